"""Starts of fits to operating spectra: rotors that have the poles which these show."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from rotorfit.base.array_types import ComplexArray, Float, Index
from rotorfit.estimators.blocks.observations import Block
from rotorfit.estimators.blocks.operating import ModesSeen, OperatingSpectra
from rotorfit.estimators.minimisation.least_squares import Options, minimise
from rotorfit.estimators.misfit.problem import Problem
from rotorfit.estimators.signals.subspace import LEAST_SHARE, Poles, spectral_poles
from rotorfit.estimators.starting.start_points import (
    POLES,
    Start,
    full_vector,
    random_starts,
    search_scale,
    short_fits,
)

_STARTS, _FOLLOWED = 24, 3
"""Rotors from all over their range, and those of them that are followed in the spectra. Chosen."""
_SHORT = Options(max_iterations=40, tolerance=1e-3, acceptable=1e-3, method="gauss-newton", hessian="gauss-newton")


def start_by_poles(problem: Problem, others: Sequence[Float]) -> Start:
    """The best end of short fits, and the other ends, from rotors that have the poles of the spectra and suit the other
    readings."""
    space = problem.space
    size = len(space.names)
    with_poles = replace(problem, blocks=tuple(map(_with_poles, problem.blocks)))
    told = list(_of_modes(problem))
    begin = np.array(told or [*(full_vector(problem, x) for x in others), *random_starts(problem, _STARTS)])
    x = begin.copy() if told else short_fits(with_poles, begin).x
    problem = replace(problem, blocks=tuple(block.rougher for block in problem.blocks))
    cost = np.array([problem.cost(end) for end in x])
    for _ in range(4):  # rotors that a mode which was not seen makes unstable: nearer to where they came from
        lost = ~np.isfinite(cost)
        x[lost] = (x[lost] + begin[lost]) / 2
        cost[lost] = [problem.cost(end) for end in x[lost]]
    followed = [x[k] for k in np.argsort(cost, kind="stable")[:_FOLLOWED].tolist() if np.isfinite(cost[k])]
    if not told:  # a force that is not white may show poles that are none
        raw = np.array([problem.cost(end) for end in begin])
        followed += [begin[k] for k in np.argsort(raw, kind="stable")[:_FOLLOWED].tolist() if np.isfinite(raw[k])]
    if not followed:
        raise ValueError(
            f"no start was found at which {space.model.name} is stable and has the poles of the spectra: give start "
            "values (start=, --start)"
        )
    low, high = space.lower, space.upper
    ends = (
        minimise(problem, point, lower=low, upper=high, scale=search_scale(space, point), options=_SHORT)
        for point in followed
    )
    same = 1 + 1e-3  # ratio of the costs of ends in one minimum
    first, *rest = sorted(ends, key=lambda fit: np.nan_to_num(fit.cost, nan=np.inf))
    others = [end.x[:size] for before, end in pairwise([first, *rest]) if end.cost > same * before.cost]
    return Start(x=first.x[:size], kind=POLES, others=tuple(others))


def _of_modes(problem: Problem) -> Iterator[Float]:
    """Rotors that have the modes of the spectra, of models that modes tell, and guesses of those not seen."""
    space = problem.space
    for damping in (0.2, 0.5, 1.0, 2.0):  # of modes not seen over their frequency
        x = np.array(space.typical)
        for block, cells, poles in (seen for one in problem.blocks for seen in _seen(one)):
            n, size = len(block.model.coordinates), float(np.abs(poles.s).mean())
            missing = np.arange(block.model.order * n - poles.s.size)
            more = size * (1 + missing / 10) * (-damping + 1j * (-1.0) ** (missing + (poles.s[0].imag > 0)))
            shapes = np.concatenate([poles.shapes, np.eye(n)[:, missing % n]], axis=1)
            values = block.model.with_modes(np.concatenate([poles.s, more]), shapes)
            if values is None:
                return
            entries = space.index[block.group[cells[0]]]
            x[entries[entries >= 0]] = values[entries >= 0]
        yield full_vector(problem, x)


def _seen(block: Block) -> Iterator[tuple[OperatingSpectra, Index, Poles]]:
    """Spectra, the cells of each setting, and the poles that they show; nothing of other readings."""
    if not isinstance(block, OperatingSpectra):
        return
    order, spare = block.model.order * len(block.model.planes), 2
    for cells, frequency, matrix in block.cells:
        found = spectral_poles(frequency, matrix, float(np.median(np.diff(frequency))), order + spare)
        kept = np.array(_apart(found.s, found.share)[:order], dtype=np.intp)
        yield block, cells, Poles(found.s[kept], found.shapes[:, kept], found.share[kept])


def _with_poles(block: Block) -> Block:
    """Poles in place of spectra; other readings where eccentricities were measured."""
    seen = list(_seen(block))
    if not seen:
        return block.frozen
    spectra = seen[0][0]
    s = np.concatenate([poles.s for _, _, poles in seen])
    first = np.concatenate([np.full(poles.s.size, cells[0]) for _, cells, poles in seen])
    return ModesSeen(
        model=spectra.model,
        measured=s,
        sigma=0.2 * np.abs(s.real) + 0.01 * np.abs(s),  # about what few minutes and a wrong number of states leave
        label=np.zeros(s.size, dtype=np.intp),
        labels=("poles",),
        run=spectra.run[first * (spectra.m**2 // 2)],
        speed=spectra.speed[first],
        reading_group=spectra.group[first],
    )


def _apart(s: ComplexArray, share: Float) -> list[int]:
    """Poles of some share, without those beside one that stands before them, nearer than half its width."""
    kept: list[int] = []
    for k in np.flatnonzero(share > LEAST_SHARE).tolist():
        if all(abs(s[k].imag - s[other].imag) > abs(s[other].real) for other in kept):
            kept.append(k)
    return kept
