"""Lines at which a recording gives responses: estimated, driven enough, and apart from the orders of the shaft."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from rotorfit.data.findings import Finding
from rotorfit.estimators.signals.local_response import LocalResponse, RecordSpectra, local_response
from rotorfit.models.array_types import Bool, Float
from rotorfit.models.digits import significant

if TYPE_CHECKING:
    from rotorfit.recordings.recording import Recording
    from rotorfit.recordings.reduction.reduced_record import ReducedRecord

Report = Callable[[Finding], None]

DRIVEN_INFORMATION_SHARE = 3e-3
"""Information of a line over that of the median line below which it is left out: 18 times the median error."""


def estimated(
    records: Sequence[Recording], spectra: Sequence[RecordSpectra], low: float, high: float, *, transient: bool = True
) -> LocalResponse:
    """Local responses; what is wrong is said with the names of the recordings."""
    try:
        return local_response(spectra, low, high, transient=transient)
    except ValueError as problem:
        raise ValueError(f"{', '.join(record.name for record in records)}: {problem}") from problem


def clear_lines(reduced: ReducedRecord, found: LocalResponse, power: int, report: Report) -> Bool:
    """Lines where the force says enough and that no order of the shaft is too near to."""
    enough = driven(found, power)
    apart = apart_from_orders(reduced, found.frequency)
    say_lost(
        reduced.record, int(np.sum(enough & ~apart)), int(enough.sum()), reduced.time[-1] - reduced.time[0], report
    )
    return enough & apart


def say_lost(record: Recording, lost: int, count: int, seconds: float, report: Report) -> None:
    """Say how many lines an order of the shaft takes."""
    if lost:
        report(
            Finding(
                "note",
                "lines-at-orders",
                f"{record.name}: {lost} of {count} lines left out: closer to "
                f"an order of the shaft than {significant(seconds, 3)} s can separate.",
            )
        )


def driven(found: LocalResponse, power: int) -> Bool:
    """True if the force says enough at each node, its growth with a power of the frequency aside.

    Where a sweep begins and ends its spectrum falls off and cannot be distinguished from the transient. Chosen by the
    force, not by what was measured, so that nothing is selected.
    """
    information = (found.noise[0] / found.sigma[0, 0]) ** 2 / found.width / found.frequency**power
    return np.asarray(information > DRIVEN_INFORMATION_SHARE * np.median(information))


def time_at(reduced: ReducedRecord, frequency: Float) -> Float:
    """When the drive last passed each frequency, s; of the nearest one where it never did."""
    speed = reduced.drive_speed
    ascending = np.maximum.accumulate(speed) if speed[-1] >= speed[0] else np.minimum.accumulate(speed)[::-1]
    time = reduced.time if speed[-1] >= speed[0] else reduced.time[::-1]
    return time[np.clip(np.searchsorted(ascending, frequency), 0, time.size - 1)]


def shaft_speed_at(reduced: ReducedRecord, frequency: Float, width: Float) -> Float:
    """Rotative speed that the responses at some frequencies have, from a band of a width about each, rad/s; the record
    is one without the shaft's orders.

    A speed that is off its mean by v(t) presses on the motion z by what the fluid does to ``v(t) z(t)``: to first order
    the response is that at the mean speed and V/Z, the ratio of the spectra. Of a sweep that is the speed when it
    passed, a little later as the motion lags.
    """
    if reduced.shaft_angle is None:
        return np.zeros(frequency.size)
    away = np.gradient(reduced.shaft_angle) * reduced.rate - reduced.shaft_speed
    cross, power = np.zeros((2, reduced.lines.size))
    for z in reduced.motion.values():
        for signal in (z, z.conj()):
            spectrum = reduced.spectrum(signal)
            cross += (reduced.spectrum(away * signal) * spectrum.conj()).real
            power += np.abs(spectrum) ** 2
    low, high = (np.searchsorted(reduced.lines, frequency + side * width / 2) for side in (-1, 1))
    shift, size = (
        total[np.minimum(high, power.size - 1)] - total[np.maximum(low - 1, 0)]
        for total in map(np.cumsum, (cross, power))
    )
    return np.asarray(reduced.shaft_speed + np.divide(shift, size, out=np.zeros_like(shift), where=size > 0))


def apart_from_orders(reduced: ReducedRecord, w: Float) -> Bool:
    """True if lines are further from every order than the record can separate, its own wander of speed added."""
    if reduced.shaft_angle is None:
        return np.ones(w.size, dtype=bool)
    wander = float(np.std(np.diff(reduced.shaft_angle)) * reduced.rate)
    order = np.maximum(np.rint(w / reduced.shaft_speed), 1)
    resolution = 2 * np.pi / (reduced.time[-1] - reduced.time[0])
    return np.asarray(np.abs(w - order * reduced.shaft_speed) > resolution + order * wander)
