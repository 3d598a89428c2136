"""Responses as ratios of polynomials in frequency: how well as many poles as a model has can fit, and where zeros lie.

At one speed every response is ``N(w)/d(w)`` with one denominator for all of them. With the last denominator as weight
the fit is linear (Sanathanan and Koerner 1963): no start, no local minimum. It holds every rotor with so many poles, so
that a fit of the rotor which misses the data by much more has not found them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rotorfit.estimators.blocks.observations import Responses
from rotorfit.estimators.signals.ratios import best_ratio
from rotorfit.models.array_types import Index

_DATA_AN_UNKNOWN = 2.0  # real data an unknown from which on the residuals of the ratios show the noise
_SAME_FREQUENCY = 0.02  # relative difference of frequencies that are one


@dataclass(frozen=True, kw_only=True)
class RationalFit:
    """Ratios of polynomials fitted to responses."""

    cost: float  # half the sum of squares that they leave
    unknowns: int  # real unknowns
    data: int  # real numbers of the data
    zeros: tuple[float, ...]  # their frequencies, rad/s, ascending

    def limit(self, unknowns: int, deviations: float) -> float:
        """Cost that a rotor with so many poles leaves, to so many standard deviations of chi-squared."""
        level = max(1.0, 2 * self.cost / (self.data - self.unknowns))
        spare = max(self.unknowns - unknowns, 1)
        return float(self.cost + level * (spare + deviations * np.sqrt(2 * spare)) / 2)


def rational_fit(blocks: Sequence[Responses]) -> RationalFit | None:
    """Ratios of polynomials with as many poles as the model has; None of models and readings without such ratios."""
    fits = []
    for block in blocks:
        if block.model.frame != "z" or block.model.shaft is not None or block.imposed:
            return None
        if (np.count_nonzero(block.force, axis=1) != 1).any() or not block.frequency.any():
            return None
        for readings in block.at_set_speed().condition_readings:
            fit = _fit(block, readings)
            if fit is None:
                return None
            fits.append(fit)
    return RationalFit(
        cost=sum(fit.cost for fit in fits),
        unknowns=sum(fit.unknowns for fit in fits),
        data=sum(fit.data for fit in fits),
        zeros=_distinct([w for fit in fits for w in fit.zeros]),
    )


def _fit(block: Responses, readings: Index) -> RationalFit | None:
    order, size = block.model.order, len(block.model.coordinates)
    poles, zeros = order * size, order * (size - 1)
    line, probe = block.line[readings], block.coordinate[readings]
    plane = np.argmax(np.abs(block.force[line]), axis=1)
    force = block.force[line, plane]
    pairs, pair = np.unique(probe * size + plane, return_inverse=True)
    unknowns = 2 * (poles + pairs.size * (zeros + 1))
    if 2 * readings.size < _DATA_AN_UNKNOWN * unknowns:
        return None
    top = float(np.abs(block.frequency[line]).max())
    powers = np.asarray(np.polynomial.chebyshev.chebvander(block.frequency[line] / top, poles), dtype=float)
    numerators = np.zeros((readings.size, pairs.size, zeros + 1))
    numerators[np.arange(readings.size), pair.reshape(-1)] = powers[:, : zeros + 1]
    response, sigma = block.measured[readings] / force, block.sigma[readings] / np.abs(force)
    _, numerator, cost = best_ratio(response, sigma, powers, numerators.reshape(readings.size, -1))
    seen = numerator.reshape(pairs.size, zeros + 1)[pairs // size == pairs % size]
    zeros_seen = [float(abs(w)) for own in seen for w in np.polynomial.chebyshev.chebroots(own)]
    return RationalFit(
        cost=cost,
        unknowns=unknowns,
        data=2 * readings.size,
        zeros=tuple(w * top for w in zeros_seen if 0 < w < 1),  # in the band
    )


def _distinct(frequencies: Sequence[float]) -> tuple[float, ...]:
    """Frequencies, ascending, of which those that two speeds or directions have in common are one."""
    found: list[float] = []
    for w in sorted(frequencies):
        if not found or w > (1 + _SAME_FREQUENCY) * found[-1]:
            found.append(w)
    return tuple(found)
