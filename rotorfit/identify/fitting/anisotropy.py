"""Turning anisotropy of a fitted shaft: dK, its direction, and intervals that hold near zero, where dK has no sign.

The fit knows ``v = dK (cos 2g, sin 2g)`` with a covariance. Of a round shaft the size of v comes out positive by noise
alone, so that an interval of plus and minus standard errors would call one round shaft in seven anisotropic. The
interval here holds every dK whose likelihood ratio is below what dK would exceed with the level's probability (Neyman's
construction for Rice's distribution; Feldman and Cousins 1998): at dK = 0 that is chi-squared with two degrees of
freedom, far from zero with one.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from rotorfit.base.array_types import Float
from rotorfit.base.digits import significant
from rotorfit.estimators.inference.covariance import standard_error
from rotorfit.identify.fitting.quantities import Quantity
from rotorfit.identify.fitting.result import FitResult
from rotorfit.models import RotorModel, eigenvalues, unstable_bands
from rotorfit.models.motion.stability import growing_bands

_FAR = 12.0
"""Standard deviations from zero beyond which Rice's distribution is a normal one."""


@dataclass(frozen=True, kw_only=True)
class TurningAnisotropy:
    """The fitted turning anisotropy."""

    dK: Quantity  # half the difference of the two lateral stiffnesses, N/m
    ratio: Quantity  # dK/K, NaN for models without one K
    # direction of the greater stiffness ahead of the Keyphasor mark, rad, between -pi/2 and pi/2; its standard
    # error is infinite where dK may be zero
    angle: Quantity
    interval: tuple[float, float]  # of dK, N/m
    ratio_interval: tuple[float, float]  # of dK/K
    level: float  # of both intervals

    @property
    def significant(self) -> bool:
        """True if the interval excludes a round shaft."""
        return self.interval[0] > 0

    def __str__(self) -> str:
        if not math.isfinite(self.interval[1]):
            return "not determined by these data"
        level = f"{significant(100 * self.level, 4)} % interval"
        if math.isfinite(self.ratio.value):
            low, high = (significant(100 * value, 4) for value in self.ratio_interval)
            size = f"dK = {self.dK}, dK/K = {significant(100 * self.ratio.value, 4)} % ({level} {low} to {high} %)"
        else:
            low, high = (significant(value, 5) for value in self.interval)
            size = f"dK = {self.dK} ({level} {low} to {high} N/m)"
        if not self.significant:
            return f"{size}: a round shaft is not ruled out"
        angle, error = (math.degrees(part) for part in (self.angle.value, self.angle.stderr))
        return f"{size}, stiff direction {significant(angle, 4)} +- {significant(error, 2)} deg ahead of the mark"


def turning_anisotropy(
    fit: FitResult, *, level: float = 0.95, at: Mapping[str, Any] | None = None
) -> TurningAnisotropy:
    """Turning anisotropy of a fit with the parameters dK_cos, dK_sin and K."""
    names = fit.model.parameter_names
    if "dK_cos" not in names or "dK_sin" not in names:
        raise ValueError(f"{fit.model.name} has no turning anisotropy dK_cos, dK_sin")
    if not 0 < level < 1:
        raise ValueError(f"level {level} is a probability, between 0 and 1")
    theta = dict(zip(names, fit.theta(at).tolist(), strict=True))
    v, K = np.array([theta["dK_cos"], theta["dK_sin"]]), theta.get("K", math.nan)
    # Covariance of dK_cos, dK_sin and K; known ones have none, those that the data leave open an infinite one.
    index = fit.problem.space.index[fit.group(at)]
    entries = np.array([int(index[names.index(name)]) if name in names else -1 for name in ("dK_cos", "dK_sin", "K")])
    known = entries < 0
    covar = np.where(known[:, None] | known, 0.0, fit.covar[np.ix_(entries, entries)])
    for i in np.flatnonzero(~known).tolist():
        if not fit.params[fit.var_names[entries[i]]].resolved:
            covar[i, i] = math.inf
    over_K = np.column_stack([np.eye(2) / K, -v / K**2])
    size = float(np.hypot(*v))
    interval = ratio_interval = (0.0, math.inf)
    error = share_error = turn = math.inf
    if np.isfinite(covar).all():
        own, share = covar[:2, :2], over_K @ covar @ over_K.T
        along = v / size if size else np.array([1.0, 0.0])
        interval = magnitude_interval(v, own, level)
        ratio_interval = magnitude_interval(v / K, share, level) if math.isfinite(K) else (math.nan, math.nan)
        error, share_error = (float(standard_error(along, one)) for one in (own, share))
        across = float(standard_error(np.array([-along[1], along[0]]), own))
        turn = across / (2 * size) if interval[0] > 0 else math.inf
    return TurningAnisotropy(
        dK=Quantity(size, error, "N/m"),
        ratio=Quantity(size / K, share_error, "1"),
        angle=Quantity(0.5 * math.atan2(v[1], v[0]), turn, "rad"),
        interval=interval,
        ratio_interval=ratio_interval,
        level=level,
    )


def magnitude_interval(v: Float, covar: Float, level: float) -> tuple[float, float]:
    """Interval of the length of a vector in the plane that is known with a covariance."""
    from scipy.optimize import brentq

    size = float(np.hypot(*v))
    spread = float(np.linalg.det(covar)) ** 0.25 if np.linalg.det(covar) > 0 else 0.0
    if spread == 0.0:
        return size, size
    inverse = np.linalg.inv(covar)
    angles = np.linspace(-math.pi, math.pi, 721)
    directions = np.array([np.cos(angles), np.sin(angles)])

    def excess(length: float) -> float:
        """Likelihood ratio of a length over its critical value, less one; below zero inside the interval."""
        miss = v[:, None] - length * directions
        distance = float(np.einsum("ir,ij,jr->r", miss, inverse, miss).min())
        critical = float(np.interp(length / spread, *_critical_table(level)))
        return math.sqrt(distance) / critical - 1.0

    reach = 4 * math.sqrt(float(np.linalg.eigvalsh(covar)[-1])) + size * 1e-9
    while excess(size + reach) < 0:
        reach *= 2
    # The nearest direction on the grid stands for that of the estimate: refine where v is far from zero.
    angles = np.linspace(-0.02, 0.02, 401) + math.atan2(v[1], v[0]) if size > _FAR * reach / 4 else angles
    directions = np.array([np.cos(angles), np.sin(angles)])
    high = float(brentq(excess, size, size + reach))
    low = float(brentq(excess, 0.0, size)) if excess(0.0) > 0 else 0.0
    return low, high


@cache
def _critical_table(level: float) -> tuple[Float, Float]:
    """Lengths, and the distance from each that a Rice variable of unit spread stays within with the probability."""
    from scipy.optimize import brentq
    from scipy.stats import norm, rice

    def missed(distance: float, length: float) -> float:
        inside = rice.cdf(length + distance, length) - rice.cdf(max(length - distance, 0.0), length)
        return float(inside) - level

    lengths = np.linspace(0.0, _FAR, 121)
    found = [float(brentq(missed, 1e-6, 20.0, args=(length,))) for length in lengths[:-1].tolist()]
    return lengths, np.array([*found, float(norm.ppf((1 + level) / 2))])


def unstable_speeds(model: RotorModel, theta: Float, top: float) -> list[tuple[float, float]]:
    """Ranges of speed up to ``top``, rad/s, in which a shaft that is not round runs away, or its motion grows."""
    return (growing_bands if model.line_count > 2 else unstable_bands)(model, theta, top)


def searched_speed(fit: FitResult) -> float:
    """Speed, rad/s, up to which a shaft that is not round is looked at: past its resonance and the tests."""
    critical = float(np.abs(eigenvalues(fit.model, fit.theta(), 0.0)).max())
    return 1.15 * max(1.5 * critical, *(float(np.max(e.speed)) for e in fit.experiments))


def lines_cut_off(fit: FitResult) -> tuple[float, float]:
    """Greatest change of the fitted lines by those left out, over the greatest reading, and over its noise."""
    size = share = 0.0
    for block in fit.problem.blocks:
        change = block.cut_off(fit.thetas)
        size = max(size, float(change.max() / np.abs(block.measured).max()))
        share = max(share, float((change / block.sigma).max()))
    return size, share
