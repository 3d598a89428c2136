"""Fixed causes of what a fit misses, asked before random ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from rotorfit.base.array_types import ComplexArray, Float, Index
from rotorfit.base.significance import P_UNLIKELY, P_WARNING
from rotorfit.estimators.inference.score_tests import joint_gains
from rotorfit.estimators.inference.smooth_causes import Cause, cause_columns, causes_of
from rotorfit.estimators.misfit.problem import Problem
from rotorfit.estimators.noise.run_effects import MixedModel, select_effects
from rotorfit.estimators.noise.sweep_noise import NOISE_FLOOR
from rotorfit.identify.fitting.noise.noise_fit import (
    RESPONSE,
    SPEED,
    LinearisedFit,
    NoiseFit,
    linearise,
    sigma_of_residuals,
    weighing_sigma,
)


def fixed_causes(problem: Problem, x: Float, data: LinearisedFit) -> tuple[tuple[Cause, ...], LinearisedFit]:
    """Smooth causes that explain what the fit misses, and the linearised fit with their columns beside its values."""
    causes = causes_of(problem, x)
    readings = problem.measured / problem.sigma
    if not causes or np.linalg.norm(data.r) <= NOISE_FLOOR * np.linalg.norm(readings):  # exact data miss digits only
        return (), data
    columns = cause_columns(problem, x, causes)
    own = np.split(np.arange(columns.shape[1]), np.cumsum([len(cause.parts) for cause in causes])[:-1])
    found: tuple[int, ...] = ()
    most_causes = 3  # causes that are looked for one after the other; where more act, the model is another one
    while len(found) < most_causes:
        best = _most_likely(data, columns, own)
        if best is None:
            break
        taken = [k for one in found for k in own[one]]
        if found and best != _most_likely(*_at_own_optimum(problem, x, data, causes, taken), own):
            break
        beside = _beside(data, columns[:, own[best]])
        if data.kinds and not _better_than_runs(data, beside):
            break
        data, found = beside, (*found, best)
    return tuple(causes[k] for k in found), data


def _at_own_optimum(
    problem: Problem, x: Float, data: LinearisedFit, causes: Sequence[Cause], taken: Sequence[int]
) -> tuple[LinearisedFit, ComplexArray]:
    """The fit beside the columns that were taken, about where they lead it, and the columns of all causes there: what
    linearising about a fit without a large cause leaves of it is no further one."""
    columns = cause_columns(problem, x, causes)
    if data.forced or problem.priors:  # entries that the linearised fit does not have, or has with their gradients
        return data, columns
    at, sizes, share = x, np.zeros(len(taken)), 1.0
    for _ in range(15):  # Gauss-Newton steps, shorter where they do not descend; three do unless a cause is large
        step = share * data.alone.solution.step
        ahead, beside = at + step[: x.size], sizes + step[x.size :]
        there, changes = linearise(problem, ahead), cause_columns(problem, ahead, causes)
        r = np.full(1, np.inf) if there is None else there.r + changes[:, taken] @ beside
        if there is None or not np.linalg.norm(r) < np.linalg.norm(data.r):
            share /= 4
            continue
        at, sizes, columns, share = ahead, beside, changes, 1.0
        data = replace(_beside(there, columns[:, taken]), r=r)
    return data, columns


def with_sizes(causes: Sequence[Cause], step: Float) -> tuple[Cause, ...]:
    """Causes with their sizes, which the step to the optimum has last."""
    counts = [len(cause.parts) for cause in causes]
    own = np.split(step[step.size - sum(counts) :], np.cumsum(counts)[:-1])
    return tuple(replace(cause, sizes=tuple(sizes.tolist())) for cause, sizes in zip(causes, own, strict=False))


def _beside(data: LinearisedFit, columns: ComplexArray) -> LinearisedFit:
    """The linearised fit with more columns, of which nothing is known beforehand."""
    prior = np.concatenate([data.prior, np.zeros(columns.shape[1])])
    return replace(data, J=np.hstack([data.J, columns]), prior=prior)


def _most_likely(data: LinearisedFit, columns: ComplexArray, own: Sequence[Index]) -> int | None:
    """The cause that explains most by an F test, its residuals weighed by the size that they have; none by chance."""
    from scipy.special import fdtrc  # late: loading it takes longer than a fit

    sigma = sigma_of_residuals(data.alone, (RESPONSE, SPEED))[1]
    scale = (sigma / data.sigma)[:, None]
    gains = joint_gains(data.r / scale[:, 0], data.J / scale, columns / scale, data.prior, own)
    F = gains.gain / np.maximum(gains.rank, 1) / ((gains.square - gains.gain) / (gains.freedom - gains.rank))
    p = np.where(gains.rank > 0, fdtrc(np.maximum(gains.rank, 1), gains.freedom - gains.rank, F), 1.0)
    best = int(np.argmin(p))
    if p[best] > P_WARNING / len(own):
        return None
    beside = NoiseFit.of(_beside(data, columns[:, own[best]]), sigma, np.zeros(len(data.kinds)))
    shared = 1 + 2 * sum(beside.memory(sigma).lags)  # neighbours that correlate are fewer readings
    chance = fdtrc(gains.rank[best], (gains.freedom - gains.rank[best]) / shared, F[best] / shared)
    return best if chance < P_WARNING / len(own) else None


def _better_than_runs(data: LinearisedFit, beside: LinearisedFit) -> bool:
    """True if runs that differ at random do not explain as well what a cause does: within the runs, or between them."""
    from scipy.special import fdtrc  # late: loading it takes longer than a fit

    separate = np.array([kind != "run_fluid" for kind in data.kinds])  # that is K0 and D together
    sigma = weighing_sigma(NoiseFit.of(beside, data.sigma, np.where(separate, np.inf, 0.0)))
    without_cause, with_cause = (MixedModel.of(*one.weighed(sigma), one.rows, one.prior) for one in (data, beside))
    variance = select_effects(without_cause, level=P_WARNING, forced=data.forced)
    if np.count_nonzero(variance) <= len(data.forced):
        return True
    own = np.flatnonzero(separate)
    free = np.full(own.size, np.inf)
    columns = beside.prior.size - data.prior.size
    left = with_cause.part(own).solve(free).square
    gain = without_cause.part(own).solve(free).square - left
    freedom = 2 * data.r.size - beside.prior.size - own.size * len(data.runs)
    if freedom > 0 and fdtrc(columns, freedom, gain / columns / (left / freedom)) < P_WARNING:
        return True
    # Gain in likelihood as of a straight line through one value of each run, which few runs have by chance.
    spread = select_effects(with_cause, level=P_WARNING, forced=data.forced)
    ratio = 2 * (_likelihood(with_cause, spread) - _likelihood(without_cause, variance)) / len(data.runs)
    freedom = len(data.runs) - 1 - columns
    return freedom > 0 and bool(fdtrc(columns, freedom, freedom / columns * np.expm1(max(ratio, 0.0))) < P_UNLIKELY)


def _likelihood(model: MixedModel, variance: Float) -> float:
    some = np.flatnonzero(variance)
    return float(model.part(some).log_likelihood(variance[some], restricted=False))
