"""The verdict on a solved problem: errors, goodness of fit, identifiability, sentences worth reading."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from rotorfit.base.array_types import ComplexArray, Float, Index
from rotorfit.base.digits import significant
from rotorfit.base.units import RPM_PER_RAD_S
from rotorfit.estimators.blocks.correlated import freedom_of
from rotorfit.estimators.inference import covariance
from rotorfit.estimators.inference.identifiability import Identifiability, along_valley, diagnose
from rotorfit.estimators.inference.joint_errors import JointErrors
from rotorfit.estimators.inference.projected_errors import MOST_ENTRIES_TOGETHER, projected_errors
from rotorfit.estimators.minimisation.least_squares import Solution, Status
from rotorfit.estimators.minimisation.projection import Projection
from rotorfit.estimators.misfit.parameter_space import DATUM, ParameterSpace
from rotorfit.estimators.misfit.problem import Derivatives, Problem, robust_weights
from rotorfit.estimators.starting.closed_form import ClosedForm
from rotorfit.estimators.starting.start_points import Start
from rotorfit.identify.fitting.causes.solution import JointSearch, SolvedCauses, shifted
from rotorfit.identify.fitting.causes.table import size_warnings
from rotorfit.identify.fitting.noise.error_bars import shares_of_possible_effects, with_scatter, with_shares
from rotorfit.identify.fitting.noise.record import is_run_effect
from rotorfit.identify.fitting.noise.residual_study import (
    MODEL_LIMITED_REDCHI,
    ResidualStudy,
    is_misfit,
    largest_redchi,
)
from rotorfit.identify.fitting.noise.scatter import BadLines, bad_lines, one_component
from rotorfit.identify.fitting.possible import impossible
from rotorfit.identify.fitting.problem_setup import with_noise_of_data
from rotorfit.identify.fitting.quantities import FittedParameter, ResponseQuality
from rotorfit.identify.fitting.result import FitResult, noise_known_from
from rotorfit.identify.fitting.settings import FitSettings
from rotorfit.lab.data.findings import BAD_LINES, Finding
from rotorfit.lab.data.rows import Experiment
from rotorfit.models import BLOCKS, RotorModel
from rotorfit.models.motion.stability import growing, stability_band
from rotorfit.models.parameters import bare_name

_MEANING = {
    "phase": ("rad", "offset of the phase reference"),
    DATUM: ("rad", "common datum angle: lead of responses over forces"),
}


def judge(
    problem: Problem,
    experiments: tuple[Experiment, ...],
    settings: FitSettings,
    start: Start,
    solved: Solution | ClosedForm,
    notes: Sequence[Finding] = (),
    noise: ResidualStudy | None = None,
    beside: JointSearch | None = None,
) -> FitResult:
    """The result of a solved problem, ``beside`` causes that were solved with it, or of a closed form."""
    x = np.concatenate([solved.x, np.zeros(problem.space.size - solved.x.size)])
    derivatives = Derivatives(problem, x)
    residuals = derivatives.residuals
    goodness = _goodness(problem, settings, x, residuals, beside)
    redchi, nfree = goodness["redchi"], goodness["nfree"]
    found = _estimated_errors(settings, derivatives, redchi, nfree, solved, noise, beside)
    covar, verdict, noise, errors = found.covar, found.identifiability, found.noise, found.beside
    causes = None if beside is None or errors is None else beside.solved(errors)
    settings = replace(settings, solved=causes)
    params = _parameters(problem.space, x, start.x, covar, found.degrees, verdict.unresolved, causes)
    plain, begin = problem, x
    if beside is not None:  # without the causes that were found
        plain, begin = shifted(problem, [-part for part in beside.shift]), beside.plain[: x.size]
    alone = None
    if redchi > MODEL_LIMITED_REDCHI:
        alone = bad_lines(*with_noise_of_data(plain, settings, begin), MODEL_LIMITED_REDCHI)
    notices = [*notes, *fit_warnings(problem, x, redchi, params, verdict, settings, noise, alone)]
    notices += [_warning("cause-size", text) for text in size_warnings(causes)]
    if redchi <= max(largest_redchi(noise, nfree, noise_known_from(problem)), MODEL_LIMITED_REDCHI):
        notices += [_warning("impossible-value", text) for text in impossible(plain, begin, params)]
    success, method, message, evaluations = True, "closed form", "closed form, no iteration", 0
    if isinstance(solved, Solution):
        # A minimum along a whole line is one: the identifiability verdict names the line.
        success = solved.success or solved.status is Status.SINGULAR
        method, message, evaluations = "least squares", solved.message, solved.n_evaluations
        if success and explains_nothing(problem, solved):
            success, message = False, _NOTHING
    if not success:  # where a search stalled the curvature tells nothing of the error
        params = {n: replace(p, stderr=np.nan) if p.vary else p for n, p in params.items()}
        text = f"the optimisation did not converge, so no standard errors are given: {message}"
        notices.insert(0, _warning("not-converged", text))
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
        message=message,
        start=start.kind,
        perhaps_local=start.perhaps_local,
        nfev=evaluations,
        identifiability=verdict,
        notices=tuple(notices),
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
    wider = wider or fit.model_uncertainty is not None or fit.settings.solved is not None
    return fit.covar if fit.problem.loss == "linear" and not wider else covariance.inverse_curvature(fit.problem, fit.x)


def redchi_of(problem: Problem, solution: Solution) -> float:
    """redchi of a solution before anything is known of its noise."""
    return 2 * solution.cost * covariance.per_freedom(problem.loss, problem.n_data - problem.space.size)


def explains(problem: Problem, solution: Solution) -> bool:
    """True of a solution that leaves no more than noise does, by :attr:`FitResult.largest_redchi`."""
    most = largest_redchi(None, problem.n_data - problem.space.size, noise_known_from(problem))
    return redchi_of(problem, solution) <= most


_NOTHING = "nothing explained: the residuals are as large as the readings, as where no value matters any more"


def explains_nothing(problem: Problem, solution: Solution) -> bool:
    """True on a plateau, where the rotor that was found hardly answers: residuals as large as the readings are no
    noise. By their sum and by their median, which one that is far off does not move."""
    least_redchi, least_share = 10.0, 0.9  # redchi, and residual over reading, that noise alone does not leave
    if problem.loss != "linear" or len(problem.responses) < len(problem.blocks):
        return False
    if not redchi_of(problem, solution) > least_redchi:
        return False
    size, left = np.abs(problem.measured / problem.sigma), np.abs(problem.residuals(solution.x))
    share = _share_missed(problem, solution.x)
    return bool(share > least_share and np.linalg.norm(left) > least_share * np.linalg.norm(size))


def _share_missed(problem: Problem, x: Float) -> float:
    """Share of a reading that the model misses, which half of the readings exceed."""
    size, left = np.abs(problem.measured / problem.sigma), np.abs(problem.residuals(x))
    return float(np.median(left / np.where(size > 0, size, np.inf)))


# ---- goodness of fit -------------------------------------------------------------------------------------------------


def _goodness(
    problem: Problem, settings: FitSettings, x: Float, residuals: ComplexArray, beside: JointSearch | None
) -> dict[str, Any]:
    """Fields of the result that say how well an estimate agrees with the data, by the noise of the data, whatever
    weights the fit gave them. Models are compared without causes, which would stand for what one of them lacks."""
    given, before = with_noise_of_data(problem, settings, x)
    count = given.space.size
    size2 = np.abs(residuals if given is problem else given.residuals(before)) ** 2
    # A nuisance entry with a prior brings the datum that pays for it.
    nfree = problem.n_data - count + sum(prior.entry >= len(problem.space.names) for prior in given.priors)
    chisqr = float(size2.sum())
    deviance = alone = chisqr if problem.loss == "linear" else float(robust_weights(problem.loss, size2)[0].sum())
    if beside is not None:
        plain = shifted(given, [-part for part in beside.shift])
        without = np.abs(plain.residuals(beside.plain[:count])) ** 2
        alone = float(robust_weights(problem.loss, without)[0].sum())
    return {
        "chisqr": chisqr,
        "redchi": deviance * covariance.per_freedom(problem.loss, nfree),
        "nvarys": count,
        "nfree": nfree,
        "aic": alone + 2 * count,
        "bic": alone + count * float(np.log(problem.n_data)),
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


@dataclass(frozen=True, eq=False, kw_only=True)
class _Errors:
    """Errors of an estimate."""

    covar: Float  # covariance, shape ``(p, p)``
    degrees: tuple[float, ...]  # degrees of freedom of each entry's error
    identifiability: Identifiability  # what the data determine
    noise: ResidualStudy | None  # the study of the residuals with its share in the errors
    beside: JointErrors | None  # of causes that were solved with it


def _estimated_errors(
    settings: FitSettings,
    derivatives: Derivatives,
    redchi: float,
    nfree: int,
    solved: Solution | ClosedForm,
    noise: ResidualStudy | None,
    beside: JointSearch | None,
) -> _Errors:
    """Errors of an estimate, widened where the model or the residuals ask for it and by causes."""
    problem, x, residuals = derivatives.problem, derivatives.x, derivatives.residuals
    space = problem.space
    names, base = (*space.names, *space.nuisance), (*space.base, *space.nuisance)
    scales, sandwich = covariance.parameter_scales(problem, x), None
    projection = Projection.of(problem) if x.size > MOST_ENTRIES_TOGETHER else None
    if projection is not None:
        scattered, verdict = projected_errors(projection, x, scales)
    else:
        root, sandwich = covariance.information(problem, x, residuals, derivatives)
        scattered, verdict = diagnose(space.model, names, base, x, root, scales)
    if sandwich is not None:
        weighing = covariance.weighing_error(problem, derivatives.whole, scattered)
        scattered = scattered @ sandwich @ scattered + weighing
    if isinstance(solved, ClosedForm):
        scattered = np.where(np.isfinite(solved.covar), solved.covar, np.nan)
    else:
        verdict = along_valley(problem, x, scattered, scales, verdict)
    known = freedom_of(problem.blocks)
    widening = covariance.widening(redchi, problem.loss, rescaled=settings.rescaled, nfree=nfree, freedom=known)
    covar = scattered if widening == 1 else scattered * widening
    if problem.priors and widening > 1 and sandwich is None:
        # what is known beforehand is no less certain for a model that does not fit
        wide = covariance.information(problem, x, residuals, derivatives, widening=widening)[0]
        covar = diagnose(space.model, names, base, x, wide, scales)[0]
    if noise is not None:
        covar, noise = with_scatter(noise, problem, residuals, derivatives, scattered, covar, widening)
        possible = shares_of_possible_effects(noise, problem, x, derivatives, scattered)
        noise = with_shares(noise, settings, problem, x, covar, possible)
        covar = sum(possible, covar)
    freedom = min(known, float(nfree)) if widening > 1 and np.isfinite(known) else known
    errors = None
    if beside is not None:
        errors = beside.errors(widening)
        covar = covar + errors.covariance
        if noise is not None:
            noise = replace(noise, shares=(*noise.shares, errors.covariance), freedom=(*noise.freedom, math.inf))
    degrees = (freedom,) * space.size if noise is None else noise.own_degrees()
    return _Errors(covar=covar, degrees=degrees, identifiability=verdict, noise=noise, beside=errors)


def _parameters(
    space: ParameterSpace,
    x: Float,
    begin: Float,
    covar: Float,
    degrees: Sequence[float],
    unresolved: Sequence[str],
    solved: SolvedCauses | None,
) -> dict[str, FittedParameter]:
    """Parameters by name, fitted and known, in the model's order."""
    # With priors or tight noise a variance may come out as -0.
    wide = np.sqrt(np.maximum(np.diag(covar), 0.0)).tolist()
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
            plain=values[i] if solved is None else float(solved.plain[i]),
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
    theta = space.theta(x)[0]
    # Values that were taken as known have causes of their names.
    wider = 1.0 if solved is None else math.sqrt(solved.errors.widened)
    off = {cause.name: wider * deviation for cause, _, deviation in solved or ()}
    for place, known in enumerate(space.model.parameters):
        if (space.index[:, place] < 0).all():
            value = float(theta[place])
            entries[known.name] = FittedParameter(
                name=known.name,
                value=value,
                stderr=off.get(known.name, 0.0),
                init_value=value,
                unit=known.unit,
                meaning=known.meaning,
                min=known.lower,
                max=known.upper,
                vary=False,
            )
    order = {name: i for i, name in enumerate(space.model.parameter_names)}
    return dict(sorted(entries.items(), key=lambda item: order.get(bare_name(item[0]), len(order))))


# ---- sentences worth reading -----------------------------------------------------------------------------------------


def _warning(code: str, text: str) -> Finding:
    """A warning of the fit itself."""
    return Finding("warning", code, text, origin="fit")


def of_start(notes: Iterable[str]) -> list[Finding]:
    """What had to be assumed where the search began, or is in doubt of it, as warnings."""
    return [_warning("start", note) for note in notes]


EXACT_REDCHI = 1e-4  # redchi below which the data are exact, and their noise the floor that keeps weights finite

_FILTERED = (
    "Noise that is correlated along the lines, as behind overlapping filters, looks the same where sigma is not "
    "known: standard errors include that too. Give sigma_um as repeated sweeps show it, to separate them"
)


def fit_warnings(
    problem: Problem,
    x: Float,
    redchi: float,
    params: Mapping[str, FittedParameter],
    identifiability: Identifiability,
    settings: FitSettings,
    noise: ResidualStudy | None,
    alone: BadLines | None,
) -> Iterator[Finding]:
    """Warnings for a reader of the result; ``alone``: lines that alone miss it."""
    if alone is not None:
        yield _warning(BAD_LINES, alone.sentence(redchi))
        yield from _of_values(problem, x, params, identifiability)
        return
    for block, predicted in zip(problem.blocks, problem.predict(x), strict=True):
        for code, text in block.doubts(problem.space.theta(x), predicted):
            yield _warning(code, text)
    if noise is not None:
        yield from noise.warnings(redchi, _of_scatter(problem, x, params))
    rescaled = bool(settings.noise_scale)
    advice = _advice(problem, identifiability, rescaled or settings.refined)
    nfree = problem.n_data - problem.space.size
    misfit = covariance.widening(redchi, problem.loss, nfree=nfree, freedom=freedom_of(problem.blocks))
    if is_misfit(noise, misfit):
        where = f". It misses most: {', '.join(noise.places)}" if noise is not None and noise.places else ""
        wider = "the residuals of each response" if rescaled else significant(np.sqrt(redchi), 2)
        other = f". {_FILTERED}" if noise is not None and noise.perhaps_filtered else ""
        text = (
            f"redchi is {significant(redchi, 3)}: the model, not the noise, limits this fit. Standard errors are "
            f"widened by {wider}, but parameters may be biased beyond them; {advice}{where}{other}"
        )
        yield _warning("misfit", text)
    if noise is not None and noise.odd_run and redchi > MODEL_LIMITED_REDCHI:
        yield _warning("odd-run", noise.odd_run)
    quiet_deviations = 6.0  # standard deviations of redchi below one at which the noise is too large for the residuals
    quiet_redchi = 0.5  # redchi below which errors are wider than they need be by more than is worth knowing
    if EXACT_REDCHI < redchi < min(quiet_redchi, 1 - quiet_deviations * np.sqrt(2 / max(nfree, 1))):
        text = (
            f"redchi is {significant(redchi, 2)}: the noise is overestimated, and standard errors are about "
            f"{significant(1 / np.sqrt(redchi), 2)} times too wide. Give the noise of the readings (sigma_um), "
            "or more lines"
        )
        yield _warning("noise-overestimated", text)
    if problem.loss != "linear":
        # the median of |r|^2 is 2 ln 2 for noise alone, and hardly moves for a few outliers
        typical = float(np.median(np.abs(problem.residuals(x)) ** 2)) / (2 * np.log(2))
        if typical > MODEL_LIMITED_REDCHI:
            text = (
                f"the squared residuals of most readings are {significant(typical, 2)} times those of the noise: not "
                f"outliers but the model limits this fit, and parameters may be biased; {advice}"
            )
            yield _warning("misfit", text)
    yield from _of_values(problem, x, params, identifiability)


def _of_scatter(problem: Problem, x: Float, params: Mapping[str, FittedParameter]) -> str:
    """What readings scatter for, in words."""
    bound = ", ".join(p.name for p in params.values() if p.at_bound)
    if bound:
        return f"as where a bound keeps the model from the data ({bound}: widen it, or free what is known)"
    part = one_component(problem, x)
    if part:
        return f"and only in their {part}, as where noise was simulated in one component"
    most_jitter = 0.1  # of a reading, that hardly any force or speed jitters by. Chosen
    if (missed := _share_missed(problem, x)) > most_jitter:
        return (
            f"half of them by {significant(100 * missed, 2)} % of their size or more, which is no jitter: the model "
            "misses a mode or a direction, or lines are too far apart for its resonance"
        )
    return "as where a force or a speed jitters"


def _of_values(
    problem: Problem, x: Float, params: Mapping[str, FittedParameter], identifiability: Identifiability
) -> Iterator[Finding]:
    """Warnings of values that rest on bounds, that these lines cannot tell, and of speeds without stability."""
    for p in params.values():
        if p.at_bound:
            unit = "" if p.unit == "1" else f" {p.unit}"
            yield _warning("at-bound", f"{p.name} rests on its bound at {p.value:.6g}{unit}")
    lines = frozenset[str]().union(*(block.shaft_lines for block in problem.blocks))
    if lines == {"w"} and identifiability.unresolved:
        left = ", ".join(identifiability.unresolved)
        text = (
            f"these data hold the motion at w alone, which leaves {left} open: a shaft of unequal stiffness shows in "
            "the image at 2x - w and in its twist. Of recordings rf.shaft_lines reads these lines, not rf.responses"
        )
        yield _warning("one-line", text)
    for text in _instability(problem, x, identifiability.unresolved):
        yield _warning("unstable", text)


_ROTOR_MOVES = (
    "if the rotor moves too, make forces F - M a by accelerometers on the stator (stator=, --stator): probes that read "
    "relative to the rotor mistake the stator's inertia"
)


def _advice(problem: Problem, identifiability: Identifiability, refined: bool) -> str:
    """Advice for a fit that its model limits: structural blocks only where more can be added."""
    model = problem.space.model
    if model.advice:
        return model.advice
    moving = _ROTOR_MOVES if any(block.beside is not None for block in problem.responses) else ""
    for block in problem.responses:  # motion along x and y under forces along one of them
        along = [block.force[:, [c.axis == axis for c in model.coordinates]].any(axis=1) for axis in "xy"]
        if (along[0] ^ along[1]).any():
            return (
                "forces are given along one axis at a time: if the other shaker pushes too, give what both load cells "
                f"say (force_x_N, force_y_N){f'; {moving}' if moving else ''}"
            )
    if moving or not hasattr(model, "blocks"):
        return moving or f"{model.name} has no structural blocks to add; a model of more planes may fit"
    if refined or len(model.blocks) == len(BLOCKS):
        return "bring the shaft's matrices (KnownStructure)"
    if why_not_refined(model, identifiability):
        left = ", ".join(identifiability.unresolved)
        return f"give known values or priors for what the data leave open first ({left})"
    return "try a refined model (rf.refine, --refine)"


def _instability(problem: Problem, x: Float, unresolved: Sequence[str]) -> list[str]:
    """Speeds at which a rotor with the fitted values could not have been tested, three at most."""
    theta = problem.space.theta(x)
    model = problem.space.model
    found: list[str] = []
    left = ", ".join(unresolved)
    remedy = "Check signs, directions and the model"
    if left:
        remedy = f"These data leave {left} open: give known values or priors before you look for an error in the data"
    for block in problem.responses:
        if block.imposed or not block.frequency.any() or block.beside is not None:
            continue  # centred it might not run where a static load holds it, nor without the rig that was taken out
        _, group, speed = block.at_set_speed().condition
        band = stability_band(model, float(np.abs(block.frequency).max()))
        rates, grows = growing(model, theta[group], speed, band)
        for v, rate, some in zip(speed, rates, grows, strict=True):
            if some and len(set(found)) < 3:
                where = f"the tested speed of {v * RPM_PER_RAD_S:.0f} rpm" if model.speed_dependent else "any speed"
                found.append(
                    f"the fitted rotor is unstable at {where} (growth rate {significant(rate, 3)} 1/s): a rig could "
                    f"not have been measured there. {remedy}"
                )
    return list(dict.fromkeys(found))


def why_not_refined(model: RotorModel, identifiability: Identifiability) -> str:
    """Why :func:`rotorfit.refine` refuses a fit; empty where it can be tried."""
    if not hasattr(model, "blocks"):
        why = "they couple two or more planes" if len(model.planes) < 2 else "write what it lacks into its equation"
        return f"{model.name} has no structural blocks to add: {why}"
    if identifiability.unresolved:
        return f"resolve the parameters of the plain model before adding to it. {identifiability}"
    return ""
