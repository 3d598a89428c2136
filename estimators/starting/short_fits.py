"""Short fits from several starts at once: damped Gauss-Newton steps of all of them in the same array operations.

The start of a nonlinear fit is looked for among candidates. What tells them apart is settled by a few steps, and one
evaluation of several vectors costs little more than that of one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rotorfit.estimators.misfit.problem import Problem
from rotorfit.models.array_types import Float, Index

PRIOR_SIZES = 100.0
"""Multiples of a parameter's size by which a short fit may move it, so that what the data leave open does not drift."""


@dataclass(frozen=True, eq=False)
class ShortFits:
    """Ends of short fits."""

    x: Float  # vectors, shape ``(W, p)``
    cost: Float  # half the (robust) sum of squares plus minus the log prior, the pull to the start included, ``(W,)``


@dataclass
class _Points:
    """Where the fits are: cost, its slope and its Gauss-Newton matrix in units of the sizes."""

    x: Float
    cost: Float
    slope: Float
    matrix: Float

    def move(self, members: Index, other: _Points, rows: NDArray[np.bool_]) -> None:
        """Move some of the fits to other points, given by their rows."""
        for name in ("x", "cost", "slope", "matrix"):
            getattr(self, name)[members] = getattr(other, name)[rows]


class _Costs:
    """Costs of many vectors of a problem, each held loosely at its start."""

    def __init__(self, problem: Problem, starts: Float, sizes: Float) -> None:
        self._problem, self._starts, self._sizes = problem, starts, sizes

    def at(self, x: Float, members: Index) -> _Points:
        """Points of some of the fits at vectors ``(len(members), p)``."""
        sizes = self._sizes[members]
        cost, slope, matrix = self._problem.evaluate(x)
        every = np.arange(x.shape[1])
        slope, matrix = slope * sizes, matrix * sizes[:, :, None] * sizes[:, None, :]
        moved = (x - self._starts[members]) / (PRIOR_SIZES * sizes)
        matrix[:, every, every] += 1 / PRIOR_SIZES**2
        cost = cost + 0.5 * (moved**2).sum(axis=1)
        cost = np.where(np.isfinite(cost + slope.sum(axis=1) + matrix.sum(axis=(1, 2))), cost, np.inf)
        return _Points(x, cost, slope + moved / PRIOR_SIZES, matrix)


def short_fits(problem: Problem, starts: Float, sizes: Float) -> ShortFits:
    """Fit from every start until little more is to be gained."""
    lower, upper = problem.space.lower, problem.space.upper
    costs = _Costs(problem, starts, sizes)
    smallest_damping = 1e-3
    damping = np.full(len(starts), smallest_damping)
    largest_damping = 1e10
    tolerance = 1e-3  # fall of the cost that the next step promises, relative to the cost, at which a fit has settled
    with np.errstate(all="ignore"):  # a trial point may well be absurd
        here = costs.at(starts.copy(), np.arange(len(starts)))
        active = np.flatnonzero(np.isfinite(here.cost))
        for _ in range(25):
            step, promise = _steps(here, active, sizes, damping, lower, upper)
            going = (promise > tolerance * here.cost[active]) & (damping[active] < largest_damping)
            active, step = active[going], step[going]
            if not active.size:
                break
            trial = costs.at(np.clip(here.x[active] + step, lower, upper), active)
            better = trial.cost < here.cost[active]
            here.move(active[better], trial, better)
            damping[active] = np.where(better, damping[active] / 10, np.maximum(10 * damping[active], smallest_damping))
    return ShortFits(here.x, here.cost)


def _steps(
    here: _Points, active: Index, sizes: Float, damping: Float, lower: Float, upper: Float
) -> tuple[Float, Float]:
    """Damped Gauss-Newton steps, entries at a bound and pressed on held, and the fall of the cost that they promise."""
    x, slope = here.x[active], here.slope[active]
    held = ((x <= lower) & (slope > 0)) | ((x >= upper) & (slope < 0))
    every = np.arange(x.shape[1])
    slope = np.where(held, 0.0, slope)
    matrix = np.where(held[:, :, None] | held[:, None, :], 0.0, here.matrix[active])
    matrix[:, every, every] *= 1 + damping[active, None]
    matrix[:, every, every] += held
    step = -np.linalg.solve(matrix, slope[..., None])[..., 0]
    return step * sizes[active], -(slope * step).sum(axis=1) / 2
