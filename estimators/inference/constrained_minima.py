"""The minimum over everything else with one quantity held at a value, for many quantities and values at once."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from rotorfit.base.array_types import Bool, Float, Index
from rotorfit.estimators.inference.joint_errors import nearest_of_one_sign
from rotorfit.estimators.inference.log_posterior import box
from rotorfit.estimators.minimisation.least_squares import Options, Status, minimise
from rotorfit.estimators.misfit.problem import Normal, Problem
from rotorfit.estimators.misfit.ratios import LogRatioProblem

if TYPE_CHECKING:
    from rotorfit.estimators.inference.caused_problem import CausedProblem

ValueAndGradient = Callable[[Float], tuple[float, Float]]
"""Value of a quantity and its gradient, shape ``(p,)``, at a fitted vector."""

Condition = Callable[[Float, Float], tuple[Float, Float, Float]]
"""Equation of vectors ``(W, p)`` and values that holds a derived quantity: its residual, NaN where it has none, and
its slopes by vector and value."""

_ENOUGH = 1e-8
"""Squared step, in standard errors, at which a minimum beside causes is found."""
_OPTIONS = Options(max_iterations=60, hessian="gauss-newton")


@dataclass(frozen=True, eq=False, kw_only=True)
class Minima:
    """Minima over everything else with a quantity held at some values."""

    cost: Float  # at each minimum, shape ``(W,)``
    x: Float  # place of each minimum, shape ``(W, p)``
    slope: Float  # change of the minimum for a change of the value by one, shape ``(W, p)``
    found: Bool  # whether full steps led there; the others have to be searched by themselves, shape ``(W,)``
    contraction: Float  # largest length of a step over that of the one before, shape ``(W,)``; zero where there was one


@dataclass(frozen=True, eq=False)
class EntryConstraint:
    """Minimum over all entries of the fitted vector, or all coordinates in its place, but one."""

    problem: Problem | CausedProblem | LogRatioProblem  # the problem, or the same in other coordinates
    scale: Float  # typical sizes, as for :func:`minimise`

    def together(self, entries: Index, values: Float, starts: Float, contraction: Float) -> Minima:
        """Minima of many, where full steps lead there."""
        held = np.arange(starts.shape[1]) == entries[:, None]
        lower, upper = (np.where(held, values[:, None], bound) for bound in self.bounds)
        signs = one_sided(self.problem)

        def step(x: Float, gradient: Float, matrix: Float, members: Index) -> tuple[Float, Float]:
            still = held[members]
            aside = np.where(still, 0.0, np.take_along_axis(matrix, entries[members, None, None], axis=2)[..., 0])
            others = np.where(still[:, :, None] | still[:, None, :], still[:, :, None] & still[:, None, :], matrix)
            down, along = solved(others, np.where(still, 0.0, -gradient), np.where(still, 1.0, -aside))
            return kept_of_one_sign(signs, others, x, down, along)

        if signs is not None:
            return damped_steps(lambda x, _: self.problem.evaluate(x), starts, lower, upper, step, _ENOUGH)
        return full_steps(lambda x, _: self.problem.evaluate(x), starts, lower, upper, step, contraction)

    @property
    def bounds(self) -> tuple[Float, Float]:
        """Bounds, of fitted vectors narrowed to where the priors are not zero, shapes ``(p,)``."""
        if isinstance(self.problem, LogRatioProblem):
            return self.problem.ratios.bounds(self.problem.problem.space)
        return bounds_of(self.problem)

    def alone(self, entry: int, value: float, start: Float) -> tuple[float, Float, bool]:
        """Cost, infinite where there is nothing, and vector at the minimum for one value, and whether it is exact."""
        minima = self.together(np.array([entry]), np.array([value]), start[None], np.ones(1))
        if minima.found[0]:
            return float(minima.cost[0]), minima.x[0], True
        low, high = (bound.copy() for bound in self.bounds)
        low[entry] = high[entry] = value
        begin = minima.x[0]  # as far as full steps led
        if not math.isfinite(self.problem.cost(begin)):
            return math.inf, begin, True
        found = minimise(self.problem, begin, lower=low, upper=high, scale=self.scale, options=_OPTIONS)
        return found.cost, found.x, found.status in (Status.CONVERGED, Status.SINGULAR)


@dataclass(frozen=True, eq=False)
class QuantityConstraint:
    """Minimum where a derived quantity has a value: Gauss-Newton steps inside the linearised condition. The
    Lagrangian's stationary point of the quadratic model, ``H d = -g + mu c`` with ``c^T d = value - q``, is taken until
    the step, in standard errors, is negligible; bounds of the vector are kept by shortening steps."""

    problem: Problem | CausedProblem  # the problem
    quantity: ValueAndGradient  # the quantity and its gradient
    condition: Condition | None = None  # the same as an equation for many vectors, where there is one

    def together(self, entries: Index, values: Float, starts: Float, contraction: Float) -> Minima:
        """See :class:`EntryConstraint`."""
        condition = self.condition
        signs = one_sided(self.problem)
        if condition is None:
            none = np.zeros(values.size)
            return Minima(cost=none, x=starts, slope=np.zeros_like(starts), found=none > 0, contraction=none)

        def step(x: Float, gradient: Float, matrix: Float, members: Index) -> tuple[Float, Float]:
            missing, slope, by_value = condition(x, values[members])
            down, turned = solved(matrix, -gradient, slope)
            with np.errstate(all="ignore"):  # of what does not move with the vector nothing is found
                turned /= np.einsum("wi,wi->w", slope, turned)[:, None]
            down = down + turned * (missing - np.einsum("wi,wi->w", slope, down))[:, None]
            return kept_of_one_sign(signs, matrix, x, down, -turned * by_value[:, None], slope)

        lower, upper = (np.broadcast_to(bound, starts.shape) for bound in bounds_of(self.problem))
        if signs is not None:
            return damped_steps(partial(self._penalised, condition, values), starts, lower, upper, step, _ENOUGH)
        return full_steps(lambda x, _: self.problem.evaluate(x), starts, lower, upper, step, contraction)

    def _penalised(self, condition: Condition, values: Float, x: Float, members: Index) -> Normal:
        """Cost with gradient and matrix of vectors, and beside the cost what they miss the condition by."""
        cost, gradient, matrix = self.problem.evaluate(x)
        missing, slope, _ = condition(x, values[members])
        (turned,) = solved(matrix, slope)
        weight = 1e3  # of the square of what is missed, in standard errors
        return cost + weight * missing**2 / np.einsum("wi,wi->w", slope, turned), gradient, matrix

    def alone(self, entry: int, value: float, start: Float) -> tuple[float, Float, bool]:
        """See :class:`EntryConstraint`."""
        problem = self.problem
        lower, upper = bounds_of(problem)
        x = np.clip(start, lower, upper)
        before = math.inf
        stretch = 20  # steps after which the squared step must have come down to a hundredth, else it leads nowhere
        for number in range(200):
            with np.errstate(all="ignore"):  # a step may well lead astray, where there is no cost or no quantity
                cost, gradient, matrix = problem.gauss_newton(x)
                if not math.isfinite(cost):
                    break
                q, slope = self.quantity(x)
            if not math.isfinite(q):
                break
            step = _held_step(gradient, matrix, slope, value - q, lower - x, upper - x)
            with np.errstate(divide="ignore", invalid="ignore"):
                room = np.where(step > 0, (upper - x) / step, np.where(step < 0, (lower - x) / step, np.inf))
            x = np.clip(x + min(1.0, float(room.min())) * step, lower, upper)
            size = float(step @ matrix @ step)
            if size <= 1e-18 * max(cost, 1.0):
                return problem.cost(x), x, True
            if number % stretch == stretch - 1:
                if size > 0.01 * before:
                    break
                before = size
        return math.inf, x, False


Constraint: TypeAlias = EntryConstraint | QuantityConstraint
"""The minimum over everything else with one quantity held at a value."""


def full_steps(
    normal: Callable[[Float, Index], Normal],
    starts: Float,
    lower: Float,
    upper: Float,
    step: Callable[[Float, Float, Float, Index], tuple[Float, Float]],
    contraction: Float,
) -> Minima:
    """Full Gauss-Newton steps of many vectors as long as they shrink: from a neighbour a few of them are enough."""
    x = np.clip(starts, lower, upper)
    cost, slope, found = np.full(len(x), np.inf), np.zeros_like(x), np.zeros(len(x), dtype=bool)
    active, before, slowest = np.arange(len(x)), np.full(len(x), np.inf), np.zeros(len(x))
    step_tolerance = 1e-16  # squared step that remains, in standard errors, against chi-squared
    # Error of the cost that the quadratic model of a last step may have. It misses the share of the step's square, in
    # standard errors, by which Gauss-Newton steps contract.
    cost_tolerance = 1e-9
    for _ in range(15):
        here = x[active]
        value, gradient, matrix = normal(here, active)
        way, along = step(here, gradient, matrix, active)
        size = np.einsum("wi,wij,wj->w", way, matrix, way)
        good = np.isfinite(value) & (size <= before[active])
        slowest[active] = np.where(good, np.maximum(slowest[active], size / before[active]), slowest[active])
        end = here + way
        inside = np.asarray(((end >= lower[active]) & (end <= upper[active])).all(axis=1))
        last = good & (size <= np.maximum(cost_tolerance / contraction[active], step_tolerance * value))
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
    return Minima(cost=cost, x=x, slope=slope, found=found, contraction=np.sqrt(slowest))


def damped_steps(
    normal: Callable[[Float, Index], Normal],
    starts: Float,
    lower: Float,
    upper: Float,
    step: Callable[[Float, Float, Float, Index], tuple[Float, Float]],
    enough: float,
) -> Minima:
    """Gauss-Newton steps of many vectors, or shares of them, that lower the cost, until what remains, squared and in
    standard errors, is small ``enough``: where values follow far along what they and causes can both take up."""
    x, share, along = np.clip(starts, lower, upper), np.ones(len(starts)), np.zeros_like(starts)
    found, active, shortest = np.zeros(len(x), dtype=bool), np.arange(len(x)), 1e-4
    with np.errstate(all="ignore"):  # a trial point may well be absurd
        cost, gradient, matrix = normal(x, active)
        left = np.zeros(len(x))  # by which the quadratic model would fall on
        for _ in range(100):
            way, along[active] = step(x[active], gradient[active], matrix[active], active)
            size = np.einsum("wi,wij,wj->w", way, matrix[active], way)
            found[active] = size <= enough
            left[active] = np.where(found[active], np.einsum("wi,wi->w", gradient[active], way) + size / 2, 0.0)
            going = (size > enough) & (share[active] > shortest)
            active, way = active[going], way[going]
            if not active.size:
                break
            trial = np.clip(x[active] + share[active, None] * way, lower[active], upper[active])
            ahead = normal(trial, active)
            falls = ahead[0] < cost[active]
            taken = active[falls]
            x[taken] = trial[falls]
            for kept, part in zip((cost, gradient, matrix), ahead, strict=True):
                kept[taken] = part[falls]
            share[active] = np.where(falls, np.minimum(4 * share[active], 1.0), share[active] / 4)
    return Minima(cost=cost + left, x=x, slope=along, found=found, contraction=np.zeros(len(x)))


def bounds_of(problem: Problem | CausedProblem) -> tuple[Float, Float]:
    """Bounds of vectors, narrowed to where the priors are not zero."""
    return box(problem) if isinstance(problem, Problem) else problem.bounds


def one_sided(problem: Problem | CausedProblem | LogRatioProblem) -> Bool | None:
    """Entries that are sizes of causes of one sign, where there are any."""
    return None if isinstance(problem, Problem | LogRatioProblem) else problem.one_sided


def kept_of_one_sign(
    signs: Bool | None, matrix: Float, x: Float, down: Float, along: Float, slope: Float | None = None
) -> tuple[Float, Float]:
    """Steps, and changes of minima, that leave no entry of one sign below zero: to the optimum of the quadratic model
    with these entries at zero, where ``slope`` times the step is as it was."""
    if signs is None:
        return down, along
    with np.errstate(invalid="ignore"):
        below = ((x + down)[:, signs] < 0).any(axis=1) & np.isfinite(down).all(axis=1)
    down, along = down.copy(), along.copy()
    for member in np.flatnonzero(below).tolist():
        size = np.sqrt(np.diag(matrix[member]))
        covar = np.linalg.inv(matrix[member] / np.outer(size, size)) / np.outer(size, size)
        if slope is not None:
            turned = covar @ slope[member]
            covar = covar - np.outer(turned, turned) / (slope[member] @ turned)
        if not (np.isfinite(covar).all() and (covar.diagonal() > 0).all()):  # an absurd point, which the cost refuses
            continue
        end = nearest_of_one_sign(x[member] + down[member], covar, signs)
        down[member] = end - x[member]
        at = np.flatnonzero(signs & (end == 0))
        along[member] -= covar[:, at] @ np.linalg.solve(covar[np.ix_(at, at)], along[member][at])
        along[member][at] = 0.0
    return down, along


def solved(matrix: Float, *sides: Float) -> tuple[Float, ...]:
    """Solutions for positive matrices of shape ``(W, k, k)`` and right sides ``(W, k)``; NaN where there is none."""
    size = np.sqrt(np.maximum(np.diagonal(matrix, axis1=1, axis2=2), 0.0))
    usable = np.asarray(np.isfinite(matrix).all(axis=(1, 2)) & (size > 0).all(axis=1))
    size = np.where(usable[:, None], size, 1.0)
    unit = np.where(usable[:, None, None], matrix / (size[:, :, None] * size[:, None, :]), np.eye(matrix.shape[1]))
    right = np.stack(sides, axis=-1) / size[..., None]
    right[~usable] = np.nan
    try:
        found = np.linalg.solve(unit, right)
    except np.linalg.LinAlgError:  # one of them at least: each is searched by itself
        found = np.full_like(right, np.nan)
    return tuple(found[..., i] / size for i in range(len(sides)))


def _held_step(gradient: Float, matrix: Float, slope: Float, missing: float, low: Float, high: Float) -> Float:
    """Step to the minimum of the quadratic model where the quantity changes by what is missing."""
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
