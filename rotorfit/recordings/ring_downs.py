"""Free vibration after blows, cut out of recordings with the shaft's own orders taken out."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from rotorfit.data.experiments import RingDownTest
from rotorfit.models.array_types import ComplexArray, Float
from rotorfit.models.parameters import unknown_name
from rotorfit.recordings.reduced_rate import ReducedRate
from rotorfit.recordings.reduced_record import ORDERS, is_pair, motion_at

if TYPE_CHECKING:
    from rotorfit.recordings.recording import Recording

QUIET = 0.02
"""Time over which the motion is averaged to see a blow, s."""
STANDS_OUT = 6.0
"""A blow begins where that average exceeds so many times its median."""
CONTACT = 0.01
"""Time left out after the beginning of a blow, s: hammer or release still act."""


def ring_downs(
    records: Sequence[Recording] | Recording,
    *,
    plane: str | None = None,
    highest_hz: float = 200.0,
    position: complex = 0.0,
) -> RingDownTest:
    """Records of free vibration after each blow or release, for fits and :func:`rotorfit.ring_down_modes`.

    The shaft's orders are found where it is quiet and taken out everywhere. A record lasts until the next blow or until
    what is left is in the noise.

    Args:
        records: recordings in which the rotor is struck or released, any number of times.
        plane: of the probes, by default the only one, or the journal.
        highest_hz: frequency above which nothing is of interest.
        position: where the journal rests, ``x + jy`` from the bearing's centre, m; the recording alone does not tell.

    Raises:
        ValueError: no blow stands out, no such plane, or a plane with one probe.
    """
    listed = list(records) if isinstance(records, Sequence) else [records]
    columns: dict[str, list[Float]] = {name: [] for name in ("speed", "time", "x", "y")}
    runs: list[str] = []
    for record in listed:
        where = _plane(record, plane)
        for number, (speed, time, z) in enumerate(_blows(record, where, highest_hz), start=1):
            runs += [f"{record.name}, blow {number}"] * time.size
            for name, values in zip(columns, (np.full(time.size, speed), time, z.real, z.imag), strict=True):
                columns[name].append(values)
    speed_of, instant, x, y = (np.concatenate(parts) for parts in columns.values())
    return RingDownTest(
        run=np.array(runs),
        speed=speed_of,
        time=instant,
        x=x + position.real,
        y=y + position.imag,
        eccentricity=np.full(len(runs), np.nan),
        source=", ".join(record.name for record in listed),
    )


def _plane(record: Recording, asked: str | None) -> str:
    found = asked or ("journal" if "journal" in record.planes else record.planes[0])
    if found not in record.planes:
        raise ValueError(f"{record.name}: {unknown_name('plane', found, record.planes)}")
    if asked is None and len(record.planes) > 1 and found != "journal":
        raise ValueError(f"{record.name}: say which plane: {', '.join(record.planes)}")
    if not is_pair(record, found):
        raise ValueError(f"{record.name}: {found} has one probe; free vibration needs x and y")
    return found


def _blows(record: Recording, plane: str, highest_hz: float) -> Iterator[tuple[float, Float, ComplexArray]]:
    """Speed, times from the beginning of each blow and motion without the shaft's orders."""
    shaft = record.shaft_angle()
    reduced = ReducedRate.for_band(highest_hz, record.sample_rate, record.size)
    inside = np.flatnonzero((reduced.time >= shaft.begin) & (reduced.time <= shaft.end))
    part = slice(int(inside[0]), int(inside[-1]) + 1)
    time, rate = reduced.time[part], reduced.rate
    angle = shaft.angle(time)
    z = motion_at(record, reduced, part, plane)
    orders = np.exp(1j * np.arange(-ORDERS, ORDERS + 1)[:, None] * angle).T
    quiet = np.ones(time.size, dtype=bool)
    for _ in range(3):  # blows disturb the orders, and orders hide blows
        left = z - orders @ np.linalg.lstsq(orders[quiet], z[quiet], rcond=None)[0]
        width = max(int(QUIET * rate), 1)
        size = np.sqrt(np.convolve(np.abs(left) ** 2, np.ones(width) / width, mode="same"))
        noise = float(np.median(size[quiet]))
        quiet = size < 3 * noise
    loud = size > STANDS_OUT * noise
    begins = np.flatnonzero(loud[1:] & ~loud[:-1]) + 1
    begins = begins[np.concatenate([[True], np.diff(begins) > 5 * width])] if begins.size else begins
    if not begins.size:
        raise ValueError(f"{record.name}: no blow stands out of the motion of {plane}")
    speed = float(np.mean(shaft.speed(time)))
    for begin, following in zip(begins, [*begins[1:], time.size], strict=True):
        first = begin + int(CONTACT * rate) + width // 2
        calm = np.flatnonzero(size[first:following] < 1.5 * noise)
        last = min(first + (int(calm[0]) if calm.size else following - first), following - width)
        if last - first > 16:
            yield speed, time[first:last] - time[first], left[first:last]
