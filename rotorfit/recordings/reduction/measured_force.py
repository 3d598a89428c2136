"""Recordings of forces that were measured: their band, how they act, and the noise of their channels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from rotorfit.data.experiments import PerturbationTest
from rotorfit.data.findings import Finding
from rotorfit.estimators.signals.local_response import LocalResponse
from rotorfit.estimators.significance import SIGNIFICANT_ERRORS
from rotorfit.models.array_types import Bool, ComplexArray, Float
from rotorfit.models.digits import significant
from rotorfit.recordings.recording import Recording
from rotorfit.recordings.reduction.reduced_record import ReducedRecord, motion_at, reduced_times

_ONE_SIDED_POWER_RATIO = 0.02
"""Power in one direction over that in the other below which a measured force is taken for one of one direction."""

_LEAST_COHERENCE = 0.9
"""Coherence below which readings are named."""


@dataclass(frozen=True, kw_only=True, eq=False)
class MeasuredForce:
    """Band, direction and noise of a measured force, before responses are made of it."""

    low: float  # frequency, rad/s, below which a thousandth of its power lies
    high: float  # frequency, rad/s, above which a thousandth of its power lies
    noise_x: float  # density of the noise along x, N^2 s, a one-sided spectrum taken as two-sided
    noise_y: float  # the same along y

    def noise_of(self, direction: str) -> float:
        """Density of the noise of the force that responses are referred to, N^2 s."""
        return {"circular": self.noise_x + self.noise_y, "x": 4 * self.noise_x, "y": 4 * self.noise_y}[direction]


class ReducedForce(NamedTuple):
    """A recording with a measured force at the rate that the force needs."""

    record: ReducedRecord
    direction: str  # how the force acts: ``circular``, ``x`` or ``y``
    noise: float  # density of its noise, N^2 s
    across: ComplexArray | None  # what acts along the other axis at once, as ``record.unit_force``; None: nothing
    axis_across: str  # the other axis
    noise_across: float  # density of its noise, N^2 s


def look_at_force(record: Recording, *, struck: bool = False) -> MeasuredForce:
    """Band and noise of a measured force, one of blows or another.

    The noise is taken for white: a force that is swept or that strikes is at each frequency only for a while, so that
    the median over time of the power there is that of the noise, and the level that of most lines.
    """
    noise_window = 0.25  # length of the windows that show the noise, s
    fewest = 8  # windows, half over one another; those of a shorter recording are shorter
    power, _ = _powers(record, min(noise_window, record.duration / fewest))
    noise = np.median(np.median(power, axis=0) / np.log(2), axis=1)  # which is exponentially distributed, N^2 s
    window = 2.0  # length of the windows in which the band is looked for, s
    power, step = _powers(record, window, over_ends=struck)
    mean = power.mean(axis=0).sum(axis=0)
    if not mean.any():
        raise ValueError(f"{record.name}: the measured force is constant; is its channel the right one?")
    floor = float(noise.sum())
    averaged = 9  # lines of the spectrum whose mean power is held against the noise
    beside = np.convolve(mean, np.ones(averaged) / averaged, mode="same")
    loud = beside > (1 + 6 / np.sqrt(averaged * len(power))) * floor
    share = np.cumsum(np.where(loud, np.maximum(mean - floor, 0.0), 0.0))
    power_beyond_band = 1e-3  # share of a measured force's power left out at either end of its band
    ends = np.searchsorted(share, np.array([power_beyond_band, 1 - power_beyond_band]) * share[-1]) + 1.0
    if not share[-1]:
        raise ValueError(f"{record.name}: the measured force does not stand out of the noise of its channels")
    return MeasuredForce(
        low=float(ends[0] * step), high=float(ends[1] * step), noise_x=float(noise[0]), noise_y=float(noise[1])
    )


def _powers(record: Recording, length: float, *, over_ends: bool = False) -> tuple[Float, float]:
    """Density of the power of both channels in windows, N^2 s, shape ``(windows, 2, lines)``; rad/s between lines."""
    size = min(1 << round(np.log2(length * record.sample_rate)), record.size)
    beyond = size // 2 if over_ends else 0  # a blow near the ends of the recording counts as others do
    most = 200  # windows at most, spread over a long recording
    count = min(max(record.size // size * 2, 1) + 2 * over_ends, most)
    starts = np.linspace(-beyond, record.size - size + beyond, count).astype(int)
    window = np.hanning(size)
    found = []
    for start in starts.tolist():
        force = record.force_signal(max(start, 0), start + size)
        parts = np.stack([force.real, force.imag])
        parts -= parts.mean(axis=1, keepdims=True)
        place = slice(max(-start, 0), max(-start, 0) + force.size)
        spectrum = np.fft.rfft(parts * window[place], size)
        found.append(np.abs(spectrum[:, 1 : size // 2]) ** 2)
    scale = float(np.sum(window**2)) * record.sample_rate
    return np.array(found) / scale, 2 * np.pi * record.sample_rate / size


def reduce_measured(record: Recording, *, struck: bool) -> ReducedForce:
    """Bring a recording with a measured force to the rate that the force needs."""
    shaft = record.shaft
    begin, end = (shaft.begin, shaft.end) if shaft is not None else (0.0, record.duration)
    force_seen = look_at_force(record, struck=struck)
    reduced, part = reduced_times(record, shaft, force_seen.high, begin, end)
    force = np.asarray(reduced.reduce(record.force_signal), dtype=complex)[part]
    force -= force.mean()
    direction, whirl = _how_it_acts(force, reduced.rate, force_seen)
    # of a force along an axis, F exp(jwt), the half at +w counts: its spectrum is that of twice the signal
    seen = {"circular": force if whirl > 0 else force.conj(), "x": 2 * force.real, "y": 2 * force.imag}
    made = ReducedRecord(
        record=record,
        drive=None,
        whirl=whirl,
        band=(force_seen.low, force_seen.high),
        unit_force=np.asarray(seen[direction], dtype=complex),
        rate=reduced.rate,
        time=reduced.time[part],
        motion={plane: motion_at(record, reduced, part, plane) for plane in record.planes},
        drive_angle=np.zeros(0),
        drive_speed=np.zeros(0),
        shaft_angle=None if shaft is None else shaft.angle(reduced.time[part]),
    )
    across = {"x": "y", "y": "x"}.get(direction, "")
    measured = across and seen[across].any()
    return ReducedForce(
        record=made,
        direction=direction,
        noise=force_seen.noise_of(direction),
        across=np.asarray(seen[across], dtype=complex) if measured else None,
        axis_across=across,
        noise_across=force_seen.noise_of(across) if measured else 0.0,
    )


def _how_it_acts(force: ComplexArray, rate: float, seen: MeasuredForce) -> tuple[str, int]:
    """Which way a force turns, or along which axis the greater part of it acts, by its power in the band."""
    spectra = np.fft.fft(np.stack([force, force.real, force.imag]))
    w = 2 * np.pi * np.fft.fftfreq(force.size, 1 / rate)
    inside = (np.abs(w) >= seen.low) & (np.abs(w) <= seen.high)
    noise = np.array([seen.noise_x, seen.noise_y]) * rate * force.size * int(inside.sum())
    ways = [float(np.sum(np.abs(spectra[0, inside & (sign * w > 0)]) ** 2)) - noise.sum() / 2 for sign in (1, -1)]
    noise_error = 0.2  # how well the power of the noise is known, a share of it
    if min(ways) < _ONE_SIDED_POWER_RATIO * max(ways) + noise_error * noise.sum():
        return "circular", 1 if ways[0] > ways[1] else -1
    along_x, along_y = np.sum(np.abs(spectra[1:, inside]) ** 2, axis=1) - noise
    return ("x", 1) if along_x > along_y else ("y", 1)


def force_across(reduced: ReducedForce, found: LocalResponse) -> tuple[ComplexArray, Float] | None:
    """Force along the other axis over the force, and its standard deviation, shape ``(L,)``; None where it is
    nothing but noise. It is the last of the outputs.

    Raises:
        ValueError: forces that are not of one signal, such as those of two shakers that run at once.
    """
    if reduced.across is None:
        return None
    ratio, sigma = found.response[0, -1], found.sigma[0, -1]
    record = reduced.record
    left = found.residual[0][-1]
    inside = np.isfinite(left)
    main, along = (np.sum(np.abs(record.spectrum(f)[inside]) ** 2) for f in (record.unit_force, reduced.across))
    noise = reduced.noise_across * record.time.size / record.rate * inside.sum()
    unlike = (np.sum(np.abs(left[inside]) ** 2) - noise) / along
    if along - noise > _ONE_SIDED_POWER_RATIO * main and unlike > 1 - _LEAST_COHERENCE:
        raise ValueError(
            f"{record.record.name}: the force measured along {reduced.axis_across} does not follow that along "
            f"{reduced.direction} ({unlike:.0%} of its power); record sweeps of one shaker at a time, each in a file "
            "of its own"
        )
    excess = np.mean(np.abs(ratio) ** 2 / (2 * sigma**2)) - 1
    return (ratio, sigma) if excess > SIGNIFICANT_ERRORS / np.sqrt(ratio.size) else None


def clear_of_noise(found: LocalResponse, reduced: ReducedRecord, noise: float) -> Bool:
    """Lines at which a measured force stands out of its noise, shape ``(L,)``."""
    # Noise of the force over the force, in power, beyond which a line says nothing that could be trusted
    largest_noise_share = 0.1
    return np.asarray(noise < largest_noise_share * _power(found, reduced))


def _power(found: LocalResponse, reduced: ReducedRecord) -> Float:
    """Mean power of a measured force around each line, shape ``(L,)``."""
    power = np.abs(reduced.spectrum(reduced.unit_force)) ** 2
    near = [np.abs(reduced.lines - w) <= half for w, half in zip(found.frequency, found.width / 2, strict=True)]
    return np.array([np.mean(power[lines]) for lines in near])


def coherence(test: PerturbationTest, found: LocalResponse, reduced: ReducedRecord, kept: Bool) -> Float:
    """Share of the power of each reading that a measured force explains, shape ``(N,)``."""
    leverage = 2 * (found.sigma[0, 0] / found.noise[0]) ** 2  # variance of a response over that of the noise
    lines = np.tile(np.flatnonzero(kept), len(test) // int(kept.sum()))
    explained = np.abs(test.response) ** 2 * _power(found, reduced)[lines]
    return np.asarray(explained / (explained + 2 * test.sigma**2 / leverage[lines]))


def coherence_note(test: PerturbationTest, coherent: Float) -> Finding:
    """The coherence in a sentence."""
    poor = np.abs(test.frequency[coherent < _LEAST_COHERENCE]) / (2 * np.pi)
    where = (
        f", below {_LEAST_COHERENCE:g} in {poor.size}, {significant(poor.min(), 3)} to {significant(poor.max(), 3)} Hz"
        if poor.size
        else ""
    )
    words = (
        f"{test.run[0]}: coherence {np.median(coherent):.4f} in the median of {len(test)} readings{where}; the column "
        "coherence has it by reading."
    )
    return Finding("note", "coherence", words)
