"""Spectra of a machine in operation, from recordings at steady speed: without the shaft's orders and foreign lines."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from rotorfit.base.array_types import ComplexArray, Float
from rotorfit.base.digits import significant
from rotorfit.base.executors import carry_out
from rotorfit.base.units import RPM_PER_RAD_S
from rotorfit.estimators.signals.cells import Cells, averaged, envelope, half_width, outstanding, periodogram, smoothed
from rotorfit.lab.data.findings import Finding, listed
from rotorfit.lab.data.synchronous import join
from rotorfit.lab.kinds.operating_test import OperatingTest, operating_test
from rotorfit.lab.recordings.recording import Recording, named_apart
from rotorfit.lab.recordings.reduction.reduced_record import HIGHEST_ORDER, ReducedRate, ReducedRecord, motion_at
from rotorfit.lab.recordings.reduction.static_positions import STEADY_SPEED_RANGE
from rotorfit.lab.recordings.signals import source_of

_LOWEST = 1.0
"""Frequency from which spectra are used, Hz: below it probes drift."""
_MASK = 0.3
"""Half the width of what is left out about an order of the shaft and about a foreign line, Hz."""
_WIDEST, _NARROWEST = 0.25, 0.02
"""Widths of a cell, Hz: of the half width of the sharpest mode it is a tenth to a third."""
_STEADY, _CHANCE = 0.6, 3.0
"""Variance over squared mean of a squared envelope below which whirl is no noise's work, by so many standard
deviations: 0.7 was seen close to the threshold, 0.3 of a rotor that whips."""
_LEAST_RISE = 10.0
"""Power of the highest peak over the floor, from which spectra tell a rotor: 10 dB."""


class _Seen(NamedTuple):
    """One recording as cells."""

    record: Recording
    speed: float
    planes: tuple[str, ...]
    cells: Cells
    findings: tuple[Finding, ...]


def operating_spectra(
    records: Sequence[Recording] | Recording,
    *,
    band_hz: tuple[float, float] | None = None,
    width_hz: float | None = None,
    executor: Executor | None = None,
) -> OperatingTest:
    """Spectra of a machine in operation that turbulence shakes, for fits: no exciter is needed.

    Orders of the shaft are taken out by least squares on its angle, whatever their phase, then left out with a narrow
    mask; other lines that stand out are left out and listed. What is left is averaged over cells of frequencies of one
    spectrum of the whole record, without segments. Band, cells and masks are derived from the spectra and reported.

    Args:
        records: of one machine at one or more steady speeds, x and y at each plane, with a Keyphasor, minutes long.
        band_hz: lowest and highest frequency, in place of those derived.
        width_hz: width of a cell, in place of that derived; much below the half width of the sharpest mode.
        executor: reduces recordings beside each other, see :func:`rotorfit.responses`.

    Returns:
        the test; its ``findings`` say what was derived and what was odd.

    Raises:
        ValueError: a recording without Keyphasor, whose speed changes, without a plane of two good probes, too short,
            or so quiet that the floor hides the rotor.

    Example:
        >>> test = rf.operating_spectra(rf.read_recording(rf.datasets.operation()))
        >>> test.planes, test.runs
        (('disk', 'journal'), ('operation',))
    """
    listed_records = named_apart(records)
    seen = carry_out(partial(_cells, band=band_hz, width=width_hz), listed_records, executor)
    source = source_of(listed_records)
    names = set.intersection(*(set(one.record.attributes) for one in seen))
    tests = []
    for one in seen:
        attributes = {name: value for name, value in one.record.attributes.items() if name in names}
        tests.append(operating_test(one.record.name, one.speed, one.planes, one.cells, attributes, source))
    findings = tuple(finding for one in seen for finding in one.findings)
    return replace(join(tests), findings=findings)


def _cells(record: Recording, *, band: tuple[float, float] | None, width: float | None) -> _Seen:
    """One recording."""
    found: list[Finding] = []
    record.need_displacements("operating vibration")
    planes = _good_planes(record, found)
    speed = _steady_speed(record)
    reduced = _reduced(record, planes, speed, band).without_orders()
    z = np.array([reduced.motion[plane] for plane in planes])
    seconds, turning = z.shape[1] / reduced.rate, speed / (2 * np.pi)
    top = reduced.band[1] / (2 * np.pi)  # above it the filter of the reduced rate falls
    masked = [(n * turning - _MASK, n * turning + _MASK) for n in range(1, HIGHEST_ORDER + 1)]
    frequency, power = periodogram(z, reduced.rate)
    clear = np.all([(frequency < low) | (frequency > high) for low, high in masked], axis=0)
    found += _self_excited(record, z, reduced.rate, smoothed(frequency, power, masked, 1.0))
    lines = outstanding(frequency, power, clear & (frequency > _LOWEST) & (frequency < top), _MASK)
    masked += [(line - _MASK, line + _MASK) for line in lines]
    if lines:
        where = listed([f"{f:.2f} Hz" for f in lines])
        text = f"{record.name}: lines that are no orders of the shaft left out, at {where}."
        found.append(Finding("note", "foreign-lines", text))
    at, smooth = smoothed(frequency[frequency < top], power[:, frequency < top], masked, 1.0)
    low, high = _band(record, at, smooth, seconds) if band is None else band
    usual = _width(record, z, reduced.rate, (low, high), masked, seconds) if width is None else width
    cells = averaged(z, reduced.rate, band=(low, high), width=usual, masked=masked)
    least = 2 * z.shape[0]
    if cells.freedom.min() < least:
        raise ValueError(
            f"{record.name}: {significant(seconds, 3)} s are too short: a cell of {significant(usual, 2)} Hz has "
            f"{significant(float(cells.freedom.min()), 2)} degrees of freedom, fewer than its {least} signals. Record "
            f"{significant(seconds * 2 * least / float(cells.freedom.min()), 2)} s or more"
        )
    text = (
        f"{record.name}: {cells.frequency.size} cells of {significant(usual, 2)} Hz from {significant(low, 3)} to "
        f"{significant(high, 3)} Hz, {significant(float(np.median(cells.freedom)), 3)} degrees of freedom each."
    )
    found.append(Finding("note", "cells", text))
    rms = 1e6 * np.sqrt(np.mean(np.abs(z) ** 2, axis=1))
    sizes = listed(
        [f"{significant(size, 2)} um rms at {plane}" for plane, size in zip(planes, rms.tolist(), strict=True)]
    )
    text = f"{record.name}: motion without orders {sizes}: a fit is of the linear rotor at this amplitude."
    found.append(Finding("note", "amplitude", text))
    return _Seen(record, speed, planes, cells, (*record.findings, *found))


def _self_excited(record: Recording, z: ComplexArray, rate: float, spectrum: tuple[Float, Float]) -> Iterator[Finding]:
    """A warning of whirl that keeps its orbit, as of a rotor beyond its threshold, and as noise leaves none."""
    frequency, power = spectrum
    plane, peak = np.unravel_index(np.argmax(power[: len(z)]), power[: len(z)].shape)
    size, chance = envelope(z[plane], rate, float(frequency[peak]), 1.0)
    if size < min(_STEADY, 1 - _CHANCE * chance):
        text = (
            f"{record.name}: whirl at {significant(float(frequency[peak]), 3)} Hz keeps its orbit (envelope "
            f"{significant(size, 2)}, 1 where noise drives a stable rotor): self-excited, or forced by another "
            "machine. Decrements and threshold of a fit are not those of a linear rotor; record at a lower speed"
        )
        yield Finding("warning", "self-excited", text, remedy="record at a lower speed", origin="recording")


def _good_planes(record: Recording, found: list[Finding]) -> tuple[str, ...]:
    """Planes of two good probes; the others are reported."""
    bad = [name for name, each in record.statistics.items() if each.clipped or each.still]
    kept, left = [], []
    for plane in record.planes:
        own = [probe.channel for probe in record.probes if probe.plane == plane]
        if plane not in record.pairs:
            left.append(f"{plane} has one probe")
        elif set(own) & set(bad):
            left.append(f"{listed([name for name in own if name in bad])} of {plane} is clipped or interrupted")
        else:
            kept.append(plane)
    if not kept:
        raise ValueError(
            f"{record.name}: {'; '.join(left) or 'it has no probes'}; operating vibration needs x and y of a plane, as "
            "one probe does not tell forward from backward"
        )
    found += [Finding("warning", "plane-left-out", f"{record.name}: {why}: left out of the spectra.") for why in left]
    return tuple(kept)


def _steady_speed(record: Recording) -> float:
    """Mean speed of a shaft that keeps it, rad/s."""
    shaft = record.shaft_angle()
    speeds = np.abs(shaft.speeds(400))
    if np.ptp(speeds) > STEADY_SPEED_RANGE * speeds.mean():
        low, high = (significant(v * RPM_PER_RAD_S, 4) for v in (speeds.min(), speeds.max()))
        raise ValueError(
            f"{record.name}: the speed changes from {low} to {high} rpm; operating vibration needs a steady one, "
            f"within {STEADY_SPEED_RANGE:.0%}: cut the recording into parts of one speed"
        )
    return float(abs(np.diff(shaft.angle(np.array([shaft.begin, shaft.end])))[0]) / (shaft.end - shaft.begin))


def _reduced(
    record: Recording, planes: tuple[str, ...], speed: float, band: tuple[float, float] | None
) -> ReducedRecord:
    """The recording at the rate that its band needs, between the first mark and the last."""
    shaft, orders = record.shaft_angle(), 3.0  # times the speed, up to which modes are looked for
    least = 60.0  # Hz, of slow machines
    top = max(orders * speed / (2 * np.pi), least) if band is None else band[1]
    rate = ReducedRate.for_band(min(top, 0.45 * record.sample_rate), record.sample_rate, record.size)
    inside = np.flatnonzero((rate.time >= shaft.begin) & (rate.time <= shaft.end))
    part = slice(int(inside[0]), int(inside[-1]) + 1)
    return ReducedRecord(
        record=record,
        drive=None,
        whirl=1,
        band=(0.0, 2 * np.pi * top),
        unit_force=np.zeros(0, dtype=complex),
        rate=rate.rate,
        time=rate.time[part],
        motion={plane: motion_at(record, rate, part, plane) for plane in planes},
        drive_angle=np.zeros(0),
        drive_speed=np.zeros(0),
        shaft_angle=shaft.angle(rate.time[part]),
    )


def _band(record: Recording, frequency: Float, power: Float, seconds: float) -> tuple[float, float]:
    """Lowest and highest frequency: to where the spectrum of every signal sinks into the floor, and as much again."""
    floor = np.quantile(power, 0.1, axis=1, keepdims=True)
    rise = float((power / floor).max())
    if rise < _LEAST_RISE:
        raise ValueError(
            f"{record.name}: no mode stands out of the floor, by {significant(10 * np.log10(rise), 2)} dB at most "
            f"({significant(10 * np.log10(_LEAST_RISE), 2)} dB are needed): the machine is too quiet, or the probes "
            "too noisy. Longer recordings do not help; probes of a finer range do"
        )
    over = frequency[(power > 4 * floor).any(axis=0)]
    return _LOWEST, float(min(1.5 * over[-1], frequency[-1]))


def _width(
    record: Recording,
    z: ComplexArray,
    rate: float,
    band: tuple[float, float],
    masked: Sequence[tuple[float, float]],
    seconds: float,
) -> float:
    """Width of a cell: a third of the half width of the sharpest mode, but several lines."""
    coarse = averaged(z, rate, band=band, width=max(_WIDEST, 8 / seconds), masked=masked)
    told, least = coarse.frequency.size, 2 * len(z) + 2  # as many cells as poles are looked for
    if told < least:
        raise ValueError(
            f"{record.name}: {significant(seconds, 3)} s are too short: the spectrum from {significant(band[0], 3)} to "
            f"{significant(band[1], 3)} Hz has {told} of the {least} cells that tell a mode. Record "
            f"{significant(seconds * least / max(told, 1), 2)} s or more"
        )
    sharpest = half_width(coarse, len(z))
    fewest = 2.5 * 2 * len(z) / seconds  # lines of a cell over its signals
    return max(float(np.clip(sharpest / 3, _NARROWEST, _WIDEST)), fewest)
