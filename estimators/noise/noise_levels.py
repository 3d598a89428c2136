"""Noise levels from the residuals of a fit by restricted likelihood, for residuals that are white along each sweep.

Noise found in the data alone (:mod:`rotorfit.estimators.noise.reading_noise`) does not see what both probes share, such
as a force that jitters. Residuals see it, and where they do not follow one another along the sweep it is noise and no
misfit.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rotorfit.estimators.noise.reading_noise import FLOOR
from rotorfit.models.array_types import Float, Index

_RATIOS = np.concatenate([[0.0], np.logspace(-2.5, 4.5, 22), [np.inf]])
"""Tried ratios of the proportional to the constant share of the variance, at the mean square amplitude."""

_COARSE = np.array([0, *range(2, _RATIOS.size - 1, 3), _RATIOS.size - 1])
"""Those looked at first."""

_BETWEEN = np.linspace(0.0, 1.0, 9)
"""Ratios between the neighbours of the best of them, as shares of the way on a logarithmic scale."""

_POOLED = 0.01
"""Probability of keeping sweeps apart although they share one noise."""

_FEWEST = 8
"""Lines from which a sweep can have a noise of its own."""


@dataclass(frozen=True, kw_only=True)
class Shape:
    """Noise of one group of readings, ``sigma^2 = a^2 + b^2 |prediction|^2``."""

    rows: Index  # the readings
    a: float  # constant part, in units of the readings
    b: float  # part that is proportional to the prediction
    log_likelihood: float  # restricted, up to a constant of the readings
    along: str  # what ``size2`` is of, in words

    def variance(self, size2: Float) -> Float:
        """Variance of the real and of the imaginary part of each reading of the group."""
        return self.a**2 + self.b**2 * np.asarray(size2)[self.rows]


def likelihood(power: Float, weight: Float, variance: Float) -> Float:
    """Restricted log likelihood of squared residuals, up to a constant, shape ``(...)``."""
    return np.asarray(-np.sum(weight * (np.log(variance) + power / variance), axis=-1))


def fit_probes(
    probes: Sequence[Sequence[Index]], power: Float, weight: Float, size2: Float, *, along: str = ""
) -> list[list[Shape]]:
    """Constant and proportional noise of several probes by restricted likelihood.

    The sweeps of a probe share both parts, or have them each where the data refuse to pool them. For a given ratio of
    the two, the level has a closed form; the ratio is looked for on a grid, which no start can lead astray. All probes
    of one size are taken at once.
    """
    pooled = _fit_many([np.concatenate(sweeps) for sweeps in probes], power, weight, size2, along)
    several = [len(sweeps) > 1 and min(rows.size for rows in sweeps) >= _FEWEST for sweeps in probes]
    wanted = [rows for sweeps, apart in zip(probes, several, strict=True) if apart for rows in sweeps]
    singly = iter(_fit_many(wanted, power, weight, size2, along))
    found = []
    for sweeps, one, apart in zip(probes, pooled, several, strict=True):
        own = [next(singly) for _ in sweeps] if apart else [one]
        gain = 2 * (sum(shape.log_likelihood for shape in own) - one.log_likelihood)
        found.append(own if apart and _no_chance(gain, 2 * (len(sweeps) - 1)) else [one])
    return found


def _no_chance(gain: float, freedom: int) -> bool:
    """Whether chi-squared exceeds a gain with less than the probability of keeping sweeps apart by mistake."""
    ratio = gain / freedom
    if ratio <= 1:  # it exceeds its mean once in three times
        return False
    if freedom / 2 * (1 + math.log(ratio) - ratio) < math.log(_POOLED):  # Chernoff's bound of that probability
        return True
    from scipy.special import gammaincc  # late: loading it takes longer than a fit

    return bool(gammaincc(freedom / 2, gain / 2) < _POOLED)


def _fit_many(groups: Sequence[Index], power: Float, weight: Float, size2: Float, along: str) -> list[Shape]:
    """The shape of each of several groups; those of one size are worked out together."""
    by_size: dict[int, list[int]] = {}
    for number, rows in enumerate(groups):
        by_size.setdefault(rows.size, []).append(number)
    found: dict[int, Shape] = {}
    for numbers in by_size.values():
        rows = np.array([groups[number] for number in numbers])
        a, b, best = _fit_equal(power[rows], weight[rows], size2[rows])
        for number, *values in zip(numbers, a.tolist(), b.tolist(), best.tolist(), strict=True):
            found[number] = Shape(rows=groups[number], a=values[0], b=values[1], log_likelihood=values[2], along=along)
    return [found[number] for number in range(len(groups))]


def _fit_equal(p: Float, w: Float, q: Float) -> tuple[Float, Float, Float]:
    """Constant part, proportional part and log likelihood of groups of readings, arrays of shape ``(G, n)``."""
    mean = q.mean(axis=1)
    some = mean > 0
    profile = _Profile.of(p, w, q, mean)
    ratio = np.broadcast_to(_RATIOS[_COARSE], (len(q), len(_COARSE)))
    found, level = profile.at(ratio)
    near = _COARSE[np.argmax(found, axis=1)]
    # The profile changes within decades of the ratio, three steps of the grid each.
    fine = np.clip(near[:, None] + np.arange(-2, 3), 0, _RATIOS.size - 1)
    ratio = _RATIOS[fine]
    found, level = profile.at(ratio)
    best = fine[np.arange(len(q)), np.argmax(found, axis=1)]
    inner = (best > 0) & (best < _RATIOS.size - 1)
    low, high = _RATIOS[np.clip(best - 1, 1, None)], _RATIOS[np.clip(best + 1, None, _RATIOS.size - 2)]
    low, high = np.where(inner, low, 1.0)[:, None], np.where(inner, high, 1.0)[:, None]
    last = low * (high / low) ** _BETWEEN
    ratio = np.where(inner[:, None], last, _RATIOS[best][:, None])
    found, level = profile.at(ratio)
    chosen = np.arange(len(q)), np.argmax(found, axis=1)
    ratio, own = ratio[chosen], level[chosen]
    with np.errstate(invalid="ignore"):
        share = np.where(np.isinf(ratio), 1.0, ratio / (1 + ratio))
    proportional = np.where(some, share * own / np.where(some, mean, 1.0), 0.0)
    return np.sqrt((1 - share) * own), np.sqrt(proportional), found[chosen]


@dataclass(frozen=True, eq=False, kw_only=True)
class _Profile:
    """Likelihood of groups of readings, the level at its best for each ratio."""

    relative: Float  # what the noise may grow with over its mean, shape ``(G, n)``
    power: Float  # weighted squared residuals, and weights, shape ``(G, n)``
    weight: Float  # weighted squared residuals, and weights, shape ``(G, n)``
    total: Float  # sum of the weights and smallest level, shape ``(G,)``
    least: Float  # sum of the weights and smallest level, shape ``(G,)``

    @classmethod
    def of(cls, p: Float, w: Float, q: Float, mean: Float) -> _Profile:
        some = mean > 0
        relative = np.where(some[:, None], q / np.where(some, mean, 1.0)[:, None], 1.0)
        least = np.where(some, FLOOR**2 * mean, np.finfo(float).tiny)
        return cls(relative=relative, power=w * p, weight=w, total=w.sum(axis=1), least=least)

    def at(self, ratio: Float) -> tuple[Float, Float]:
        """Log likelihood and level at ratios of the proportional to the constant share, shape ``(G, m)`` each."""
        whole = np.isinf(ratio)
        finite = np.where(whole, 0.0, ratio)
        shape = (1 + finite[:, :, None] * self.relative[:, None]) / (1 + finite)[:, :, None]
        shape[whole] = np.maximum(self.relative, 1e-12)[np.nonzero(whole)[0]]
        misfit = np.matmul(1 / shape, self.power[:, :, None])[:, :, 0]
        logs = np.matmul(np.log(shape), self.weight[:, :, None])[:, :, 0]
        level = np.maximum(misfit / self.total[:, None], self.least[:, None])
        return -logs - self.total[:, None] * np.log(level) - misfit / level, level
