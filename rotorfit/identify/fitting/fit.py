"""Fit a model to experiments: in closed form, or by weighted nonlinear least squares."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from rotorfit.base.array_types import Float
from rotorfit.base.digits import significant
from rotorfit.base.faults import of_library, of_program
from rotorfit.estimators.inference.covariance import excess, inverse_curvature
from rotorfit.estimators.minimisation.least_squares import Options, Solution, Status, minimise
from rotorfit.estimators.minimisation.objective import Method
from rotorfit.estimators.minimisation.projection import Projection
from rotorfit.estimators.misfit.cost_graph import cost_graph
from rotorfit.estimators.misfit.problem import Loss, Problem
from rotorfit.estimators.misfit.ratios import LogRatioProblem, ratios_of
from rotorfit.estimators.starting.closed_form import ClosedFormError
from rotorfit.estimators.starting.closed_form import closed_form as solve_closed_form
from rotorfit.estimators.starting.shaft_line_starts import has_lines
from rotorfit.estimators.starting.start_points import CLOSED_FORM, EARLIER_FIT, Start, search_scale
from rotorfit.estimators.starting.starts import find_start
from rotorfit.identify.fitting.causes.calibration import Calibration
from rotorfit.identify.fitting.causes.solution import NEGLIGIBLE, JointSearch, search, solved_before
from rotorfit.identify.fitting.causes.table import table_of
from rotorfit.identify.fitting.judge import (
    explains,
    explains_nothing,
    judge,
    of_start,
    redchi_of,
    with_model_uncertainty,
)
from rotorfit.identify.fitting.noise.error_bars import with_noise
from rotorfit.identify.fitting.noise.study import study_residuals
from rotorfit.identify.fitting.problem_setup import as_tuple, build_problem, check_model, dry_run, each_of
from rotorfit.identify.fitting.result import FitResult
from rotorfit.identify.fitting.settings import FitSettings, PhaseOffsets
from rotorfit.lab.data.experiments import perturbations
from rotorfit.lab.data.findings import Finding
from rotorfit.lab.data.joined import runs_apart
from rotorfit.lab.data.rows import Experiment
from rotorfit.lab.observing.clearance import usable
from rotorfit.models import RotorModel

_LOG = logging.getLogger(__name__)


def fit(
    model: RotorModel,
    experiments: Experiment | Sequence[Experiment],
    *,
    known: Mapping[str, float | tuple[float, float] | None] | None = None,
    bounds: Mapping[str, tuple[float | None, float | None]] | None = None,
    priors: Mapping[str, Any] | None = None,
    per: Mapping[str, str] | None = None,
    loss: Loss = "linear",
    start: Mapping[str, float] | None = None,
    phase_offsets: PhaseOffsets = False,
    baseline: Experiment | None = None,
    stator_mass_kg: float | None = None,
    calibration: Calibration | None = None,
    causes: Mapping[str, float] | None = MappingProxyType({}),
    method: Method = "auto",
    max_iterations: int = 200,
) -> FitResult:
    """Fit a model by weighted nonlinear least squares on the complex responses.

    The search begins at the closed form or, where there is none, at the start that :attr:`FitResult.start` names. It
    takes Gauss-Newton steps, and goes on with Ipopt where these do not lead to the optimum.

    Args:
        model: the rotor, for instance ``rf.models.WhirlWhip()``.
        experiments: one experiment or a list that informs one parameter vector. Runs of one name that a probe read in
            several of them are different runs and are named with their file.
        known: values that are not fitted, SI units, or pairs of a value and its standard uncertainty; ``None`` frees a
            parameter that the model fixes by default.
        bounds: lower and upper bounds by parameter name, None for none.
        priors: frozen ``scipy.stats`` distributions by parameter name.
        per: parameters that take one value for each value of a test attribute, ``{"D": "speed_rpm"}``, or of several
            together, ``{"D": "speed_rpm+pressure_bar"}``; ``"K*"`` stands for all that begin so and are fitted.
        loss: "linear", or "soft_l1", "huber", "cauchy" against outliers.
        start: start values that replace those that are found from the data (:attr:`FitResult.start`). Where they lead
            to a fit that does not explain the data, it is tried without them; the better of the two is the result.
        phase_offsets: fit an offset of the phase reference for every run but the first, or for every run about their
            mean where their scatter tells how far the first one's may be off; "common": one angle ``datum``
            between all forces and all responses, where weight holes, Keyphasor and probes have no common zero. It is
            positive where responses lead.
        baseline: a dry run of the same rig, whose dynamic stiffness is taken out: the model is then of the fluid alone.
            Its speeds are matched with those of the test, its frequencies are interpolated, and its noise enters the
            errors.
        stator_mass_kg: in place of a dry run, the mass of a floating stator.
        calibration: uncertainties of probes, force and phase reference, which then count in ``stderr``.
        causes: sizes of causes beside the model, standard uncertainties by their names in :attr:`FitResult.causes`,
            ``{"gain": 0.005}``; zero takes one out, ``{}`` is the list as it is. They are solved with the fitted values
            and count in ``stderr``. ``None`` fits without causes.
        method: "gauss-newton" for damped Gauss-Newton steps, "ipopt" for Ipopt, on CasADi's own graph of the cost where
            there is one; "auto" takes Gauss-Newton steps and hands over to Ipopt where they do not lead to the optimum.
        max_iterations: limit on the iterations of the search.

    Returns:
        the result; a fit that did not converge has ``success`` false and the best estimate found. Data checks
        run when :attr:`FitResult.findings` are read.

    Raises:
        TypeError: a class or a name in place of a model, or something else than experiments.
        KeyError: unknown parameter names; the message names the nearest. Unknown causes.
        ValueError: data that do not fit the model, an unknown loss, contradictory bounds, more unknowns than data,
            sizes of causes that are negative.

    Example:
        >>> fit = rf.fit(rf.models.WhirlWhip(), rig, known={"K3": 6000.0})
        >>> fit.success, round(fit.params["lam"].value, 3), fit.params["lam"].unit
        (True, 0.475, '1')
    """
    settings = FitSettings(
        known={name: tuple(v) if isinstance(v, list) else v for name, v in (known or {}).items()},
        bounds={name: _numbers(pair) for name, pair in (bounds or {}).items()},
        priors=priors or {},
        per=each_of(model, per or {}, known or {}),
        start=start or {},
        loss=loss,
        phase_offsets=phase_offsets,
        baseline=dry_run(baseline),
        stator_mass_kg=stator_mass_kg,
        calibration=calibration,
        causes=None if causes is None else dict(causes),
        method=method,
        max_iterations=max_iterations,
    )
    return fitted(model, runs_apart(as_tuple(experiments)), settings, or_from_data=True)


def _numbers(pair: Any) -> Any:
    """Bounds with infinity in place of None; what is no pair is refused where bounds are used."""
    if not isinstance(pair, tuple | list) or len(pair) != 2:
        return pair
    low, high = pair
    return (-np.inf if low is None else low, np.inf if high is None else high)


class _Solved(NamedTuple):
    """A solved problem."""

    problem: Problem
    start: Start
    solution: Solution
    rival: _Solved | None = None  # the same rotor with another spectrum of a force, which the data do not tell from it


def fitted(
    model: RotorModel, experiments: tuple[Experiment, ...], settings: FitSettings, *, or_from_data: bool = False
) -> FitResult:
    """The fit of a model with given settings; ``or_from_data``: start values that do not lead to a fit that explains
    the data are tried without."""
    try:
        found = begun = min(_solved(model, experiments, settings), key=_bic)
        if or_from_data and settings.start and not explains(found.problem, found.solution):
            found = _or_from_data(begun, model, experiments, settings)
            settings = settings if found.start is begun.start else replace(settings, start={})
        settings = replace(settings, force_spectrum=_spectrum_of(found.problem))
        fit = judged(found.problem, experiments, settings, found.start, found.solution)
        return fit if found.rival is None else with_model_uncertainty(fit, _of_choice(found, found.rival))
    except np.linalg.LinAlgError as reason:
        if not of_library(reason):
            raise
        raise np.linalg.LinAlgError(
            f"the equations of {model.name} cannot be solved with these numbers ({reason}): look at the units of "
            "forces, responses, known and start values, which are many powers of ten apart"
        ) from reason


def _or_from_data(
    found: _Solved, model: RotorModel, experiments: tuple[Experiment, ...], settings: FitSettings
) -> _Solved:
    """What start values that were given lead to, or, where it is better, what those that the data give lead to, with a
    sentence that says so."""
    try:
        free = min(_solved(model, experiments, replace(settings, start={})), key=_bic)
    except ValueError as reason:  # where data alone give no start
        if of_program(reason):
            raise
        return found

    def doubt(solved: _Solved) -> tuple[bool, bool, float]:
        solution = solved.solution
        local = not explains(solved.problem, solution), not _is_minimum(solution)
        return *local, np.nan_to_num(solution.cost, nan=np.inf)

    same = 1e-3  # relative difference of costs within which two searches ended in one minimum
    one = doubt(free)[:2] == doubt(found)[:2] and free[2].cost > (1 - same) * found[2].cost
    if one or not doubt(free) < doubt(found):
        return found
    redchi, own = (significant(redchi_of(one.problem, one.solution), 3) for one in (found, free))
    given = ", ".join(f"{name} {value:g}" for name, value in settings.start.items())
    local = "" if explains(free.problem, free.solution) else ". Neither explains the data: perhaps a local minimum"
    minimum = "" if _is_minimum(found.solution) else ", no minimum"
    note = (
        f"the start that was given ({given}) leads to redchi {redchi}{minimum}, the one found from the data to {own}: "
        f"this is the fit from the data. Check the start values and their units{local}"
    )
    _LOG.info("%s", note)
    local_too = free.start.perhaps_local or bool(local)
    return free._replace(start=replace(free.start, notes=(note, *free.start.notes), perhaps_local=local_too))


def _solved(model: RotorModel, experiments: tuple[Experiment, ...], settings: FitSettings) -> list[_Solved]:
    """The solved problem of a model, or those of its alternatives; of these, such as fit the data at all."""
    check_model(model)
    found: list[_Solved] = []
    rows = ((t, t.alike("plane", "direction")[0].tolist()) for t in perturbations(experiments))
    for one in model.alternatives({(str(t.plane[k]), str(t.direction[k])) for t, first in rows for k in first}):
        try:
            problem = build_problem(one, experiments, settings)
            start = find_start(problem, settings.start)
            _LOG.info(
                "%s: %d values to fit to %d data, starting from: %s",
                one.name,
                problem.space.size,
                problem.n_data,
                start.kind,
            )
        except ValueError as reason:
            if not found or of_program(reason):
                raise
            continue
        options = Options(max_iterations=settings.max_iterations, method=settings.method)
        if settings.force_spectrum or not _spectrum_of(problem):
            found.append(_Solved(problem, start, solve(problem, start.x, options)))
            continue
        best, rival = (
            one._replace(solution=solve(one.problem, one.solution.x, options))
            for one in _with_best_spectra(problem, start)
        )
        same = rival.problem is best.problem or not _is_minimum(rival.solution)
        found.append(best._replace(rival=None if same else rival))
    return found


def _with_best_spectra(problem: Problem, start: Start) -> tuple[_Solved, _Solved]:
    """The problem with the spectra of least BIC and of least AIC of a force that was not measured, solved to a few
    digits. Each spectrum is begun where it costs least of the places that are known, the freest first, and again where
    one of the best ended, as long as it costs less there: a rotor found with the wrong spectrum is often far from that
    of the right one."""
    rough = Options(max_iterations=4, tolerance=1e-3, acceptable=1e-3, method="gauss-newton", hessian="gauss-newton")
    less, near = 0.1, 1.3  # of a cost, worth another search; over the least found, up to which a search goes on
    rounds, followed = 4, 2  # of the search for all; of the best places
    names = dict.fromkeys(name for block in problem.blocks for name in block.force_spectra)
    found: dict[str, _Solved] = {}

    def hopeless(solution: Solution) -> bool:
        return not solution.cost < near * min((one.solution.cost for one in found.values()), default=np.inf)

    for number in range(rounds):
        before = {name: one.solution.cost for name, one in found.items()}
        for name in [*list(names)[1:], *list(names)[:1]]:
            if name in found and hopeless(found[name].solution):
                continue
            own = found[name].problem if name in found else _with_spectrum(problem, name)
            best = sorted(found.values(), key=_aic)[:followed]
            places = [one.solution.x for one in best] + ([] if number else [start.x, *start.others])
            costs = [float(np.nan_to_num(own.cost(x), nan=np.inf)) for x in places]
            if name in found and not min(costs) < before[name] - less:
                continue
            solution = solve(own, places[int(np.argmin(costs))], rough)
            if not _is_minimum(solution) and not hopeless(solution):
                solution = solve(own, solution.x, replace(rough, max_iterations=40))
            if name not in found or solution.cost < before[name]:
                found[name] = _Solved(own, start, solution)
        if all(one.solution.cost > before.get(name, np.inf) - less for name, one in found.items()):
            break
    return min(found.values(), key=_bic), min(found.values(), key=_aic)


def _of_choice(best: _Solved, rival: _Solved) -> Float:
    """What is added to the covariance of the parameters because the data do not choose between two spectra of a force:
    the means of both covariances and the squares of their distance, by their weights after Akaike."""
    weight = 1 / (1 + np.exp((_aic(rival)[-1] - _aic(best)[-1]) / 2))
    own, other = (inverse_curvature(one.problem, one.solution.x) for one in (best, rival))
    apart = rival.solution.x - best.solution.x
    wide = (1 - weight) * own + weight * (other + np.outer(apart, apart))
    count = len(best.problem.space.names)
    return excess(wide, own)[:count, :count]


def _with_spectrum(problem: Problem, name: str) -> Problem:
    blocks = tuple(block.with_force_spectrum(name if block.force_spectra else "") for block in problem.blocks)
    return replace(problem, blocks=blocks)


def _spectrum_of(problem: Problem) -> str:
    """Name of the spectrum of forces that were not measured; empty where all were."""
    return next((block.force_spectra[0] for block in problem.blocks if block.force_spectra), "")


def _is_minimum(solution: Solution) -> bool:
    """True of a minimum, also of one along a whole line."""
    return solution.success or solution.status is Status.SINGULAR


def _bic(solved: _Solved) -> tuple[bool, bool, float]:
    """What tells the better of two solved problems of the same readings: whether it has a minimum, whether its numbers
    can be, and its BIC."""
    return _criterion(solved, float(np.log(solved.problem.n_data)))


def _aic(solved: _Solved) -> tuple[bool, bool, float]:
    """The same with AIC, which keeps what is freer as long as it may be needed."""
    return _criterion(solved, 2.0)


def _criterion(solved: _Solved, each: float) -> tuple[bool, bool, float]:
    """The same with twice the cost and so much for each number that is fitted."""
    problem, solution = solved.problem, solved.solution
    unsound = not all(block.own_believable for block in problem.blocks)
    unknowns = problem.space.size + sum(block.own_unknowns for block in problem.blocks)
    cost = float(np.nan_to_num(solution.cost, nan=np.inf))
    return not _is_minimum(solution), unsound, 2 * cost + unknowns * each


def judged(
    problem: Problem,
    experiments: tuple[Experiment, ...],
    settings: FitSettings,
    start: Start,
    solution: Solution,
) -> FitResult:
    """The result of a solved problem, solved again with the noise that its residuals show."""
    left_out = (sentence for test in experiments for sentence in usable(problem.space.model, test)[1])
    notes = (*(Finding("warning", "left-out", text) for text in left_out), *of_start(start.notes))
    nothing = explains_nothing(problem, solution)
    studied = settings.loss == "linear" and _is_minimum(solution) and not nothing
    beside = None if nothing else _beside(problem, solution, settings, for_noise=studied)
    at = problem if beside is None else beside.problem
    study = study_residuals(at, solution.x, beside) if studied else None
    if settings.causes is None and study is not None and (study.effects or not explains(problem, solution)):
        notes = (*notes, *_left_out(problem, solution, settings))
    if study is not None and study.found is not None:
        _LOG.info("%s: solved again with the noise that its residuals show", problem.space.model.name)
        offsets, settings = settings.phase_offsets, replace(settings, noise=study.found)
        names, model = (*problem.space.names, *problem.space.nuisance), problem.space.model
        problem = build_problem(model, experiments, settings) if offsets else with_noise(problem, study.found)
        now = (*problem.space.names, *problem.space.nuisance)

        def named(x: Float) -> Float:
            before = dict(zip(names, x.tolist(), strict=True))
            return np.array([before.get(name, 0.0) for name in now])

        options = Options(max_iterations=settings.max_iterations, method=settings.method)
        closer = solve(problem, named(solution.x), options)
        solution = replace(closer, n_evaluations=solution.n_evaluations + closer.n_evaluations)
        beside = None if beside is None else replace(beside, x=named(beside.x), missed=math.inf)
    if beside is not None and beside.missed >= NEGLIGIBLE:
        beside = _beside(problem, solution, settings, beside)
    if beside is not None:
        problem, solution = beside.problem, replace(solution, x=beside.x)
    found = judge(problem, experiments, settings, start, solution, notes, study, beside)
    _LOG.info("%r", found)
    return found


def _left_out(problem: Problem, solution: Solution, settings: FitSettings) -> Iterator[Finding]:
    """The clearest cause that readings show which were to be fitted without any: what differs from run to run, or
    misses the model, may be its work."""
    found = search(problem, solution.x, settings.sizes, settings.calibration)
    if found is None:
        return
    errors = found.errors(found.square / max(problem.n_data - problem.space.size, 1))
    for row in table_of(found.solved(errors)).found[:1]:
        text = f"the data show {row.words}, which a fit without causes (causes=None, --no-causes) leaves out"
        yield Finding("warning", "cause-left-out", f"{text}; {row.way_out}", remedy=row.way_out, origin="fit")


def _beside(
    problem: Problem,
    solution: Solution,
    settings: FitSettings,
    begin: JointSearch | None = None,
    *,
    for_noise: bool = False,
) -> JointSearch | None:
    """The fitted values solved with causes, where these were asked for and the search found an optimum."""
    if settings.causes is None or not _is_minimum(solution):
        return None
    return search(problem, solution.x, settings.sizes, settings.calibration, begin=begin, for_noise=for_noise)


def closed_form(
    model: RotorModel,
    experiments: Experiment | Sequence[Experiment],
    *,
    known: Mapping[str, float | None] | None = None,
    per: Mapping[str, str] | None = None,
    baseline: Experiment | None = None,
    stator_mass_kg: float | None = None,
    weighted: bool = True,
) -> FitResult:
    """Identify without iteration (eqs 5 to 9 and straight-line fits); the result has the shape of :func:`fit`'s.

    Args:
        model, experiments, known, per, baseline, stator_mass_kg: as for :func:`fit`.
        weighted: weigh by the propagated noise, or, as the paper did, not at all.

    Raises:
        ClosedFormError: the data do not allow a closed form.

    Example:
        >>> start = rf.closed_form(rf.models.WhirlWhip(), rig, known={"K3": 6000.0})
        >>> round(start.params["lam"].value, 3)
        0.473
    """
    if model.eccentricity_dependent:
        raise ClosedFormError(
            f"{model.name} changes with eccentricity, which has no closed form; fit starts from that of a linear fluid "
            f"at small eccentricity"
        )
    if model.no_closed_form:
        raise ClosedFormError(model.no_closed_form)
    settings = FitSettings(
        known=known or {},
        per=each_of(model, per or {}, known or {}),
        baseline=dry_run(baseline),
        stator_mass_kg=stator_mass_kg,
        causes=None,
    )
    several = runs_apart(as_tuple(experiments))
    problem = build_problem(model, several, settings)
    if has_lines(problem):
        raise ClosedFormError("combination lines have none; the fit starts from linear steps, one line after the other")
    # Responses to measured forces and beside a dry run are taken without what their errors have in common.
    blocks = tuple(block.without_force_errors for block in problem.blocks)
    estimate = solve_closed_form(problem.space, blocks, weighted=weighted)
    return judge(problem, several, settings, Start(x=estimate.x, kind=CLOSED_FORM), estimate, of_start(estimate.notes))


def solve_again(fit: FitResult, problem: Problem) -> FitResult:
    """The result of a fit with its settings, solved for another problem: other nuisance entries, noise or readings."""
    settings = fit.settings
    begin = np.zeros(problem.space.size)
    begin[: min(fit.x.size, begin.size)] = fit.x[: begin.size]
    solution = solve(problem, np.clip(begin, problem.space.lower, problem.space.upper), Options(method=settings.method))
    start = Start(x=begin, kind=EARLIER_FIT)
    beside = None if settings.solved is None else solved_before(problem, solution.x, settings.solved)
    found = judge(problem, fit.experiments, settings, start, solution, noise=fit.noise, beside=beside)
    return found if fit.model_uncertainty is None else with_model_uncertainty(found, fit.model_uncertainty)


def solve(problem: Problem, start: Float, options: Options) -> Solution:
    """Minimise the cost of a problem."""
    space = problem.space
    if problem.loss not in ("linear", "soft_l1"):
        # A redescending loss has local minima; the convex one leads into the right basin.
        start = solve(replace(problem, loss="soft_l1"), start, options).x
    projection = Projection.of(problem) if options.method != "ipopt" else None
    if projection is not None:
        kept, scale = projection.kept, search_scale(space, start)
        most_exact = 50  # unknowns up to which second derivatives, by an evaluation each, are sooner found than not
        if kept.size > most_exact:
            options = replace(options, hessian="gauss-newton")
        lower, upper = space.lower[kept], space.upper[kept]
        found = minimise(projection, start[kept], lower=lower, upper=upper, scale=scale[kept], options=options)
        return replace(found, x=projection.vector(found.x))
    ratios = ratios_of(problem)
    if ratios is None or not start[ratios.numerators].any():  # nothing is known of a ratio either
        scale = search_scale(space, start)
        graph = cost_graph(problem) if options.method == "ipopt" else None
        bounds = {"lower": space.lower, "upper": space.upper}
        return minimise(problem, start, **bounds, scale=scale, options=options, graph=graph)
    begin, (lower, upper) = ratios.of(start), ratios.bounds(space)
    scale = search_scale(space, begin)
    scale[ratios.entry] = 1.0
    found = minimise(LogRatioProblem(problem, ratios), begin, lower=lower, upper=upper, scale=scale, options=options)
    return replace(found, x=ratios.vectors(found.x))
