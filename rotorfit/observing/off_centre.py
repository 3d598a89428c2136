"""Small motion about a static position off the centre."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from rotorfit.data.experiments import PerturbationTest
from rotorfit.estimators.blocks.observations import Responses
from rotorfit.estimators.blocks.row_keys import words
from rotorfit.estimators.blocks.small_motion import OffCentreResponses
from rotorfit.models import RotorModel
from rotorfit.models.array_types import ComplexArray, Index
from rotorfit.models.motion.journal import journal
from rotorfit.observing.circular import first_rows, observe
from rotorfit.observing.refusals import check_clearance, check_finite


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
    check_clearance(eps, model, "static positions")
    parts = []
    for axis in ("x", "y"):
        rows = np.flatnonzero(test.direction == axis)
        if rows.size:
            part = test.select(rows)
            block = observe(model, part, group[rows])
            first = first_rows(part)
            parts.append((axis, block, eps[rows][first], np.angle(position[rows][first])))
    phasors = [_probe_phasors(axis, block) for axis, block, _, _ in parts]
    names = [f"{block.labels[k]} {axis}" for axis, block, _, _ in parts for k in block.label.tolist()]
    labels, label = words(np.array(names))
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
        labels=tuple(labels),
        run=joined(lambda b: b.run).astype(str),
    )


def _probe_phasors(axis: str, block: Responses) -> ComplexArray:
    """Phasor of a probe, relative to exp(+j|w|t), from what was taken for a circular orbit."""
    turned = block.measured if axis == "x" else -1j * block.measured
    return np.where(block.frequency[block.line] < 0, turned.conj(), turned)
