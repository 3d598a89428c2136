"""Coefficients of a model's fluid against eccentricity, with their derivatives by the parameters."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from types import SimpleNamespace
from typing import NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from rotorfit.models.array_types import Float
from rotorfit.models.compiled import array_function
from rotorfit.models.laws import Law
from rotorfit.models.model import RotorModel


class LawCurve(NamedTuple):
    """A coefficient of the fluid against eccentricity: values ``(E,)``, derivatives by parameters ``(E, P)``."""

    name: str  # ``K0``, ``D``, ``lam``, or ``lam_D`` and ``lam_M``
    unit: str  # SI unit
    value: Float  # at each eccentricity, shape ``(E,)``
    slope: Float  # its derivatives by the model's parameters, shape ``(E, P)``


def law_of(model: RotorModel) -> Law:
    """The law of eccentricity of a model."""
    law = getattr(model, "law", None)
    if not isinstance(law, Law) or not law.parameters:
        raise ValueError(f"{model.name} as used here does not change with eccentricity; give it a law")
    return law


def law_changes_with_speed(model: RotorModel) -> bool:
    """True if the law of a model gives other values at another speed."""
    p, eccentricity, speed = _symbols(model)
    return any(ca.depends_on(ca.SX(part), speed) for part in law_of(model).at_speed(p, eccentricity, speed))


def law_curves(
    model: RotorModel, theta: ArrayLike, eccentricity: ArrayLike, speed: float | None = None
) -> tuple[LawCurve, ...]:
    """K0, D and lam (or lam_D and lam_M) at eccentricities ``(E,)``, at a speed or the law's reference speed."""
    law_of(model)
    vector, eps = np.asarray(theta, dtype=float), np.asarray(eccentricity, dtype=float)
    names, kernel = _compiled(model, at_speed=speed is not None)
    at = np.full(eps.size, speed if speed is not None else 0.0)
    inputs = [*(np.full(eps.size, value) for value in vector), eps, at]
    flat = kernel(inputs).reshape(vector.size + 1, len(names), eps.size)
    return tuple(LawCurve(name, model.parameter(name).unit, flat[0, i], flat[1:, i].T) for i, name in enumerate(names))


def _symbols(model: RotorModel) -> tuple[SimpleNamespace, ca.SX, ca.SX]:
    """Parameters by name, eccentricity and speed."""
    p = SimpleNamespace(**{name: ca.SX.sym(name) for name in model.parameter_names})
    return p, ca.SX.sym("eccentricity"), ca.SX.sym("speed")


@lru_cache(maxsize=64)
def _compiled(model: RotorModel, *, at_speed: bool) -> tuple[list[str], Callable[[Sequence[Float]], Float]]:
    p, eccentricity, speed = _symbols(model)
    law = law_of(model)
    fluid = law.at_speed(p, eccentricity, speed) if at_speed else law.at(p, eccentricity)
    ratios = [name for name in ("lam", "lam_D", "lam_M") if name in model.parameter_names]
    names = ["K0", "D", *ratios]
    theta = ca.vertcat(*vars(p).values())
    curves = ca.vertcat(fluid.K0, fluid.D, *[getattr(p, name) * fluid.ratio for name in ratios])
    graph = ca.densify(ca.horzcat(curves, ca.jacobian(curves, theta)))
    return names, array_function(ca.Function("law_curves", [ca.vertcat(theta, eccentricity, speed)], [ca.vec(graph)]))
