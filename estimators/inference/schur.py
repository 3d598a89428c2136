"""Parameters that parts of the data share: what each part says of them with its own parameters free.

The Gauss-Newton matrix of a joint fit is an arrow: blocks of each part's own parameters, bordered by the shared ones.
Its Schur complement is the sum of those of the parts, so that no large matrix is ever set up.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from rotorfit.models.array_types import RANK_TOLERANCE, Float, Index


@dataclass(frozen=True, eq=False, kw_only=True)
class Curvature:
    """Quadratic approximation of the cost of one part of the data around a point."""

    names: tuple[str, ...]  # parameters, shape ``(p,)``
    x: Float  # the point, shape ``(p,)``
    cost: float  # half the (robust) sum of squares there, and what priors add to it
    squares: float  # sum of the squares of the whitened residuals
    gradient: Float  # its slope, shape ``(p,)``
    matrix: Float  # its Gauss-Newton matrix, shape ``(p, p)``
    prior: Float  # what priors add to the diagonal of the matrix, shape ``(p,)``

    def scaled(self, factor: float) -> Curvature:
        """The approximation with the readings' information times a factor, that of the priors as it is."""
        own = np.diag(self.prior)
        return replace(self, matrix=factor * (self.matrix - own) + own)


@dataclass(frozen=True, eq=False, kw_only=True)
class Parts:
    """A quadratic approximation parted in ``s`` shared and ``q`` own parameters."""

    shared: Index  # places of the shared among the parameters of the quadratic, shape ``(s,)``
    own: Index  # places of the others, shape ``(q,)``
    schur: Float  # information on the shared ones, the own ones free, shape ``(s, s)``
    size: Float  # information on each of the shared ones, all others known, shape ``(s,)``
    gradient: Float  # slope by the shared ones, the own ones following, shape ``(s,)``
    follow: Float  # change of the own ones for a change of the shared ones, shape ``(q, s)``
    own_covar: Float  # covariance of the own ones, the shared ones known, shape ``(q, q)``

    @classmethod
    def of(cls, quadratic: Curvature, names: Sequence[str]) -> Parts:
        """Part an approximation."""
        shared = np.array([quadratic.names.index(name) for name in names], dtype=np.intp)
        own = np.setdiff1d(np.arange(len(quadratic.names)), shared)
        A = quadratic.matrix
        size = np.sqrt(np.maximum(np.diag(A), 0.0))
        scale = 1 / np.where(size > 0, size, 1.0)
        unit = A * np.outer(scale, scale)
        inner = np.linalg.pinv(unit[np.ix_(own, own)], rcond=RANK_TOLERANCE, hermitian=True) * np.outer(
            scale[own], scale[own]
        )
        follow = -inner @ A[np.ix_(own, shared)]
        schur = A[np.ix_(shared, shared)] + A[np.ix_(shared, own)] @ follow
        return cls(
            shared=shared,
            own=own,
            schur=schur,
            size=np.diag(A)[shared],
            gradient=quadratic.gradient[shared] + follow.T @ quadratic.gradient[own],
            follow=follow,
            own_covar=inner,
        )

    def reach(self) -> Float:
        """Slope of all parameters by the shared ones, the own ones following, shape ``(p, s)``."""
        slope = np.zeros((self.shared.size + self.own.size, self.shared.size))
        slope[self.shared, np.arange(self.shared.size)] = 1.0
        slope[self.own] = self.follow
        return slope

    def covariance(self, covar: Float) -> Float:
        """Covariance of all parameters, shape ``(p, p)``."""
        whole = self.reach() @ covar @ self.reach().T
        whole[np.ix_(self.own, self.own)] += self.own_covar
        return np.asarray(whole)

    def pull(self, covar: Float) -> Float:
        """Change of the own parameters by this part's slope of the cost, shape ``(q, p)``."""
        direct = np.zeros((self.own.size, self.shared.size + self.own.size))
        direct[:, self.own] = self.own_covar
        return np.asarray(direct + self.follow @ covar @ self.reach().T)


def shared_covariance(parts: Sequence[Parts], names: Sequence[str]) -> Float:
    """Covariance of the shared parameters by all parts of the data, shape ``(s, s)``."""
    return inverse_information(np.sum([p.schur for p in parts], axis=0), np.sum([p.size for p in parts], axis=0), names)


def inverse_information(information: Float, size: Float, names: Sequence[str]) -> Float:
    """Covariance of shared parameters."""
    scale = 1 / np.sqrt(np.where(size > 0, size, 1.0))
    power, directions = np.linalg.eigh(information * np.outer(scale, scale))
    open_ = power <= RANK_TOLERANCE
    if open_.any():
        named = [name for i, name in enumerate(names) if np.abs(directions[i, open_]).max(initial=0.0) > 0.1]
        raise ValueError(
            f"the runs do not determine the shared {', '.join(named or names)}: take them for known, or share less"
        )
    return np.asarray(directions / power @ directions.T * np.outer(scale, scale))
