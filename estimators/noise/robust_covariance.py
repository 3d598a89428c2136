"""Covariance that follows the residuals line by line where no shape of noise explains them (HC3, by clusters).

Noise that lies in one direction of the complex plane, as that of a speed that jitters, or that two probes share at a
line, is not seen by one variance a reading. The scatter of the gradient, summed line by line, sees both.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rotorfit.estimators.noise.run_effects import LEAST_RESIDUAL_SHARE, powers, real_rows
from rotorfit.models.array_types import ComplexArray, Float, Index


@dataclass(frozen=True, eq=False, kw_only=True)
class LineScatter:
    """Scatter of the gradient by lines, beside what equal and circular noise brings."""

    covar: Float  # covariance of the estimate by HC3, shape ``(p, p)``
    excess: Float  # standard deviations by which the variance of each entry exceeds that of such noise, shape ``(p,)``
    freedom: Float  # degrees of freedom of those variances, shape ``(p,)``


def line_scatter(r: ComplexArray, J: ComplexArray, covar: Float, line: Index, power: float = 1.0) -> LineScatter:
    """Compare the scatter of the gradient with what noise of a given power explains."""
    own = real_rows(J)
    moved = covar @ own  # both parts of each reading one after the other
    left = np.maximum(1 - powers(moved, own) / 2, LEAST_RESIDUAL_SHARE)
    order = np.argsort(line, kind="stable")
    starts = 2 * np.flatnonzero(np.diff(line[order], prepend=-1))
    parts = (2 * order[:, None] + np.arange(2)).ravel()

    def by_line(values: Float) -> Float:
        return np.asarray(np.add.reduceat(values[:, parts], starts, axis=1))

    def gathered(residuals: ComplexArray) -> Float:
        return by_line(moved * residuals.view(float))

    expected = by_line(moved**2)
    total = np.maximum(expected.sum(axis=1), np.finfo(float).tiny)
    chance = np.maximum(np.sqrt(2 * np.sum(expected**2, axis=1)) / total, np.finfo(float).eps)
    ratio = np.sum(gathered(r / np.sqrt(left)) ** 2, axis=1) / total / power
    scatter = gathered(r / left)
    return LineScatter(covar=scatter @ scatter.T, excess=(ratio - 1) / chance, freedom=2 / chance**2)
