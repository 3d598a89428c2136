"""A fit about its optimum solved with given noise and effects of runs, and the noise that its residuals have."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from rotorfit.estimators.noise.correlation import Memory, memory
from rotorfit.estimators.noise.noise_levels import Shape, fit_probes, likelihood
from rotorfit.estimators.noise.run_effects import LEAST_RESIDUAL_SHARE, MixedModel, MixedSolution, Residuals
from rotorfit.fitting.noise.linearised import LinearisedFit
from rotorfit.models.array_types import Float

_LEAST_SHAPE_GAIN = 12.0
"""Twice the gain in log likelihood, for each probe, from which noise by residuals replaces that of the data alone: the
99.75 % point of chi-squared with the two parts of a shape as degrees of freedom."""

RESPONSE, SPEED = "of the response", "of the speed, as it moves the response"
"""Quantities that noise may grow with."""


@dataclass(frozen=True, eq=False, kw_only=True)
class NoiseFit:
    """A mixed model solved with given noise and effects of runs."""

    data: LinearisedFit
    sigma: Float  # noise that weighed the readings, in their units
    solution: MixedSolution
    residuals: Residuals  # in units of sigma

    @classmethod
    def of(cls, data: LinearisedFit, sigma: Float, variance: Float) -> NoiseFit:
        """Solve with variances of the effects by kind, zero for those that runs do not have."""
        kinds = np.flatnonzero(variance)
        r, J, Z = data.weighed(sigma)
        solution = MixedModel.of(r, J, Z[:, kinds], data.rows, data.prior).solve(variance[kinds])
        residuals = solution.residuals(r, J, Z[:, kinds], data.rows)
        return cls(data=data, sigma=sigma, solution=solution, residuals=residuals)

    @cached_property
    def weight(self) -> Float:
        """One less the leverage of each reading."""
        return np.clip(1 - self.residuals.leverage, LEAST_RESIDUAL_SHARE, 1.0)

    @cached_property
    def power(self) -> Float:
        """Squared residuals, leverage-corrected, in units of what the sensors measured."""
        return np.asarray(np.abs(self.residuals.values) ** 2 / 2 * self.sigma**2 / self.weight * self.data.rate**2)

    @cached_property
    def power_given(self) -> Float:
        """Square of the noise of the data in the same units."""
        return np.asarray(self.data.sigma**2 * self.data.rate**2)

    @property
    def redchi(self) -> float:
        """Mean squared residual over the noise of the data."""
        return float(np.sum(self.weight * self.power / self.power_given) / np.sum(self.weight))

    def memory(self, sigma: Float) -> Memory:
        """Correlation along the sweeps of residuals in units of a noise."""
        values = self.residuals.values * (self.sigma / sigma)
        return memory(values, self.residuals.sensitivities, self.solution.outer, self.data.sweeps)


def reweighted(data: LinearisedFit, variance: Float) -> NoiseFit:
    """The mixed model weighed by the noise of its own residuals."""
    fit = NoiseFit.of(data, data.sigma, variance)
    # Times that the fit is weighed anew by the noise of its residuals: in nineteen of twenty fits of
    # ``benchmarks/honest_errors.py`` a third would change sigma by less than a percent.
    for _ in range(2):
        sigma = weighing_sigma(fit)
        if np.array_equal(sigma, fit.sigma):
            break
        fit = NoiseFit.of(data, sigma, variance)
    return fit


def weighing_sigma(fit: NoiseFit) -> Float:
    """Noise to weigh by: as given, but not less than residuals ask; else as they have it."""
    if fit.data.sigma_given:
        return np.asarray(fit.data.sigma * np.sqrt(max(1.0, fit.redchi)))
    return sigma_of_residuals(fit, (RESPONSE,))[1]


def sigma_of_residuals(fit: NoiseFit, along: Sequence[str]) -> tuple[list[Shape], Float]:
    """Noise of all probes by restricted likelihood, and sigma of each reading; that of the data where it was given."""
    data, sigma = fit.data, fit.data.sigma.copy()
    if data.sigma_given:
        return [], sigma
    sizes = {RESPONSE: np.abs(data.predicted) ** 2 * data.rate**2}  # as by a force that jitters
    if "run_lam" in data.kinds:
        sizes[SPEED] = np.abs(data.Z[:, data.kinds.index("run_lam")] * data.sigma) ** 2 * data.rate**2
    shapes: list[Shape] = []
    trials_along = [fit_probes(data.channels, fit.power, fit.weight, sizes[a], along=a) for a in along if a in sizes]
    for trials in zip(*trials_along, strict=True):
        gains = [sum(shape.log_likelihood for shape in trial) for trial in trials]
        best = int(np.argmax(gains))
        shapes += trials[best if 2 * (gains[best] - gains[0]) > _LEAST_SHAPE_GAIN else 0]
    for shape in shapes:
        sigma[shape.rows] = np.sqrt(shape.variance(sizes[shape.along])) / data.rate[shape.rows]
    return shapes, sigma


def explains(fit: NoiseFit, shapes: Sequence[Shape]) -> bool:
    """True if the residuals are about as likely under the noise of the data as under one of their own."""
    now = sum(shape.log_likelihood for shape in shapes)
    given = likelihood(fit.power, fit.weight, fit.power_given)
    return 2 * (now - given) < _LEAST_SHAPE_GAIN * len(fit.data.channels)
