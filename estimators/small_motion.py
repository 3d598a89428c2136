"""Observations of small motion about an off-centre equilibrium: forced responses and free vibration."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from rotorfit.estimators.nonlinear import entries
from rotorfit.models import RotorModel
from rotorfit.models.array_types import ComplexArray, Float, Index
from rotorfit.models.journal import journal
from rotorfit.models.off_centre import coupled_stiffness, off_centre_eigenvalues, off_centre_gradient


@dataclass(frozen=True, eq=False, kw_only=True)
class OffCentreResponses:
    """Small responses to circular forces about an off-centre equilibrium; the fluid couples both directions.

    Attributes:
        model: the rotor.
        speed, frequency: rad/s, frequency signed by the sense of the force, shape ``(L,)``.
        force: generalised force in complex coordinates, shape ``(L, n)``.
        eccentricity, attitude: static position of the journal in each line: |z_s| over clearance, and its angle in
            rad.
        group: parameter group of each line.
        line, coordinate: line and complex coordinate of each reading, shape ``(R,)``.
        vertical: whether a reading is that of the y probe, shape ``(R,)``.
        measured: phasors relative to ``exp(+j|w|t)``; sigma, label, run, labels: see
            :class:`~rotorfit.estimators.observations.Block`.
    """

    model: RotorModel
    speed: Float
    frequency: Float
    force: ComplexArray
    eccentricity: Float
    attitude: Float
    group: Index
    line: Index
    coordinate: Index
    vertical: NDArray[np.bool_]
    measured: ComplexArray
    sigma: Float
    label: Index
    labels: tuple[str, ...]
    run: NDArray[np.str_]

    @property
    def reading_group(self) -> Index:
        """Group of each reading."""
        return self.group[self.line]

    def _solve(self, theta: Float) -> tuple[ComplexArray, ComplexArray]:
        """Receptance of (A, conj(B)), shape ``(L, 2n, 2n)``, and these amplitudes, shape ``(L, 2n)``."""
        stiffness = coupled_stiffness(
            self.model, theta[self.group], self.frequency, self.speed, self.eccentricity, self.attitude
        )
        back = (self.frequency < 0)[:, None]
        drive = np.concatenate([np.where(back, 0.0, self.force), np.where(back, self.force.conj(), 0.0)], axis=1)
        H = np.linalg.inv(stiffness)
        return np.asarray(H), np.einsum("lij,lj->li", H, drive)

    def _read(self, pairs: ComplexArray) -> ComplexArray:
        """Probe phasors ``X = A + conj(B)``, ``Y = -j (A - conj(B))`` from (A, conj(B)) of each line along axis 1."""
        n = pairs.shape[1] // 2
        A, B = pairs[self.line, self.coordinate], pairs[self.line, n + self.coordinate]
        vertical = self.vertical.reshape(-1, *[1] * (A.ndim - 1))
        return np.asarray(np.where(vertical, -1j * (A - B), A + B))

    def with_noise(self, factor: Float) -> Self:
        """See :meth:`~rotorfit.estimators.observations.Block.with_noise`."""
        return replace(self, sigma=self.sigma * factor)

    def predict(self, theta: Float) -> ComplexArray:
        """See :meth:`~rotorfit.estimators.observations.Block.predict`."""
        return self._read(self._solve(theta)[1])

    def predict_jacobian(self, theta: Float) -> tuple[ComplexArray, ComplexArray]:
        """See :meth:`~rotorfit.estimators.observations.Block.predict_jacobian`."""
        H, amplitude = self._solve(theta)
        left = self._read(H)
        right = amplitude[self.line]
        vectors, n = theta[self.group], self.force.shape[1]
        total = np.zeros((theta.shape[1] + 2, self.line.size), dtype=complex)
        s = 1j * np.abs(self.frequency)[self.line]
        for power, row, column, inputs, values in entries(self.model, vectors, self.speed, self.eccentricity):
            ahead = left[:, row] * right[:, column] * s**power
            behind = left[:, n + row] * right[:, n + column] * s**power
            for place, value in zip(inputs.tolist(), values, strict=True):
                total[place] -= ahead * value[self.line] + behind * value.conj()[self.line]
        slopes = total[: theta.shape[1]]
        if self.model.shaft is not None:
            self._known(vectors, left, right, slopes)
        seat = journal(self.model)
        turn = np.exp(2j * self.attitude[self.line])
        ahead, behind = right[:, seat.at], right[:, n + seat.at]
        by_coupling = left[:, seat.at] * (ahead + turn * behind)
        by_conjugate = left[:, n + seat.at] * (turn.conj() * ahead + behind)
        coupling = seat.coupling_jacobian(vectors, self.speed, self.eccentricity)[:, self.line]
        slopes -= by_coupling * coupling + by_conjugate * coupling.conj()
        return self._read(amplitude), slopes.T

    def _known(self, vectors: Float, left: ComplexArray, right: ComplexArray, slopes: ComplexArray) -> None:
        """Add what the scale factors of a known structure change."""
        n, w = self.force.shape[1], np.abs(self.frequency)
        ahead = self.model.known_stiffness(vectors, 1j * w, self.speed)
        behind = self.model.known_stiffness(vectors, -1j * w, self.speed)
        for place, forward, backward in zip(ahead.inputs.tolist(), ahead.slopes, behind.slopes, strict=True):
            slopes[place] -= np.einsum("ri,rij,rj->r", left[:, :n], forward[self.line], right[:, :n])
            slopes[place] -= np.einsum("ri,rij,rj->r", left[:, n:], backward[self.line].conj(), right[:, n:])


@dataclass(frozen=True, eq=False, kw_only=True)
class FreeVibrations:
    """Eigenvalues of small free motion about equilibria, each the one nearest to what was measured.

    Attributes:
        model: the rotor.
        speed, eccentricity: rotative speed, rad/s, and static eccentricity of the journal, shape ``(R,)``.
        reading_group: parameter group, shape ``(R,)``.
        measured: eigenvalues ``s = -zeta |s| + j w_d``, 1/s; sigma, label, run, labels: see
            :class:`~rotorfit.estimators.observations.Block`.
    """

    model: RotorModel
    speed: Float
    eccentricity: Float
    reading_group: Index
    measured: ComplexArray
    sigma: Float
    label: Index
    labels: tuple[str, ...]
    run: NDArray[np.str_]

    def with_noise(self, factor: Float) -> Self:
        """See :meth:`~rotorfit.estimators.observations.Block.with_noise`."""
        return replace(self, sigma=self.sigma * factor)

    def predict(self, theta: Float) -> ComplexArray:
        """See :meth:`~rotorfit.estimators.observations.Block.predict`."""
        found = self._spectra(theta)
        distance = np.abs(found - self.measured[:, None])
        nearest = np.nanargmin(distance, axis=1)
        return np.asarray(found[np.arange(nearest.size), nearest])

    def _spectra(self, theta: Float) -> ComplexArray:
        """Eigenvalues of every line along axis 1."""
        vectors = theta[self.reading_group]
        if self.model.shaft is None:
            return off_centre_eigenvalues(self.model, vectors, self.speed, self.eccentricity)
        lines = zip(vectors, self.speed.tolist(), self.eccentricity.tolist(), strict=True)
        return np.array([off_centre_eigenvalues(self.model, *line) for line in lines])

    def predict_jacobian(self, theta: Float) -> tuple[ComplexArray, ComplexArray]:
        """See :meth:`~rotorfit.estimators.observations.Block.predict_jacobian`."""
        s = self.predict(theta)
        return s, off_centre_gradient(self.model, theta[self.reading_group], self.speed, self.eccentricity, s)
