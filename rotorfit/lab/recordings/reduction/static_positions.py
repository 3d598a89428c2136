"""Where a loaded shaft rests, from gap voltages of recordings under constant loads: static-load records for a fit."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rotorfit.base.array_types import ComplexArray, Float
from rotorfit.base.digits import significant
from rotorfit.base.executors import carry_out
from rotorfit.base.units import RPM_PER_RAD_S
from rotorfit.lab.data.findings import Finding
from rotorfit.lab.kinds.static_test import StaticTest
from rotorfit.lab.recordings.angle_track import AngleTrack
from rotorfit.lab.recordings.recording import Recording, named_apart
from rotorfit.lab.recordings.reduction.reduced_record import HIGHEST_ORDER, ReducedRate
from rotorfit.lab.recordings.reduction.response_lines import Report
from rotorfit.lab.recordings.rig.setup import Probe
from rotorfit.lab.recordings.signals import source_of

STEADY_SPEED_RANGE = 0.02
"""Change of the speed, relative, up to which it counts as one."""


class _Zero(NamedTuple):
    """Where a plane is without load."""

    z: complex = 0.0  # m
    variance: float = 0.0  # of x and of y, m^2
    repeat: float = 0.0  # variance from one recording to the next beyond what each tells of itself, m^2


def static_positions(
    records: Sequence[Recording] | Recording,
    *,
    executor: Executor | None = None,
) -> StaticTest:
    """Positions of a shaft under constant loads, from the mean voltages of its probes, for fits.

    A recording of one speed gives one position a plane, one whose speed changes twenty. Positions count from the centre
    of the bearing where the setup says ``centre_V`` of the probes, else from where the shaft rests in the recordings
    without load (``N = 0``): of the same speed, or of the nearest one.

    Positions that count from the same recordings share the error of these. Each gets that variance as many times as
    there are such positions, so that together they know no more than those recordings do. Where these were repeated at
    a speed, their scatter is that of every position.

    Args:
        records: of one rig, DC-coupled, with their loads in ``[load]``.
        executor: reads recordings beside each other, see :func:`rotorfit.responses`.

    Raises:
        ValueError: a recording whose load is not given, without gap voltages or without a plane of two good probes, no
            load at all, or nothing to count positions from.

    Example:
        >>> rotor = rf.models.WhirlWhip()
        >>> truth = {"Md": 1.0, "Ds": 3.0, "K1": 13e3, "K2": 15e3, "sigma": 1.0, "K3": 6e3, "Mb": 0.3}
        >>> truth |= {"K0": 3e3, "D": 450.0, "lam": 0.47, "Mf": 0.35}
        >>> files = rf.simulate_recordings(rotor, truth, folder, "static-load", load=[4.0, 8.0], duration=2.0)
        >>> test = rf.static_positions([rf.read_recording(file) for file in files])
        >>> [f"{1e6 * abs(z):.0f} um" for z in test.displacement[test.plane == "journal"]]
        ['111 um', '222 um']
    """
    listed = named_apart(records)
    findings: list[Finding] = []
    rests: list[RestPosition] = []
    for record in listed:
        record.need_displacements("a static position")
        load_of(record)
    reduced = carry_out(_rests, listed, executor)
    for record, (found, left_out, own) in zip(listed, reduced, strict=True):
        findings += own
        rests += [replace(rest, record=record) for rest in found]
        for why in left_out:
            words = f"{record.name}: {why}: no static position of that plane."
            findings.append(Finding("warning", "plane-left-out", words))
    loaded = [rest for rest in rests if load_of(rest.record)]
    if not loaded:
        raise ValueError(f"{listed[0].name}: none of the recordings has a load above zero; give N in [load]")
    zeros = _zeros(loaded, [rest for rest in rests if not load_of(rest.record)], findings.append)
    test = _test(loaded, zeros, source_of(listed))
    return replace(test, findings=tuple(findings))


def _rests(record: Recording) -> tuple[list[RestPosition], list[str], tuple[Finding, ...]]:
    """What a recording says of its rest positions, and what was found odd in it."""
    return (*rest_positions(record), record.findings)


def load_of(record: Recording) -> complex:
    """Constant load of a recording, N."""
    if record.rig.load is None:
        lacking = "give plane, N and angle_deg in [load], N = 0 where there is none"
        raise ValueError(f"{record.name}: nothing says what constant load acts; {lacking}")
    return record.rig.load.newton


def _zeros(loaded: Sequence[RestPosition], unloaded: Sequence[RestPosition], report: Report) -> list[_Zero]:
    """For each rest the place that it counts from; the same object for those that share it."""
    made: dict[tuple[str, float], _Zero] = {}
    found = []
    for rest in loaded:
        if rest.from_centre:
            found.append(made.setdefault(("", 0.0), _Zero()))
            continue
        own = [other for other in unloaded if other.plane == rest.plane]
        if not own:
            raise ValueError(
                f"{rest.record.name}: nothing to count the position of {rest.plane} from: give centre_V of its probes "
                "in [[probe]], or record it without load too, N = 0 in [load]"
            )
        if rest.speed.size > 1 or any(other.speed.size > 1 for other in own):
            raise ValueError(
                f"{rest.record.name}: the speed changes, in it or in the recordings without load; positions at many "
                "speeds need centre_V of the probes in [[probe]]"
            )
        at = float(rest.speed[0])
        nearest = min((float(other.speed[0]) for other in own), key=lambda speed: abs(speed - at))
        if abs(nearest - at) > STEADY_SPEED_RANGE * max(abs(nearest), abs(at)):
            message = (
                f"{rest.record.name}: no recording without load at {at * RPM_PER_RAD_S:.0f} rpm; its position counts "
                f"from that at {nearest * RPM_PER_RAD_S:.0f} rpm, and what the speed moves the shaft by is in it."
            )
            report(Finding("warning", "unloaded-elsewhere", message))
        found.append(made.setdefault((rest.plane, round(nearest, 6)), _zero(own, nearest)))
    return found


def _zero(unloaded: Sequence[RestPosition], speed: float) -> _Zero:
    """Mean of the positions without load at about a speed."""
    most = STEADY_SPEED_RANGE * max(abs(speed), 1e-9)
    near = [rest for rest in unloaded if abs(float(rest.speed[0]) - speed) <= most]
    z = np.array([rest.z[0] for rest in near])
    own = float(np.mean([rest.variance[0] for rest in near]))
    scatter = float(np.sum(np.abs(z - z.mean()) ** 2) / (2 * (z.size - 1))) if z.size > 1 else 0.0
    return _Zero(z=complex(z.mean()), variance=max(own, scatter) / z.size, repeat=max(scatter - own, 0.0))


def _test(loaded: Sequence[RestPosition], zeros: Sequence[_Zero], source: str) -> StaticTest:
    sizes = [rest.z.size for rest in loaded]
    sharing = [sum(size for size, other in zip(sizes, zeros, strict=True) if other is zero) for zero in zeros]
    sigma = [
        np.sqrt(rest.variance + zero.repeat + count * zero.variance)
        for rest, zero, count in zip(loaded, zeros, sharing, strict=True)
    ]
    names = dict.fromkeys(name for rest in loaded for name in rest.record.attributes)

    def each(values: Sequence[Any]) -> NDArray[Any]:
        return np.repeat(np.array(values), sizes)

    return StaticTest(
        run=each([rest.record.name for rest in loaded]),
        speed=np.concatenate([rest.speed for rest in loaded]),
        load_plane=each([rest.record.rig.load.plane for rest in loaded if rest.record.rig.load is not None]),
        load=each([load_of(rest.record) for rest in loaded]),
        plane=each([rest.plane for rest in loaded]),
        displacement=np.concatenate([rest.z - zero.z for rest, zero in zip(loaded, zeros, strict=True)]),
        sigma=np.concatenate(sigma),
        attributes={name: each([rest.record.attributes.get(name, np.nan) for rest in loaded]) for name in names},
        source=source,
    )


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

    A recording of one speed gives one position a plane, one whose speed changes twenty. The error of a mean voltage is
    the scatter of the means of parts of the recording, slow drift included.
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
        if plane not in record.pairs:
            left_out.append(f"{plane} has one probe")
        elif clipped:
            left_out.append(f"{', '.join(clipped)} of {plane} is clipped")
        else:
            found.append(_rest(record, plane, probes))
    if not found:
        raise ValueError(f"{record.name}: {'; '.join(left_out)}; a static position needs x and y of a plane")
    return found, left_out


def _rest(record: Recording, plane: str, probes: Sequence[Probe]) -> RestPosition:
    shaft = record.shaft
    edges, speeds = _stretches(record, shaft)
    fastest = 0.0 if shaft is None else float(np.abs(shaft.speeds()).max())
    highest = 20.0  # highest frequency that matters of a shaft without marks, Hz
    reduced = ReducedRate.for_band(max(HIGHEST_ORDER * fastest / (2 * np.pi), highest), record.sample_rate, record.size)
    mean, variance = np.empty((2, len(probes), speeds.size))
    parts_of_record = 16  # parts of a recording whose mean voltages tell how well the mean of the whole is known
    for p, probe in enumerate(probes):
        each, scale = record.statistics[probe.channel], float(probe.sensitivity or 1.0)
        volts = reduced.reduce(partial(record.channel, probe.channel)).real
        # a signal that moves by less than a count is not known better than that
        rounding = each.step**2 / 12 if each.deviation < each.step else 0.0
        for s, (begin, end) in enumerate(edges):
            inside = (reduced.time >= begin) & (reduced.time <= end)
            if inside.sum() < 4 * parts_of_record:
                length = f"{significant(end - begin, 3)} s"
                raise ValueError(f"{record.name}: {length} are too short to tell a mean voltage and its error")
            parts = np.array_split(np.flatnonzero(inside), parts_of_record)
            levels = np.array([_level(volts[part], reduced.time[part], shaft) for part in parts])
            # where voltages drift, longer parts scatter more than their length says
            error = max(each.var(ddof=1) / each.size for each in (levels, levels.reshape(-1, 2).mean(axis=1)))
            mean[p, s], variance[p, s] = (levels.mean() - (probe.centre or 0.0)) / scale, (error + rounding) / scale**2
    x, y = record.resolved(plane, mean)
    return RestPosition(
        record=record, plane=plane, speed=speeds, z=x + 1j * y, variance=record.resolved_variance(plane, variance)
    )


def _stretches(record: Recording, shaft: AngleTrack | None) -> tuple[list[tuple[float, float]], Float]:
    """Times from and to, and mean speeds, of what counts as one position each."""
    if shaft is None:
        return [(0.0, record.duration)], np.array([record.stated_speed])
    speeds = shaft.speeds(400)
    count = 1 if np.ptp(speeds) <= STEADY_SPEED_RANGE * np.abs(speeds).mean() else 20
    edges = np.linspace(shaft.begin, shaft.end, count + 1)
    mean = np.diff(shaft.angle(edges)) / np.diff(edges)
    return list(zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True)), np.asarray(mean)


def _level(volts: Float, time: Float, shaft: AngleTrack | None) -> float:
    """Mean voltage without the shaft's orders."""
    basis = [np.ones(volts.size)]
    if shaft is not None:
        angle = shaft.angle(time)
        turns = float(angle[-1] - angle[0]) / (2 * np.pi)
        orders = [n for n in range(1, HIGHEST_ORDER + 1) if n * turns > 1 and volts.size > 4 * HIGHEST_ORDER]
        basis += [wave(n * angle) for n in orders for wave in (np.cos, np.sin)]
    return float(np.linalg.lstsq(np.array(basis).T, volts, rcond=None)[0][0])
