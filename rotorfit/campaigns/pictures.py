"""What the cost of each run of a campaign looks like around a point: by its own parameters and by shared ones."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from rotorfit.campaigns.runs import Batch, Run
from rotorfit.data.alike import alike
from rotorfit.data.experiments import Experiment
from rotorfit.estimators.inference.covariance import bends, prior_curvature, score_scatter
from rotorfit.estimators.inference.schur import Curvature
from rotorfit.estimators.minimisation.descent_of_many import smooth_descents
from rotorfit.estimators.minimisation.least_squares import Options
from rotorfit.estimators.misfit.parameter_space import parameter_space
from rotorfit.estimators.misfit.run_stack import RunStack
from rotorfit.estimators.starting.closed_form import ClosedFormError
from rotorfit.estimators.starting.start_points import search_scale
from rotorfit.fitting.fit import solve
from rotorfit.fitting.plain_fits import is_plain, stacks_of
from rotorfit.fitting.problem_setup import build_problem
from rotorfit.fitting.settings import FitSettings
from rotorfit.models import RotorModel
from rotorfit.models.array_types import Float, Index
from rotorfit.observing.alike import observe_alike


def curvatures(model: RotorModel, batch: Batch) -> Iterator[Curvature | str]:
    """What :func:`curvature` answers for each run, or :func:`least_curvature` where ``shared`` values are among its
    options; runs of one plan and settings together, where the noise is that of the data.
    """
    asked: list[FitSettings] = [option["settings"] for _, option in batch]
    settings = next((one for one in asked if one.noise is None), None)
    together: dict[int, Curvature] = {}
    if settings is not None and is_plain(model, settings):
        some = [number for number, one in enumerate(asked) if one is settings]
        tests, points = [batch[number][0].experiment for number in some], [batch[number][1]["at"] for number in some]
        shared = batch[some[0]][1].get("shared", {})
        together = {some[number]: found for number, found in _together(model, tests, settings, shared, points)}
    for number, (run, option) in enumerate(batch):
        one_by_one = least_curvature if "shared" in option else curvature
        yield together[number] if number in together else one_by_one(model, run, **option)


def _together(
    model: RotorModel,
    tests: Sequence[Experiment],
    settings: FitSettings,
    shared: Mapping[str, float],
    points: Sequence[Mapping[str, float]],
) -> Iterator[tuple[int, Curvature]]:
    """Pictures of runs by their numbers, as far as their searches for given shared values go smoothly."""
    free = parameter_space(model, known=settings.known, bounds=settings.bounds, groups=({},))
    if set(free.names) <= set(shared):
        return
    own = parameter_space(model, known={**settings.known, **shared}, bounds=settings.bounds, groups=({},))
    for group in alike(tests):
        seen = observe_alike(model, group)
        for some, stack in stacks_of(own, seen, np.ones(len(group.tests), dtype=bool)):
            numbers = group.numbers[some].tolist()
            x = np.array([[points[number][name] for name in own.names] for number in numbers])
            smooth = np.arange(len(x))
            if shared:
                x, smooth = _least(stack, x)
            columns = (
                x[:, own.names.index(name)] if name in own.names else np.full(len(x), shared[name])
                for name in free.names
            )
            whole = np.column_stack(list(columns))
            with np.errstate(all="ignore"):  # of searches that went astray, which are left out
                pictures = replace(stack, space=free).gauss_newton(whole)
            for member in smooth.tolist():
                cost, gradient, matrix = (part[member] for part in pictures)
                picture = Curvature(
                    names=free.names,
                    x=whole[member],
                    cost=float(cost),
                    squares=2 * float(cost),
                    gradient=gradient,
                    matrix=matrix,
                    prior=np.zeros(free.size),
                )
                yield numbers[member], picture


def _least(stack: RunStack, x: Float) -> tuple[Float, Index]:
    """Own parameters of least cost, shape ``(W, p)``, and the runs whose search for them went smoothly."""
    space = stack.space
    begin = np.clip(x, space.lower, space.upper)
    with np.errstate(all="ignore"):
        scale = search_scale(space, begin)
        ends = smooth_descents(stack.gauss_newton, begin, scale, space.lower, space.upper, Options())
    return ends.x, np.flatnonzero(ends.smooth)


def curvature(model: RotorModel, run: Run, *, settings: FitSettings, at: Mapping[str, float]) -> Curvature | str:
    """Cost of one run and its derivatives at given parameters; the reason in words where there is none."""
    try:
        problem = build_problem(model, run.experiment, settings)
    except (ValueError, KeyError, ClosedFormError) as reason:
        return str(reason)
    names = (*problem.space.names, *problem.space.nuisance)
    x = np.array([at.get(name, 0.0) if name in problem.space.nuisance else at[name] for name in names])
    cost, gradient, matrix = problem.gauss_newton(x)
    squares = float(np.sum(np.abs(problem.residuals(x)) ** 2))
    prior = prior_curvature(problem, x)
    return Curvature(names=names, x=x, cost=cost, squares=squares, gradient=gradient, matrix=matrix, prior=prior)


def least_curvature(
    model: RotorModel, run: Run, *, settings: FitSettings, shared: Mapping[str, float], at: Mapping[str, float]
) -> Curvature | str:
    """Cost of one run and its derivatives where its own parameters are best for the shared ones given."""
    inner = replace(settings, known={**settings.known, **shared})
    try:
        problem = build_problem(model, run.experiment, inner)
    except (ValueError, KeyError, ClosedFormError) as reason:
        return str(reason)
    names = (*problem.space.names, *problem.space.nuisance)
    begin = np.array([at.get(name, 0.0) if name in problem.space.nuisance else at[name] for name in names])
    found = solve(problem, np.clip(begin, problem.space.lower, problem.space.upper), Options())
    own = dict(zip(names, found.x.tolist(), strict=True))
    return curvature(model, run, settings=settings, at={**own, **shared})


def bends_of(model: RotorModel, run: Run, *, settings: FitSettings, at: Mapping[str, float]) -> tuple[Float, Float]:
    """Bends of a robust loss in one run's readings, shape ``(R,)``, and its matrix by squares, shape ``(p, p)``."""
    problem = build_problem(model, run.experiment, settings)
    r, J = problem.jacobian(np.array([at[name] for name in problem.space.names]))
    return bends(problem.loss, r), np.asarray((J.conj().T @ J).real)


def scatter_of(
    model: RotorModel, run: Run, *, settings: FitSettings, at: Mapping[str, float], bend: float, covar: Float
) -> Float:
    """Scatter of the slope of one run's cost, shape ``(p, p)``."""
    problem = build_problem(model, run.experiment, settings)
    x = np.array([at[name] for name in problem.space.names])
    return score_scatter(problem, x, *problem.jacobian(x), bend=bend, covar=covar)
