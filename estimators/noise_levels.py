"""Noise levels from the residuals of a fit by restricted likelihood, for residuals that are white along each sweep.

Noise found in the data alone (:mod:`rotorfit.estimators.noise`) does not see what both probes share, such as a force
that jitters. Residuals see it, and where they do not follow one another along the sweep it is noise and no misfit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import gammainccinv

from rotorfit.estimators.noise import FLOOR
from rotorfit.models.array_types import Float, Index

_RATIOS = np.concatenate([[0.0], np.logspace(-2.5, 4.5, 22), [np.inf]])
"""Tried ratios of the proportional to the constant share of the variance, at the mean square amplitude."""

_POOLED = 0.01
"""Probability of keeping sweeps apart although they share one noise."""

_FEWEST = 8
"""Lines from which a sweep can have a noise of its own."""


@dataclass(frozen=True, kw_only=True)
class Shape:
    """Noise of one group of readings, ``sigma^2 = a^2 + b^2 |prediction|^2``.

    Attributes:
        rows: the readings.
        a: constant part, in units of the readings.
        b: part that is proportional to the prediction.
        log_likelihood: restricted, up to a constant of the readings.
        along: what ``size2`` is of, in words.
    """

    rows: Index
    a: float
    b: float
    log_likelihood: float
    along: str

    def variance(self, size2: Float) -> Float:
        """Variance of the real and of the imaginary part at squared amplitudes of all readings, shape ``(R,)``."""
        return self.a**2 + self.b**2 * np.asarray(size2)[self.rows]


def likelihood(power: Float, weight: Float, variance: Float) -> float:
    """Restricted log likelihood of squared residuals, up to a constant.

    Args:
        power: ``|r|^2 / (2 (1 - h))``, h the leverage of the reading, shape ``(n,)``.
        weight: ``1 - h``: the share of a reading that the fitted values leave (Smyth 2002).
        variance: of real and of imaginary part.
    """
    return -float(np.sum(weight * (np.log(variance) + power / variance)))


def fit_shape(rows: Index, power: Float, weight: Float, size2: Float, *, along: str = "") -> Shape:
    """Constant and proportional noise of a group by restricted likelihood.

    For a given ratio of the two, the level has a closed form; the ratio is looked for on a grid, which no start can
    lead astray.

    Args:
        rows: readings of the group.
        power, weight: see :func:`likelihood`, of all readings, shape ``(R,)``.
        size2: square of what the noise may grow with, the modulus of predictions for one, shape ``(R,)``.
        along: that in words.
    """
    p, w, q = power[rows], weight[rows], size2[rows]
    mean = float(np.mean(q))
    least = (FLOOR**2) * mean if mean > 0 else np.finfo(float).tiny
    relative = q / mean if mean > 0 else np.ones_like(q)

    def profile(ratio: Float) -> tuple[Float, Float]:
        with np.errstate(invalid="ignore"):
            shape = np.where(np.isinf(ratio)[:, None], relative, (1 + ratio[:, None] * relative) / (1 + ratio[:, None]))
        shape = np.maximum(shape, 1e-12)
        level = np.maximum((w * p / shape).sum(axis=1) / w.sum(), least)
        found = -(w * np.log(shape)).sum(axis=1) - w.sum() * np.log(level) - (w * p / shape).sum(axis=1) / level
        return found, level

    found, level = profile(_RATIOS)
    best = int(np.argmax(found))
    ratio = _RATIOS
    if 0 < best < _RATIOS.size - 1:
        inner = max(best - 1, 1), min(best + 1, _RATIOS.size - 2)
        ratio = np.geomspace(_RATIOS[inner[0]], _RATIOS[inner[1]], 9)
        found, level = profile(ratio)
        best = int(np.argmax(found))
    share = 1.0 if np.isinf(ratio[best]) else float(ratio[best] / (1 + ratio[best]))
    own = float(level[best])
    proportional = share * own / mean if mean > 0 else 0.0
    return Shape(
        rows=rows,
        a=float(np.sqrt((1 - share) * own)),
        b=float(np.sqrt(proportional)),
        log_likelihood=float(found[best]),
        along=along,
    )


def fit_shapes(sweeps: Sequence[Index], power: Float, weight: Float, size2: Float, *, along: str = "") -> list[Shape]:
    """Noise of sweeps of one probe: one for all, or one each where the data refuse to pool them.

    Args:
        sweeps: readings of each sweep.
        power, weight, size2, along: see :func:`fit_shape`.
    """
    pooled = fit_shape(np.concatenate(sweeps), power, weight, size2, along=along)
    if len(sweeps) == 1 or min(rows.size for rows in sweeps) < _FEWEST:
        return [pooled]
    apart = [fit_shape(rows, power, weight, size2, along=along) for rows in sweeps]
    gain = 2 * (sum(shape.log_likelihood for shape in apart) - pooled.log_likelihood)
    # 2 gammainccinv(k/2, p) is the point that chi-squared with k degrees of freedom exceeds with probability p.
    return apart if gain > 2 * gammainccinv(len(sweeps) - 1, _POOLED) else [pooled]
