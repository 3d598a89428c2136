"""The verdict on a solved problem: errors, goodness of fit, identifiability, sentences worth reading."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from rotorfit.data.experiments import Experiment
from rotorfit.estimators import covariance
from rotorfit.estimators.closed_form import ClosedForm
from rotorfit.estimators.correlated import freedom_of
from rotorfit.estimators.identifiability import diagnose
from rotorfit.estimators.least_squares import Solution, Status
from rotorfit.estimators.losses import robust_weights
from rotorfit.estimators.nonlinear import responses_of
from rotorfit.estimators.parameter_space import DATUM
from rotorfit.estimators.problem import Problem
from rotorfit.fitting.calibration import NUISANCE_KINDS
from rotorfit.fitting.noise_judging import MODEL_LIMITED, as_residuals_ask, is_misfit, noise_warnings, with_shares
from rotorfit.fitting.noise_problem import estimate_before, without_noise
from rotorfit.fitting.noise_record import Noise, NoiseVerdict, is_run_effect
from rotorfit.fitting.problem_setup import with_levels
from rotorfit.fitting.quantities import FittedParameter, ResponseQuality
from rotorfit.fitting.result import FitResult
from rotorfit.fitting.settings import FitSettings
from rotorfit.models import BLOCKS, Modal, RotorModel
from rotorfit.models.array_types import Float, Index
from rotorfit.models.parameters import bare_name
from rotorfit.models.stability import growth_rate
from rotorfit.units import RPM_PER_RAD_S

_MEANING = {
    "phase": ("rad", "offset of the phase reference"),
    DATUM: ("rad", "common datum angle: lead of responses over forces"),
    **NUISANCE_KINDS,
}

_CLEARLY = 6.0  # standard deviations of redchi below one at which the noise is too large for the residuals
_TOO_QUIET = 0.5  # redchi below which errors are wider than they need be by more than is worth knowing
_NOISE_FLOOR = 1e-4  # redchi below which the data are exact, and their noise the floor that keeps weights finite


def judge(
    problem: Problem,
    experiments: tuple[Experiment, ...],
    settings: FitSettings,
    x: Float,
    begin: Float,
    method: str,
    solution: Solution | None,
    notes: tuple[str, ...],
    estimate: ClosedForm | None = None,
    noise: Noise | None = None,
) -> FitResult:
    """The result of a solved problem, or of a closed form.

    Args:
        problem, experiments, settings: what was asked, see :func:`rotorfit.fitting.problem_setup.build_problem`.
        x: estimate; nuisance entries that it lacks are zero.
        begin: where the search began.
        method: "least squares" or "closed form".
        solution: how the search ended, of least squares.
        notes: warnings that came up on the way.
        estimate: the closed form with its covariance, where that is the method.
        noise: what the residuals are, where that was looked into.
    """
    space = problem.space
    x = np.concatenate([x, np.zeros(space.size - x.size)])
    residuals, jacobian = problem.jacobian(x)
    given = problem if settings.noise is None else without_noise(problem, settings.noise)
    given = with_levels(given, settings.levels, -1)  # goodness of fit refers to the noise of the data
    count = given.space.size
    before = estimate_before(settings.noise, x, count)
    whitened = residuals if given is problem else given.residuals(before)
    # A nuisance entry with a prior brings the datum that pays for it.
    paid = sum(prior.entry >= len(space.names) for prior in given.priors)
    chisqr, nfree = float(np.sum(np.abs(whitened) ** 2)), problem.n_data - count + paid
    redchi = covariance.reduced_chi_square(problem, whitened, nfree)
    root, sandwich = covariance.information(problem, x, residuals, jacobian)
    scales = covariance.natural_sizes(problem, x)
    names = (*space.names, *space.nuisance)
    base = (*space.base, *space.nuisance)
    scattered, verdict = diagnose(space.model, names, base, x, root, scales)
    if sandwich is not None:
        weighing = covariance.weighing_error(problem, jacobian, scattered)
        scattered = scattered @ sandwich @ scattered + weighing
    if estimate is not None:
        scattered = np.where(np.isfinite(estimate.covar), estimate.covar, np.nan)
    known = freedom_of(problem.blocks)
    widening = covariance.widening(redchi, problem.loss, levelled=settings.levelled, nfree=nfree, freedom=known)
    covar = scattered * widening
    if problem.priors and widening > 1 and sandwich is None:
        # what is known beforehand is no less certain for a model that does not fit
        wide = covariance.information(problem, x, residuals / np.sqrt(widening), jacobian / np.sqrt(widening))[0]
        covar = diagnose(space.model, names, base, x, wide, scales)[0]
    if noise is not None:
        covar, noise = as_residuals_ask(noise, problem, residuals, jacobian, scattered, covar, widening)
        noise = with_shares(noise, settings, problem, x, covar)
    deviance = float(robust_weights(problem.loss, np.abs(whitened) ** 2)[0].sum())
    freedom = min(known, float(nfree)) if widening > 1 and np.isfinite(known) else known
    degrees = [freedom if noise is None else noise.degrees(row) for row in np.eye(space.size)]
    # A minimum along a whole line is one: the identifiability verdict names the line.
    success = solution is None or solution.success or solution.status is Status.SINGULAR
    params = _parameters(problem, x, begin, scattered, covar, degrees, verdict.unresolved)
    if not success:  # where a search stalled the curvature tells nothing of the error
        params = {n: replace(p, stderr=np.nan, stderr_noise=np.nan) if p.vary else p for n, p in params.items()}
    warnings = [*notes, *_warnings(problem, x, redchi, params, bool(settings.levels), noise)]
    if solution is not None and not success:
        warnings.insert(0, f"the optimisation did not converge, so that nothing has an error: {solution.message}")
    return FitResult(
        model=space.model,
        experiments=experiments,
        settings=settings,
        method=method,
        problem=problem,
        x=x,
        params=params,
        covar=covar,
        chisqr=chisqr,
        redchi=redchi,
        ndata=problem.n_data,
        nvarys=count,
        nfree=nfree,
        aic=deviance + 2 * count,
        bic=deviance + count * float(np.log(problem.n_data)),
        success=success,
        message=solution.message if solution is not None else "closed form, no iteration",
        nfev=solution.n_evaluations if solution is not None else 0,
        responses=_qualities(given, before),
        identifiability=verdict,
        warnings=tuple(warnings),
        noise=noise,
    )


def inverse_curvature(fit: FitResult) -> Float:
    """Change of the estimate by the slope of the cost, shape ``(p, p)``: mostly ``covar`` itself."""
    wider = fit.noise is not None and (fit.noise.robust or fit.noise.verdict is NoiseVerdict.FOLLOWING)
    return fit.covar if fit.problem.loss == "linear" and not wider else covariance.inverse_curvature(fit.problem, fit.x)


def _parameters(
    problem: Problem,
    x: Float,
    begin: Float,
    scattered: Float,
    covar: Float,
    degrees: Sequence[float],
    unresolved: Sequence[str],
) -> dict[str, FittedParameter]:
    space = problem.space
    begin = np.concatenate([begin, np.zeros(space.size - begin.size)])
    # With priors or tight noise a variance may come out as -0.
    error, wide = (np.sqrt(np.maximum(np.diag(matrix), 0.0)) for matrix in (scattered, covar))
    entries: dict[str, FittedParameter] = {}
    for i, name in enumerate((*space.names, *space.nuisance)):
        if is_run_effect(name):
            continue
        known_to_model = i < len(space.names)
        meta = space.model.parameter(space.base[i]) if known_to_model else None
        unit, meaning = (meta.unit, meta.meaning) if meta else _MEANING[bare_name(name)]
        resolved = name not in unresolved
        span = max(abs(float(x[i])), 1e-12)
        at_bound = bool(min(x[i] - space.lower[i], space.upper[i] - x[i]) <= 1e-7 * span)
        entries[name] = FittedParameter(
            name=name,
            value=float(x[i]),
            stderr=float(wide[i]) if resolved else float("inf"),
            stderr_noise=float(error[i]) if resolved else float("inf"),
            init_value=float(begin[i]),
            unit=unit,
            meaning=meaning,
            min=float(space.lower[i]),
            max=float(space.upper[i]),
            vary=True,
            resolved=resolved,
            at_bound=at_bound,
            freedom=degrees[i],
        )
    theta = space.theta(x)
    for place, meta in enumerate(space.model.parameters):
        if (space.index[:, place] < 0).all():
            value = float(theta[0, place])
            entries[meta.name] = FittedParameter(
                name=meta.name,
                value=value,
                stderr=0.0,
                stderr_noise=0.0,
                init_value=value,
                unit=meta.unit,
                meaning=meta.meaning,
                min=meta.lower,
                max=meta.upper,
                vary=False,
            )
    order = {name: i for i, name in enumerate(space.model.parameter_names)}
    last = len(order)
    return dict(sorted(entries.items(), key=lambda item: order.get(bare_name(item[0]), last)))


def _warnings(
    problem: Problem,
    x: Float,
    redchi: float,
    params: Mapping[str, FittedParameter],
    levelled: bool,
    noise: Noise | None,
) -> list[str]:
    found = [] if noise is None else noise_warnings(noise, redchi)
    nfree = problem.n_data - problem.space.size
    misfit = covariance.widening(redchi, problem.loss, nfree=nfree, freedom=freedom_of(problem.blocks))
    if is_misfit(noise, misfit):
        where = f". It misses most: {', '.join(noise.places)}" if noise is not None and noise.places else ""
        wider = "each response as its residuals ask" if levelled else f"{np.sqrt(redchi):.2g}"
        advice = _advice(problem.space.model, levelled)
        found.append(
            f"redchi is {redchi:.3g}: the model, not the noise, limits this fit. Standard errors are widened by "
            f"{wider}, but parameters may be biased beyond them; {advice}{where}"
        )
    chance = np.sqrt(2 / max(problem.n_data - problem.space.size, 1))
    if _NOISE_FLOOR < redchi < min(_TOO_QUIET, 1 - _CLEARLY * chance):
        found.append(
            f"redchi is {redchi:.2g}: the noise is overestimated, and standard errors are about "
            f"{1 / np.sqrt(redchi):.2g} times too wide. Give the noise of the readings (sigma_um), or more lines"
        )
    if problem.loss != "linear":
        # the median of |r|^2 is 2 ln 2 for noise alone, and hardly moves for a few outliers
        typical = float(np.median(np.abs(problem.residuals(x)) ** 2)) / (2 * np.log(2))
        if typical > MODEL_LIMITED:
            found.append(
                f"the squared residuals of most readings are {typical:.2g} times those of the noise: not outliers but "
                f"the model limits this fit, and parameters may be biased; {_advice(problem.space.model, levelled)}"
            )
    found += [
        f"{p.name} rests on its bound at {p.value:.6g}{'' if p.unit == '1' else ' ' + p.unit}"
        for p in params.values()
        if p.at_bound
    ]
    return found + _instability(problem, x)


def _advice(model: RotorModel, levelled: bool) -> str:
    """What may help a fit that its model limits: blocks between planes only where there are several, and some left."""
    if isinstance(model, Modal):
        return "modes left out do so, or supports that differ in x and y (apart)"
    if not hasattr(model, "blocks"):
        return f"{model.name} has no structural blocks to add; a model of more planes may explain them"
    if levelled or len(model.blocks) == len(BLOCKS):
        return "bring the shaft's matrices (KnownStructure)"
    return "try rf.refine(fit) (--refine)"


def _instability(problem: Problem, x: Float) -> list[str]:
    theta = problem.space.theta(x)
    model = problem.space.model
    found: list[str] = []
    for block in map(responses_of, problem.blocks):
        if block is None or block.imposed or not block.frequency.any():
            continue  # under a static load the journal may run where centred it could not
        _, group, speed = block.condition
        band = float(np.abs(block.frequency).max()) if model.order > 2 else np.inf
        rates = growth_rate(model, theta[group], speed, band)
        for g, v, rate in zip(group, speed, rates, strict=True):
            size = np.abs(theta[g]).max()
            if rate > 1e-9 * size and len(found) < 3:
                found.append(
                    f"the fitted rotor is unstable at the tested speed of {v * RPM_PER_RAD_S:.0f} rpm (growth rate "
                    f"{rate:.3g} 1/s): a rig could not have been measured there. Check signs, directions and the model"
                )
    return found


def _qualities(problem: Problem, x: Float) -> tuple[ResponseQuality, ...]:
    result = []
    for block, predicted in zip(problem.blocks, problem.predict(x), strict=True):
        label, size = block.label, len(block.labels)
        miss = np.abs(predicted - block.measured) ** 2
        product = predicted.conj() * block.measured

        def total(values: Float, label: Index = label, size: int = size) -> Float:
            return np.asarray(np.bincount(label, weights=values, minlength=size), dtype=float)

        count = np.bincount(label, minlength=size)
        missed, power = total(miss), total(np.abs(block.measured) ** 2)
        both = power * total(np.abs(predicted) ** 2)
        common = total(product.real) ** 2 + total(product.imag) ** 2
        fraction = np.divide(common, both, out=np.zeros(size), where=both > 0)
        nrmse = np.sqrt(missed / np.maximum(power, 1e-300))
        redchi = total(miss / block.sigma**2) / count / 2
        columns = zip(block.labels, nrmse.tolist(), fraction.tolist(), redchi.tolist(), count.tolist(), strict=True)
        result += [ResponseQuality(name=n, nrmse=e, frac=f, redchi=c, count=k) for n, e, f, c, k in columns]
    return tuple(result)
