"""Angles of what turns in a recorded test: at a speed that wanders, swept, or dwelling at one speed after the other."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from rotorfit.base.array_types import ComplexArray, Float

RAMP_TIME = 1.0
"""Time in which a perturbator goes from one dwell to the next, s."""


class Rotation(Protocol):
    """Angle, speed and acceleration over time."""

    def moves(self, t: Float) -> tuple[Float, Float, Float]:
        """Angle (rad), speed (rad/s) and acceleration (rad/s^2) at some times, shape ``(N,)`` each."""

    def angle(self, t: Float) -> Float:
        """Angle, rad, shape ``(N,)``."""
        return self.moves(t)[0]

    def speed(self, t: Float) -> Float:
        """Speed, rad/s, shape ``(N,)``."""
        return self.moves(t)[1]

    def acceleration(self, t: Float) -> Float:
        """Acceleration, rad/s^2, shape ``(N,)``."""
        return self.moves(t)[2]

    def force(self, t: Float, heavy_spot: float) -> ComplexArray:
        """Force of one kg m as seen from x turning with it, N, shape ``(N,)``."""
        angle, speed, acceleration = self.moves(t)
        return np.asarray((speed**2 - 1j * acceleration) * np.exp(1j * (angle + heavy_spot)))


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

    def moves(self, t: Float) -> tuple[Float, Float, Float]:
        """See :meth:`Rotation.moves`."""
        size = self.mean * self.share * math.sqrt(2 / self.rates.size)
        waves = np.exp(1j * (np.multiply.outer(t, self.rates) + self.phases))
        angle = self.mean * t + size * (waves.real / self.rates).sum(axis=-1)
        speed = self.mean - size * waves.imag.sum(axis=-1)
        return angle, speed, -size * (waves.real * self.rates).sum(axis=-1)


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

    def moves(self, t: Float) -> tuple[Float, Float, Float]:
        """See :meth:`Rotation.moves`."""
        size, rate = abs(self.last - self.first) * self.uneven, 2 * np.pi * 7.3 / self.duration
        wave = np.exp(1j * rate * t)
        angle = self.first * t + self.slope * t**2 / 2 - size / rate * (wave.real - 1)
        return angle, self.first + self.slope * t + size * wave.imag, self.slope + size * rate * wave.real


@dataclass(frozen=True, kw_only=True, eq=False)
class Dwells(Rotation):
    """Angle of a perturbator that dwells at one speed after the other, with even ramps of :data:`RAMP_TIME` between."""

    speeds: Float  # of each dwell, rad/s, shape ``(D,)``
    each: float  # how long it lasts, s

    @property
    def duration(self) -> float:
        """Of all, ramps included, s."""
        return self.speeds.size * self.each + (self.speeds.size - 1) * RAMP_TIME

    def moves(self, t: Float) -> tuple[Float, Float, Float]:
        """See :meth:`Rotation.moves`."""
        begin = np.arange(self.speeds.size) * (self.each + RAMP_TIME)
        time = np.stack([begin, begin + self.each], axis=1).ravel()  # at which a dwell begins or ends
        speed = np.repeat(self.speeds, 2)
        angle = np.concatenate([[0.0], np.cumsum((speed[1:] + speed[:-1]) / 2 * np.diff(time))])
        slope = np.append(np.diff(speed) / np.diff(time), 0.0)
        at = np.clip(np.searchsorted(time, t, side="right") - 1, 0, time.size - 1)
        into = t - time[at]
        return angle[at] + speed[at] * into + slope[at] * into**2 / 2, np.interp(t, time, speed), slope[at]
