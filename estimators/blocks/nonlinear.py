"""Observations of a rotor whose fluid changes with eccentricity, with exact sensitivities."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np

from rotorfit.base.array_types import Bool, ComplexArray, Float, Index
from rotorfit.estimators.blocks.observations import OnResponses, Responses
from rotorfit.estimators.blocks.response import inverse_of_lines, read_by_probes, read_by_probes_jacobian
from rotorfit.models import RotorModel
from rotorfit.models.motion.journal import Journal, journal, known_structure, line_stiffness
from rotorfit.models.motion.orbits import LARGEST_ECCENTRICITY, OrbitEquation, followed_roots, nearest_orbits
from rotorfit.models.shafts.shaft import KnownStiffness

OrbitBranch = Literal["nearest", "followed", "given"]


@dataclass(frozen=True, eq=False)
class _State:
    """Orbits at parameter vectors, lines along the last axis."""

    theta: Float  # parameter vector of each line, shape ``(..., L or 1, P)``
    eps: Float  # journal's eccentricity, shape ``(..., L)``
    H: ComplexArray  # receptance at that eccentricity, shape ``(n, n, ..., L)``
    amplitude: ComplexArray  # response of every coordinate, shape ``(n, ..., L)``


@dataclass(frozen=True, eq=False)
class OrbitResponses(OnResponses):
    """Centred orbits under circular forces, or displacements under constant loads (w = 0), of a nonlinear rotor."""

    # eccentricity of the journal in each line as its probe read it, NaN where it was not measured, shape ``(L,)``
    eccentricity: Float
    mode: OrbitBranch  # which root
    sweep: Index  # number of the sweep of each line, for ``followed``; lines are in the sweep's order

    @property
    def journal(self) -> Journal:
        """Where the eccentricity enters."""
        return journal(self.model)

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
        return OrbitResponses(self.base.lines(keep), self.eccentricity[keep], self.mode, self.sweep[keep])

    def measured_eccentricity(self, theta: Float) -> Float:
        """Eccentricity of the journal in each line, its probe's factor taken out, shape ``(..., L)`` or ``(L,)``."""
        if self.base.imposed:
            return self.eccentricity
        return eccentricity_of_reading(self.model, theta, self.base.group, self.eccentricity)[0]

    def at_small_orbits(self, limit: float) -> Responses:
        """See :class:`~rotorfit.estimators.blocks.observations.Asked`."""
        eps = np.where(np.isfinite(self.eccentricity), self.eccentricity, 0.0)
        return self.lines(eps <= max(limit, float(np.median(eps)))).base

    def at_speeds(self, factor: float) -> OrbitResponses:
        """See :class:`~rotorfit.estimators.blocks.observations.Asked`."""
        return replace(self, base=self.base.at_speeds(factor))

    @property
    def apart(self) -> OrbitResponses:
        """See :class:`~rotorfit.estimators.blocks.observations.Asked`."""
        return replace(self, base=replace(self.base, group=self.base.condition[0]))

    def in_clearance(self, factor: float) -> OrbitResponses:
        """See :class:`~rotorfit.estimators.blocks.observations.Asked`."""
        base = replace(self.base, model=resized(self.model, factor))
        return replace(self, base=base, eccentricity=self.eccentricity / factor)

    def orbits(self, theta: Float) -> Float:
        """Eccentricity of the journal in each line, shape ``(..., L)``."""
        return self._state(theta).eps

    def _state(self, theta: Float) -> _State:
        base, seat = self.base, self.journal
        at = seat.at
        # Lines of one group share a vector, which broadcasts: what depends on parameters alone is computed once.
        vectors = theta if theta.shape[-2] == 1 else theta[..., base.group, :]
        if self.mode == "given":
            eps = np.clip(self.eccentricity, 0.0, LARGEST_ECCENTRICITY)
            H = self._receptance(vectors, eps)
            return _State(vectors, np.broadcast_to(eps, H.shape[2:]), H, self._forced(H))
        H = self._receptance(vectors, 0.0)
        centred = self._forced(H)
        drive, w = np.abs(centred[at]) / seat.clearance, self._frequency
        equation = OrbitEquation(theta=vectors, frequency=w, speed=self._speed, drive=drive, receptance=H[at, at])
        if self.mode == "nearest":
            eps, delta = nearest_orbits(seat, equation, self.measured_eccentricity(theta))
        else:
            eps = followed_roots(seat, equation, self.sweep)
            delta = equation.change(seat, eps)
        # Only the entry (b, b) of kappa changes: a rank-one change of its inverse.
        gain = delta / (1.0 + delta * H[at, at])
        column, row = gain * H[:, at], H[at]
        return _State(vectors, eps, H - column[:, None] * row, centred - column * centred[at])

    @cached_property
    def _speed(self) -> Float:
        """Rotative speed of the lines, a single number where all have the same."""
        speed = self.base.speed
        return np.asarray(speed[0]) if np.ptp(speed) == 0 else speed

    @cached_property
    def _frequency(self) -> Float:
        return np.ascontiguousarray(self.base.s.imag)

    def _receptance(self, vectors: Float, eccentricity: Float | float) -> ComplexArray:
        """Receptance of the rotor with its journal at an eccentricity, shape ``(n, n, ..., L)``."""
        return inverse_of_lines(self._stiffness(vectors, self._frequency, eccentricity))

    def _stiffness(self, vectors: Float, frequency: Float, eccentricity: Float | float) -> ComplexArray:
        """Dynamic stiffness of every line at a frequency of its own, likewise."""
        kappa = line_stiffness(self.model).values(vectors, frequency, self._speed, eccentricity)
        if self.model.shaft is not None:
            s: ComplexArray = np.asarray(1j * frequency, dtype=np.complex128)
            kappa = kappa + known_structure(self.model, vectors, s, self.base.speed).values
        return np.asarray(kappa)

    def compliance(self, theta: Float) -> Float:
        """Eccentricity by which a unit of a constant load moves the journal, shape ``(..., L)``, 1/N."""
        vectors = theta if theta.shape[-2] == 1 else theta[..., self.base.group, :]
        held = inverse_of_lines(self._stiffness(vectors, np.zeros_like(self._frequency), 0.0))
        return np.asarray(np.abs(held[self.journal.at, self.journal.at]) / self.journal.clearance)

    def under_load(self, theta: Float, load: float) -> ComplexArray:
        """Predictions where a constant load acts at the journal too: of an orbit a about the place p that it gives the
        part at the frequency of the force, and the mean, balance; other harmonics are left out."""
        state, seat = self._state(theta), self.journal
        angle = np.pi * (np.arange(8) + 0.5)[:, None] / 8  # of the orbit from the place: Gauss and Chebyshev's nodes
        turn = np.cos(angle)
        orbit, place = state.eps, load * self.compliance(theta)
        amplitude, still = state.amplitude, np.zeros_like(self._frequency)
        for _ in range(20):  # orbit and place by turns, in part as they may swing
            e = np.clip(np.sqrt(np.abs(orbit**2 + place**2 + 2 * orbit * place * turn)), 0.0, LARGEST_ECCENTRICITY)
            held = self._stiffness(state.theta, still, e)
            moved = self._stiffness(state.theta, self._frequency, e)
            across = np.divide(place, orbit, out=np.zeros_like(orbit), where=orbit > 0)
            amplitude = self._forced(inverse_of_lines((moved + across * turn * held).mean(axis=-2)))
            along = np.divide(orbit, place, out=np.zeros_like(orbit), where=place > 0)
            mean = inverse_of_lines((held + along * turn * moved).mean(axis=-2))[seat.at, seat.at]
            orbit = orbit + 0.4 * (np.abs(amplitude[seat.at]) / seat.clearance - orbit)
            place = place + 0.4 * (load * np.abs(mean) / seat.clearance - place)
        return read_by_probes(self.base, theta, self._read(list(amplitude)))

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
        by_kappa = line_stiffness(self.model).slopes(state.theta, self._frequency, self._speed, state.eps)
        known = None if self.model.shaft is None else known_structure(self.model, state.theta, base.s, base.speed)
        slopes = [self._slopes(state.H[i], by_kappa, known, right[i], count) for i in coordinates]
        if base.imposed:
            slopes = [slope * factor for slope, factor in zip(slopes, outer, strict=True)]
        elif self.mode != "given":
            seat, moving = self.journal, state.amplitude[self.journal.at]
            size, own = np.abs(moving), slopes[seat.at]
            pointer = np.divide(moving.conj(), size * seat.clearance, out=np.zeros_like(moving), where=size > 0)
            loop = 1.0 - (pointer * own[count]).real
            free = (state.eps < LARGEST_ECCENTRICITY) & (loop != 0)  # zero where the orbit fills the gap
            orbit = (pointer / np.where(free, loop, np.inf) * own[:count]).real
            for slope in slopes:
                slope[:count] += slope[count] * orbit
        by_theta = [slope[:count] for slope in slopes]
        return self._read(values), np.moveaxis(self._read(by_theta), 0, -1)

    def _slopes(
        self, left: ComplexArray, by_kappa: ComplexArray, known: KnownStiffness | None, right: ComplexArray, count: int
    ) -> ComplexArray:
        """``-left dkappa right`` by the parameters and, last, by eccentricity, shape ``(P + 1, ..., L)``."""
        graph = line_stiffness(self.model)
        total = np.zeros((count + 1, *left.shape[1:]), dtype=complex)
        products: dict[tuple[int, int], ComplexArray] = {}
        for value, place, row, column in zip(by_kappa, graph.inputs, graph.rows, graph.columns, strict=True):
            if (row, column) not in products:
                products[row, column] = left[row] * right[column]
            total[place] -= products[row, column] * value
        if known is not None:
            for place, slope in zip(known.inputs.tolist(), known.slopes, strict=True):
                total[place] -= np.einsum("i...,ij...,j...->...", left, slope, right)
        return total


def eccentricity_of_reading(model: RotorModel, theta: Float, group: Index, reading: Float) -> tuple[Float, Float]:
    """Eccentricities by the journal's probe, ``(..., L)``, and slopes by parameters, ``(..., L, P)`` or ``(1,)``."""
    functions = model.functions
    if not (functions.has_probe_factors and model.eccentricity_dependent):
        return reading, np.zeros(1)
    at = journal(model).at
    factor = functions.factors(theta)[..., group, at].real
    slope = functions.factor_jacobian(theta)[..., group, at, :].real
    with np.errstate(divide="ignore", invalid="ignore"):  # a factor of zero is a bound
        eps = np.where(reading == 0, 0.0, reading / factor)
        by_theta = np.where((eps < LARGEST_ECCENTRICITY)[..., None], -(eps / factor)[..., None] * slope, 0.0)
    return np.minimum(eps, LARGEST_ECCENTRICITY), by_theta


def resized(model: RotorModel, factor: float) -> RotorModel:
    """The model in a bearing of another clearance."""
    other = copy(model)
    other.clearance = factor * (model.clearance or 0.0)
    return other
