"""Responses of a linear rotor with what its model does not hold: more stiffness, values of their own, readings off."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from rotorfit.base.array_types import ComplexArray, Float, Index
from rotorfit.estimators.blocks.observations import OnResponses, Responses


@dataclass(frozen=True, eq=False, kw_only=True)
class CausedResponses(OnResponses):
    """Responses to circular forces with causes beside the model, of given sizes and in full, not to first order."""

    stiffness: ComplexArray | None  # that acts beside the model's, shape ``(L, n, n)``
    scaled: Float  # share by which each value of a line exceeds that of its group, shape ``(L, P)``
    added: Float  # what is added to it then, shape ``(L, P)``
    gain: ComplexArray  # factor of each reading, shape ``(R,)``

    @cached_property
    def _distinct(self) -> tuple[Index, Index]:
        """One line of each distinct set of group and changes, and the set of each line."""
        changed = self.scaled.any(axis=0) | self.added.any(axis=0)
        rows = np.column_stack([self.base.group, self.scaled[:, changed], self.added[:, changed]])
        _, first, index = np.unique(rows, axis=0, return_index=True, return_inverse=True)
        return first, index.reshape(-1)

    @cached_property
    def own(self) -> Responses:
        """The responses with the stiffness, each distinct set of values a group of its own."""
        beside = self.base.beside
        if self.stiffness is not None:
            beside = self.stiffness if beside is None else beside + self.stiffness
        return replace(self.base, beside=beside, group=self._distinct[1])

    def values(self, theta: Float) -> Float:
        """Parameter vectors of the groups of :attr:`own`."""
        first, _ = self._distinct
        return np.asarray(theta[..., self.base.group[first], :] * (1 + self.scaled[first]) + self.added[first])

    def predict(self, theta: Float) -> ComplexArray:
        """See :meth:`~rotorfit.estimators.blocks.observations.Block.predict`."""
        return self.own.predict(self.values(theta)) * self.gain

    def predict_jacobian(self, theta: Float) -> tuple[ComplexArray, ComplexArray]:
        """See :meth:`~rotorfit.estimators.blocks.observations.Block.predict_jacobian`."""
        predicted, rows = self.own.predict_jacobian(self.values(theta))
        return predicted * self.gain, rows * (1 + self.scaled)[self.base.line] * self.gain[:, None]
