"""Profile likelihood: the misfit as a function of one quantity, everything else at its best for each value of it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from rotorfit.estimators.inference.log_posterior import box
from rotorfit.estimators.minimisation.least_squares import Options, Status, minimise
from rotorfit.estimators.misfit.problem import Problem
from rotorfit.models.array_types import Float, Index

ValueAndGradient = Callable[[Float], tuple[float, Float]]
"""Value of a quantity and its gradient, shape ``(p,)``, at a fitted vector."""

_ROOT = 1e-9  # relative error of the ends, in half-widths
_STEPS = 60  # evaluations for an end at most
_REACH = 100.0  # sizes of a parameter beyond which an end that was not met counts as open
_SQP_STEPS = 40
_OPTIONS = Options(max_iterations=60, hessian="gauss-newton")
_FULL_STEPS = 15
_CONVERGED = 1e-16  # squared step that remains, in standard errors, against chi-squared


class Held(Protocol):
    """The minimum over everything else with one quantity held at a value."""

    def __call__(self, value: float, start: Float) -> tuple[float, Float, bool]:
        """Cost and vector at that minimum, from a start nearby, and whether it is one to full precision.

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
        self._direction = direction
        self._points: list[tuple[float, Float, float]] = [(value, x, 0.0)]
        self.unsettled = 0

    @property
    def lowest(self) -> float:
        """Least rise met, below zero if the minimum given was not the lowest."""
        return min(rise for _, _, rise in self._points)

    def __call__(self, value: float) -> float:
        """Rise at a value of the quantity."""
        for known, _, rise in self._points:
            if known == value:
                return rise
        cost, x, settled = self._held(value, self._predict(value))
        self.unsettled += not settled
        rise = 2 * (cost - self._cost) if math.isfinite(cost) else math.inf
        if math.isfinite(rise):
            self._points.append((value, x, rise))
        return rise

    def _predict(self, value: float) -> Float:
        near = sorted(self._points, key=lambda point: abs(point[0] - value))[:2]
        v, x, _ = near[0]
        if len(near) == 1:
            return x + (value - v) * self._direction
        other, y, _ = near[1]
        return x + (value - v) / (other - v) * (y - x)

    def end(self, side: int, level: float, step: float, limit: float, at_bound: bool) -> End:
        """Follow the curve to one side until it has risen to a level.

        The signed root of the rise is nearly a straight line, so its zero is soon found.

        Args:
            side: -1 for the lower end, 1 for the upper.
            level: rise asked for.
            step: where the end is guessed to be, from the minimum.
            limit: how far to go, a value of the quantity.
            at_bound: whether the limit is a bound.
        """
        centre, goal = self._points[0][0], math.sqrt(level)
        reach = abs(limit - centre)
        inner, low = 0.0, -goal
        outer, high, count = min(step, reach), -goal, 0
        while count < _STEPS:
            count += 1
            high = self._root(centre + side * outer, limit, outer == reach) - goal
            if outer == reach and at_bound and not math.isfinite(high):  # round-off at the edge of a prior
                limit = centre + side * (1 - 1e-9) * reach
                outer = reach = abs(limit - centre)
                high = self._root(limit, limit, True) - goal
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
        distance, exact = self._solve(centre, side, (inner, low), (outer, high), goal, _STEPS - count)
        return End(value=centre + side * distance, limit=limit, rise=level, at_bound=False, exact=exact)

    def _root(self, value: float, limit: float, at_limit: bool) -> float:
        return math.sqrt(max(self(limit if at_limit else value), 0.0))

    def _solve(
        self, centre: float, side: int, a: tuple[float, float], b: tuple[float, float], goal: float, steps: int
    ) -> tuple[float, bool]:
        """Zero of root minus goal between two distances: false position, the end that stays halved (Illinois)."""
        (u, f), (v, g), kept = a, b, 0
        for _ in range(steps):
            if g == 0:
                return v, True
            # halved where nothing fits on the far side
            w = v - g * (v - u) / (g - f) if math.isfinite(g) else (u + v) / 2
            h = self._root(centre + side * w, 0.0, False) - goal
            if abs(h) <= _ROOT * goal or abs(v - u) <= _ROOT * abs(v):
                return w, True
            if (h < 0) == (f < 0):
                u, f, g, kept = w, h, (g / 2 if kept < 0 and math.isfinite(g) else g), -1
            else:
                v, g, f, kept = w, h, (f / 2 if kept > 0 else f), 1
        return v, False


def hold_entry(problem: Problem, entry: int, scale: Float) -> Held:
    """Minimum over all entries of the fitted vector but one; arguments of :func:`minimise` otherwise."""
    lower, upper = box(problem)

    def held(value: float, start: Float) -> tuple[float, Float, bool]:
        low, high = lower.copy(), upper.copy()
        low[entry] = high[entry] = value
        begin = np.clip(start, low, high)
        cost, polished = _polish(problem, np.delete(np.arange(begin.size), entry), begin, low, high)
        if cost is not None:
            return cost, polished, True
        if not math.isfinite(problem.cost(begin)):
            return math.inf, begin, True
        begin = polished
        found = minimise(problem, begin, lower=low, upper=high, scale=scale, options=_OPTIONS)
        return found.cost, found.x, found.status in (Status.CONVERGED, Status.SINGULAR)

    return held


def _polish(problem: Problem, free: Index, x: Float, low: Float, high: Float) -> tuple[float | None, Float]:
    """Full Gauss-Newton steps as long as they descend: from a neighbour a few of them are enough.

    Returns:
        cost and vector at the minimum; no cost if the steps met a bound or an ascent and Ipopt has to go on.
    """
    best, before = x, math.inf
    for _ in range(_FULL_STEPS):
        cost, gradient, matrix = problem.gauss_newton(x)
        if not cost <= before * (1 + 1e-12):
            return None, best
        best, before = x, cost
        slope, curvature = gradient[free], matrix[np.ix_(free, free)]
        size = np.sqrt(np.diag(curvature))
        if not (np.isfinite(size).all() and (size > 0).all()):
            return None, best
        try:
            step = -np.linalg.solve(curvature / np.outer(size, size), slope / size) / size
        except np.linalg.LinAlgError:
            return None, best
        if -slope @ step <= _CONVERGED * max(cost, 1.0):
            return cost, x
        x = x.copy()
        x[free] += step
        if not ((x >= low) & (x <= high)).all():
            return None, best
    return None, best


def hold_quantity(problem: Problem, quantity: ValueAndGradient) -> Held:
    """Minimum where a derived quantity has a value: Gauss-Newton steps inside the linearised condition.

    The Lagrangian's stationary point of the quadratic model, ``H d = -g + mu c`` with ``c^T d = value - q``, is taken
    until the step, in standard errors, is negligible; bounds of the vector are kept by shortening steps.
    """
    lower, upper = box(problem)

    def held(value: float, start: Float) -> tuple[float, Float, bool]:
        x = np.clip(start, lower, upper)
        for _ in range(_SQP_STEPS):
            cost, gradient, matrix = problem.gauss_newton(x)
            q, slope = quantity(x)
            if not (math.isfinite(cost) and math.isfinite(q)):
                break
            step = _held_step(gradient, matrix, slope, value - q, lower - x, upper - x)
            with np.errstate(divide="ignore", invalid="ignore"):
                room = np.where(step > 0, (upper - x) / step, np.where(step < 0, (lower - x) / step, np.inf))
            x = np.clip(x + min(1.0, float(room.min())) * step, lower, upper)
            if step @ matrix @ step <= 1e-18 * max(cost, 1.0):
                return problem.cost(x), x, True
        return math.inf, x, False

    return held


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
