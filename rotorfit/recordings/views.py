"""What the figures of a recording show, as arrays: orbits, vectors, centreline, spectra, cascade and speeds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rotorfit.estimators.signals.order_vectors import order_vectors
from rotorfit.estimators.signals.spectral_lines import full_spectrum
from rotorfit.models.array_types import ComplexArray, Float
from rotorfit.models.parameters import unknown_name
from rotorfit.recordings.angle_track import AngleTrack
from rotorfit.recordings.signals import Signals

_MARKS = ("shaft", "perturbator")
_LINES = 1 << 15
"""Most samples of a spectrum of a cascade."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Marks:
    """The two angles of a recording, either may be missing."""

    shaft: AngleTrack | None
    perturbator: AngleTrack | None
    whirl: int = 1

    def named(self, name: str, record: Signals) -> AngleTrack:
        """The angle of a mark.

        Raises:
            ValueError: no such mark in this recording.
        """
        if name not in _MARKS:
            raise ValueError(unknown_name("reference", name, _MARKS))
        found = self.shaft if name == "shaft" else self.perturbator
        if found is None:
            raise ValueError(f"{record.name} has no phase reference of the {name}")
        return found

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
class Stretch:
    """Motion of one plane over a short time.

    Attributes:
        plane: its name.
        t: s, shape ``(N,)``.
        z: ``x + jy``, m; real for one probe.
        dots: positions of each mark's pulses: times, s, by name of the mark.
        filtered: the parts of the motion that turn with each mark (first order, both directions), m, by name.
        speeds: of each mark, rad/s, by name.
    """

    plane: str
    t: Float
    z: NDArray[Any]
    dots: dict[str, Float]
    filtered: dict[str, ComplexArray]
    speeds: dict[str, float]


def stretch(record: Signals, marks: Marks, plane: str, at: float | None, turns: float) -> Stretch:
    """Motion of a plane over some turns of the slowest mark.

    Args:
        record: the recording.
        marks: its angles.
        plane: one of its planes.
        at: middle, s; None: the middle of the recording.
        turns: how many.

    Raises:
        ValueError: no such plane or time.
    """
    middle = record.duration / 2 if at is None else at
    if not 0 <= middle <= record.duration:
        raise ValueError(f"at = {middle:g} s is not within {record.name}, 0 to {record.duration:g} s")
    speeds = {name: float(angle.speed(np.array([middle]))[0]) for name, angle in marks.present.items()}
    slowest = min((abs(speed) for speed in speeds.values() if speed), default=2 * np.pi / max(record.duration, 1e-9))
    start, stop = _window(record, middle, turns * 2 * np.pi / slowest)
    z = np.asarray(record.motion(plane, start, stop))
    t = np.arange(start, stop) / record.sample_rate
    angles = [angle.angle(t) for angle in marks.present.values()]
    filtered = {}
    if angles:
        vectors = order_vectors(z.astype(complex), angles, 2)
        for name, angle, vector in zip(marks.present, angles, vectors, strict=True):
            once = np.exp(1j * angle)
            filtered[name] = vector[3] * once + vector[1] / once
    pulses = {name: angle.marks for name, angle in marks.present.items()}
    dots = {name: times[(times >= t[0]) & (times <= t[-1])] for name, times in pulses.items()}
    return Stretch(plane=plane, t=t, z=z, dots=dots, filtered=filtered, speeds=speeds)


def _window(record: Signals, middle: float, length: float) -> tuple[int, int]:
    half = max(round(length / 2 * record.sample_rate), 16)
    start = max(round(middle * record.sample_rate) - half, 0)
    return min(start, max(record.size - 2 * half, 0)), min(start + 2 * half, record.size)


@dataclass(frozen=True, kw_only=True, eq=False)
class OrderVectors:
    """First-order vectors of all probes over a recording.

    Attributes:
        reference: mark that they turn with.
        t: middle of each window, s, shape ``(W,)``.
        speed: of the mark, rad/s, shape ``(W,)``.
        phasors: of each probe, ``Re(phasor exp(j angle))`` is its motion, m, shape ``(P, W)``.
        probes: plane and angle (rad) of each probe.
        forward, backward: amplitudes of the two directions in planes with two probes, complex, m, by plane.
    """

    reference: str
    t: Float
    speed: Float
    phasors: ComplexArray
    probes: tuple[tuple[str, float], ...]
    forward: dict[str, ComplexArray]
    backward: dict[str, ComplexArray]


def vectors_over_time(
    record: Signals, marks: Marks, reference: str, *, turns: float = 8.0, windows: int = 300
) -> OrderVectors:
    """Vectors by windows of some turns over the whole recording, the other mark's orders taken out.

    Args:
        record: the recording.
        marks: its angles.
        reference: ``"shaft"`` or ``"perturbator"``.
        turns: of the reference in a window.
        windows: how many.

    Raises:
        ValueError: no such mark.
    """
    main = marks.named(reference, record)
    others = [angle for name, angle in marks.present.items() if name != reference]
    centres = np.linspace(main.begin, main.end, windows)
    speed = main.speed(centres)
    phasors = np.full((len(record.probes), windows), np.nan + 0j)
    pairs = [plane for plane in record.planes if sum(probe.plane == plane for probe in record.probes) > 1]
    forward = {plane: np.full(windows, np.nan + 0j) for plane in pairs}
    backward = {plane: np.full(windows, np.nan + 0j) for plane in pairs}
    for i, (middle, rate) in enumerate(zip(centres, speed, strict=True)):
        length = turns * 2 * np.pi / max(abs(rate), 1e-3)
        if middle - length / 2 < main.begin or middle + length / 2 > main.end:
            continue
        start, stop = _window(record, float(middle), length)
        t = np.arange(start, stop) / record.sample_rate
        angles = [*(angle.angle(t) for angle in others), main.angle(t)]  # who comes last must stand apart from the rest
        along = np.stack([record.displacement(probe, start, stop) for probe in record.probes]).astype(complex)
        phasors[:, i] = 2 * order_vectors(along, angles, 2)[-1, 3]
        for plane in pairs:
            x, y = record.resolved(plane, phasors[[p.plane == plane for p in record.probes], i])
            forward[plane][i], backward[plane][i] = (x + 1j * y) / 2, np.conj(x - 1j * y) / 2
    sites = tuple((probe.plane, float(probe.angle or 0.0)) for probe in record.probes)
    return OrderVectors(
        reference=reference, t=centres, speed=speed, phasors=phasors, probes=sites, forward=forward, backward=backward
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class Centreline:
    """Mean position of the shaft in one plane over a recording, from the gap voltages.

    Attributes:
        plane: its name.
        t: s, shape ``(W,)``.
        z: ``x + jy``, m, relative to the first, shape ``(W,)``.
        speed: of the shaft, rad/s, NaN without a mark, shape ``(W,)``.
    """

    plane: str
    t: Float
    z: ComplexArray
    speed: Float


def centreline(record: Signals, marks: Marks, plane: str, windows: int = 100) -> Centreline:
    """Mean positions along the recording, by windows that overlap by half and fade at their ends: an orbit of more
    than two turns in a window leaves nothing.

    Raises:
        ValueError: no such plane, or one with a single probe.
    """
    if not np.iscomplexobj(record.motion(plane, 0, 1)):
        raise ValueError(f"{record.name}: {plane} has one probe; a centreline needs two")
    edges = np.linspace(0, record.size, min(windows, record.size // 64) + 1).astype(int).tolist()
    means = []
    for begin, end in zip(edges[:-2], edges[2:], strict=True):
        weight = np.hanning(end - begin + 2)[1:-1]
        means.append(complex(weight @ record.motion(plane, begin, end) / weight.sum()))
    z = np.array(means)
    t = np.array(edges[1:-1]) / record.sample_rate
    speed = np.full(t.size, np.nan) if marks.shaft is None else marks.shaft.speed(t)
    return Centreline(plane=plane, t=t, z=z - z[0], speed=speed)


@dataclass(frozen=True, kw_only=True, eq=False)
class Cascade:
    """Full spectra of one plane, one after the other.

    Attributes:
        plane: its name.
        over: what tells them apart: ``time``, ``speed`` or ``perturbation``.
        position: s or rad/s, shape ``(W,)``.
        frequency: Hz, negative is backward, shape ``(F,)``.
        amplitude: m, shape ``(W, F)``; a circle of radius A has A.
        shaft, perturbation: speeds at each spectrum, rad/s (perturbation signed by its whirl); NaN without a mark.
    """

    plane: str
    over: str
    position: Float
    frequency: Float
    amplitude: Float
    shaft: Float
    perturbation: Float


def spectrum(record: Signals, plane: str, start: float, stop: float | None) -> tuple[Float, Float]:
    """Full spectrum of a plane over a stretch of time: frequencies (Hz) and amplitudes (m).

    Args:
        record: the recording.
        plane: one of its planes.
        start, stop: s; by default all, of a long recording the first million samples.

    Raises:
        ValueError: no such plane, or a stretch that is empty.
    """
    first = round(max(start, 0.0) * record.sample_rate)
    last = record.size if stop is None else min(round(stop * record.sample_rate), record.size)
    last = min(last, first + (1 << 20))
    if last - first < 16:
        end = "the end" if stop is None else f"{stop:g} s"
        raise ValueError(f"{record.name}: no samples from {start:g} s to {end}")
    z = record.motion(plane, first, last)
    frequency, amplitude = full_spectrum(z.astype(complex), record.sample_rate)
    return frequency, amplitude if np.iscomplexobj(z) else 2 * amplitude


def cascade(record: Signals, marks: Marks, plane: str, *, over: str | None = None, spectra: int = 60) -> Cascade:
    """Full spectra at even steps of time, speed or perturbation frequency.

    Args:
        record: the recording.
        marks: its angles.
        plane: one of its planes.
        over: ``"time"``, ``"speed"`` or ``"perturbation"``; None: what changes in this recording.
        spectra: how many.

    Raises:
        ValueError: no such plane, or a mark that is missing for what is asked.
    """
    places = cascade_times(record, marks, over, spectra)
    rows = []
    for start in places.starts.tolist():
        z = record.motion(plane, start, start + places.size)
        frequency, amplitude = full_spectrum(z.astype(complex), record.sample_rate)
        rows.append(amplitude if np.iscomplexobj(z) else 2 * amplitude)
    return Cascade(
        plane=plane, over=places.over, position=places.position, frequency=frequency, amplitude=np.array(rows),
        shaft=places.shaft, perturbation=places.perturbation,
    )  # fmt: skip


@dataclass(frozen=True, kw_only=True, eq=False)
class CascadeTimes:
    """Where the spectra of a cascade are taken.

    Attributes:
        over: what tells them apart: ``time``, ``speed`` or ``perturbation``.
        size: samples of each.
        starts: first sample of each, shape ``(W,)``.
        position: s or rad/s, shape ``(W,)``.
        shaft, perturbation: speeds at each spectrum, rad/s, the latter signed; NaN without a mark.
    """

    over: str
    size: int
    starts: NDArray[np.intp]
    position: Float
    shaft: Float
    perturbation: Float


def cascade_times(record: Signals, marks: Marks, over: str | None, spectra: int) -> CascadeTimes:
    """Even steps of time, speed or perturbation frequency; arguments and errors as for :func:`cascade`."""
    over = _changing(marks) if over is None else over
    if over not in ("time", "speed", "perturbation"):
        raise ValueError(unknown_name("axis of a cascade", over, ("time", "speed", "perturbation")))
    size = int(np.clip(record.size // spectra * 2, 256, _LINES))
    size = min(size, record.size)
    t = np.linspace(size / 2, record.size - size / 2, spectra) / record.sample_rate
    if over != "time":
        mark = marks.named("shaft" if over == "speed" else "perturbator", record)
        fine = np.linspace(t[0], t[-1], 20 * spectra)
        speed = mark.speed(fine)
        if np.any(np.diff(speed) * (speed[-1] - speed[0]) <= 0):  # not one way up or down: in the order of time
            at = t
        else:
            order = np.argsort(speed)
            at = np.interp(np.linspace(speed.min(), speed.max(), spectra), speed[order], fine[order])
        t = at
    middles = np.round(t * record.sample_rate) - size // 2
    nan = np.full(t.size, np.nan)
    shaft = nan if marks.shaft is None else marks.shaft.speed(t)
    perturbation = nan if marks.perturbator is None else marks.whirl * marks.perturbator.speed(t)
    return CascadeTimes(
        over=over,
        size=size,
        starts=np.clip(middles, 0, record.size - size).astype(np.intp),
        position={"time": t, "speed": shaft, "perturbation": np.abs(perturbation)}[over],
        shaft=shaft,
        perturbation=perturbation,
    )


def _changing(marks: Marks) -> str:
    for name, angle in (("perturbation", marks.perturbator), ("speed", marks.shaft)):
        if angle is not None:
            speed = angle.speed(np.linspace(angle.begin, angle.end, 50))
            if np.ptp(speed) > 0.1 * np.abs(speed).max():
                return name
    return "time"


@dataclass(frozen=True, kw_only=True, eq=False)
class SpeedTrack:
    """Speed of one mark over a recording.

    Attributes:
        mark: ``shaft`` or ``perturbator``.
        t: s, shape ``(N,)``.
        speed: rad/s, smoothed.
        acceleration: rad/s^2.
        raw_t, raw_speed: between one pulse and the next, s and rad/s.
    """

    mark: str
    t: Float
    speed: Float
    acceleration: Float
    raw_t: Float
    raw_speed: Float


def speeds(marks: Marks, points: int = 2000) -> list[SpeedTrack]:
    """Speed of each mark between its first and its last pulse, with the speed that single intervals would give."""
    found = []
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


def steady_lines(marks: Marks, start: float, stop: float) -> dict[str, float]:
    """Frequencies of orders, Hz, of the marks whose speed hardly changes from one time (s) to another, by label."""
    lines: dict[str, float] = {}
    t = np.linspace(start, stop, 50)
    for name, angle in marks.present.items():
        speed = angle.speed(t) / (2 * np.pi)
        if np.ptp(speed) < 0.02 * np.abs(speed).max():
            mean = float(speed.mean())
            lines |= {f"{k}x": k * mean for k in (-2, -1, 1, 2)} if name == "shaft" else {"w": marks.whirl * mean}
    return lines
