"""Blows: where a motion is quiet between them, what a hammer's measured force shows, and free vibration after each."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple, TypeAlias

import numpy as np

from rotorfit.base.array_types import Bool, ComplexArray, Float
from rotorfit.base.digits import significant
from rotorfit.base.executors import carry_out
from rotorfit.base.names import unknown_name
from rotorfit.lab.data.findings import Finding, listed
from rotorfit.lab.data.ring_down import ring_down_test
from rotorfit.lab.kinds.free_vibration import RingDownTest
from rotorfit.lab.recordings.recording import Recording, named_apart
from rotorfit.lab.recordings.reduction.reduced_record import HIGHEST_ORDER, ReducedRate, ReducedRecord, motion_at
from rotorfit.lab.recordings.reduction.static_positions import rest_positions
from rotorfit.lab.recordings.signals import SAMPLES_OF_A_PIECE, source_of

AVERAGING_TIME = 0.02
"""Time over which the motion is averaged to see a blow, s."""
QUIET_TURNS = 2.0
"""Turns of quiet motion before the first blow that tell the shaft's orders."""
QUIET_SHARE = 0.1
"""Share of a recording of blows that tells them: their error two lines beside then is as large as the noise."""


def quiet_part(
    z: ComplexArray, angle: Float | None, rate: float, before: Bool | None = None
) -> tuple[ComplexArray, ComplexArray, Float, float, Bool]:
    """A motion between blows, arrays of shape ``(N,)``: less the orders that the shaft has where it is quiet, m; where
    it settles, m; the size of what is left, averaged over some hundredths of a second, and that where it is quiet, m;
    and when nothing is left of a blow, first guess ``before``."""
    turning = [n for n in range(-HIGHEST_ORDER, HIGHEST_ORDER + 1) if n] if angle is not None else []
    orders = np.exp(1j * np.array(turning)[:, None] * (0.0 if angle is None else angle)).T
    width = max(int(AVERAGING_TIME * rate), 1)
    quiet = np.ones(z.size, dtype=bool) if before is None else before
    level = np.zeros(z.size, dtype=complex)
    median_time = 0.5  # time about each instant whose median position is where the shaft rests, s
    for _ in range(3):  # blows disturb the orders, and orders hide blows
        left = z - orders @ np.linalg.lstsq(orders[quiet], (z - level)[quiet], rcond=None)[0] if turning else z
        level = _level(left, int(median_time * rate))
        size = np.sqrt(np.convolve(np.abs(left - level) ** 2, np.ones(width) / width, mode="same"))
        noise = float(np.median(size[quiet]))
        quiet = size <= 3 * noise  # of a simulation both may be none
    return left, level, size, noise, quiet


def _level(values: ComplexArray, width: int) -> ComplexArray:
    """Running median: it follows where the shaft rests, jumps with a release and does not see vibration."""
    from scipy.ndimage import median_filter

    parts = (median_filter(part, max(width, 1), mode="nearest") for part in (values.real, values.imag))
    return np.asarray(sum(factor * part for factor, part in zip((1, 1j), parts, strict=True)))


def rest_of(reduced: ReducedRecord, struck: Sequence[Blow]) -> tuple[Bool, float]:
    """When all planes of a rotor under blows are quiet, and the share of a blow's motion that the recording cuts off.

    Of a mode that decays, what is cut off of its spectrum has the size over the whole that the motion at the end has
    over that at the beginning.
    """
    angle, time = reduced.shaft_angle, reduced.time
    if struck[-1].end < time[0] or struck[0].begin > time[-1] or (len(struck) == 1 and struck[0].begin < time[0]):
        raise ValueError(
            f"{reduced.record.name}: the blow at {struck[0].begin:.3f} s is not between the first mark of the shaft "
            f"and the last, {time[0]:.3f} to {time[-1]:.3f} s, where its angle is known: record some turns before it"
        )
    before = time < struck[0].begin - AVERAGING_TIME
    turns = float(np.sum(before)) / reduced.rate * reduced.shaft_speed / (2 * np.pi)
    begins_quiet = bool(np.sum(before) > 2 * AVERAGING_TIME * reduced.rate) and (angle is None or turns >= QUIET_TURNS)
    parts = [quiet_part(z, angle, reduced.rate, before if begins_quiet else None) for z in reduced.motion.values()]
    quiet = np.asarray(np.all([calm for *_, calm in parts], axis=0))
    at_ends = [max(size[0], size[-1]) * np.sqrt(2) / size.max() for _, _, size, _, _ in parts]  # half a window
    rests = begins_quiet and bool(quiet[0] and quiet[-1])
    return quiet, 0.0 if rests else float(max(at_ends)) / len(struck)


class Blow(NamedTuple):
    """One blow of a hammer whose force was measured."""

    begin: float  # when the force rises, s
    end: float  # when the force is gone, s
    peak: float  # N
    cut: bool  # whether its top is flat


def blows(record: Recording) -> list[Blow]:
    """The blows that a measured force consists of; none where it is no force of blows."""
    first = record.force_signal(0, SAMPLES_OF_A_PIECE)
    level = complex(np.median(first.real), np.median(first.imag))
    pieces = [(start, start + SAMPLES_OF_A_PIECE) for start in range(0, record.size, SAMPLES_OF_A_PIECE)]
    greatest = max(float(np.abs(record.force_signal(*piece) - level).max()) for piece in pieces)
    acting_force_share = 0.1  # share of the greatest force of a recording from which it acts
    least = acting_force_share * greatest
    acts = np.concatenate([np.abs(record.force_signal(*piece) - level) > least for piece in pieces])
    largest_struck_share = 0.1  # share of a recording in which the force acts, below which it is one of blows
    if not acts.any() or acts.mean() > largest_struck_share:
        return []
    at = np.flatnonzero(acts)
    longest_break = 1e-3  # time for which noise may interrupt a blow, s: none bounces so soon
    apart = np.flatnonzero(np.diff(at) > max(longest_break * record.sample_rate, 1.0))
    found = []
    # Share of its peak within which a blow is at its top, and share of its length at half the peak that no top lasts
    top_share, largest_top_share = 5e-3, 0.2  # half sines and their squares have 0.1
    for low, high in zip(at[np.append(0, apart + 1)].tolist(), (at[np.append(apart, -1)] + 1).tolist(), strict=True):
        size = np.abs(record.force_signal(low, high) - level)
        top, half = int(np.sum(size > (1 - top_share) * size.max())), int(np.sum(size > size.max() / 2))
        begin, end, peak = low / record.sample_rate, high / record.sample_rate, float(size.max())
        found.append(Blow(begin, end, peak, top >= 3 and top > largest_top_share * half))
    return found


def blow_findings(record: Recording, found: Sequence[Blow]) -> Iterator[Finding]:
    """Blows that bounced, and those that went beyond the range of the force's channel or of a probe's."""
    cut = [blow for blow in found if blow.cut]
    if cut:
        words = (
            f"{record.name}: the force of the blow at {listed([f'{b.begin:.3f} s' for b in cut])} is cut off at "
            f"{listed([f'{significant(b.peak, 4)} N' for b in cut])}: its channel was overloaded, and responses come "
            "out too large. Leave the blow out, or strike again with a wider input range."
        )
        yield Finding("error", "force-clipped", words)
    bounce_time = 0.1  # time after a blow within which no one strikes on purpose, s: the hammer bounced
    again = [(first, second) for first, second in pairwise(found) if second.begin - first.end < bounce_time]
    if again:
        later = [f"{significant((b.begin - a.begin) * 1e3, 3)} ms later" for a, b in again]
        when = listed([f"{a.begin:.3f} s and again {time}" for (a, _), time in zip(again, later, strict=True)])
        words = (
            f"{record.name}: the hammer struck at {when}. The responses hold, for all of the force was measured, but "
            "where both blows cancel they are worse by what the errors say. Strike again if these lines matter."
        )
        yield Finding("warning", "double-hit", words)
    for channel, each in record.statistics.items():
        if not each.clipped and each.flat_low + each.flat_high > 0:  # it stays at an extreme even once
            words = (
                f"{record.name}, channel {channel} is clipped after a blow, at {significant(each.low, 4)} or "
                f"{significant(each.high, 4)} "
                f"{each.unit}: amplitudes there are too small. Set the input range wider, or leave the probe out."
            )
            yield Finding("error", "channel-clipped", words)


_Blow: TypeAlias = tuple[float, Float, ComplexArray, complex]
"""Speed, times, motion and the place where it settles."""

HIGHEST_HZ = 200.0
"""Frequency above which nothing is of interest unless said otherwise, Hz."""
BLOW_OVER_MEDIAN = 6.0
"""A blow begins where that average exceeds so many times its median."""
CONTACT_TIME = 0.01
"""Time left out after the beginning of a blow, s: hammer or release still act."""


def ring_downs(
    records: Sequence[Recording] | Recording,
    *,
    plane: str | None = None,
    highest_hz: float | None = None,
    position: complex | None = None,
    executor: Executor | None = None,
) -> RingDownTest:
    """Records of free vibration after each blow or release, for fits and :func:`rotorfit.ring_down_modes`.

    The shaft's orders are found where it is quiet and taken out everywhere. A record lasts until the next blow or until
    what is left is in the noise.

    Args:
        records: recordings in which the rotor is struck or released, any number of times.
        plane: of the probes, by default that of ``[impulse]``, the only one, or the journal.
        highest_hz: frequency above which nothing is of interest, by default that of ``[impulse]``, or 200.
        position: where the journal rests, ``x + jy`` from the bearing's centre, m; by default what gap voltages tell
            where the setup says ``centre_V`` of the probes, else the centre.
        executor: reads recordings beside each other, see :func:`rotorfit.responses`.

    Raises:
        ValueError: no blow stands out, no such plane, or a plane with one probe.

    Example:
        >>> values = {"M": 1.2, "K": 8e3, "Ds": 8.0, "K0": 9e3, "D": 450.0, "lam": 0.46, "Mf": 0.4}
        >>> files = rf.simulate_recordings(rf.models.OneMode(), values, folder / "blows", "impulse", blows=3)
        >>> struck = rf.ring_downs([rf.read_recording(file, folder / "blows" / "rig.toml") for file in files])
        >>> len(struck.runs), len(rf.ring_down_modes(struck))
        (3, 3)
    """
    listed = named_apart(records)
    parts: list[tuple[str, float, Float, ComplexArray]] = []
    jobs = []
    for record in listed:
        record.need_displacements("free vibration")
        said = None if record.rig.impulse is None else record.rig.impulse.highest
        highest = HIGHEST_HZ if said is None else said / (2 * np.pi)
        jobs.append((record, _plane(record, plane), highest if highest_hz is None else highest_hz))
    reduced = carry_out(_reduced, jobs, executor)
    for (record, _, _), (mean, blows, _) in zip(jobs, reduced, strict=True):
        for number, (speed, time, z, settled) in enumerate(blows, start=1):
            at = z + (position if position is not None else 0.0 if mean is None else mean + settled)
            parts.append((f"{record.name}, blow {number}", speed, time, at))
    findings = tuple(found for _, _, own in reduced for found in own)
    return replace(ring_down_test(parts, source_of(listed)), findings=findings)


def _reduced(job: tuple[Recording, str, float]) -> tuple[complex | None, list[_Blow], tuple[Finding, ...]]:
    """Mean position where it is known, the motion after each blow, and what was found odd, of a recording, plane and
    highest frequency."""
    record, plane, highest_hz = job
    mean = None
    if all(probe.centre is not None for probe in record.probes if probe.plane == plane):  # voltages of the centre
        mean = next((complex(rest.z.mean()) for rest in rest_positions(record)[0] if rest.plane == plane), None)
    return mean, list(_blows(record, plane, highest_hz)), record.findings


def _plane(record: Recording, asked: str | None) -> str:
    asked = asked or (None if record.rig.impulse is None else record.rig.impulse.plane)
    found = asked or ("journal" if "journal" in record.planes else record.planes[0])
    if found not in record.planes:
        raise ValueError(f"{record.name}: {unknown_name('plane', found, record.planes)}")
    if asked is None and len(record.planes) > 1 and found != "journal":
        raise ValueError(f"{record.name}: say which plane: {', '.join(record.planes)}")
    if found not in record.pairs:
        raise ValueError(f"{record.name}: {found} has one probe; free vibration needs x and y")
    return found


def _blows(record: Recording, plane: str, highest_hz: float) -> Iterator[_Blow]:
    """Speed, times from each blow, motion without the shaft's orders about where it settles, and that place.

    The place counts from the mean position over the recording.
    """
    shaft = record.shaft_angle()
    reduced = ReducedRate.for_band(highest_hz, record.sample_rate, record.size)
    inside = np.flatnonzero((reduced.time >= shaft.begin) & (reduced.time <= shaft.end))
    part = slice(int(inside[0]), int(inside[-1]) + 1)
    time, rate = reduced.time[part], reduced.rate
    angle = shaft.angle(time)
    z = motion_at(record, reduced, part, plane)
    left, level, size, noise, quiet = quiet_part(z, angle, rate)
    width = max(int(AVERAGING_TIME * rate), 1)
    loud = size > BLOW_OVER_MEDIAN * noise
    begins: list[int] = []
    for rise in (np.flatnonzero(loud[1:] & ~loud[:-1]) + 1).tolist():
        if not begins or quiet[begins[-1] : rise].any():  # a motion that dies out may rise again
            begins.append(rise)
    if not begins:
        raise ValueError(f"{record.name}: no blow stands out of the motion of {plane}")
    speed = float(np.mean(shaft.speed(time)))
    for begin, following in zip(begins, [*begins[1:], time.size], strict=True):
        first, end = begin + int(CONTACT_TIME * rate) + width // 2, following - width
        calm = np.flatnonzero(size[first:following] < 1.5 * noise)
        last = min(first + (int(calm[0]) if calm.size else following - first), end)
        settled = complex(np.mean(left[last:end] if end - last > 5 * width else level[first:following]))
        if last - first > 16:
            yield speed, time[first:last] - time[first], left[first:last] - settled, settled
