"""Responses of one recording, or of start-ups that belong together: swept, at steady frequencies, by a measured force.

Windows of turns are for dwells, slow sweeps and rotors that are not linear.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.fft import prev_fast_len

from rotorfit.base.array_types import Bool, ComplexArray, Float, Index
from rotorfit.estimators.signals.local_response import SMOOTH_DEGREE, LocalResponse
from rotorfit.estimators.signals.tracking import DwellResponse, dwell_response, dwells, track_windows
from rotorfit.lab.data.experiments import PerturbationTest
from rotorfit.lab.data.findings import Finding
from rotorfit.lab.data.synchronous import DIFFERENCED
from rotorfit.lab.recordings.recording import Recording
from rotorfit.lab.recordings.reduction.measured_responses import measured_responses
from rotorfit.lab.recordings.reduction.reduced_record import ReducedRecord, reduce_record
from rotorfit.lab.recordings.reduction.response_lines import (
    ProbeResponses,
    Report,
    apart_from_orders,
    clear_lines,
    driven,
    estimated,
    readings,
    rows,
    say_lost,
    shaft_speed_at,
    single_direction,
    time_at,
)
from rotorfit.lab.recordings.rig.setup import Force
from rotorfit.lab.recordings.signals import said_of
from rotorfit.lab.recordings.views import OrderVectors


def reduced_responses(
    records: Sequence[Recording], turns: int | None, report: Report, groups: int = 1
) -> PerturbationTest:
    """The responses of a record, or of start-ups with the weight in one plane."""
    record = records[0]
    force = force_of(record)
    if force.measured:
        return measured_responses(records, report)
    if not turns and force.reference == "shaft" and not dwelling(record):
        return _start_ups(records, groups, report)
    drive = record.shaft_angle() if force.reference == "shaft" else record.perturbator_angle()
    if drive is None:
        raise ValueError(f"{record.name} has no phase reference of the perturbator; name its channel in [perturbator]")
    reduced = reduce_record(record, drive, force.whirl)
    if turns:
        return window_responses(reduced, force, turns)
    parts = dwells_of(reduced)
    if force.reference == "perturbator" and not parts:
        return _sweep(reduced, force, report)
    test, clear = dwell_responses(reduced, parts, force)  # of a balance run residual unbalance is in the 1x vectors
    if force.reference == "perturbator":
        if not clear.any():
            raise ValueError(
                f"{record.name}: the perturbation dwells closer to an order of the shaft than the recording can "
                "separate"
            )
        say_lost(record, int(np.sum(~clear)), clear.size, float(np.ptp(parts[0].time)), report)
    return test


def force_of(record: Recording) -> Force:
    """Force that drives the rotor of a recording."""
    if record.force is None:
        raise ValueError(
            f"{record.name}: nothing says what drives the rotor; give plane, mr_kg_m and whirl in [force] of the setup"
        )
    return record.force


def _sweep(reduced: ReducedRecord, force: Force, report: Report) -> PerturbationTest:
    """One record of a perturbator that sweeps."""
    record = reduced.record
    weight = np.array([force.mr * np.exp(1j * force.angle)])
    calm = reduced.without_orders()
    found = estimated([record], [calm.spectra(weight, reduced.orders())], *reduced.band)
    w = found.frequency
    turned = 0.0 if reduced.drive is None else reduced.drive.stderr(time_at(reduced, w))
    if image_seen(reduced, found):
        words = (
            f"{record.name}: the shaft answers at twice its speed less the perturbation (2x - w) too, as one does "
            "whose stiffness turns with it. Responses hold the motion at w alone: rf.shaft_lines reads all lines "
            "of the recording, for AnisotropicShaft or Turning."
        )
        report(Finding("warning", "shaft-lines", words))
    return rows(
        record,
        readings(record, force.whirl, found, np.abs(found.response[0]) * turned),
        clear_lines(reduced, found, 4, report),
        frequency=force.whirl * w,
        speed=shaft_speed_at(calm, w, found.width / (SMOOTH_DEGREE + 1)),
        force_plane=force.plane,
        force=force.mr * w**2 * np.exp(1j * force.angle),
    )


def _start_ups(records: Sequence[Recording], groups: int, report: Report) -> PerturbationTest:
    """Start-ups with the weight in one plane: the response to it, apart from what all of them share.

    Runs without a weight may serve several planes, whose responses then share the error of these runs. Each gets its
    variance as many times as there are planes, so that together they know no more than those runs do.
    """
    forces = [force_of(record) for record in records]
    reduced = [reduce_record(record, record.shaft_angle(), 1) for record in records]
    weights = np.array([force.mr * np.exp(1j * force.angle) for force in forces])
    differenced = np.ptp(weights.real) + np.ptp(weights.imag) > 1e-6 * np.abs(weights).max()
    if not differenced:
        words = (
            f"{', '.join(r.name for r in records)}: no second run with the weight "
            "elsewhere or taken off, so residual unbalance, bow and run-out are in the response."
        )
        report(Finding("warning", "not-differenced", words))
    drives = [np.array([weight, 1.0]) if differenced else np.array([weight]) for weight in weights]
    spectra = [r.spectra(drive, r.orders(2)) for r, drive in zip(reduced, drives, strict=True)]
    low = max(r.band[0] for r in reduced)
    high = min(r.band[1] for r in reduced)
    found = estimated(records, spectra, low, high)
    w = found.frequency
    heaviest = int(np.argmax(np.abs(weights)))
    reference = weights[heaviest]
    # how much each record counts: what several groups share, as many times
    inputs = np.array(drives)
    counted = np.abs(np.linalg.pinv(inputs)[0]) ** 2
    shared = np.where(weights == 0, groups, 1.0) * counted
    found = replace(found, sigma=found.sigma * np.sqrt(shared.sum() / counted.sum()))
    # a shaft angle that is off turns all of a record's motion, that of the residual unbalance too
    moved = np.abs(np.einsum("rj,jpl->rpl", inputs, found.response)) ** 2
    turned = np.array([record.shaft_angle().stderr(time_at(r, w)) for record, r in zip(records, reduced, strict=True)])
    error = np.sqrt(np.einsum("r,rl,rpl->pl", shared, turned**2, moved))
    test = rows(
        records[0],
        readings(records[0], 1, found, error),
        driven(found, 4),
        frequency=w,
        speed=w,
        force_plane=forces[heaviest].plane,
        force=reference * w**2,
    )
    run = np.full(len(test), " minus ".join(record.name for record in records))
    return replace(test, run=run, attributes={**test.attributes, DIFFERENCED: np.full(len(test), float(differenced))})


def image_seen(reduced: ReducedRecord, found: LocalResponse) -> bool:
    """True if what responses to a forward sweep leave over follows ``conj(f) exp(2j theta)`` where two probes are.

    The image of a backward one is above its band, where nothing was looked at.
    """
    if reduced.shaft_angle is None or reduced.whirl < 0:
        return False
    image = reduced.unit_force.conj() * np.exp(2j * reduced.shaft_angle)
    drives = [reduced.spectrum(signal) for signal in (image, image.conj())]  # of z and of its conjugate
    row = 0
    for plane in reduced.record.planes:
        pair = plane in reduced.record.pairs
        image_share = 0.4  # of what the responses leave over, from which it stands out of the noise
        if pair and _share(found, row, drives) > image_share:
            return True
        row += 4 if pair else 1
    return False


def _share(found: LocalResponse, row: int, drives: Sequence[ComplexArray]) -> float:
    """Share of the power left over that drives explain, those of two rows from one on."""
    explained = left = 0.0
    lines = 12  # of a band in which the response to the image's drive is one number: noise explains 1/12 so
    for rest, drive in zip(found.residual[0][row : row + 2], drives, strict=True):
        inside = np.flatnonzero(np.isfinite(rest))
        count = inside.size // lines * lines
        if not count:
            continue
        r, d = (values[inside[:count]].reshape(-1, lines) for values in (rest, drive))
        power = np.sum(np.abs(d) ** 2, axis=1)
        drive_power_share = 0.1  # power of the drive over that of its median band from which it counts
        counts = power > drive_power_share * np.median(power[power > 1e-3 * power.max()])
        explained += float(np.sum((np.abs(np.sum(d.conj() * r, axis=1)) ** 2 / np.maximum(power, 1e-300))[counts]))
        left += float(np.sum(np.abs(r[counts]) ** 2))
    return explained / left if left else 0.0


def swept_vectors(record: Recording) -> OrderVectors | None:
    """Vectors of a perturbator's known weight, relative to its mark, orders of the shaft left out; None of others."""
    force = record.force
    if force is None or force.measured or force.reference != "perturbator":
        return None
    try:
        test = reduced_responses([record], None, lambda finding: None)
    except ValueError:  # windows show what there is, and the figure says that it is by windows
        return None
    frequency = np.unique(np.abs(test.frequency))
    channels = list(dict.fromkeys(zip(test.plane.tolist(), test.direction.tolist(), strict=True)))
    phasors = np.full((len(channels), frequency.size), np.nan + 0j)
    for number, (plane, direction) in enumerate(channels):
        rows = (test.plane == plane) & (test.direction == direction)
        phasors[number, np.searchsorted(frequency, np.abs(test.frequency[rows]))] = test.response[rows]
    steps, gap = np.diff(frequency), 2.5  # usual steps from which a curve is interrupted: a line is left out, or more
    gaps = np.flatnonzero(steps > gap * np.median(steps)) if steps.size else np.zeros(0, dtype=np.intp)
    speed = np.insert(frequency, gaps + 1, (frequency[gaps] + frequency[gaps + 1]) / 2)
    return OrderVectors(
        reference="perturbator",
        t=np.full(speed.size, np.nan),
        speed=speed,
        phasors=np.insert(phasors, gaps + 1, np.nan, axis=1),
        probes=tuple((plane, {"y": np.pi / 2}.get(direction, 0.0)) for plane, direction in channels),
    )


def dwelling(record: Recording) -> bool:
    """True if the shaft of a recording dwells at one speed, or at several in turn."""
    shaft = record.shaft_angle()
    turns = abs(float(np.ptp(shaft.angle(np.array([shaft.begin, shaft.end]))))) / (2 * np.pi)
    time = np.linspace(shaft.begin, shaft.end, max(int(8 * turns), 200))  # some times a turn
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
    if part.drive is None or not part.drive.count:
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
