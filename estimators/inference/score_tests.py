"""Score tests of terms that a model leaves out: one more column of the Jacobian each, and no fit.

Near the estimate the whitened residuals are ``r + J dx + c t`` with ``c`` what one unit of a left-out term does to the
predictions. The part of ``c`` that the fitted parameters cannot take up determines ``t``; the rest of ``c`` is how far
the estimate moves with it (the score, or Lagrange multiplier, test of Rao 1948).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rotorfit.models.array_types import RANK_TOLERANCE, ComplexArray, Float, Index


@dataclass(frozen=True, kw_only=True)
class Scores:
    """Score tests of left-out terms, one entry each, taken one by one."""

    estimate: Float  # size of the term that the residuals ask for, in its units; NaN where parameters take up all of it
    stderr: Float  # its standard error, infinite there
    shift: Float  # change of the fitted vector by one unit of the term, shape ``(T, p)``


def score_tests(residuals: ComplexArray, jacobian: ComplexArray, columns: ComplexArray, priors: Float) -> Scores:
    """Test terms that are left out of a model, and tell how far each would move the estimate."""
    r, c, J = _stacked(residuals, jacobian, columns, priors)
    size = np.linalg.norm(J, axis=0)
    size = np.where(size > 0, size, 1.0)
    left, singular, right = np.linalg.svd(J / size, full_matrices=False)
    kept = singular > RANK_TOLERANCE * singular.max(initial=0.0)
    within = left[:, kept].T @ c
    taken = (right[kept].T / singular[kept]) @ within / size[:, None]
    rest = c - left[:, kept] @ within
    whole, free = np.linalg.norm(c, axis=0), np.linalg.norm(rest, axis=0)
    seen = free > np.sqrt(RANK_TOLERANCE) * whole
    power = np.where(seen, free, 1.0) ** 2
    return Scores(
        estimate=np.where(seen, -(rest.T @ r) / power, np.nan),
        stderr=np.where(seen, 1.0 / np.sqrt(power), np.inf),
        shift=-taken.T,
    )


@dataclass(frozen=True, kw_only=True)
class Gains:
    """Share of the residuals that groups of columns explain beside the fitted parameters, one entry a group."""

    gain: Float  # fall of the sum of squares
    rank: Float  # columns that parameters do not take up
    square: float  # sum of squares without any
    freedom: int  # its degrees of freedom


def joint_gains(
    residuals: ComplexArray, jacobian: ComplexArray, columns: ComplexArray, priors: Float, groups: Sequence[Index]
) -> Gains:
    """Sums of squares that groups of columns explain, each group on its own."""
    r, c, J = _stacked(residuals, jacobian, columns, priors)
    left = _basis(J)
    rest, whole = c - left @ (left.T @ c), np.linalg.norm(c, axis=0)
    r = r - left @ (left.T @ r)
    seen = np.linalg.norm(rest, axis=0) > np.sqrt(RANK_TOLERANCE) * whole
    bases = [_basis(rest[:, own[seen[own]]]) for own in groups]
    return Gains(
        gain=np.array([float(np.sum((basis.T @ r) ** 2)) for basis in bases]),
        rank=np.array([float(basis.shape[1]) for basis in bases]),
        square=float(r @ r),
        freedom=2 * residuals.size - left.shape[1],
    )


def _basis(columns: Float) -> Float:
    """Orthonormal basis of what columns span."""
    size = np.linalg.norm(columns, axis=0)
    left, singular, _ = np.linalg.svd(columns / np.where(size > 0, size, 1.0), full_matrices=False)
    return np.asarray(left[:, singular > RANK_TOLERANCE * singular.max(initial=0.0)])


def _stacked(
    residuals: ComplexArray, jacobian: ComplexArray, columns: ComplexArray, priors: Float
) -> tuple[Float, Float, Float]:
    """Residuals, columns and derivatives as real numbers, with a row for each prior."""
    known = np.zeros((priors.size, columns.shape[1]))
    J = np.concatenate([jacobian.real, jacobian.imag, np.diag(np.sqrt(priors))])
    c = np.concatenate([columns.real, columns.imag, known])
    return np.concatenate([residuals.real, residuals.imag, np.zeros(priors.size)]), c, J
