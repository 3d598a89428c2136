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
from functools import cached_property
from typing import Any

import numpy as np

from rotorfit.campaigns.joint_errors import Errors, FittedRun, joint_errors
from rotorfit.campaigns.runs import Run, RunFit, Workers, fit_run
from rotorfit.estimators.inference.covariance import (
    Curvature,
    Parts,
    inverse_information,
    prior_curvature,
    shared_covariance,
)
from rotorfit.estimators.minimisation.least_squares import Options
from rotorfit.estimators.misfit.problem import Problem
from rotorfit.estimators.starting.closed_form import ClosedFormError
from rotorfit.fitting.fit import solve
from rotorfit.fitting.problem_setup import build_problem
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


@dataclass(frozen=True, eq=False, kw_only=True)
class _Joint:
    """The task: runs, and which parameters they share."""

    workers: Workers
    runs: Sequence[Run]
    names: Sequence[str]  # of the shared parameters
    settings: FitSettings
    start: Mapping[str, float]

    @cached_property
    def limits(self) -> Float:
        """Bounds of the shared parameters, shape ``(2, s)``."""
        found = []
        for name in self.names:
            parameter = self.workers.model.parameter(name)
            low, high = self.settings.bounds.get(name, (parameter.lower, parameter.upper))
            found.append((max(low, parameter.lower), min(high, parameter.upper)))
        return np.array(found).T

    def first(self) -> tuple[Float, list[RunFit]]:
        """Shared values that suit the separate fits of all runs best, by quadratic approximations, and these fits."""
        if all(name in self.start for name in self.names):
            phi = np.array([self.start[name] for name in self.names], dtype=float)
            return phi, self.fits(phi, [self.start] * len(self.runs))
        fits = self.workers(fit_run, self.runs, [{"settings": self.settings, "start": self.start}] * len(self.runs))
        refuse_none(fits)
        usable = [(run, fit) for run, fit in zip(self.runs, fits, strict=True) if fit.params]
        start = self.start
        options = [{"settings": _with_noise(self.settings, fit), "at": _own_values(fit, start)} for _, fit in usable]
        quadratics = self.workers(_curvature, [run for run, _ in usable], options)
        taken = [quadratic for quadratic in quadratics if isinstance(quadratic, Curvature)]
        if not taken:
            raise ValueError(f"no run determines any of the shared parameters; the first one: {quadratics[0]}")
        parts = [Parts.of(quadratic, self.names) for quadratic in taken]
        # The minimum of each approximation lies a Newton step from its point.
        pulls = [p.schur @ quadratic.x[p.shared] - p.gradient for p, quadratic in zip(parts, taken, strict=True)]
        return np.asarray(shared_covariance(parts, self.names) @ np.sum(pulls, axis=0)), fits

    def fits(self, phi: Float, starts: Sequence[Mapping[str, float]]) -> list[RunFit]:
        """Every run fitted by itself for given shared values."""
        fixed = dict(zip(self.names, phi.tolist(), strict=True))
        inner = replace(self.settings, known={**self.settings.known, **fixed})
        own_starts = [{name: value for name, value in start.items() if name not in fixed} for start in starts]
        fits = self.workers(fit_run, self.runs, [{"settings": inner, "start": start} for start in own_starts])
        refuse_none(fits)
        return fits

    def search(self, fits: Sequence[RunFit], phi: Float) -> tuple[Float, _Profile, bool]:
        """Shared values of least cost with the noise of the runs as their fits took it, and whether this settled."""
        here = self.profile(fits, phi)
        for _ in range(30):
            covar = inverse_information(here.information, here.size, self.names)
            step = np.clip(phi - covar @ here.gradient, *self.limits) - phi
            if np.sqrt(step @ here.information @ step) < _STEP_TOLERANCE:
                return phi, here, True
            factor = 1.0
            while True:
                there = self.profile(fits, phi + factor * step)
                if there.cost <= here.cost * (1 + 1e-12) or factor < 1e-3:
                    break
                factor /= 2
            if there.cost > here.cost * (1 + 1e-12):
                break
            phi, here = phi + factor * step, there
        return phi, here, False

    def options(self, fits: Sequence[RunFit], phi: Float) -> dict[int, dict[str, Any]]:
        """Settings and values with which each run that was fitted is looked at, by its number."""
        fixed = dict(zip(self.names, phi.tolist(), strict=True))
        free = replace(self.settings, known={**self.settings.known, **dict.fromkeys(self.names)})
        return {
            number: {"settings": _with_noise(free, fit), "shared": fixed, "at": _own_values(fit, {})}
            for number, fit in enumerate(fits)
            if fit.params
        }

    def profile(self, fits: Sequence[RunFit], phi: Float) -> _Profile:
        """Sum what all runs say about given shared values, with their own at their best and noise as fitted."""
        options = self.options(fits, phi)
        found = self.workers(_least_curvature, [self.runs[number] for number in options], list(options.values()))
        quadratics = {n: own for n, own in zip(options, found, strict=True) if isinstance(own, Curvature)}
        if not quadratics:
            raise ValueError(f"no run of the campaign determines anything of the shared parameters: {found[0]}")
        parts = [Parts.of(quadratic, self.names) for quadratic in quadratics.values()]
        return _Profile(
            cost=sum(quadratic.cost for quadratic in quadratics.values()),
            gradient=np.sum([part.gradient for part in parts], axis=0),
            information=np.sum([part.schur for part in parts], axis=0),
            size=np.sum([part.size for part in parts], axis=0),
            quadratics=quadratics,
        )

    def result(self, fits: Sequence[RunFit], phi: Float, settled: bool) -> Shared:
        """The result, with the errors of the joint fit."""
        options, quadratics = self.options(fits, phi), self.profile(fits, phi).quadratics
        fitted = []
        for number, quadratic in quadratics.items():
            at = dict(zip(quadratic.names, quadratic.x.tolist(), strict=True))
            given = {"settings": options[number]["settings"], "at": at}
            fitted.append(FittedRun(run=self.runs[number], fit=fits[number], quadratic=quadratic, options=given))
        errors, own_errors = joint_errors(self.workers, fitted, self.names)
        params = {name: self._parameter(i, float(phi[i]), errors) for i, name in enumerate(self.names)}
        done = list(fits)
        for number, own in zip(quadratics, own_errors, strict=True):
            done[number] = _with_errors(done[number], own, self.names)
        return Shared(runs=tuple(done), params=params, covar=errors[1], success=settled)

    def _parameter(self, i: int, value: float, errors: Errors) -> FittedParameter:
        parameter = self.workers.model.parameter(self.names[i])
        low, high = self.limits[:, i].tolist()
        return FittedParameter(
            name=self.names[i],
            value=value,
            stderr=float(np.sqrt(errors[1][i, i])),
            stderr_noise=float(np.sqrt(errors[0][i, i])),
            init_value=value,
            unit=parameter.unit,
            meaning=parameter.meaning,
            min=low,
            max=high,
            vary=True,
            at_bound=bool(min(value - low, high - value) <= 1e-7 * abs(value)),
        )


def fit_shared(
    workers: Workers, runs: Sequence[Run], names: Sequence[str], settings: FitSettings, start: Mapping[str, float]
) -> Shared:
    """Fit shared and per-run parameters together."""
    joint = _Joint(workers=workers, runs=runs, names=names, settings=settings, start=start)
    phi, fits = joint.first()
    phi = np.clip(phi, *joint.limits)
    rounds = 3  # times that noise is found anew; a run at the edge between two verdicts may change its mind for ever
    for number in range(rounds + 1):
        found, here, settled = joint.search(fits, phi)
        moved = found - phi
        if number and np.sqrt(moved @ here.information @ moved) < _STEP_TOLERANCE:
            break  # the fits are those for these values
        phi = found
        # Separate fits may determine too little of a run to start from: the first ones begin with their closed forms.
        fits = joint.fits(phi, [_own_values(fit, start) if number else start for fit in fits])
        if not settled:
            break
    return joint.result(fits, phi, settled)


def refuse_none(fits: Sequence[RunFit]) -> None:
    """Refuse a campaign of which nothing can be fitted."""
    if not any(fit.params for fit in fits):
        raise ValueError(f"no run of the campaign can be fitted; the first one: {fits[0].message}")


def _own_values(fit: RunFit, start: Mapping[str, float]) -> Mapping[str, float]:
    return {name: fit.params[name].value for name in fit.var_names} or start


def _with_noise(settings: FitSettings, fit: RunFit) -> FitSettings:
    """Settings with the noise that a fit found; the very same where it found none, which runs then share."""
    return settings if fit.noise is None else replace(settings, noise=fit.noise)


def _with_errors(fit: RunFit, errors: Errors, names: Sequence[str]) -> RunFit:
    params = {name: parameter for name, parameter in fit.params.items() if name not in names}
    for i, name in enumerate(fit.var_names):
        if params[name].resolved:
            noise, error = (float(np.sqrt(covar[i, i])) for covar in errors)
            params[name] = replace(params[name], stderr=error, stderr_noise=noise)
    return replace(fit, params=params, covar=errors[1])


# ---- work on one run, here or elsewhere --------------------------------------------------------------------------


def _problem_at(
    model: RotorModel, run: Run, settings: FitSettings, at: Mapping[str, float]
) -> tuple[Problem, tuple[str, ...], Float] | str:
    """The problem of one run, its entries by name, and the vector of given parameters; or why there is none."""
    try:
        problem = build_problem(model, run.experiment, settings)
    except (ValueError, KeyError, ClosedFormError) as reason:
        return str(reason)
    names = (*problem.space.names, *problem.space.nuisance)
    return problem, names, np.array([at.get(n, 0.0) if n in problem.space.nuisance else at[n] for n in names])


def _curvature(model: RotorModel, run: Run, *, settings: FitSettings, at: Mapping[str, float]) -> Curvature | str:
    """Cost of one run and its derivatives at given parameters; the reason in words where there is none."""
    found = _problem_at(model, run, settings, at)
    if isinstance(found, str):
        return found
    problem, names, x = found
    cost, gradient, matrix = problem.gauss_newton(x)
    squares = float(np.sum(np.abs(problem.residuals(x)) ** 2))
    prior = prior_curvature(problem, x)
    return Curvature(names=names, x=x, cost=cost, squares=squares, gradient=gradient, matrix=matrix, prior=prior)


def _least_curvature(
    model: RotorModel, run: Run, *, settings: FitSettings, shared: Mapping[str, float], at: Mapping[str, float]
) -> Curvature | str:
    """Cost of one run and its derivatives where its own parameters are best for the shared ones given."""
    found = _problem_at(model, run, replace(settings, known={**settings.known, **shared}), at)
    if isinstance(found, str):
        return found
    problem, names, begin = found
    solution = solve(problem, np.clip(begin, problem.space.lower, problem.space.upper), Options())
    own = dict(zip(names, solution.x.tolist(), strict=True))
    return _curvature(model, run, settings=settings, at={**own, **shared})
