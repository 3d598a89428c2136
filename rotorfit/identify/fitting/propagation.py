"""Errors of what is worked out from a fit, by derivatives: of the fitted vector, and of causes solved beside it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from rotorfit.base.array_types import Float
from rotorfit.estimators.inference.covariance import spread_along, standard_error
from rotorfit.identify.fitting.causes.slopes import onset_slopes, value_slopes
from rotorfit.identify.fitting.quantities import CAUSE, THRESHOLD, ErrorBar, Quantity

if TYPE_CHECKING:
    from rotorfit.identify.fitting.result import FitResult


def propagated(
    fit: FitResult,
    group: int,
    value: float,
    gradient: Float,
    unit: str,
    *,
    speed: float | None = None,
    by_causes: Float | None = None,
) -> Quantity:
    """A result with its error by its derivatives by the model parameters of a group, shape ``(P,)``.

    ``speed`` is the rotative speed, rad/s, that it belongs to, with whose values it is made; ``by_causes`` are its
    derivatives by the sizes of causes that do not change values, the parameters held.
    """
    beside = by_values_of_causes(fit, np.asarray(gradient), group, speed)
    beside = beside if by_causes is None else beside + by_causes
    return with_error(fit, value, fit.problem.space.pull_back(np.asarray(gradient), group), beside, unit)


def with_error(fit: FitResult, value: float, slope: Float, by_causes: Float, unit: str) -> Quantity:
    """A result with its error by all its derivatives: by the fitted vector, and by the sizes of causes."""
    solved = fit.settings.solved
    names = [f"{CAUSE}{cause.name}" for cause in solved.causes] if solved else []
    named = {name: own for name, own in zip(names, by_causes.tolist(), strict=True) if own}
    return _with_error(fit, value, slope, unit, dict(zip(fit.var_names, slope.tolist(), strict=True)) | named)


def by_values_of_causes(fit: FitResult, gradient: Float, group: int, speed: Float | float | None = None) -> Float:
    """Derivatives of results by the sizes of causes that change values of the model, shape ``(..., k)``, from those by
    the model parameters of a group, ``(..., P)``; ``speed`` as for :func:`propagated`, or one a result."""
    solved = fit.settings.solved
    return value_slopes(fit.model, fit.thetas[group], gradient, speed, solved) if solved else np.zeros(0)


def theta_at(fit: FitResult, group: int, speed: float) -> Float:
    """Parameter vector of a group, shape ``(P,)``, with what the causes that were found change of it at a speed."""
    theta, solved = fit.thetas[group], fit.settings.solved
    if solved is None:
        return np.asarray(theta)
    return np.asarray(theta + solved.errors.value @ value_slopes(fit.model, theta, np.eye(theta.size), speed, solved).T)


def covariance_of(fit: FitResult, slopes: Float, by_causes: Float) -> Float:
    """Covariance of results, from their derivatives by the fitted vector, shape ``(n, p)``, and by the sizes of causes,
    ``(n, k)``."""
    solved = fit.settings.solved
    if solved is None:
        return np.asarray(slopes @ fit.covar @ slopes.T)
    errors = solved.errors
    along = errors.along(slopes, by_causes)
    by_noise = slopes @ (fit.covar - errors.covariance) @ slopes.T
    return np.asarray(by_noise + errors.widened * (along @ errors.covar @ along.T))


def stderr_of(fit: FitResult, slopes: Float, by_causes: Float) -> Float:
    """Standard errors of many results, shape ``(n,)``, from derivatives as for :func:`covariance_of`."""
    solved = fit.settings.solved
    if solved is None:
        return standard_error(slopes, fit.covar)
    errors = solved.errors
    by_noise = standard_error(slopes, fit.covar - errors.covariance)
    by_all = standard_error(errors.along(slopes, by_causes), errors.covar * errors.widened)
    return np.hypot(by_noise, by_all)


def error_bar(fit: FitResult, slopes: Mapping[str, float]) -> ErrorBar | None:
    """See :meth:`~rotorfit.identify.fitting.result.FitResult.error_of`."""
    solved = fit.settings.solved
    if solved is None:
        return None
    slope, by_causes = slopes_of(fit, slopes)
    errors = solved.errors
    noise = math.sqrt(max(float(slope @ (fit.covar - errors.covariance) @ slope), 0.0))
    names = [cause.name for cause in solved.causes]
    freedom = fit.freedom if fit.noise is None else fit.noise.degrees(slope)
    return ErrorBar.of(errors, names, noise, errors.along(slope, by_causes), freedom)


def independent_parts(fit: FitResult, slopes: Mapping[str, float]) -> Float:
    """The error of a result by independent numbers of unit variance, those of the noise and those of the causes."""
    slope, by_causes = slopes_of(fit, slopes)
    solved = fit.settings.solved
    if solved is None:
        return spread_along(slope, fit.covar)
    errors = solved.errors
    along = errors.along(slope, by_causes)
    noise, beside = fit.covar - errors.covariance, errors.covar * errors.widened
    return np.concatenate([spread_along(slope, noise), spread_along(along, beside)])


def slopes_of(fit: FitResult, slopes: Mapping[str, float]) -> tuple[Float, Float]:
    """Derivatives by the fitted vector and by the sizes of causes, of derivatives by name."""
    solved = fit.settings.solved
    slope = _by_fitted(fit, slopes)
    causes = solved.causes if solved else ()
    by_causes = np.array([slopes.get(f"{CAUSE}{cause.name}", 0.0) for cause in causes])
    held = np.array([0.0 if name in fit.var_names else slopes.get(name, 0.0) for name in fit.model.parameter_names])
    if held.any():
        by_causes = by_causes + by_values_of_causes(fit, held, 0)
    if THRESHOLD in slopes and (onset := fit.onset(0)) is not None:
        times = slopes[THRESHOLD]
        slope = slope + times * fit.problem.space.pull_back(onset.gradient, 0)
        if solved:
            by_causes = by_causes + times * onset_slopes(fit.model, fit.theta(), onset, solved)
    return slope, by_causes


def made_of(fit: FitResult, value: float, slopes: Mapping[str, float], unit: str) -> Quantity:
    """See :meth:`~rotorfit.identify.fitting.result.FitResult.quantity`."""
    slope = _by_fitted(fit, slopes)
    by_onset = slopes.get(THRESHOLD, 0.0)
    onset = fit.onset(0) if by_onset else None
    beside = 0.0
    if onset is not None:
        along = fit.problem.space.pull_back(onset.gradient, 0)
        slope = slope + by_onset * along
        own = fit.threshold_of(0).stderr  # with the difference between candidates, which parameters do not know
        beside = abs(by_onset) * math.sqrt(max(own**2 - float(standard_error(along, fit.covar)) ** 2, 0.0))
    found = _with_error(fit, value, slope, unit, slopes)
    return replace(found, stderr=math.hypot(found.stderr, beside))


def _by_fitted(fit: FitResult, slopes: Mapping[str, float]) -> Float:
    """Derivatives by the fitted vector, of derivatives by name."""
    return np.array([slopes.get(name, 0.0) for name in fit.var_names])


def _with_error(fit: FitResult, value: float, slope: Float, unit: str, slopes: Mapping[str, float]) -> Quantity:
    """A quantity with its derivatives by the fitted vector, and those by name of all that it is made of."""
    made = Quantity(value, math.inf, unit, source=fit, slopes=dict(slopes))
    if fit.identifiability.leaves_open(np.abs(value), slope[None]).any():
        return made
    if not fit.success:
        return replace(made, stderr=math.nan)
    freedom = fit.freedom if fit.noise is None else fit.noise.degrees(slope)
    bar = error_bar(fit, slopes)
    stderr = float(standard_error(slope, fit.covar)) if bar is None else bar.stderr
    return replace(made, stderr=stderr, freedom=freedom)
