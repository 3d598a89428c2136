"""Quadratic approximation of each run's cost around a point: by its own parameters and by shared ones."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from rotorfit.campaigns.runs import Run
from rotorfit.estimators.inference.covariance import bends, prior_curvature, score_scatter
from rotorfit.estimators.inference.schur import Curvature
from rotorfit.estimators.minimisation.least_squares import Options
from rotorfit.estimators.starting.closed_form import ClosedFormError
from rotorfit.fitting.fit import solve
from rotorfit.fitting.problem_setup import build_problem
from rotorfit.fitting.settings import FitSettings
from rotorfit.models import RotorModel
from rotorfit.models.array_types import Float


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
