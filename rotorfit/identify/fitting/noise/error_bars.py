"""Effect of a study of residuals on a problem and on its covariance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from rotorfit.base.array_types import ComplexArray, Float, Index
from rotorfit.estimators.minimisation.projection import Projection
from rotorfit.estimators.misfit.priors import CentredNormal, Prior
from rotorfit.estimators.misfit.problem import Derivatives, Problem
from rotorfit.estimators.noise.residuals import line_scatter, scatter_in_pieces
from rotorfit.identify.fitting.noise.noise_fit import channels_of, lines_in
from rotorfit.identify.fitting.noise.record import RUN_KINDS, FoundNoise, NoiseVerdict, is_run_effect
from rotorfit.identify.fitting.noise.residual_study import ResidualStudy
from rotorfit.identify.fitting.settings import FitSettings


def with_noise(problem: Problem, noise: FoundNoise) -> Problem:
    """The problem with noise of another size, and differences of runs as nuisance entries with priors."""
    problem = problem.with_noise(np.concatenate(noise.factors))
    space, priors, blocks = problem.space, problem.priors, problem.blocks
    factors = problem.factors or (None,) * len(blocks)
    for effect in noise.effects:
        columns = [
            sensitivity[:, None] * (block.run[:, None] == np.array(effect.runs)[None, :])
            for block, sensitivity in zip(blocks, effect.sensitivities, strict=True)
        ]
        first = space.size
        space = replace(
            space,
            nuisance=(*space.nuisance, *effect.names),
            lower=np.concatenate([space.lower, np.full(len(effect.runs), -np.inf)]),
            upper=np.concatenate([space.upper, np.full(len(effect.runs), np.inf)]),
        )
        factors = tuple(
            column if own is None else np.hstack([own, column]) for own, column in zip(factors, columns, strict=True)
        )
        spread = CentredNormal(effect.sd)
        priors += tuple(Prior(first + i, spread) for i in range(len(effect.runs)))
    return replace(problem, space=space, priors=priors, factors=factors)


def effect_entries(problem: Problem, noise: FoundNoise | None) -> list[tuple[Index, float]]:
    """Entries of the fitted vector of each effect of runs, and its standard deviation."""
    names = (*problem.space.names, *problem.space.nuisance)
    effects = () if noise is None else noise.effects
    return [(np.array([names.index(n) for n in e.names]), e.sd) for e in effects]


def without_noise(problem: Problem, noise: FoundNoise) -> Problem:
    """The problem before :func:`with_noise`; offsets of phase_offsets stay, with their priors."""
    count = problem.space.size - sum(len(effect.runs) for effect in noise.effects if effect.kind in RUN_KINDS)
    own = count - len(problem.space.names)
    space = replace(
        problem.space,
        nuisance=problem.space.nuisance[:own],
        lower=problem.space.lower[:count],
        upper=problem.space.upper[:count],
    )
    priors = tuple(prior for prior in problem.priors if prior.entry < count)
    factors = tuple(None if part is None or not own else part[:, :own] for part in problem.factors)
    given = problem.with_noise(1 / np.concatenate(noise.factors))
    return replace(given, space=space, priors=priors, factors=factors)


def with_scatter(
    study: ResidualStudy,
    problem: Problem,
    r: ComplexArray,
    derivatives: Derivatives,
    scattered: Float,
    covar: Float,
    widening: float,
) -> tuple[Float, ResidualStudy]:
    """The covariance with what residuals that follow one another, or scatter unevenly, add to it."""
    if study.correlated:
        sweeps = [sweep for sweeps in channels_of(problem) for sweep in sweeps]
        if study.verdict is NoiseVerdict.CORRELATED:
            added = scatter_in_pieces(derivatives.pieces(), len(covar), sweeps, study.lags)
            return covar + scattered @ added @ scattered * widening, study
        ratio = np.concatenate(study.noise_ratio)  # as if the misfit were noise of its own shape and memory
        own = [(readings, entries, rows * ratio[readings]) for readings, entries, rows in derivatives.pieces()]
        added = scatter_in_pieces(own, len(covar), sweeps, study.lags)
        for _, entries, rows in own:
            added[np.ix_(entries, entries)] += (rows.conj() @ rows.T).real
        as_noise = scattered @ added @ scattered
        return covar + _beyond(as_noise, covar), study
    if study.verdict is NoiseVerdict.MISFIT:
        return covar, study
    projection = Projection.of(problem) if derivatives.in_channels else None
    shared = None if projection is None else projection.kept  # what probes share, where each has entries of its own
    lines, parameters = lines_in(problem), slice(0, len(problem.space.names))
    found = line_scatter(r, derivatives.pieces(), scattered, lines, widening, shared)
    as_found = study.verdict is NoiseVerdict.AS_FOUND
    # Standard deviations of scatter beyond that of equal noise from which standard errors follow it: where all else
    # looks well (once in 300 000 by the normal distribution), and where the noise was not as expected (once in 160)
    uneven_scatter, uneven_scatter_of_other_noise = 4.5, 2.5
    limit = uneven_scatter if as_found else uneven_scatter_of_other_noise
    if problem.loss != "linear" or float(found.excess[parameters].max(initial=0.0)) < limit:
        return covar, study
    if shared is not None:
        found = line_scatter(r, derivatives.pieces(), scattered, lines, widening)
    robust = found.covar
    for prior in problem.priors:  # what is known beforehand does not scatter
        column = scattered[:, prior.entry] * np.sqrt(prior.terms(0.0)[2])
        robust = robust + np.outer(column, column)
    freedom = float(np.median(found.freedom[parameters]))
    return robust, replace(study, robust=True, scatter_freedom=max(freedom, 1.0))


def _beyond(covar: Float, other: Float) -> Float:
    """Part of a covariance beyond another one: added to that, it makes nothing smaller."""
    size = np.sqrt(np.diag(other))
    scale = np.outer(np.where(size > 0, size, 1.0), np.where(size > 0, size, 1.0))
    power, basis = np.linalg.eigh((covar - other) / scale)
    return np.asarray((basis * np.maximum(power, 0.0)) @ basis.T * scale)


def shares_of_possible_effects(
    study: ResidualStudy, problem: Problem, x: Float, derivatives: Derivatives, scattered: Float
) -> tuple[Float, ...]:
    """Contribution of possible differences of runs to the covariance, kind by kind, each of shape ``(p, p)``."""
    if not study.possible_effects:
        return ()
    whitened = np.concatenate(problem.predict(x)) / problem.sigma
    shares = []
    for effect in study.possible_effects:
        change = effect.sd * np.concatenate(effect.sensitivities) * whitened
        columns = change[:, None] * (problem.run[:, None] == np.array(effect.runs))
        moves = scattered @ (derivatives.whole.conj().T @ columns).real
        shares.append(moves @ moves.T)
    return tuple(shares)


def with_shares(
    study: ResidualStudy, settings: FitSettings, problem: Problem, x: Float, covar: Float, possible: Sequence[Float]
) -> ResidualStudy:
    """The study with the parts of the covariance: effects of runs one by one, possible ones, then all the rest."""
    study = replace(study, found=settings.noise)
    names = (*problem.space.names, *problem.space.nuisance)
    shares = []
    for effect in study.effects:
        columns = covar[:, [names.index(name) for name in effect.names]] / effect.sd
        shares.append(columns @ columns.T)
    rest = covar - np.sum(shares, axis=0) if shares else covar
    shares += possible
    between = (*study.effects, *study.possible_effects)
    freedom = [effect.freedom for effect in between]
    if between and len(between[0].runs) == 2:  # whatever two runs differ by is read from the same difference
        shares, freedom = [np.sum(shares, axis=0)], [max(freedom)]
    error = np.sqrt(np.maximum(np.diag(covar), 0.0)).tolist()
    runs = tuple((name, float(x[i]), error[i]) for i, name in enumerate(names) if is_run_effect(name))
    return replace(study, runs=runs, shares=(*shares, rest), freedom=(*freedom, study.scatter_freedom))
