"""How well a fit agrees with the data: chi-squared, information criteria, and each response by itself."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rotorfit.estimators.inference import covariance
from rotorfit.estimators.misfit.losses import robust_weights
from rotorfit.estimators.misfit.problem import Problem
from rotorfit.fitting.noise.error_bars import estimate_before, without_noise
from rotorfit.fitting.problem_setup import with_noise_scale
from rotorfit.fitting.quantities import ResponseQuality
from rotorfit.fitting.settings import FitSettings
from rotorfit.models.array_types import ComplexArray, Float, Index


@dataclass(frozen=True, kw_only=True)
class Goodness:
    """Agreement with the data, by the noise of the data, whatever weights the fit gave them."""

    chisqr: float  # sum of squared residuals over the noise
    redchi: float  # the same over the degrees of freedom
    nvarys: int  # fitted values
    nfree: int  # degrees of freedom
    aic: float  # Akaike's information criterion, of the loss
    bic: float  # the Bayesian information criterion, of the loss
    responses: tuple[ResponseQuality, ...]  # agreement response by response


def goodness_of(problem: Problem, settings: FitSettings, x: Float, residuals: ComplexArray) -> Goodness:
    """Agreement of an estimate with the data."""
    given = problem if settings.noise is None else without_noise(problem, settings.noise)
    given = with_noise_scale(given, settings.noise_scale, -1)
    count = given.space.size
    before = estimate_before(settings.noise, x, count)
    whitened = residuals if given is problem else given.residuals(before)
    # A nuisance entry with a prior brings the datum that pays for it.
    paid = sum(prior.entry >= len(problem.space.names) for prior in given.priors)
    nfree = problem.n_data - count + paid
    size2 = np.abs(whitened) ** 2
    chisqr = float(size2.sum())
    deviance = chisqr if problem.loss == "linear" else float(robust_weights(problem.loss, size2)[0].sum())
    return Goodness(
        chisqr=chisqr,
        redchi=deviance * covariance.per_freedom(problem.loss, nfree),
        nvarys=count,
        nfree=nfree,
        aic=deviance + 2 * count,
        bic=deviance + count * float(np.log(problem.n_data)),
        responses=_qualities(given, before),
    )


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
