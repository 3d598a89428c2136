"""Observations about an off-centre equilibrium: forced responses, free vibration, and tabulated coefficients."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace

import numpy as np

from rotorfit.base.array_types import Bool, ComplexArray, Float, Index
from rotorfit.estimators.blocks.nonlinear import eccentricity_of_reading, resized
from rotorfit.estimators.blocks.observations import Observed, Responses
from rotorfit.estimators.blocks.response import inverse_of_lines, read_by_probes, read_by_probes_jacobian
from rotorfit.models import RotorModel
from rotorfit.models.motion.journal import journal, known_structure, line_stiffness
from rotorfit.models.motion.neglected_terms import LeftOut
from rotorfit.models.motion.off_centre import (
    coupled_stiffness,
    off_centre_eigenvalues,
    off_centre_gradient,
    off_centre_shift,
)


@dataclass(frozen=True, eq=False, kw_only=True)
class OffCentreResponses(Observed):
    """Small responses to circular forces about an off-centre equilibrium, phasors relative to ``exp(+j|w|t)``."""

    speed: Float  # rad/s, shape ``(L,)``
    frequency: Float  # rad/s, signed by the sense of the force, shape ``(L,)``
    force: ComplexArray  # generalised force in complex coordinates, shape ``(L, n)``
    eccentricity: Float  # of the static position of the journal in each line as its probe read it: |z_s| over clearance
    attitude: Float  # angle of that position, rad
    group: Index  # parameter group of each line
    line: Index  # line of each reading, shape ``(R,)``
    coordinate: Index  # complex coordinate of each reading, shape ``(R,)``
    vertical: Bool  # whether a reading is that of the y probe, shape ``(R,)``

    @property
    def reading_group(self) -> Index:
        """Group of each reading."""
        return self.group[self.line]

    @property
    def centred(self) -> bool:
        """See :class:`~rotorfit.estimators.blocks.observations.Asked`."""
        return False

    @property
    def over_clearance(self) -> bool:
        """See :class:`~rotorfit.estimators.blocks.observations.Asked`."""
        return True

    @property
    def by_turning_phase(self) -> ComplexArray:
        """See :class:`~rotorfit.estimators.blocks.observations.Asked`."""
        return np.full(self.measured.size, 1j)

    def measured_eccentricity(self, theta: Float) -> Float:
        """Static eccentricity of the journal in each line, the factor of its probe taken out, shape ``(..., L)``."""
        return eccentricity_of_reading(journal(self.model), theta, self.group, self.eccentricity)[0]

    def at_small_orbits(self, limit: float) -> Responses:
        """Readings of each probe as of circular orbits: what is anisotropic cancels between x and y."""
        turned = np.where(self.vertical, 1j * self.measured, self.measured)
        turned = np.where(self.frequency[self.line] < 0, np.where(self.vertical, -turned, turned).conj(), turned)
        columns = {f.name: getattr(self, f.name) for f in fields(Responses) if hasattr(self, f.name)}
        return Responses(**{**columns, "measured": turned})

    def in_clearance(self, factor: float) -> OffCentreResponses:
        """See :class:`~rotorfit.estimators.blocks.observations.Asked`."""
        return replace(self, model=resized(self.model, factor), eccentricity=self.eccentricity / factor)

    def _solve(self, theta: Float, eps: Float) -> tuple[Float, ComplexArray, ComplexArray]:
        """Vectors of the lines, receptance ``(2n, 2n, ..., L)`` of (A, conj(B)), and amplitudes, ``(2n, ..., L)``."""
        vectors = theta if theta.shape[-2] == 1 else theta[..., self.group, :]
        stiffness = coupled_stiffness(self.model, vectors, self.frequency, self.speed, eps, self.attitude)
        back = (self.frequency < 0)[:, None]
        drive = np.concatenate([np.where(back, 0.0, self.force), np.where(back, self.force.conj(), 0.0)], axis=1)
        H = inverse_of_lines(np.moveaxis(stiffness, (-2, -1), (0, 1)))
        return vectors, H, np.einsum("ij...l,lj->i...l", H, drive)

    def _read(self, pairs: ComplexArray) -> ComplexArray:
        """Probe phasors ``X = A + conj(B)``, ``Y = -j (A - conj(B))`` of (A, conj(B)) of each line."""
        n = pairs.shape[0] // 2
        A, B = pairs[self.coordinate, ..., self.line], pairs[n + self.coordinate, ..., self.line]
        vertical = self.vertical.reshape(-1, *[1] * (A.ndim - 1))
        return np.moveaxis(np.where(vertical, -1j * (A - B), A + B), 0, -1)

    def predict(self, theta: Float) -> ComplexArray:
        """See :meth:`~rotorfit.estimators.blocks.observations.Block.predict`."""
        return read_by_probes(self, theta, self._read(self._solve(theta, self.measured_eccentricity(theta))[2]))

    def predict_jacobian(self, theta: Float) -> tuple[ComplexArray, ComplexArray]:
        """See :meth:`~rotorfit.estimators.blocks.observations.Block.predict_jacobian`."""
        eps, rest = eccentricity_of_reading(journal(self.model), theta, self.group, self.eccentricity)
        vectors, H, amplitude = self._solve(theta, eps)
        n, count = amplitude.shape[0] // 2, theta.shape[-1]
        left, right = self._read(H), amplitude[..., self.line]
        total = np.zeros((count + 1, *right.shape[1:]), dtype=complex)  # last by the eccentricity
        w, graph = np.abs(self.frequency), line_stiffness(self.model)
        slopes = [graph.slopes(vectors, sense * w, self.speed, eps)[..., self.line] for sense in (1, -1)]
        for place, row, column, forward, backward in zip(graph.inputs, graph.rows, graph.columns, *slopes, strict=True):
            total[place] -= left[row] * right[column] * forward
            total[place] -= left[n + row] * right[n + column] * backward.conj()
        if self.model.shaft is not None:  # what its scale factors change
            ahead = known_structure(self.model, vectors, 1j * w, self.speed)
            behind = known_structure(self.model, vectors, -1j * w, self.speed)
            product = "i...,ij...,j...->..."
            for place, forward, backward in zip(ahead.inputs.tolist(), ahead.slopes, behind.slopes, strict=True):
                total[place] -= np.einsum(product, left[:n], forward[..., self.line], right[:n])
                total[place] -= np.einsum(product, left[n:], backward[..., self.line].conj(), right[n:])
        seat = journal(self.model)
        turn = np.exp(2j * self.attitude[self.line])
        own, image = right[seat.at], right[n + seat.at]
        by_coupling = left[seat.at] * (own + turn * image)
        by_conjugate = left[n + seat.at] * (turn.conj() * own + image)
        coupling = seat.coupling_jacobian(vectors, self.speed, eps)[..., self.line]
        total -= by_coupling * coupling + by_conjugate * coupling.conj()
        by_theta = np.moveaxis(total[:-1], 0, -1)
        if rest.any():
            by_theta = by_theta + total[-1][..., None] * rest[..., self.line, :]
        return read_by_probes_jacobian(self, theta, self._read(amplitude), by_theta)


@dataclass(frozen=True, eq=False, kw_only=True)
class FreeVibrations(Observed):
    """Eigenvalues of small free motion about equilibria, each nearest to a measured ``s = -zeta |s| + j w_d``, 1/s."""

    speed: Float  # rotative speed, rad/s, shape ``(R,)``
    eccentricity: Float  # of the static position of the journal, as given or as its probe read it, shape ``(R,)``
    position_read: Bool  # whether its probe read it, shape ``(R,)``
    reading_group: Index  # parameter group, shape ``(R,)``

    @property
    def of_motion(self) -> bool:
        """See :class:`~rotorfit.estimators.blocks.observations.Asked`."""
        return False

    @property
    def shows_eccentricity(self) -> bool:
        """See :class:`~rotorfit.estimators.blocks.observations.Asked`."""
        return self.model.eccentricity_dependent and bool((self.eccentricity > 0).any())

    @property
    def tells_sense(self) -> bool:
        """See :class:`~rotorfit.estimators.blocks.observations.Asked`."""
        return False

    def measured_eccentricity(self, theta: Float) -> Float:
        """Static eccentricity of the journal, the factor of its probe taken out, shape ``(..., R)``."""
        return self._at_rest(theta)[0]

    def in_clearance(self, factor: float) -> FreeVibrations:
        """See :class:`~rotorfit.estimators.blocks.observations.Asked`; eccentricities that were given stay."""
        eccentricity = np.where(self.position_read, self.eccentricity / factor, self.eccentricity)
        return replace(self, model=resized(self.model, factor), eccentricity=eccentricity)

    @property
    def speed_read(self) -> Float:
        """See :class:`~rotorfit.estimators.blocks.observations.Asked`."""
        return self.speed

    def at_speeds(self, factor: float) -> FreeVibrations:
        """See :class:`~rotorfit.estimators.blocks.observations.Asked`."""
        return replace(self, speed=self.speed * factor)

    def shifted(self, theta: Float, term: Callable[[RotorModel, Float, float], LeftOut | None]) -> ComplexArray:
        """See :class:`~rotorfit.estimators.blocks.observations.Asked`."""
        eps, s = np.broadcast_to(self.measured_eccentricity(theta), self.speed.shape), self.predict(theta)
        found = np.zeros(s.size, dtype=complex)
        for row, vector in enumerate(theta[self.reading_group]):
            ahead, behind = (term(self.model, vector, way * float(s[row].imag)) for way in (1, -1))
            if ahead is not None and behind is not None:
                at = float(self.speed[row]), float(eps[row]), complex(s[row])
                found[row] = off_centre_shift(self.model, vector, *at, ahead, behind)
        return found

    def _at_rest(self, theta: Float) -> tuple[Float, Float]:
        """Static eccentricities and their derivatives, those that were given being what they are."""
        if not self.model.eccentricity_dependent:
            return self.eccentricity, np.zeros(1)
        seat, read = journal(self.model), self.position_read
        eps, by_theta = eccentricity_of_reading(seat, theta, self.reading_group, self.eccentricity)
        return np.where(read, eps, self.eccentricity), by_theta * read[:, None]

    def predict(self, theta: Float) -> ComplexArray:
        """See :meth:`~rotorfit.estimators.blocks.observations.Block.predict`."""
        if self.model.shaft is not None and theta.ndim > 2:  # eigenvalues of one rotor at a time
            return np.array([self.predict(one) for one in theta])
        vectors = theta[..., self.reading_group, :]
        if self.model.shaft is None:
            found = off_centre_eigenvalues(self.model, vectors, self.speed, self.measured_eccentricity(theta))
        else:
            lines = zip(vectors, self.speed.tolist(), self.eccentricity.tolist(), strict=True)
            found = np.array([off_centre_eigenvalues(self.model, *line) for line in lines])
        nearest = np.nanargmin(np.abs(found - self.measured[:, None]), axis=-1)
        return np.asarray(np.take_along_axis(found, nearest[..., None], axis=-1)[..., 0])

    def predict_jacobian(self, theta: Float) -> tuple[ComplexArray, ComplexArray]:
        """See :meth:`~rotorfit.estimators.blocks.observations.Block.predict_jacobian`."""
        s = self.predict(theta)
        if self.model.shaft is not None and theta.ndim > 2:
            return s, np.array([self.predict_jacobian(one)[1] for one in theta])
        eps, rest = self._at_rest(theta)
        slopes = off_centre_gradient(self.model, theta[..., self.reading_group, :], self.speed, eps, s)
        by_theta = slopes[..., :-1]
        return s, by_theta + slopes[..., -1:] * rest if rest.any() else by_theta


@dataclass(frozen=True, eq=False, kw_only=True)
class JournalCoefficients(Observed):
    """Stiffness, damping and mass at the journal, one observation each for every row of a table. An observation is
    ``kxx + j kxy``, ``cxx + j cxy`` or ``mxx + j mxy``, its parts over their own standard deviations, which differ by
    decades, so that ``sigma`` is one. ``mxy = 0`` in an isotropic fluid. Rows follow one another power by power. What
    else acts at the journal (mass, springs) belongs to the coefficients too."""

    speed: Float  # shape ``(L,)``
    eccentricity: Float  # shape ``(L,)``
    group: Index  # parameter group of each row, shape ``(L,)``
    spread: Float  # standard deviation of the real and of the imaginary part of each observation, shape ``(3 L, 2)``

    @property
    def reading_group(self) -> Index:
        """Group of each observation."""
        return np.tile(self.group, 3)

    @property
    def of_motion(self) -> bool:
        """See :class:`~rotorfit.estimators.blocks.observations.Asked`."""
        return False

    def measured_eccentricity(self, theta: Float) -> Float:
        """Eccentricity of each row."""
        return self.eccentricity

    @property
    def _at(self) -> int:
        """Coordinate of the journal; a model that does not change with eccentricity has no more than one."""
        if self.model.eccentricity_dependent:
            return journal(self.model).at
        if len(self.model.coordinates) > 1:
            raise ValueError(f"{self.model.name} has several coordinates, and no law that says which is the journal's")
        return 0

    def _whitened(self, values: ComplexArray) -> ComplexArray:
        """Conjugates of values of shape ``(..., 3 L)``, their parts over the standard deviations."""
        real, imag = self.spread.T
        # The complex stiffness is kxx - j kxy.
        return np.asarray(values.real / real - 1j * values.imag / imag)

    def predict(self, theta: Float) -> ComplexArray:
        """See :meth:`~rotorfit.estimators.blocks.observations.Block.predict`."""
        at = self._at
        C = self.model.coefficients(theta[..., self.group, :], self.speed, self.eccentricity)[..., :3, at, at]
        return self._whitened(np.swapaxes(C, -1, -2).reshape(*C.shape[:-2], -1))

    def predict_jacobian(self, theta: Float) -> tuple[ComplexArray, ComplexArray]:
        """See :meth:`~rotorfit.estimators.blocks.observations.Block.predict_jacobian`."""
        at = self._at
        jacobian = self.model.functions.jacobian(theta[..., self.group, :], self.speed, self.eccentricity)
        shape = theta.shape[:-2]
        slopes = np.zeros((*shape, theta.shape[-1] + 2, 3, self.speed.size), dtype=complex)
        chosen = np.flatnonzero((jacobian.rows == at) & (jacobian.columns == at) & (jacobian.powers < 3))
        for entry in chosen.tolist():
            slopes[..., jacobian.inputs[entry], jacobian.powers[entry], :] += jacobian.values[..., entry]
        rows = self._whitened(slopes[..., :-2, :, :].reshape(*shape, theta.shape[-1], -1))
        return self.predict(theta), np.swapaxes(rows, -1, -2)
