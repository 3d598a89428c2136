"""Observations of spectral lines of a shaft that is not round, and of its twist."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from rotorfit.models import AnisotropicShaft
from rotorfit.models.array_types import ComplexArray, Float, Index
from rotorfit.models.combination_lines import Order, line_order

Text = NDArray[np.str_]


@dataclass(frozen=True, eq=False, kw_only=True)
class LineResponses:
    """Lines under rotating forces, or without a force, one a reading, all of shape ``(R,)``.

    Attributes:
        model: the shaft.
        speed, frequency: Om and w, rad/s.
        force: complex amplitude of the force at w, N.
        direction: ``z`` or ``twist``.
        line: name of the line.
        reading_group: parameter group.
        measured, sigma, label, labels, run: see :class:`~rotorfit.estimators.observations.Block`.
    """

    model: AnisotropicShaft
    speed: Float
    frequency: Float
    force: ComplexArray
    direction: Text
    line: Text
    reading_group: Index
    measured: ComplexArray
    sigma: Float
    label: Index
    labels: tuple[str, ...]
    run: Text

    def kinds(self) -> Iterator[tuple[str, Order, Index]]:
        """Direction and orders of each kind of line, with its readings."""
        kinds = list(zip(self.direction.tolist(), self.line.tolist(), strict=True))
        for direction, line in dict.fromkeys(kinds):
            rows = np.flatnonzero((self.direction == direction) & (self.line == line))
            yield direction, line_order(direction, line), rows

    def predict(self, theta: Float) -> ComplexArray:
        """See :meth:`~rotorfit.estimators.observations.Block.predict`."""
        predicted = np.empty(self.measured.size, dtype=complex)
        for direction, order, rows in self.kinds():
            vectors = theta[self.reading_group[rows]]
            predicted[rows] = self.model.lines(
                vectors, direction, order, self.frequency[rows], self.speed[rows], self.force[rows]
            )
        return predicted

    def predict_jacobian(self, theta: Float) -> tuple[ComplexArray, ComplexArray]:
        """See :meth:`~rotorfit.estimators.observations.Block.predict_jacobian`."""
        predicted = np.empty(self.measured.size, dtype=complex)
        jacobian = np.empty((self.measured.size, theta.shape[1]), dtype=complex)
        for direction, order, rows in self.kinds():
            vectors = theta[self.reading_group[rows]]
            predicted[rows], jacobian[rows] = self.model.lines_jacobian(
                vectors, direction, order, self.frequency[rows], self.speed[rows], self.force[rows]
            )
        return predicted, jacobian

    def with_noise(self, factor: Float) -> Self:
        """See :meth:`~rotorfit.estimators.observations.Block.with_noise`."""
        return replace(self, sigma=self.sigma * factor)
