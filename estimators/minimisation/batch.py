"""Many fits at once: the same model and lines, another set of readings for each (bootstrap, campaigns, simulations).

Readings that differ by noise alone leave the Gauss-Newton matrix almost unchanged. One factorisation therefore
serves all members, and each iteration costs one exact gradient, which the adjoint of the response gives for about two
evaluations of the misfit. Convergence is linear with a small factor.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from rotorfit.base.array_types import Bool, ComplexArray, Float, Index
from rotorfit.estimators.minimisation.least_squares import Options, Status, minimise
from rotorfit.estimators.misfit.kernels import Batch
from rotorfit.estimators.misfit.problem import Problem

STEP_TOLERANCE = 1e-8
"""Remaining step, in standard errors, at which a member has converged."""
_DEFAULTS = Options()


@dataclass(frozen=True, eq=False)
class BatchFit:
    """Optima of many data sets."""

    x: Float  # fitted vectors, shape ``(B, p)``
    cost: Float  # half the (robust) sum of squares plus minus the log prior, shape ``(B,)``
    converged: Bool  # whether each member is at a minimum, shape ``(B,)``
    alone: Bool  # members that were handed to Ipopt one by one (at a bound, slow, or not normal), shape ``(B,)``


def with_measured(problem: Problem, measured: ComplexArray) -> Problem:
    """The same problem with other readings; the orbit that a nonlinear rotor is taken to run on stays the same."""
    parts = zip(problem.blocks, problem.by_block(measured), strict=True)
    return replace(problem, blocks=tuple(block.with_measured(own) for block, own in parts))


def batch_fit(
    problem: Problem,
    measured: ComplexArray,
    start: ArrayLike,
    *,
    accelerate: bool | None = None,
    options: Options = _DEFAULTS,
) -> BatchFit:
    """Fit many sets of readings of one problem."""
    first = np.broadcast_to(np.asarray(start, dtype=float), (len(measured), problem.space.size))
    first = np.clip(first, problem.space.lower, problem.space.upper)
    x = first.copy()
    cost, converged = np.full(len(x), np.inf), np.zeros(len(x), dtype=bool)
    if all(block.normal for block in problem.blocks):  # others fit numbers of their own to every set of readings
        x, cost, converged = _together(problem, measured, first, accelerate)
    alone = ~converged
    for b in np.flatnonzero(alone).tolist():
        own = with_measured(problem, measured[b])
        begin = x[b] if np.isfinite(cost[b]) else first[b]
        found = minimise(own, begin, lower=problem.space.lower, upper=problem.space.upper, options=options)
        x[b], cost[b] = found.x, found.cost
        converged[b] = found.success or found.status is Status.SINGULAR  # a minimum along a whole line is one
    return BatchFit(x, cost, converged, alone)


def _together(problem: Problem, measured: ComplexArray, x: Float, accelerate: bool | None) -> tuple[Float, Float, Bool]:
    """Where steps of all members together end, their costs, and which of them have converged."""
    evaluations = 5  # a member's gradients until it has converged, typically
    batch = Batch(problem, accelerate=accelerate, work=evaluations * len(measured), gradients=True)
    with np.errstate(all="ignore"):  # a trial point may well be absurd
        end = _Descent(problem, x.copy(), batch.of_readings(measured))
    return end.x, end.cost, end.converged


class _Descent:
    """Damped Gauss-Newton steps of all members together, by one matrix."""

    def __init__(self, problem: Problem, x: Float, evaluate: Callable[[Float, Index], tuple[Float, Float]]) -> None:
        self.x, self.evaluate, space = x, evaluate, problem.space
        matrix = problem.gauss_newton(np.clip(x.mean(axis=0), space.lower, space.upper))[2]
        size = np.sqrt(np.diag(matrix))
        size = np.where(size > 0, size, 1.0)
        power, basis = np.linalg.eigh(matrix / np.outer(size, size))
        self._power, self._basis = np.maximum(power, 1e-14 * power[-1]), basis / size[:, None]
        self.cost, self.gradient = evaluate(x, np.arange(len(x)))
        self.damping = np.zeros(len(x))
        self.step, self.remaining = self._steps(self.gradient, self.damping)
        self.converged = self.remaining < STEP_TOLERANCE
        active = np.flatnonzero(~self.converged & np.isfinite(self.cost))
        for _ in range(60):
            if not active.size:
                break
            trial = self.x[active] + self.step[active]
            inside = ((trial > space.lower) & (trial < space.upper)).all(axis=1)
            active, trial = active[inside], trial[inside]  # the others meet a bound: Ipopt's task
            self._advance(active, trial)
            active = active[~self.converged[active] & (self.damping[active] < 1e12)]

    def _steps(self, gradient: Float, damping: Float) -> tuple[Float, Float]:
        """Damped steps downhill and the undamped remaining step in standard errors."""
        along = gradient @ self._basis
        step = -(along / (self._power + damping[:, None])) @ self._basis.T
        return step, np.sqrt((along**2 / self._power).sum(axis=1))

    def _advance(self, active: Index, trial: Float) -> None:
        """Take the steps that do not climb, damp the others."""
        cost, gradient = self.evaluate(trial, active)
        _, remaining = self._steps(gradient, np.zeros(active.size))
        before, damping = self.remaining[active], self.damping[active]
        # Below round-off of the cost, the gradient decides.
        close = before**2 < 1e-9 * np.maximum(self.cost[active], 1.0)
        good = np.where(close, remaining < before, cost <= self.cost[active])
        round_off = 1e-5  # remaining step at which failure to shrink further is round-off
        settled = ~good & close & (before < round_off)
        taken = active[good]
        self.x[taken], self.cost[taken], self.gradient[taken] = trial[good], cost[good], gradient[good]
        smaller, larger = np.where(damping < 1e-4, 0.0, damping / 10), np.maximum(10 * damping, 1e-3)
        self.damping[active] = np.where(good, smaller, larger)
        self.converged[active] = np.where(good, remaining < STEP_TOLERANCE, settled)
        self.step[active], self.remaining[active] = self._steps(self.gradient[active], self.damping[active])
