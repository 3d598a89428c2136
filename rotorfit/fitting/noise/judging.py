"""What the residuals ask of the error bars, and what of the noise is worth a warning."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from rotorfit.estimators.misfit.problem import Problem
from rotorfit.estimators.noise.correlation import scatter
from rotorfit.estimators.noise.robust_covariance import line_scatter
from rotorfit.fitting.noise.record import Noise, NoiseVerdict, is_run_effect
from rotorfit.fitting.noise.search import lines_in, sweeps_in
from rotorfit.fitting.settings import FitSettings
from rotorfit.models.array_types import Float

MODEL_LIMITED = 2.0
"""redchi above which a result that has nothing else to go by says that the model, not the noise, limits the fit."""

UNEVEN, _SUSPECT = 4.5, 2.5
"""Standard deviations of scatter beyond that of equal noise, where all else looks well, and where not."""


def as_residuals_ask(
    noise: Noise,
    problem: Problem,
    r: NDArray[np.complex128],
    J: NDArray[np.complex128],
    scattered: Float,
    covar: Float,
    widening: float,
) -> tuple[Float, Noise]:
    """The covariance with what residuals that follow one another, or scatter unevenly, add to it."""
    if noise.verdict is NoiseVerdict.MISFIT:
        return covar, noise
    if noise.verdict is NoiseVerdict.FOLLOWING:
        return covar + scattered @ scatter(J, sweeps_in(problem), noise.lags) @ scattered * widening, noise
    found = line_scatter(r, J, scattered, lines_in(problem), widening)
    parameters = slice(0, len(problem.space.names))
    limit = UNEVEN if noise.verdict is NoiseVerdict.AS_FOUND else _SUSPECT
    if problem.loss != "linear" or float(found.excess[parameters].max(initial=0.0)) < limit:
        return covar, noise
    robust = found.covar
    for prior in problem.priors:  # what is known beforehand does not scatter
        column = scattered[:, prior.entry] * np.sqrt(prior.terms(0.0)[2])
        robust = robust + np.outer(column, column)
    told = "the residuals scatter more along some changes than equal noise does; standard errors follow them (HC3)"
    freedom = float(np.median(found.freedom[parameters]))
    sentences = tuple(dict.fromkeys((*noise.sentences, told)))  # said once, however often the fit was solved again
    return robust, replace(noise, robust=True, scatter_freedom=max(freedom, 1.0), sentences=sentences)


def allowed_for(
    noise: Noise, problem: Problem, x: Float, J: NDArray[np.complex128], scattered: Float
) -> tuple[Float, ...]:
    """What runs that may differ add to the covariance, kind by kind, each of shape ``(p, p)``."""
    if not noise.perhaps:
        return ()
    run = np.concatenate([block.run for block in problem.blocks])
    sigma = np.concatenate([block.sigma for block in problem.blocks])
    whitened = np.concatenate(problem.predict(x)) / sigma
    shares = []
    for effect in noise.perhaps:
        change = effect.sd * np.concatenate(effect.sensitivities) * whitened
        columns = change[:, None] * (run[:, None] == np.array(effect.runs))
        moves = scattered @ (J.conj().T @ columns).real
        shares.append(moves @ moves.T)
    return tuple(shares)


def with_shares(
    noise: Noise, settings: FitSettings, problem: Problem, x: Float, covar: Float, allowed: Sequence[Float] = ()
) -> Noise:
    """The record with the parts of the covariance: effects of runs one by one, then all the rest."""
    effects = () if settings.noise is None else settings.noise.effects
    names = (*problem.space.names, *problem.space.nuisance)
    shares = []
    for effect in effects:
        columns = covar[:, [names.index(name) for name in effect.names]] / effect.sd
        shares.append(columns @ columns.T)
    rest = covar - np.sum(shares, axis=0) if shares else covar
    shares += allowed
    between = (*effects, *noise.perhaps)
    freedom = [effect.freedom for effect in between]
    if between and len(between[0].runs) == 2:  # whatever two runs differ by is read from the same difference
        shares, freedom = [np.sum(shares, axis=0)], [max(freedom)]
    error = np.sqrt(np.maximum(np.diag(covar), 0.0)).tolist()
    runs = tuple((name, float(x[i]), error[i]) for i, name in enumerate(names) if is_run_effect(name))
    return replace(noise, runs=runs, shares=(*shares, rest), freedom=(*freedom, noise.scatter_freedom))


def is_misfit(noise: Noise | None, widening: float) -> bool:
    """Whether the model, not the noise, limits a fit: by its residuals' memory, or else by their size alone."""
    return widening > MODEL_LIMITED if noise is None else noise.verdict is NoiseVerdict.MISFIT


def noise_warnings(noise: Noise, redchi: float) -> list[str]:
    """What of the noise a reader should not miss."""
    found = list(noise.notable)
    if noise.verdict is NoiseVerdict.SHAPED and redchi > MODEL_LIMITED:
        found.append(
            f"redchi is {redchi:.3g}, yet residuals do not follow one another: readings scatter more than found in "
            "the data alone, as by a force or a speed that jitters. They were weighed, and errors stated, by the "
            "scatter of the residuals"
        )
    if noise.verdict is NoiseVerdict.LARGER:
        found.append(
            f"redchi is {redchi:.3g}, yet residuals do not follow one another: the noise is larger than sigma_um says, "
            "and standard errors are wider accordingly. Without sigma_um its size and shape are found"
        )
    if noise.verdict is NoiseVerdict.FOLLOWING:
        found.append(
            f"residuals at neighbouring lines correlate ({noise.correlation:.2f}), as where filters overlap: there are "
            "fewer independent readings than lines, and standard errors are widened accordingly"
        )
    return found
