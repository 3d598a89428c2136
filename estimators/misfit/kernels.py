"""The misfit of many parameter vectors at once, by compiled kernels or by NumPy with the same answers."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from rotorfit.estimators.misfit import accelerator, codegen
from rotorfit.estimators.misfit.block_misfit import BlockMisfit, alone, takes_many
from rotorfit.estimators.misfit.kernel_layout import KernelLayout, channels, is_plain, layout
from rotorfit.estimators.misfit.losses import robust_weights
from rotorfit.estimators.misfit.problem import Problem
from rotorfit.models.array_types import ComplexArray, Float, Index

PAYS = 2e7
"""Readings to evaluate (vectors times readings) beyond which kernels are quicker than NumPy's 0.05 microseconds.

It lies between the time to load them from disk and that to compile them. The choice must not depend on which of the two
it is: the same seed gives the same samples, to round-off.
"""
GRADIENT = 5.0
"""NumPy's time for a gradient over that of a misfit."""
_CHUNK = 60_000  # readings that NumPy holds at once, so that arrays stay in cache


@dataclass(frozen=True, eq=False, kw_only=True)
class MemberReadings:
    """Readings of many members."""

    measured: ComplexArray  # as given, shape ``(W, R)``; empty where there are responses to forces alone
    re: Float  # responses to unit forces in the order of the layout, shape ``(W, Q)``
    im: Float  # responses to unit forces in the order of the layout, shape ``(W, Q)``

    def of(self, members: Index) -> MemberReadings:
        """Those of some members; of all without a copy."""
        if members.size == self.measured.shape[0]:
            return self
        return MemberReadings(measured=self.measured[members], re=self.re[members], im=self.im[members])


class Batch:
    """Misfit, by channel, of many vectors of a problem, and its gradient."""

    def __init__(
        self, problem: Problem, *, accelerate: bool | None = None, work: float = np.inf, gradients: bool = False
    ) -> None:
        self.problem = problem
        self.layout: KernelLayout | None = layout(problem)
        self.channel_names, self.channel_counts, self._channel_of = channels(problem)
        self._others = [i for i, block in enumerate(problem.blocks) if not is_plain(block)]
        unrolled = len(problem.space.model.coordinates) <= codegen.LARGEST_UNROLLED
        possible = unrolled and self.layout is not None
        self.compiled = bool(possible and (self._pays(work, gradients) if accelerate is None else accelerate))

    def _pays(self, work: float, gradients: bool) -> bool:
        """Whether kernels, with the time it takes to have them, are quicker than NumPy."""
        readings = work * self.problem.n_data / 2 * (GRADIENT if gradients else 1.0)
        return readings > PAYS and accelerator.available()

    @property
    def one_by_one(self) -> bool:
        """Whether some observations are evaluated vector by vector, so that many vectors at once save nothing."""
        return not all(takes_many(self.problem.blocks[i]) for i in self._others)

    # ---- gains: nuisance entries and probe factors -------------------------------------------------------------------

    @cached_property
    def has_gains(self) -> bool:
        """Whether predictions are multiplied by something that depends on the vector."""
        factored = self.problem.space.model.functions.has_probe_factors
        return self.layout is not None and (factored or bool(self.layout.nuisance.any()))

    def _theta(self, x: Float) -> Float:
        """Parameter vectors of the groups for each vector, shape ``(W, G, P)``."""
        space = self.problem.space
        theta = np.broadcast_to(space.template, (x.shape[0], *space.template.shape)).copy()
        free = space.index >= 0
        theta[:, free] = x[:, space.index[free]]
        return theta

    def _gains(self, x: Float) -> ComplexArray:
        """Factor of each distinct gain, shape ``(W, number of gains)``."""
        plan = self._plan
        if not self.has_gains:
            return np.ones((1, plan.gain_group.size), dtype=complex)
        gain = np.exp(x[:, len(self.problem.space.names) :] @ plan.nuisance.T)
        functions = self.problem.space.model.functions
        if functions.has_probe_factors:
            gain = gain * functions.factors(self._theta(x))[:, plan.gain_group, plan.gain_coordinate]
        return np.asarray(gain, dtype=complex)

    def _gain_gradient(self, x: Float, slope: ComplexArray) -> Float:
        """Chain the slope of the cost with respect to the gains (by re + j by im) to the vector, shape ``(W, p)``."""
        plan, space = self._plan, self.problem.space
        result = np.zeros_like(x)
        gain = self._gains(x)
        result[:, len(space.names) :] = ((slope.conj() * gain) @ plan.nuisance).real
        functions = space.model.functions
        if functions.has_probe_factors:
            theta = self._theta(x)
            factor = functions.factors(theta)[:, plan.gain_group, plan.gain_coordinate]
            by_theta = functions.factor_jacobian(theta)[:, plan.gain_group, plan.gain_coordinate]
            pull = ((slope.conj() * gain / factor)[:, :, None] * by_theta).real
            for g, row in enumerate(plan.gain_group):
                free = np.flatnonzero(space.index[row] >= 0)
                np.add.at(result.T, space.index[row, free], pull[:, g, free].T)
        return result

    # ---- misfit ------------------------------------------------------------------------------------------------------

    def sums(self, x: Float) -> Float:
        """Robust sum of squared whitened residuals of each channel.

        Returns:
            shape ``(W, channels)``; twice :meth:`Problem.cost` without priors when summed.
        """
        x = np.ascontiguousarray(x, dtype=float)
        out = np.zeros((x.shape[0], len(self.channel_names)))
        if self.layout is not None and x.size:
            (self._compiled_sums if self.compiled else self._array_sums)(x, out)
        for rest in self._rest:
            rest.add_sums(x, out)
        return out

    def readings(self, measured: ComplexArray) -> MemberReadings:
        """Readings of members in place of the problem's, sorted once for many evaluations."""
        raw = measured if self._others else measured[:, :0]
        if self.layout is None:
            none = np.zeros((measured.shape[0], 0))
            return MemberReadings(measured=raw, re=none, im=none)
        order, per_drive = self.layout.reading, 1.0 / self.layout.drive
        shape = measured.shape[0], order.size
        re, im = np.empty(shape), np.empty(shape)
        for m, row in enumerate(measured):
            target = row[order] * per_drive
            re[m], im[m] = target.real, target.imag
        return MemberReadings(measured=raw, re=re, im=im)

    def cost_and_gradient(self, x: Float, readings: MemberReadings | None = None) -> tuple[Float, Float]:
        """Cost of :class:`Problem` without priors, and its exact gradient.

        Returns:
            shapes ``(W,)`` and ``(W, p)``.
        """
        x = np.ascontiguousarray(x, dtype=float)
        cost, gradient = np.zeros(x.shape[0]), np.zeros_like(x)
        if self.layout is not None and x.size:
            re, im = self._data[:2] if readings is None else (readings.re, readings.im)
            if self.compiled:
                self._compiled_slopes(x, re, im, cost, gradient)
            else:
                self._array_slopes(x, re + 1j * im, cost, gradient)
        for rest in self._rest:
            rest.add_slopes(x, None if readings is None else readings.measured, cost, gradient)
        return cost, gradient

    @property
    def _plan(self) -> KernelLayout:
        if self.layout is None:
            raise RuntimeError("the problem has no responses to forces")
        return self.layout

    @cached_property
    def _rest(self) -> list[BlockMisfit]:
        """Blocks without a kernel."""
        problem, stops = self.problem, np.cumsum([0] + [block.measured.size for block in self.problem.blocks])
        return [
            BlockMisfit(
                problem=alone(problem, i),
                readings=slice(stops[i], stops[i + 1]),
                channel=self._channel_of[i],
            )
            for i in self._others
        ]

    # ---- NumPy -------------------------------------------------------------------------------------------------------

    def _amplitude(self, x: Float) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
        """Receptance of each node, response to each force direction, and prediction of each datum before the gain."""
        plan, model = self._plan, self.problem.space.model
        coefficients = model.coefficients(self._theta(x)[:, plan.group], plan.speed)
        s = 1j * plan.frequency[:, None, None]
        kappa = coefficients[:, plan.node_condition, -1]
        for power in range(coefficients.shape[2] - 2, -1, -1):
            kappa = kappa * s + coefficients[:, plan.node_condition, power]
        H = _inverse(kappa)
        response = H @ plan.directions.T
        return H, response, response[:, plan.node, plan.coordinate[plan.entry], plan.direction[plan.entry]]

    def _parts(self, x: Float) -> list[slice]:
        step = max(1, _CHUNK // self._plan.reading.size)
        return [slice(a, a + step) for a in range(0, x.shape[0], step)]

    def _array_sums(self, x: Float, out: Float) -> None:
        plan = self._plan
        to_channel = np.zeros((plan.datum.size, out.shape[1]))
        to_channel[np.arange(plan.datum.size), plan.channel] = 1.0
        for part in self._parts(x):
            _, _, value = self._amplitude(x[part])
            miss = value * self._gains(x[part])[:, plan.gain[plan.entry]] - plan.target
            rho, _ = robust_weights(self.problem.loss, plan.weight * (miss.real**2 + miss.imag**2))
            out[part] += np.add.reduceat(rho, plan.datum, axis=1) @ to_channel

    def _array_slopes(self, x: Float, target: ComplexArray, cost: Float, gradient: Float) -> None:
        for part in self._parts(x):
            self._array_slopes_of(x[part], target if target.shape[0] == 1 else target[part], cost[part], gradient[part])

    def _array_slopes_of(self, x: Float, target: ComplexArray, cost: Float, gradient: Float) -> None:
        """Adjoint of the prediction: ``d cost = Re sum Y dA`` and ``dA = -H dkappa H u`` give the slope by kappa."""
        plan = self._plan
        H, _, value = self._amplitude(x)
        gain = self._gains(x)[:, plan.gain[plan.entry]]
        miss = value * gain - target
        rho, weight = robust_weights(self.problem.loss, plan.weight * (miss.real**2 + miss.imag**2))
        cost += rho.sum(axis=1) / 2
        pull = weight * plan.weight * miss.conj()
        Y = np.zeros((*H.shape[:-1], plan.directions.shape[0]), dtype=complex)
        # One entry at a time: no node occurs twice in it.
        by_gain = np.zeros((x.shape[0], plan.gain_group.size), dtype=complex)
        for e, (a, b) in enumerate(zip(plan.datum, np.append(plan.datum[1:], plan.reading.size), strict=True)):
            Y[:, plan.node[a:b], plan.coordinate[e], plan.direction[e]] += pull[:, a:b] * gain[:, a:b]
            by_gain[:, plan.gain[e]] += (pull[:, a:b] * value[:, a:b]).sum(axis=1).conj()
        turned = np.swapaxes(H, -1, -2)
        by_kappa = -(turned @ (Y @ plan.directions) @ turned)
        gradient += self._pull(x, by_kappa)
        if self.has_gains:
            gradient += self._gain_gradient(x, by_gain)

    def _pull(self, x: Float, by_kappa: ComplexArray) -> Float:
        """Chain the slope by the dynamic stiffness of each node through the coefficients to the vector."""
        plan, space = self._plan, self.problem.space
        powers = (1j * plan.frequency[:, None]) ** np.arange(space.model.order + 1)
        jacobian = space.model.functions.jacobian(self._theta(x)[:, plan.group], plan.speed)
        result = np.zeros_like(x)
        for k, g in enumerate(plan.group):
            nodes = np.flatnonzero(plan.node_condition == k)
            n = by_kappa.shape[-1]
            by_c = (powers[nodes].T @ by_kappa[:, nodes].reshape(len(x), -1, n * n)).reshape(len(x), -1, n, n)
            used = np.flatnonzero(jacobian.inputs < space.index.shape[1])
            used = used[space.index[g, jacobian.inputs[used]] >= 0]
            slope = by_c[:, jacobian.powers[used], jacobian.rows[used], jacobian.columns[used]]
            values = (slope * jacobian.values[:, k, used]).real
            np.add.at(result.T, space.index[g, jacobian.inputs[used]], values.T)
        return result

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
                    self.has_gains,
                    self.problem.loss,
                ),
                len(seen),
            )
            for _, _, _, e0, e1 in plan.segments
        ]
        return tuple(seen), np.array(numbers, dtype=np.intp)

    @cached_property
    def _kernels(self) -> dict[str, accelerator.Kernel]:
        return accelerator.compile_kernels(self._source)

    @cached_property
    def _source(self) -> str:
        return codegen.source(self.problem.space.model, self._patterns[0])

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

    def _compiled_sums(self, x: Float, out: Float) -> None:
        self._kernels["sums"](x, *self._fixed, *self._data, *self._gain_parts(x), self._plan.channel, out)

    @cached_property
    def _unit_gains(self) -> tuple[Float, Float]:
        return _split(np.ones((1, self._plan.gain_group.size), dtype=complex))

    def _gain_parts(self, x: Float) -> tuple[Float, Float]:
        return _split(self._gains(x)) if self.has_gains else self._unit_gains

    def _compiled_slopes(self, x: Float, target_re: Float, target_im: Float, cost: Float, gradient: Float) -> None:
        re, im = self._gain_parts(x)
        seed_re, seed_im = np.zeros_like(re), np.zeros_like(im)
        self._kernels["slopes"](
            x, *self._fixed, target_re, target_im, self._data[2], re, im, cost, gradient, seed_re, seed_im
        )
        if self.has_gains:
            gradient += self._gain_gradient(x, seed_re + 1j * seed_im)


def _split(values: ComplexArray) -> tuple[Float, Float]:
    return np.ascontiguousarray(values.real), np.ascontiguousarray(values.imag)


def _inverse(kappa: ComplexArray) -> ComplexArray:
    """Inverse of matrices of shape ``(..., n, n)``, one and two rows in closed form."""
    n = kappa.shape[-1]
    if n == 1:
        return np.asarray(1.0 / kappa)
    if n > 2:
        return np.asarray(np.linalg.inv(kappa))
    a, b, c, d = kappa[..., 0, 0], kappa[..., 0, 1], kappa[..., 1, 0], kappa[..., 1, 1]
    determinant = 1.0 / (a * d - b * c)
    result = np.empty_like(kappa)
    result[..., 0, 0], result[..., 0, 1] = d * determinant, -b * determinant
    result[..., 1, 0], result[..., 1, 1] = -c * determinant, a * determinant
    return result
