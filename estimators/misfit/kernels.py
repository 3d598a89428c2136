"""The misfit of many parameter vectors at once: compiled where that pays, else as the problem itself evaluates them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from rotorfit.estimators.misfit import accelerator, codegen
from rotorfit.estimators.misfit.block_term import is_linear_response
from rotorfit.estimators.misfit.kernel_layout import layout
from rotorfit.estimators.misfit.problem import Problem
from rotorfit.models.array_types import Bool, ComplexArray, Float, Index

BREAK_EVEN_READINGS = 2e7
"""Readings to evaluate (vectors times readings) beyond which kernels are quicker than NumPy's 0.05 microseconds.

It lies between the time to load them from disk and that to compile them. The choice must not depend on which of the two
it is: the same seed gives the same samples, to round-off.
"""
GRADIENT_COST = 5.0
"""NumPy's time for a gradient over that of a misfit."""


@dataclass(frozen=True, eq=False, kw_only=True)
class MemberReadings:
    """Readings of many members."""

    measured: ComplexArray  # of what is not compiled, shape ``(W, R)``
    re: Float  # real parts of responses to unit forces in the order of the kernels, shape ``(W, Q)``
    im: Float  # imaginary parts, shape ``(W, Q)``

    def of(self, members: Index) -> MemberReadings:
        """Those of some members; of all without a copy."""
        if members.size == self.re.shape[0]:
            return self
        return MemberReadings(measured=self.measured[members], re=self.re[members], im=self.im[members])


class Batch:
    """Channel sums, costs and gradients of many vectors of a problem."""

    def __init__(
        self, problem: Problem, *, accelerate: bool | None = None, work: float = np.inf, gradients: bool = False
    ) -> None:
        self.problem = problem
        linear = np.array([is_linear_response(block) for block in problem.blocks], dtype=bool)
        readings = work * problem.n_data / 2 * (GRADIENT_COST if gradients else 1.0)
        pays = (readings > BREAK_EVEN_READINGS and accelerator.available()) if accelerate is None else accelerate
        unrolled = len(problem.space.model.coordinates) <= codegen.LARGEST_UNROLLED
        self.compiled = bool(pays and unrolled and linear.any())
        self._kernels = Kernels(_part(problem, linear)) if self.compiled else None
        linear &= self.compiled
        self._in_kernels = np.repeat(linear, [block.measured.size for block in problem.blocks])  # of readings
        self._channels = np.repeat(linear, [len(block.labels) for block in problem.blocks])
        self._rest = _part(problem, ~linear)

    def channel_sums(self, x: Float) -> Float:
        """See :meth:`Problem.channel_sums`."""
        if self._kernels is None:
            return self._rest.channel_sums(x)
        out = np.zeros((len(x), len(self.problem.channel_names)))
        out[:, self._channels], out[:, ~self._channels] = self._kernels.channel_sums(x), self._rest.channel_sums(x)
        return out

    def readings(self, measured: ComplexArray) -> MemberReadings:
        """Readings of members in place of the problem's, shape ``(W, R)``, sorted once for many evaluations."""
        if self._kernels is None:
            none = np.zeros((len(measured), 0))
            return MemberReadings(measured=measured, re=none, im=none)
        re, im = self._kernels.sorted(measured if self._in_kernels.all() else measured[:, self._in_kernels])
        return MemberReadings(measured=measured[:, ~self._in_kernels], re=re, im=im)

    def cost_and_gradient(self, x: Float, readings: MemberReadings | None = None) -> tuple[Float, Float]:
        """Costs of the problem and their exact gradients, shapes ``(W,)`` and ``(W, p)``."""
        cost, gradient, _ = self._rest.evaluate(x, None if readings is None else readings.measured, matrix=False)
        if self._kernels is not None:
            self._kernels.add(x, None if readings is None else (readings.re, readings.im), cost, gradient)
        return cost, gradient


def _part(problem: Problem, chosen: Bool) -> Problem:
    """Some blocks of a problem with all of its priors; the problem itself where that is all of them."""
    if chosen.all():
        return problem
    numbers = np.flatnonzero(chosen).tolist()
    factors = tuple(problem.factors[i] for i in numbers) if problem.factors else ()
    return replace(problem, blocks=tuple(problem.blocks[i] for i in numbers), factors=factors)


class Kernels:
    """Compiled sums over the readings of a problem whose blocks are responses to forces of a linear model."""

    def __init__(self, problem: Problem) -> None:
        self.problem, self._plan = problem, layout(problem)

    def channel_sums(self, x: Float) -> Float:
        """See :meth:`Problem.channel_sums`."""
        x, out = np.ascontiguousarray(x, dtype=float), np.zeros((len(x), len(self.problem.channel_names)))
        if x.size:
            self._functions["sums"](x, *self._fixed, *self._data, *self._gain_parts(x), self._plan.channel, out)
        return out

    def sorted(self, measured: ComplexArray) -> tuple[Float, Float]:
        """Responses to unit forces in the order of the kernels, real and imaginary parts, shapes ``(W, Q)``."""
        order, per_drive = self._plan.reading, 1.0 / self._plan.drive
        re, im = np.empty((len(measured), order.size)), np.empty((len(measured), order.size))
        for m, row in enumerate(measured):
            target = row[order] * per_drive
            re[m], im[m] = target.real, target.imag
        return re, im

    def add(self, x: Float, targets: tuple[Float, Float] | None, cost: Float, gradient: Float) -> None:
        """Add costs without priors, and their gradients."""
        x = np.ascontiguousarray(x, dtype=float)
        re, im = self._gain_parts(x)
        seed_re, seed_im = np.zeros_like(re), np.zeros_like(im)
        target_re, target_im = self._data[:2] if targets is None else targets
        self._functions["slopes"](
            x, *self._fixed, target_re, target_im, self._data[2], re, im, cost, gradient, seed_re, seed_im
        )
        if not self._has_gains:
            return
        # The slope by the gains (by re + j by im) is chained to the vector.
        plan, space, functions = self._plan, self.problem.space, self.problem.space.model.functions
        pulled = (seed_re - 1j * seed_im) * self._gains(x)
        gradient[:, len(space.names) :] += (pulled @ plan.nuisance).real
        if functions.has_probe_factors:
            theta = space.theta(x)
            factor = functions.factors(theta)[:, plan.gain_group, plan.gain_coordinate]
            by_theta = functions.factor_jacobian(theta)[:, plan.gain_group, plan.gain_coordinate]
            pull = ((pulled / factor)[:, :, None] * by_theta).real
            for g, row in enumerate(plan.gain_group):
                free = np.flatnonzero(space.index[row] >= 0)
                np.add.at(gradient.T, space.index[row, free], pull[:, g, free].T)

    # ---- gains: nuisance entries and probe factors -------------------------------------------------------------------

    @cached_property
    def _has_gains(self) -> bool:
        """True if predictions are multiplied by something that depends on the vector."""
        factored = self.problem.space.model.functions.has_probe_factors
        return factored or bool(self._plan.nuisance.any())

    def _gains(self, x: Float) -> ComplexArray:
        """Factor of each distinct gain, shape ``(W, number of gains)``."""
        plan = self._plan
        if not self._has_gains:
            return np.ones((1, plan.gain_group.size), dtype=complex)
        gain = np.exp(x[:, len(self.problem.space.names) :] @ plan.nuisance.T)
        functions = self.problem.space.model.functions
        if functions.has_probe_factors:
            gain = gain * functions.factors(self.problem.space.theta(x))[:, plan.gain_group, plan.gain_coordinate]
        return np.asarray(gain, dtype=complex)

    # ---- numba -------------------------------------------------------------------------------------------------------

    @cached_property
    def _patterns(self) -> tuple[tuple[codegen.Pattern, ...], Index]:
        """Distinct ways of reading a node, and the one of each segment."""
        plan = self._plan
        axis = [int(np.argmax(u)) if np.count_nonzero(u) == 1 and u.max() == 1 else -1 for u in plan.directions.real]
        axis = [a if not plan.directions[i].imag.any() else -1 for i, a in enumerate(axis)]
        seen: dict[codegen.Pattern, int] = {}
        numbers = [
            seen.setdefault(
                codegen.Pattern(
                    tuple((int(plan.coordinate[e]), axis[plan.direction[e]]) for e in range(e0, e1)),
                    self._has_gains,
                    self.problem.loss,
                ),
                len(seen),
            )
            for _, _, _, e0, e1 in plan.segments
        ]
        return tuple(seen), np.array(numbers, dtype=np.intp)

    @cached_property
    def _functions(self) -> dict[str, accelerator.Kernel]:
        return accelerator.compile_kernels(codegen.source(self.problem.space.model, self._patterns[0]))

    @cached_property
    def _fixed(self) -> tuple[Any, ...]:
        plan, space = self._plan, self.problem.space
        arrays = (
            space.template,
            space.index,
            plan.group,
            plan.speed,
            plan.frequency,
            plan.segments,
            self._patterns[1],
            plan.datum,
            plan.gain,
            plan.direction,
            plan.directions.real,
            plan.directions.imag,
        )
        return tuple(np.ascontiguousarray(a) for a in arrays)

    @cached_property
    def _data(self) -> tuple[Float, Float, Float]:
        return (*_split(self._plan.target[None, :]), np.ascontiguousarray(self._plan.weight))

    @cached_property
    def _unit_gains(self) -> tuple[Float, Float]:
        return _split(np.ones((1, self._plan.gain_group.size), dtype=complex))

    def _gain_parts(self, x: Float) -> tuple[Float, Float]:
        return _split(self._gains(x)) if self._has_gains else self._unit_gains


def _split(values: ComplexArray) -> tuple[Float, Float]:
    return np.ascontiguousarray(values.real), np.ascontiguousarray(values.imag)
