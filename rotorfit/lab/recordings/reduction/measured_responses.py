"""Responses to forces that were measured: magnetic bearing, load cells, shaker, hammer; one axis or both at once.

A rig that is shaken along x, then along y, feels the other shaker too. Where both forces were measured, the two
recordings are reduced together: with A the motion and F the forces of both, ``H = A F^-1`` at lines that they share.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from rotorfit.base.array_types import Bool, ComplexArray, Float
from rotorfit.base.digits import significant
from rotorfit.base.significance import SIGNIFICANT_ERRORS
from rotorfit.estimators.blocks.set_speeds import SPEED_TOLERANCE
from rotorfit.estimators.signals.local_response import SMOOTH_DEGREE, LocalResponse, RecordSpectra
from rotorfit.lab.data.experiments import FORCE_SIGMA, PerturbationTest, records
from rotorfit.lab.data.findings import Finding
from rotorfit.lab.data.synchronous import join
from rotorfit.lab.recordings.recording import Recording
from rotorfit.lab.recordings.reduction.reduced_record import ReducedRecord, motion_at, reduced_times
from rotorfit.lab.recordings.reduction.response_lines import (
    Report,
    clear_lines,
    estimated,
    readings,
    rows,
    shaft_speed_at,
)
from rotorfit.lab.recordings.reduction.ring_downs import QUIET_SHARE, Blow, blow_findings, blows, rest_of

_ONE_SIDED_POWER_RATIO = 0.02
"""Power in one direction over that in the other below which a measured force is taken for one of one direction."""

_LEAST_COHERENCE = 0.9
"""Coherence below which readings are named."""


class MeasuredForce(NamedTuple):
    """Band and noise of a measured force, before responses are made of it."""

    low: float  # frequency, rad/s, below which a thousandth of its power lies
    high: float  # frequency, rad/s, above which a thousandth of its power lies
    noise_x: float  # density of the noise along x, N^2 s, a one-sided spectrum taken as two-sided
    noise_y: float  # the same along y


@dataclass(frozen=True, kw_only=True, eq=False)
class _Forced:
    """A recording with a measured force at the rate that the force needs."""

    reduced: ReducedRecord
    direction: str  # how the force acts: ``circular``, ``x`` or ``y``
    noise: float  # power of its noise in a line of the spectrum
    across: ComplexArray | None  # what acts along the other axis at once, as ``reduced.unit_force``; None: nothing
    axis_across: str  # the other axis
    noise_across: float  # power of its noise in a line
    struck: Sequence[Blow]  # the blows that it consists of


@dataclass(frozen=True, kw_only=True, eq=False)
class _Driven(_Forced):
    """The same with the responses that it shows by itself."""

    found: LocalResponse  # what acts along the other axis is the last output
    cut_off: float  # share of the motion that the recording cuts off
    ratio: tuple[ComplexArray, Float] | None  # what acts along the other axis over the force, and its sigma

    @property
    def size(self) -> float:
        """Size that represents the force at all lines, N."""
        return float(np.sqrt(np.mean(np.abs(self.reduced.unit_force) ** 2)))


def measured_responses(recordings: Sequence[Recording], report: Report) -> PerturbationTest:
    """Responses to measured forces. What the noise of their channels does to the motion that they predict is left over
    by the local fits, and so in sigma."""
    driven = []
    for record in recordings:
        force = _reduced(record)
        for finding in blow_findings(record, force.struck):
            report(finding)
        found, cut_off = _responses(force, report)
        driven.append(_Driven(**vars(force), found=found, cut_off=cut_off, ratio=_force_across(force, found)))
    tests = []
    while driven:
        first = driven.pop(0)
        others = [other for other in driven if _of_one_state(first, other)]
        ways = {each.direction for each in (first, *others)}
        if ways != {"x", "y"} or (len(others) == 1 and first.ratio is None and others[0].ratio is None):
            tests.append(_alone(first, report))
        else:
            driven = [each for each in driven if each not in others]
            tests += _of_both([first, *others], report)
    return join(tests)


def look_at_force(record: Recording, *, struck: bool = False) -> MeasuredForce:
    """Band and noise of a measured force, one of blows or another.

    The noise is taken for white: a force that is swept or that strikes is at each frequency only for a while, so that
    the median over time of the power there is that of the noise, and the level that of most lines.
    """
    noise_window = 0.25  # length of the windows that show the noise, s
    fewest = 8  # windows, half over one another; those of a shorter recording are shorter
    lowest_rate = 64.0  # sampling rate, Hz: a window of noise has 16 samples
    if record.sample_rate < lowest_rate or record.size < 16 * fewest:
        raise ValueError(
            f"{record.name}: {record.size} samples at {record.sample_rate:g} Hz are too few to tell a measured "
            "force from its noise; is the sampling rate right?"
        )
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
    return MeasuredForce(*(ends * step).tolist(), *noise.tolist())


def shaken_along(record: Recording) -> str:
    """Axis along which the greater part of a measured force acts."""
    window = 0.25  # length of the windows, s
    power, _ = _powers(record, min(window, record.duration))
    along_x, along_y = power.sum(axis=(0, 2)).tolist()
    return "x" if along_x > along_y else "y"


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


def _reduced(record: Recording) -> _Forced:
    """A recording with a measured force at the rate that the force needs."""
    struck, shaft = blows(record), record.shaft
    seen = look_at_force(record, struck=bool(struck))
    begin, end = (shaft.begin, shaft.end) if shaft is not None else (0.0, record.duration)
    rate, part = reduced_times(record, shaft, seen.high, begin, end)
    force = np.asarray(rate.reduce(record.force_signal), dtype=complex)[part]
    force -= force.mean()
    direction, whirl = _how_it_acts(force, rate.rate, seen)
    # of a force along an axis, F exp(jwt), the half at +w counts: its spectrum is that of twice the signal
    signals = {"circular": force if whirl > 0 else force.conj(), "x": 2 * force.real, "y": 2 * force.imag}
    noise = {"circular": seen.noise_x + seen.noise_y, "x": 4 * seen.noise_x, "y": 4 * seen.noise_y, "": 0.0}
    across = {"x": "y", "y": "x"}.get(direction, "")
    measured, seconds = bool(across and signals[across].any()), force.size / rate.rate
    reduced = ReducedRecord(
        record=record,
        drive=None,
        whirl=whirl,
        band=(seen.low, seen.high),
        unit_force=np.asarray(signals[direction], dtype=complex),
        rate=rate.rate,
        time=rate.time[part],
        motion={plane: motion_at(record, rate, part, plane) for plane in record.planes},
        drive_angle=np.zeros(0),
        drive_speed=np.zeros(0),
        shaft_angle=None if shaft is None else shaft.angle(rate.time[part]),
    )
    return _Forced(
        reduced=reduced,
        direction=direction,
        noise=noise[direction] * seconds,
        across=np.asarray(signals[across], dtype=complex) if measured else None,
        axis_across=across,
        noise_across=noise[across] * seconds,
        struck=struck,
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


def _force_across(driven: _Forced, found: LocalResponse) -> tuple[ComplexArray, Float] | None:
    """Force along the other axis over the force, and its standard deviation, shape ``(L,)``; None where it is
    nothing but noise. It is the last of the outputs.

    Raises:
        ValueError: forces that are not of one signal, such as those of two shakers that run at once.
    """
    if driven.across is None:
        return None
    ratio, sigma = found.response[0, -1], found.sigma[0, -1]
    reduced = driven.reduced
    left = found.residual[0][-1]
    inside = np.isfinite(left)
    main, along = (np.sum(np.abs(reduced.spectrum(f)[inside]) ** 2) for f in (reduced.unit_force, driven.across))
    noise = driven.noise_across * inside.sum()
    unlike = (np.sum(np.abs(left[inside]) ** 2) - noise) / along
    if along - noise > _ONE_SIDED_POWER_RATIO * main and unlike > 1 - _LEAST_COHERENCE:
        raise ValueError(
            f"{reduced.record.name}: the force measured along {driven.axis_across} does not follow that along "
            f"{driven.direction} ({unlike:.0%} of its power); record sweeps of one shaker at a time, each in a file "
            "of its own"
        )
    excess = np.mean(np.abs(ratio) ** 2 / (2 * sigma**2)) - 1
    return (ratio, sigma) if excess > SIGNIFICANT_ERRORS / np.sqrt(ratio.size) else None


def _of_one_state(one: _Driven, other: _Driven) -> bool:
    """True if forces along both axes were measured in two recordings, either along one of them, at one speed."""
    speeds = [each.reduced.shaft_speed for each in (one, other)]
    return (
        not (one.struck or other.struck)
        and one.across is not None
        and other.across is not None
        and one.reduced.record.planes == other.reduced.record.planes
        and bool(np.ptp(speeds) <= SPEED_TOLERANCE * max(speeds))
    )


def _alone(driven: _Driven, report: Report) -> PerturbationTest:
    """The test that one recording makes."""
    clear = _clear(driven, driven.found, report)
    test = _rows(driven, driven.found, clear, report)
    test = replace(test, sigma=np.hypot(test.sigma, driven.cut_off * np.abs(test.response) / np.sqrt(2)))
    if driven.ratio is None:
        return test
    ratio, error = driven.ratio[0][clear], driven.ratio[1][clear]
    noise = np.tile(driven.size * error, len(test) // ratio.size)
    return replace(_with_across(test, driven, ratio), attributes={**test.attributes, FORCE_SIGMA: noise})


def _rows(driven: _Driven, found: LocalResponse, clear: Bool, report: Report) -> PerturbationTest:
    """Readings at clear lines, with their coherence: the share of the power of each that the force explains."""
    reduced, record = driven.reduced, driven.reduced.record
    speed = shaft_speed_at(reduced.without_orders(), found.frequency, found.width / (SMOOTH_DEGREE + 1))
    test = rows(
        record,
        readings(record, reduced.whirl, found, np.zeros(found.noise.shape)),
        clear,
        frequency=reduced.whirl * found.frequency,
        speed=speed,
        force_plane=record.force.plane if record.force else "",
        force=np.full(found.frequency.size, driven.size, dtype=complex),
        force_direction=driven.direction,
    )
    leverage = 2 * (found.sigma[0, 0] / found.noise[0]) ** 2  # variance of a response over that of the noise
    lines = np.tile(np.flatnonzero(clear), len(test) // int(clear.sum()))
    explained = np.abs(test.response) ** 2 * _power(found, reduced)[lines]
    coherent = np.asarray(explained / (explained + 2 * test.sigma**2 / leverage[lines]))
    poor = np.abs(test.frequency[coherent < _LEAST_COHERENCE]) / (2 * np.pi)
    where = ""
    if poor.size:
        range_hz = f"{significant(poor.min(), 3)} to {significant(poor.max(), 3)} Hz"
        where = f", below {_LEAST_COHERENCE:g} in {poor.size}, {range_hz}"
    words = (
        f"{test.run[0]}: coherence {np.median(coherent):.4f} in the median of {len(test)} readings{where}; the column "
        "coherence has it by reading."
    )
    report(Finding("note", "coherence", words))
    return replace(test, attributes={**test.attributes, "coherence": coherent})


def _power(found: LocalResponse, reduced: ReducedRecord) -> Float:
    """Mean power of a measured force around each line, shape ``(L,)``."""
    power = np.abs(reduced.spectrum(reduced.unit_force)) ** 2
    near = [np.abs(reduced.lines - w) <= half for w, half in zip(found.frequency, found.width / 2, strict=True)]
    return np.array([np.mean(power[lines]) for lines in near])


def _with_across(test: PerturbationTest, driven: _Driven, ratio: ComplexArray) -> PerturbationTest:
    """The test with what acts along the other axis at once, over the force, shape ``(L,)``."""
    newton = np.tile(driven.size * ratio, len(test) // ratio.size)
    acting = zip(test.force_plane.tolist(), newton.tolist(), strict=True)
    return replace(test, further_forces=records(((plane, force, driven.axis_across),) for plane, force in acting))


def _clear(driven: _Driven, found: LocalResponse, report: Report) -> Bool:
    """Lines that are clear of the shaft's orders and at which the force stands out of its noise, shape ``(L,)``."""
    reduced, largest_noise_share = driven.reduced, 0.1  # of the force, in power, up to which a line can be trusted
    clear = clear_lines(reduced, found, 0, report) & (driven.noise < largest_noise_share * _power(found, reduced))
    if not clear.any():
        raise ValueError(f"{reduced.record.name}: the measured force does not stand out of the noise of its channels")
    return clear


def _of_both(several: Sequence[_Driven], report: Report) -> list[PerturbationTest]:
    """The tests that recordings along x and along y make together, one of each axis, at lines that they share; repeats
    are averaged, and what they scatter is in the noise.

    Forces (columns of the inverse root of the covariance of both responses) are chosen so that the two tests err
    independently. They are nearly those that acted, and taken to be along the axes where they nearly are.
    """
    ordered = sorted(several, key=lambda driven: driven.direction)
    spectra = []
    for driven in ordered:
        reduced = driven.reduced.without_orders()
        own = reduced.spectra(np.ones(1, dtype=complex), reduced.orders())
        across = [reduced.spectrum(driven.across)] if driven.across is not None else []
        forces = [own.forces[0], *across] if driven.direction == "x" else [*across, own.forces[0]]
        spectra.append(replace(own, forces=np.array(forces), force_noise=driven.noise))
    lows, highs = zip(*(driven.reduced.band for driven in ordered), strict=True)
    found = estimated([driven.reduced.record for driven in ordered], spectra, max(lows), min(highs))
    found = replace(found, noise=found.noise * _scatter(found, spectra))
    acting = _independent_forces(found.covariance)
    each = [
        replace(
            found,
            response=np.einsum("jl,jpl->pl", acting[:, k], found.response)[None],
            sigma=found.noise[None]
            * np.sqrt(np.einsum("jl,jml,ml->l", acting[:, k], found.covariance, acting[:, k].conj()).real / 2),
        )
        for k in (0, 1)
    ]
    firsts = {driven.direction: driven for driven in reversed(ordered)}
    silent: list[Finding] = []  # repeats say what the first of them says
    clear = np.ones(found.frequency.size, dtype=bool)
    for driven in ordered:
        tell = report if driven is firsts[driven.direction] else silent.append
        clear &= _clear(driven, each[driven.direction == "y"], tell)
    tests = []
    for k, axis in enumerate("xy"):
        test = _rows(firsts[axis], each[k], clear, report)
        if acting[1 - k, k].any():
            test = _with_across(test, firsts[axis], acting[1 - k, k, clear])
        more = sum(driven.direction == axis for driven in ordered) - 1
        if more:
            test = replace(test, run=np.full(len(test), f"{test.run[0]} and {more} more"))
        tests.append(test)
    return tests


def _scatter(found: LocalResponse, spectra: Sequence[RecordSpectra]) -> Float:
    """Factor on the noise of each output at each line by which repeats scatter there beyond the noise beside it, as
    under hum in the channels of the forces, shape ``(P, L)``; one without repeats."""
    forces, wide = 2, 1.5  # lines of the spectrum beside a node that are its own, those with force the more
    freedom = len(spectra) - forces
    if not freedom:
        return np.ones(found.noise.shape)
    own = np.zeros(found.noise.shape)
    for record, left in zip(spectra, found.residual, strict=True):
        step = float(record.frequency[1] - record.frequency[0])
        near = (np.abs(record.frequency - found.frequency[:, None]) <= wide * step) & np.isfinite(left[0])
        weight = near * np.sum(np.abs(record.forces) ** 2, axis=0)
        total = weight.sum(axis=1)
        share = np.divide(weight, total[:, None], out=np.zeros_like(weight), where=total[:, None] > 0)
        own += np.abs(np.nan_to_num(left)) ** 2 @ share.T
    ratio = own / freedom / found.noise**2
    return np.asarray(np.where(ratio > 1 + SIGNIFICANT_ERRORS / np.sqrt(freedom), np.sqrt(ratio), 1.0))


def _independent_forces(covariance: ComplexArray) -> ComplexArray:
    """Forces along x and y of two tests, over that along the test's own axis, shape ``(2, 2, L)``: columns are tests.

    With C the covariance of the responses, tests of forces ``conj(C^-1/2)`` err independently.
    """
    values, vectors = np.linalg.eigh(covariance.transpose(2, 0, 1).conj())
    root = (vectors / np.sqrt(values)[:, None, :]) @ vectors.conj().swapaxes(1, 2)
    forces = np.asarray((root / np.einsum("ljj->lj", root)[:, None, :]).transpose(1, 2, 0))
    nearly = 0.05  # of a force: tests along the axes then err independently to a tenth
    small = np.median(np.abs(forces[[1, 0], [0, 1]])) < nearly
    return np.repeat(np.eye(2, dtype=complex)[:, :, None], forces.shape[2], axis=2) if small else forces


def _responses(driven: _Forced, report: Report) -> tuple[LocalResponse, float]:
    """Responses to a force that was measured, that of the other axis the last, and the share of the motion that the
    recording cuts off.

    To one blow a smooth response and a smooth transient look alike. Where the rotor rests before the blows and after
    them there is no transient, and the shaft's orders are those of the time when it is quiet.
    """
    reduced, struck, unit = driven.reduced, driven.struck, np.ones(1, dtype=complex)
    record = reduced.record

    def noisy(spectra: RecordSpectra) -> RecordSpectra:
        more = [] if driven.across is None else [reduced.spectrum(driven.across)]
        return replace(spectra, force_noise=driven.noise, outputs=np.array([*spectra.outputs, *more]))

    quiet, left_out = rest_of(reduced, struck) if struck else (np.zeros(1, dtype=bool), 0.0)
    many_blows = 3  # blows whose spectrum is not smooth, so that it is distinguished from a transient
    if not struck or (quiet.mean() < QUIET_SHARE and len(struck) >= many_blows):
        spectra = reduced.without_orders().spectra(unit, reduced.orders())
        return estimated([record], [noisy(spectra)], *reduced.band), 0.0
    if quiet.mean() < QUIET_SHARE and reduced.shaft_angle is not None:
        raise ValueError(
            f"{record.name}: the rotor is quiet in {quiet.mean():.0%} of the {significant(np.ptp(reduced.time), 3)} s "
            "between the first mark of the shaft and the last, too little to tell the shaft's own orders from the "
            "blow: record some turns before it, and until the rotor rests"
        )
    calm = reduced.without_orders(quiet).spectra(unit, [])
    found = estimated([record], [noisy(calm)], *reduced.band, transient=False)
    if left_out:
        words = (
            f"{record.name}: the rotor moves when the recording begins or ends, by {significant(left_out, 2)} of "
            "its motion after the blow; errors are wider by that share of each response. Record some turns before "
            "the blow, and until the rotor rests."
        )
        report(Finding("warning", "moving-at-ends", words))
    return found, left_out
