"""Errors of a campaign with shared parameters: those of the joint fit, from what each run says by itself."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from rotorfit.campaigns.runs import Run, RunFit, Workers
from rotorfit.estimators.inference.covariance import Curvature, Parts, bends, score_scatter, shared_covariance, widening
from rotorfit.fitting.problem_setup import build_problem
from rotorfit.fitting.settings import FitSettings
from rotorfit.models import RotorModel
from rotorfit.models.array_types import Float

Errors = tuple[Float, Float]
"""Covariance as the noise alone makes it, and widened for a model that does not fit."""


@dataclass(frozen=True, eq=False, kw_only=True)
class FittedRun:
    """A run at the solution of the joint fit."""

    run: Run  # its data
    fit: RunFit  # its own parameters, fitted with the shared ones known
    quadratic: Curvature  # its cost around the solution, by own and shared parameters
    options: dict[str, Any]  # settings and point that the approximation was made with, for the workers


def joint_errors(workers: Workers, fitted: Sequence[FittedRun], names: Sequence[str]) -> tuple[Errors, list[Errors]]:
    """Errors of the joint fit to all runs.

    Returns:
        those of the shared parameters, shape ``(s, s)``, and of each run's own in the order of its ``var_names``.
    """
    if fitted[0].options["settings"].loss != "linear":
        return _of_robust_loss(workers, fitted, names)
    free = sum(item.fit.ndata - len(item.fit.var_names) for item in fitted) - len(names)
    redchi = sum(item.quadratic.squares for item in fitted) / free if free > 0 else float("nan")
    noise, added = _by_squares(fitted, names, 1.0)
    covar, wide = _by_squares(fitted, names, 1 / widening(redchi, "linear"))
    own = []
    for item, more, more_wide in zip(fitted, added, wide, strict=True):
        variance = [item.fit.params[name].stderr_noise ** 2 for name in item.fit.var_names]
        own.append((np.diag(variance) + more, np.asarray(item.fit.covar + more_wide)))
    return (noise, covar), own


def _by_squares(fitted: Sequence[FittedRun], names: Sequence[str], factor: float) -> tuple[Float, list[Float]]:
    """Covariance of the shared parameters, and what it adds to each run's own; ``factor`` is on the information."""
    parts = [Parts.of(item.quadratic.scaled(factor), names) for item in fitted]
    covar = shared_covariance(parts, names)
    return covar, [
        _own_order(item, names, part.follow @ covar @ part.follow.T) for item, part in zip(fitted, parts, strict=True)
    ]


def _of_robust_loss(workers: Workers, fitted: Sequence[FittedRun], names: Sequence[str]) -> tuple[Errors, list[Errors]]:
    """The sandwich of :func:`rotorfit.estimators.inference.covariance.information`, put together from the runs. Its
    filling is the scatter of each run's slope, which reaches the shared parameters directly and through those of the
    run's own that follow them. The scatter already shows a model that does not fit: nothing is widened."""
    runs, options = [item.run for item in fitted], [item.options for item in fitted]
    found = workers(_bends_of, runs, options)
    bend = float(np.mean(np.concatenate([own for own, _ in found])))
    quadratics = [
        replace(item.quadratic, matrix=squares + np.diag(item.quadratic.prior)).scaled(bend)
        for item, (_, squares) in zip(fitted, found, strict=True)
    ]
    parts = [Parts.of(quadratic, names) for quadratic in quadratics]
    inverse = shared_covariance(parts, names)
    inverses = [part.covariance(inverse) for part in parts]
    asked = [{**option, "bend": bend, "covar": covar} for option, covar in zip(options, inverses, strict=True)]
    scatters = workers(_scatter_of, runs, asked)
    reached = [part.reach().T @ scatter @ part.reach() for part, scatter in zip(parts, scatters, strict=True)]
    filling = np.sum(reached, axis=0)
    own = []
    for item, part, scatter, direct in zip(fitted, parts, scatters, reached, strict=True):
        pull, follow = part.pull(inverse), part.follow @ inverse
        matrix = _own_order(item, names, pull @ scatter @ pull.T + follow @ (filling - direct) @ follow.T)
        own.append((matrix, matrix))
    covar = inverse @ filling @ inverse
    return (covar, covar), own


def _own_order(item: FittedRun, names: Sequence[str], matrix: Float) -> Float:
    """A matrix of own parameters in the order of the fit."""
    own = [name for name in item.quadratic.names if name not in names]
    order = [own.index(name) for name in item.fit.var_names]
    return np.asarray(matrix[np.ix_(order, order)])


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
