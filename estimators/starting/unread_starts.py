"""Starts for tests that do not read every coordinate of the rotor: its equations are not linear in all unknowns.

Where force and probe are at the journal, zeros of its response are the frequencies at which the rest of the rotor
would vibrate with the journal held. A rotor whose rest has these frequencies tells the motion that was not read from
that which was, and with both the closed form gives all else.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from rotorfit.estimators.blocks.observations import Responses
from rotorfit.estimators.blocks.response import dynamic_stiffness
from rotorfit.estimators.misfit.problem import Problem
from rotorfit.estimators.starting.closed_form import ClosedFormError, closed_form
from rotorfit.estimators.starting.rational_fit import RationalFit
from rotorfit.estimators.starting.start_points import full_vector, random_starts
from rotorfit.models.array_types import Float, Index
from rotorfit.models.motion.stability import companion


def unread_starts(problem: Problem, blocks: Sequence[Responses], fit: RationalFit) -> Iterator[Float]:
    """Starts, shape ``(p,)`` each, the likeliest first; none where force and probe are never at one coordinate."""
    unread = _unread(blocks)
    if unread is None:
        return
    typical = full_vector(problem, problem.space.typical)
    draws = 6  # rotors drawn for each zero: mass and damping of the rest are not given
    for drawn in (typical, *random_starts(problem, draws - 1)):
        for zero in fit.zeros:
            start = _with_rest_at(problem, blocks[0], drawn, unread, zero)
            theta = problem.space.theta(start)
            try:
                found = closed_form(problem.space, tuple(_completed(block, theta, unread) for block in blocks))
            except ClosedFormError:
                continue
            yield full_vector(problem, found.x)


def _unread(blocks: Sequence[Responses]) -> Index | None:
    """Coordinates that no line reads, where all lines read the same ones."""
    read = [np.isfinite(block.amplitudes()[0]) for block in blocks]
    first = read[0][0]
    if first.all() or any((part != first).any() for part in read):
        return None
    return np.flatnonzero(~first)


def _with_rest_at(problem: Problem, block: Responses, start: Float, unread: Index, frequency: float) -> Float:
    """A rotor with all frequencies scaled so that the lowest one of its rest, what was read being held, is as given."""
    space, theta = problem.space, problem.space.theta(start)
    rest = block.model.coefficients(theta[0], float(block.speed[0]))[:, unread][:, :, unread]
    matrix, scale = companion(rest)
    slowest = np.abs(np.linalg.eigvals(matrix)).max() / scale  # one over the lowest frequency
    power = np.array([space.model.parameter(name).frequency_power for name in space.base])
    return full_vector(problem, start[: power.size] * (frequency * slowest) ** power)


def _completed(block: Responses, theta: Float, unread: Index) -> Responses:
    """A block with the motion that was not read as a rotor tells it from the motion that was."""
    amplitude, sigma = block.amplitudes()
    lines, size = amplitude.shape
    read = np.setdiff1d(np.arange(size), unread)
    kappa = dynamic_stiffness(block, theta)[:, unread]
    seen = amplitude[:, read]
    pull = block.force[:, unread] - np.einsum("lij,lj->li", kappa[:, :, read], seen)
    amplitude[:, unread] = np.linalg.solve(kappa[:, :, unread], pull[..., None])[..., 0]
    share = np.sqrt(np.mean((sigma[:, read] / np.abs(seen)) ** 2, axis=1))
    sigma[:, unread] = share[:, None] * np.abs(amplitude[:, unread])
    return replace(
        block,
        line=np.repeat(np.arange(lines), size),
        coordinate=np.tile(np.arange(size), lines),
        measured=amplitude.reshape(-1),
        sigma=sigma.reshape(-1),
        label=np.zeros(lines * size, dtype=np.intp),
        run=np.repeat(block.run[:1], lines * size),
    )
