"""Parameters of a result, fitted and known, in the model's order."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rotorfit.estimators.misfit.parameter_space import DATUM, ParameterSpace
from rotorfit.fitting.assumptions.calibration import NUISANCE_KINDS
from rotorfit.fitting.noise.record import is_run_effect
from rotorfit.fitting.quantities import FittedParameter
from rotorfit.models.array_types import Float
from rotorfit.models.parameters import Parameter, bare_name

_MEANING = {
    "phase": ("rad", "offset of the phase reference"),
    DATUM: ("rad", "common datum angle: lead of responses over forces"),
    **NUISANCE_KINDS,
}


def parameter_table(
    space: ParameterSpace,
    x: Float,
    begin: Float,
    scattered: Float,
    covar: Float,
    degrees: Sequence[float],
    unresolved: Sequence[str],
) -> dict[str, FittedParameter]:
    """Parameters by name."""
    # With priors or tight noise a variance may come out as -0.
    error, wide = (np.sqrt(np.maximum(np.diag(matrix), 0.0)).tolist() for matrix in (scattered, covar))
    values, lower, upper = x.tolist(), space.lower.tolist(), space.upper.tolist()
    first = [*begin.tolist(), *[0.0] * (space.size - begin.size)]
    entries: dict[str, FittedParameter] = {}
    for i, name in enumerate((*space.names, *space.nuisance)):
        if is_run_effect(name):
            continue
        unit, meaning = _described(space, i, name)
        resolved = name not in unresolved
        entries[name] = FittedParameter(
            name=name,
            value=values[i],
            stderr=wide[i] if resolved else float("inf"),
            stderr_noise=error[i] if resolved else float("inf"),
            init_value=first[i],
            unit=unit,
            meaning=meaning,
            min=lower[i],
            max=upper[i],
            vary=True,
            resolved=resolved,
            at_bound=min(values[i] - lower[i], upper[i] - values[i]) <= 1e-7 * max(abs(values[i]), 1e-12),
            freedom=degrees[i],
        )
    theta = space.theta(x)[0].tolist()
    known = {
        meta.name: _known(meta, theta[place])
        for place, meta in enumerate(space.model.parameters)
        if (space.index[:, place] < 0).all()
    }
    order = {name: i for i, name in enumerate(space.model.parameter_names)}
    return dict(sorted((entries | known).items(), key=lambda item: order.get(bare_name(item[0]), len(order))))


def _described(space: ParameterSpace, i: int, name: str) -> tuple[str, str]:
    """Unit and meaning of an entry of the fitted vector: the model's, or those of a nuisance entry."""
    if i >= len(space.names):
        return _MEANING[bare_name(name)]
    own = space.model.parameter(space.base[i])
    return own.unit, own.meaning


def _known(parameter: Parameter, value: float) -> FittedParameter:
    """A parameter that was not fitted."""
    return FittedParameter(
        name=parameter.name,
        value=value,
        stderr=0.0,
        stderr_noise=0.0,
        init_value=value,
        unit=parameter.unit,
        meaning=parameter.meaning,
        min=parameter.lower,
        max=parameter.upper,
        vary=False,
    )
