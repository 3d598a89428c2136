"""Observations of a rotor whose fluid changes with eccentricity, with exact sensitivities."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, Self

import numpy as np

from rotorfit.base.array_types import Bool, ComplexArray, Float, Index
from rotorfit.estimators.blocks.observations import OnResponses, Responses
from rotorfit.estimators.blocks.response import inverse_of_lines, read_by_probes, read_by_probes_jacobian
from rotorfit.models import RotorModel
from rotorfit.models.motion.journal import Journal, LineStiffness, journals, known_structure, line_stiffness
from rotorfit.models.motion.orbits import (
    LARGEST_ECCENTRICITY,
    CentredMotion,
    followed_roots,
    followed_together,
    nearest_orbits,
    nearest_together,
)
from rotorfit.models.shafts.shaft import KnownStiffness

OrbitBranch = Literal["nearest", "followed", "given"]


@dataclass(frozen=True, eq=False)
class _State:
    """Orbits at parameter vectors, lines along the last axis."""

    theta: Float  # parameter vector of each line, shape ``(..., L or 1, P)``
    eps: Float  # eccentricity of each journal, shape ``(J, ..., L)``
    H: ComplexArray  # receptance at these eccentricities, shape ``(n, n, ..., L)``
    amplitude: ComplexArray  # response of every coordinate, shape ``(n, ..., L)``


@dataclass(frozen=True, eq=False)
class OrbitResponses(OnResponses):
    """Centred orbits under circular forces, or displacements under constant loads (w = 0), of a nonlinear rotor."""

    # eccentricity of each journal in each line as its probe read it, NaN where it was not measured, shape ``(J, L)``
    eccentricity: Float
    mode: OrbitBranch  # which root
    sweep: Index  # number of the sweep of each line, for ``followed``; lines are in the sweep's order
    beside: ComplexArray | None = None  # dynamic stiffness that acts beside the rotor's, shape ``(L, n, n)``

    @cached_property
    def journals(self) -> tuple[Journal, ...]:
        """Where eccentricities enter."""
        return journals(self.model)

    @cached_property
    def _graph(self) -> LineStiffness:
        return line_stiffness(self.model)

    @property
    def frozen(self) -> OrbitResponses:
        """The same with the measured eccentricities taken as given."""
        return replace(self, mode="given", eccentricity=np.nan_to_num(self.eccentricity))

    def from_rest(self, *, one_sweep: bool = False) -> OrbitResponses:
        """See :class:`~rotorfit.estimators.blocks.observations.Asked`."""
        mode: OrbitBranch = "given" if self.mode == "given" else "followed"
        return replace(self, mode=mode, sweep=np.zeros_like(self.sweep) if one_sweep else self.sweep)

    @property
    def over_clearance(self) -> bool:
        """See :class:`~rotorfit.estimators.blocks.observations.Asked`."""
        return True

    @property
    def shows_eccentricity(self) -> bool:
        """See :class:`~rotorfit.estimators.blocks.observations.Asked`."""
        return bool(np.isfinite(self.eccentricity).any())

    def lines(self, keep: Bool) -> OrbitResponses:
        """The observations of some lines."""
        return OrbitResponses(self.base.lines(keep), self.eccentricity[:, keep], self.mode, self.sweep[keep])

    def measured_eccentricity(self, theta: Float) -> Float:
        """Largest eccentricity of a journal in each line, factors of probes taken out, ``(..., L)`` or ``(L,)``."""
        return np.asarray(self._measured(theta).max(axis=0))

    def _measured(self, theta: Float) -> Float:
        """Eccentricities of the journals as their probes read them, shape ``(J, ..., L)`` or ``(J, L)``."""
        if self.base.imposed:
            return self.eccentricity
        pairs = zip(self.journals, self.eccentricity, strict=True)
        return np.stack([eccentricity_of_reading(seat, theta, self.base.group, eps)[0] for seat, eps in pairs])

    def at_small_orbits(self, limit: float) -> Responses:
        """See :class:`~rotorfit.estimators.blocks.observations.Asked`."""
        eps = np.nan_to_num(self.eccentricity).max(axis=0)
        return self.lines(eps <= max(limit, float(np.median(eps)))).base

    def at_speeds(self, factor: float) -> OrbitResponses:
        """See :class:`~rotorfit.estimators.blocks.observations.Asked`."""
        return replace(self, base=self.base.at_speeds(factor))

    @property
    def circular(self) -> Responses:
        """See :class:`~rotorfit.estimators.blocks.observations.Asked`."""
        return self.base

    @property
    def apart(self) -> OrbitResponses:
        """See :class:`~rotorfit.estimators.blocks.observations.Asked`."""
        return replace(self, base=replace(self.base, group=self.base.condition[0]))

    def in_clearance(self, factor: float) -> OrbitResponses:
        """See :class:`~rotorfit.estimators.blocks.observations.Asked`."""
        base = replace(self.base, model=resized(self.model, factor))
        return replace(self, base=base, eccentricity=self.eccentricity / factor)

    def orbits(self, theta: Float) -> Float:
        """Eccentricity of each journal in each line, shape ``(J, ..., L)``."""
        return self._state(theta).eps

    def on(self, base: Responses) -> Self:
        """See :meth:`~rotorfit.estimators.blocks.observations.OnResponses.on`; orbits, which no reading moves, go
        along."""
        found = copy(self)
        object.__setattr__(found, "base", base)
        return found

    @cached_property
    def _states(self) -> dict[bytes, _State]:
        """Orbits at the parameter vectors that were asked for last: much is asked at an optimum."""
        return {}

    def _state(self, theta: Float) -> _State:
        """Orbits at parameter vectors; those at one vector are kept until the next."""
        if theta.ndim > 2:
            return self._moving(theta)
        key = theta.tobytes()
        if (found := self._states.get(key)) is None:
            found = self._moving(theta)
            self._states.clear()
            self._states[key] = found
        return found

    def _moving(self, theta: Float) -> _State:
        base, seats = self.base, self.journals
        # Lines of one group share a vector, which broadcasts: what depends on parameters alone is computed once.
        vectors = theta if theta.shape[-2] == 1 else theta[..., base.group, :]
        if self.mode == "given":
            eps = np.clip(self.eccentricity, 0.0, LARGEST_ECCENTRICITY)
            H = self._receptance(vectors, eps)
            shape = (len(seats), *H.shape[2:])
            return _State(vectors, np.broadcast_to(eps[:, *[None] * (H.ndim - 3)], shape), H, self._forced(H))
        H = self._receptance(vectors, np.zeros((len(seats), 1)))
        moved = CentredMotion(
            theta=vectors, frequency=self._frequency, speed=self._speed, receptance=H, amplitude=self._forced(H)
        )
        eps, changes = self._settled(moved, theta)
        for seat, change in zip(seats, changes, strict=True):
            moved = moved.changed(seat.at, change)
        return _State(vectors, eps, moved.receptance, moved.amplitude)

    def _settled(self, centred: CentredMotion, theta: Float) -> tuple[Float, ComplexArray]:
        """Eccentricities, and changes of the stiffness, shape ``(J, ..., L)``: the roots that the mode chooses."""
        if len(self.journals) > 1:
            if self.mode == "nearest":
                return nearest_together(self.journals, centred, self._measured(theta))
            return followed_together(self.journals, centred, self.sweep)
        (seat,) = self.journals
        equation = centred.equation(seat)
        if self.mode == "nearest":
            eps, change = nearest_orbits(seat, equation, self._measured(theta)[0])
        else:
            eps = followed_roots(seat, equation, self.sweep)
            change = equation.change(seat, eps)
        return eps[None], change[None]

    @cached_property
    def _speed(self) -> Float:
        """Rotative speed of the lines, a single number where all have the same."""
        speed = self.base.speed
        return np.asarray(speed[0]) if np.ptp(speed) == 0 else speed

    @cached_property
    def _frequency(self) -> Float:
        return np.ascontiguousarray(self.base.s.imag)

    def _receptance(self, vectors: Float, eccentricity: Float) -> ComplexArray:
        """Receptance of the rotor with its journals at eccentricities, shape ``(n, n, ..., L)``."""
        kappa = self._stiffness(vectors, self._frequency, eccentricity)
        return inverse_of_lines(kappa if self.beside is None else kappa + np.moveaxis(self.beside, 0, -1))

    def stiffened(self, stiffness: ComplexArray) -> OrbitResponses:
        """See :class:`~rotorfit.estimators.blocks.observations.Asked`."""
        return replace(self, beside=stiffness)

    def _stiffness(self, vectors: Float, frequency: Float, eccentricity: Float) -> ComplexArray:
        """Dynamic stiffness of every line at a frequency of its own, likewise."""
        first, *others = eccentricity
        graph = self._graph
        kappa = graph.values(vectors, frequency, self._speed, first)
        for seat, own in zip(self.journals[1:], others, strict=True):  # each entry by the orbit of its own journal
            kappa[seat.at, seat.at] = graph.values(vectors, frequency, self._speed, own)[seat.at, seat.at]
        if self.model.shaft is not None:
            s: ComplexArray = np.asarray(1j * frequency, dtype=np.complex128)
            kappa = kappa + known_structure(self.model, vectors, s, self.base.speed).values
        return np.asarray(kappa)

    def _forced(self, H: ComplexArray) -> ComplexArray:
        """Response to the forces, shape ``(n, ..., L)``."""
        force = self.base.force
        total = np.zeros(H.shape[1:], dtype=complex)
        for column in np.flatnonzero(force.any(axis=0)).tolist():
            total += H[:, column] * force[:, column]
        return total

    def predict(self, theta: Float) -> ComplexArray:
        """See :meth:`~rotorfit.estimators.blocks.observations.Block.predict`."""
        state = self._state(theta)
        if self.base.imposed:
            coordinates = range(state.H.shape[0])
            return self._read([self.base.force[:, i] / state.H[i, i] for i in coordinates])
        return read_by_probes(self.base, theta, self._read(list(state.amplitude)))

    def _read(self, values: list[ComplexArray]) -> ComplexArray:
        """Readings, shape ``(..., R)``, of what every coordinate does, shape ``(..., L)`` each."""
        return np.concatenate(values, axis=-1)[..., self.base.place]

    def predict_jacobian(self, theta: Float) -> tuple[ComplexArray, ComplexArray]:
        """See :meth:`~rotorfit.estimators.blocks.observations.Block.predict_jacobian`."""
        found = self.motion_jacobian(theta)
        return found if self.base.imposed else read_by_probes_jacobian(self.base, theta, *found)

    def motion_jacobian(self, theta: Float) -> tuple[ComplexArray, ComplexArray]:
        """Motion that the probes read, without their factors (or forces under imposed orbits), and its derivatives. By
        the implicit function theorem ``d eps = (d|A_b| / clearance) / (1 - d|A_b|/d eps / clearance)``, the derivatives
        on the right those at fixed eccentricity."""
        state, base, count = self._state(theta), self.base, theta.shape[-1]
        coordinates = range(state.H.shape[0])
        if base.imposed:
            values = [base.force[:, i] / state.H[i, i] for i in coordinates]
            right = [state.H[:, i] for i in coordinates]
            outer = [-value / state.H[i, i] for i, value in enumerate(values)]
        else:
            values, right = list(state.amplitude), [state.amplitude] * len(coordinates)
        by_kappa = self._by_kappa(state)
        known = None if self.model.shaft is None else known_structure(self.model, state.theta, base.s, base.speed)
        slopes = [self._slopes(state.H[i], by_kappa, known, right[i], count) for i in coordinates]
        if base.imposed:
            slopes = [slope * factor for slope, factor in zip(slopes, outer, strict=True)]
        elif self.mode != "given":
            orbits = self._orbit_slopes(state, [slopes[seat.at] for seat in self.journals], count)
            for slope in slopes:
                for place, orbit in enumerate(orbits, count):
                    slope[:count] += slope[place] * orbit
        by_theta = [slope[:count] for slope in slopes]
        return self._read(values), np.moveaxis(self._read(by_theta), 0, -1)

    def _by_kappa(self, state: _State) -> ComplexArray:
        """Derivatives of the stiffness's entries, each at the eccentricity of its own journal."""
        graph = self._graph
        found = [graph.slopes(state.theta, self._frequency, self._speed, eps) for eps in state.eps]
        for seat, own in zip(self.journals[1:], found[1:], strict=True):
            there = np.array(graph.rows) == seat.at  # which has this eccentricity on the diagonal alone
            found[0][there] = own[there]
        return found[0]

    def _orbit_slopes(self, state: _State, own: list[ComplexArray], count: int) -> list[Float]:
        """Derivatives of the eccentricities by the parameters, ``(P, ..., L)`` each; zero where an orbit fills the gap.
        ``own`` are those of the journals' motion by the parameters and by eccentricities that are held."""
        pointers = []
        for seat in self.journals:
            moving = state.amplitude[seat.at]
            size = np.abs(moving)
            pointers.append(np.divide(moving.conj(), size * seat.clearance, out=np.zeros_like(moving), where=size > 0))
        if len(own) == 1:
            ((pointer,), (slope,)) = pointers, own
            loop = 1.0 - (pointer * slope[count]).real
            free = (state.eps[0] < LARGEST_ECCENTRICITY) & (loop != 0)
            return [(pointer / np.where(free, loop, np.inf) * slope[:count]).real]
        parts = np.stack([(pointer * slope).real for pointer, slope in zip(pointers, own, strict=True)], axis=-1)
        loops = np.eye(len(own)) - np.moveaxis(parts[count:], 0, -1)
        free = np.asarray((state.eps < LARGEST_ECCENTRICITY).all(axis=0))
        found = np.linalg.solve(loops, np.moveaxis(parts[:count], 0, -1))
        return [np.moveaxis(found[..., k, :], -1, 0) * free for k in range(len(own))]

    def motion(self, theta: Float) -> ComplexArray:
        """See :class:`~rotorfit.estimators.blocks.observations.Asked`."""
        return np.asarray(self._state(theta).amplitude.T)

    def pushed(self, theta: Float, force: ComplexArray) -> ComplexArray:
        """See :class:`~rotorfit.estimators.blocks.observations.Asked`."""
        state, count = self._state(theta), theta.shape[-1]
        moved = np.einsum("ijl,lj->il", state.H, force)
        if self.mode != "given":
            by_kappa = self._by_kappa(state)
            held = [self._slopes(left, by_kappa, None, state.amplitude, count)[count:] for left in state.H]
            own = [np.concatenate([moved[None, seat.at], held[seat.at]]) for seat in self.journals]
            orbits = np.concatenate(self._orbit_slopes(state, own, 1))
            moved = moved + np.einsum("ikl,kl->il", held, orbits)
        return np.asarray(moved.T)

    def _slopes(
        self, left: ComplexArray, by_kappa: ComplexArray, known: KnownStiffness | None, right: ComplexArray, count: int
    ) -> ComplexArray:
        """``-left dkappa right`` by the parameters and, last, by eccentricities, shape ``(P + J, ..., L)``."""
        graph = self._graph
        seats = {seat.at: number for number, seat in enumerate(self.journals)}
        total = np.zeros((count + len(seats), *left.shape[1:]), dtype=complex)
        products: dict[tuple[int, int], ComplexArray] = {}
        for value, place, row, column in zip(by_kappa, graph.inputs, graph.rows, graph.columns, strict=True):
            if (row, column) not in products:
                products[row, column] = left[row] * right[column]
            total[place + seats[row] if place == count else place] -= products[row, column] * value
        if known is not None:
            for place, slope in zip(known.inputs.tolist(), known.slopes, strict=True):
                total[place] -= np.einsum("i...,ij...,j...->...", left, slope, right)
        return total


def eccentricity_of_reading(seat: Journal, theta: Float, group: Index, reading: Float) -> tuple[Float, Float]:
    """Eccentricities by a journal's probe, ``(..., L)``, and slopes by parameters, ``(..., L, P)`` or ``(1,)``."""
    functions = seat.model.functions
    if not functions.has_probe_factors:
        return reading, np.zeros(1)
    factor = functions.factors(theta)[..., group, seat.at].real
    slope = functions.factor_jacobian(theta)[..., group, seat.at, :].real
    with np.errstate(divide="ignore", invalid="ignore"):  # a factor of zero is a bound
        eps = np.where(reading == 0, 0.0, reading / factor)
        by_theta = np.where((eps < LARGEST_ECCENTRICITY)[..., None], -(eps / factor)[..., None] * slope, 0.0)
    return np.minimum(eps, LARGEST_ECCENTRICITY), by_theta


def resized(model: RotorModel, factor: float) -> RotorModel:
    """The model in bearings of other clearances."""
    other = copy(model)
    gaps = ((plane, model.clearance_at(plane)) for plane in model.planes)
    other.clearance = tuple((plane, factor * gap) for plane, gap in gaps if gap is not None)
    return other
