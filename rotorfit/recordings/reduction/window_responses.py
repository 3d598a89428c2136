"""Responses of one recording by windows of whole turns, for dwells, slow sweeps and rotors that are not linear."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from rotorfit.estimators.signals.tracking import track_windows
from rotorfit.models.array_types import Float, Index
from rotorfit.recordings.reduction.reduced_record import is_pair
from rotorfit.recordings.reduction.response_rows import ProbeResponses, rows, single_direction

if TYPE_CHECKING:
    from rotorfit.data.experiments import PerturbationTest
    from rotorfit.recordings.reduction.reduced_record import ReducedRecord
    from rotorfit.recordings.rig.setup import Force


def window_responses(reduced: ReducedRecord, force: Force, turns: int) -> PerturbationTest:
    """A reading of each probe for each window that no order of the shaft disturbs."""
    record, synchronous = reduced.record, force.reference == "shaft"
    signals = np.array([reduced.motion[plane] for plane in record.planes])
    angle = reduced.whirl * reduced.drive_angle
    try:
        found = track_windows(signals, angle, None if synchronous else reduced.shaft_angle, turns=turns)
    except ValueError as problem:
        raise ValueError(f"{record.name}: {problem}") from problem
    w = reduced.drive_speed[found.centre]
    newton = w**2  # of one kg m: what turns with the mark, be there a weight or none
    # phasors relative to exp(+j|w|t): what turns backward is conjugated
    along = found.along if reduced.whirl > 0 else found.along.conj()
    against = found.against.conj() if reduced.whirl > 0 else found.against
    probes = []
    for p, plane in enumerate(record.planes):
        if not is_pair(record, plane):
            axis, factor = single_direction(record, plane, reduced.whirl)
            single, sigma = factor * (along[p] + against[p]) / newton, 2 * found.sigma[p] / np.abs(newton)
            probes.append(ProbeResponses(plane=plane, direction=axis, response=single, sigma=sigma))
            continue
        sigma = np.sqrt(2) * found.sigma[p] / np.abs(newton)
        for axis, phasor in (
            ("x", along[p] + against[p]),
            ("y", -1j * reduced.whirl * (along[p] - against[p])),
        ):
            probes.append(ProbeResponses(plane=plane, direction=axis, response=phasor / newton, sigma=sigma))
    return rows(
        probes,
        found.clear,
        run=record.name,
        frequency=force.whirl * w,
        speed=w if synchronous else _shaft_speeds(reduced, found.centre),
        force_plane=force.plane,
        force=force.mr * w**2 * np.exp(1j * force.angle),
        attributes=record.attributes,
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
