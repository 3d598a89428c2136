"""Score tests of terms that a model leaves out: one more column of the Jacobian each, and no fit.

Near the estimate the whitened residuals are ``r + J dx + c t`` with ``c`` what one unit of a left-out term does to the
predictions. What the fitted parameters cannot take up of ``c`` tells ``t``; what they can take up is how far the
estimate moves with it (the score, or Lagrange multiplier, test of Rao 1948).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rotorfit.models.array_types import RANK_TOLERANCE, ComplexArray, Float

_SMALLEST_REMAINDER = 1e-6  # length left of a column, over its own, at which parameters took up all of it


@dataclass(frozen=True, kw_only=True)
class Scores:
    """Score tests of left-out terms, one entry each, taken one by one."""

    estimate: Float  # size of the term that the residuals ask for, in its units; NaN where parameters take up all of it
    stderr: Float  # its standard error, infinite there
    shift: Float  # change of the fitted vector by one unit of the term, shape ``(T, p)``


def score_tests(residuals: ComplexArray, jacobian: ComplexArray, columns: ComplexArray, priors: Float) -> Scores:
    """Test terms that are left out of a model, and tell how far each would move the estimate."""
    known = np.zeros((priors.size, columns.shape[1]))
    J = np.concatenate([jacobian.real, jacobian.imag, np.diag(np.sqrt(priors))])
    c = np.concatenate([columns.real, columns.imag, known])
    r = np.concatenate([residuals.real, residuals.imag, np.zeros(priors.size)])
    size = np.linalg.norm(J, axis=0)
    size = np.where(size > 0, size, 1.0)
    left, singular, right = np.linalg.svd(J / size, full_matrices=False)
    kept = singular > RANK_TOLERANCE * singular.max(initial=0.0)
    within = left[:, kept].T @ c
    taken = (right[kept].T / singular[kept]) @ within / size[:, None]
    rest = c - left[:, kept] @ within
    whole, free = np.linalg.norm(c, axis=0), np.linalg.norm(rest, axis=0)
    seen = free > _SMALLEST_REMAINDER * whole
    power = np.where(seen, free, 1.0) ** 2
    return Scores(
        estimate=np.where(seen, -(rest.T @ r) / power, np.nan),
        stderr=np.where(seen, 1.0 / np.sqrt(power), np.inf),
        shift=-taken.T,
    )
