"""Static loads: positions of the shaft under forces that do not turn."""

from __future__ import annotations

import numpy as np

from rotorfit.data.experiments import StaticTest
from rotorfit.estimators.blocks.nonlinear import OrbitResponses
from rotorfit.estimators.blocks.observations import Block, Responses
from rotorfit.estimators.noise.reading_noise import noise_from_smoothness
from rotorfit.models import RotorModel
from rotorfit.models.array_types import Float, Index
from rotorfit.models.motion.journal import journal
from rotorfit.observing.refusals import check_clearance, check_finite, check_planes
from rotorfit.observing.row_labels import numbered_labels, same_rows, spread_of_repeats


def static_loads(model: RotorModel, test: StaticTest, group: Index) -> Block:
    """Observations of a static test, with their noise."""
    check_finite(test, test.load, test.displacement)
    check_planes(model, test, test.planes, test.force_planes, forces="load planes")
    if model.frame != "z":
        raise ValueError(f"{model.name} keeps x and y apart; static loads need a model in complex coordinates")
    idle = np.flatnonzero(test.load == 0)
    if idle.size:
        raise ValueError(
            f"{test.source or test.title}: the load is zero in {idle.size} rows ({', '.join(map(str, idle[:8] + 1))}); "
            "positions count from that without a load: subtract it from the others and remove its row"
        )
    count = len(test)
    still = np.zeros(count)
    force = np.zeros((count, len(model.coordinates)), dtype=complex)
    for plane in test.force_planes:
        at = test.load_plane == plane
        force[at] = model.force_vector(plane, still[at], test.load[at])
    coordinate = np.array([model.coordinate(plane, "z") for plane in test.plane.tolist()], dtype=np.intp)
    names = [f"{run} / {plane} static" for run, plane in zip(test.run.tolist(), test.plane.tolist(), strict=True)]
    label, labels = numbered_labels(names)
    block = Responses(
        model=model,
        speed=test.speed,
        frequency=still,
        force=force,
        group=group,
        line=np.arange(count),
        coordinate=coordinate,
        measured=test.displacement,
        sigma=_static_noise(test, label),
        label=label,
        labels=labels,
        run=test.run,
    )
    if not model.eccentricity_dependent:
        return block
    eps = _eccentricity(model, test, coordinate)
    sweep = same_rows(test.run, test.speed, test.load_plane, test.plane)
    return OrbitResponses(block, eps, "nearest" if np.isfinite(eps).all() else "followed", sweep)


def _eccentricity(model: RotorModel, test: StaticTest, coordinate: Index) -> Float:
    """Measured eccentricity of the journal in each row, NaN where no probe read it under that load."""
    seat = journal(model)
    eps = np.where(coordinate == seat.at, np.abs(test.displacement) / seat.clearance, np.nan)
    check_clearance(eps, model, "static positions")
    loads = same_rows(test.run, test.speed, test.load_plane, test.load.real, test.load.imag)
    for load in np.unique(loads[np.isnan(eps)]):  # other planes under a load share the journal's position
        here = loads == load
        if np.isfinite(eps[here]).any():
            eps[here] = np.where(np.isnan(eps[here]), np.nanmean(eps[here]), eps[here])
    return np.asarray(eps)


def _static_noise(test: StaticTest, label: Index) -> Float:
    """Noise given, else from repeated loads, else from the smoothness of the locus over the load."""
    sigma = test.sigma.copy()
    same = same_rows(label, test.speed, test.load_plane, test.load.real, test.load.imag)
    for curve in np.unique(same_rows(label, test.speed)[np.isnan(sigma)]):
        rows = np.flatnonzero(same_rows(label, test.speed) == curve)
        spread = spread_of_repeats(test.displacement[rows], same[rows])
        if spread is None:
            order = rows[np.argsort(np.abs(test.load[rows]), kind="stable")]
            try:
                spread = float(noise_from_smoothness(np.abs(test.load[order]), test.displacement[order])[0])
            except ValueError as reason:
                raise ValueError(f"{test.source or 'static test'}, run {test.run[rows[0]]}: {reason}") from reason
        sigma[rows] = np.where(np.isnan(sigma[rows]), spread, sigma[rows])
    return sigma
