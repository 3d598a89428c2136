"""Tabulated coefficients of a fluid at eccentricities as observations of a model's journal."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from rotorfit.models import RotorModel
from rotorfit.models.array_types import ComplexArray, Float, Index, Text
from rotorfit.models.motion.journal import journal


@dataclass(frozen=True, eq=False, kw_only=True)
class JournalCoefficients:
    """Stiffness, damping and mass at the journal, one observation each for every row of a table. An observation is
    ``kxx + j kxy``, ``cxx + j cxy`` or ``mxx + j mxy``, its parts over their own standard deviations, which differ by
    decades; ``mxy = 0`` in an isotropic fluid. Rows follow one another power by power."""

    model: RotorModel  # the rotor; what else acts at the journal (mass, springs) belongs to the coefficients too
    speed: Float  # shape ``(L,)``
    eccentricity: Float  # shape ``(L,)``
    group: Index  # parameter group of each row, shape ``(L,)``
    spread: Float  # standard deviation of the real and of the imaginary part of each observation, shape ``(3 L, 2)``
    measured: ComplexArray
    label: Index
    labels: tuple[str, ...]
    run: Text

    @property
    def sigma(self) -> Float:
        """One: the observations are whitened already."""
        return np.ones(self.measured.size)

    @property
    def reading_group(self) -> Index:
        """Group of each observation."""
        return np.tile(self.group, 3)

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

    def with_noise(self, factor: Float) -> Self:
        """See :meth:`~rotorfit.estimators.blocks.observations.Block.with_noise`."""
        return replace(self, spread=self.spread * factor[:, None], measured=self.measured / factor)

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
