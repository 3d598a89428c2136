"""Influences of weights as observations with correlated errors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from rotorfit.data.weights import Influences
from rotorfit.estimators.blocks.correlated import CorrelatedResponses
from rotorfit.estimators.blocks.observations import Responses
from rotorfit.models.array_types import ComplexArray


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
        freedom=solved.freedom,
        weight_freedom=solved.weight_freedom,
        remarks=influences.remarks,
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
