"""The study of the residuals of a fit: noise of some shape, noise with memory, differences of runs, or misfit.

A difference from run to run enters the error bar in two steps: :func:`random_effects` estimates its variance here,
``error_bars.py`` fits the problem with it, or adds its share to the covariance where it is only possible. Sigma of the
readings is that of the data until :func:`sigma_of_residuals` replaces it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from rotorfit.base.array_types import Float
from rotorfit.base.significance import SIGNIFICANT_ERRORS
from rotorfit.estimators.blocks.observations import Responses
from rotorfit.estimators.misfit.problem import Problem
from rotorfit.estimators.noise.residuals import Memory, Shape
from rotorfit.estimators.noise.run_effects import MixedModel, odd_run, select_effects, shared_variances
from rotorfit.identify.fitting.causes.solution import JointSearch
from rotorfit.identify.fitting.noise.noise_fit import (
    RESPONSE,
    SPEED,
    LinearisedFit,
    NoiseFit,
    explains,
    linearise,
    reweighted,
    sigma_of_residuals,
    weighing_sigma,
)
from rotorfit.identify.fitting.noise.record import FoundNoise, Miss, NoiseVerdict, ResponseNoise, RunEffect
from rotorfit.identify.fitting.noise.residual_study import MODEL_LIMITED_REDCHI, ResidualStudy

NOISE_LIKE_REDCHI = 1.5
"""redchi up to which residuals have the size of the noise: the 95 % point of a variance estimated from ten lines."""


def study_residuals(problem: Problem, x: Float, beside: JointSearch | None = None) -> ResidualStudy | None:
    """Tell noise, differences of runs and misfit apart at the optimum of a linear loss, ``beside`` causes that were
    solved with it; nothing for other data."""
    data = linearise(problem, x if beside is None else beside.x, beside)
    if data is None:
        return None
    variance, possible = random_effects(data)
    fit = reweighted(data, variance)
    shapes, sigma = ([], data.sigma) if data.sigma_given else sigma_of_residuals(fit, (RESPONSE, SPEED))
    remembered = fit.memory(fit.sigma)
    verdict = _verdict(fit, remembered, as_found=data.sigma_given or explains(fit, shapes))
    # A misfit may be noise of overlapping filters if its memory fades: that of smooth misfits does not.
    filtered = verdict is NoiseVerdict.MISFIT and remembered.fades
    limited = float(np.mean(np.abs(data.solved) ** 2)) / 2 > MODEL_LIMITED_REDCHI  # else none is spoken of
    odd = odd_run(data.solved, data.J, data.prior, data.rows, data.sweeps) if limited else None
    own_shape = np.full(sigma.size, np.sqrt(max(1.0, fit.redchi))) if data.sigma_given else sigma / data.sigma
    if verdict is not NoiseVerdict.SHAPED:
        # Readings that effects of runs share are weighed by redchi, which no longer widens the covariance.
        sigma = data.sigma * (np.sqrt(max(1.0, fit.redchi)) if variance.any() else 1.0)
    if verdict is NoiseVerdict.MISFIT:  # runs may seem to differ by what the model misses
        variance, possible = np.zeros((2, len(data.kinds)))
    # Degrees of freedom of the noise within runs, infinite where it was given.
    freedom = 2 * float(fit.weight.sum())
    if verdict is NoiseVerdict.SHAPED:
        freedom = min(2 * float(fit.weight[shape.rows].sum()) for shape in shapes)
    elif verdict is NoiseVerdict.CORRELATED or filtered:
        freedom /= 1 + 2 * sum(lag**2 for lag in remembered.lags)
    elif data.sigma_given or verdict is NoiseVerdict.MISFIT:
        freedom = float("inf")
    effects = _run_effects(problem, fit, sigma, variance, possible)
    found = None
    if variance.any() or verdict is NoiseVerdict.SHAPED:
        factors = tuple(problem.by_block(sigma / data.sigma))
        found = FoundNoise(factors=factors, effects=tuple(e for e in effects if e.values), before=x)
    return ResidualStudy(
        verdict=verdict,
        correlation=remembered.first,
        lags=remembered.lags,
        response_noise=_response_noise(problem, shapes) if verdict is NoiseVerdict.SHAPED else (),
        found=found,
        noise_ratio=tuple(problem.by_block(own_shape)) if filtered else (),
        possible_effects=tuple(e for e in effects if not e.values),
        run_count=len(data.runs),
        misses=_misses(problem, data) if verdict is NoiseVerdict.MISFIT else (),
        run_left_out=None if odd is None else (data.runs[odd[0]], odd[1]),
        scatter_freedom=max(freedom, 1.0),
    )


def _verdict(fit: NoiseFit, remembered: Memory, *, as_found: bool) -> NoiseVerdict:
    """Verdict on the residuals; ``as_found``: their size is no reason to replace the noise of the data."""
    if _follows(remembered):
        return NoiseVerdict.CORRELATED if fit.redchi < NOISE_LIKE_REDCHI else NoiseVerdict.MISFIT
    if not as_found:
        return NoiseVerdict.SHAPED
    larger = fit.data.sigma_given and fit.redchi > NOISE_LIKE_REDCHI
    return NoiseVerdict.LARGER if larger else NoiseVerdict.AS_FOUND


def _follows(remembered: Memory) -> bool:
    """True if residuals follow one another along the sweeps: where the correlation of neighbours is significant, and
    widens standard errors by a fifth at least."""
    memory_correlation = 0.25
    return remembered.first > memory_correlation and remembered.z > SIGNIFICANT_ERRORS


# ---- differences from run to run ---------------------------------------------------------------------------------


def random_effects(data: LinearisedFit) -> tuple[Float, Float]:
    """Variances of the effects of runs by kind, zero where runs agree: of those found, and of those possible."""
    found, possible = np.zeros((2, len(data.kinds)))
    if not data.kinds:
        return found, possible
    separate = np.array([kind != "run_fluid" for kind in data.kinds])
    within = NoiseFit.of(data, data.sigma, np.where(separate, np.inf, 0.0))  # each run with effects of its own
    sigma = weighing_sigma(within)
    remembered = within.memory(sigma)
    if _follows(remembered):
        if within.redchi >= NOISE_LIKE_REDCHI:
            return found, possible  # the model misses within every run
        # Noise with memory weighs more on what changes slowly along a sweep.
        sigma = sigma * np.sqrt(1 + 2 * sum(remembered.lags))
    model = MixedModel.of(*data.weighed(sigma), data.rows, data.prior)
    # The same of letting the errors allow for one, without a warning; with two runs. Runs that differ agree by chance
    # in some tests, and then nothing widens: the laxer this level, the fewer. Both tests of an effect err to the safe
    # side: at 0.1 runs that agree are given one in 2 to 3 fits of 100, and at 0.2 in 5; each is several to forty times
    # as wide, so that the mean width grows by 1 to 30 %. Two runs need 0.2 to hold D in 85 % where forces differ by 1
    # %: two that agree are then 1.4 to 2.1 times as wide on average. The median stays. ``benchmarks/honest_errors.py``
    # counts all of it.
    p_possible, p_possible_of_two = 0.1, 0.2
    level = p_possible_of_two if len(data.runs) == 2 else p_possible
    p_effect = 0.005  # probability of a warning of an effect of runs that do not differ
    found = select_effects(model, level=p_effect, forced=data.forced)
    # Noise of another size than that of the data has a shape that is guessed, which a lax test would take for runs.
    if np.count_nonzero(found) == len(data.forced) and within.redchi < NOISE_LIKE_REDCHI:
        possible = np.where(found > 0, 0.0, select_effects(model, level=level, forced=data.forced))
    if len(data.runs) == 2 and not data.forced and np.count_nonzero(found + possible) == 1:
        shared = shared_variances(model)  # two runs hardly say which kind it is
        found, possible = (shared, possible) if found.any() else (found, shared)
    return found, possible


def _run_effects(
    problem: Problem, fit: NoiseFit, sigma: Float, variance: Float, possible: Float
) -> tuple[RunEffect, ...]:
    """Effects of runs with their degrees of freedom, those found with their values; the forced one first."""
    data, both = fit.data, variance + possible
    kinds, chosen = np.flatnonzero(both), np.flatnonzero(variance).tolist()
    if not kinds.size:
        return ()
    r, J, Z = data.weighed(sigma)
    freedom = MixedModel.of(r, J, Z[:, kinds], data.rows, data.prior).freedom(both[kinds])
    effects = [
        RunEffect(
            kind="phase" if kind in data.forced else data.kinds[kind],
            sd=float(np.sqrt(both[kind])),
            freedom=float(own),
            runs=data.runs,
            values=tuple(fit.solution.own[:, chosen.index(kind)].tolist()) if kind in chosen else (),
            sensitivities=tuple(problem.by_block(data.Z[:, kind] * data.sigma / data.predicted)),
        )
        for kind, own in zip(kinds.tolist(), freedom, strict=True)
    ]
    return tuple(sorted(effects, key=lambda effect: effect.kind != "phase"))


# ---- responses and places ----------------------------------------------------------------------------------------


def _response_noise(problem: Problem, shapes: Sequence[Shape]) -> tuple[ResponseNoise, ...]:
    labels = np.array(problem.channel_names)[problem.channel]
    units = np.concatenate([_units(block) for block in problem.responses])
    return tuple(
        ResponseNoise(
            responses=tuple(dict.fromkeys(labels[shape.rows].tolist())),
            constant=shape.a,
            share=shape.b,
            along=shape.along,
            unit=str(units[shape.rows[0]]) if np.unique(units[shape.rows]).size == 1 else "",
        )
        for shape in shapes
    )


def _units(block: Responses) -> NDArray[np.str_]:
    """Unit of each reading of a block."""
    along, tilt = ("N", "N m") if block.imposed else ("m", "rad")
    units = np.array([tilt if c.axis == "r" else along for c in block.model.coordinates])[block.coordinate]
    rates = np.array(["", "/s", "/s^2"])
    return units if block.derivative is None else np.char.add(units, rates[block.derivative])


def _misses(problem: Problem, data: LinearisedFit) -> tuple[Miss, ...]:
    """Where residuals, averaged over neighbouring lines, are largest."""
    labels = np.array(problem.channel_names)[problem.channel]
    w = np.concatenate([block.frequency[block.line] for block in problem.responses])
    found = []
    miss_lines = 5  # lines over which residuals are averaged to see where the model misses, and places that are named
    for sweep in data.sweeps:
        width = min(miss_lines, sweep.size)
        mean = np.abs(np.convolve(data.solved[sweep], np.full(width, 1 / width), mode="valid"))
        at = int(np.argmax(mean))
        low, high = sorted(np.abs(w[sweep[[at, at + width - 1]]]).tolist())
        found.append((float(mean[at]), Miss(response=str(labels[sweep[0]]), low=low, high=high)))
    return tuple(miss for _, miss in sorted(found, key=lambda entry: -entry[0])[:3])
