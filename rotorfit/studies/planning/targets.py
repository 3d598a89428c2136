"""Quantities that a test is to determine: parameters, the threshold speed, functions of parameters."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, TypeAlias

import numpy as np

from rotorfit.base.array_types import Float
from rotorfit.base.names import unknown_name
from rotorfit.estimators.misfit.parameter_space import ParameterSpace
from rotorfit.identify.fitting.causes.slopes import onset_slopes, value_slopes
from rotorfit.identify.fitting.causes.solution import SolvedCauses
from rotorfit.identify.fitting.derived import value_and_gradient
from rotorfit.identify.fitting.quantities import THRESHOLD
from rotorfit.models import Threshold, threshold_speed

Wanted: TypeAlias = str | Callable[[Any], Any] | Sequence[str] | Mapping[str, Callable[[Any], Any]] | None
"""Names, a function of the parameters, or functions by name."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Target:
    """One quantity: its value and its derivatives by the fitted vector, shape ``(p,)``, at fitted vectors."""

    unit: str
    at: Callable[[Float], tuple[float, Float]]
    # derivatives by the sizes of causes that act on it itself, shape ``(k,)``; nothing for what causes move by values
    beside: Callable[[Float, SolvedCauses], Float] | None = None

    def by_causes(self, x: Float, solved: SolvedCauses) -> Float:
        """Derivatives by the sizes of causes, the fitted values held, shape ``(k,)``."""
        return np.zeros(len(solved.causes)) if self.beside is None else self.beside(x, solved)


def all_targets(space: ParameterSpace, quantity: Wanted, band: float) -> tuple[dict[str, Target], tuple[str, ...]]:
    """Parameters, threshold speeds and what else is asked for, by name, and the names of what is asked for."""
    found = {name: _parameter(space, i) for i, name in enumerate(space.names)}
    if space.model.speed_dependent:
        labels = space.labels
        for group, label in enumerate(labels):
            name = THRESHOLD if len(labels) == 1 else f"{THRESHOLD}[{', '.join(label)}]"
            found[name] = _threshold(space, group, band)
    if quantity is None:
        return found, ()
    if callable(quantity):
        quantity = {"quantity": quantity}
    if isinstance(quantity, Mapping):
        for name, function in quantity.items():
            if not callable(function):
                raise TypeError(f"quantity {name} is {function!r}; a function of the parameters is needed")
            found[name] = _function(space, name, function)
        return found, tuple(quantity)
    asked: list[str] = []
    for name in (quantity,) if isinstance(quantity, str) else tuple(quantity):
        named = [one for one in found if name in (one, one.partition("[")[0])]
        if not named:
            if name in space.model.parameter_names:
                raise ValueError(f"quantity {name} is known here: a test need not determine it")
            raise KeyError(unknown_name("quantity", name, found))
        asked += named
    return found, tuple(asked)


def _parameter(space: ParameterSpace, entry: int) -> Target:
    unit = space.model.parameter(space.base[entry]).unit
    return Target(unit=unit, at=lambda x: (float(x[entry]), np.eye(space.size)[entry]))


def _threshold(space: ParameterSpace, group: int, band: float) -> Target:
    @cache
    def onset(x: tuple[float, ...]) -> Threshold | None:
        return threshold_speed(space.model, space.theta(np.array(x))[group], band=band)

    def at(x: Float) -> tuple[float, Float]:
        found = onset(tuple(x.tolist()))
        if found is None:
            return math.nan, np.zeros(space.size)
        return found.speed, space.pull_back(found.gradient, group)

    def beside(x: Float, solved: SolvedCauses) -> Float:
        found = onset(tuple(x.tolist()))
        if found is None:
            return np.zeros(len(solved.causes))
        return onset_slopes(space.model, space.theta(x)[group], found, solved)

    return Target(unit="rad/s", at=at, beside=beside)


def _function(space: ParameterSpace, name: str, function: Callable[[Any], Any]) -> Target:
    evaluate = value_and_gradient(space.model, function)

    def at(x: Float) -> tuple[float, Float]:
        if len(space.index) > 1:
            raise ValueError(f"quantity {name}: parameters differ between tests; name one parameter of a group instead")
        value, gradient = evaluate(space.theta(x)[0])
        return value, space.pull_back(gradient, 0)

    def beside(x: Float, solved: SolvedCauses) -> Float:
        theta = space.theta(x)[0]
        return value_slopes(space.model, theta, evaluate(theta)[1], None, solved)

    return Target(unit="", at=at, beside=beside)
