"""From responses to forces to observations in a model's coordinates, by what the model is."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from rotorfit.base.array_types import ComplexArray, Index
from rotorfit.estimators.blocks.correlated import CorrelatedResponses
from rotorfit.estimators.blocks.nonlinear import OrbitResponses
from rotorfit.estimators.blocks.observations import Block, Responses
from rotorfit.estimators.blocks.row_keys import distinguished, words
from rotorfit.estimators.blocks.shaft_lines import LineResponses
from rotorfit.estimators.blocks.small_motion import OffCentreResponses
from rotorfit.lab.data.experiments import PerturbationTest
from rotorfit.lab.data.weights import Influences
from rotorfit.lab.observing.circular import observe
from rotorfit.lab.observing.rows import check_clearance, check_finite
from rotorfit.models import AnisotropicShaft, RotorModel
from rotorfit.models.motion.journal import journal, journals


def forced_responses(model: RotorModel, test: PerturbationTest, group: Index) -> Block:
    """Observations of responses to forces in the model's coordinates, with their noise."""
    if isinstance(model, AnisotropicShaft):
        return main_lines(model, observe(model, test, group))
    if model.line_places:
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
    seats, (amplitude, _) = journals(model), base.amplitudes()
    eps = np.stack([np.abs(amplitude[:, seat.at]) / seat.clearance for seat in seats])
    for seat, own in zip(seats, eps, strict=True):
        check_clearance(own, seat.clearance, "orbits")
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


def off_centre_responses(
    model: RotorModel, test: PerturbationTest, group: Index, position: ComplexArray
) -> OffCentreResponses:
    """Observations of a perturbation test at a static position, with their noise."""
    other = sorted(set(test.direction.tolist()) - {"x", "y"})
    if other:
        raise ValueError(
            f"{test.source or 'experiment'}: off-centre motion is not circular; it needs readings in x and y, not "
            f"{', '.join(other)}"
        )
    seat = journal(model)
    eps = np.abs(position) / seat.clearance
    check_finite(test, position)
    check_clearance(eps, seat.clearance, "static positions")
    parts = []
    for axis in ("x", "y"):
        rows = np.flatnonzero(test.direction == axis)
        if rows.size:
            part = test.select(rows)
            block = observe(model, part, group[rows])
            first = part.lines_apart[0]
            # Phasors of the probe, relative to exp(+j|w|t), from what was taken for a circular orbit.
            turned = block.measured if axis == "x" else -1j * block.measured
            phasors = np.where(block.frequency[block.line] < 0, turned.conj(), turned)
            parts.append((axis, replace(block, measured=phasors), rows[first]))
    rows = np.concatenate([first for _, _, first in parts])
    names = [f"{block.labels[k]} {axis}" for axis, block, _ in parts for k in block.label.tolist()]
    labels, label = words(np.array(names))
    starts = np.cumsum([0, *(block.speed.size for _, block, _ in parts)])

    def joined(column: str) -> Any:
        return np.concatenate([getattr(block, column) for _, block, _ in parts])

    return OffCentreResponses(
        model=model,
        speed=joined("speed"),
        frequency=joined("frequency"),
        force=joined("force"),
        eccentricity=eps[rows],
        attitude=np.angle(position[rows]),
        group=joined("group"),
        line=np.concatenate([block.line + start for (_, block, _), start in zip(parts, starts[:-1], strict=True)]),
        coordinate=joined("coordinate"),
        vertical=np.concatenate([np.full(block.measured.size, axis == "y") for axis, block, _ in parts]),
        measured=joined("measured"),
        sigma=joined("sigma"),
        label=label,
        labels=tuple(labels),
        run=joined("run"),
    )


def correlated(base: Responses, influences: Influences) -> CorrelatedResponses:
    """Observations of influences with the covariance of their errors."""
    solved = influences.solved
    combine = _combination(base, influences) * np.tile(influences.weight, solved.channel.size)
    working, covariance = (combine @ matrix @ combine.conj().T for matrix in (solved.working, solved.covariance))
    sigma = np.sqrt(np.real(np.diag(working)))
    if not np.isfinite(sigma).all():  # neither repeats nor given noise: what was estimated from the readings stands
        sigma = base.sigma
        working = covariance = np.diag(sigma**2).astype(complex)
    scale = np.outer(sigma, sigma)
    return CorrelatedResponses(
        base=replace(base, sigma=sigma),
        correlation=working / scale,
        covariance=covariance / scale,
        degrees=solved.freedom,
        weight_freedom=solved.weight_freedom,
        notes=influences.remarks,
    )


def _combination(base: Responses, influences: Influences) -> ComplexArray:
    """Share of each row of the test in each reading, shape ``(readings, rows)``."""
    rows: dict[tuple[str, float, str], dict[str, int]] = {}
    test = influences.test
    keys = zip(test.run.tolist(), test.speed.tolist(), test.plane.tolist(), test.direction.tolist(), strict=True)
    for number, (run, speed, plane, direction) in enumerate(keys):
        rows.setdefault((run, speed, plane), {})[direction] = number
    combine = np.zeros((base.measured.size, len(test)), dtype=complex)
    for reading, (line, place) in enumerate(zip(base.line.tolist(), base.coordinate.tolist(), strict=True)):
        coordinate = base.model.coordinates[place]
        there = rows[str(base.run[reading]), float(base.speed[line]), coordinate.plane]
        if coordinate.axis in ("x", "y"):
            combine[reading, there[coordinate.axis]] = 1.0
        elif "x" in there and "y" in there:  # the forward component, (X + jY)/2
            combine[reading, [there["x"], there["y"]]] = 0.5, 0.5j
        else:  # one probe, taken as a circular orbit
            direction, number = next(iter(there.items()))
            combine[reading, number] = 1j if direction == "y" else 1.0
    return combine


def main_lines(model: AnisotropicShaft, base: Responses) -> LineResponses:
    """Responses to circular forces as lines at w, the image at 2 Om - w not having been measured."""
    line = base.line
    synchronous = np.abs(base.frequency - base.speed) <= 1e-4 * np.abs(base.speed)
    if synchronous.any():
        raise ValueError(
            f"{model.name}: at w = Om a line and its image 2 Om - w are one; give synchronous responses as line 1x of "
            "a LineTest, or leave them out"
        )
    return LineResponses(
        model=model,
        speed=base.speed[line],
        frequency=base.frequency[line],
        force=base.force[line, 0],
        direction=np.full(line.size, "z"),
        line=np.full(line.size, "w"),
        reading_group=base.reading_group,
        measured=base.measured,
        sigma=base.sigma,
        label=base.label,
        labels=base.labels,
        run=base.run,
    )
