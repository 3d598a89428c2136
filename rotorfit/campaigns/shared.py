"""Parameters that all runs of a campaign share, found without ever setting up one large problem.

For given shared parameters phi the runs are independent fits; the sum of their costs is a function of phi alone, whose
slope and curvature follow from each run's own (the Schur complement of its Gauss-Newton matrix). The work is linear in
the number of runs, and the result is that of one joint fit, its covariance included.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from rotorfit.campaigns.joint_errors import FittedRun, JointErrors, OwnErrors, joint_errors
from rotorfit.campaigns.runs import Run, RunFit, Workers, curvature, fit_run
from rotorfit.estimators.inference.schur import Curvature, Parts, inverse_information, shared_covariance
from rotorfit.fitting.quantities import FittedParameter
from rotorfit.fitting.settings import FitSettings
from rotorfit.models import RotorModel
from rotorfit.models.array_types import Float

_ROUNDS = 30
_SETTLED = 1e-4  # of a standard error: a step that changes nothing any more


@dataclass(frozen=True, eq=False, kw_only=True)
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


@dataclass(frozen=True, eq=False, kw_only=True)
class _Profile:
    """Cost as a function of the shared parameters, at one point."""

    cost: float
    gradient: Float
    information: Float
    size: Float  # information that each would have, were all others known: what counts as none is judged against it
    fits: list[RunFit]
    fitted: dict[int, FittedRun]  # by the number of the run, those that could be fitted


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
    errors = joint_errors(workers, list(here.fitted.values()), names)
    return _finish(workers.model, names, phi, here, errors, settled, (lower, upper))


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
    taken = [picture for picture in pictures if isinstance(picture, Curvature)]
    if not taken:
        raise ValueError(f"no run tells anything of the shared parameters; the first one: {pictures[0]}")
    parts = [Parts.of(picture, names) for picture in taken]
    # The minimum of each picture lies a Newton step from where it was taken.
    pulls = [p.schur @ picture.x[p.shared] - p.gradient for p, picture in zip(parts, taken, strict=True)]
    return np.asarray(shared_covariance(parts, names) @ np.sum(pulls, axis=0))


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
    fitted = {
        number: FittedRun(run=runs[number], fit=fits[number], picture=picture, options=option)
        for (number, picture), option in zip(found.items(), options, strict=True)
        if isinstance(picture, Curvature)
    }
    if not fitted:
        raise ValueError(
            f"no run of the campaign tells anything of the shared parameters: {next(iter(found.values()))}"
        )
    parts = [Parts.of(item.picture, names) for item in fitted.values()]
    return _Profile(
        cost=sum(item.picture.cost for item in fitted.values()),
        gradient=np.sum([part.gradient for part in parts], axis=0),
        information=np.sum([part.schur for part in parts], axis=0),
        size=np.sum([part.size for part in parts], axis=0),
        fits=fits,
        fitted=fitted,
    )


def _finish(
    model: RotorModel,
    names: Sequence[str],
    phi: Float,
    profile: _Profile,
    errors: JointErrors,
    settled: bool,
    limits: tuple[Float, Float],
) -> Shared:
    shared = {}
    for i, name in enumerate(names):
        parameter = model.parameter(name)
        low, high = float(limits[0][i]), float(limits[1][i])
        shared[name] = FittedParameter(
            name=name,
            value=float(phi[i]),
            stderr=float(np.sqrt(errors.covar[i, i])),
            stderr_noise=float(np.sqrt(errors.noise[i, i])),
            init_value=float(phi[i]),
            unit=parameter.unit,
            meaning=parameter.meaning,
            min=low,
            max=high,
            vary=True,
            at_bound=bool(min(phi[i] - low, high - phi[i]) <= 1e-7 * abs(phi[i])),
        )
    runs = list(profile.fits)
    for number, own in zip(profile.fitted, errors.own, strict=True):
        runs[number] = _with_errors(runs[number], own, names)
    return Shared(runs=tuple(runs), params=shared, covar=errors.covar, success=settled)


def _with_errors(fit: RunFit, errors: OwnErrors, names: Sequence[str]) -> RunFit:
    params = {name: parameter for name, parameter in fit.params.items() if name not in names}
    for i, name in enumerate(fit.var_names):
        if params[name].resolved:
            error, noise = np.sqrt(errors.covar[i, i]), np.sqrt(errors.noise[i, i])
            params[name] = replace(params[name], stderr=float(error), stderr_noise=float(noise))
    return replace(fit, params=params, covar=errors.covar)
