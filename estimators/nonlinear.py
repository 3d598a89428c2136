"""Observations of a rotor whose fluid changes with eccentricity, with exact sensitivities."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from rotorfit.estimators.correlated import CorrelatedResponses
from rotorfit.estimators.observations import OnResponses, Responses
from rotorfit.estimators.response import dynamic_stiffness, inverse
from rotorfit.models import RotorModel
from rotorfit.models.array_types import ComplexArray, Float, Index
from rotorfit.models.journal import Journal, journal
from rotorfit.models.orbits import LARGEST_ECCENTRICITY, OrbitEquation, followed_roots, nearest_roots

OrbitBranch = Literal["nearest", "followed", "given"]


def entries(
    model: RotorModel, theta: Float, speed: Float, eps: Float
) -> Iterator[tuple[int, int, int, Index, ComplexArray]]:
    """Derivatives of the coefficients, gathered by the place (power, row, column) they change.

    Yields power, row, column, the inputs and the values, shape ``(inputs, L)``.
    """
    jacobian = model.functions.jacobian(theta, speed, eps)
    places = np.column_stack([jacobian.powers, jacobian.rows, jacobian.columns])
    distinct, place = np.unique(places, axis=0, return_inverse=True)
    for number, (power, row, column) in enumerate(distinct.tolist()):
        chosen = np.flatnonzero(place.reshape(-1) == number)
        yield power, row, column, jacobian.inputs[chosen], jacobian.values[:, chosen].T


@dataclass(frozen=True, eq=False)
class _State:
    """Orbits at a parameter vector.

    Attributes:
        theta: parameter vector of each line, shape ``(L, P)``.
        eps: journal's eccentricity, shape ``(L,)``.
        H: receptance at that eccentricity, shape ``(L, n, n)``.
        amplitude: response of every coordinate, shape ``(L, n)``.
    """

    theta: Float
    eps: Float
    H: ComplexArray
    amplitude: ComplexArray


@dataclass(frozen=True, eq=False)
class OrbitResponses(OnResponses):
    """Centred orbits under circular forces, or displacements under constant loads (w = 0), of a nonlinear rotor.

    The journal's eccentricity solves ``kappa(w, |A_b|) A = F``; see :mod:`rotorfit.models.orbits`.

    Attributes:
        base: the readings, as of a linear rotor.
        eccentricity: measured eccentricity of the journal in each line, NaN where it was not measured, shape
            ``(L,)``.
        mode: which root: the ``nearest`` to the measured eccentricity, or that which a sweep reaches when it is
            ``followed`` line by line; or the eccentricity is ``given``, which leaves an explicit equation.
        sweep: number of the sweep of each line, for ``followed``; lines are in the sweep's order.
    """

    eccentricity: Float
    mode: OrbitBranch
    sweep: Index

    @property
    def journal(self) -> Journal:
        """Where the eccentricity enters."""
        return journal(self.model)

    def frozen(self) -> OrbitResponses:
        """The same with the measured eccentricities taken as given: explicit, a good place to start a fit from.

        Where it was not measured the journal is taken as centred.
        """
        return replace(self, mode="given", eccentricity=np.nan_to_num(self.eccentricity))

    def lines(self, keep: NDArray[np.bool_]) -> OrbitResponses:
        """The observations of some lines."""
        return OrbitResponses(self.base.lines(keep), self.eccentricity[keep], self.mode, self.sweep[keep])

    def orbits(self, theta: Float) -> Float:
        """Eccentricity of the journal in each line, shape ``(L,)``; theta of shape ``(G, P)``."""
        return self._state(theta).eps

    def _state(self, theta: Float) -> _State:
        base, seat = self.base, self.journal
        at, vectors = seat.at, theta[base.group]
        H = inverse(dynamic_stiffness(base, theta))
        centred = np.einsum("lij,lj->li", H, base.force)
        if self.mode == "given":
            eps = np.clip(self.eccentricity, 0.0, LARGEST_ECCENTRICITY)
        else:
            equation = OrbitEquation(
                theta=vectors,
                s=base.s,
                speed=base.speed,
                drive=centred[:, at] / seat.clearance,
                receptance=H[:, at, at],
            )
            if self.mode == "nearest":
                eps = nearest_roots(seat, equation, self.eccentricity)
            else:
                eps = followed_roots(seat, equation, self.sweep)
        delta, _ = seat.change(vectors, base.s, base.speed, eps)
        # Only the entry (b, b) of kappa changes: a rank-one change of its inverse.
        gain = (delta / (1.0 + delta * H[:, at, at]))[:, None]
        column, row = H[:, :, at], H[:, at, :]
        return _State(
            vectors, eps, H - (gain * column)[:, :, None] * row[:, None], centred - gain * column * centred[:, [at]]
        )

    def predict(self, theta: Float) -> ComplexArray:
        """See :meth:`~rotorfit.estimators.observations.Block.predict`."""
        state, line, coordinate = self._state(theta), self.base.line, self.base.coordinate
        if self.base.imposed:
            return np.asarray(self.base.force[line, coordinate] / state.H[line, coordinate, coordinate])
        return np.asarray(state.amplitude[line, coordinate])

    def predict_jacobian(self, theta: Float) -> tuple[ComplexArray, ComplexArray]:
        """See :meth:`~rotorfit.estimators.observations.Block.predict_jacobian`.

        By the implicit function theorem ``d eps = (d|A_b| / clearance) / (1 - d|A_b|/d eps / clearance)``, the
        derivatives on the right those at fixed eccentricity.
        """
        state, line, coordinate = self._state(theta), self.base.line, self.base.coordinate
        if self.base.imposed:
            drive = state.H[line, coordinate, coordinate]
            predicted = self.base.force[line, coordinate] / drive
            slopes, _ = self._slopes(state, line, state.H[line, coordinate], state.H[line, :, coordinate])
            return predicted, slopes * (-predicted / drive)[:, None]
        slopes, by_eps = self._slopes(state, line, state.H[line, coordinate], state.amplitude[line])
        if self.mode != "given":
            slopes += by_eps[:, None] * self._orbit_slopes(state)[line]
        return np.asarray(state.amplitude[line, coordinate]), slopes

    def _orbit_slopes(self, state: _State) -> Float:
        """Derivatives of the eccentricities by the parameters, shape ``(L, P)``; zero where the orbit fills the gap."""
        seat = self.journal
        every = np.arange(state.eps.size)
        slopes, by_eps = self._slopes(state, every, state.H[:, seat.at], state.amplitude)
        moving = state.amplitude[:, seat.at]
        size = np.abs(moving)
        pointer = np.divide(moving.conj(), size * seat.clearance, out=np.zeros_like(moving), where=size > 0)
        loop = 1.0 - (pointer * by_eps).real
        free = (state.eps < LARGEST_ECCENTRICITY) & (loop != 0)
        loop = np.where(free, loop, 1.0)
        return np.where(free[:, None], (pointer[:, None] * slopes).real / loop[:, None], 0.0)

    def _slopes(
        self, state: _State, line: Index, left: ComplexArray, right: ComplexArray
    ) -> tuple[ComplexArray, ComplexArray]:
        """``-left dkappa right`` by the parameters and by eccentricity, shapes ``(Q, P)`` and ``(Q,)``.

        Args:
            state: orbits.
            line: line of each row, shape ``(Q,)``.
            left, right: vectors of each row, shape ``(Q, n)``.
        """
        base, count = self.base, state.theta.shape[1]
        total = np.zeros((count + 2, line.size), dtype=complex)
        s = base.s[line]
        for power, row, column, inputs, values in entries(self.model, state.theta, base.speed, state.eps):
            product = left[:, row] * right[:, column] * s**power if power else left[:, row] * right[:, column]
            for place, value in zip(inputs.tolist(), values, strict=True):
                total[place] -= product * value[line]
        if self.model.shaft is not None:
            known = self.model.known_stiffness(state.theta, base.s, base.speed)
            for place, slope in zip(known.inputs.tolist(), known.slopes, strict=True):
                total[place] -= np.einsum("qi,qij,qj->q", left, slope[line], right)
        return total[:count].T, total[count + 1]


def responses_of(block: object) -> Responses | None:
    """The responses to circular forces or constant loads that a block holds, if any."""
    if isinstance(block, OrbitResponses | CorrelatedResponses):
        return block.base
    return block if isinstance(block, Responses) else None
