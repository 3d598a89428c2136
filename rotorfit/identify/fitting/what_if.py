"""A fitted rotor with some of its values changed: all that follows from a fit follows from it, errors included."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from rotorfit.base.array_types import Float
from rotorfit.base.digits import significant
from rotorfit.base.names import unknown_name
from rotorfit.identify.fitting.propagation import slopes_of
from rotorfit.identify.fitting.quantities import FittedParameter, Number
from rotorfit.models.parameters import bare_name

if TYPE_CHECKING:
    from rotorfit.identify.fitting.result import FitResult
    from rotorfit.identify.fitting.settings import FitSettings


def what_if(fit: FitResult, values: Mapping[str, float | Number]) -> FitResult:
    """See :meth:`rotorfit.FitResult.what_if`."""
    if not fit.success:
        raise ValueError(f"the fit did not converge, nothing follows from its rotor: {fit.message}")
    if not values:
        raise ValueError("nothing is changed; give parameters by name, lam=0.3")
    names = fit.problem.space.names
    for name in values:
        if name not in fit.params and name not in fit.model.parameter_names:
            raise KeyError(unknown_name("parameter", name, fit.params))
    changed = {
        p: values[p] if p in values else values[bare_name(p)] for p in fit.params if {p, bare_name(p)} & {*values}
    }
    x, template = fit.x.copy(), fit.problem.space.template.copy()
    turned, by_causes = (
        np.eye(x.size),
        np.zeros((x.size, len(fit.settings.solved.causes) if fit.settings.solved else 0)),
    )
    for name, value in changed.items():
        if name in names:
            at = names.index(name)
            x[at] = _value(value)
            turned[at], by_causes[at] = _slopes(fit, value)
        else:
            template[:, fit.model.parameter_names.index(name)] = _value(value)
    settings = _settings(fit, x, turned, by_causes)
    covar = _covariance(fit, turned, settings)
    words = ", ".join(f"{name} = {significant(_value(value), 6)}" for name, value in values.items())
    found = replace(
        fit,
        x=x,
        covar=covar,
        params={name: _parameter(p, changed.get(name)) for name, p in fit.params.items()},
        settings=settings,
        problem=replace(fit.problem, space=replace(fit.problem.space, template=template)),
        noise=fit.noise and replace(fit.noise, shares=tuple(turned @ share @ turned.T for share in fit.noise.shares)),
        model_uncertainty=_of_parameters(fit.model_uncertainty, turned),
        message=f"what if {words}",
        notices=(),
    )
    vars(found)["findings"] = ()  # nothing was measured on this rotor
    return found


def _value(value: float | Number) -> float:
    return value.value if isinstance(value, Number) else float(value)


def _slopes(fit: FitResult, value: float | Number) -> tuple[Float, Float] | tuple[float, float]:
    """Derivatives of a value by the fitted vector and by the sizes of causes: a plain one is known."""
    if not isinstance(value, Number):
        return 0.0, 0.0
    own = value._quantity
    if own.source is not fit:
        raise ValueError(f"{value} is of another fit; give numbers made of this fit's parameters, or plain ones")
    return slopes_of(fit, own.slopes)


def _settings(fit: FitResult, x: Float, turned: Float, by_causes: Float) -> FitSettings:
    """The settings with causes that move the changed values as these depend on what they are made of."""
    solved = fit.settings.solved
    if solved is not None:
        errors = replace(solved.errors, moves=turned @ solved.errors.moves + by_causes)
        solved = replace(solved, errors=errors, plain=solved.plain + (x - fit.x))
    return replace(fit.settings, solved=solved, onsets=())


def _covariance(fit: FitResult, turned: Float, settings: FitSettings) -> Float:
    """That of the changed vector, by the noise and by the causes."""
    if fit.settings.solved is None or settings.solved is None:
        return np.asarray(turned @ fit.covar @ turned.T)
    by_noise = fit.covar - fit.settings.solved.errors.covariance
    return np.asarray(turned @ by_noise @ turned.T + settings.solved.errors.covariance)


def _of_parameters(uncertainty: Float | None, turned: Float) -> Float | None:
    if uncertainty is None:
        return None
    own = turned[: len(uncertainty), : len(uncertainty)]
    return np.asarray(own @ uncertainty @ own.T)


def _parameter(p: FittedParameter, value: float | Number | None) -> FittedParameter:
    if value is None:
        return p
    own = value._quantity if isinstance(value, Number) else None
    if own is None or not p.vary:
        return replace(p, value=_value(value), plain=_value(value), stderr=0.0, vary=False, resolved=True)
    return replace(p, value=own.value, plain=own.value, stderr=own.stderr, freedom=own.freedom)
