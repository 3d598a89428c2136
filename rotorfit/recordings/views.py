"""Motion in a recording as its figures show it, as arrays: orbits, vectors over time, centreline, a whole recording."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rotorfit.estimators.signals.tracking import order_vectors
from rotorfit.models.array_types import ComplexArray, Float
from rotorfit.recordings.angle_track import Marks
from rotorfit.recordings.rig.setup import Probe
from rotorfit.recordings.signals import SAMPLES_OF_A_PIECE, Signals


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
    angles = [angle.angle(t) for angle in marks.present.values()]
    filtered = {}
    if angles:
        vectors = order_vectors(z.astype(complex), angles, 2)
        for name, angle, vector in zip(marks.present, angles, vectors, strict=True):
            once = np.exp(1j * angle)
            filtered[name] = vector[3] * once + vector[1] / once
    pulses = {name: angle.marks for name, angle in marks.present.items()}
    dots = {name: times[(times >= t[0]) & (times <= t[-1])] for name, times in pulses.items()}
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
    forward: dict[str, ComplexArray]  # amplitudes of the two directions in planes with two probes, complex, m, by plane
    backward: dict[str, ComplexArray]


def vectors_over_time(
    record: Signals, marks: Marks, reference: str, *, turns: float = 8.0, windows: int = 300
) -> OrderVectors:
    """Vectors by windows of some turns over the whole recording, the other mark's orders taken out."""
    main = marks.named(reference, record)
    others = [angle for name, angle in marks.present.items() if name != reference]
    centres = np.linspace(main.begin, main.end, windows)
    speed = main.speed(centres)
    phasors = np.full((len(record.probes), windows), np.nan + 0j)
    forward, backward = ({plane: np.full(windows, np.nan + 0j) for plane in record.pairs} for _ in range(2))
    for i, (middle, rate) in enumerate(zip(centres, speed, strict=True)):
        length = turns * 2 * np.pi / max(abs(rate), 1e-3)
        if middle - length / 2 < main.begin or middle + length / 2 > main.end:
            continue
        start, stop = _window(record, float(middle), length)
        t = np.arange(start, stop) / record.sample_rate
        angles = [*(angle.angle(t) for angle in others), main.angle(t)]  # who comes last must stand apart from the rest
        along = np.stack([record.displacement(probe, start, stop) for probe in record.probes]).astype(complex)
        phasors[:, i] = 2 * order_vectors(along, angles, 2)[-1, 3]
        for plane in record.pairs:
            x, y = record.resolved(plane, phasors[[p.plane == plane for p in record.probes], i])
            forward[plane][i], backward[plane][i] = (x + 1j * y) / 2, np.conj(x - 1j * y) / 2
    sites = tuple((probe.plane, float(probe.angle or 0.0)) for probe in record.probes)
    return OrderVectors(
        reference=reference, t=centres, speed=speed, phasors=phasors, probes=sites, forward=forward, backward=backward
    )


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
    circle = None if circle is None else replace(circle, centre=circle.centre - z[0])
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
        low, high = _blocks(record, probe)
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


def _blocks(record: Signals, probe: Probe) -> tuple[Float, Float]:
    """Least and largest of all blocks of a channel, read once."""
    known = record.__dict__.setdefault("_envelopes", {})
    if probe.channel not in known:
        parts = [
            _extremes(record.displacement(probe, begin, begin + SAMPLES_OF_A_PIECE), _BLOCK)
            for begin in range(0, record.size, SAMPLES_OF_A_PIECE)
        ]
        known[probe.channel] = tuple(np.concatenate(ends) for ends in zip(*parts, strict=True))
    low, high = known[probe.channel]
    return low, high
