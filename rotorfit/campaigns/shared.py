"""Parameters that all runs of a campaign share, found without ever setting up one large problem.

For given shared parameters phi the runs are independent fits; the sum of their costs is a function of phi alone, whose
slope and curvature follow from each run's own (the Schur complement of its Gauss-Newton matrix). The work is linear in
the number of runs, and the result is that of one joint fit, its covariance included.

A run may be noise of another size or shape than its data alone show. What its own fit finds of that is held while the
shared parameters are sought: each run's cost is then one function, which both its own parameters and the shared ones
minimise. At the solution all runs are fitted anew, and the search is repeated if they find other noise.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from rotorfit.campaigns.curvatures import curvature, least_curvature
from rotorfit.campaigns.joint_errors import FittedRun, OwnErrors, joint_errors
from rotorfit.campaigns.runs import Run, RunFit, Workers, fit_run
from rotorfit.estimators.inference.schur import Curvature, Parts, inverse_information, shared_covariance
from rotorfit.fitting.quantities import FittedParameter
from rotorfit.fitting.settings import FitSettings
from rotorfit.models import RotorModel
from rotorfit.models.array_types import Float

_STEP_TOLERANCE = 1e-4  # of a standard error: a step that changes nothing any more


@dataclass(frozen=True, eq=False, kw_only=True)
class Shared:
    """Joint fit of a campaign: the runs, and what they share."""

    runs: tuple[RunFit, ...]
    params: Mapping[str, FittedParameter]  # the shared parameters
    covar: Float  # their covariance, SI units, shape ``(s, s)``
    success: bool  # whether the search for them settled


@dataclass(frozen=True, eq=False, kw_only=True)
class _Profile:
    """Cost as a function of the shared parameters, at one point."""

    cost: float
    gradient: Float
    information: Float
    size: Float  # information that each would have, were all others known: what counts as none is judged against it
    quadratics: dict[int, Curvature]  # by the number of the run, those that could be fitted


def fit_shared(
    workers: Workers,
    runs: Sequence[Run],
    names: Sequence[str],
    settings: FitSettings,
    start: Mapping[str, float],
) -> Shared:
    """Fit shared and per-run parameters together."""
    phi, fits = _first(workers, runs, names, settings, start)
    limits = np.array([_limits(workers.model, name, settings) for name in names]).T
    phi = np.clip(phi, *limits)
    rounds = 3  # times that noise is found anew; a run at the edge between two verdicts may change its mind for ever
    for number in range(rounds + 1):
        found, here, settled = _search(workers, runs, fits, names, settings, phi, limits)
        moved = found - phi
        if number and np.sqrt(moved @ here.information @ moved) < _STEP_TOLERANCE:
            break  # the fits are those for these values
        phi = found
        # Separate fits may determine too little of a run to start from: the first ones begin with their closed forms.
        starts = [_own_values(fit, start) if number else start for fit in fits]
        fits = _fits(workers, runs, names, settings, phi, starts)
        if not settled:
            break
    return _finish(workers, runs, fits, names, settings, phi, settled, limits)


def _search(
    workers: Workers,
    runs: Sequence[Run],
    fits: Sequence[RunFit],
    names: Sequence[str],
    settings: FitSettings,
    phi: Float,
    limits: Float,
) -> tuple[Float, _Profile, bool]:
    """Shared values of least cost with the noise of the runs as their fits took it, and whether the search settled."""
    here = _profile(workers, runs, fits, names, settings, phi)
    for _ in range(30):
        covar = inverse_information(here.information, here.size, names)
        step = np.clip(phi - covar @ here.gradient, *limits) - phi
        if np.sqrt(step @ here.information @ step) < _STEP_TOLERANCE:
            return phi, here, True
        factor = 1.0
        while True:
            there = _profile(workers, runs, fits, names, settings, phi + factor * step)
            if there.cost <= here.cost * (1 + 1e-12) or factor < 1e-3:
                break
            factor /= 2
        if there.cost > here.cost * (1 + 1e-12):
            break
        phi, here = phi + factor * step, there
    return phi, here, False


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
) -> tuple[Float, list[RunFit]]:
    """Shared values that suit the separate fits of all runs best, by quadratic approximations, and these fits."""
    if all(name in start for name in names):
        phi = np.array([start[name] for name in names], dtype=float)
        return phi, _fits(workers, runs, names, settings, phi, [start] * len(runs))
    option = {"settings": settings, "start": start}
    fits = workers(fit_run, runs, [option] * len(runs))
    usable = [(run, fit) for run, fit in zip(runs, fits, strict=True) if fit.params]
    if not usable:
        raise ValueError(f"no run of the campaign can be fitted; the first one: {fits[0].message}")
    options = [{"settings": _with_noise(settings, fit), "at": _own_values(fit, start)} for _, fit in usable]
    quadratics = workers(curvature, [run for run, _ in usable], options)
    taken = [quadratic for quadratic in quadratics if isinstance(quadratic, Curvature)]
    if not taken:
        raise ValueError(f"no run determines any of the shared parameters; the first one: {quadratics[0]}")
    parts = [Parts.of(quadratic, names) for quadratic in taken]
    # The minimum of each approximation lies a Newton step from its point.
    pulls = [p.schur @ quadratic.x[p.shared] - p.gradient for p, quadratic in zip(parts, taken, strict=True)]
    return np.asarray(shared_covariance(parts, names) @ np.sum(pulls, axis=0)), fits


def _fits(
    workers: Workers,
    runs: Sequence[Run],
    names: Sequence[str],
    settings: FitSettings,
    phi: Float,
    starts: Sequence[Mapping[str, float]],
) -> list[RunFit]:
    """Every run fitted by itself for given shared values."""
    fixed = dict(zip(names, phi.tolist(), strict=True))
    inner = replace(settings, known={**settings.known, **fixed})
    own_starts = [{name: value for name, value in start.items() if name not in fixed} for start in starts]
    fits = workers(fit_run, runs, [{"settings": inner, "start": start} for start in own_starts])
    if not any(fit.params for fit in fits):
        raise ValueError(f"no run of the campaign can be fitted; the first one: {fits[0].message}")
    return fits


def _options(
    fits: Sequence[RunFit], names: Sequence[str], settings: FitSettings, phi: Float
) -> dict[int, dict[str, Any]]:
    """Settings and values with which each run that was fitted is looked at, by its number."""
    fixed = dict(zip(names, phi.tolist(), strict=True))
    free = replace(settings, known={**settings.known, **dict.fromkeys(names)})
    return {
        number: {"settings": _with_noise(free, fit), "shared": fixed, "at": _own_values(fit, {})}
        for number, fit in enumerate(fits)
        if fit.params
    }


def _with_noise(settings: FitSettings, fit: RunFit) -> FitSettings:
    """Settings with the noise that a fit found; the very same where it found none, which runs then share."""
    return settings if fit.noise is None else replace(settings, noise=fit.noise)


def _profile(
    workers: Workers,
    runs: Sequence[Run],
    fits: Sequence[RunFit],
    names: Sequence[str],
    settings: FitSettings,
    phi: Float,
) -> _Profile:
    """Sum what all runs say about given shared values, with their own parameters at their best and noise as fitted."""
    options = _options(fits, names, settings, phi)
    found = workers(least_curvature, [runs[number] for number in options], list(options.values()))
    quadratics = {n: quadratic for n, quadratic in zip(options, found, strict=True) if isinstance(quadratic, Curvature)}
    if not quadratics:
        raise ValueError(f"no run of the campaign tells anything of the shared parameters: {found[0]}")
    parts = [Parts.of(quadratic, names) for quadratic in quadratics.values()]
    return _Profile(
        cost=sum(quadratic.cost for quadratic in quadratics.values()),
        gradient=np.sum([part.gradient for part in parts], axis=0),
        information=np.sum([part.schur for part in parts], axis=0),
        size=np.sum([part.size for part in parts], axis=0),
        quadratics=quadratics,
    )


def _finish(
    workers: Workers,
    runs: Sequence[Run],
    fits: Sequence[RunFit],
    names: Sequence[str],
    settings: FitSettings,
    phi: Float,
    settled: bool,
    limits: Float,
) -> Shared:
    """The result, with the errors of the joint fit."""
    options = _options(fits, names, settings, phi)
    quadratics = _profile(workers, runs, fits, names, settings, phi).quadratics
    fitted = [
        FittedRun(
            run=runs[number],
            fit=fits[number],
            quadratic=quadratic,
            options={
                "settings": options[number]["settings"],
                "at": dict(zip(quadratic.names, quadratic.x.tolist(), strict=True)),
            },
        )
        for number, quadratic in quadratics.items()
    ]
    errors = joint_errors(workers, fitted, names)
    shared = {}
    for i, name in enumerate(names):
        parameter = workers.model.parameter(name)
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
    done = list(fits)
    for number, own in zip(quadratics, errors.own, strict=True):
        done[number] = _with_errors(done[number], own, names)
    return Shared(runs=tuple(done), params=shared, covar=errors.covar, success=settled)


def _with_errors(fit: RunFit, errors: OwnErrors, names: Sequence[str]) -> RunFit:
    params = {name: parameter for name, parameter in fit.params.items() if name not in names}
    for i, name in enumerate(fit.var_names):
        if params[name].resolved:
            error, noise = np.sqrt(errors.covar[i, i]), np.sqrt(errors.noise[i, i])
            params[name] = replace(params[name], stderr=float(error), stderr_noise=float(noise))
    return replace(fit, params=params, covar=errors.covar)
