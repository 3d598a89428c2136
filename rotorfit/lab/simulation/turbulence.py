"""Process noise of a virtual rig: the force of the flow's turbulence on its planes, of any spectrum.

It is made on a grid of frequencies, independent complex normal numbers of the spectrum's size, over a time longer than
the recording: what is cut off keeps the end from meeting the begin. Between samples the force is straight. That weakens
a frequency f by ``sinc(f / rate)^2``, so that it is raised by as much, and the spectrum is exact up to half the rate of
the samples.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from rotorfit.base.array_types import ComplexArray, Float

if TYPE_CHECKING:
    from rotorfit.lab.simulation.rig import Force


@dataclass(frozen=True, kw_only=True)
class Turbulence:
    """Random force ``Fx + j Fy`` of the flow on the planes of a virtual rig, stationary and normal.

    The two-sided spectrum of a plane at a signed frequency f, positive forward, is
    ``level^2 (|f| / at_hz)^-exponent / (1 + (f / low_pass_hz)^2)``, times or over the root of ``forward``.

    Attributes:
        level: root of the spectrum at ``at_hz``, N per root Hz, of all planes or by plane; planes not named have none.
        exponent: how steeply the spectrum falls with frequency, of all planes or by plane; 0 is white. Below a tenth of
            ``at_hz`` it is flat.
        at_hz: where the level is meant, Hz.
        low_pass_hz: corner from which it falls by 6 dB an octave more, Hz.
        forward: spectrum at forward over that at backward frequencies.
        correlation: of the forces on any two planes, -1 to 1; of three or more planes from ``-1 / (planes - 1)``.
        x_over_y: rms force along x over that along y.

    Example:
        >>> flow = rf.Turbulence(level={"journal": 0.02}, exponent=1.0)
        >>> flow.spectrum(["disk", "journal"], [-20.0, 10.0]).round(6).tolist()
        [[0.0, 0.0002], [0.0, 0.0004]]
    """

    level: float | Mapping[str, float]
    exponent: float | Mapping[str, float] = 0.0
    at_hz: float = 10.0
    low_pass_hz: float = np.inf
    forward: float = 1.0
    correlation: float = 0.0
    x_over_y: float = 1.0

    def __post_init__(self) -> None:
        positive = {name: getattr(self, name) for name in ("at_hz", "low_pass_hz", "forward", "x_over_y")}
        wrong = next((name for name, value in positive.items() if not value > 0), None)
        if wrong:
            raise ValueError(f"turbulence: {wrong} must be positive, got {positive[wrong]}")
        if not abs(self.correlation) <= 1:
            raise ValueError(f"turbulence: correlation must be within -1 and 1, got {self.correlation}")

    def spectrum(self, planes: Sequence[str], hz: Sequence[float] | Float) -> Float:
        """Two-sided spectrum of the force on each plane, N^2/Hz, shape ``(F, planes)``.

        Args:
            planes: their names.
            hz: signed frequencies, Hz, shape ``(F,)``.

        Raises:
            ValueError: a level or an exponent of a plane that is not there, or one that is no number.
        """
        f = np.asarray(hz, dtype=float)[:, None]
        level, exponent = (self._by_plane(name, planes) for name in ("level", "exponent"))
        steep = np.maximum(np.abs(f) / self.at_hz, 0.1) ** -exponent
        turned = self.forward ** (np.sign(f) / 2)
        return np.asarray(level**2 * steep * turned / (1 + (f / self.low_pass_hz) ** 2))

    def force(self, planes: Sequence[str], count: int, rate: float, rng: np.random.Generator) -> Force:
        """A force that is drawn, as a function of the time since its first sample, shape ``(T, planes)``.

        Args:
            planes: their names.
            count: samples that it lasts.
            rate: of the samples, Hz.
            rng: source of chance.

        Raises:
            ValueError: as :meth:`spectrum`; planes that cannot be correlated so.
        """
        from scipy.fft import fftfreq, ifft, next_fast_len

        cut_off = 20.0  # s, over which forces and motion forget themselves
        size = next_fast_len(count + int(cut_off * rate))
        f = fftfreq(size, 1 / rate)
        drawn = rng.standard_normal((size, len(planes), 2)).view(complex)[..., 0] @ self._mixing(len(planes)).T
        spread = np.sqrt(self.spectrum(planes, f) * rate * size / 2) / np.sinc(f / rate)[:, None] ** 2
        newton = ifft(drawn * spread, axis=0)[:count]
        along_x = np.sqrt(2) * np.cos(np.arctan(1 / self.x_over_y))
        along_y = np.sqrt(2) * np.sin(np.arctan(1 / self.x_over_y))
        columns = np.ascontiguousarray((along_x * newton.real + 1j * along_y * newton.imag).T)
        sampled = np.arange(count) / rate

        def force(t: Float) -> ComplexArray:
            return np.column_stack([np.interp(t, sampled, column) for column in columns])

        return force

    def _by_plane(self, name: str, planes: Sequence[str]) -> Float:
        given = getattr(self, name)
        if isinstance(given, Mapping) and (unknown := [plane for plane in given if plane not in planes]):
            raise ValueError(f"turbulence: {name} of {', '.join(unknown)}; the planes are {', '.join(planes)}")
        values = [given.get(plane, 0.0) if isinstance(given, Mapping) else given for plane in planes]
        found = np.asarray(values, dtype=float)
        if not (np.isfinite(found).all() and (name == "exponent" or (found >= 0).all())):
            raise ValueError(f"turbulence: {name} must be a number{' from 0 on' * (name == 'level')}, got {given}")
        return found

    def _mixing(self, count: int) -> Float:
        """What makes independent forces correlated."""
        shared = np.full((count, count), self.correlation) + (1 - self.correlation) * np.eye(count)
        values, vectors = np.linalg.eigh(shared)
        if values.min() < -1e-12:
            raise ValueError(f"turbulence: {count} planes cannot all be correlated by {self.correlation}")
        return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))
