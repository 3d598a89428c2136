"""Values of a rotor before its test: guesses, ranges, distributions, or what an earlier fit or posterior gave."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from numbers import Real
from typing import Any, TypeAlias

import numpy as np

from rotorfit.base.array_types import Float
from rotorfit.base.names import unknown_name
from rotorfit.estimators.inference.covariance import spreading
from rotorfit.estimators.misfit.parameter_space import ParameterSpace
from rotorfit.identify.fitting.result import FitResult
from rotorfit.identify.uncertainty.posterior import Posterior
from rotorfit.models.parameters import bare_name

Values: TypeAlias = Mapping[str, Any] | FitResult | Posterior
"""By parameter name a number, a range ``(low, high)`` or a frozen scipy.stats distribution; or an earlier result."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Guess:
    """Fitted vectors that a rotor may have."""

    centre: Float  # the likeliest, shape ``(p,)``
    draws: Float  # over what is not known, shape ``(D, p)``: one, the centre, where all is given by numbers


def guess(space: ParameterSpace, values: Values, count: int, seed: int) -> Guess:
    """Vectors of a parameter space, nuisance entries zero."""
    if isinstance(values, Posterior):
        samples = values.samples
        chosen = np.linspace(0, len(samples) - 1, count).astype(np.intp)
        return _by_name(space, values.fit, values.names, np.median(samples, axis=0), samples[chosen])
    if isinstance(values, FitResult):
        from scipy.special import ndtri  # late: loading it takes longer than a plan

        normal = ndtri(_spread_levels(values.x.size, count, seed)).T
        samples = values.x + normal @ spreading(np.nan_to_num(values.covar)).T
        return _by_name(space, values, values.var_names, values.x, samples)
    if not isinstance(values, Mapping):
        raise TypeError(f"values are a mapping, a FitResult or a Posterior, not {type(values).__name__}")
    known = {*space.names, *space.base, *space.model.parameter_names}
    for name in values:
        if name not in known:
            raise KeyError(unknown_name(f"parameter of {space.model.name}", name, space.model.parameter_names))
    entries = [_entry(space, values, name, base) for name, base in zip(space.names, space.base, strict=True)]
    centre = np.zeros(space.size)
    centre[: len(entries)] = [_quantiles(entry, np.array([0.5]))[0] for entry in entries]
    if all(isinstance(entry, float) for entry in entries):
        return Guess(centre=centre, draws=centre[None])
    levels = _spread_levels(len(entries), count, seed)
    draws = np.zeros((count, space.size))
    draws[:, : len(entries)] = np.stack([_quantiles(e, u) for e, u in zip(entries, levels, strict=True)], axis=1)
    return Guess(centre=centre, draws=np.clip(draws, space.lower, space.upper))


def _spread_levels(size: int, count: int, seed: int) -> Float:
    """Probabilities of a Latin hypercube, shape ``(size, count)``."""
    rng = np.random.default_rng(seed)
    cells = rng.permuted(np.tile(np.arange(count), (size, 1)), axis=1)
    return np.asarray((cells + rng.random((size, count))) / count)


def _entry(space: ParameterSpace, values: Mapping[str, Any], name: str, base: str) -> Any:
    """The guess of one parameter: a number, a pair or a distribution, checked."""
    given = values.get(name, values.get(base))
    parameter = space.model.parameter(base)
    if given is None:
        raise ValueError(
            f"no value for {name} ({parameter.meaning}, {parameter.unit}): give a guess, a range (low, high), a "
            "distribution, or known="
        )
    if hasattr(given, "ppf"):
        return given
    pair = isinstance(given, tuple | list)
    ends = list(given) if pair else [given]
    if not all(isinstance(end, Real) and np.isfinite(float(end)) for end in ends) or len(ends) > 2:
        raise ValueError(f"the value of {name} is {given!r}; a number, a range (low, high) or a distribution is needed")
    if not all(parameter.lower <= end <= parameter.upper for end in ends):
        raise ValueError(
            f"the value of {name}, {given!r}, is outside the physical limits "
            f"[{parameter.lower:g}, {parameter.upper:g}] {parameter.unit}"
        )
    if pair and not (len(ends) == 2 and ends[0] < ends[1]):
        raise ValueError(f"the range of {name} is {given!r}; it is (low, high) with low below high")
    return (float(ends[0]), float(ends[1])) if pair else float(given)


def _quantiles(entry: Any, level: Float) -> Float:
    if isinstance(entry, float):
        return np.full(level.shape, entry)
    if isinstance(entry, tuple):
        return np.asarray(entry[0] + (entry[1] - entry[0]) * level)
    return np.asarray(entry.ppf(level), dtype=float)


def _by_name(space: ParameterSpace, fit: FitResult, names: tuple[str, ...], middle: Float, samples: Float) -> Guess:
    """Columns of samples for the entries of a space, known values where nothing was sampled."""
    centre, draws = np.zeros(space.size), np.zeros((len(samples), space.size))
    for i, name in enumerate(space.names):
        source = next((one for one in (name, bare_name(name)) if one in fit.params), None)
        if source is None:
            raise ValueError(
                f"the earlier fit of {fit.model.name} has no {name}: give its value in a mapping, for instance "
                "{name: p.value for name, p in fit.params.items()} and more"
            )
        if source in names:
            centre[i], draws[:, i] = middle[names.index(source)], samples[:, names.index(source)]
        else:
            centre[i] = draws[:, i] = fit.params[source].value
    return Guess(centre=np.clip(centre, space.lower, space.upper), draws=np.clip(draws, space.lower, space.upper))
