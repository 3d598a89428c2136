"""The density that a posterior is drawn from, as settings of sampling say."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from rotorfit.base.array_types import Float
from rotorfit.estimators.inference.caused_posterior import CausedPosterior
from rotorfit.estimators.inference.caused_problem import CausedProblem
from rotorfit.estimators.inference.log_posterior import LogPosterior
from rotorfit.identify.fitting.causes.solution import SolvedCauses, linear_causes
from rotorfit.identify.fitting.noise.error_bars import effect_entries
from rotorfit.identify.fitting.result import FitResult
from rotorfit.identify.uncertainty.posterior import SampleSettings

OF_ONE_MODEL = (
    "The uncertainty of the choice among candidate models, which standard errors hold, is not in these draws of one "
    "model"
)


def caused_problem(fit: FitResult) -> CausedProblem | None:
    """The problem of a fit beside its causes, its noise as the errors have it; None without any."""
    solved = fit.settings.solved
    if solved is None:
        return None
    found = _beside_causes(fit, solved)
    return found if fit.widening == 1 else found.with_noise(math.sqrt(fit.widening))


def _beside_causes(fit: FitResult, solved: SolvedCauses) -> CausedProblem:
    causes = linear_causes(fit.problem, fit.x, solved)
    return CausedProblem(problem=fit.problem, causes=causes, start=np.concatenate([fit.x, causes.at]))


def posterior_of(
    fit: FitResult, settings: SampleSettings, *, accelerate: bool | None = None, work: float = 0.0
) -> LogPosterior:
    """The log posterior of a fit; ``accelerate`` and ``work`` as there."""
    effects = effect_entries(fit.problem, fit.settings.noise) if settings.between_runs else ()
    inflation, solved = settings.inflation, fit.settings.solved
    if not settings.causes or solved is None:
        return LogPosterior(
            fit.problem, settings.noise, inflation=inflation, effects=effects, accelerate=accelerate, work=work
        )
    caused = _beside_causes(fit, solved)
    return CausedPosterior(
        fit.problem,
        settings.noise,
        replace(caused.causes, columns=caused.beside),
        fit.x,
        taken=caused.taken,
        inflation=inflation,
        effects=effects,
        accelerate=accelerate,
        work=work,
    )


@dataclass(frozen=True, eq=False, kw_only=True)
class LogDensity:
    """Log posterior density of the fitted values, up to a constant, for any sampler.

    Called with one vector ``(n,)`` it gives a number, with many ``(W, n)`` as many; minus infinity outside the bounds.
    Unknown levels of noise are integrated out, and so are causes beside the model: vectors are less what values take
    up of them, which :meth:`values` adds to the draws.

    Attributes:
        names: of the entries of a vector: fitted values, then nuisances such as a phase reference.
        bounds: lowest and highest value of each entry, SI units, shape ``(n, 2)``.
        start: where the density is highest, shape ``(n,)``.
        covariance: of the normal approximation there, shape ``(n, n)``.
    """

    names: tuple[str, ...]
    bounds: Float
    start: Float
    covariance: Float
    density: LogPosterior

    def __call__(self, vectors: Float) -> Float:
        """Log density of one vector or of many."""
        vectors = np.asarray(vectors, dtype=float)
        found = self.density(vectors.reshape(-1, self.start.size))
        return np.asarray(found.reshape(vectors.shape[:-1]))[()]

    def values(self, draws: Float, seed: int = 0) -> Float:
        """Fitted values of draws ``(W, n)``: with what they take up of causes, whose sizes are drawn at random.

        Args:
            draws: of a sampler of this density.
            seed: of random numbers.
        """
        if not isinstance(self.density, CausedPosterior):
            return draws
        return self.density.drawn(draws, np.random.default_rng(seed))[0]

    def walkers(self, count: int, seed: int = 0) -> Float:
        """Places from which walkers may start, drawn from the normal approximation within the bounds.

        Args:
            count: of walkers.
            seed: of random numbers.
        """
        rng = np.random.RandomState(seed)
        from rotorfit.estimators.inference.ensemble_sampler import starting_places  # late: it loads emcee

        return starting_places(self.density, self.start, self.covariance, count, rng)


def log_density(fit: FitResult, settings: SampleSettings) -> LogDensity:
    """See :meth:`rotorfit.FitResult.log_posterior`."""
    found = posterior_of(fit, settings)
    start, covariance = found.laplace(fit.x)
    bounds = np.column_stack([found.lower, found.upper])
    return LogDensity(names=found.names, bounds=bounds, start=start, covariance=covariance, density=found)
