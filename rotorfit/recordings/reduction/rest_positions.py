"""Mean positions of a shaft in one recording, from the gap voltages of its probes, with their errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from rotorfit.models.array_types import ComplexArray, Float
from rotorfit.models.digits import significant
from rotorfit.recordings.reduction.reduced_rate import ReducedRate
from rotorfit.recordings.reduction.reduced_record import HIGHEST_ORDER, is_pair

if TYPE_CHECKING:
    from rotorfit.recordings.angle_track import AngleTrack
    from rotorfit.recordings.recording import Recording
    from rotorfit.recordings.rig.setup import Probe

POSITIONS = 20
"""Positions taken of a recording in which the speed changes."""
STEADY_SPEED_RANGE = 0.02
"""Change of the speed, relative, up to which it counts as one."""
_PARTS_OF_RECORD = 16
"""Parts of a recording whose mean voltages tell how well the mean of the whole is known."""


@dataclass(frozen=True, kw_only=True, eq=False)
class RestPosition:
    """Mean positions of one plane in one recording."""

    record: Recording  # the recording
    plane: str  # its plane
    speed: Float  # of the shaft, rad/s, shape ``(S,)``
    # ``x + jy`` from where each probe reads its ``centre``, or zero volts without one, m, shape ``(S,)``
    z: ComplexArray
    variance: Float  # of x and of y, their mean, m^2, shape ``(S,)``

    @property
    def from_centre(self) -> bool:
        """True if the position counts from the centre of the bearing."""
        return all(probe.centre is not None for probe in self.record.probes if probe.plane == self.plane)


def rest_positions(record: Recording) -> tuple[list[RestPosition], list[str]]:
    """Mean positions in all planes with two good probes, and why the others are left out.

    A recording of one speed gives one position a plane, one whose speed changes :data:`POSITIONS`. The error of a
    mean voltage is the scatter of the means of parts of the recording, slow drift included.
    """
    coupled = [name for name, each in record.statistics.items() if each.without_gap]
    if coupled:
        raise ValueError(
            f"{record.name}: {', '.join(coupled)} without gap voltage (AC-coupled?): there is no static position in it"
        )
    found, left_out = [], []
    for plane in record.planes:
        probes = [probe for probe in record.probes if probe.plane == plane]
        clipped = [probe.channel for probe in probes if record.statistics[probe.channel].clipped]
        if not is_pair(record, plane):
            left_out.append(f"{plane} has one probe")
        elif clipped:
            left_out.append(f"{', '.join(clipped)} of {plane} is clipped")
        else:
            found.append(_rest(record, plane, probes))
    if not found:
        raise ValueError(f"{record.name}: {'; '.join(left_out)}; a static position needs x and y of a plane")
    return found, left_out


def _rest(record: Recording, plane: str, probes: Sequence[Probe]) -> RestPosition:
    shaft = record.shaft_angle() if record.rig.shaft is not None else None
    edges, speeds = _stretches(record, shaft)
    fastest = 0.0 if shaft is None else float(np.abs(shaft.speed(np.linspace(shaft.begin, shaft.end, 200))).max())
    highest = 20.0  # highest frequency that matters of a shaft without marks, Hz
    reduced = ReducedRate.for_band(max(HIGHEST_ORDER * fastest / (2 * np.pi), highest), record.sample_rate, record.size)
    mean, variance = np.empty((2, len(probes), speeds.size))
    for p, probe in enumerate(probes):
        each, scale = record.statistics[probe.channel], float(probe.sensitivity or 1.0)
        volts = reduced.reduce(lambda first, last, name=probe.channel: record.channel(name, first, last)).real  # type: ignore[misc]
        # a signal that moves by less than a count is not known better than that
        rounding = each.step**2 / 12 if each.deviation < each.step else 0.0
        for s, (begin, end) in enumerate(edges):
            inside = (reduced.time >= begin) & (reduced.time <= end)
            if inside.sum() < 4 * _PARTS_OF_RECORD:
                raise ValueError(
                    f"{record.name}: {significant(end - begin, 3)} s are too short to tell a mean voltage and its error"
                )
            level, error = _mean(volts[inside], reduced.time[inside], shaft)
            mean[p, s], variance[p, s] = (level - (probe.centre or 0.0)) / scale, (error + rounding) / scale**2
    x, y = record.resolved(plane, mean)
    return RestPosition(
        record=record, plane=plane, speed=speeds, z=x + 1j * y, variance=record.resolved_variance(plane, variance)
    )


def _stretches(record: Recording, shaft: AngleTrack | None) -> tuple[list[tuple[float, float]], Float]:
    """Times from and to, and mean speeds, of what counts as one position each."""
    if shaft is None:
        return [(0.0, record.duration)], np.array([abs(record.speed or 0.0)])
    speeds = shaft.speed(np.linspace(shaft.begin, shaft.end, 400))
    count = 1 if np.ptp(speeds) <= STEADY_SPEED_RANGE * np.abs(speeds).mean() else POSITIONS
    edges = np.linspace(shaft.begin, shaft.end, count + 1)
    mean = np.diff(shaft.angle(edges)) / np.diff(edges)
    return list(zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True)), np.asarray(mean)


def _mean(volts: Float, time: Float, shaft: AngleTrack | None) -> tuple[float, float]:
    """Mean voltage without the shaft's orders, and its variance from the scatter over parts of the time."""
    parts = np.array_split(np.arange(volts.size), _PARTS_OF_RECORD)
    levels = np.array([_level(volts[part], time[part], shaft) for part in parts])
    pairs = levels.reshape(-1, 2).mean(axis=1)  # where voltages drift, longer parts scatter more than their length says
    return float(levels.mean()), float(max(levels.var(ddof=1) / levels.size, pairs.var(ddof=1) / pairs.size))


def _level(volts: Float, time: Float, shaft: AngleTrack | None) -> float:
    basis = [np.ones(volts.size)]
    if shaft is not None:
        angle = shaft.angle(time)
        turns = float(angle[-1] - angle[0]) / (2 * np.pi)
        orders = [n for n in range(1, HIGHEST_ORDER + 1) if n * turns > 1 and volts.size > 4 * HIGHEST_ORDER]
        basis += [wave(n * angle) for n in orders for wave in (np.cos, np.sin)]
    return float(np.linalg.lstsq(np.array(basis).T, volts, rcond=None)[0][0])
