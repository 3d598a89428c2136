"""Starts of fits to operating spectra: rotors that have the poles which these show."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from rotorfit.base.array_types import ComplexArray, Float
from rotorfit.estimators.blocks.observations import Block
from rotorfit.estimators.blocks.operating import ModesSeen, OperatingSpectra
from rotorfit.estimators.minimisation.least_squares import Options, minimise
from rotorfit.estimators.misfit.problem import Problem
from rotorfit.estimators.signals.subspace import LEAST_SHARE, spectral_poles
from rotorfit.estimators.starting.start_points import (
    POLES,
    Start,
    full_vector,
    random_starts,
    search_scale,
    short_fits,
)

_STARTS, _FOLLOWED = 24, 4
"""Rotors from all over their range, and those of them that are followed in the spectra. Chosen."""
_SHORT = Options(max_iterations=40, tolerance=1e-3, acceptable=1e-3, method="gauss-newton", hessian="gauss-newton")


def start_by_poles(problem: Problem, others: Sequence[Float]) -> Start:
    """The best end of short fits, from rotors that have the poles of the spectra and suit the other readings."""
    space = problem.space
    size = len(space.names)
    with_poles = replace(problem, blocks=tuple(map(_with_poles, problem.blocks)))
    begin = np.array([*(full_vector(problem, x) for x in others), *random_starts(problem, _STARTS)])
    x = short_fits(with_poles, begin).x
    problem = replace(problem, blocks=tuple(block.rougher for block in problem.blocks))
    cost = np.array([problem.cost(end) for end in x])
    for _ in range(4):  # rotors that a mode which was not seen makes unstable: nearer to where they came from
        lost = ~np.isfinite(cost)
        x[lost] = (x[lost] + begin[lost]) / 2
        cost[lost] = [problem.cost(end) for end in x[lost]]
    followed = [k for k in np.argsort(cost, kind="stable")[:_FOLLOWED].tolist() if np.isfinite(cost[k])]
    if not followed:
        raise ValueError(
            f"no start was found at which {space.model.name} is stable and has the poles of the spectra: give start "
            "values (start=, --start)"
        )
    low, high = space.lower, space.upper
    ends = (
        minimise(problem, x[k], lower=low, upper=high, scale=search_scale(space, x[k]), options=_SHORT)
        for k in followed
    )
    return Start(x=min(ends, key=lambda fit: np.nan_to_num(fit.cost, nan=np.inf)).x[:size], kind=POLES)


def _with_poles(block: Block) -> Block:
    """Poles in place of spectra; other readings where eccentricities were measured."""
    if not isinstance(block, OperatingSpectra):
        return block.frozen
    order, spare = block.model.order * len(block.model.planes), 2
    poles, cells = [], []
    for own, frequency, matrix in block.cells:
        width = float(np.median(np.diff(frequency)))
        found, share = spectral_poles(frequency, matrix, width, order + spare)
        poles.append(_apart(found[share > LEAST_SHARE])[:order])
        cells.append(np.full(poles[-1].size, own[0]))
    s, first = np.concatenate(poles), np.concatenate(cells)
    return ModesSeen(
        model=block.model,
        measured=s,
        sigma=0.2 * np.abs(s.real) + 0.01 * np.abs(s),  # about what few minutes and a wrong number of states leave
        label=np.zeros(s.size, dtype=np.intp),
        labels=("poles",),
        run=block.run[first * (block.m**2 // 2)],
        speed=block.speed[first],
        reading_group=block.group[first],
    )


def _apart(poles: ComplexArray) -> ComplexArray:
    """Poles without those beside one that stands before them, nearer than half its width."""
    kept: list[complex] = []
    for s in poles.tolist():
        if all(abs(s.imag - other.imag) > abs(other.real) for other in kept):
            kept.append(s)
    return np.array(kept)
