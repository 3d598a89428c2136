"""The verdict on a solved problem: errors, goodness of fit, identifiability, sentences worth reading."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from rotorfit.data.experiments import Experiment
from rotorfit.estimators.blocks.correlated import freedom_of
from rotorfit.estimators.inference import covariance
from rotorfit.estimators.inference.identifiability import Identifiability, along_valley, diagnose
from rotorfit.estimators.minimisation.least_squares import Solution, Status
from rotorfit.estimators.misfit.parameter_space import DATUM, ParameterSpace
from rotorfit.estimators.misfit.problem import Problem, robust_weights
from rotorfit.estimators.starting.closed_form import ClosedForm
from rotorfit.estimators.starting.start_points import Start
from rotorfit.fitting.assumptions.calibration import NUISANCE_KINDS
from rotorfit.fitting.fit_warnings import fit_warnings
from rotorfit.fitting.noise.error_bars import shares_of_possible_effects, with_scatter, with_shares
from rotorfit.fitting.noise.record import is_run_effect
from rotorfit.fitting.noise.residual_study import ResidualStudy
from rotorfit.fitting.problem_setup import with_noise_of_data
from rotorfit.fitting.quantities import FittedParameter, ResponseQuality
from rotorfit.fitting.result import FitResult
from rotorfit.fitting.settings import FitSettings
from rotorfit.models.array_types import ComplexArray, Float, Index
from rotorfit.models.parameters import bare_name

_MEANING = {
    "phase": ("rad", "offset of the phase reference"),
    DATUM: ("rad", "common datum angle: lead of responses over forces"),
    **NUISANCE_KINDS,
}


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
    goodness = _goodness(problem, settings, x, residuals)
    redchi, nfree = goodness["redchi"], goodness["nfree"]
    scattered, covar, degrees, verdict, noise = _standard_errors(
        problem, settings, x, residuals, jacobian, redchi, nfree, estimate, noise
    )
    params = _parameters(problem.space, x, start.x, scattered, covar, degrees, verdict.unresolved)
    # A minimum along a whole line is one: the identifiability verdict names the line.
    success = solution is None or solution.success or solution.status is Status.SINGULAR
    if not success:  # where a search stalled the curvature tells nothing of the error
        params = {n: replace(p, stderr=np.nan, stderr_noise=np.nan) if p.vary else p for n, p in params.items()}
    warnings = [*notes, *fit_warnings(problem, x, redchi, params, verdict, bool(settings.noise_scale), noise)]
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
        covar=covar,
        ndata=problem.n_data,
        **goodness,
        success=success,
        message=solution.message if solution is not None else "closed form, no iteration",
        start=start.kind,
        perhaps_local=start.perhaps_local,
        nfev=solution.n_evaluations if solution is not None else 0,
        identifiability=verdict,
        warnings=tuple(warnings),
        noise=noise,
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
    wider = noise is not None and (noise.robust or noise.correlated or bool(noise.possible_effects))
    wider = wider or fit.model_uncertainty is not None
    return fit.covar if fit.problem.loss == "linear" and not wider else covariance.inverse_curvature(fit.problem, fit.x)


# ---- goodness of fit -------------------------------------------------------------------------------------------------


def _goodness(problem: Problem, settings: FitSettings, x: Float, residuals: ComplexArray) -> dict[str, Any]:
    """Fields of the result that say how well an estimate agrees with the data, by the noise of the data, whatever
    weights the fit gave them."""
    given, before = with_noise_of_data(problem, settings, x)
    count = given.space.size
    size2 = np.abs(residuals if given is problem else given.residuals(before)) ** 2
    # A nuisance entry with a prior brings the datum that pays for it.
    nfree = problem.n_data - count + sum(prior.entry >= len(problem.space.names) for prior in given.priors)
    chisqr = float(size2.sum())
    deviance = chisqr if problem.loss == "linear" else float(robust_weights(problem.loss, size2)[0].sum())
    return {
        "chisqr": chisqr,
        "redchi": deviance * covariance.per_freedom(problem.loss, nfree),
        "nvarys": count,
        "nfree": nfree,
        "aic": deviance + 2 * count,
        "bic": deviance + count * float(np.log(problem.n_data)),
        "responses": _qualities(given, before),
    }


def _qualities(problem: Problem, x: Float) -> tuple[ResponseQuality, ...]:
    result = []
    for block, predicted in zip(problem.blocks, problem.predict(x), strict=True):
        label, size = block.label, len(block.labels)
        product = predicted.conj() * block.measured

        def total(values: Float, label: Index = label, size: int = size) -> Float:
            return np.asarray(np.bincount(label, weights=values, minlength=size), dtype=float)

        miss = np.abs(predicted - block.measured) ** 2
        count, power = np.bincount(label, minlength=size), total(np.abs(block.measured) ** 2)
        both = power * total(np.abs(predicted) ** 2)
        common = total(product.real) ** 2 + total(product.imag) ** 2
        fraction = np.divide(common, both, out=np.zeros(size), where=both > 0)
        nrmse = np.sqrt(total(miss) / np.maximum(power, 1e-300))
        redchi = total(miss / block.sigma**2) / count / 2
        columns = zip(block.labels, nrmse.tolist(), fraction.tolist(), redchi.tolist(), count.tolist(), strict=True)
        result += [ResponseQuality(name=n, nrmse=e, frac=f, redchi=c, count=k) for n, e, f, c, k in columns]
    return tuple(result)


# ---- errors ----------------------------------------------------------------------------------------------------------


def _standard_errors(
    problem: Problem,
    settings: FitSettings,
    x: Float,
    residuals: ComplexArray,
    jacobian: ComplexArray,
    redchi: float,
    nfree: int,
    estimate: ClosedForm | None,
    noise: ResidualStudy | None,
) -> tuple[Float, Float, tuple[float, ...], Identifiability, ResidualStudy | None]:
    """Covariance of an estimate by the noise alone, shape ``(p, p)``, and widened where the model or the residuals ask
    for it; degrees of freedom of each entry's error, what the data determine, and the study with its share in it."""
    space = problem.space
    root, sandwich = covariance.information(problem, x, residuals, jacobian)
    names, base = (*space.names, *space.nuisance), (*space.base, *space.nuisance)
    scales = covariance.parameter_scales(problem, x)
    scattered, verdict = diagnose(space.model, names, base, x, root, scales)
    if sandwich is not None:
        weighing = covariance.weighing_error(problem, jacobian, scattered)
        scattered = scattered @ sandwich @ scattered + weighing
    if estimate is not None:
        scattered = np.where(np.isfinite(estimate.covar), estimate.covar, np.nan)
    else:
        verdict = along_valley(problem, x, scattered, scales, verdict)
    known = freedom_of(problem.blocks)
    widening = covariance.widening(redchi, problem.loss, rescaled=settings.rescaled, nfree=nfree, freedom=known)
    covar = scattered * widening
    if problem.priors and widening > 1 and sandwich is None:
        # what is known beforehand is no less certain for a model that does not fit
        wide = covariance.information(problem, x, residuals, jacobian, widening=widening)[0]
        covar = diagnose(space.model, names, base, x, wide, scales)[0]
    if noise is not None:
        covar, noise = with_scatter(noise, problem, residuals, jacobian, scattered, covar, widening)
        possible = shares_of_possible_effects(noise, problem, x, jacobian, scattered)
        noise = with_shares(noise, settings, problem, x, covar, possible)
        covar = np.sum([covar, *possible], axis=0)
    freedom = min(known, float(nfree)) if widening > 1 and np.isfinite(known) else known
    degrees = (freedom,) * space.size if noise is None else noise.own_degrees()
    return scattered, covar, degrees, verdict, noise


def _parameters(
    space: ParameterSpace,
    x: Float,
    begin: Float,
    scattered: Float,
    covar: Float,
    degrees: Sequence[float],
    unresolved: Sequence[str],
) -> dict[str, FittedParameter]:
    """Parameters by name, fitted and known, in the model's order."""
    # With priors or tight noise a variance may come out as -0.
    error, wide = (np.sqrt(np.maximum(np.diag(matrix), 0.0)).tolist() for matrix in (scattered, covar))
    values, lower, upper = x.tolist(), space.lower.tolist(), space.upper.tolist()
    first = [*begin.tolist(), *[0.0] * (space.size - begin.size)]
    entries: dict[str, FittedParameter] = {}
    for i, name in enumerate((*space.names, *space.nuisance)):
        if is_run_effect(name):
            continue
        own = space.model.parameter(space.base[i]) if i < len(space.names) else None
        unit, meaning = _MEANING[bare_name(name)] if own is None else (own.unit, own.meaning)
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
    for place, known in enumerate(space.model.parameters):
        if (space.index[:, place] < 0).all():
            entries[known.name] = FittedParameter(
                name=known.name,
                value=theta[place],
                stderr=0.0,
                stderr_noise=0.0,
                init_value=theta[place],
                unit=known.unit,
                meaning=known.meaning,
                min=known.lower,
                max=known.upper,
                vary=False,
            )
    order = {name: i for i, name in enumerate(space.model.parameter_names)}
    return dict(sorted(entries.items(), key=lambda item: order.get(bare_name(item[0]), len(order))))
