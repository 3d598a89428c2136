"""A posterior sampled: from a fit to draws that are enough and independent enough, and what was assumed on the way."""

from __future__ import annotations

import logging
import math
import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from rotorfit.base.array_types import Float
from rotorfit.base.chance import Seed, seed_of
from rotorfit.base.digits import significant
from rotorfit.base.progress import progress_on_stderr
from rotorfit.estimators.blocks.correlated import freedom_of
from rotorfit.estimators.inference import ensemble_sampler
from rotorfit.estimators.inference.caused_posterior import CausedPosterior
from rotorfit.estimators.inference.covariance import inverse_curvature
from rotorfit.estimators.inference.ensemble_sampler import SamplerProgress, WalkerPaths
from rotorfit.estimators.inference.log_posterior import LogPosterior, Noise
from rotorfit.identify.fitting.judge import why_not_refined
from rotorfit.identify.fitting.result import FitResult
from rotorfit.identify.fitting.structure.refine import refine as refine_fit
from rotorfit.identify.fitting.structure.refine import structure_name
from rotorfit.identify.uncertainty.posterior import Posterior, SampleSettings
from rotorfit.identify.uncertainty.target import OF_ONE_MODEL, LogDensity, log_density, posterior_of
from rotorfit.models.shafts.angular_rates import real_number

_LOG = logging.getLogger(__name__)
WALKERS = 128
"""Walkers at most by default, enough to keep vectorised likelihoods busy; more where there are many parameters."""
FEW_WALKERS = 32
"""The same with the matrices of a whole shaft, and with spectra, where many vectors at once save nothing."""


def sample(
    fit: FitResult,
    *,
    rng: Seed = None,
    seed: Seed = None,
    walkers: int | None = None,
    ess: float = 4000,
    max_steps: int = 20_000,
    noise: Noise | None = None,
    refine: bool = False,
    checkpoint: str | os.PathLike[str] | None = None,
    progress: bool | Callable[[SamplerProgress], None] | None = None,
    moves: Sequence[tuple[Any, float]] | None = None,
    accelerate: bool | None = None,
) -> Posterior:
    """Sample the posterior of a fit with emcee until enough effective samples are there.

    Known values, bounds, priors, ``per`` and loss are those of the fit; without a prior a parameter's density is flat
    between its bounds.

    Args:
        fit: result of :func:`rotorfit.fit`.
        rng: of the random numbers, a generator or its seed, which the result keeps; by default one is drawn.
        seed: the same.
        walkers: even number of walkers, by default 128 (32 with the matrices of a whole shaft or spectra of
            operating vibration, and fewer for an ``ess`` that fewer give), or twice the number of entries.
        ess: effective samples to reach.
        max_steps: steps after which to stop in any case; the result then says that it is not converged.
        noise: level of the noise in each channel: "marginal" (default: unknown and integrated out, so that a channel
            that the model misses widens by itself), "sampled" (the same, its logarithm sampled too) or "fixed" (as
            given with the data, the only one for a robust loss; widened by redchi where the model limits the fit).
        refine: first add the structural blocks that AIC asks for, see :func:`rotorfit.refine`.
        checkpoint: HDF5 file to write at every look at the chain; a run that was stopped continues from it.
        progress: whether a line of progress is printed to stderr, by default where that is a terminal; or a function
            that is called with a :class:`~rotorfit.estimators.inference.ensemble_sampler.SamplerProgress`.
        moves: emcee moves with weights, by default independence proposals from the normal approximation mixed with
            emcee's DE and stretch moves.
        accelerate: compile the likelihood with numba; by default where it is installed and pays.

    Returns:
        the draws; :attr:`Posterior.converged` and :attr:`Posterior.message` say how the run ended.

    Raises:
        ValueError: a closed-form result or a fit that did not converge, noise that few mountings of weights tell, an
            unknown noise treatment or one that the loss rules out, a posterior without limits in some direction, too
            few walkers, ``ess`` that is no positive number, a checkpoint of another run.

    Example:
        >>> posterior = rf.sample(fit, seed=1, walkers=32, ess=100)
        >>> posterior.converged
        True
    """
    allowed = "a positive number of effective samples (ess=, --ess)"
    if real_number(ess, "ess", allowed) <= 0:
        raise ValueError(f"ess is {ess:g}; it must be {allowed}")
    structure = ""
    if refine:
        refinement = refine_fit(fit)
        fit, tried = refinement.best, ", ".join(structure_name(step.model) for step in refinement.steps)
        structure = f"structure chosen by AIC: {structure_name(fit.model)} (of: {tried}); "
    settings = _settings(fit, noise, ess=ess, max_steps=max_steps)
    typical_steps = 400  # of a well-behaved posterior, to judge whether compiling pays
    work = max(ess, (walkers or WALKERS) * typical_steps)
    target = posterior_of(fit, settings, accelerate=accelerate, work=work)
    one_by_one = fit.model.shaft is not None or not all(block.normal for block in fit.problem.blocks)
    usual = FEW_WALKERS if one_by_one else WALKERS
    # Each gives 100 effective samples until its times are resolved; thrice as many walkers keep likelihoods busy
    enough = 2 * math.ceil(ess / 60)
    count = walkers or max(min(usual, max(16, enough)), 2 * target.size)
    centre, covariance = target.laplace(fit.x)
    with progress_on_stderr(progress, _state_in_words) as report:
        paths = ensemble_sampler.sample(
            target,
            centre,
            covariance,
            walkers=count,
            ess=ess,
            max_steps=max_steps,
            seed=None if rng is None and seed is None else seed_of(rng, seed, 0),
            checkpoint=None if checkpoint is None else Path(checkpoint),
            report=report,
            moves=list(moves) if moves else None,
        )
    _LOG.info(
        "sampled %s with seed %d: %d steps of %d walkers, %s",
        fit.model.name,
        paths.seed,
        paths.steps,
        count,
        paths.message,
    )
    chain, sizes = paths.draws, None
    if isinstance(target, CausedPosterior):
        flat, sizes = target.drawn(chain.reshape(-1, target.size), np.random.default_rng(paths.seed))
        chain, sizes = flat.reshape(chain.shape), sizes.reshape(*chain.shape[:2], -1)
    return Posterior(
        fit=fit,
        names=target.names,
        chain=chain,
        log_density=paths.log_density,
        acceptance=paths.acceptance,
        tau=paths.tau,
        burn_in=paths.burn_in,
        converged=paths.converged,
        message=paths.message,
        treatment=structure
        + _treatment(fit, target, centre)
        + _better_optimum(target, centre, paths)
        + _visited(fit, chain),
        seed=paths.seed,
        settings=replace(settings, walkers=count, steps=paths.steps),
        sizes=sizes,
    )


def _settings(fit: FitResult, noise: Noise | None, *, ess: float, max_steps: int) -> SampleSettings:
    _refuse_unsampled(fit)
    # The level of the noise is unknown unless the loss, or the likelihood of readings, has a scale of its own.
    scaled = fit.settings.loss != "linear" or not all(block.normal for block in fit.problem.blocks)
    level: Noise = noise or ("fixed" if scaled else "marginal")
    return SampleSettings(
        noise=level, inflation=_inflation(fit, level), walkers=0, ess=ess, max_steps=max_steps, steps=0,
        between_runs=True, causes=fit.settings.solved is not None,
    )  # fmt: skip


def log_posterior(fit: FitResult, noise: Noise | None = None) -> LogDensity:
    """See :meth:`rotorfit.FitResult.log_posterior`."""
    if noise == "sampled":
        raise ValueError("noise is 'sampled'; a density of the fitted values has it 'marginal' or 'fixed'")
    return log_density(fit, _settings(fit, noise, ess=0.0, max_steps=0))


def _refuse_unsampled(fit: FitResult) -> None:
    """Refuse what has no optimum to start from, or no likelihood."""
    if fit.method != "least squares" or not fit.success:
        state = "a closed form" if fit.method != "least squares" else f"a fit that did not converge ({fit.message})"
        raise ValueError(f"this is {state}: walkers start from the optimum of rf.fit")
    if np.isfinite(freedom_of(fit.problem.blocks)):
        raise ValueError(
            "the noise of these data is known from few mountings of weights, and their readings err together: their "
            "covariance has too small a rank for a likelihood, and one that takes the noise as known would give "
            "intervals that are too narrow. Use params[...].interval(), which is Student's t, or profile"
        )


def _inflation(fit: FitResult, level: Noise) -> float:
    """Factor on variances that the likelihood lacks: of a model that limits the fit, of readings that are correlated.
    The level of unknown noise is that of the residuals already."""
    if fit.noise is not None and fit.noise.correlated:
        white = np.diag(inverse_curvature(fit.problem, fit.x)).tolist()
        others = (fit.settings.solved is not None) + (fit.model_uncertainty is not None)  # after it
        within = np.diag(fit.noise.shares[-1 - others])  # all but differences of runs
        told = [i for i, name in enumerate(fit.problem.space.names) if fit.params[name].resolved]
        wider = [float(within[i]) / white[i] for i in told if white[i] > 0]
        return max(float(np.median(wider)) / (1.0 if level == "fixed" else fit.redchi), 1.0) if wider else 1.0
    return fit.widening if fit.model_limited and level == "fixed" else 1.0


def _treatment(fit: FitResult, target: LogPosterior, centre: Float) -> str:
    """Treatment of noise and model-form error, in words."""
    if not fit.model_limited:
        words = _noise_words(fit, target, centre)
        if isinstance(target, CausedPosterior):
            words += f"; {target.causes.at.size} causes beside the model integrated out"
        if fit.noise is not None and fit.noise.effects:
            words += "; variances of what differs from run to run unknown and integrated out"
        elif fit.noise is not None and fit.noise.possible_effects:
            words += (
                "; runs are taken to agree: what they may differ by, which standard errors allow for, is not in here"
            )
        if fit.model_uncertainty is not None:
            words += f". {OF_ONE_MODEL}"
        return words
    if fit.settings.noise_scale:
        advice = "bring the shaft's matrices (KnownStructure)"
    elif not why_not_refined(fit.model, fit.identifiability):
        advice = "sample a refined fit instead (refine=True, --refine)"
    else:
        advice = "a richer model is needed"
    return (
        f"{_noise_words(fit, target, centre)}. redchi is {significant(fit.redchi, 3)}: the model, not the noise, "
        f"limits the fit. That widens the intervals, but parameters may be biased beyond them: {advice}"
    )


def _noise_words(fit: FitResult, target: LogPosterior, centre: Float) -> str:
    """Level assumed for the noise, in words."""
    if target.noise == "fixed":
        if fit.settings.noise_scale:
            return "noise of each response at the level of the residuals of the refined fit"
        if fit.settings.loss != "linear":
            return f"noise as given with the data, {fit.settings.loss} loss"
        if target.inflation == 1.0:
            return "noise as given with the data"
        wider = significant(np.sqrt(target.inflation), 3)
        return f"noise as given with the data, standard deviations widened by {wider}"
    parameters = centre[None, : target.problem.space.size]
    level = np.sqrt((target.channel_sums(parameters)[0] + 1.0) / target.counts)
    level *= [fit.settings.noise_scale.get(name, 1.0) for name in fit.problem.channel_names]
    how = "integrated out" if target.noise == "marginal" else "sampled"
    size = f"{significant(level.min(), 3)} to {significant(level.max(), 3)}"
    words = f"noise level of each channel unknown and {how}; at the optimum {size} times the noise given with the data"
    if target.inflation == 1.0:
        return words
    return f"{words}; variances are {significant(target.inflation, 2)} times as large, as readings are correlated"


def _better_optimum(target: LogPosterior, centre: Float, paths: WalkerPaths) -> str:
    """Warning where draws are denser than the optimum that the walkers started from can be."""
    best = paths.draws[np.unravel_index(np.argmax(paths.log_density), paths.log_density.shape)]
    lead = float(np.diff(target.height(np.array([centre, best])))[0])
    largest_excess = 0.5  # excess of the log density over that at the optimum that is more than an optimum's inaccuracy
    if not lead > largest_excess:
        return ""
    return (
        f". The log density of the best draw is {significant(lead, 3)} above that of the optimum found from the fit: "
        "the fit did not end in the lowest minimum, fit again with start at the medians of these draws"
    )


def _visited(fit: FitResult, chain: Float) -> str:
    """Whether the draws are of other solutions that the data hold as well."""
    words = ""
    for other in fit.other_solutions:
        names = [n for n, value in other.values.items() if value != fit.params[n].value and fit.params[n].stderr]
        places = [fit.problem.space.names.index(name) for name in names]
        error = np.array([fit.params[name].stderr for name in names])
        way = (other.x - fit.x)[places] / error
        share = float((((chain[..., places] - fit.x[places]) / error) @ way > way @ way / 2).mean())
        seen = f"{significant(100 * share, 2)} % of the draws are nearer to it" if share else "no draw is of it"
        words += f". The data hold another solution as well (fit.other_solutions): {seen}"
    return words


def _state_in_words(state: SamplerProgress) -> str:
    return f"{state.steps} steps, {100 * state.done:.0f} %: {state.waiting}"
