"""From any experiment to observations in a model's coordinates, fluids that change with eccentricity included."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from rotorfit.data.experiments import (
    CoefficientTable,
    DisplacementTest,
    Experiment,
    ImpulseTest,
    LineTest,
    PerturbationTest,
    RingDownTest,
    StaticTest,
)
from rotorfit.estimators.coefficients import JournalCoefficients
from rotorfit.estimators.noise import noise_from_smoothness
from rotorfit.estimators.nonlinear import OrbitResponses
from rotorfit.estimators.observations import Block, Responses
from rotorfit.estimators.small_motion import FreeVibrations, OffCentreResponses
from rotorfit.models import AnisotropicShaft, RotorModel
from rotorfit.models.array_types import ComplexArray, Float, Index
from rotorfit.models.journal import journal
from rotorfit.observing.circular import lines_of, observe
from rotorfit.observing.shaft_lines import lines_of_test, main_lines

_CLEAR = 1.0 - 1e-6  # eccentricity above which a measured position is out of the clearance


def observe_any(model: RotorModel, experiment: Experiment, group: Index) -> Block:
    """Observations of an experiment in the model's coordinates, with their noise.

    Args:
        model: the rotor.
        experiment: what was measured.
        group: parameter group of each row.

    Raises:
        ValueError: planes or directions that the model does not have, readings that are not finite, a noise that
            neither the data nor the user tell.
    """
    block: Block
    match experiment:
        case StaticTest():
            block = _static(model, experiment, group)
        case ImpulseTest():
            block = _impulses(model, experiment, group)
        case RingDownTest():
            from rotorfit.data.ring_down import ring_down_modes

            _, first = np.unique(experiment.run, return_index=True)
            block = _impulses(model, ring_down_modes(experiment), group[np.sort(first)])
        case CoefficientTable():
            block = _coefficients(model, experiment, group)
        case LineTest():
            block = lines_of_test(model, experiment, group)
        case DisplacementTest():
            block = _imposed(model, observe(model, experiment, group))
        case _:
            block = _forced(model, experiment, group)
    return block


def _forced(model: RotorModel, test: PerturbationTest, group: Index) -> Block:
    if isinstance(model, AnisotropicShaft):
        return main_lines(model, observe(model, test, group))
    if not model.eccentricity_dependent:
        return observe(model, test, group)
    if test.linear.any():
        raise ValueError(
            f"{test.source or 'experiment'}: {model.name} changes with the eccentricity of circular orbits, and a "
            f"force along {test.force_direction[test.linear][0]} makes no circular one; fit the model without its "
            "law, or the model anisotropic"
        )
    position = test.static_position
    if position is None:
        return _orbits(model, observe(model, test, group))
    return _off_centre(model, test, group, position)


# ---- circular orbits ----------------------------------------------------------------------------


def _orbits(model: RotorModel, base: Responses) -> OrbitResponses:
    """Responses with the measured eccentricity of each line, which chooses the branch.

    Where the journal was not measured the branch is that which a sweep from its first line on would reach.
    """
    seat = journal(model)
    amplitude, _ = base.amplitudes()
    eps = np.abs(amplitude[:, seat.at]) / seat.clearance
    _check_clearance(eps, model, "orbits")
    sense = np.where(base.frequency < 0, -1.0, 1.0)
    plane = np.argmax(np.abs(base.force), axis=1)
    run = np.unique(base.run, return_inverse=True)[1].reshape(-1)
    of_line = np.zeros(base.speed.size)
    of_line[base.line] = run
    size = np.round(np.abs(base.force).max(axis=1) / np.maximum(base.frequency**2, 1.0), 15)
    constant = np.round(np.abs(base.force).max(axis=1), 12)
    # A run may hold several force levels, of constant forces or of unbalances: the fewer levels are meant.
    level = min(size, constant, key=lambda values: np.unique(values).size)
    codes = np.column_stack([of_line, base.speed, sense, plane, level])
    sweep = np.unique(codes, axis=0, return_inverse=True)[1].reshape(-1).astype(np.intp)
    return OrbitResponses(base, eps, "nearest" if np.isfinite(eps).all() else "followed", sweep)


def _imposed(model: RotorModel, base: Responses) -> Block:
    if not model.eccentricity_dependent:
        return base
    seat = journal(model)
    if (base.coordinate != seat.at).any():
        raise ValueError(
            f"{model.name} changes with the eccentricity at {model.coordinates[seat.at].plane}; a circular orbit has "
            f"to be imposed there, or the eccentricity is not known"
        )
    eps = np.abs(base.force[:, seat.at]) / seat.clearance
    _check_clearance(eps, model, "imposed orbits")
    return OrbitResponses(base, eps, "given", np.arange(eps.size, dtype=np.intp))


def _check_clearance(eps: Float, model: RotorModel, what: str) -> None:
    largest = float(np.nanmax(eps, initial=0.0))
    if largest > _CLEAR and model.clearance is not None:
        raise ValueError(
            f"{what} reach {largest * model.clearance * 1e6:.4g} um, the clearance is {model.clearance * 1e6:.4g} um; "
            f"check clearance_um and the units of the data"
        )


# ---- static loads -----------------------------------------------------------------------------------------


def _static(model: RotorModel, test: StaticTest, group: Index) -> Block:
    _check_finite(test, test.load, test.displacement)
    _check_planes(model, test)
    if model.frame != "z":
        raise ValueError(f"{model.name} keeps x and y apart; static loads need a model in complex coordinates")
    count = len(test)
    still = np.zeros(count)
    force = np.zeros((count, len(model.coordinates)), dtype=complex)
    for plane in test.force_planes:
        at = test.load_plane == plane
        force[at] = model.force_vector(plane, still[at], test.load[at])
    coordinate = np.array([model.coordinate(plane, "z") for plane in test.plane.tolist()], dtype=np.intp)
    names = [f"{run} / {plane} static" for run, plane in zip(test.run.tolist(), test.plane.tolist(), strict=True)]
    label, labels = _labels(names)
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
    seat = journal(model)
    eps = np.where(coordinate == seat.at, np.abs(test.displacement) / seat.clearance, np.nan)
    _check_clearance(eps, model, "static positions")
    loads = _same(test.run, test.speed, test.load_plane, test.load.real, test.load.imag)
    for load in np.unique(loads[np.isnan(eps)]):  # other planes under a load share the journal's position
        here = loads == load
        if np.isfinite(eps[here]).any():
            eps[here] = np.where(np.isnan(eps[here]), np.nanmean(eps[here]), eps[here])
    sweep = _same(test.run, test.speed, test.load_plane, test.plane)
    return OrbitResponses(block, eps, "nearest" if np.isfinite(eps).all() else "followed", sweep)


def _static_noise(test: StaticTest, label: Index) -> Float:
    """Noise given, else from repeated loads, else from the smoothness of the locus over the load."""
    sigma = test.sigma.copy()
    same = _same(label, test.speed, test.load_plane, test.load.real, test.load.imag)
    for curve in np.unique(_same(label, test.speed)[np.isnan(sigma)]):
        rows = np.flatnonzero(_same(label, test.speed) == curve)
        spread = _repeats(test.displacement[rows], same[rows])
        if spread is None:
            order = rows[np.argsort(np.abs(test.load[rows]), kind="stable")]
            try:
                spread = float(noise_from_smoothness(np.abs(test.load[order]), test.displacement[order])[0])
            except ValueError as reason:
                raise ValueError(f"{test.source or 'static test'}, run {test.run[rows[0]]}: {reason}") from reason
        sigma[rows] = np.where(np.isnan(sigma[rows]), spread, sigma[rows])
    return sigma


def _repeats(values: ComplexArray, same: Index) -> float | None:
    """Standard deviation of each part from values measured several times, None where none was."""
    free, total = 0, 0.0
    for key in np.unique(same):
        part = values[same == key]
        free += part.size - 1
        total += float(np.sum(np.abs(part - part.mean()) ** 2))
    return float(np.sqrt(total / (2 * free))) if free and total > 0 else None


# ---- free vibration ---------------------------------------------------------------------------------------


def _impulses(model: RotorModel, test: ImpulseTest, group: Index) -> FreeVibrations:
    _check_finite(test, test.frequency, test.damping_ratio)
    eps = test.eccentricity.copy()
    if model.clearance is not None:
        eps = np.where(np.isnan(eps), np.abs(test.position) / model.clearance, eps)
    elif not model.eccentricity_dependent:
        eps[np.isnan(eps)] = 0.0
    if np.isnan(eps).any():
        row = int(np.flatnonzero(np.isnan(eps))[0]) + 1
        raise ValueError(
            f"{test.source or 'impulse test'}: row {row} tells neither eccentricity nor position of the journal; use 0 "
            f"for a centred one"
        )
    _check_clearance(eps, model, "static positions")
    label, labels = _labels([f"{run} / eigenvalue" for run in test.run.tolist()])
    s = test.eigenvalue
    sigma = test.sigma.copy()
    if np.isnan(sigma).any():
        spread = _repeats(s, _same(test.speed, np.round(eps, 9)))
        if spread is None:
            raise ValueError(
                f"{test.source or 'impulse test'}: the noise of frequency and damping is not known; give a sigma_rpm "
                f"column, or repeat impulses at the same speed and eccentricity"
            )
        sigma[np.isnan(sigma)] = spread
    return FreeVibrations(
        model=model,
        speed=test.speed,
        eccentricity=eps,
        reading_group=group,
        measured=s,
        sigma=sigma,
        label=label,
        labels=labels,
        run=test.run,
    )


# ---- small motion off centre -----------------------------------------------------------------------------------------


def _off_centre(model: RotorModel, test: PerturbationTest, group: Index, position: ComplexArray) -> OffCentreResponses:
    other = sorted(set(test.direction.tolist()) - {"x", "y"})
    if other:
        raise ValueError(
            f"{test.source or 'experiment'}: off-centre motion is not circular; it needs readings in x and y, not "
            f"{', '.join(other)}"
        )
    seat = journal(model)
    eps = np.abs(position) / seat.clearance
    _check_finite(test, position)
    _check_clearance(eps, model, "static positions")
    parts = []
    for axis in ("x", "y"):
        rows = np.flatnonzero(test.direction == axis)
        if rows.size:
            part = test.select(rows)
            block = observe(model, part, group[rows])
            first = lines_of(model, part)
            parts.append((axis, block, eps[rows][first], np.angle(position[rows][first])))
    phasors = [_probe_phasors(axis, block) for axis, block, _, _ in parts]
    names = [f"{block.labels[k]} {axis}" for axis, block, _, _ in parts for k in block.label.tolist()]
    label, labels = _labels(names)
    starts = np.cumsum([0, *(block.speed.size for _, block, _, _ in parts)])

    def joined(pick: Callable[[Responses], NDArray[np.generic]]) -> NDArray[np.generic]:
        return np.concatenate([pick(block) for _, block, _, _ in parts])

    return OffCentreResponses(
        model=model,
        speed=joined(lambda b: b.speed).astype(float),
        frequency=joined(lambda b: b.frequency).astype(float),
        force=joined(lambda b: b.force).astype(complex),
        eccentricity=np.concatenate([e for _, _, e, _ in parts]),
        attitude=np.concatenate([a for _, _, _, a in parts]),
        group=joined(lambda b: b.group).astype(np.intp),
        line=np.concatenate([part[1].line + start for part, start in zip(parts, starts[:-1], strict=True)]),
        coordinate=joined(lambda b: b.coordinate).astype(np.intp),
        vertical=np.concatenate([np.full(block.measured.size, axis == "y") for axis, block, _, _ in parts]),
        measured=np.concatenate(phasors),
        sigma=joined(lambda b: b.sigma).astype(float),
        label=label,
        labels=labels,
        run=joined(lambda b: b.run).astype(str),
    )


def _probe_phasors(axis: str, block: Responses) -> ComplexArray:
    """Phasor of a probe, relative to exp(+j|w|t), from what was taken for a circular orbit."""
    turned = block.measured if axis == "x" else -1j * block.measured
    return np.where(block.frequency[block.line] < 0, turned.conj(), turned)


# ---- coefficients -------------------------------------------------------------------------------------------


def _coefficients(model: RotorModel, test: CoefficientTable, group: Index) -> JournalCoefficients:
    values = np.stack([test.kxx, test.kxy, test.cxx, test.cxy, test.mxx], axis=1)
    _check_finite(test, test.speed, test.eccentricity, *values.T)
    if np.isnan(test.sigma).any():
        raise ValueError(
            f"{test.source or 'table'}: the accuracy of the coefficients is not known; give a sigma_ratio column, for "
            f"instance 3e-7 for a table of six digits"
        )
    floor = 1e-9 * np.abs(values).max(axis=0)
    error = np.maximum(test.sigma[:, None] * np.abs(values), floor)
    mass = test.sigma * np.abs(test.mxx)
    spread = np.concatenate([error[:, 0:2], error[:, 2:4], np.column_stack([error[:, 4], np.maximum(mass, floor[4])])])
    parts = np.concatenate([values[:, 0:2], values[:, 2:4], np.column_stack([test.mxx, np.zeros(len(test))])])
    names = [f"{run} / {what}" for what in ("stiffness", "damping", "mass") for run in test.run.tolist()]
    label, labels = _labels(names)
    measured = parts[:, 0] / spread[:, 0] + 1j * parts[:, 1] / spread[:, 1]
    return JournalCoefficients(
        model=model,
        speed=test.speed,
        eccentricity=test.eccentricity,
        group=group,
        spread=spread,
        measured=measured,
        label=label,
        labels=labels,
        run=np.tile(test.run, 3),
    )


# ---- helpers ----------------------------------------------------------------------------


def _labels(names: list[str]) -> tuple[Index, tuple[str, ...]]:
    labels = tuple(dict.fromkeys(names))
    number = {name: i for i, name in enumerate(labels)}
    return np.array([number[name] for name in names], dtype=np.intp), labels


def _same(*columns: NDArray[np.generic]) -> Index:
    """Number rows by equality in all columns."""
    codes = np.column_stack([np.unique(column, return_inverse=True)[1].reshape(-1) for column in columns])
    return np.unique(codes, axis=0, return_inverse=True)[1].reshape(-1).astype(np.intp)


def _check_finite(test: Experiment, *columns: NDArray[np.generic]) -> None:
    bad = np.zeros(len(test), dtype=bool)
    for column in columns:
        bad |= ~np.isfinite(column)
    if bad.any():
        rows = ", ".join(str(row + 1) for row in np.flatnonzero(bad)[:8])
        raise ValueError(f"{test.source or test.title}: {bad.sum()} rows are not finite ({rows}); remove them")


def _check_planes(model: RotorModel, test: StaticTest) -> None:
    unknown = (set(test.planes) | set(test.force_planes)) - set(model.planes)
    if unknown:
        raise ValueError(
            f"{test.source or 'static test'} has planes {', '.join(test.planes)} and load planes "
            f"{', '.join(test.force_planes)}, the model {model.name} has {', '.join(model.planes)}. Map names with "
            f"{type(model).__name__}(planes=(...)) or --planes"
        )
