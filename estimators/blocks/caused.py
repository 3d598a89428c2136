"""Responses of a linear rotor with what its model does not hold: more stiffness, values of their own, readings off."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from rotorfit.base.array_types import ComplexArray, Float, Index
from rotorfit.estimators.blocks.observations import OnResponses, Responses
from rotorfit.estimators.blocks.response import probe_factors


@dataclass(frozen=True, eq=False, kw_only=True)
class CausedResponses(OnResponses):
    """Responses to circular forces with causes beside the model, of given sizes and in full, not to first order."""

    speed: Float  # true rotative speed of each line, shape ``(L,)``
    force: ComplexArray  # where it truly acts, shape ``(L, n)``
    stiffness: ComplexArray | None  # that acts beside the model's, shape ``(L, n, n)``
    scaled: Float  # share by which each value exceeds that of its group at each distinct speed, shape ``(C, P)``
    added: Float  # what is added to it then, shape ``(C, P)``
    towards: Index  # coordinate towards which the probe of each reading is off, shape ``(R,)``
    way: Float  # share of the way by which it is, shape ``(R,)``
    moved: ComplexArray  # motion beside the rotor's, in units of its readings, shape ``(R,)``
    gain: ComplexArray  # factor of each reading, shape ``(R,)``

    @cached_property
    def own(self) -> Responses:
        """The responses with the stiffness, each (group, speed) a group of its own."""
        beside = self.base.beside
        if self.stiffness is not None:
            beside = self.stiffness if beside is None else beside + self.stiffness
        return replace(self.base, beside=beside, group=self.base.condition[0], speed=self.speed, force=self.force)

    @cached_property
    def beyond(self) -> Responses:
        """The same as the probes would read that are where they are off to."""
        return replace(self.own, coordinate=self.towards)

    def values(self, theta: Float) -> Float:
        """Parameter vectors of the groups of :attr:`own`."""
        return np.asarray(theta[..., self.base.condition[1], :] * (1 + self.scaled) + self.added)

    def predict(self, theta: Float) -> ComplexArray:
        """See :meth:`~rotorfit.estimators.blocks.observations.Block.predict`."""
        values = self.values(theta)
        found = self.own.predict(values)
        if self.way.any():
            found = (1 - self.way) * found + self._way(values) * self.beyond.predict(values)
        return np.asarray((found + self.moved) * self.gain)

    def by_values(self, theta: Float) -> tuple[ComplexArray, ComplexArray]:
        """Predictions, and their derivatives by the values of each reading's own group, shape ``(R, P)``."""
        values = self.values(theta)
        found, rows = self.own.predict_jacobian(values)
        if self.way.any():
            way, (there, more) = self._way(values), self.beyond.predict_jacobian(values)
            found = (1 - self.way) * found + way * there
            rows = (1 - self.way)[:, None] * rows + way[..., None] * more
        return (found + self.moved) * self.gain, rows * self.gain[:, None]

    def predict_jacobian(self, theta: Float) -> tuple[ComplexArray, ComplexArray]:
        """See :meth:`~rotorfit.estimators.blocks.observations.Block.predict_jacobian`."""
        predicted, rows = self.by_values(theta)
        return predicted, rows * (1 + self.scaled)[self.own.reading_group]

    def _way(self, values: Float) -> ComplexArray:
        """Share of the motion at the other plane, read by the probe's own factor."""
        return np.asarray(self.way * probe_factors(self.own, values) / probe_factors(self.beyond, values))
