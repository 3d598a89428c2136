"""Quantities made of the parameters of a fit: exact derivatives by CasADi, errors by the fit's covariance."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping
from typing import Any

import casadi as ca
import numpy as np

from rotorfit.base.array_types import Float
from rotorfit.base.names import unknown_name
from rotorfit.identify.fitting.quantities import Quantity
from rotorfit.identify.fitting.result import FitResult
from rotorfit.models import RotorModel


class _Symbols:
    """The parameters of a model as attributes."""

    def __init__(self, symbols: Mapping[str, ca.SX]) -> None:
        self._symbols = symbols

    def __getattr__(self, name: str) -> ca.SX:
        if name not in self._symbols:
            raise AttributeError(unknown_name("parameter", name, self._symbols))
        return self._symbols[name]


def derive(fit: FitResult, quantity: Callable[[Any], Any], unit: str, at: Mapping[str, Any] | None) -> Quantity:
    """See :meth:`FitResult.derive`."""
    value, gradient = value_and_gradient(fit.model, quantity)(fit.theta(at))
    space, group = fit.problem.space, fit.group(at)
    slopes = dict(zip(fit.var_names, space.pull_back(gradient, group).tolist(), strict=True))
    names, index = fit.model.parameter_names, space.index[group]
    known = {name: slope for name, slope, i in zip(names, gradient.tolist(), index.tolist(), strict=True) if i < 0}
    return fit.quantity(value, slopes | known, unit)


def value_and_gradient(model: RotorModel, quantity: Callable[[Any], Any]) -> Callable[[Float], tuple[float, Float]]:
    """The value of a quantity and its derivatives at parameter vectors, shape ``(P,)``."""
    if not callable(quantity):
        raise TypeError(f"the quantity is {quantity!r}; a function of the parameters is needed: lambda p: p.K0 / p.D")
    symbols = [ca.SX.sym(name) for name in model.parameter_names]
    with warnings.catch_warnings():  # NumPy's functions of symbols stay symbols, whatever CasADi says of later versions
        warnings.filterwarnings("ignore", message=r"\s*casadi: a numpy function", category=FutureWarning)
        made = quantity(_Symbols(dict(zip(model.parameter_names, symbols, strict=True))))
    try:
        expression = ca.SX(made)
    except NotImplementedError:
        raise ValueError(f"the quantity is {made!r}; one number made of parameters is needed") from None
    if expression.shape != (1, 1):
        raise ValueError(f"the quantity has shape {expression.shape}; one number is needed, derive each by itself")
    vector = ca.vertcat(*symbols)
    function = ca.Function("quantity", [vector], [expression, ca.gradient(expression, vector)])

    def at(theta: Float) -> tuple[float, Float]:
        value, gradient = (np.asarray(part, dtype=float).reshape(-1) for part in function(theta))
        if not (math.isfinite(value[0]) and np.isfinite(gradient).all()):
            raise ValueError(f"the quantity is {value[0]} at these values, or has no derivative there")
        return float(value[0]), gradient

    return at
