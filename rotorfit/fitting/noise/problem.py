"""A problem with the noise that a fit found in its residuals, and the same problem without."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np

from rotorfit.estimators.misfit.priors import Prior
from rotorfit.estimators.misfit.problem import Problem
from rotorfit.fitting.noise.record import RUN_KINDS, FoundNoise
from rotorfit.models.array_types import Float


def with_noise(problem: Problem, noise: FoundNoise) -> Problem:
    """The problem with noise of another size, and what differs from run to run as nuisance entries with priors."""
    blocks = tuple(block.with_noise(factor) for block, factor in zip(problem.blocks, noise.factors, strict=True))
    space, priors = problem.space, problem.priors
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
        spread = normal(effect.sd)
        priors += tuple(Prior(first + i, spread) for i in range(len(effect.runs)))
    return replace(problem, space=space, blocks=blocks, priors=priors, factors=factors)


@lru_cache(maxsize=64)
def normal(sd: float) -> Any:
    """The normal distribution about zero with a standard deviation; SciPy takes a millisecond to make one."""
    from scipy.stats import norm

    return norm(0.0, sd)


def estimate_before(noise: FoundNoise | None, x: Float, count: int) -> Float:
    """The estimate that goodness of fit refers to, shape ``(count,)``."""
    return noise.before if noise is not None and noise.before.size == count else x[:count]


def without_noise(problem: Problem, noise: FoundNoise) -> Problem:
    """The problem before :func:`with_noise`; offsets of phase_offsets stay, with their priors."""
    blocks = tuple(block.with_noise(1 / factor) for block, factor in zip(problem.blocks, noise.factors, strict=True))
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
    return replace(problem, space=space, blocks=blocks, priors=priors, factors=factors)
