"""Responses of one recording, or of start-ups that belong together: swept, dwelling, driven by a measured force."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from rotorfit.data.experiments import PerturbationTest
from rotorfit.data.findings import Finding
from rotorfit.data.synchronous import DIFFERENCED
from rotorfit.estimators.signals.local_response import SMOOTH_DEGREE, LocalResponse
from rotorfit.models.array_types import ComplexArray
from rotorfit.recordings.recording import Recording
from rotorfit.recordings.reduction.measured_responses import measured_responses
from rotorfit.recordings.reduction.reduced_record import ReducedRecord, reduce_record
from rotorfit.recordings.reduction.response_lines import (
    Report,
    clear_lines,
    driven,
    estimated,
    readings,
    rows,
    say_lost,
    shaft_speed_at,
    time_at,
)
from rotorfit.recordings.reduction.steady_responses import dwell_responses, dwelling, dwells_of, window_responses
from rotorfit.recordings.rig.setup import Force
from rotorfit.recordings.views import OrderVectors


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
        # Share of what the responses leave over that is the image, from which it stands out of the noise
        image_share = 0.4
        if pair and _share(found, row, drives) > image_share:
            return True
        row += 4 if pair else 1
    return False


def _share(found: LocalResponse, row: int, drives: Sequence[ComplexArray]) -> float:
    """Share of the power left over that drives explain, those of two rows from one on."""
    explained = left = 0.0
    # Spectral lines of a band in which the response to the image's drive is one number: noise explains 1/12 so.
    lines = 12
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
    steps = np.diff(frequency)
    # Steps between lines, over the usual step, from which a curve is interrupted: one line is left out, or more
    gap = 2.5
    gaps = np.flatnonzero(steps > gap * np.median(steps)) if steps.size else np.zeros(0, dtype=np.intp)
    speed = np.insert(frequency, gaps + 1, (frequency[gaps] + frequency[gaps + 1]) / 2)
    return OrderVectors(
        reference="perturbator",
        t=np.full(speed.size, np.nan),
        speed=speed,
        phasors=np.insert(phasors, gaps + 1, np.nan, axis=1),
        probes=tuple((plane, {"y": np.pi / 2}.get(direction, 0.0)) for plane, direction in channels),
        forward={},
        backward={},
    )
