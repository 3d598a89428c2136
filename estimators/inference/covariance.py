"""Errors of a solution: curvature of the cost, its sandwich for robust losses, and the chi-squared that widens them.

The Gauss-Newton matrix of a joint fit of parts of the data is an arrow: blocks of each part's own parameters, bordered
by the shared ones. Its Schur complement is the sum of those of the parts, so that no large matrix is ever set up.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from rotorfit.base.array_types import RANK_TOLERANCE, ComplexArray, Float, Index
from rotorfit.base.significance import P_CHANCE
from rotorfit.estimators.inference.identifiability import covariance as inverse
from rotorfit.estimators.inference.identifiability import natural_scales
from rotorfit.estimators.misfit.problem import Derivatives, Loss, Problem, robust_weights
from rotorfit.estimators.noise.run_effects import LEAST_RESIDUAL_SHARE, real_rows


def widening(redchi: float, loss: Loss, *, rescaled: bool = False, nfree: int = 0, freedom: float = math.inf) -> float:
    """Factor on a covariance for a model that does not fit to within the noise. Robust losses and noise levels set by
    residuals follow these already; of noise known from few mountings a redchi within reach of chance (F, 5 %) is no
    misfit."""
    if loss != "linear" or rescaled:
        return 1.0
    if math.isfinite(freedom) and nfree > 0:
        from scipy.special import fdtri  # late: loading it takes longer than a fit

        return redchi if redchi > float(fdtri(nfree, freedom, 1 - P_CHANCE)) else 1.0
    return max(1.0, redchi)


def standard_error(slope: Float, covar: Float) -> Float:
    """Standard error of quantities that follow from an estimate, by the delta method, shape ``(...)``."""
    return np.asarray(np.sqrt(np.maximum(np.sum(slope @ covar * slope, axis=-1), 0.0)))


def spreading(covar: Float) -> Float:
    """Changes of an estimate, one a column, whose squares add up to a covariance, shape ``(p, p)``. Of entries in units
    of their errors they are symmetric, so that draws do not hang on the signs of eigenvectors."""
    size = np.sqrt(np.maximum(np.diag(covar), 0.0))
    size = np.where(size > 0, size, 1.0)
    power, basis = np.linalg.eigh(covar / np.outer(size, size))
    return np.asarray(size[:, None] * ((basis * np.sqrt(np.maximum(power, 0.0))) @ basis.T))


def spread_along(slope: Float, covar: Float) -> Float:
    """Changes of a result by independent numbers of unit variance, from a covariance of what it depends on."""
    return np.asarray(slope @ spreading(covar))


@cache
def _expected_loss(loss: Loss) -> float:
    """Mean robust cost of one complex reading under pure noise, |r|^2 being chi-squared with two degrees of freedom."""
    q = (np.arange(20000) + 0.5) / 20000
    return float(np.mean(robust_weights(loss, -2 * np.log1p(-q))[0]))


def per_freedom(loss: Loss, nfree: int) -> float:
    """Factor from the (robust) sum of squared residuals to its ratio to what noise alone leaves, for any loss."""
    return 2 / nfree / _expected_loss(loss) if nfree > 0 else float("nan")


def information(
    problem: Problem, x: Float, r: ComplexArray, derivatives: Derivatives, *, widening: float = 1.0
) -> tuple[Float, Float | None]:
    """``R`` with ``R^T R`` the cost's curvature, and the scatter of its gradient; None for independent squares."""
    prior = prior_curvature(problem, x)
    if problem.loss == "linear":
        curvature = (problem.gauss_newton(x)[2] - np.diag(prior)) / widening + np.diag(prior)
        size = np.sqrt(np.maximum(np.diag(curvature), 0.0))  # less what a prior leaves to round-off
        least_eigenvalue = 1e-5  # of a curvature of unit diagonal from which its inverse has ten digits
        safe = np.where(size > 0, size, 1.0)
        unit = curvature / safe[:, None] / safe  # one after the other: the product of tiny sizes is zero
        if size.all() and np.isfinite(unit).all() and np.linalg.eigvalsh(unit)[0] >= least_eigenvalue:
            root = np.asarray(np.linalg.cholesky(curvature).T)
        else:  # the product hides weak directions in round-off
            root = _root(derivatives.whole / np.sqrt(widening), prior)
        return root, _common_scatter(problem, x, derivatives)
    bend, J = float(np.mean(bends(problem.loss, r))), derivatives.whole
    root = _root(np.sqrt(bend) * J, prior)
    covar = inverse(root, parameter_scales(problem, x))[0]
    return root, score_scatter(problem, x, r, J, bend=bend, covar=covar)


def _root(J: ComplexArray, prior: Float) -> Float:
    """Triangle of whitened derivatives and what priors add to the diagonal of the curvature, at any condition."""
    rows = real_rows(J).T
    if prior.any():
        rows = np.concatenate([rows, np.diag(np.sqrt(prior))[prior > 0]])
    return np.asarray(np.linalg.qr(rows, mode="r"))


def bends(loss: Loss, r: ComplexArray) -> Float:
    """Curvature of the cost by each whitened residual, averaged over its phases, shape ``(R,)``; one for squares."""
    size2 = np.abs(r) ** 2
    weight = robust_weights(loss, size2)[1]
    if loss == "linear":
        return weight
    step = 1e-4 * (1 + size2)
    slope = (robust_weights(loss, size2 + step)[1] - weight) / step
    # A modulus loss bends by w + 2 |r|^2 w' along r and by w across it; residual phases are uniform.
    return np.asarray(weight + size2 * slope)


def prior_curvature(problem: Problem, x: Float) -> Float:
    """Contribution of the priors to the diagonal of the curvature, shape ``(p,)``."""
    added = np.zeros(x.size)
    for prior in problem.priors:
        added[prior.entry] += prior.terms(float(x[prior.entry]))[2]
    return added


def prior_slope(problem: Problem, x: Float) -> Float:
    """Contribution of the priors to the slope of the cost, shape ``(p,)``."""
    slope = np.zeros(x.size)
    for prior in problem.priors:
        slope[prior.entry] += prior.terms(float(x[prior.entry]))[1]
    return slope


def score_scatter(problem: Problem, x: Float, r: ComplexArray, J: ComplexArray, *, bend: float, covar: Float) -> Float:
    """Scatter of the cost's gradient, each reading's part judged by a fit without it, to first order (MacKinnon and
    White 1985, HC3), shape ``(p, p)``."""
    parts = np.stack([J.real, J.imag], axis=1)  # (R, 2, p)
    power, basis = np.linalg.eigh(bend * (parts @ covar @ parts.transpose(0, 2, 1)))
    along = np.einsum("rik,ri->rk", basis, np.stack([r.real, r.imag], axis=1))
    # A reading that alone determines something cannot be left out.
    left_out = np.einsum("rik,rk->ri", basis, along / np.maximum(1 - power, LEAST_RESIDUAL_SHARE))
    _, weight = robust_weights(problem.loss, np.abs(r) ** 2)
    scores = weight[:, None] * np.einsum("ri,rip->rp", left_out, parts)
    # A prior's centre is as uncertain as the prior is wide.
    return np.asarray(scores.T @ scores + np.diag(prior_curvature(problem, x)))


def weighing_error(problem: Problem, J: ComplexArray, covar: Float) -> Float:
    """Contribution of errors of the weights, known from few mountings, to a covariance, ``(p, p)``."""
    parts = zip(problem.blocks, problem.by_block(J), strict=True)
    total = np.sum([block.weighing_error(rows, covar) for block, rows in parts], axis=0)
    return np.asarray(covar @ total @ covar)


def _common_scatter(problem: Problem, x: Float, derivatives: Derivatives) -> Float | None:
    """Scatter of the cost's gradient where readings of one mounting err together, None where all are independent."""
    if all(block.independent for block in problem.blocks):
        return None
    total = np.diag(prior_curvature(problem, x))
    for block, rows in zip(problem.blocks, problem.by_block(derivatives.whole), strict=True):
        total = total + (rows.conj().T @ block.scattered(rows)).real
    return np.asarray(total)


def inverse_curvature(problem: Problem, x: Float) -> Float:
    """Change of the estimate by the slope of the cost, shape ``(p, p)``."""
    derivatives = Derivatives(problem, x)
    root, _ = information(problem, x, derivatives.residuals, derivatives)
    return inverse(root, parameter_scales(problem, x))[0]


def excess(wide: Float, own: Float) -> Float:
    """Least addition to a covariance so that no combination is surer than by another, shape ``(p, p)``."""
    size = np.sqrt(np.maximum(np.diag(own), np.diag(wide)))
    size = np.where(size > 0, size, 1.0)
    power, basis = np.linalg.eigh((wide - own) / np.outer(size, size))
    return np.asarray((basis * np.maximum(power, 0.0)) @ basis.T * np.outer(size, size))


def parameter_scales(problem: Problem, x: Float) -> Float:
    """Size of each parameter that would matter in these data."""
    space = problem.space
    responses = problem.responses
    if not responses:
        typical = np.concatenate([space.typical, np.ones(len(space.nuisance))])
        return np.maximum(np.abs(x), 0.1 * typical)
    levels, top = [], 0.0
    for block in responses:
        drive = np.linalg.norm(block.force, axis=1)[block.line]  # force, or imposed displacement
        ratio = np.abs(block.measured) / drive if block.imposed else drive / np.abs(block.measured)
        levels.append(ratio[np.isfinite(ratio) & (ratio > 0)])
        # Constant loads see damping and inertia by the fluid that turns with the shaft.
        top = max(top, float(np.abs(block.frequency).max()) or float(np.abs(block.speed).max()))
    stiffness = float(np.median(np.concatenate(levels)))
    own = natural_scales(space.model, space.base, x[: len(space.names)], stiffness, max(top, 1e-12))
    return np.concatenate([own, np.ones(len(space.nuisance))])


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
