"""Signals at the rate that the tested band needs: filtered against aliasing and thinned out, in pieces of the file.

A linear-phase filter (Kaiser window, 100 dB) passes the band up to its top within 1e-5, so that nothing has to be
corrected afterwards. What would fold back into the band is filtered out; what folds back above it is not looked at.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from rotorfit.models.array_types import ComplexArray, Float
from rotorfit.models.digits import significant

Signal = Float | ComplexArray

RATE_OVER_TOP = 3.0
"""Reduced rate over the highest frequency of the band: the filter falls from the top to twice the top."""


@dataclass(frozen=True, kw_only=True)
class ReducedRate:
    """A lower sampling rate for signals of a band."""

    full_rate: float  # of the recording, Hz
    size: int  # samples of the recording
    factor: int  # samples of the recording for one at the reduced rate

    @classmethod
    def for_band(cls, top: float, full_rate: float, size: int) -> ReducedRate:
        """The lowest rate that keeps a band."""
        if 2 * top >= full_rate:
            raise ValueError(
                f"the band goes up to {significant(top, 4)} Hz, the sampling rate {full_rate:g} Hz shows what is below "
                f"{full_rate / 2:g} Hz"
            )
        return cls(full_rate=full_rate, size=size, factor=max(int(full_rate / (RATE_OVER_TOP * top)), 1))

    @property
    def rate(self) -> float:
        """Reduced rate, Hz."""
        return self.full_rate / self.factor

    @cached_property
    def _filter(self) -> Float:
        """Filter as a matrix (factor, blocks): column b holds what the b-th block of samples counts."""
        if self.factor == 1:
            return np.ones((1, 1))
        fall = self.rate - 2 * self.rate / RATE_OVER_TOP  # from the top of the band to what folds back onto it, Hz
        attenuation = 100.0  # of what folds back, dB
        beta = 0.1102 * (attenuation - 8.7)  # Kaiser's formulas
        length = (attenuation - 7.95) / (2.285 * 2 * np.pi * fall / self.full_rate)
        half = -(-int(length + 1) // (2 * self.factor))
        place = np.arange(-half * self.factor, half * self.factor + 1) / self.factor
        taps = np.sinc(place) * np.kaiser(place.size, beta)
        return np.asarray(np.pad(taps / taps.sum(), (0, self.factor - 1)).reshape(-1, self.factor).T)

    @property
    def _half(self) -> int:
        """Blocks before and after the centre of the filter."""
        return int(self._filter.shape[1]) // 2

    @property
    def count(self) -> int:
        """Samples at the reduced rate, those that the filter reaches in full."""
        return max((self.size - 1) // self.factor + 1 - 2 * self._half, 0)

    @property
    def time(self) -> Float:
        """Their times from the start of the recording, s."""
        return (np.arange(self.count) + self._half) * self.factor / self.full_rate

    def reduce(self, read: Callable[[int, int], Signal]) -> Signal:
        """A signal at the reduced rate.

        Returns:
            shape ``(count,)``.
        """
        blocks, width = self._filter.shape[1], self.factor
        at_once = 1 << 18  # samples of the file read at once
        step = max(at_once // width, 1)
        parts = []
        for first in range(0, self.count, step):
            last = min(first + step, self.count)
            samples = read(first * width, min((last + blocks - 1) * width, self.size))
            lacking = (last - first + blocks - 1) * width - samples.size  # the last block counts its first sample only
            rows = np.pad(samples, (0, lacking)).reshape(-1, width) if lacking else samples.reshape(-1, width)
            counted = rows @ self._filter
            parts.append(sum(counted[b : b + last - first, b] for b in range(blocks)))
        return np.concatenate(parts) if parts else np.zeros(0)
