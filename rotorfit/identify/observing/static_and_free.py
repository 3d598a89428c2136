"""Tests of a journal without a turning force: static loads, free vibration, tables of its coefficients."""

from __future__ import annotations

import numpy as np

from rotorfit.base.array_types import ComplexArray, Float, Index
from rotorfit.estimators.blocks.nonlinear import OrbitResponses
from rotorfit.estimators.blocks.observations import Block, Responses
from rotorfit.estimators.blocks.row_keys import distinguished
from rotorfit.estimators.blocks.small_motion import FreeVibrations, JournalCoefficients
from rotorfit.estimators.noise.sweep_noise import noise_from_smoothness
from rotorfit.identify.observing.rows import check_clearance, check_finite, check_planes, of_rows
from rotorfit.lab.data.experiments import CoefficientTable, ImpulseTest, StaticTest
from rotorfit.models import RotorModel
from rotorfit.models.motion.journal import journal


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
    pairs = zip(test.run.tolist(), test.plane.tolist(), strict=True)
    rows = of_rows(model, test, (f"{run} / {plane} static" for run, plane in pairs))
    block = Responses(
        **rows,
        frequency=still,
        force=force,
        group=group,
        line=np.arange(count),
        coordinate=coordinate,
        measured=test.displacement,
        sigma=_static_noise(test, rows["label"]),
    )
    if not model.eccentricity_dependent:
        return block
    eps = _eccentricity(model, test, coordinate)
    sweep = distinguished(test.run, test.speed, test.load_plane, test.plane)[1]
    return OrbitResponses(block, eps, "nearest" if np.isfinite(eps).all() else "followed", sweep)


def _eccentricity(model: RotorModel, test: StaticTest, coordinate: Index) -> Float:
    """Measured eccentricity of the journal in each row, NaN where no probe read it under that load."""
    seat = journal(model)
    eps = np.where(coordinate == seat.at, np.abs(test.displacement) / seat.clearance, np.nan)
    check_clearance(eps, model, "static positions")
    loads = distinguished(test.run, test.speed, test.load_plane, test.load)[1]
    for load in np.unique(loads[np.isnan(eps)]):  # other planes under a load share the journal's position
        here = loads == load
        if np.isfinite(eps[here]).any():
            eps[here] = np.where(np.isnan(eps[here]), np.nanmean(eps[here]), eps[here])
    return np.asarray(eps)


def _static_noise(test: StaticTest, label: Index) -> Float:
    """Noise given, else from repeated loads, else from the smoothness of the locus over the load."""
    sigma = test.sigma.copy()
    same, curves = distinguished(label, test.speed, test.load_plane, test.load)[1], distinguished(label, test.speed)[1]
    for curve in np.unique(curves[np.isnan(sigma)]):
        rows = np.flatnonzero(curves == curve)
        spread = _spread_of_repeats(test.displacement[rows], same[rows])
        if spread is None:
            order = rows[np.argsort(np.abs(test.load[rows]), kind="stable")]
            try:
                spread = noise_from_smoothness(np.abs(test.load[order]), test.displacement[order])
            except ValueError as reason:
                raise ValueError(f"{test.source or 'static test'}, run {test.run[rows[0]]}: {reason}") from reason
        sigma[rows] = np.where(np.isnan(sigma[rows]), spread, sigma[rows])
    return sigma


def journal_coefficients(model: RotorModel, test: CoefficientTable, group: Index) -> JournalCoefficients:
    """Observations of a table, with the accuracy that it states."""
    values = np.stack([test.kxx, test.kxy, test.cxx, test.cxy, test.mxx], axis=1)
    check_finite(test, test.speed, test.eccentricity, *values.T)
    if np.isnan(test.sigma).any():
        raise ValueError(
            f"{test.source or 'table'}: the accuracy of the coefficients is not known; give a sigma_ratio column, for "
            f"instance 3e-7 for a table of six digits"
        )
    floor = 1e-9 * np.abs(values).max(axis=0)
    error = np.maximum(test.sigma[:, None] * np.abs(values), floor)
    spread = np.concatenate([error[:, 0:2], error[:, 2:4], error[:, [4, 4]]])  # of stiffness, damping and mass
    parts = np.concatenate([values[:, 0:2], values[:, 2:4], np.column_stack([test.mxx, np.zeros(len(test))])])
    names = (f"{run} / {what}" for what in ("stiffness", "damping", "mass") for run in test.run.tolist())
    return JournalCoefficients(
        **{**of_rows(model, test, names), "run": np.tile(test.run, 3)},
        eccentricity=test.eccentricity,
        group=group,
        spread=spread,
        measured=parts[:, 0] / spread[:, 0] + 1j * parts[:, 1] / spread[:, 1],
        sigma=np.ones(len(parts)),
    )


def free_vibrations(model: RotorModel, test: ImpulseTest, group: Index) -> FreeVibrations:
    """Observations of an impulse test, with their noise."""
    check_finite(test, test.frequency, test.damping_ratio)
    eps = test.eccentricity.copy()
    read = np.isnan(eps)
    if model.clearance is not None:
        eps = np.where(np.isnan(eps), np.abs(test.position) / model.clearance, eps)
    elif not model.eccentricity_dependent:
        eps[np.isnan(eps)] = 0.0
    if np.isnan(eps).any():
        row = int(np.flatnonzero(np.isnan(eps))[0]) + 1
        raise ValueError(
            f"{test.source or 'impulse test'}: row {row} gives neither eccentricity nor position of the journal; use 0 "
            f"for a centred one"
        )
    check_clearance(eps, model, "static positions")
    s = test.eigenvalue
    sigma = test.sigma.copy()
    if np.isnan(sigma).any():
        spread = _spread_of_repeats(s, distinguished(test.speed, np.round(eps, 9))[1])
        if spread is None:
            raise ValueError(
                f"{test.source or 'impulse test'}: the noise of frequency and damping is not known; give a sigma_rpm "
                f"column, or repeat impulses at the same speed and eccentricity"
            )
        sigma[np.isnan(sigma)] = spread
    return FreeVibrations(
        **of_rows(model, test, np.char.add(test.run, " / eigenvalue").tolist()),
        eccentricity=eps,
        position_read=read,
        reading_group=group,
        measured=s,
        sigma=sigma,
    )


def _spread_of_repeats(values: ComplexArray, same: Index) -> float | None:
    """Standard deviation of each part from values measured several times, None where none was."""
    free, total = 0, 0.0
    for key in np.unique(same):
        part = values[same == key]
        free += part.size - 1
        total += float(np.sum(np.abs(part - part.mean()) ** 2))
    return float(np.sqrt(total / (2 * free))) if free and total > 0 else None
