"""Recordings at the rate that the tested band needs: filtered against aliasing and thinned out, in pieces of the file.

A linear-phase filter (Kaiser window, 100 dB) passes the band up to its top within 1e-5, so that nothing has to be
corrected afterwards. What would fold back into the band is filtered out; what folds back above it is not looked at.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from rotorfit.base.array_types import Bool, ComplexArray, Float
from rotorfit.base.digits import significant
from rotorfit.estimators.signals.local_response import RecordSpectra
from rotorfit.lab.recordings.angle_track import AngleTrack
from rotorfit.lab.recordings.recording import Recording
from rotorfit.lab.recordings.signals import said_of

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
    def count(self) -> int:
        """Samples at the reduced rate, those that the filter reaches in full."""
        return max((self.size - 1) // self.factor + 1 - 2 * (len(self._filter.T) // 2), 0)

    @property
    def time(self) -> Float:
        """Their times from the start of the recording, s."""
        return (np.arange(self.count) + len(self._filter.T) // 2) * self.factor / self.full_rate

    def reduce(self, read: Callable[[int, int], Signal]) -> Signal:
        """A signal at the reduced rate, shape ``(count,)``."""
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


HIGHEST_ORDER = 5
"""Highest order of the shaft that is taken out, in both directions."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ReducedRecord:
    """Signals of one recording at N equally spaced times."""

    record: Recording  # the recording
    drive: AngleTrack | None  # angle that the force is locked to; None for a force that was measured
    whirl: int  # +1 where the force turns with the shaft, -1 against it
    band: tuple[float, float]  # lowest and highest frequency of the force, rad/s
    unit_force: ComplexArray  # what the response is referred to, as seen from x turning with the force
    rate: float  # samples a second, Hz
    time: Float  # from the start of the recording, s, shape ``(N,)``
    motion: dict[str, ComplexArray]  # of each plane, m: ``x + jy``, or the reading of a single probe in the real part
    drive_angle: Float  # of the drive, rad, shape ``(N,)``; empty without one
    drive_speed: Float  # of the drive, rad/s, shape ``(N,)``; empty without one
    shaft_angle: Float | None  # rad, shape ``(N,)``; None without a reference of the shaft

    @property
    def shaft_speed(self) -> float:
        """Mean rotative speed, rad/s; without a reference of the shaft that which file or setup say."""
        if self.shaft_angle is None:
            return self.record.stated_speed
        return float((self.shaft_angle[-1] - self.shaft_angle[0]) / (self.time[-1] - self.time[0]))

    def orders(self, first: int = 1) -> list[int]:
        """Orders of the shaft, from the first to the fifth, that reach into the band."""
        if self.shaft_angle is None:
            return []
        slowest = float(np.diff(self.shaft_angle).min()) * self.rate
        return [n for n in range(first, HIGHEST_ORDER + 1) if n * slowest < self.band[1] * 1.1]

    @property
    def lines(self) -> Float:
        """Frequencies of the spectra, from zero to the end of the band, rad/s, shape ``(K,)``."""
        step = 2 * np.pi * self.rate / self.time.size
        return np.asarray(step * np.arange(min(int(1.02 * self.band[1] / step) + 2, self.time.size // 2)), dtype=float)

    def spectrum(self, signal: ComplexArray) -> ComplexArray:
        """Spectrum of one signal, times the sampling interval, shape ``(K,)``."""
        from scipy.fft import fft

        return np.asarray(fft(signal)[: self.lines.size] / self.rate)

    def spectra(self, weights: ComplexArray, orders: Sequence[int]) -> RecordSpectra:
        """All spectra of the record.

        The outputs are, for a plane with two probes: the orbit's component in the direction of the force, that in the
        other one, and the phasors of x and of y, relative to ``exp(+j|w|t)``; for a plane with one probe its phasor.
        """
        outputs: list[ComplexArray] = []
        for plane, z in self.motion.items():
            plus, minus = self.spectrum(z), self.spectrum(z.conj())
            if plane not in self.record.pairs:
                outputs.append(2 * plus)
                continue
            along, against = (plus, minus) if self.whirl > 0 else (minus, plus)
            outputs += [along, against, plus + minus, (plus - minus) / 1j]
        angle = np.zeros(0) if self.shaft_angle is None else self.shaft_angle
        others = [self.spectrum(np.exp(1j * n * angle)) for n in orders]
        return RecordSpectra(
            frequency=self.lines,
            outputs=np.array(outputs),
            forces=weights[:, None] * self.spectrum(self.unit_force),
            others=np.array(others, dtype=complex).reshape(len(others), self.lines.size),
        )

    def without_orders(self, quiet: Bool | None = None) -> ReducedRecord:
        """The record less what least squares finds of the shaft's orders in it, in both directions.

        Looked for at all times or, under blows, at those when it is quiet, shape ``(N,)``. Piece by piece, so that
        hours need no more memory than the motion itself.
        """
        angle = self.shaft_angle
        if angle is None:
            return self
        powers = np.array([sign * n for n in self.orders() for sign in (1, -1)] + [0])
        samples = 1 << 15  # samples worked on at once
        pieces = [slice(a, a + samples) for a in range(0, angle.size, samples)]
        normal = np.zeros((powers.size, powers.size), dtype=complex)
        right = np.zeros((powers.size, len(self.motion)), dtype=complex)
        for piece in pieces:
            basis = np.exp(1j * powers[:, None] * angle[piece])
            if quiet is not None:
                basis *= quiet[piece]
            normal += basis.conj() @ basis.T
            right += basis.conj() @ np.array([z[piece] for z in self.motion.values()]).T
        amplitude = np.linalg.solve(normal, right)
        left = {plane: z.copy() for plane, z in self.motion.items()}
        for piece in pieces:
            found = amplitude.T @ np.exp(1j * powers[:, None] * angle[piece])
            for z, part in zip(left.values(), found, strict=True):
                z[piece] -= part
        return replace(self, motion=left)


def reduce_record(record: Recording, drive: AngleTrack, whirl: int) -> ReducedRecord:
    """Bring a recording to the rate that the band of its drive needs."""
    shaft, marks = record.shaft, [track for track in (drive, record.shaft) if track is not None]
    begin, end = max(mark.begin for mark in marks), min(mark.end for mark in marks)
    fastest = float(drive.speed(np.linspace(begin, end, 20_001)).max())
    reduced, part = reduced_times(record, shaft, fastest, begin, end)
    time = reduced.time[part]
    angle, speed = drive.angle(time), drive.speed(time)
    return ReducedRecord(
        record=record,
        drive=drive,
        whirl=whirl,
        band=(float(speed.min()), float(speed.max())),
        unit_force=np.asarray((speed**2 - 1j * drive.acceleration(time)) * np.exp(1j * angle)),
        rate=reduced.rate,
        time=time,
        motion={plane: motion_at(record, reduced, part, plane) for plane in record.planes},
        drive_angle=angle,
        drive_speed=speed,
        shaft_angle=None if shaft is None else shaft.angle(time),
    )


def reduced_times(
    record: Recording, shaft: AngleTrack | None, fastest: float, begin: float, end: float
) -> tuple[ReducedRate, slice]:
    """The rate that a band and the orders in it need, and the samples at that rate between two times."""
    from scipy.fft import prev_fast_len

    top = fastest
    if shaft is not None:
        speed = shaft.speed(np.linspace(begin, end, 20_001))
        reach = [n * float(speed.max()) for n in range(1, HIGHEST_ORDER + 1) if n * speed.min() < 1.1 * fastest]
        top = max([top, *reach])
    with said_of(record.name):
        reduced = ReducedRate.for_band(1.02 * top / (2 * np.pi), record.sample_rate, record.size)
    inside = np.flatnonzero((reduced.time >= begin) & (reduced.time <= end))
    if inside.size < 32:
        seconds = significant(max(end - begin, 0), 3)
        raise ValueError(f"{record.name}: the pulses leave {seconds} s of the recording, too little")
    return reduced, slice(int(inside[0]), int(inside[0]) + int(prev_fast_len(inside.size)))


def motion_at(record: Recording, reduced: ReducedRate, part: slice, plane: str) -> ComplexArray:
    """Motion of one plane about its mean: ``x + jy``, or the reading of a single probe in the real part, m."""
    probes = [probe for probe in record.probes if probe.plane == plane]
    volts = [reduced.reduce(partial(record.without_run_out, probe)).real[part] for probe in probes]
    along = np.stack([v / float(probe.sensitivity or 1.0) for v, probe in zip(volts, probes, strict=True)])
    along -= along.mean(axis=1, keepdims=True)
    if len(probes) == 1:
        return np.asarray(along[0], dtype=complex)
    x, y = record.resolved(plane, along)
    return np.asarray(x + 1j * y)
