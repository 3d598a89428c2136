"""Covariance of an estimate: from the noise, widened where the model or the residuals ask for it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rotorfit.estimators.blocks.correlated import freedom_of
from rotorfit.estimators.inference import covariance
from rotorfit.estimators.inference.identifiability import Identifiability, along_valley, diagnose
from rotorfit.estimators.misfit.problem import Problem
from rotorfit.estimators.starting.closed_form import ClosedForm
from rotorfit.fitting.goodness import Goodness
from rotorfit.fitting.noise.error_bars import shares_of_possible_effects, with_scatter, with_shares
from rotorfit.fitting.noise.residual_study import ResidualStudy
from rotorfit.fitting.settings import FitSettings
from rotorfit.models.array_types import ComplexArray, Float


@dataclass(frozen=True, eq=False, kw_only=True)
class StandardErrors:
    """Standard error of an estimate, and its origin."""

    scattered: Float  # covariance by the noise alone, shape ``(p, p)``
    covar: Float  # the same, widened
    degrees: tuple[float, ...]  # of freedom of each entry's error
    identifiability: Identifiability  # what the data determine
    noise: ResidualStudy | None  # what the residuals are, with what it adds to the errors


def standard_errors(
    problem: Problem,
    settings: FitSettings,
    x: Float,
    residuals: ComplexArray,
    jacobian: ComplexArray,
    goodness: Goodness,
    estimate: ClosedForm | None,
    noise: ResidualStudy | None,
) -> StandardErrors:
    """Errors of an estimate."""
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
    widening = covariance.widening(
        goodness.redchi, problem.loss, rescaled=settings.rescaled, nfree=goodness.nfree, freedom=known
    )
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
    freedom = min(known, float(goodness.nfree)) if widening > 1 and np.isfinite(known) else known
    degrees = (freedom,) * space.size if noise is None else noise.own_degrees(space.size)
    return StandardErrors(scattered=scattered, covar=covar, degrees=degrees, identifiability=verdict, noise=noise)
