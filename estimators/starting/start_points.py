"""Points where a search may begin: inside the bounds, of typical size, at random; and short fits from several at once.

Candidates for the start of a nonlinear fit are compared by a few damped Gauss-Newton steps, of all of
them in the same array operations: one evaluation of several vectors costs little more than that of one.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from rotorfit.base.array_types import Float
from rotorfit.estimators.misfit.parameter_space import DATUM, ParameterSpace
from rotorfit.estimators.misfit.problem import Problem

CLOSED_FORM = "closed form"  # eqs 5 to 9, weighted
SHORT_FIT = "short fit"  # the best end of a few steps from several closed forms
RANDOM = "random starts"  # the best end of a few steps from many typical rotors
RATIONAL_FIT = "rational fit"  # poles and residues of a modal model
SPECTRAL_LINES = "spectral lines"  # linear least squares, one kind of line after the other
POLES = "poles"  # the best end of a few steps from rotors that have the poles of measured spectra
GIVEN = "given"  # every value by the user
EARLIER_FIT = "earlier fit"  # the optimum of a fit that this one varies


@dataclass(frozen=True, eq=False, kw_only=True)
class Start:
    """Where a search begins."""

    x: Float  # parameters, or the whole vector with nuisance entries behind them, shape ``(p,)``
    kind: str  # which one was taken, one of the names above
    others: tuple[Float, ...] = ()  # of x beside it, from which a search may end elsewhere
    notes: tuple[str, ...] = ()  # what had to be assumed, or is in doubt, in sentences
    perhaps_local: bool = False  # True if another minimum may be as deep or deeper; a note says why


def full_vector(problem: Problem, values: Float, datum: float = 0.0) -> Float:
    """Values of the parameters moved inside the bounds, nuisance entries behind them at zero."""
    nuisance = [datum if name == DATUM else 0.0 for name in problem.space.nuisance]
    return np.concatenate([inside_bounds(values, problem.space), nuisance])


def inside_bounds(values: Float, space: ParameterSpace) -> Float:
    """Values moved off the bounds, where Ipopt's barrier wants them."""
    lower, upper = space.lower[: values.shape[-1]], space.upper[: values.shape[-1]]
    margin = 1e-3 * np.where(np.isfinite(upper - lower), upper - lower, np.maximum(np.abs(values), 1e-3))
    margin = np.minimum(margin, 1e-3 * space.typical)
    return np.asarray(np.clip(values, lower + margin, upper - margin))


def search_scale(space: ParameterSpace, start: Float) -> Float:
    """Sizes by which a search is scaled."""
    typical = np.concatenate([space.typical, np.full(len(space.nuisance), 0.1)])
    return np.where(np.abs(start) > 1e-6 * typical, np.abs(start), typical)


def random_starts(problem: Problem, count: int) -> Iterator[Float]:
    """Starts spread over a decade around typical values, always the same ones."""
    rng = np.random.default_rng(0)
    scale = problem.space.typical
    deviation = 0.8  # standard deviation of the logarithm of random starts: most lie within a decade
    for _ in range(count):
        yield full_vector(problem, scale * np.exp(rng.normal(0.0, deviation, scale.size)))


def noise_limit(problem: Problem) -> float:
    """Cost that noise leaves, to six standard deviations of chi-squared."""
    return 0.5 * float(problem.n_data + 6 * np.sqrt(2 * problem.n_data))


PRIOR_SIZES = 100.0
"""Multiples of a parameter's size by which a short fit may move it, so that what the data leave open does not drift."""


class ShortFits(NamedTuple):
    """Ends of short fits."""

    x: Float  # vectors, shape ``(W, p)``
    cost: Float  # half the (robust) sum of squares plus minus the log prior, the pull to the start included, ``(W,)``

    @property
    def best(self) -> Float:
        """The end of least cost, shape ``(p,)``."""
        return np.asarray(self.x[np.argmin(self.cost)])


def short_fits(problem: Problem, starts: Float) -> ShortFits:
    """Fit from every start, shape ``(W, p)``, held loosely there, until little more is to be gained."""
    lower, upper = problem.space.lower, problem.space.upper
    sizes = np.abs(starts) + (starts == 0)
    count, every = len(problem.space.names), np.arange(starts.shape[1])
    sizes[:, :count] = np.maximum(np.abs(starts[:, :count]), problem.space.typical)
    smallest_damping, largest_damping = 1e-3, 1e10
    damping = np.full(len(starts), smallest_damping)
    tolerance = 1e-3  # fall of the cost that the next step promises, relative to the cost, at which a fit has settled
    x = starts.copy()
    with np.errstate(all="ignore"):  # a trial point may well be absurd
        cost, slope, matrix = _evaluate(problem, x, starts, sizes)
        active = np.flatnonzero(np.isfinite(cost))
        for _ in range(25):
            inside = (x[active] > lower) | (slope[active] <= 0), (x[active] < upper) | (slope[active] >= 0)
            free = inside[0] & inside[1]
            down, normal = np.where(free, slope[active], 0.0), matrix[active] * (free[:, :, None] & free[:, None, :])
            normal[:, every, every] = normal[:, every, every] * (1 + damping[active, None]) + ~free
            step = -np.linalg.solve(normal, down[..., None])[..., 0]
            promise = -(down * step).sum(axis=1) / 2
            going = (promise > tolerance * cost[active]) & (damping[active] < largest_damping)
            active, step = active[going], step[going]
            if not active.size:
                break
            trial = np.clip(x[active] + step * sizes[active], lower, upper)
            there = _evaluate(problem, trial, starts[active], sizes[active])
            better = there[0] < cost[active]
            for own, moved in zip((x, cost, slope, matrix), (trial, *there), strict=True):
                own[active[better]] = moved[better]
            damping[active] = np.where(better, damping[active] / 10, np.maximum(10 * damping[active], smallest_damping))
    return ShortFits(x, cost)


def _evaluate(problem: Problem, x: Float, starts: Float, sizes: Float) -> tuple[Float, Float, Float]:
    """Cost with the pull to the start, infinite where undefined, its slope and Gauss-Newton matrix by units of size."""
    cost, slope, matrix = problem.evaluate(x)
    every = np.arange(x.shape[1])
    slope, matrix = slope * sizes, matrix * sizes[:, :, None] * sizes[:, None, :]
    moved = (x - starts) / (PRIOR_SIZES * sizes)
    matrix[:, every, every] += 1 / PRIOR_SIZES**2
    cost = cost + 0.5 * (moved**2).sum(axis=1)
    cost = np.where(np.isfinite(cost + slope.sum(axis=1) + matrix.sum(axis=(1, 2))), cost, np.inf)
    return cost, slope + moved / PRIOR_SIZES, matrix
