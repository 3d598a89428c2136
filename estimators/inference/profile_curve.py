"""Profile likelihood: the misfit as a function of one quantity, everything else at its best for each value of it.

Points of the curves are found together: both ends of all intervals are searched side by side, and then the whole curves
at once, each point from the polynomial through its neighbours and their slopes, which is so near that one or two steps
do.
"""

from __future__ import annotations

import math
from collections.abc import Generator, Sequence
from dataclasses import dataclass

import numpy as np

from rotorfit.base.array_types import Float
from rotorfit.estimators.inference.constrained_minima import Constraint


@dataclass(frozen=True, kw_only=True)
class End:
    """One end of an interval."""

    value: float  # where the curve meets the level; infinite if it does not
    limit: float  # how far it was followed
    rise: float  # rise of the curve at the end, or at the limit
    at_bound: bool  # the limit is a bound
    exact: bool  # whether the end was found to full precision


@dataclass(frozen=True, eq=False)
class _Point:
    value: float
    x: Float
    rise: float
    slope: Float  # NaN where it is not known


Search = Generator[float, float, End]
"""Asks for the rise at a value, gets it, and so on, until it knows the end."""


class Curve:
    """Twice the rise of the cost above its minimum, every point found from its neighbours."""

    def __init__(self, held: Constraint, value: float, x: Float, cost: float, direction: Float, entry: int = 0) -> None:
        self.held, self.entry, self._cost = held, entry, cost
        self._points = [_Point(value, x, 0.0, direction)]
        self.rises = {value: 0.0}  # where they have been found, infinite where there is no minimum
        self.contraction = 0.0  # of lengths of steps, the largest met
        self.unsettled = 0

    @property
    def lowest(self) -> float:
        """Least rise met, below zero if the minimum given was not the lowest."""
        return min(point.rise for point in self._points)

    def keep(self, value: float, cost: float, x: Float, slope: Float) -> None:
        """Keep a point that was found."""
        self.rises[value] = rise = 2 * (cost - self._cost)
        if math.isfinite(rise):
            self._points.append(_Point(value, x, rise, slope))

    def predict(self, values: Sequence[float]) -> Float:
        """Vectors at values, shape ``(W, p)``: Hermite's cubic where slopes are known, else a straight line. It goes
        through the nearest point and the nearest one at least as far from that as the value is."""
        known, wanted = np.array([point.value for point in self._points]), np.array(values)
        x, slope = (np.array(part) for part in zip(*((point.x, point.slope) for point in self._points), strict=True))
        off = np.abs(wanted[:, None] - known)
        near = off.argmin(axis=1)
        way = wanted - known[near]
        off[np.abs(known - known[near, None]) < np.abs(way)[:, None]] = np.inf
        off[np.arange(wanted.size), near] = np.inf
        other = off.argmin(axis=1)
        lone = np.isinf(off[np.arange(wanted.size), other])
        between = np.where(lone, 1.0, known[other] - known[near])[:, None]
        share, chord = way[:, None] / between, x[other] - x[near]
        start, end = between * slope[near] - chord, between * slope[other] - chord
        bend = (1 - share) * ((1 - share) * start - share * end)
        straight = np.where(lone[:, None], np.nan_to_num(slope[near]), chord / between)
        curved = np.where(lone[:, None], 0.0, share * np.nan_to_num(bend))
        return np.asarray(x[near] + way[:, None] * straight + curved)

    def search(self, side: int, level: float, step: float, limit: float, at_bound: bool) -> Search:
        """Follow the curve to one side until it has risen to a level."""
        centre, goal = self._points[0].value, math.sqrt(level)
        reach = abs(limit - centre)
        inner, low = 0.0, -goal
        outer, high, count = min(step, reach), -goal, 0
        most = 60  # evaluations for an end at most
        close = 1.1  # level over a first guess up to which a step beyond the line's zero will do
        while count < most:
            count += 1
            high = _root((yield limit if outer == reach else centre + side * outer)) - goal
            if outer == reach and at_bound and not math.isfinite(high):  # round-off at the edge of a prior
                limit = centre + side * (1 - 1e-9) * reach
                outer = reach = abs(limit - centre)
                high = _root((yield limit)) - goal
            if high >= 0 or outer == reach:
                break
            ratio = goal / (high + goal) if high > -goal else math.inf
            grown = outer * min(max(1.1 * ratio, 1.3), 4.0)
            if count == 1 and ratio < close:  # the first guess is mostly short by little
                grown = outer * (1.5 * ratio - 0.5)
            inner, low, outer = outer, high, min(grown, reach)
        if high < 0:
            return End(
                value=side * math.inf,
                limit=limit,
                rise=(high + goal) ** 2,
                at_bound=at_bound and outer == reach,
                exact=True,
            )
        distance, left, exact = yield from _solve(centre, side, (inner, low), (outer, high), goal, most - count)
        end, rise = centre + side * distance, (left + goal) ** 2
        least_rise = 0.99  # rise over the level, short of which it is not met
        if rise < least_rise * level:  # the curve ends before
            return End(value=side * math.inf, limit=end, rise=rise, at_bound=False, exact=False)
        return End(value=end, limit=limit, rise=rise, at_bound=False, exact=exact)


def find_rises(curves: Sequence[Curve], values: Sequence[Sequence[float]]) -> None:
    """Find the rises of curves at some values each; those that full steps do not reach are followed in their order."""
    pairs = zip(curves, values, strict=True)
    unknown = [(curve, [value for value in dict.fromkeys(some) if value not in curve.rises]) for curve, some in pairs]
    for held in dict.fromkeys(curve.held for curve, some in unknown if some):
        mine = [(curve, some) for curve, some in unknown if some and curve.held is held]
        each = [(curve, value) for curve, some in mine for value in some]
        minima = held.together(
            np.array([curve.entry for curve, _ in each]),
            np.array([value for _, value in each]),
            np.concatenate([curve.predict(some) for curve, some in mine]),
            np.array([curve.contraction or 1.0 for curve, _ in each]),
        )
        for number in np.flatnonzero(minima.found).tolist():
            curve, value = each[number]
            curve.keep(value, float(minima.cost[number]), minima.x[number], minima.slope[number])
            curve.contraction = max(curve.contraction, float(minima.contraction[number]))
        for number in np.flatnonzero(~minima.found).tolist():
            curve, value = each[number]
            cost, x, settled = held.alone(curve.entry, value, curve.predict([value])[0])
            curve.unsettled += not settled
            curve.keep(value, cost, x, np.full_like(x, np.nan))


def find_ends(curves: Sequence[Curve], searches: Sequence[tuple[Search, ...]]) -> list[list[End]]:
    """Ends that searches of each curve find, side by side."""
    ends: list[dict[int, End]] = [{} for _ in curves]
    asked = [{place: next(search) for place, search in enumerate(own)} for own in searches]
    while any(asked):
        find_rises(curves, [list(waiting.values()) for waiting in asked])
        for curve, own, waiting, found in zip(curves, searches, asked, ends, strict=True):
            for place, value in tuple(waiting.items()):
                try:
                    waiting[place] = own[place].send(curve.rises[value])
                except StopIteration as last:
                    found[place] = last.value
                    del waiting[place]
    return [[found[place] for place in sorted(found)] for found in ends]


def _root(rise: float) -> float:
    return math.sqrt(max(rise, 0.0))


def _solve(
    centre: float, side: int, a: tuple[float, float], b: tuple[float, float], goal: float, steps: int
) -> Generator[float, float, tuple[float, float, bool]]:
    """Zero of root minus goal between two distances: false position, the end that stays halved (Illinois). Returns the
    distance, what is left of root minus goal there, and whether it is the zero: where the curve ends short of the goal,
    as no minimum is found beyond, it is the last place before that."""
    (u, f), (v, g), kept = a, b, 0
    short = f  # root minus goal at u, which f is not where it was halved
    end_tolerance = 1e-9  # relative error of the ends, in half-widths
    for _ in range(steps):
        if g == 0:
            return v, g, True
        # halved where nothing fits on the far side
        w = v - g * (v - u) / (g - f) if math.isfinite(g) else (u + v) / 2
        h = _root((yield centre + side * w)) - goal
        if abs(h) <= end_tolerance * goal:
            return w, h, True
        if abs(v - u) <= end_tolerance * abs(v):
            return (w, h, True) if math.isfinite(g) else (u, short, False)
        if (h < 0) == (f < 0):
            u, f, short, g, kept = w, h, h, (g / 2 if kept < 0 and math.isfinite(g) else g), -1
        else:
            v, g, f, kept = w, h, (f / 2 if kept > 0 else f), 1
    return v, g, False


def limits(low: float, high: float, value: float, size: float, step: float) -> tuple[tuple[float, bool], ...]:
    """How far a quantity is followed downwards and upwards, and whether a bound stands there."""
    sizes = 100.0  # sizes of a parameter beyond which an end that was not met counts as open
    reach = sizes * max(size, abs(value), step)
    return (low, True) if low >= value - reach else (value - reach, False), (high, True) if high <= value + reach else (
        value + reach,
        False,
    )
