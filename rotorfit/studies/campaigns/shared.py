"""Parameters that all runs of a campaign share, found without ever setting up one large problem.

For given shared parameters phi the runs are independent fits; the sum of their costs is a function of phi alone, whose
slope and curvature follow from each run's own (the Schur complement of its Gauss-Newton matrix). The work is linear in
the number of runs, and the result is that of one joint fit, its covariance included.

A run's own fit may find other noise than its data alone show. That noise is held while the shared parameters are
sought: each run's cost is then one function, which both its own parameters and the shared ones minimise. At the
solution all runs are fitted anew, and the search is repeated if they find other noise.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from rotorfit.base.array_types import Float
from rotorfit.base.faults import of_program
from rotorfit.estimators.inference.covariance import (
    Curvature,
    Parts,
    bends,
    inverse_information,
    prior_curvature,
    score_scatter,
    shared_covariance,
    widening,
)
from rotorfit.estimators.minimisation.least_squares import Options
from rotorfit.estimators.misfit.problem import Problem
from rotorfit.identify.fitting.fit import solve
from rotorfit.identify.fitting.problem_setup import build_problem
from rotorfit.identify.fitting.quantities import FittedParameter
from rotorfit.identify.fitting.settings import FitSettings
from rotorfit.models import RotorModel
from rotorfit.studies.campaigns.runs import Run, RunFit, Workers, fit_run

Errors = tuple[Float, Float]
"""Covariance as the noise alone makes it, and widened for a model that does not fit."""

_STEP_TOLERANCE = 1e-4  # of a standard error: a step that changes nothing any more


Shared = tuple[tuple[RunFit, ...], Mapping[str, FittedParameter], Float]
"""Joint fit of a campaign: the runs, what they share, and the covariance of that, SI units, shape ``(s, s)``."""


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
        found = self.workers(_curvature, [self.runs[number] for number in options], list(options.values()))
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

    def result(self, fits: Sequence[RunFit], phi: Float) -> Shared:
        """The result, with the errors of the joint fit."""
        quadratics = self.profile(fits, phi).quadratics
        if self.settings.loss == "linear":
            errors, own_errors = self._errors([fits[n] for n in quadratics], list(quadratics.values()))
        else:
            errors, own_errors = self._errors_of_robust_loss(fits, quadratics, self.options(fits, phi))
        params = {name: self._parameter(i, float(phi[i]), errors) for i, name in enumerate(self.names)}
        done = list(fits)
        for number, own in zip(quadratics, own_errors, strict=True):
            fit = done[number]
            errors_of_run = np.sqrt(np.maximum(np.diag(own), 0.0)).tolist()
            changed = {name: parameter for name, parameter in fit.params.items() if name not in self.names}
            for name, error in zip(fit.var_names, errors_of_run, strict=True):
                if changed[name].resolved:
                    changed[name] = replace(changed[name], stderr=error)
            done[number] = replace(fit, params=changed, covar=own)
        return tuple(done), params, errors

    def _errors(self, fits: Sequence[RunFit], quadratics: Sequence[Curvature]) -> tuple[Float, list[Float]]:
        """Errors of the shared parameters, and of each run's own in the order of its ``var_names``."""
        free = sum(fit.ndata - len(fit.var_names) for fit in fits) - len(self.names)
        redchi = sum(quadratic.squares for quadratic in quadratics) / free if free > 0 else float("nan")
        parts = [Parts.of(quadratic.scaled(1 / widening(redchi, "linear")), self.names) for quadratic in quadratics]
        covar = shared_covariance(parts, self.names)
        follow = (part.follow @ covar @ part.follow.T for part in parts)
        added = (self._own_order(*own) for own in zip(fits, quadratics, follow, strict=True))
        return covar, [fit.covar + more for fit, more in zip(fits, added, strict=True)]

    def _errors_of_robust_loss(
        self, fits: Sequence[RunFit], quadratics: Mapping[int, Curvature], options: Mapping[int, Mapping[str, Any]]
    ) -> tuple[Float, list[Float]]:
        """The sandwich of :func:`rotorfit.estimators.inference.covariance.information`, put together from the runs. Its
        filling is the scatter of each run's slope, which reaches the shared parameters directly and through those of
        the run's own that follow them. The scatter shows a model that does not fit already: nothing is widened."""
        runs = [self.runs[number] for number in quadratics]
        given: list[dict[str, Any]] = [
            {"settings": options[number]["settings"], "at": dict(zip(one.names, one.x.tolist(), strict=True))}
            for number, one in quadratics.items()
        ]
        found = self.workers(_bends_of, runs, given)
        bend = float(np.mean(np.concatenate([own for own, _ in found])))
        parts = [
            Parts.of(replace(one, matrix=squares + np.diag(one.prior)).scaled(bend), self.names)
            for one, (_, squares) in zip(quadratics.values(), found, strict=True)
        ]
        inverse = shared_covariance(parts, self.names)
        asked = [own | {"bend": bend, "covar": p.covariance(inverse)} for own, p in zip(given, parts, strict=True)]
        scatters = self.workers(_scatter_of, runs, asked)
        reached = [part.reach().T @ scatter @ part.reach() for part, scatter in zip(parts, scatters, strict=True)]
        filling = np.sum(reached, axis=0)
        own = []
        for (number, one), part, scatter, direct in zip(quadratics.items(), parts, scatters, reached, strict=True):
            pull, follow = part.pull(inverse), part.follow @ inverse
            whole = pull @ scatter @ pull.T + follow @ (filling - direct) @ follow.T
            own.append(self._own_order(fits[number], one, whole))
        return np.asarray(inverse @ filling @ inverse), own

    def _own_order(self, fit: RunFit, quadratic: Curvature, matrix: Float) -> Float:
        """A matrix of own parameters in the order of the fit."""
        own = [name for name in quadratic.names if name not in self.names]
        order = [own.index(name) for name in fit.var_names]
        return np.asarray(matrix[np.ix_(order, order)])

    def _parameter(self, i: int, value: float, errors: Float) -> FittedParameter:
        parameter = self.workers.model.parameter(self.names[i])
        low, high = self.limits[:, i].tolist()
        return FittedParameter(
            name=self.names[i],
            value=value,
            stderr=float(np.sqrt(errors[i, i])),
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
) -> tuple[Shared, bool]:
    """Fit shared and per-run parameters together; whether the search for the shared ones settled."""
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
    return joint.result(fits, phi), settled


def refuse_none(fits: Sequence[RunFit]) -> None:
    """Refuse a campaign of which nothing can be fitted."""
    if not any(fit.params for fit in fits):
        raise ValueError(f"no run of the campaign can be fitted; the first one: {fits[0].message}")


def _own_values(fit: RunFit, start: Mapping[str, float]) -> Mapping[str, float]:
    return {name: fit.params[name].value for name in fit.var_names} or start


def _with_noise(settings: FitSettings, fit: RunFit) -> FitSettings:
    """Settings with the noise that a fit found; the very same where it found none, which runs then share."""
    return settings if fit.noise is None else replace(settings, noise=fit.noise)


# ---- work on one run, here or elsewhere --------------------------------------------------------------------------


def _curvature(
    model: RotorModel,
    run: Run,
    *,
    settings: FitSettings,
    at: Mapping[str, float],
    shared: Mapping[str, float] | None = None,
) -> Curvature | str:
    """Cost of one run and its derivatives at given parameters, where shared ones are given at the best of its own
    beside them; the reason in words where there is none."""
    try:
        if shared is not None:
            known = replace(settings, known={**settings.known, **shared})
            problem, names, begin = _problem_at(model, run, known, at)
            x = solve(problem, np.clip(begin, problem.space.lower, problem.space.upper), Options()).x
            at = {**dict(zip(names, x.tolist(), strict=True)), **shared}
        problem, names, x = _problem_at(model, run, settings, at)
    except (ValueError, KeyError) as reason:
        if of_program(reason):
            raise
        return str(reason)
    cost, gradient, matrix = problem.gauss_newton(x)
    squares = float(np.sum(np.abs(problem.residuals(x)) ** 2))
    prior = prior_curvature(problem, x)
    return Curvature(names=names, x=x, cost=cost, squares=squares, gradient=gradient, matrix=matrix, prior=prior)


def _problem_at(
    model: RotorModel, run: Run, settings: FitSettings, at: Mapping[str, float]
) -> tuple[Problem, tuple[str, ...], Float]:
    """The problem of one run, its entries by name, and the vector of given parameters."""
    problem = build_problem(model, run.experiment, settings)
    names = (*problem.space.names, *problem.space.nuisance)
    return problem, names, np.array([at.get(n, 0.0) if n in problem.space.nuisance else at[n] for n in names])


def _bends_of(model: RotorModel, run: Run, *, settings: FitSettings, at: Mapping[str, float]) -> tuple[Float, Float]:
    """Bends of a robust loss in one run's readings, shape ``(R,)``, and its matrix by squares, shape ``(p, p)``."""
    problem = build_problem(model, run.experiment, settings)
    r, J = problem.jacobian(np.array([at[name] for name in problem.space.names]))
    return bends(problem.loss, r), np.asarray((J.conj().T @ J).real)


def _scatter_of(
    model: RotorModel, run: Run, *, settings: FitSettings, at: Mapping[str, float], bend: float, covar: Float
) -> Float:
    """Scatter of the slope of one run's cost, shape ``(p, p)``."""
    problem = build_problem(model, run.experiment, settings)
    x = np.array([at[name] for name in problem.space.names])
    return score_scatter(problem, x, *problem.jacobian(x), bend=bend, covar=covar)
