"""The verdict on a solved problem: errors, goodness of fit, identifiability, sentences worth reading."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from rotorfit.data.experiments import Experiment
from rotorfit.estimators.inference import covariance
from rotorfit.estimators.minimisation.least_squares import Solution, Status
from rotorfit.estimators.misfit.problem import Problem
from rotorfit.estimators.starting.closed_form import ClosedForm
from rotorfit.estimators.starting.start_points import Start
from rotorfit.fitting.fit_warnings import fit_warnings
from rotorfit.fitting.goodness import goodness_of
from rotorfit.fitting.noise.residual_study import ResidualStudy
from rotorfit.fitting.parameter_table import parameter_table
from rotorfit.fitting.result import FitResult
from rotorfit.fitting.settings import FitSettings
from rotorfit.fitting.standard_errors import standard_errors
from rotorfit.models.array_types import Float


def judge(
    problem: Problem,
    experiments: tuple[Experiment, ...],
    settings: FitSettings,
    x: Float,
    start: Start,
    method: str,
    solution: Solution | None,
    notes: tuple[str, ...],
    estimate: ClosedForm | None = None,
    noise: ResidualStudy | None = None,
) -> FitResult:
    """The result of a solved problem, or of a closed form."""
    x = np.concatenate([x, np.zeros(problem.space.size - x.size)])
    residuals, jacobian = problem.jacobian(x)
    goodness = goodness_of(problem, settings, x, residuals)
    errors = standard_errors(problem, settings, x, residuals, jacobian, goodness, estimate, noise)
    verdict = errors.identifiability
    params = parameter_table(
        problem.space, x, start.x, errors.scattered, errors.covar, errors.degrees, verdict.unresolved
    )
    # A minimum along a whole line is one: the identifiability verdict names the line.
    success = solution is None or solution.success or solution.status is Status.SINGULAR
    if not success:  # where a search stalled the curvature tells nothing of the error
        params = {n: replace(p, stderr=np.nan, stderr_noise=np.nan) if p.vary else p for n, p in params.items()}
    found = fit_warnings(problem, x, goodness.redchi, params, verdict, bool(settings.noise_scale), errors.noise)
    warnings = [*notes, *found]
    if solution is not None and not success:
        warnings.insert(0, f"the optimisation did not converge, so no standard errors are given: {solution.message}")
    return FitResult(
        model=problem.space.model,
        experiments=experiments,
        settings=settings,
        method=method,
        problem=problem,
        x=x,
        params=params,
        covar=errors.covar,
        chisqr=goodness.chisqr,
        redchi=goodness.redchi,
        ndata=problem.n_data,
        nvarys=goodness.nvarys,
        nfree=goodness.nfree,
        aic=goodness.aic,
        bic=goodness.bic,
        success=success,
        message=solution.message if solution is not None else "closed form, no iteration",
        start=start.kind,
        perhaps_local=start.perhaps_local,
        nfev=solution.n_evaluations if solution is not None else 0,
        responses=goodness.responses,
        identifiability=verdict,
        warnings=tuple(warnings),
        noise=errors.noise,
    )


def with_model_uncertainty(fit: FitResult, uncertainty: Float) -> FitResult:
    """The result with the uncertainty of the choice of its model in its covariance and standard errors."""
    names = fit.problem.space.names
    added = np.zeros_like(fit.covar)
    added[: len(names), : len(names)] = uncertainty
    covar, noise = fit.covar + added, fit.noise
    if noise is not None and noise.shares:
        noise = replace(noise, shares=(*noise.shares, added), freedom=(*noise.freedom, float("inf")))
    params = dict(fit.params)
    for i, name in enumerate(names):
        if params[name].resolved and fit.success:
            freedom = params[name].freedom if noise is None else noise.degrees(np.eye(len(covar))[i])
            params[name] = replace(params[name], stderr=float(np.sqrt(covar[i, i])), freedom=freedom)
    return replace(fit, covar=covar, params=params, noise=noise, model_uncertainty=uncertainty)


def inverse_curvature(fit: FitResult) -> Float:
    """Change of the estimate by the slope of the cost, shape ``(p, p)``: mostly ``covar`` itself."""
    noise = fit.noise
    wider = noise is not None and (noise.robust or noise.correlated)
    wider = wider or fit.model_uncertainty is not None or (fit.noise is not None and bool(fit.noise.possible_effects))
    return fit.covar if fit.problem.loss == "linear" and not wider else covariance.inverse_curvature(fit.problem, fit.x)
