"""Responses where the frequency is steady: of recordings that dwell at one after the other, and by windows of turns.

Windows are for dwells, slow sweeps and rotors that are not linear.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.fft import prev_fast_len

from rotorfit.data.experiments import PerturbationTest
from rotorfit.estimators.signals.local_response import LocalResponse
from rotorfit.estimators.signals.tracking import DwellResponse, dwell_response, dwells, track_windows
from rotorfit.models.array_types import Bool, Float, Index
from rotorfit.recordings.recording import Recording
from rotorfit.recordings.reduction.reduced_record import ReducedRecord
from rotorfit.recordings.reduction.response_lines import (
    ProbeResponses,
    apart_from_orders,
    readings,
    rows,
    single_direction,
)
from rotorfit.recordings.rig.setup import Force
from rotorfit.recordings.signals import said_of


def dwelling(record: Recording) -> bool:
    """True if the shaft of a recording dwells at one speed, or at several in turn."""
    shaft = record.shaft_angle()
    turns = abs(float(np.ptp(shaft.angle(np.array([shaft.begin, shaft.end]))))) / (2 * np.pi)
    # Times a turn at which a shaft is looked at to see whether it dwells.
    time = np.linspace(shaft.begin, shaft.end, max(int(8 * turns), 200))
    return bool(dwells(time, shaft.angle(time), shaft.speed(time)))


def dwells_of(reduced: ReducedRecord) -> list[ReducedRecord]:
    """The parts of a record in which its drive dwells; none where it sweeps."""
    found = []
    for part in dwells(reduced.time, reduced.drive_angle, reduced.drive_speed):
        whole = slice(part.start, part.start + int(prev_fast_len(part.stop - part.start)))
        speed = reduced.drive_speed[whole]
        found.append(
            replace(
                reduced,
                band=(float(speed.min()), float(speed.max())),
                unit_force=reduced.unit_force[whole],
                time=reduced.time[whole],
                motion={plane: z[whole] for plane, z in reduced.motion.items()},
                drive_angle=reduced.drive_angle[whole],
                drive_speed=speed,
                shaft_angle=None if reduced.shaft_angle is None else reduced.shaft_angle[whole],
            )
        )
    return found


def dwell_responses(
    reduced: ReducedRecord, parts: Sequence[ReducedRecord], force: Force
) -> tuple[PerturbationTest, Bool]:
    """A line for each dwell that no order of the shaft lies on, and which dwells these are."""
    record, synchronous = reduced.record, force.reference == "shaft"
    weight = np.ones(1, dtype=complex)  # of one kg m: what turns with the mark, be there a weight or none
    found: list[DwellResponse] = []
    for part in parts:
        wider = replace(part, band=(part.band[0], part.band[1] + 20 * 2 * np.pi / float(np.ptp(part.time))))
        with said_of(record.name):
            found.append(dwell_response(wider.spectra(weight, wider.orders(2 if synchronous else 1)), _speed(part)))
    speeds = np.array([_speed(part) for part in parts])
    order = np.argsort(speeds, kind="stable")
    response, sigma, noise = (np.array([each[k] for each in found]).T[:, order] for k in range(3))
    w = speeds[order]
    clear = np.array([synchronous or apart_from_orders(p, np.array([_speed(p)]))[0] for p in parts], dtype=bool)[order]
    error = np.array([_angle_error(part) for part in parts])[order]
    local = LocalResponse(
        frequency=w, response=response[None], sigma=sigma[None], noise=noise, width=np.zeros(w.size), residual=()
    )
    test = rows(
        record,
        readings(record, reduced.whirl, local, np.abs(response) * error),
        clear,
        frequency=force.whirl * w,
        speed=w if synchronous else np.array([part.shaft_speed for part in parts])[order],
        force_plane=force.plane,
        force=force.mr * w**2 * np.exp(1j * force.angle),
        unit=w**2,
    )
    return test, clear


def _speed(part: ReducedRecord) -> float:
    """Mean speed of the drive."""
    return float((part.drive_angle[-1] - part.drive_angle[0]) / (part.time[-1] - part.time[0]))


def _angle_error(part: ReducedRecord) -> float:
    """Standard error of the drive's angle, averaged over a dwell, rad; none without a mark, whose datum is free."""
    if part.drive is None or part.drive.levels is None:
        return 0.0
    pulses = int(np.sum((part.drive.pulses >= part.time[0]) & (part.drive.pulses <= part.time[-1])))
    independent = max(pulses * part.drive.share, 1.0)  # values that the smooth angle has in the dwell
    return float(np.sqrt(np.mean(part.drive.stderr(part.time) ** 2) / independent))


def window_responses(reduced: ReducedRecord, force: Force, turns: int) -> PerturbationTest:
    """A reading of each probe for each window that no order of the shaft disturbs."""
    record, synchronous = reduced.record, force.reference == "shaft"
    signals = np.array([reduced.motion[plane] for plane in record.planes])
    angle = reduced.whirl * reduced.drive_angle
    with said_of(record.name):
        found = track_windows(signals, angle, None if synchronous else reduced.shaft_angle, turns=turns)
    w = reduced.drive_speed[found.centre]
    newton = w**2  # of one kg m: what turns with the mark, be there a weight or none
    # phasors relative to exp(+j|w|t): what turns backward is conjugated
    along = found.along if reduced.whirl > 0 else found.along.conj()
    against = found.against.conj() if reduced.whirl > 0 else found.against
    probes: list[ProbeResponses] = []
    for p, plane in enumerate(record.planes):
        if plane not in record.pairs:
            axis, factor = single_direction(record, plane, reduced.whirl)
            single, sigma = factor * (along[p] + against[p]) / newton, 2 * found.sigma[p] / np.abs(newton)
            probes.append((plane, axis, single, sigma))
            continue
        sigma = np.sqrt(2) * found.sigma[p] / np.abs(newton)
        for axis, phasor in (("x", along[p] + against[p]), ("y", -1j * reduced.whirl * (along[p] - against[p]))):
            probes.append((plane, axis, phasor / newton, sigma))
    return rows(
        record,
        probes,
        found.clear,
        frequency=force.whirl * w,
        speed=w if synchronous else _shaft_speeds(reduced, found.centre),
        force_plane=force.plane,
        force=force.mr * w**2 * np.exp(1j * force.angle),
        unit=newton,
    )


def _shaft_speeds(reduced: ReducedRecord, centre: Index) -> Float:
    """Mean rotative speed of each window, rad/s, from half-way to that before to half-way to that after."""
    if reduced.shaft_angle is None or centre.size < 2:
        return np.full(centre.size, reduced.shaft_speed)
    half = np.gradient(centre) / 2
    ends = [np.clip((centre + side * half).astype(np.intp), 0, reduced.time.size - 1) for side in (-1, 1)]
    (begin, end), (start, stop) = ([values[at] for at in ends] for values in (reduced.shaft_angle, reduced.time))
    return np.asarray((end - begin) / (stop - start))
