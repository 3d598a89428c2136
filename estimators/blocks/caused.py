"""Responses of a linear rotor with what its model does not hold: more stiffness, values of their own, readings off."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

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
    high_pass: float  # corner of the one that is in it, rad/s
    _seen: Any = field(
        default=None, init=False
    )  # parameter vectors that predictions were last asked for, and what probes without causes read
    _seen_jacobian: Any = field(default=None, init=False)  # likewise of derivatives

    @property
    def linear(self) -> Responses:
        """See :class:`~rotorfit.estimators.blocks.observations.Asked`."""
        return self.own

    @cached_property
    def own(self) -> Responses:
        """The responses with the stiffness, each (group, speed) a group of its own."""
        beside = self.base.beside
        if self.stiffness is not None:
            beside = self.stiffness if beside is None else beside + self.stiffness
        return replace(self.base, beside=beside, group=self.base.condition[0], speed=self.speed, force=self.force)

    @cached_property
    def seen(self) -> Responses:
        """:attr:`own`, and after it the same as the probes would read that are where some are off to."""
        own = self.own
        if not self.way.any():
            return own
        names = ("line", "measured", "sigma", "label", "run", "derivative")
        twice: dict[str, Any] = {
            name: np.concatenate([one, one]) for name in names if (one := getattr(own, name)) is not None
        }
        return replace(own, coordinate=np.concatenate([own.coordinate, self.towards]), **twice)

    def values(self, theta: Float) -> Float:
        """Parameter vectors of the groups of :attr:`own`."""
        return np.asarray(theta[..., self.base.condition[1], :] * (1 + self.scaled) + self.added)

    @property
    def by_causes(self) -> ComplexArray:
        """See :class:`~rotorfit.estimators.blocks.observations.Asked`."""
        return self.gain

    @property
    def corner(self) -> float:
        """See :class:`~rotorfit.estimators.blocks.observations.Asked`."""
        return self.high_pass

    def seen_by_probes(self, motion: ComplexArray) -> ComplexArray:
        """See :class:`~rotorfit.estimators.blocks.observations.Asked`: of some between two planes."""
        found = motion[self.base.line, self.base.coordinate]
        return (1 - self.way) * found + self.way * motion[self.base.line, self.towards] if self.way.any() else found

    def at_speeds(self, factor: float) -> CausedResponses:
        """See :class:`~rotorfit.estimators.blocks.observations.Asked`."""
        return replace(self, speed=self.speed * factor)

    def with_readings(self, *, moved: ComplexArray, gain: ComplexArray, corner: float) -> CausedResponses:
        """The same with other motion beside the rotor's and other factors; what was worked out of the rotor goes
        along."""
        found = copy(self)
        object.__setattr__(found, "moved", moved)
        object.__setattr__(found, "gain", gain)
        object.__setattr__(found, "high_pass", corner)
        return found

    def predict(self, theta: Float) -> ComplexArray:
        """See :meth:`~rotorfit.estimators.blocks.observations.Block.predict`."""
        if self._seen is None or not np.array_equal(self._seen[0], theta):  # of the curve of a probe, and of residuals
            values = self.values(theta)
            object.__setattr__(self, "_seen", (theta, self._between(self.seen.predict(values), values)))
        return np.asarray((self._seen[1] + self.moved) * self.gain)

    def by_values(self, theta: Float) -> tuple[ComplexArray, ComplexArray]:
        """Predictions, and their derivatives by the values of each reading's own group, shape ``(R, P)``."""
        if self._seen_jacobian is None or not np.array_equal(self._seen_jacobian[0], theta):  # of columns, and of a fit
            values = self.values(theta)
            seen, rows = (self._between(part, values) for part in self.seen.predict_jacobian(values))
            object.__setattr__(self, "_seen_jacobian", (theta, seen, rows))
        _, seen, rows = self._seen_jacobian
        return (seen + self.moved) * self.gain, rows * self.gain[:, None]

    def predict_jacobian(self, theta: Float) -> tuple[ComplexArray, ComplexArray]:
        """See :meth:`~rotorfit.estimators.blocks.observations.Block.predict_jacobian`."""
        predicted, rows = self.by_values(theta)
        return predicted, rows * (1 + self.scaled)[self.own.reading_group]

    def _between(self, seen: ComplexArray, values: Float) -> ComplexArray:
        """What probes give that are between two planes, each by its own factor, of values at both, ``(2 R, ...)``."""
        if not self.way.any():
            return seen
        factor, other = np.split(probe_factors(self.seen, values), 2)
        here, there = np.split(seen, 2)
        # A probe whose factor is zero reads nothing, which tells nothing of the motion there.
        more = np.divide(self.way * factor, other, out=np.zeros_like(other), where=other != 0)
        column = (-1, *(1,) * (seen.ndim - 1))
        return np.asarray((1 - self.way).reshape(column) * here + more.reshape(column) * there)
