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
    """A coefficient of the fluid against eccentricity: values ``(E,)``, derivatives by parameters ``(E, P)``.

    Attributes:
        name: ``K0``, ``D``, ``lam``, or ``lam_D`` and ``lam_M``.
        unit: SI unit.
        value: at each eccentricity, shape ``(E,)``.
        slope: its derivatives by the model's parameters, shape ``(E, P)``.
    """

    name: str
    unit: str
    value: Float
    slope: Float


def law_of(model: RotorModel) -> Law:
    """The law of eccentricity of a model.

    Args:
        model: the rotor.

    Raises:
        ValueError: it has none, or its fluid is linear.
    """
    law = getattr(model, "law", None)
    if not isinstance(law, Law) or not law.parameters:
        raise ValueError(f"{model.name} as used here does not change with eccentricity; give it a law")
    return law


def law_curves(model: RotorModel, theta: ArrayLike, eccentricity: ArrayLike) -> tuple[LawCurve, ...]:
    """K0, D and lam (or lam_D and lam_M) of the fluid at eccentricities.

    Args:
        model: a model with a law.
        theta: parameter vector, shape ``(P,)``.
        eccentricity: shape ``(E,)``.

    Raises:
        ValueError: the model has no law.
    """
    law_of(model)
    vector, eps = np.asarray(theta, dtype=float), np.asarray(eccentricity, dtype=float)
    names, kernel = _compiled(model)
    flat = kernel([*(np.full(eps.size, value) for value in vector), eps]).reshape(vector.size + 1, len(names), eps.size)
    return tuple(LawCurve(name, model.parameter(name).unit, flat[0, i], flat[1:, i].T) for i, name in enumerate(names))


@lru_cache(maxsize=64)
def _compiled(model: RotorModel) -> tuple[list[str], Callable[[Sequence[Float]], Float]]:
    theta, eccentricity = ca.SX.sym("theta", len(model.parameters)), ca.SX.sym("eccentricity")
    p = SimpleNamespace(**{name: theta[i] for i, name in enumerate(model.parameter_names)})
    fluid = law_of(model).at(p, eccentricity)
    ratios = [name for name in ("lam", "lam_D", "lam_M") if name in model.parameter_names]
    names = ["K0", "D", *ratios]
    curves = ca.vertcat(fluid.K0, fluid.D, *[getattr(p, name) * fluid.ratio for name in ratios])
    graph = ca.densify(ca.horzcat(curves, ca.jacobian(curves, theta)))
    return names, array_function(ca.Function("law_curves", [ca.vertcat(theta, eccentricity)], [ca.vec(graph)]))
