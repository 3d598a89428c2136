"""Vectors of a sweep as a fit gets them, over frequency, for figures."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from rotorfit.models.array_types import ComplexArray, Float
from rotorfit.recordings.reduction.reductions import reduced_responses
from rotorfit.recordings.views import OrderVectors

if TYPE_CHECKING:
    from rotorfit.recordings.recording import Recording


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
    speed, phasors = _interrupted(frequency, phasors)
    return OrderVectors(
        reference="perturbator",
        t=np.full(speed.size, np.nan),
        speed=speed,
        phasors=phasors,
        probes=tuple((plane, {"y": np.pi / 2}.get(direction, 0.0)) for plane, direction in channels),
        forward={},
        backward={},
    )


def _interrupted(frequency: Float, phasors: ComplexArray) -> tuple[Float, ComplexArray]:
    """The same with nothing where lines are left out."""
    steps = np.diff(frequency)
    # Steps between lines, over the usual step, from which a curve is interrupted: one line is left out, or more
    gap = 2.5
    gaps = np.flatnonzero(steps > gap * np.median(steps)) if steps.size else np.zeros(0, dtype=np.intp)
    middle = (frequency[gaps] + frequency[gaps + 1]) / 2
    return np.insert(frequency, gaps + 1, middle), np.insert(phasors, gaps + 1, np.nan, axis=1)
