"""Parameters that all runs of a campaign share, found without ever setting up one large problem.

For given shared parameters phi the runs are independent fits; the sum of their costs is a function of phi alone, whose
slope and curvature follow from each run's own (the Schur complement of its Gauss-Newton matrix). The work is linear in
the number of runs, and the result is that of one joint fit, its covariance included.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rotorfit.campaigns.runs import Run, RunFit, Workers, curvature, fit_run
from rotorfit.estimators.schur import Curvature, Parts, inverse_information
from rotorfit.fitting.result import FittedParameter
from rotorfit.fitting.settings import FitSettings
from rotorfit.models import RotorModel

Float = NDArray[np.float64]

_ROUNDS = 30
_SETTLED = 1e-4  # of a standard error: a step that changes nothing any more


@dataclass(frozen=True, eq=False)
class Shared:
    """Joint fit of a campaign: the runs, and what they share.

    Attributes:
        runs: results of the runs, the errors of their own parameters with those of the shared ones propagated.
        params: the shared parameters.
        covar: their covariance, SI units, shape ``(s, s)``.
        success: whether the search for them settled.
    """

    runs: tuple[RunFit, ...]
    params: Mapping[str, FittedParameter]
    covar: Float
    success: bool


@dataclass(frozen=True, eq=False)
class _Profile:
    """Cost as a function of the shared parameters, at one point."""

    cost: float
    gradient: Float
    information: Float
    size: Float  # information that each would have, were all others known: what counts as none is judged against it
    pictures: list[Curvature | str]
    fits: list[RunFit]


def fit_shared(
    workers: Workers,
    runs: Sequence[Run],
    names: Sequence[str],
    settings: FitSettings,
    start: Mapping[str, float],
) -> Shared:
    """Fit shared and per-run parameters together.

    Args:
        workers: what does the work.
        runs: the runs.
        names: shared parameters.
        settings: known values, bounds, loss.
        start: start values.

    Raises:
        ValueError: the runs do not determine the shared parameters, or none can be fitted.
    """
    phi = _first(workers, runs, names, settings, start)
    lower, upper = np.array([_limits(workers.model, name, settings) for name in names]).T
    here = _profile(workers, runs, names, settings, phi, [start] * len(runs))
    settled = False
    for _ in range(_ROUNDS):
        covar = inverse_information(here.information, here.size, names)
        step = np.clip(phi - covar @ here.gradient, lower, upper) - phi
        if np.sqrt(step @ here.information @ step) < _SETTLED:
            settled = True
            break
        factor = 1.0
        while True:
            starts = [_own_values(fit, start) for fit in here.fits]
            there = _profile(workers, runs, names, settings, phi + factor * step, starts)
            if there.cost <= here.cost * (1 + 1e-12) or factor < 1e-3:
                break
            factor /= 2
        if there.cost > here.cost * (1 + 1e-12):
            break
        phi, here = phi + factor * step, there
    return _finish(
        workers.model,
        names,
        phi,
        here,
        inverse_information(here.information, here.size, names),
        settled,
        (lower, upper),
    )


def _limits(model: RotorModel, name: str, settings: FitSettings) -> tuple[float, float]:
    parameter = model.parameter(name)
    low, high = settings.bounds.get(name, (parameter.lower, parameter.upper))
    return max(low, parameter.lower), min(high, parameter.upper)


def _own_values(fit: RunFit, start: Mapping[str, float]) -> Mapping[str, float]:
    return {name: fit.params[name].value for name in fit.var_names} or start


def _first(
    workers: Workers,
    runs: Sequence[Run],
    names: Sequence[str],
    settings: FitSettings,
    start: Mapping[str, float],
) -> Float:
    """Shared values that suit the separate fits of all runs best, by the quadratic picture of each."""
    if all(name in start for name in names):
        return np.array([start[name] for name in names], dtype=float)
    option = {"settings": settings, "start": start}
    fits = workers(fit_run, runs, [option] * len(runs))
    usable = [(run, fit) for run, fit in zip(runs, fits, strict=True) if fit.params]
    if not usable:
        raise ValueError(f"no run of the campaign can be fitted; the first one: {fits[0].message}")
    options = [{"settings": settings, "at": {n: fit.params[n].value for n in fit.var_names}} for _, fit in usable]
    pictures = workers(curvature, [run for run, _ in usable], options)
    information, size, pull = np.zeros((len(names), len(names))), np.zeros(len(names)), np.zeros(len(names))
    for picture in pictures:
        if isinstance(picture, Curvature):
            parts = Parts.of(picture, names)
            information += parts.schur
            size += parts.size
            # The minimum of the picture lies a Newton step from where it was taken.
            pull += parts.schur @ picture.x[parts.shared] - parts.gradient
    return inverse_information(information, size, names) @ pull


def _profile(
    workers: Workers,
    runs: Sequence[Run],
    names: Sequence[str],
    settings: FitSettings,
    phi: Float,
    starts: Sequence[Mapping[str, float]],
) -> _Profile:
    """Fit all runs for given shared values and sum what they say about these."""
    fixed = dict(zip(names, phi.tolist(), strict=True))
    inner = replace(settings, known={**settings.known, **fixed})
    own_starts = [{name: value for name, value in start.items() if name not in fixed} for start in starts]
    fits = workers(fit_run, runs, [{"settings": inner, "start": start} for start in own_starts])
    free = replace(settings, known={**settings.known, **dict.fromkeys(names)})
    usable = [number for number, fit in enumerate(fits) if fit.params]
    if not usable:
        raise ValueError(f"no run of the campaign can be fitted; the first one: {fits[0].message}")
    options = [
        {
            "settings": free,
            "at": {**fixed, **{n: fits[number].params[n].value for n in fits[number].var_names}},
        }
        for number in usable
    ]
    found = dict(zip(usable, workers(curvature, [runs[number] for number in usable], options), strict=True))
    pictures = [found.get(number, "not fitted") for number in range(len(runs))]
    cost, gradient, information, size = (
        0.0,
        np.zeros(phi.size),
        np.zeros((phi.size, phi.size)),
        np.zeros(phi.size),
    )
    for picture in pictures:
        if isinstance(picture, Curvature):
            parts = Parts.of(picture, names)
            cost += picture.cost
            gradient += parts.gradient
            information += parts.schur
            size += parts.size
    return _Profile(cost, gradient, information, size, pictures, fits)


def _finish(
    model: RotorModel,
    names: Sequence[str],
    phi: Float,
    profile: _Profile,
    covar: Float,
    settled: bool,
    limits: tuple[Float, Float],
) -> Shared:
    """Errors of the joint fit: the runs' own parameters inherit those of the shared ones."""
    used = [fit for fit in profile.fits if fit.params]
    free = sum(fit.ndata - len(fit.var_names) for fit in used) - len(names)
    redchi = sum(fit.chisqr for fit in used) / free if free > 0 else float("nan")
    widening = max(1.0, redchi)
    shared = {}
    for i, name in enumerate(names):
        parameter = model.parameter(name)
        error, low, high = float(np.sqrt(covar[i, i])), float(limits[0][i]), float(limits[1][i])
        shared[name] = FittedParameter(
            name, float(phi[i]), error * float(np.sqrt(widening)), error, float(phi[i]), parameter.unit,
            parameter.meaning, low, high, True, at_bound=bool(min(phi[i] - low, high - phi[i]) <= 1e-7 * abs(phi[i])),
        )  # fmt: skip
    runs = [
        _with_shared_errors(fit, picture, names, covar, widening)
        for fit, picture in zip(profile.fits, profile.pictures, strict=True)
    ]
    return Shared(tuple(runs), shared, covar * widening, settled)


def _with_shared_errors(
    fit: RunFit, picture: Curvature | str, names: Sequence[str], covar: Float, widening: float
) -> RunFit:
    if not isinstance(picture, Curvature):
        return fit
    follow = Parts.of(picture, names).follow
    own = [name for name in picture.names if name not in names]
    order = [own.index(name) for name in fit.var_names]
    added = (follow @ covar @ follow.T)[np.ix_(order, order)]
    params = {name: parameter for name, parameter in fit.params.items() if name not in names}
    for i, name in enumerate(fit.var_names):
        old = params[name]
        params[name] = replace(
            old,
            stderr=float(np.hypot(old.stderr, np.sqrt(added[i, i] * widening))),
            stderr_noise=float(np.hypot(old.stderr_noise, np.sqrt(added[i, i]))),
        )
    return replace(fit, params=params, covar=fit.covar + added * widening)
