"""Free vibration after blows, cut out of recordings with the shaft's own orders taken out."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import Executor
from typing import Any, TypeAlias

import numpy as np

from rotorfit.data.experiments import RingDownTest
from rotorfit.executors import carry_out, executor_of
from rotorfit.models.array_types import ComplexArray, Float
from rotorfit.models.parameters import unknown_name
from rotorfit.recordings.recording import Recording, named_apart
from rotorfit.recordings.reduction.blows import AVERAGING_TIME, quiet_part
from rotorfit.recordings.reduction.reduced_record import ReducedRate, motion_at
from rotorfit.recordings.reduction.static_positions import rest_positions
from rotorfit.recordings.signals import source_of

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
    client: Any = None,
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
        executor, client: read recordings beside each other, see :func:`rotorfit.responses`.

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
    columns: dict[str, list[Float]] = {name: [] for name in ("speed", "time", "x", "y")}
    runs: list[str] = []
    jobs = []
    for record in listed:
        said = record.rig.impulse.highest if record.rig.impulse is not None else None
        highest = highest_hz if highest_hz is not None else HIGHEST_HZ if said is None else said / (2 * np.pi)
        jobs.append((record, _plane(record, plane), highest))
    for (record, _, _), (mean, blows) in zip(
        jobs, carry_out(_reduced, jobs, executor_of(executor, client)), strict=True
    ):
        for number, (speed, time, z, settled) in enumerate(blows, start=1):
            runs += [f"{record.name}, blow {number}"] * time.size
            at = z + (position if position is not None else 0.0 if mean is None else mean + settled)
            for name, values in zip(columns, (np.full(time.size, speed), time, at.real, at.imag), strict=True):
                columns[name].append(values)
    speed_of, instant, x, y = (np.concatenate(parts) for parts in columns.values())
    return RingDownTest(
        run=np.array(runs),
        speed=speed_of,
        time=instant,
        x=x,
        y=y,
        eccentricity=np.full(len(runs), np.nan),
        source=source_of(listed),
    )


def _reduced(job: tuple[Recording, str, float]) -> tuple[complex | None, list[_Blow]]:
    """Mean position where it is known, and the motion after each blow, of a recording, plane and highest frequency."""
    record, plane, highest_hz = job
    mean = None
    if all(probe.centre is not None for probe in record.probes if probe.plane == plane):  # voltages of the centre
        mean = next((complex(rest.z.mean()) for rest in rest_positions(record)[0] if rest.plane == plane), None)
    return mean, list(_blows(record, plane, highest_hz))


def _plane(record: Recording, asked: str | None) -> str:
    said = record.rig.impulse.plane if record.rig.impulse is not None else None
    asked = asked or said
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
