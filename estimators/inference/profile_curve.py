"""Profile likelihood: the misfit as a function of one quantity, everything else at its best for each value of it.

Points of the curve are found together: both ends of an interval are searched side by side, and then the whole curve at
once, each point from the polynomial through its neighbours and their slopes, which is so near that one or two steps do.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from rotorfit.estimators.inference.log_posterior import box
from rotorfit.estimators.minimisation.least_squares import Options, Status, minimise
from rotorfit.estimators.misfit.normal_equations import normal_equations
from rotorfit.estimators.misfit.problem import Problem
from rotorfit.models.array_types import Bool, Float, Index

ValueAndGradient = Callable[[Float], tuple[float, Float]]
"""Value of a quantity and its gradient, shape ``(p,)``, at a fitted vector."""

_ROOT = 1e-9  # relative error of the ends, in half-widths
_STEPS = 60  # evaluations for an end at most
_REACH = 100.0  # sizes of a parameter beyond which an end that was not met counts as open
_SQP_STEPS = 40
_OPTIONS = Options(max_iterations=60, hessian="gauss-newton")
_FULL_STEPS = 15
_CONVERGED = 1e-16  # squared step that remains, in standard errors, against chi-squared
_FORETOLD = 1e-9
"""What the quadratic model of a last step may miss of the cost.

It misses the share of the step's square, in standard errors, by which Gauss-Newton steps contract.
"""


@dataclass(frozen=True, eq=False, kw_only=True)
class Minima:
    """Minima over everything else with a quantity held at some values.

    Attributes:
        cost, x: at each minimum, shapes ``(W,)`` and ``(W, p)``.
        slope: change of the minimum for a change of the value by one, shape ``(W, p)``.
        found: whether full steps led there; the others have to be searched by themselves, shape ``(W,)``.
        contraction: largest length of a step over that of the one before; zero where none took two.
    """

    cost: Float
    x: Float
    slope: Float
    found: Bool
    contraction: float


class Held(Protocol):
    """The minimum over everything else with one quantity held at a value."""

    def together(self, values: Float, starts: Float, contraction: float) -> Minima:
        """Minima for values of shape ``(W,)`` from starts nearby, shape ``(W, p)``, where full steps lead there.

        Steps are taken to contract as given, and a step whose model tells the rest is the last.
        """
        ...

    def alone(self, value: float, start: Float) -> tuple[float, Float, bool]:
        """Cost and vector at the minimum for one value, and whether it is one to full precision.

        The cost is infinite where there is nothing.
        """
        ...


@dataclass(frozen=True, kw_only=True)
class End:
    """One end of an interval.

    Attributes:
        value: where the curve meets the level; infinite if it does not.
        limit: how far it was followed: a bound, or some hundred times the quantity's own size.
        rise: rise of the curve at the end, or at the limit.
        at_bound: the limit is a bound.
        exact: whether the end was found to full precision.
    """

    value: float
    limit: float
    rise: float
    at_bound: bool
    exact: bool


@dataclass(frozen=True, eq=False)
class _Point:
    value: float
    x: Float
    rise: float
    slope: Float | None  # None where it is not known


_Search = Generator[float, float, End]
"""Asks for the rise at a value, gets it, and so on, until it knows the end."""


class Curve:
    """Twice the rise of the cost above its minimum, every point found from its neighbours.

    Args:
        held: minimum over everything else.
        value, x, cost: quantity, vector and cost at the minimum.
        direction: change of the vector for a change of the quantity by one, at the minimum; zero if not known.

    Attributes:
        unsettled: points that are not at a minimum to full precision, so that the curve may be too high there.
    """

    def __init__(self, held: Held, value: float, x: Float, cost: float, direction: Float) -> None:
        self._held, self._cost = held, cost
        self._points = [_Point(value, x, 0.0, direction)]
        self._contraction = 0.0
        self.unsettled = 0

    @property
    def lowest(self) -> float:
        """Least rise met, below zero if the minimum given was not the lowest."""
        return min(point.rise for point in self._points)

    def __call__(self, values: Sequence[float]) -> list[float]:
        """Rise at values of the quantity; those that full steps do not reach are followed in the order given."""
        known = {point.value: point.rise for point in self._points}
        new = [value for value in dict.fromkeys(values) if value not in known]
        if new:
            starts = np.array([self._predict(value) for value in new])
            minima = self._held.together(np.array(new), starts, self._contraction or 1.0)
            self._contraction = max(self._contraction, minima.contraction)
            for i in np.flatnonzero(minima.found).tolist():
                rise = 2 * (float(minima.cost[i]) - self._cost)
                known[new[i]] = rise
                self._points.append(_Point(new[i], minima.x[i], rise, minima.slope[i]))
            for i in np.flatnonzero(~minima.found).tolist():
                known[new[i]] = self._alone(new[i])
        return [known[value] for value in values]

    def _alone(self, value: float) -> float:
        cost, x, settled = self._held.alone(value, self._predict(value))
        self.unsettled += not settled
        if not math.isfinite(cost):
            return math.inf
        rise = 2 * (cost - self._cost)
        self._points.append(_Point(value, x, rise, None))
        return rise

    def _predict(self, value: float) -> Float:
        """Vector at a value, from the nearest point and the nearest one at least as far from that as the value is."""
        near = min(self._points, key=lambda point: abs(point.value - value))
        way = value - near.value
        others = [point for point in self._points if point is not near and abs(point.value - near.value) >= abs(way)]
        if not others:
            return near.x if near.slope is None else near.x + way * near.slope
        other = min(others, key=lambda point: abs(point.value - value))
        return _between(near, other, way / (other.value - near.value))

    def ends(self, level: float, step: float, reach: Sequence[tuple[float, bool]]) -> list[End]:
        """Follow the curve to both sides until it has risen to a level.

        The signed root of the rise is nearly a straight line, so its zero is soon found.

        Args:
            level: rise asked for.
            step: where the ends are guessed to be, from the minimum.
            reach: how far to go, a value of the quantity, and whether that is a bound: downwards and upwards.
        """
        searches = [
            self._search(side, level, step, limit, bound) for side, (limit, bound) in zip((-1, 1), reach, strict=True)
        ]
        ends: dict[int, End] = {}
        asked = {side: next(search) for side, search in enumerate(searches)}
        while asked:
            rises = self(list(asked.values()))
            for side, rise in zip(tuple(asked), rises, strict=True):
                try:
                    asked[side] = searches[side].send(rise)
                except StopIteration as last:
                    ends[side] = last.value
                    del asked[side]
        return [ends[0], ends[1]]

    def _search(self, side: int, level: float, step: float, limit: float, at_bound: bool) -> _Search:
        centre, goal = self._points[0].value, math.sqrt(level)
        reach = abs(limit - centre)
        inner, low = 0.0, -goal
        outer, high, count = min(step, reach), -goal, 0
        while count < _STEPS:
            count += 1
            high = _root((yield limit if outer == reach else centre + side * outer)) - goal
            if outer == reach and at_bound and not math.isfinite(high):  # round-off at the edge of a prior
                limit = centre + side * (1 - 1e-9) * reach
                outer = reach = abs(limit - centre)
                high = _root((yield limit)) - goal
            if high >= 0 or outer == reach:
                break
            grown = outer * min(max(1.1 * goal / (high + goal), 1.3), 4.0) if high > -goal else 4 * outer
            inner, low, outer = outer, high, min(grown, reach)
        if high < 0:
            return End(
                value=side * math.inf,
                limit=limit,
                rise=(high + goal) ** 2,
                at_bound=at_bound and outer == reach,
                exact=True,
            )
        distance, exact = yield from _solve(centre, side, (inner, low), (outer, high), goal, _STEPS - count)
        return End(value=centre + side * distance, limit=limit, rise=level, at_bound=False, exact=exact)


def _root(rise: float) -> float:
    return math.sqrt(max(rise, 0.0))


def _solve(
    centre: float, side: int, a: tuple[float, float], b: tuple[float, float], goal: float, steps: int
) -> Generator[float, float, tuple[float, bool]]:
    """Zero of root minus goal between two distances: false position, the end that stays halved (Illinois)."""
    (u, f), (v, g), kept = a, b, 0
    for _ in range(steps):
        if g == 0:
            return v, True
        # halved where nothing fits on the far side
        w = v - g * (v - u) / (g - f) if math.isfinite(g) else (u + v) / 2
        h = _root((yield centre + side * w)) - goal
        if abs(h) <= _ROOT * goal or abs(v - u) <= _ROOT * abs(v):
            return w, True
        if (h < 0) == (f < 0):
            u, f, g, kept = w, h, (g / 2 if kept < 0 and math.isfinite(g) else g), -1
        else:
            v, g, f, kept = w, h, (f / 2 if kept > 0 else f), 1
    return v, False


def _between(a: _Point, b: _Point, share: float) -> Float:
    """Vector at a share of the way from one point to another: Hermite's cubic where both slopes are known."""
    chord, way = b.x - a.x, b.value - a.value
    if a.slope is None or b.slope is None:
        return a.x + share * chord
    start, end = way * a.slope - chord, way * b.slope - chord
    return a.x + share * (chord + (1 - share) * ((1 - share) * start - share * end))


@dataclass(frozen=True, eq=False)
class HeldEntry:
    """Minimum over all entries of the fitted vector but one.

    Attributes:
        problem: the problem.
        entry: number of the entry that is held.
        scale: typical sizes, as for :func:`minimise`.
    """

    problem: Problem
    entry: int
    scale: Float

    def together(self, values: Float, starts: Float, contraction: float = 1.0) -> Minima:
        """See :class:`Held`."""
        free = np.arange(starts.shape[1]) != self.entry
        lower, upper = (np.where(free, bound, values[:, None]) for bound in box(self.problem))

        def step(x: Float, gradient: Float, matrix: Float, members: Index) -> tuple[Float, Float]:
            down, along = _solved(matrix[:, free][:, :, free], -gradient[:, free], -matrix[:, free, self.entry])
            steps, slopes = np.zeros_like(gradient), np.ones_like(gradient)
            steps[:, free], slopes[:, free] = down, along
            return steps, slopes

        return _full_steps(self.problem, starts, lower, upper, step, contraction)

    def alone(self, value: float, start: Float) -> tuple[float, Float, bool]:
        """See :class:`Held`."""
        minima = self.together(np.array([value]), start[None])
        if minima.found[0]:
            return float(minima.cost[0]), minima.x[0], True
        low, high = (bound.copy() for bound in box(self.problem))
        low[self.entry] = high[self.entry] = value
        begin = np.clip(start, low, high)
        if not math.isfinite(self.problem.cost(begin)):
            return math.inf, begin, True
        found = minimise(self.problem, begin, lower=low, upper=high, scale=self.scale, options=_OPTIONS)
        return found.cost, found.x, found.status in (Status.CONVERGED, Status.SINGULAR)


class Condition(Protocol):
    """What holds a derived quantity at a value: an equation between the vector and the value."""

    def __call__(self, x: Float, values: Float) -> tuple[Float, Float, Float]:
        """What the equation misses at vectors of shape ``(W, p)``, and its derivatives by vector and value.

        NaN where the equation does not hold the quantity there.
        """
        ...


@dataclass(frozen=True, eq=False)
class HeldQuantity:
    """Minimum where a derived quantity has a value: Gauss-Newton steps inside the linearised condition.

    The Lagrangian's stationary point of the quadratic model, ``H d = -g + mu c`` with ``c^T d = value - q``, is taken
    until the step, in standard errors, is negligible; bounds of the vector are kept by shortening steps.

    Attributes:
        problem: the problem.
        quantity: the quantity and its gradient.
        condition: the same as an equation for many vectors, where there is one.
    """

    problem: Problem
    quantity: ValueAndGradient
    condition: Condition | None = None

    def together(self, values: Float, starts: Float, contraction: float = 1.0) -> Minima:
        """See :class:`Held`."""
        condition = self.condition
        if condition is None:
            nothing = np.full(values.shape, np.inf)
            found = np.zeros(values.shape, dtype=bool)
            return Minima(cost=nothing, x=starts, slope=np.zeros_like(starts), found=found, contraction=0.0)

        def step(x: Float, gradient: Float, matrix: Float, members: Index) -> tuple[Float, Float]:
            missing, slope, by_value = condition(x, values[members])
            down, turned = _solved(matrix, -gradient, slope)
            turned /= np.einsum("wi,wi->w", slope, turned)[:, None]
            return down + turned * (missing - np.einsum("wi,wi->w", slope, down))[:, None], -turned * by_value[:, None]

        lower, upper = (np.broadcast_to(bound, starts.shape) for bound in box(self.problem))
        return _full_steps(self.problem, starts, lower, upper, step, contraction)

    def alone(self, value: float, start: Float) -> tuple[float, Float, bool]:
        """See :class:`Held`."""
        problem = self.problem
        lower, upper = box(problem)
        x = np.clip(start, lower, upper)
        for _ in range(_SQP_STEPS):
            cost, gradient, matrix = problem.gauss_newton(x)
            q, slope = self.quantity(x)
            if not (math.isfinite(cost) and math.isfinite(q)):
                break
            step = _held_step(gradient, matrix, slope, value - q, lower - x, upper - x)
            with np.errstate(divide="ignore", invalid="ignore"):
                room = np.where(step > 0, (upper - x) / step, np.where(step < 0, (lower - x) / step, np.inf))
            x = np.clip(x + min(1.0, float(room.min())) * step, lower, upper)
            if step @ matrix @ step <= 1e-18 * max(cost, 1.0):
                return problem.cost(x), x, True
        return math.inf, x, False


def _full_steps(
    problem: Problem,
    starts: Float,
    lower: Float,
    upper: Float,
    step: Callable[[Float, Float, Float, Index], tuple[Float, Float]],
    contraction: float,
) -> Minima:
    """Full Gauss-Newton steps of many vectors as long as they shrink: from a neighbour a few of them are enough.

    Args:
        problem: the problem.
        starts: where they begin, shape ``(W, p)``.
        lower, upper: bounds, shape ``(W, p)``.
        step: the step, and the change of the minimum with the value, at some vectors with their gradient, their
            Gauss-Newton matrix and their numbers.
        contraction: of lengths of steps, as far as it is known.
    """
    x = np.clip(starts, lower, upper)
    cost, slope, found = np.full(len(x), np.inf), np.zeros_like(x), np.zeros(len(x), dtype=bool)
    active, before, slowest = np.arange(len(x)), np.full(len(x), np.inf), 0.0
    for _ in range(_FULL_STEPS):
        here = x[active]
        value, gradient, matrix = normal_equations(problem, here)
        way, along = step(here, gradient, matrix, active)
        size = np.einsum("wi,wij,wj->w", way, matrix, way)
        good = np.isfinite(value) & (size <= before[active])
        slowest = max(slowest, float(np.max(size / before[active], where=good, initial=0.0)))
        end = here + way
        inside = np.asarray(((end >= lower[active]) & (end <= upper[active])).all(axis=1))
        last = good & (size <= np.maximum(_FORETOLD / contraction, _CONVERGED * value))
        ended = active[last]
        found[ended], slope[ended] = True, along[last]
        x[ended] = np.where(inside[last, None], end[last], here[last])
        fall = np.einsum("wi,wi->w", gradient[last], way[last]) + size[last] / 2
        cost[ended] = value[last] + np.where(inside[last], fall, 0.0)
        going = good & inside & ~last
        active = active[going]
        if not active.size:
            break
        x[active], before[active] = end[going], size[going]
    return Minima(cost=cost, x=x, slope=slope, found=found, contraction=math.sqrt(slowest))


def _solved(matrix: Float, *sides: Float) -> tuple[Float, ...]:
    """Solutions for positive matrices of shape ``(W, k, k)`` and right sides ``(W, k)``; NaN where there is none."""
    size = np.sqrt(np.maximum(np.diagonal(matrix, axis1=1, axis2=2), 0.0))
    usable = np.asarray(np.isfinite(matrix).all(axis=(1, 2)) & (size > 0).all(axis=1))
    size = np.where(usable[:, None], size, 1.0)
    unit = np.where(usable[:, None, None], matrix / (size[:, :, None] * size[:, None, :]), np.eye(matrix.shape[1]))
    right = np.stack(sides, axis=-1) / size[..., None]
    right[~usable] = np.nan
    try:
        found = np.linalg.solve(unit, right)
    except np.linalg.LinAlgError:  # one of them at least
        found = np.full_like(right, np.nan)
        for i, (one, side) in enumerate(zip(unit, right, strict=True)):
            with suppress(np.linalg.LinAlgError):
                found[i] = np.linalg.solve(one, side)
    return tuple(found[..., i] / size for i in range(len(sides)))


def _held_step(gradient: Float, matrix: Float, slope: Float, missing: float, low: Float, high: Float) -> Float:
    """Step to the minimum of the quadratic model where the quantity changes by what is missing.

    Entries that rest on a bound and would leave it stay where they are.
    """
    free = np.ones(gradient.size, dtype=bool)
    step = np.zeros_like(gradient)
    while free.any():
        g, c, part = gradient[free], slope[free], matrix[np.ix_(free, free)]
        size = np.sqrt(np.maximum(np.diag(part), 1e-300))
        inverse = np.linalg.pinv(part / np.outer(size, size), rcond=1e-14, hermitian=True) / np.outer(size, size)
        turned, down = inverse @ c, -inverse @ g
        step[:] = 0.0
        step[free] = down + turned * ((missing - c @ down) / (c @ turned))
        leaving = ((step < 0) & (low >= 0)) | ((step > 0) & (high <= 0))
        if not leaving.any():
            break
        free &= ~leaving
    return step


def limits(low: float, high: float, value: float, size: float, step: float) -> tuple[tuple[float, bool], ...]:
    """How far a quantity is followed downwards and upwards, and whether a bound stands there."""
    reach = _REACH * max(size, abs(value), step)
    return (low, True) if low >= value - reach else (value - reach, False), (high, True) if high <= value + reach else (
        value + reach,
        False,
    )
