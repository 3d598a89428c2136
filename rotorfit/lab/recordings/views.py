"""Motion in a recording as its figures show it, as arrays: orbits, vectors over time, centrelines, spectra, the twist.

The twist is read from a torsion channel in volts, or from tooth wheels at two planes. A tooth wheel gives an angle at
every tooth. The wheel at the evenly turning end is smoothed as any mark is; the other wheel's teeth, against that
angle, are samples of the twist. Errors of the spacing of teeth repeat every turn and are taken out as a pattern, and
with them what of the twist is locked to the shaft.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rotorfit.base.array_types import ComplexArray, Float
from rotorfit.base.names import unknown_name
from rotorfit.estimators.signals.pulse_numbers import number_pulses
from rotorfit.estimators.signals.pulses import find_edges, find_levels
from rotorfit.estimators.signals.spectral_lines import full_spectrum
from rotorfit.estimators.signals.tracking import order_vectors
from rotorfit.lab.recordings.angle_track import Marks, track
from rotorfit.lab.recordings.rig.setup import Probe, Reference
from rotorfit.lab.recordings.signals import SAMPLES_OF_A_PIECE, Signals, said_of


@dataclass(frozen=True, kw_only=True)
class Clearance:
    """The circle that the shaft can move in."""

    radius: float  # m
    centre: complex  # in the coordinates of the motion, m
    known: bool  # the probes' ``centre_V`` says where the centre is; it is the mean position of the recording otherwise


def clearance_of(record: Signals, plane: str, radius: float | None) -> Clearance | None:
    """The clearance of a plane: the radius given, m, or the setup's; None where neither says one."""
    size = record.rig.clearance.get(plane) if radius is None else radius
    if size is None:
        return None
    if not 0 < size < np.inf:
        raise ValueError(f"clearance is {size!r}; it is a radius above zero, m")
    centre = record.bearing_centre(plane)
    return Clearance(radius=size, centre=centre or 0j, known=centre is not None)


@dataclass(frozen=True, kw_only=True, eq=False)
class Stretch:
    """Motion of one plane over a short time."""

    plane: str  # its name
    t: Float  # s, shape ``(N,)``
    z: NDArray[Any]  # ``x + jy``, m; real for one probe
    dots: dict[str, Float]  # positions of each mark's pulses: times, s, by name of the mark
    filtered: dict[str, ComplexArray]
    speeds: dict[str, float]  # of each mark, rad/s, by name
    cleaned: bool  # run-out, as slow turning shows it, is taken out
    clearance: Clearance | None


def stretch(
    record: Signals, marks: Marks, plane: str, at: float | None, turns: float, clearance: float | None = None
) -> Stretch:
    """Motion of a plane over some turns of the slowest mark, with the radial clearance, m, or the setup's."""
    middle = record.duration / 2 if at is None else at
    if not 0 <= middle <= record.duration:
        raise ValueError(f"at = {middle:g} s is not within {record.name}, 0 to {record.duration:g} s")
    speeds = {name: float(angle.speed(np.array([middle]))[0]) for name, angle in marks.present.items()}
    slowest = min((abs(speed) for speed in speeds.values() if speed), default=2 * np.pi / max(record.duration, 1e-9))
    start, stop = _window(record, middle, turns * 2 * np.pi / slowest)
    z = np.asarray(record.motion(plane, start, stop))
    t = np.arange(start, stop) / record.sample_rate
    angles, filtered = [angle.angle(t) for angle in marks.present.values()], {}
    if angles:
        vectors = order_vectors(z.astype(complex), angles, 2)
        for name, angle, vector in zip(marks.present, angles, vectors, strict=True):
            once = np.exp(1j * angle)
            filtered[name] = vector[3] * once + vector[1] / once
    pulses = ((name, angle.marks) for name, angle in marks.present.items())
    dots = {name: times[(times >= t[0]) & (times <= t[-1])] for name, times in pulses}
    return Stretch(
        plane=plane,
        t=t,
        z=z,
        dots=dots,
        filtered=filtered,
        speeds=speeds,
        cleaned=record.rig.slow_roll is not None,
        clearance=clearance_of(record, plane, clearance),
    )


def _window(record: Signals, middle: float, length: float) -> tuple[int, int]:
    half = max(round(length / 2 * record.sample_rate), 16)
    start = max(round(middle * record.sample_rate) - half, 0)
    return min(start, max(record.size - 2 * half, 0)), min(start + 2 * half, record.size)


@dataclass(frozen=True, kw_only=True, eq=False)
class OrderVectors:
    """First-order vectors of all probes over a recording."""

    reference: str  # mark that they turn with
    t: Float  # middle of each window, s, shape ``(W,)``
    speed: Float  # of the mark, rad/s, shape ``(W,)``
    phasors: ComplexArray  # of each probe, ``Re(phasor exp(j angle))`` is its motion, m, shape ``(P, W)``
    probes: tuple[tuple[str, float], ...]  # plane and angle (rad) of each probe


def vectors_over_time(
    record: Signals, marks: Marks, reference: str, *, turns: float = 8.0, windows: int = 300
) -> OrderVectors:
    """Vectors by windows of some turns over the whole recording, the other mark's orders taken out."""
    main = marks.named(reference, record)
    others = [angle for name, angle in marks.present.items() if name != reference]
    centres = np.linspace(main.begin, main.end, windows)
    speed = main.speed(centres)
    phasors = np.full((len(record.probes), windows), np.nan + 0j)
    for i, (middle, rate) in enumerate(zip(centres, speed, strict=True)):
        length = turns * 2 * np.pi / max(abs(rate), 1e-3)
        if middle - length / 2 < main.begin or middle + length / 2 > main.end:
            continue
        start, stop = _window(record, float(middle), length)
        t = np.arange(start, stop) / record.sample_rate
        angles = [*(angle.angle(t) for angle in others), main.angle(t)]  # who comes last must stand apart from the rest
        along = np.stack([record.displacement(probe, start, stop) for probe in record.probes]).astype(complex)
        phasors[:, i] = 2 * order_vectors(along, angles, 2)[-1, 3]
    sites = tuple((probe.plane, float(probe.angle or 0.0)) for probe in record.probes)
    return OrderVectors(reference=reference, t=centres, speed=speed, phasors=phasors, probes=sites)


@dataclass(frozen=True, kw_only=True, eq=False)
class Centreline:
    """Mean position of the shaft in one plane over a recording, from the gap voltages."""

    plane: str  # its name
    t: Float  # s, shape ``(W,)``
    z: ComplexArray  # ``x + jy``, m, relative to the first, shape ``(W,)``
    speed: Float  # of the shaft, rad/s, NaN without a mark, shape ``(W,)``
    clearance: Clearance | None


def centreline(
    record: Signals, marks: Marks, plane: str, windows: int = 100, clearance: float | None = None
) -> Centreline:
    """Mean positions along the recording, by windows that overlap by half and fade at their ends: an orbit of more
    than two turns in a window leaves nothing. ``clearance``: radial, m, or the setup's.
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
    circle = clearance_of(record, plane, clearance)
    circle = circle and replace(circle, centre=circle.centre - z[0])
    return Centreline(plane=plane, t=t, z=z - z[0], speed=speed, clearance=circle)


_BLOCK = 512
"""Samples whose least and largest are kept once they were read: an hour of a channel is some ten thousand of them."""


def envelope(record: Signals, probe: Probe, start: float, stop: float, points: int) -> tuple[Float, Float]:
    """Displacement of the shaft along a probe from one time (s) to another, thinned out to so many pieces at most.

    Times, s, and displacements about the mean, m: of a piece its least and its largest, one after the other; where
    there are hardly more samples, all of them.
    """
    first = int(np.clip(np.floor(start * record.sample_rate), 0, record.size - 1))
    last = int(np.clip(np.ceil(stop * record.sample_rate) + 1, first + 1, record.size))
    size = -(-(last - first) // points)
    if size <= 2:
        return np.arange(first, last) / record.sample_rate, record.displacement(probe, first, last)
    if size < _BLOCK:
        least, most = _extremes(record.displacement(probe, first, last), size)
    else:
        known = record.__dict__.setdefault("_envelopes", {})  # of all blocks of a channel, read once
        if probe.channel not in known:
            starts = range(0, record.size, SAMPLES_OF_A_PIECE)
            pieces = (record.displacement(probe, begin, begin + SAMPLES_OF_A_PIECE) for begin in starts)
            ends = [_extremes(piece, _BLOCK) for piece in pieces]
            known[probe.channel] = tuple(np.concatenate(each) for each in zip(*ends, strict=True))
        low, high = known[probe.channel]
        first -= first % _BLOCK
        count, own = size // _BLOCK, slice(first // _BLOCK, -(-last // _BLOCK))
        least, most = _extremes(low[own], count)[0], _extremes(high[own], count)[1]
        size = count * _BLOCK
    middles = (first + size * (np.arange(least.size) + 0.5)) / record.sample_rate
    return np.repeat(middles, 2), np.column_stack([least, most]).ravel()


def _extremes(values: Float, size: int) -> tuple[Float, Float]:
    """Least and largest of consecutive pieces of so many values, the last of which may be shorter."""
    edges = np.arange(0, values.size, size)
    return np.minimum.reduceat(values, edges), np.maximum.reduceat(values, edges)


@dataclass(frozen=True, kw_only=True, eq=False)
class Cascade:
    """Spectra of one plane, or of the twist, one after the other."""

    over: str  # what tells them apart: ``time``, ``speed`` or ``perturbation``
    position: Float  # s or rad/s, shape ``(W,)``
    shaft: Float  # shaft speed at each spectrum, rad/s; NaN without a mark
    perturbation: Float  # speed of the perturbation at each spectrum, rad/s, signed by its whirl; NaN without a mark
    frequency: Float  # Hz, negative is backward, shape ``(F,)``; of one direction and of the twist not negative
    amplitude: Float  # m or rad, shape ``(W, F)``; a circle of radius A has A
    plane: str = ""  # its name; none of the twist
    direction: str | None = None  # x or y where the spectra are of the motion along it alone
    overall: Float | None = None  # of the twist: amplitude that a sine of the same mean square has, rad, shape ``(W,)``


def spectrum(record: Signals, plane: str, start: float, stop: float | None) -> tuple[Float, Float]:
    """Full spectrum of a plane over a stretch of time: frequencies (Hz) and amplitudes (m)."""
    first = round(max(start, 0.0) * record.sample_rate)
    last = record.size if stop is None else min(round(stop * record.sample_rate), record.size)
    last = min(last, first + (1 << 20))
    if last - first < 16:
        end = "the end" if stop is None else f"{stop:g} s"
        raise ValueError(f"{record.name}: no samples from {start:g} s to {end}")
    z = record.motion(plane, first, last)
    frequency, amplitude = full_spectrum(z.astype(complex), record.sample_rate)
    return frequency, amplitude if np.iscomplexobj(z) else 2 * amplitude


def cascade(
    record: Signals,
    marks: Marks,
    plane: str,
    *,
    over: str | None = None,
    spectra: int = 60,
    direction: str | None = None,
) -> Cascade:
    """Full spectra at even steps of time, speed or perturbation frequency, or those along x or y."""
    if direction not in (None, "x", "y"):
        raise ValueError(unknown_name("direction", str(direction), ("x", "y")))
    size, starts, places = _even_steps(record, marks, over, spectra)
    rows = []
    for start in starts:
        z = record.motion(plane, start, start + size)
        if direction is not None and not np.iscomplexobj(z):
            raise ValueError(f"{record.name}, {plane}: one probe reads this plane; leave direction out for its spectra")
        z = {"x": z.real, "y": z.imag}.get(direction or "", z)
        frequency, amplitude = full_spectrum(z.astype(complex), record.sample_rate, points=4)  # round lines
        rows.append(amplitude if np.iscomplexobj(z) else 2 * amplitude)
    shown = frequency >= (-np.inf if direction is None else 0)
    amplitude = np.array(rows)[:, shown]
    return Cascade(**places, plane=plane, direction=direction, frequency=frequency[shown], amplitude=amplitude)


def _even_steps(record: Signals, marks: Marks, over: str | None, spectra: int) -> tuple[int, list[int], dict[str, Any]]:
    """Even steps of time, speed or perturbation: samples of a spectrum, the first of each, and where these are."""
    if over is None:  # what changes
        over = "time"
        for name, angle in (("speed", marks.shaft), ("perturbation", marks.perturbator)):
            if angle is not None:
                speed = angle.speeds(50)
                over = name if np.ptp(speed) > 0.1 * np.abs(speed).max() else over
    if over not in ("time", "speed", "perturbation"):
        raise ValueError(unknown_name("axis of a cascade", over, ("time", "speed", "perturbation")))
    most_samples = 1 << 15  # most samples of a spectrum of a cascade
    size = min(int(np.clip(record.size // spectra * 2, 256, most_samples)), record.size)
    t = np.linspace(size / 2, record.size - size / 2, spectra) / record.sample_rate
    if over != "time":
        mark = marks.named("shaft" if over == "speed" else "perturbator", record)
        fine = np.linspace(t[0], t[-1], 20 * spectra)
        speed = mark.speed(fine)
        if not np.any(np.diff(speed) * (speed[-1] - speed[0]) <= 0):  # one way up or down; else in the order of time
            order = np.argsort(speed)
            t = np.interp(np.linspace(speed.min(), speed.max(), spectra), speed[order], fine[order])
    starts = np.clip(np.round(t * record.sample_rate) - size // 2, 0, record.size - size).astype(np.intp)
    nan = np.full(t.size, np.nan)
    shaft = nan if marks.shaft is None else marks.shaft.speed(t)
    perturbation = nan if marks.perturbator is None else marks.whirl * marks.perturbator.speed(t)
    position = {"time": t, "speed": shaft, "perturbation": np.abs(perturbation)}[over]
    return size, starts.tolist(), {"over": over, "position": position, "shaft": shaft, "perturbation": perturbation}


def steady_lines(marks: Marks, start: float, stop: float) -> dict[str, float]:
    """Frequencies of orders, Hz, by label, of the marks whose speed hardly changes meanwhile."""
    lines: dict[str, float] = {}
    t = np.linspace(start, stop, 50)
    for name, angle in marks.present.items():
        speed = angle.speed(t) / (2 * np.pi)
        if np.ptp(speed) < 0.02 * np.abs(speed).max():
            mean = float(speed.mean())
            lines |= {f"{k}x": k * mean for k in (-2, -1, 1, 2)} if name == "shaft" else {"w": marks.whirl * mean}
    return lines


def twist_of(record: Signals) -> Float:
    """Twist at every sample of a recording, its mean taken out, rad."""
    how = record.rig.twist
    if how is None:
        raise ValueError(f"{record.name} has no twist: name its channel, or two tooth wheels, in [twist]")
    if how.channel:
        volts = record.channel(how.channel)
        return np.asarray((volts - volts.mean()) / float(how.sensitivity or 1.0))
    from scipy.interpolate import CubicSpline

    teeth = int(how.teeth or 1)
    motor = track(record, Reference(channel=how.even_wheel, pulses_per_turn=teeth))
    name = str(how.wheel)
    with said_of(f"{record.name}, channel {name}"):
        levels = find_levels(record.channel(name))
        pulses = number_pulses(find_edges(record.pieces(name), levels) / record.sample_rate)
    step = 2 * np.pi / teeth
    twist = step * pulses.numbers - motor.angle(pulses.times)
    place = pulses.numbers % teeth
    count = np.maximum(np.bincount(place, minlength=teeth), 1)
    slope = np.polynomial.Polynomial.fit(pulses.times, twist, 1)  # an offset, and a drift that the pattern must not see
    twist = twist - slope(pulses.times)
    twist = twist - (np.bincount(place, twist, minlength=teeth) / count)[place]
    time = np.arange(record.size) / record.sample_rate
    inside = (time >= pulses.times[0]) & (time <= pulses.times[-1])
    return np.where(inside, CubicSpline(pulses.times, twist)(np.clip(time, *pulses.times[[0, -1]])), 0.0)


def twist_cascade(record: Signals, marks: Marks, *, over: str | None, spectra: int) -> Cascade:
    """Overall amplitude and spectra of the twist at even steps of time, speed or perturbation frequency."""
    twist = twist_of(record)
    size, starts, places = _even_steps(record, marks, over, spectra)
    parts = [twist[start : start + size] for start in starts]
    rows = [full_spectrum(part.astype(complex), record.sample_rate) for part in parts]
    shown = rows[0][0] >= 0
    return Cascade(
        **places,
        frequency=rows[0][0][shown],
        amplitude=2 * np.array([amplitude[shown] for _, amplitude in rows]),
        overall=np.array([float(np.sqrt(2) * part.std()) for part in parts]),
    )
