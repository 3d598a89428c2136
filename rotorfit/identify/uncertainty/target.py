"""The density that a posterior is drawn from, as settings of sampling say."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from rotorfit.estimators.inference.caused_posterior import CausedPosterior
from rotorfit.estimators.inference.caused_problem import CausedProblem
from rotorfit.estimators.inference.log_posterior import LogPosterior
from rotorfit.identify.fitting.causes.solution import SolvedCauses, linear_causes
from rotorfit.identify.fitting.noise.error_bars import effect_entries
from rotorfit.identify.fitting.result import FitResult
from rotorfit.identify.uncertainty.posterior import SampleSettings


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
