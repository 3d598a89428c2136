"""Covariance that follows the residuals line by line where no shape of noise explains them (HC3, by clusters).

Noise that lies in one direction of the complex plane, as that of a speed that jitters, or that two probes share at a
line, is not seen by one variance a reading. The scatter of the gradient, summed line by line, sees both.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np

from rotorfit.estimators.noise.run_effects import powers, real_rows
from rotorfit.models.array_types import ComplexArray, Float, Index

_LEFT = 0.05  # share of a reading's residual that its fit leaves at least, in estimates of its noise


@dataclass(frozen=True, eq=False, kw_only=True)
class LineScatter:
    """Scatter of the gradient by lines, beside what equal and circular noise brings."""

    gathered: Callable[[], Float]  # what makes the scatter line by line, shape ``(p, L)``
    excess: Float  # standard deviations by which the variance of each entry exceeds that of such noise, shape ``(p,)``
    freedom: Float  # degrees of freedom of those variances, shape ``(p,)``

    @cached_property
    def covar(self) -> Float:
        """Covariance of the estimate by HC3, shape ``(p, p)``."""
        scatter = self.gathered()
        return np.asarray(scatter @ np.swapaxes(scatter, -1, -2))


def line_scatter(r: ComplexArray, J: ComplexArray, covar: Float, line: Index, power: float = 1.0) -> LineScatter:
    """Compare the scatter of the gradient with what the noise explains."""
    return scatter_by_line(r, real_rows(J), covar, line, power)


def scatter_by_line(r: ComplexArray, ours: Float, covar: Float, line: Index, power: Float | float) -> LineScatter:
    """:func:`line_scatter` of one run, or of many runs of one plan along a leading axis."""
    moved = np.asarray(np.swapaxes(covar, -1, -2) @ ours)  # both parts of each reading one after the other
    left = np.maximum(1 - powers(moved, ours) / 2, _LEFT)
    by_line = _sums_by_line(line)

    def gathered(size: Float) -> Float:
        return by_line(moved * (r / size).view(float)[..., None, :])

    expected = by_line(moved * moved)
    total = np.maximum(expected.sum(axis=-1), np.finfo(float).tiny)
    chance = np.sqrt(2 * np.sum(expected**2, axis=-1)) / total
    found = np.sum(gathered(np.sqrt(left)) ** 2, axis=-1) / total / np.asarray(power)[..., None]
    safe = np.maximum(chance, np.finfo(float).eps)
    return LineScatter(gathered=partial(gathered, left), excess=(found - 1) / safe, freedom=2 / safe**2)


def _sums_by_line(line: Index) -> Callable[[Float], Float]:
    """What sums parts of readings, shape ``(..., 2 R)``, over the readings of each line, shape ``(..., L)``."""
    parts: slice | Index = slice(None)
    if (line[1:] < line[:-1]).any():
        order = np.argsort(line, kind="stable")
        line, parts = line[order], (2 * order[:, None] + np.arange(2)).ravel()
    starts = np.flatnonzero(np.diff(line, prepend=-1))
    size = line.size // max(starts.size, 1)
    if np.array_equal(starts, np.arange(0, line.size, size)):  # lines of one length: ten times as fast
        ones = np.ones(2 * size)
        return lambda values: values[..., parts].reshape(*values.shape[:-1], -1, 2 * size) @ ones
    return lambda values: np.add.reduceat(values[..., parts], 2 * starts, axis=-1)
