"""Angle of a shaft or a perturbator over a recording, from its phase reference, with what was mended on the way."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from rotorfit.base.array_types import Float
from rotorfit.base.names import unknown_name
from rotorfit.estimators.signals.pulse_numbers import NumberedPulses, from_index, number_pulses, uneven_turns
from rotorfit.estimators.signals.pulses import find_edges, find_levels
from rotorfit.estimators.signals.shaft_angle import SmoothAngle, smooth_angle
from rotorfit.estimators.signals.spectral_lines import steady_angle
from rotorfit.lab.data.findings import Finding, listed
from rotorfit.lab.recordings.rig.setup import Reference
from rotorfit.lab.recordings.signals import Signals, said_of


@dataclass(frozen=True, kw_only=True, eq=False)
class AngleTrack(SmoothAngle):
    """Angle, speed and acceleration over a recording; the angle grows whichever way the perturbator turns."""

    pulses: Float  # times of the pulses used, s, shape ``(N,)``
    pulses_per_turn: int = 1  # of the wheel
    findings: tuple[Finding, ...] = ()  # missing, double and noisy pulses, and what else was odd

    def speeds(self, count: int = 200) -> Float:
        """Speed at even times from the first pulse to the last, rad/s."""
        return self.speed(np.linspace(self.begin, self.end, count))

    @property
    def marks(self) -> Float:
        """Times of the pulses that begin a turn, s: all of them for one pulse a turn."""
        count = np.round(self.angle(self.pulses) / (2 * np.pi) * self.pulses_per_turn)
        return np.asarray(self.pulses[count % self.pulses_per_turn == 0])


def track(record: Signals, reference: Reference) -> AngleTrack:
    """The angle that a phase reference of a recording gives."""
    channel, per_turn = str(reference.channel), reference.pulses_per_turn or 1
    where = f"{record.name}, channel {channel}"
    with said_of(where):
        levels = find_levels(_sample(record, channel), edge=reference.edge or "", level=reference.level)
        times = find_edges(record.pieces(channel), levels) / record.sample_rate / (1 + (reference.clock or 0.0))
        pulses, gap = from_index(number_pulses(times), per_turn) if per_turn > 1 else (number_pulses(times), 0)
        resolution = 1 / record.sample_rate
        smooth = smooth_angle(pulses, duration=record.duration, pulses_per_turn=per_turn, resolution=resolution)
    findings = [*_of_pulses(where, pulses, smooth), *_of_ends(where, record, smooth)]
    if reference.edge is None and levels.duty > 0.4:
        text = (
            f"{where}: the pulse lasts {levels.duty:.0%} of a turn, so its leading edge is not clear; the "
            f'{"falling" if levels.falling else "rising"} edge was taken. Say edge = "falling" or "rising".'
        )
        findings.insert(0, _warning("keyphasor-edge", text))
    if per_turn > 1:
        findings.append(_wheel(where, smooth, per_turn, gap))
    used = ~np.isin(pulses.times, smooth.outlying)
    kept = pulses.times[used]
    uneven = uneven_turns(kept, np.diff(pulses.numbers[used]))  # of lengths that no shaft makes: counted wrong
    if uneven.size:
        text = (
            f"{where}: turns jump in length at {_times(uneven)}: pulses are missing or double there, and the turns "
            "cannot be counted for sure. Set the trigger level anew (level_V), or cut that part of the record off."
        )
        findings.append(Finding("error", "pulses-uneven", text))
    return AngleTrack(**vars(smooth), pulses=kept, pulses_per_turn=per_turn, findings=tuple(findings))


def _sample(record: Signals, channel: str) -> Float:
    """Enough of a channel to know its levels: all of a short one, pieces of a long one."""
    length = 1 << 16
    stretches = 12  # pieces of a channel from which the levels of its pulses are found
    if record.size <= stretches * length:
        return record.channel(channel)
    starts = np.linspace(0, record.size - length, stretches).astype(int)
    return np.concatenate([record.channel(channel, int(s), int(s) + length) for s in starts])


def _of_pulses(where: str, pulses: NumberedPulses, smooth: SmoothAngle) -> Iterator[Finding]:
    if pulses.missing.size:
        count, longest = int(pulses.missing_count.sum()), int(pulses.missing_count.max())
        text = f"{count} pulses missing, after {_times(pulses.missing)}; the angle runs on through the gaps."
        if longest > 5:
            at = pulses.missing[int(pulses.missing_count.argmax())]
            text += f" Of the {longest} in a row after {at:.3f} s it is not certain that they were counted right."
        yield _warning("pulses-missing", f"{where}: {text}")
    if pulses.extra.size:
        text = f"{pulses.extra.size} edges that are no pulses left out, at {_times(pulses.extra)}."
        yield _warning("pulses-double", f"{where}: {text}")
    if pulses.unsure.size:
        when = listed([f"{begin:.3f} to {end:.3f} s" for begin, end in pulses.unsure])
        yield _warning(
            "pulses-unsure",
            f"{where}: from {when} missing and double pulses stand so close to one another, or to the end, that it is "
            "not certain which edges are pulses. Where one is wrong the speed (plot_speed) bends: cut that part off.",
        )
    if smooth.outlying.size:
        text = f"{smooth.outlying.size} pulses far off their place left out, at {_times(smooth.outlying)}."
        largest_outlying_share = 0.05  # of the pulses, from which turns may have been lost
        lost = smooth.outlying.size > largest_outlying_share * pulses.times.size
        if lost:
            text += (
                " With so many the turns cannot be counted for sure: set the level of the trigger anew (level_V), or"
                " cut the record where samples of it were lost."
            )
        yield Finding("error" if lost else "warning", "pulses-noisy", f"{where}: {text}")


def _warning(code: str, message: str) -> Finding:
    return Finding("warning", code, message)


def _of_ends(where: str, record: Signals, smooth: SmoothAngle) -> Iterator[Finding]:
    """A shaft that stood still at one end of the record, or a mark that failed there."""
    after = record.duration - smooth.end
    for gap, at, words in ((smooth.begin, smooth.begin, "before the first"), (after, smooth.end, "after the last")):
        turns = gap * float(smooth.speed(np.array([at]))[0]) / (2 * np.pi)
        if turns > 2.5:
            yield _warning(
                "pulses-end",
                f"{where}: no pulses in the {gap:.3f} s {words} ({turns:.0f} turns at the speed there); the angle is "
                "not known in them.",
            )


def _wheel(where: str, smooth: SmoothAngle, per_turn: int, gap: int) -> Finding:
    degrees = np.abs(np.degrees(smooth.pattern)).max()
    zero = "the record's first pulse, which differs from record to record"
    if gap:
        zero = f"the first tooth after the gap of {gap} that every turn has"
    words = (
        f"{where}: spacing of the {per_turn} pulses a turn is off by up to {degrees:.3f} degrees; the pattern is taken "
        f"out. Angle zero is {zero}."
    )
    return Finding("note", "tooth-pattern", words)


def _times(times: Float) -> str:
    return listed([f"{t:.3f} s" for t in times])


def steady_track(record: Signals, shaft: AngleTrack | None, whirl: int) -> AngleTrack:
    """The angle of a perturbator that has no mark and runs at one frequency."""
    stop = min(record.size, 1 << 21)
    planes = record.planes[:2]
    if not planes:
        raise ValueError(f"{record.name} has no probes to find the frequency of the perturbation from")
    motions = (np.asarray(record.motion(plane, 0, stop), dtype=complex) for plane in planes)
    z = max(motions, key=lambda motion: float(np.std(motion)))
    turning = 0.0 if shaft is None else float(np.mean(shaft.speeds())) / (2 * np.pi)
    orders = [k * turning for k in range(-10, 11)] if turning else [0.0]
    with said_of(f"{record.name}, perturbator without a mark"):
        smooth = steady_angle(z, record.sample_rate, whirl, orders)
    hertz = float(smooth.speed(np.array([0.0]))[0]) / (2 * np.pi)
    text = (
        f"{record.name}: the perturbator has no mark; it runs at {hertz:.4f} Hz by the motion. Its phase counts from "
        'the start of the recording: fit with phase_offsets="common" or True.'
    )
    said = Finding("note", "steady-perturbation", text)
    return AngleTrack(**vars(smooth), pulses=np.zeros(0), findings=(said,))


_MARKS = ("shaft", "perturbator")


@dataclass(frozen=True, kw_only=True, eq=False)
class Marks:
    """The two angles of a recording, either may be missing."""

    shaft: AngleTrack | None  # angle of the shaft, ``None`` without its mark
    perturbator: AngleTrack | None  # angle of the perturbator, growing whichever way it turns, likewise
    whirl: int = 1  # +1 where the perturbator turns with the shaft, -1 against it

    def named(self, name: str, record: Signals) -> AngleTrack:
        """The angle of a mark."""
        if name not in _MARKS:
            raise ValueError(unknown_name("reference", name, _MARKS))
        if name not in self.present:
            raise ValueError(f"{record.name} has no phase reference of the {name}")
        return self.present[name]

    @property
    def main(self) -> str:
        """The mark that the force is locked to: the perturbator's where there is one."""
        return "shaft" if self.perturbator is None else "perturbator"

    @property
    def present(self) -> dict[str, AngleTrack]:
        """Those that there are, by name."""
        both = zip(_MARKS, (self.shaft, self.perturbator), strict=True)
        return {name: angle for name, angle in both if angle is not None}


@dataclass(frozen=True, kw_only=True, eq=False)
class SpeedTrack:
    """Speed of one mark over a recording."""

    mark: str  # ``shaft`` or ``perturbator``
    t: Float  # s, shape ``(N,)``
    speed: Float  # rad/s, smoothed
    acceleration: Float  # rad/s^2
    raw_t: Float  # middle between one pulse and the next, s
    raw_speed: Float  # speed from one pulse to the next, rad/s


def speeds(marks: Marks) -> list[SpeedTrack]:
    """Speed of each mark between its first and its last pulse, with the speed that single intervals would give."""
    found, points = [], 2000
    for name, angle in marks.present.items():
        t = np.linspace(angle.begin, angle.end, points)
        pulses = angle.pulses[:: max(angle.pulses.size // (5 * points), 1)]
        nominal = np.round(np.diff(angle.angle(pulses)) / (2 * np.pi) * angle.pulses_per_turn) / angle.pulses_per_turn
        found.append(
            SpeedTrack(
                mark=name,
                t=t,
                speed=angle.speed(t),
                acceleration=angle.acceleration(t),
                raw_t=(pulses[1:] + pulses[:-1]) / 2,
                raw_speed=2 * np.pi * nominal / np.diff(pulses),
            )
        )
    return found
