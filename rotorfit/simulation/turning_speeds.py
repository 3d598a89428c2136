"""Angles of what turns in a recorded test: at a speed that wanders, swept, or dwelling at one speed after the other."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from rotorfit.models.array_types import ComplexArray, Float

RAMP_TIME = 1.0
"""Time in which a perturbator goes from one dwell to the next, s."""


class Rotation(Protocol):
    """Angle, speed and acceleration over time."""

    def angle(self, t: Float) -> Float:
        """Angle, rad, shape ``(N,)``."""

    def speed(self, t: Float) -> Float:
        """Speed, rad/s, shape ``(N,)``."""

    def acceleration(self, t: Float) -> Float:
        """Acceleration, rad/s^2, shape ``(N,)``."""

    def force(self, t: Float, heavy_spot: float) -> ComplexArray:
        """Force of one kg m as seen from x turning with it, N, shape ``(N,)``."""
        turned = np.exp(1j * (self.angle(t) + heavy_spot))
        return np.asarray((self.speed(t) ** 2 - 1j * self.acceleration(t)) * turned)


@dataclass(frozen=True, kw_only=True, eq=False)
class Wander(Rotation):
    """Angle of a shaft whose speed wanders slowly about its mean: a sum of slow waves."""

    mean: float  # speed, rad/s
    share: float  # standard deviation of the speed over its mean
    rates: Float  # of the waves, rad/s, shape ``(W,)``
    phases: Float  # of the waves, rad, shape ``(W,)``

    @classmethod
    def drawn(cls, mean: float, share: float, rng: np.random.Generator) -> Wander:
        """Waves with periods of some seconds."""
        rates, phases = rng.uniform([[0.2], [0.0]], [[3.0], [2 * np.pi]], (2, 6))
        return cls(mean=mean, share=share, rates=rates, phases=phases)

    def _waves(self, t: Float) -> ComplexArray:
        """The waves, each of size one, shape ``(N, W)``."""
        return np.asarray(np.exp(1j * (np.multiply.outer(t, self.rates) + self.phases)))

    @property
    def _size(self) -> float:
        return self.mean * self.share * math.sqrt(2 / self.rates.size)

    def angle(self, t: Float) -> Float:
        """See :meth:`Rotation.angle`."""
        return np.asarray(self.mean * t + self._size * (self._waves(t).real / self.rates).sum(axis=-1))

    def speed(self, t: Float) -> Float:
        """See :meth:`Rotation.speed`."""
        return np.asarray(self.mean - self._size * self._waves(t).imag.sum(axis=-1))

    def acceleration(self, t: Float) -> Float:
        """See :meth:`Rotation.acceleration`."""
        return np.asarray(-self._size * (self._waves(t).real * self.rates).sum(axis=-1))


@dataclass(frozen=True, kw_only=True)
class Sweep(Rotation):
    """Angle of a perturbator or shaft that is swept, not quite evenly."""

    first: float  # speed at the begin, rad/s
    last: float  # speed at the end, rad/s
    duration: float  # s
    uneven: float = 2e-3  # amplitude of the unevenness of the speed over the range swept

    @property
    def slope(self) -> float:
        """Mean acceleration, rad/s^2."""
        return (self.last - self.first) / self.duration

    @property
    def _wave(self) -> tuple[float, float]:
        return abs(self.last - self.first) * self.uneven, 2 * np.pi * 7.3 / self.duration

    def angle(self, t: Float) -> Float:
        """See :meth:`Rotation.angle`."""
        size, rate = self._wave
        return np.asarray(self.first * t + self.slope * t**2 / 2 - size / rate * (np.cos(rate * t) - 1))

    def speed(self, t: Float) -> Float:
        """See :meth:`Rotation.speed`."""
        size, rate = self._wave
        return np.asarray(self.first + self.slope * t + size * np.sin(rate * t))

    def acceleration(self, t: Float) -> Float:
        """See :meth:`Rotation.acceleration`."""
        size, rate = self._wave
        return np.asarray(self.slope + size * rate * np.cos(rate * t))


@dataclass(frozen=True, kw_only=True, eq=False)
class Dwells(Rotation):
    """Angle of a perturbator that dwells at one speed after the other, with even ramps of :data:`RAMP_TIME` between."""

    speeds: Float  # of each dwell, rad/s, shape ``(D,)``
    each: float  # how long it lasts, s

    @classmethod
    def at(cls, speeds: Sequence[float], each: float) -> Dwells:
        """Dwells one after the other."""
        return cls(speeds=np.asarray(speeds, dtype=float), each=each)

    @property
    def duration(self) -> float:
        """Of all, ramps included, s."""
        return self.speeds.size * self.each + (self.speeds.size - 1) * RAMP_TIME

    def _corners(self) -> tuple[Float, Float, Float]:
        """Times and speeds at which a dwell begins or ends, and the angles there."""
        begin = np.arange(self.speeds.size) * (self.each + RAMP_TIME)
        time = np.stack([begin, begin + self.each], axis=1).ravel()
        speed = np.repeat(self.speeds, 2)
        angle = np.concatenate([[0.0], np.cumsum((speed[1:] + speed[:-1]) / 2 * np.diff(time))])
        return time, speed, angle

    def speed(self, t: Float) -> Float:
        """See :meth:`Rotation.speed`."""
        time, speed, _ = self._corners()
        return np.interp(t, time, speed)

    def acceleration(self, t: Float) -> Float:
        """See :meth:`Rotation.acceleration`."""
        time, speed, _ = self._corners()
        slope = np.append(np.diff(speed) / np.diff(time), 0.0)
        return np.asarray(slope[np.clip(np.searchsorted(time, t, side="right") - 1, 0, slope.size - 1)])

    def angle(self, t: Float) -> Float:
        """See :meth:`Rotation.angle`."""
        time, speed, angle = self._corners()
        at = np.clip(np.searchsorted(time, t, side="right") - 1, 0, time.size - 1)
        into = t - time[at]
        return np.asarray(angle[at] + speed[at] * into + self.acceleration(t) * into**2 / 2)
