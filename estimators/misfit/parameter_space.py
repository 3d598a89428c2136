"""The fitted vector: which parameters are free, which of them have one value a group, and their bounds."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from numbers import Real
from typing import Any

import numpy as np

from rotorfit.base.array_types import Bool, Float, Index
from rotorfit.models import RotorModel
from rotorfit.models.parameters import bare_name

LARGEST = 1e30
"""Size up to which a number is one of a rotor, in any unit: determinants of ten planes remain finite. Chosen."""

DATUM = "datum"
"""Nuisance entry of the common datum angle: by how much responses lead forces beyond what the rotor does."""


@dataclass(frozen=True, eq=False, kw_only=True)
class ParameterSpace:
    """The fitted vector: free parameters, some of them one value a group, then nuisance parameters."""

    model: RotorModel  # the rotor
    names: tuple[str, ...]  # names of the free entries, ``D[speed_rpm=1000]`` for one value of several
    base: tuple[str, ...]  # names without the group suffix, the model's own
    template: Float  # parameter vectors of the groups with known values in place, shape ``(G, P)``
    index: Index  # entry of the fitted vector that feeds each place of the template, -1 where known, shape ``(G, P)``
    lower: Float  # lower bounds, shape ``(p,)``
    upper: Float  # upper bounds, shape ``(p,)``
    nuisance: tuple[str, ...] = ()  # names of nuisance entries, which follow the parameters

    @property
    def size(self) -> int:
        """Length of the fitted vector."""
        return len(self.names) + len(self.nuisance)

    @cached_property
    def typical(self) -> Float:
        """Sizes that the free entries have where data give none, the model's own, shape ``(len(names),)``."""
        return np.array([self.model.parameter(name).scale for name in self.base])

    def theta(self, x: Float) -> Float:
        """Parameter vectors of the groups, shape ``(..., G, P)``, of fitted vectors of shape ``(..., p)``."""
        free, entries = self._free
        theta = np.empty((*x.shape[:-1], *self.template.shape))
        theta[:] = self.template
        theta[..., free] = x[..., entries]
        return theta

    @cached_property
    def _free(self) -> tuple[Bool, Index]:
        """Places of the template that are fitted, and the entry that feeds each."""
        free = self.index >= 0
        return free, self.index[free]

    @cached_property
    def fitted(self) -> list[tuple[Index, Index]]:
        """Places of each group's parameter vector that are fitted, and the entries that feed them."""
        places = [np.flatnonzero(index >= 0) for index in self.index]
        return [(some, index[some]) for some, index in zip(places, self.index, strict=True)]

    def pull_back(self, gradient: Float, group: int) -> Float:
        """Derivatives by the fitted vector, shape ``(..., p)``, of what depends on a group's parameters."""
        index = self.index[group]
        free = index >= 0
        slope = np.zeros((*gradient.shape[:-1], self.size), dtype=gradient.dtype)
        np.add.at(slope.T, index[free], gradient[..., free].T)
        return slope

    def holding(self, values: Mapping[int, float]) -> ParameterSpace:
        """The space with entries, by their numbers, held at values: no longer fitted."""
        kept = [i for i in range(self.size) if i not in values]
        number, held = np.full(self.size + 1, -1), np.zeros(self.size)
        number[kept] = np.arange(len(kept))  # the last one answers to -1, what was known before
        held[list(values)] = list(values.values())
        return replace(
            self,
            names=tuple(self.names[i] for i in kept if i < len(self.names)),
            base=tuple(self.base[i] for i in kept if i < len(self.base)),
            template=np.where(np.isin(self.index, list(values)), held[self.index], self.template),
            index=number[self.index],
            lower=self.lower[kept],
            upper=self.upper[kept],
        )

    @property
    def labels(self) -> tuple[tuple[str, ...], ...]:
        """Name of each group: ``attribute=value`` of each ``per`` parameter, none for a single group."""
        named = ([self.names[i].partition("[") for i in row.tolist() if i >= 0] for row in self.index)
        return tuple(tuple(dict.fromkeys(rest[:-1] for _, bracket, rest in names if bracket)) for names in named)

    def group(self, at: Mapping[str, Any] | None = None) -> int:
        """Number of the parameter group with given attribute values, ``{"speed_rpm": 1000}``."""
        if self.index.shape[0] == 1:
            return 0
        matches = [
            g
            for g, suffix in enumerate(self.labels)
            if at and all(any(_is_value(label, name, value) for label in suffix) for name, value in at.items())
        ]
        if len(matches) != 1:
            raise ValueError(
                "parameters differ between tests: say which (at=, --at NAME=VALUE); there are "
                + "; ".join(", ".join(sorted(s)) for s in self.labels)
            )
        return matches[0]


def _is_value(label: str, name: str, value: Any) -> bool:
    """True if a suffix ``name=value`` is that of a value, numbers to six digits: speeds in rpm are seldom round."""
    attribute, _, text = label.partition("=")
    if attribute != name or not isinstance(value, Real):
        return label == f"{name}={value}"
    try:
        return math.isclose(float(text), float(value), rel_tol=1e-6)
    except ValueError:
        return False


def parameter_space(
    model: RotorModel,
    *,
    known: Mapping[str, float | None],
    bounds: Mapping[str, tuple[float, float]],
    groups: Sequence[Mapping[str, str]],
    nuisance: Sequence[str] = (),
) -> ParameterSpace:
    """Lay out the fitted vector."""
    for name in [*known, *bounds, *groups[0]]:
        model.parameter(bare_name(name))
    fixed = {q.name: q.default for q in model.parameters if q.default is not None} | dict(known)
    fixed = {name: value for name, value in fixed.items() if value is not None}
    _check_known(model, fixed, bounds, groups[0])
    base: dict[str, str] = {}  # the model's own name of each entry
    place_of: dict[str, int] = {}
    template = np.zeros((len(groups), len(model.parameters)))
    index = np.full(template.shape, -1, dtype=np.intp)
    for place, parameter in enumerate(model.parameters):
        for g, suffixes in enumerate(groups):
            suffix = suffixes.get(parameter.name)
            name = parameter.name if suffix is None else f"{parameter.name}[{suffix}]"
            value = fixed.get(name, fixed.get(parameter.name))
            if value is not None:
                template[g, place] = value
                continue
            base[name] = parameter.name
            index[g, place] = place_of.setdefault(name, len(place_of))
    if not base:
        raise ValueError("every parameter is known: nothing is left to fit")
    limits = np.array([_limits(model, name, bounds) for name in base])
    free = np.full(len(nuisance), np.inf)
    return ParameterSpace(
        model=model,
        names=tuple(base),
        base=tuple(base.values()),
        template=template,
        index=index,
        lower=np.concatenate([limits[:, 0], -free]),
        upper=np.concatenate([limits[:, 1], free]),
        nuisance=tuple(nuisance),
    )


def _check_known(
    model: RotorModel, fixed: Mapping[str, Any], bounds: Mapping[str, tuple[float, float]], per: Mapping[str, str]
) -> None:
    for name, given in fixed.items():
        parameter = model.parameter(bare_name(name))
        if not (isinstance(given, Real) and abs(value := float(given)) <= LARGEST):
            raise ValueError(f"known {name} = {given!r} is not a finite number of at most {LARGEST:g}")
        unit = f" {parameter.unit}" if parameter.unit != "1" else ""
        if not parameter.lower <= value <= parameter.upper:
            raise ValueError(
                f"known {name} = {value:g}{unit} is outside the physical limits "
                f"[{parameter.lower:g}, {parameter.upper:g}]"
            )
        low, high = _limits(model, name, bounds)
        if not low <= value <= high:
            raise ValueError(f"known {name} = {value:g}{unit} is outside its bounds [{low:g}, {high:g}]; change either")
        if name in per:
            raise ValueError(f"{name} is both known and fitted per attribute: choose one")


def _limits(model: RotorModel, name: str, bounds: Mapping[str, tuple[float, float]]) -> tuple[float, float]:
    parameter = model.parameter(bare_name(name))
    if name not in bounds and parameter.name not in bounds:
        return parameter.lower, parameter.upper
    pair = bounds[name] if name in bounds else bounds[parameter.name]
    if np.shape(pair) != (2,) or not all(isinstance(value, Real) for value in pair):
        raise ValueError(f"bounds of {name} must be two numbers, lower and upper (inf or None for none), got {pair!r}")
    low, high = pair
    low, high = max(float(low), parameter.lower), min(float(high), parameter.upper)
    if not low < high:
        raise ValueError(
            f"bounds of {name} are contradictory: lower {low:g} is not below upper {high:g} "
            f"(physical limits [{parameter.lower:g}, {parameter.upper:g}])"
        )
    return low, high
