"""From recordings to the experiment that a fit takes: responses with their noise, at lines chosen for the fit.

Sweeps of a perturbator are reduced one by one. Start-ups and shutdowns with the weight in one plane are reduced
together: what the weight does is found apart from residual unbalance, bow and run-out, which all of them share. The
method is in :mod:`rotorfit.estimators.local_response`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rotorfit.data.experiments import PerturbationTest
from rotorfit.data.findings import Finding
from rotorfit.data.synchronous import DIFFERENCED, group_speeds, join
from rotorfit.estimators.local_response import LocalResponse, local_response
from rotorfit.models.array_types import Float
from rotorfit.recordings.quality import spoiled
from rotorfit.recordings.reduced_record import ReducedRecord, reduce_measured, reduce_record
from rotorfit.recordings.response_rows import readings, rows, time_at
from rotorfit.recordings.window_responses import window_responses

if TYPE_CHECKING:
    from rotorfit.recordings.angle_track import AngleTrack
    from rotorfit.recordings.recording import Recording
    from rotorfit.recordings.setup import Force

_KINDS = {"perturbator": "a perturbator", "shaft": "the shaft itself", "": "a measured force"}
Report = Callable[[Finding], None]

DRIVEN = 3e-3
"""Information of a line over that of the median line below which it is left out: 18 times the median error."""


def responses(
    records: Sequence[Recording] | Recording,
    *,
    turns: int | None = None,
    on_finding: Report | None = None,
    progress: Callable[[str], None] | None = None,
) -> PerturbationTest:
    """Responses of a rotor to the force that turns with a perturbator or with the shaft itself.

    Args:
        records: of one rig; see :func:`rotorfit.read_recording`.
        turns: track by windows of so many whole turns of the drive instead; for dwells, slow sweeps and rotors that are
            not linear. A sweep makes such vectors lag behind.
        on_finding: called with each thing that was found odd or that limits what the recordings say, for instance
            ``print``; what was found while reading is in ``record.findings``.
        progress: called with a few words before each stage.

    Returns:
        a row for each probe at each line; a synchronous test where the shaft itself drives. Lines that a record cannot
        tell from an order of the shaft are left out.

    Raises:
        ValueError: a recording whose force is not known, or that is too short for what was swept.
    """
    listed = list(records) if isinstance(records, Sequence) else [records]
    if not listed:
        raise ValueError("no recordings given")
    report = on_finding or (lambda finding: None)
    tell = progress or (lambda stage: None)
    setup = listed[0].setup.source if listed[0].setup is not None else ""
    source = ", ".join(record.path.name for record in listed) + (f" with {setup}" if setup else "")
    return replace(_reduced([_usable(record, report) for record in listed], turns, report, tell), source=source)


def _reduced(
    listed: list[Recording], turns: int | None, report: Report, tell: Callable[[str], None]
) -> PerturbationTest:
    """The responses of all recordings, by what drives them."""
    forces = [_force(record) for record in listed]
    _same_kind(listed, forces)
    if not all(force.datum_known for force in forces):
        report(
            Finding(
                "note", "phase-datum", "the angle between weight and mark is not known; fit with "
                'phase_offsets="common" (--phase-offsets common), one angle for all runs.',
            )
        )  # fmt: skip
    if forces[0].measured:
        if turns:
            raise ValueError("windows of whole turns need a force that turns with a mark; this one was measured")
        test = join([_measured(record, report, tell) for record in listed])
        return replace(test, speed=group_speeds(test.speed, test.frequency, test.run))
    if forces[0].reference == "perturbator":
        reduce = partial(_windows, turns=turns) if turns else _sweep
        test = join([reduce(record, report, tell) for record in listed])
        return replace(test, speed=group_speeds(test.speed, test.frequency, test.run))
    if turns:
        return join([_windows(record, report, tell, turns=turns) for record in listed])
    planes = dict.fromkeys(force.plane for force in forces)
    groups = [[r for r, f in zip(listed, forces, strict=True) if f.plane == plane] for plane in planes]
    return join([_start_ups(group, report, tell) for group in groups])


def _usable(record: Recording, report: Report) -> Recording:
    """The recording without probes that are dead or clipped."""
    lost = spoiled(record.statistics)
    if not lost:
        return record
    kept = tuple(probe for probe in record.probes if probe.channel not in lost)
    if not kept:
        raise ValueError(f"{record.name}: all probes are dead or clipped: {', '.join(lost)}")
    report(Finding("warning", "probe-left-out", f"{record.name}: {', '.join(lost)} left out: dead or clipped."))
    return replace(record, rig=replace(record.rig, probes=kept))


def _force(record: Recording) -> Force:
    if record.force is None:
        raise ValueError(
            f"{record.name}: nothing says what drives the rotor; give plane, mr_kg_m and whirl in [force] of the setup"
        )
    return record.force


def _same_kind(records: Sequence[Recording], forces: Sequence[Force]) -> None:
    kinds = {_KINDS[force.reference]: record.name for record, force in zip(records, forces, strict=True)}
    if len(kinds) > 1:
        (one, first), (other, second), *_ = kinds.items()
        raise ValueError(
            f"{first} is driven by {one}, {second} by {other}: two kinds of tests, call responses for each and give a "
            "list of both to fit"
        )


def _sweep(record: Recording, report: Report, tell: Callable[[str], None]) -> PerturbationTest:
    """One record of a perturbator that sweeps."""
    tell(f"responses of {record.name}")
    force, drive = _force(record), _drive(record)
    reduced = reduce_record(record, drive, force.whirl)
    weight = np.array([force.mr * np.exp(1j * force.angle)])
    found = local_response([reduced.without_orders().spectra(weight, reduced.orders())], *reduced.band)
    w = found.frequency
    return rows(
        readings(record, force.whirl, found, np.abs(found.response[0]) * drive.stderr(time_at(reduced, w))),
        _clear(reduced, found, 4, report),
        run=record.name,
        frequency=force.whirl * w,
        speed=reduced.shaft_speed,
        force_plane=force.plane,
        force=force.mr * w**2 * np.exp(1j * force.angle),
        attributes=record.attributes,
    )


def _measured(record: Recording, report: Report, tell: Callable[[str], None]) -> PerturbationTest:
    """One record of a force that was measured: magnetic bearing, load cells, shaker."""
    tell(f"responses of {record.name}")
    force = _force(record)
    reduced, direction = reduce_measured(record)
    found = local_response(
        [reduced.without_orders().spectra(np.ones(1, dtype=complex), reduced.orders())], *reduced.band
    )
    size = float(np.sqrt(np.mean(np.abs(reduced.unit_force) ** 2)))
    return rows(
        readings(record, reduced.whirl, found, np.zeros(found.noise.shape)),
        _clear(reduced, found, 0, report),
        run=record.name,
        frequency=reduced.whirl * found.frequency,
        speed=reduced.shaft_speed or record.speed or 0.0,
        force_plane=force.plane,
        force=np.full(found.frequency.size, size, dtype=complex),
        attributes=record.attributes,
        force_direction=direction,
    )


def _clear(reduced: ReducedRecord, found: LocalResponse, power: int, report: Report) -> NDArray[np.bool_]:
    """Lines where the force says enough and that no order of the shaft is too near to."""
    driven = _driven(found, power)
    apart = _apart_from_orders(reduced, found.frequency)
    lost = int(np.sum(driven & ~apart))
    if lost:
        report(
            Finding(
                "note", "lines-at-orders", f"{reduced.record.name}: {lost} of {driven.sum()} lines left out: closer to "
                f"an order of the shaft than {reduced.time[-1] - reduced.time[0]:.3g} s can separate.",
            )
        )  # fmt: skip
    return driven & apart


def _windows(record: Recording, report: Report, tell: Callable[[str], None], *, turns: int) -> PerturbationTest:
    """One record by windows of whole turns."""
    tell(f"responses of {record.name}")
    force = _force(record)
    return window_responses(reduce_record(record, _drive(record), force.whirl), force, turns)


def _drive(record: Recording) -> AngleTrack:
    """The angle that the force is locked to."""
    if _force(record).reference == "shaft":
        return record.shaft_angle()
    drive = record.perturbator_angle()
    if drive is None:
        raise ValueError(f"{record.name} has no phase reference of the perturbator; name its channel in [perturbator]")
    return drive


def _driven(found: LocalResponse, power: int) -> NDArray[np.bool_]:
    """Whether the force says enough at each node, its growth with a power of the frequency aside.

    Where a sweep begins and ends its spectrum falls off and cannot be told from the transient. Chosen by the force, not
    by what was measured, so that nothing is selected.
    """
    information = (found.noise[0] / found.sigma[0, 0]) ** 2 / found.width / found.frequency**power
    return np.asarray(information > DRIVEN * np.median(information))


def _apart_from_orders(reduced: ReducedRecord, w: Float) -> NDArray[np.bool_]:
    """Whether lines are further from every order than the record can separate, its own wander of speed added."""
    if reduced.shaft_angle is None:
        return np.ones(w.size, dtype=bool)
    wander = float(np.std(np.diff(reduced.shaft_angle)) * reduced.rate)
    order = np.maximum(np.rint(w / reduced.shaft_speed), 1)
    resolution = 2 * np.pi / (reduced.time[-1] - reduced.time[0])
    return np.asarray(np.abs(w - order * reduced.shaft_speed) > resolution + order * wander)


def _start_ups(records: list[Recording], report: Report, tell: Callable[[str], None]) -> PerturbationTest:
    """Start-ups with the weight in one plane: the response to it, apart from what all of them share."""
    tell(f"responses of {', '.join(record.name for record in records)}")
    forces = [_force(record) for record in records]
    reduced = [reduce_record(record, record.shaft_angle(), 1) for record in records]
    weights = np.array([force.mr * np.exp(1j * force.angle) for force in forces])
    differenced = np.ptp(weights.real) + np.ptp(weights.imag) > 1e-6 * np.abs(weights).max()
    if not differenced:
        report(
            Finding(
                "warning", "not-differenced", f"{', '.join(r.name for r in records)}: no second run with the weight "
                "elsewhere or taken off, so residual unbalance, bow and run-out are in the response.",
            )
        )  # fmt: skip
    drives = [np.array([weight, 1.0]) if differenced else np.array([weight]) for weight in weights]
    spectra = [r.spectra(drive, r.orders(2)) for r, drive in zip(reduced, drives, strict=True)]
    low = max(r.band[0] for r in reduced)
    high = min(r.band[1] for r in reduced)
    found = local_response(spectra, low, high)
    w = found.frequency
    reference = weights[np.argmax(np.abs(weights))]
    # a shaft angle that is off turns all of a record's motion, that of the residual unbalance too
    angles = [record.shaft_angle() for record in records]
    errors = [angle.stderr(time_at(r, w)) ** 2 for angle, r in zip(angles, reduced, strict=True)]
    error = np.sqrt(np.sum(errors, axis=0)) / len(records)
    scale = np.array([1.0, 1 / np.abs(reference)])[: found.response.shape[0]]
    moved = np.sqrt(np.sum(np.abs(found.response * scale[:, None, None]) ** 2, axis=0))
    return rows(
        readings(records[0], 1, found, moved * error),
        _driven(found, 4),
        run=" minus ".join(record.name for record in records),
        frequency=w,
        speed=w,
        force_plane=forces[0].plane,
        force=reference * w**2,
        attributes={**records[0].attributes, DIFFERENCED: float(differenced)},
    )
