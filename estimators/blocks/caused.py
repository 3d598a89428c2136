"""Responses of a linear rotor with what its model does not hold: more stiffness, values of their own, readings off."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from rotorfit.base.array_types import ComplexArray, Float
from rotorfit.estimators.blocks.observations import OnResponses, Responses


@dataclass(frozen=True, eq=False, kw_only=True)
class CausedResponses(OnResponses):
    """Responses to circular forces with causes beside the model, of given sizes and in full, not to first order."""

    stiffness: ComplexArray | None  # that acts beside the model's, shape ``(L, n, n)``
    scaled: Float  # share by which each value exceeds that of its group at each distinct speed, shape ``(C, P)``
    added: Float  # what is added to it then, shape ``(C, P)``
    gain: ComplexArray  # factor of each reading, shape ``(R,)``

    @cached_property
    def own(self) -> Responses:
        """The responses with the stiffness, each (group, speed) a group of its own."""
        beside = self.base.beside
        if self.stiffness is not None:
            beside = self.stiffness if beside is None else beside + self.stiffness
        return replace(self.base, beside=beside, group=self.base.condition[0])

    def values(self, theta: Float) -> Float:
        """Parameter vectors of the groups of :attr:`own`."""
        return np.asarray(theta[..., self.base.condition[1], :] * (1 + self.scaled) + self.added)

    def predict(self, theta: Float) -> ComplexArray:
        """See :meth:`~rotorfit.estimators.blocks.observations.Block.predict`."""
        return self.own.predict(self.values(theta)) * self.gain

    def predict_jacobian(self, theta: Float) -> tuple[ComplexArray, ComplexArray]:
        """See :meth:`~rotorfit.estimators.blocks.observations.Block.predict_jacobian`."""
        predicted, rows = self.own.predict_jacobian(self.values(theta))
        return predicted * self.gain, rows * (1 + self.scaled)[self.own.reading_group] * self.gain[:, None]
