"""Fit a model to experiments: closed form, weighted nonlinear least squares, and the verdict on both."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rotorfit.calibration import KINDS, Calibration, nuisance_entries
from rotorfit.estimators.closed_form import ClosedForm, ClosedFormError
from rotorfit.estimators.closed_form import closed_form as solve_closed_form
from rotorfit.estimators.identifiability import covariance, diagnose, natural_scales
from rotorfit.estimators.least_squares import Options, Solution, Status, minimise
from rotorfit.estimators.nonlinear import responses_of
from rotorfit.estimators.observations import Block
from rotorfit.estimators.problem import (
    LOSSES,
    Loss,
    ParameterSpace,
    Prior,
    Problem,
    parameter_space,
    robust_weights,
    within_support,
)
from rotorfit.estimators.small_motion import OffCentreResponses
from rotorfit.estimators.starts import start_vector
from rotorfit.experiments import Experiment
from rotorfit.models import RotorModel
from rotorfit.models.parameters import unknown_name
from rotorfit.models.stability import growth_rate
from rotorfit.observe import group_rows
from rotorfit.observe_all import observe_any
from rotorfit.results import FitResult, FitSettings, FittedParameter, ResponseQuality

Float = NDArray[np.float64]

_MEANING = {"phase": ("rad", "offset of the phase reference"), **KINDS}

_ALONE = 0.05  # share of a reading's residual that its fit leaves at least, in estimates of its noise

MODEL_LIMITED = 2.0
"""redchi above which a result says that the model, not the noise, limits the fit."""


def fit(
    model: RotorModel,
    experiments: Experiment | Sequence[Experiment],
    *,
    known: Mapping[str, float | None] | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    priors: Mapping[str, Any] | None = None,
    per: Mapping[str, str] | None = None,
    loss: Loss = "linear",
    start: Mapping[str, float] | None = None,
    phase_offsets: bool = False,
    calibration: Calibration | None = None,
    max_iterations: int = 200,
) -> FitResult:
    """Fit a model by weighted nonlinear least squares on the complex responses (Ipopt, started from the closed form).

    Args:
        model: the rotor, for instance ``rf.models.WhirlWhip()``.
        experiments: one experiment or a list that informs one parameter vector.
        known: values that are not fitted, SI units; ``None`` frees a parameter that the model fixes by default.
        bounds: lower and upper bounds by parameter name.
        priors: frozen ``scipy.stats`` distributions by parameter name.
        per: parameters that take one value for each value of a test attribute, ``{"D": "speed_rpm"}``.
        loss: "linear", or "soft_l1", "huber", "cauchy" against outliers.
        start: start values that replace those of the closed form.
        phase_offsets: fit an offset of the phase reference for every run but the first.
        calibration: uncertainties of probes, force and phase reference, which then count in ``stderr``.
        max_iterations: limit on the iterations of Ipopt.

    Returns:
        the result; a fit that did not converge has ``success`` false and the best estimate found.

    Raises:
        KeyError: unknown parameter names; the message names the nearest.
        ValueError: data that do not fit the model, contradictory bounds, more unknowns than data.
    """
    settings = FitSettings(
        known or {}, bounds or {}, priors or {}, per or {}, loss, phase_offsets, calibration=calibration
    )
    problem = build_problem(model, experiments, settings)
    begin, notes = start_vector(problem, start or {})
    solution = _solve(problem, begin, Options(max_iterations=max_iterations))
    return _result(problem, as_tuple(experiments), settings, solution.x, begin, "least squares", solution, notes)


def closed_form(
    model: RotorModel,
    experiments: Experiment | Sequence[Experiment],
    *,
    known: Mapping[str, float | None] | None = None,
    per: Mapping[str, str] | None = None,
    weighted: bool = True,
) -> FitResult:
    """Identify without iteration (eqs 5 to 9 and straight-line fits); the result has the shape of :func:`fit`'s.

    Args:
        model, experiments, known, per: as for :func:`fit`.
        weighted: weigh by the propagated noise, or, as the paper did, not at all.

    Raises:
        ClosedFormError: the data do not allow a closed form.
    """
    if model.eccentricity_dependent:
        raise ClosedFormError(
            f"{model.name} changes with eccentricity, which has no closed form; fit starts from that of a linear fluid "
            f"at small eccentricity"
        )
    settings = FitSettings(known=known or {}, per=per or {})
    problem = build_problem(model, experiments, settings)
    estimate = solve_closed_form(problem.space, problem.blocks, weighted=weighted)
    return _result(
        problem, as_tuple(experiments), settings, estimate.x, estimate.x, "closed form", None, estimate.notes, estimate
    )


def as_tuple(experiments: Experiment | Sequence[Experiment]) -> tuple[Experiment, ...]:
    """One experiment or several, as a tuple.

    Raises:
        ValueError: none at all.
        TypeError: something else.
    """
    if isinstance(experiments, str | Path):
        raise TypeError(f"a fit needs what rf.read returns, not the name of a file: rf.read({str(experiments)!r})")
    several = tuple(experiments) if isinstance(experiments, Sequence) else (experiments,)
    for experiment in several:
        if not isinstance(experiment, Experiment):
            raise TypeError(f"a fit needs experiments such as rf.read returns, not {type(experiment).__name__}")
    if not several or not all(len(e) for e in several):
        raise ValueError("nothing to fit: give at least one experiment with at least one reading")
    return several


def build_problem(model: RotorModel, experiments: Experiment | Sequence[Experiment], settings: FitSettings) -> Problem:
    """Lay a fit out as an optimisation problem; arguments and errors as for :func:`fit`."""
    if not isinstance(model, RotorModel):
        raise TypeError(f"the model must be an instance such as rf.models.WhirlWhip(), not {model!r}")
    several = as_tuple(experiments)
    if settings.loss not in LOSSES:
        raise ValueError(unknown_name("loss", settings.loss, LOSSES))
    for name in settings.per:
        model.parameter(name)
    grouping = group_rows(several, settings.per)
    blocks: tuple[Block, ...] = tuple(
        observe_any(model, experiment, rows) for experiment, rows in zip(several, grouping.rows, strict=True)
    )
    turning = [block for block in blocks if _has_phase(block)]
    several_runs = [run for block in turning for run in block.run.tolist()] if settings.phase_offsets else []
    runs = list(dict.fromkeys(several_runs))
    nuisance = tuple(f"phase[{run}]" for run in runs[1:])
    parts = [tuple(_phase_factors(block, runs[1:]) for block in blocks)] if nuisance else []
    errors = nuisance_entries(settings.calibration, several, blocks) if settings.calibration else None
    if errors is not None:
        nuisance = (*nuisance, *errors.names)
        parts.append(errors.factors)
    factors = tuple(np.hstack(own) for own in zip(*parts, strict=True)) if parts else (None,) * len(blocks)
    space = parameter_space(
        model, known=settings.known, bounds=settings.bounds, groups=grouping.suffixes, nuisance=nuisance
    )
    priors = _priors(space, settings.priors)
    space = within_support(space, priors)
    if errors is not None:
        first = space.size - errors.sd.size
        priors += tuple(Prior(first + i, _normal(sd)) for i, sd in enumerate(errors.sd.tolist()))
    problem = with_levels(Problem(space, blocks, settings.loss, priors, factors), settings.levels)
    if space.size > problem.n_data:
        raise ValueError(f"{space.size} unknowns but only {problem.n_data} real data: fix parameters or add readings")
    return problem


def _normal(sd: float) -> Any:
    from scipy.stats import norm

    return norm(0.0, sd)


def with_levels(problem: Problem, levels: Mapping[str, float], power: int = 1) -> Problem:
    """The problem with the noise of responses multiplied by a power of their levels, those not named by one."""
    if not levels:
        return problem
    blocks = []
    for block in problem.blocks:
        factors = np.array([levels.get(name, 1.0) for name in block.labels]) ** power
        blocks.append(block.with_noise(factors[block.label]))
    return replace(problem, blocks=tuple(blocks))


def solve_again(
    fit: FitResult,
    problem: Problem,
    priors: Mapping[str, Any] | None = None,
    levels: Mapping[str, float] | None = None,
) -> FitResult:
    """The result of a fit with its problem changed: more priors, nuisance entries or other readings.

    Args:
        fit: the result to start from.
        problem: the changed problem, with the same parameters; nuisance entries that are new start at zero.
        priors: priors by parameter name that replace or join those of the problem.
        levels: noise levels by response that are in the problem, if others than those of the fit.
    """
    settings = fit.settings if levels is None else replace(fit.settings, levels=levels)
    if priors:
        settings = replace(settings, priors={**settings.priors, **priors})
        new = _priors(problem.space, priors)
        entries = {prior.entry for prior in new}
        kept = tuple(prior for prior in problem.priors if prior.entry not in entries)
        problem = replace(problem, priors=(*kept, *new))
    begin = np.zeros(problem.space.size)
    begin[: min(fit.x.size, begin.size)] = fit.x[: begin.size]
    solution = _solve(problem, np.clip(begin, problem.space.lower, problem.space.upper), Options())
    return _result(problem, fit.experiments, settings, solution.x, begin, "least squares", solution, ())


def _has_phase(block: Block) -> bool:
    """Whether the observations are phasors relative to a turning reference."""
    circular = responses_of(block)
    return isinstance(block, OffCentreResponses) or (circular is not None and bool(circular.frequency.any()))


def _phase_factors(block: Block, runs: Sequence[str]) -> NDArray[np.complex128]:
    """Sensitivity of the logarithm of each prediction to the phase reference of each run, shape ``(R, n_runs)``.

    In complex coordinates a backward run's amplitude is the conjugate of its phasors, and so is the effect of an
    offset.
    """
    sense = np.full(block.measured.size, float(_has_phase(block)))
    circular = responses_of(block)
    if circular is not None and circular.model.frame == "z":
        sense = np.where(circular.frequency[circular.line] < 0, -sense, sense)
    return np.asarray(1j * sense[:, None] * (block.run[:, None] == np.array(runs)[None, :]))


def _priors(space: ParameterSpace, priors: Mapping[str, Any]) -> tuple[Prior, ...]:
    result = []
    for name, distribution in priors.items():
        if not (hasattr(distribution, "logpdf") and hasattr(distribution, "dist")):
            raise ValueError(
                f"prior of {name} must be a frozen scipy.stats distribution, continuous as norm(1.0, 0.1) is, "
                f"not {distribution!r}"
            )
        if not (np.isfinite(distribution.mean()) and 0 < distribution.std() < np.inf):
            raise ValueError(f"prior of {name} needs a finite mean and a positive, finite standard deviation")
        entries = [i for i, (n, b) in enumerate(zip(space.names, space.base, strict=True)) if name in (n, b)]
        if not entries:
            if name in space.model.parameter_names:
                raise ValueError(f"prior of {name}: it is known here, so nothing is fitted; keep one of the two")
            raise KeyError(unknown_name("fitted parameter", name, space.names))
        support = distribution.support()
        for i in entries:
            low, high = float(space.lower[i]), float(space.upper[i])
            if not max(low, support[0]) < min(high, support[1]):
                raise ValueError(
                    f"prior of {name} allows [{support[0]:g}, {support[1]:g}], its bounds [{low:g}, {high:g}]: nothing "
                    "is left; change either"
                )
        result += [Prior(i, distribution) for i in entries]
    return tuple(result)


# ---- solution ----------------------------------------------------------------------------


def _solve(problem: Problem, start: Float, options: Options) -> Solution:
    space = problem.space
    if problem.loss not in ("linear", "soft_l1"):
        # A redescending loss has local minima; the convex one leads into the right basin.
        gentle = Problem(space, problem.blocks, "soft_l1", problem.priors, problem.factors)
        start = _solve(gentle, start, options).x
    typical = np.array([space.model.parameter(name).scale for name in space.base] + [0.1] * len(space.nuisance))
    scale = np.where(np.abs(start) > 1e-6 * typical, np.abs(start), typical)
    return minimise(problem, start, lower=space.lower, upper=space.upper, scale=scale, options=options)


# ---- verdict ----------------------------------------------------------------------------


def _result(
    problem: Problem,
    experiments: tuple[Experiment, ...],
    settings: FitSettings,
    x: Float,
    begin: Float,
    method: str,
    solution: Solution | None,
    notes: tuple[str, ...],
    estimate: ClosedForm | None = None,
) -> FitResult:
    space = problem.space
    x = np.concatenate([x, np.zeros(space.size - x.size)])
    residuals, jacobian = problem.jacobian(x)
    given = with_levels(problem, settings.levels, -1)  # goodness of fit refers to the noise of the data
    whitened = given.residuals(x) if settings.levels else residuals
    # A nuisance entry with a prior brings the datum that pays for it.
    paid = sum(prior.entry >= len(space.names) for prior in problem.priors)
    chisqr, nfree = float(np.sum(np.abs(whitened) ** 2)), problem.n_data - space.size + paid
    redchi = _reduced(problem, whitened, nfree)
    root, sandwich = _information(problem, x, residuals, jacobian)
    scales = _scales(problem, x)
    names = (*space.names, *space.nuisance)
    base = (*space.base, *space.nuisance)
    noise, verdict = diagnose(space.model, names, base, x, root, scales)
    if sandwich is not None:
        noise = noise @ sandwich @ noise
    if estimate is not None:
        noise = np.where(np.isfinite(estimate.covar), estimate.covar, np.nan)
    widening = max(1.0, redchi) if problem.loss == "linear" and not settings.levels else 1.0
    covar = noise * widening
    if problem.priors and widening > 1:  # what is known beforehand is no less certain for a model that does not fit
        wide = _information(problem, x, residuals / np.sqrt(widening), jacobian / np.sqrt(widening))[0]
        covar = diagnose(space.model, names, base, x, wide, scales)[0]
    deviance = float(robust_weights(problem.loss, np.abs(whitened) ** 2)[0].sum())
    params = _parameters(problem, x, begin, noise, covar, verdict.unresolved)
    warnings = [*notes, *_warnings(problem, x, redchi, params, bool(settings.levels))]
    # A minimum along a whole line is one: the identifiability verdict names the line.
    success = solution is None or solution.success or solution.status is Status.SINGULAR
    if solution is not None and not success:
        warnings.insert(0, f"the optimisation did not converge: {solution.message}")
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
        nvarys=space.size,
        nfree=nfree,
        aic=deviance + 2 * space.size,
        bic=deviance + space.size * float(np.log(problem.n_data)),
        success=success,
        message=solution.message if solution is not None else "closed form, no iteration",
        nfev=solution.n_evaluations if solution is not None else 0,
        responses=_qualities(given, x),
        identifiability=verdict,
        warnings=tuple(warnings),
    )


@cache
def _expected_loss(loss: Loss) -> float:
    """Mean robust cost of one complex reading under pure noise, |r|^2 being chi-squared with two degrees of freedom."""
    q = (np.arange(20000) + 0.5) / 20000
    return float(np.mean(robust_weights(loss, -2 * np.log1p(-q))[0]))


def _reduced(problem: Problem, residuals: NDArray[np.complex128], nfree: int) -> float:
    if nfree <= 0:
        return float("nan")
    cost = float(robust_weights(problem.loss, np.abs(residuals) ** 2)[0].sum())
    return cost / _expected_loss(problem.loss) * 2 / nfree


def _information(
    problem: Problem, x: Float, r: NDArray[np.complex128], J: NDArray[np.complex128]
) -> tuple[Float, Float | None]:
    """Square root of the cost's expected curvature, and for a robust loss its gradient's scatter (the sandwich)."""
    size2 = np.abs(r) ** 2
    _, weight = robust_weights(problem.loss, size2)
    if problem.loss == "linear":
        curvature = weight
    else:
        step = 1e-4 * (1 + size2)
        slope = (robust_weights(problem.loss, size2 + step)[1] - weight) / step
        # A modulus loss bends by w + 2 |r|^2 w' along r and by w across it; residual phases are uniform.
        curvature = np.full(r.size, float(np.mean(weight + size2 * slope)))
    stacked = np.concatenate([J.real, J.imag])
    rows = [np.sqrt(np.concatenate([curvature, curvature]))[:, None] * stacked]
    for prior in problem.priors:
        row = np.zeros((1, x.size))
        row[0, prior.entry] = np.sqrt(prior.terms(float(x[prior.entry]))[2])
        rows.append(row)
    root = np.asarray(np.linalg.qr(np.concatenate(rows), mode="r"))
    if problem.loss == "linear":
        return root, None
    missed = _left_out(r, J, curvature, covariance(root, _scales(problem, x))[0])
    scores = weight[:, None] * (missed.conj()[:, None] * J).real
    scatter = scores.T @ scores
    for prior in problem.priors:  # a prior's centre is as uncertain as the prior is wide
        scatter[prior.entry, prior.entry] += prior.terms(float(x[prior.entry]))[2]
    return root, scatter


def _left_out(
    r: NDArray[np.complex128], J: NDArray[np.complex128], curvature: Float, inverse: Float
) -> NDArray[np.complex128]:
    """Residual of each reading from a fit without it, to first order (MacKinnon and White 1985, HC3).

    A fit follows the readings that matter most, whose own residuals are therefore too small to tell the noise.
    """
    parts = np.stack([J.real, J.imag], axis=1)  # (R, 2, p)
    hat = curvature[:, None, None] * (parts @ inverse @ parts.transpose(0, 2, 1))
    power, basis = np.linalg.eigh(hat)
    along = np.einsum("rik,ri->rk", basis, np.stack([r.real, r.imag], axis=1))
    # A reading that alone determines something cannot be left out.
    found = np.einsum("rik,rk->ri", basis, along / np.maximum(1 - power, _ALONE))
    return np.asarray(found[:, 0] + 1j * found[:, 1])


def inverse_curvature(fit: FitResult) -> Float:
    """Change of the estimate by the slope of the cost, shape ``(p, p)``: ``covar`` itself unless the loss is robust."""
    if fit.problem.loss == "linear":
        return fit.covar
    root, _ = _information(fit.problem, fit.x, *fit.problem.jacobian(fit.x))
    return covariance(root, _scales(fit.problem, fit.x))[0]


def _scales(problem: Problem, x: Float) -> Float:
    space = problem.space
    responses = [b for b in map(responses_of, problem.blocks) if b is not None]
    if not responses:
        typical = np.array([space.model.parameter(name).scale for name in space.base] + [1.0] * len(space.nuisance))
        return np.maximum(np.abs(x), 0.1 * typical)
    levels, top = [], 0.0
    for block in responses:
        drive = np.linalg.norm(block.force, axis=1)[block.line]
        ratio = np.abs(block.measured) / drive if block.imposed else drive / np.abs(block.measured)
        levels.append(ratio[np.isfinite(ratio) & (ratio > 0)])
        # Constant loads see damping and inertia by the fluid that turns with the shaft.
        top = max(top, float(np.abs(block.frequency).max()) or float(np.abs(block.speed).max()))
    stiffness = float(np.median(np.concatenate(levels)))
    own = natural_scales(space.model, space.base, x[: len(space.names)], stiffness, max(top, 1e-12))
    return np.concatenate([own, np.ones(len(space.nuisance))])


def _parameters(
    problem: Problem, x: Float, begin: Float, noise: Float, covar: Float, unresolved: Sequence[str]
) -> dict[str, FittedParameter]:
    space = problem.space
    begin = np.concatenate([begin, np.zeros(space.size - begin.size)])
    # With priors or tight noise a variance may come out as -0.
    error, wide = (np.sqrt(np.maximum(np.diag(matrix), 0.0)) for matrix in (noise, covar))
    entries: dict[str, FittedParameter] = {}
    for i, name in enumerate((*space.names, *space.nuisance)):
        known_to_model = i < len(space.names)
        meta = space.model.parameter(space.base[i]) if known_to_model else None
        unit, meaning = (meta.unit, meta.meaning) if meta else _MEANING[name.partition("[")[0]]
        resolved = name not in unresolved
        span = max(abs(float(x[i])), 1e-12)
        at_bound = bool(min(x[i] - space.lower[i], space.upper[i] - x[i]) <= 1e-7 * span)
        entries[name] = FittedParameter(
            name,
            float(x[i]),
            float(wide[i]) if resolved else float("inf"),
            float(error[i]) if resolved else float("inf"),
            float(begin[i]),
            unit,
            meaning,
            float(space.lower[i]),
            float(space.upper[i]),
            True,
            resolved,
            at_bound,
        )
    theta = space.theta(x)
    for place, meta in enumerate(space.model.parameters):
        if (space.index[:, place] < 0).all():
            value = float(theta[0, place])
            entries[meta.name] = FittedParameter(
                meta.name, value, 0.0, 0.0, value, meta.unit, meta.meaning, meta.lower, meta.upper, False
            )
    order = {name: i for i, name in enumerate(space.model.parameter_names)}
    last = len(order)
    return dict(sorted(entries.items(), key=lambda item: order.get(item[0].partition("[")[0], last)))


def _warnings(
    problem: Problem, x: Float, redchi: float, params: Mapping[str, FittedParameter], levelled: bool
) -> list[str]:
    found = []
    if redchi > MODEL_LIMITED and problem.loss == "linear":
        wider = "each response as its residuals ask" if levelled else f"{np.sqrt(redchi):.2g}"
        advice = "bring the shaft's matrices (KnownStructure)" if levelled else "try rf.refine(fit) (--refine)"
        found.append(
            f"redchi is {redchi:.3g}: the model, not the noise, limits this fit. Standard errors are widened by "
            f"{wider}, but parameters may be biased beyond them; {advice}"
        )
    if problem.loss != "linear":
        # the median of |r|^2 is 2 ln 2 for noise alone, and hardly moves for a few outliers
        typical = float(np.median(np.abs(problem.residuals(x)) ** 2)) / (2 * np.log(2))
        if typical > MODEL_LIMITED:
            found.append(
                f"the squared residuals of most readings are {typical:.2g} times those of the noise: not outliers but "
                "the model limits this fit, and parameters may be biased; try rf.refine(fit) (--refine)"
            )
    found += [f"{p.name} rests on its bound at {p.value:.6g} {p.unit}" for p in params.values() if p.at_bound]
    return found + _instability(problem, x)


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
                    f"the fitted rotor is unstable at the tested speed of {v * 30 / np.pi:.0f} rpm (growth rate "
                    f"{rate:.3g} 1/s): a rig could not have been measured there. Check signs, directions and the model"
                )
    return found


def _qualities(problem: Problem, x: Float) -> tuple[ResponseQuality, ...]:
    result = []
    for block, predicted in zip(problem.blocks, problem.predict(x), strict=True):
        for number, name in enumerate(block.labels):
            rows = block.label == number
            measured, model, sigma = block.measured[rows], predicted[rows], block.sigma[rows]
            miss = np.abs(model - measured) ** 2
            power = float(np.sum(np.abs(measured) ** 2)) * float(np.sum(np.abs(model) ** 2))
            result.append(
                ResponseQuality(
                    name,
                    float(np.sqrt(miss.sum() / max(np.sum(np.abs(measured) ** 2), 1e-300))),
                    float(np.abs(np.vdot(model, measured)) ** 2 / power) if power > 0 else 0.0,
                    float(np.mean(miss / sigma**2) / 2),
                    int(rows.sum()),
                )
            )
    return tuple(result)
