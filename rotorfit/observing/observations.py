"""From any experiment to observations in a model's coordinates, fluids that change with eccentricity included."""

from __future__ import annotations

import numpy as np

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
from rotorfit.estimators.blocks.nonlinear import OrbitResponses
from rotorfit.estimators.blocks.observations import Block, Responses
from rotorfit.estimators.blocks.row_keys import distinguished
from rotorfit.models import AnisotropicShaft, RotorModel, Turning
from rotorfit.models.array_types import Index
from rotorfit.models.motion.journal import journal
from rotorfit.observing.circular import observe
from rotorfit.observing.off_centre import off_centre_responses
from rotorfit.observing.refusals import check_clearance
from rotorfit.observing.shaft_lines import lines_of_test, main_lines
from rotorfit.observing.static_and_free import free_vibrations, journal_coefficients, static_loads


def observe_any(model: RotorModel, experiment: Experiment, group: Index) -> Block:
    """Observations of an experiment in the model's coordinates, with their noise."""
    block: Block
    match experiment:
        case StaticTest():
            block = static_loads(model, experiment, group)
        case ImpulseTest():
            block = free_vibrations(model, experiment, group)
        case RingDownTest():
            from rotorfit.data.ring_down import ring_down_modes

            _, first = np.unique(experiment.run, return_index=True)
            block = free_vibrations(model, ring_down_modes(experiment), group[np.sort(first)])
        case CoefficientTable():
            block = journal_coefficients(model, experiment, group)
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
    if isinstance(model, Turning):
        raise ValueError(
            f"{test.source or 'experiment'}: a turning element shows in the images at 2 Om - w; give a LineTest with "
            "them, or fit the model without its turning element"
        )
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
    return off_centre_responses(model, test, group, position)


def _orbits(model: RotorModel, base: Responses) -> OrbitResponses:
    """Responses with their measured eccentricity, which chooses the branch, or that of a sweep from the first line."""
    seat = journal(model)
    amplitude, _ = base.amplitudes()
    eps = np.abs(amplitude[:, seat.at]) / seat.clearance
    check_clearance(eps, model, "orbits")
    sense = np.where(base.frequency < 0, -1.0, 1.0)
    plane = np.argmax(np.abs(base.force), axis=1)
    run = np.full(base.speed.size, "", dtype=base.run.dtype)
    run[base.line] = base.run
    size = np.round(np.abs(base.force).max(axis=1) / np.maximum(base.frequency**2, 1.0), 15)
    constant = np.round(np.abs(base.force).max(axis=1), 12)
    # A run may hold several force levels, of constant forces or of unbalances: the fewer levels are meant.
    level = min(size, constant, key=lambda values: np.unique(values).size)
    _, sweep = distinguished(run, base.set_speed, sense, plane, level)
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
    check_clearance(eps, model, "imposed orbits")
    return OrbitResponses(base, eps, "given", np.arange(eps.size, dtype=np.intp))
