"""Priors: densities of single entries, and the log density of many vectors at once."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from rotorfit.base.array_types import Float
from rotorfit.estimators.misfit.parameter_space import ParameterSpace

_SCIPY = "scipy.stats._continuous_distns"
"""Where SciPy's own distributions are; a user's may hold more than their arguments."""


@dataclass(frozen=True)
class CentredNormal:
    """The normal distribution about zero, with what is asked of SciPy's, whose import takes longer than a fit."""

    sd: float

    def mean(self) -> float:
        """Zero."""
        return 0.0

    def std(self) -> float:
        """Standard deviation."""
        return self.sd

    def var(self) -> float:
        """Variance."""
        return self.sd**2

    def support(self) -> tuple[float, float]:
        """Everything."""
        return -np.inf, np.inf

    def rvs(self, *, size: int, random_state: np.random.Generator) -> Float:
        """Draws."""
        return self.sd * random_state.standard_normal(size)


@lru_cache(maxsize=256)
def _moments(distribution: Any) -> tuple[float, float]:
    """Mean and standard deviation; SciPy's checks cost far more than the arithmetic."""
    return float(distribution.mean()), float(distribution.std())


def _is_normal(distribution: Any) -> bool:
    """True if it is SciPy's own normal one, or that about zero, which take little arithmetic."""
    if isinstance(distribution, CentredNormal):
        return True
    return type(distribution.dist).__module__ == _SCIPY and distribution.dist.name == "norm"


def normal_moments(distribution: Any) -> tuple[float, float] | None:
    """Mean and standard deviation of a normal distribution, None for others."""
    return _moments(distribution) if _is_normal(distribution) else None


@dataclass(frozen=True, eq=False)
class Prior:
    """Logarithm of a prior density of one entry and its two derivatives."""

    entry: int  # number of the entry in the fitted vector
    distribution: Any  # a frozen scipy.stats distribution, or a :class:`CentredNormal`

    def terms(self, value: Float | float) -> tuple[Float, Float, Float]:
        """Minus log of the density over its largest, at values, its slope and its curvature (none below zero)."""
        mean, sd = _moments(self.distribution)
        if _is_normal(self.distribution):
            pull = (np.asarray(value) - mean) / sd
            return 0.5 * pull**2, pull / sd, np.full_like(pull, 1.0 / sd**2)
        step = 1e-4 * sd
        # One call: SciPy's checks cost far more than the arithmetic.
        low, here, high = -self.distribution.logpdf(np.add.outer([-step, 0.0, step], value))
        rise = np.where(np.isfinite(here), np.maximum(here - self._least, 0.0), np.inf)
        with np.errstate(invalid="ignore"):
            slope, curvature = (high - low) / (2 * step), np.maximum((high - 2 * here + low) / step**2, 0.0)
        inside = np.isfinite([low, here, high]).all(axis=0)
        return rise, np.where(inside, slope, 0.0), np.where(inside, curvature, 0.0)

    @cached_property
    def _least(self) -> float:
        """Minus log density where it is largest: a cost is never negative, however narrow a prior is."""
        from scipy.optimize import minimize_scalar

        at = self.distribution.ppf(np.linspace(0.0, 1.0, 201))
        with np.errstate(all="ignore"):  # at the ends of the support a density may be zero or infinite
            height = -self.distribution.logpdf(at)
        at, height = at[np.isfinite(at + height)], height[np.isfinite(at + height)]
        best = int(np.argmin(height))
        ends = float(at[max(best - 1, 0)]), float(at[min(best + 1, at.size - 1)])
        found = minimize_scalar(
            lambda v: -self.distribution.logpdf(v), bounds=ends, options={"xatol": 1e-10 * (ends[1] - ends[0])}
        )
        return float(min(height[best], found.fun))


def within_support(space: ParameterSpace, priors: Sequence[Prior]) -> ParameterSpace:
    """The space with its bounds narrowed to where the priors are not zero."""
    if not priors:
        return space
    lower, upper = space.lower.copy(), space.upper.copy()
    for prior in priors:
        low, high = prior.distribution.support()
        lower[prior.entry] = max(lower[prior.entry], float(low))
        upper[prior.entry] = min(upper[prior.entry], float(high))
    return replace(space, lower=lower, upper=upper)


def log_priors(priors: Sequence[Prior]) -> Callable[[Float], Float]:
    """Sum of the log densities of priors, shape ``(W,)``, of vectors ``(W, p)``. SciPy's checks cost a hundred times
    the arithmetic of a few vectors, so priors of one family, whose shapes, places and scales are just numbers, are
    evaluated in one call."""
    families: dict[Any, list[Prior]] = {}
    for number, prior in enumerate(priors):
        frozen = prior.distribution
        key: tuple[Any, ...] = (number,)
        if _is_normal(frozen):
            key = ("norm",)
        elif type(frozen.dist).__module__ == _SCIPY:
            key = (type(frozen.dist), len(frozen.args), *sorted(frozen.kwds))
        families.setdefault(key, []).append(prior)
    parts = [([m.entry for m in own], _log_density([m.distribution for m in own])) for own in families.values()]

    def total(x: Float) -> Float:
        return sum((density(x[:, entries]).sum(axis=1) for entries, density in parts), np.zeros(len(x)))

    return total


def _log_density(members: Sequence[Any]) -> Callable[[Float], Float]:
    """Log density of each of several frozen distributions of a family, their values side by side."""
    first = members[0]
    if all(_is_normal(m) for m in members):
        mean, sd = np.array([_moments(m) for m in members]).T
        peak = -np.log(sd * np.sqrt(2 * np.pi))
        return lambda values: np.asarray(peak - 0.5 * ((values - mean) / sd) ** 2)
    if len(members) == 1:
        return lambda values: np.asarray(first.logpdf(values))
    arguments = np.array([m.args for m in members], dtype=float).T
    named = {key: np.array([m.kwds[key] for m in members], dtype=float) for key in first.kwds}
    return lambda values: np.asarray(first.dist.logpdf(values, *arguments, **named))
