"""Fits with an error of the data undone: what was read as ``factor`` times the truth, or rows left out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from rotorfit.estimators.blocks.observations import Responses
from rotorfit.estimators.blocks.row_keys import numbers, rows_by
from rotorfit.estimators.misfit.problem import Problem
from rotorfit.estimators.starting.closed_form import closed_form
from rotorfit.estimators.starting.start_points import short_fits
from rotorfit.models.array_types import Bool, ComplexArray, Float, Text

Hint = Callable[[ComplexArray], bool]
"""Answers True if small errors whose logarithm changes readings so, shape ``(R, k)``, may explain the misfit."""

EXPLAINED_MISFIT_SHARE = 0.01
"""Share of the misfit left from which nothing else has to be tried."""
EXPLAINING_MISFIT_SHARE = 0.1
"""Misfit that is left, of that of the data as given, if an error is the explanation, and share of the power of readings
left by a factor of theirs: missing structure alone does not vanish by what has nothing to do with it. Chosen."""
PROMISING_MISFIT_SHARE = 0.5
"""Share of the misfit that the right value leaves at most in a closed form, or without the wrong readings. Chosen."""
MOST_PLANES = 4
"""Planes that are looked at one by one. Chosen: an experiment with an error has few."""


@dataclass(frozen=True, kw_only=True)
class Explanation:
    """An error of the data that was undone in a trial fit."""

    left: float  # share of the misfit that the fit leaves without it
    code: str
    message: str
    undo: str
    correction: str | None = None  # name of the error in the table of those that can be undone
    free: int = 0  # values that were searched for; of errors that explain the data alike, those with the fewest count


def trial(problem: Problem, *, search: bool = True) -> tuple[float, Float]:
    """Sum of squares that a short search from the closed form leaves, or the closed form alone in a tenth of the time,
    and its end; infinite where the data allow none. What is right needs no better start, and to look for one takes
    longer than all the rest."""
    space = problem.space
    end = np.zeros(space.size)
    try:
        end[: len(space.names)] = closed_form(space, problem.blocks).x
        end = np.clip(end, space.lower, space.upper)
        if search:
            (end,) = short_fits(problem, end[None]).x
    except (ValueError, np.linalg.LinAlgError):  # what cannot be fitted explains nothing
        return float("inf"), end
    return 2 * problem.cost(end), end


@dataclass(frozen=True, eq=False, kw_only=True)
class Readings:
    """Readings of all blocks one after the other, shape ``(R,)`` each."""

    problem: Problem  # as the data were given
    run: Text  # run of each reading
    plane: Text  # plane of its probe
    force_plane: Text  # plane of its force
    speed: Float  # rad/s
    frequency: Float  # signed, rad/s
    conjugated: Bool  # where a reading is the conjugate of what probes gave

    @property
    def s(self) -> ComplexArray:
        """The variable j w of what probes gave, w > 0."""
        return 1j * np.abs(self.frequency)

    @property
    def middle(self) -> float:
        """A frequency in the midst of the readings: a power of what is relative to it leaves their sizes much alike."""
        return float(np.exp(np.mean(np.log(np.abs(self.frequency)))))

    def seen(self, factor: ComplexArray) -> ComplexArray:
        """Factors on phasors as factors on the readings as they stand."""
        conjugated = self.conjugated if factor.ndim == 1 else self.conjugated[:, None]
        return np.where(conjugated, factor.conj(), factor)

    def corrected(self, factor: ComplexArray) -> Problem:
        """The problem with readings that were given as so many times the truth."""
        whole = self.seen(factor)
        return self._with(self.problem.measured / whole, self.problem.sigma / np.abs(whole))

    def without(self, rows: Bool) -> Problem:
        """The problem in which some readings have no weight."""
        hidden = 1e4  # factor on the noise of readings that are left out, which then have no weight
        return self._with(self.problem.measured, np.where(rows, hidden, 1.0) * self.problem.sigma)

    def _with(self, measured: ComplexArray, sigma: Float) -> Problem:
        by_block = self.problem.by_block
        parts = zip(self.problem.blocks, by_block(measured), by_block(sigma), strict=True)
        blocks = tuple(
            replace(block, measured=m, sigma=e) if isinstance(block, Responses) else block for block, m, e in parts
        )
        return replace(self.problem, blocks=blocks)


def readings_of(problem: Problem) -> Readings | None:
    """Readings of a problem, thinned where many; None with others than a linear rotor's to turning forces."""
    blocks = [block for block in problem.blocks if isinstance(block, Responses)]
    if len(blocks) < len(problem.blocks) or any(block.imposed or not block.frequency.all() for block in blocks):
        return None
    most_readings = 1500  # readings that show an error
    every = -(-sum(block.measured.size for block in blocks) // most_readings)
    if every > 1:
        problem = _some_lines(problem, blocks, every)
        blocks = problem.responses
    names = np.array([c.plane for c in problem.space.model.coordinates])
    forced = [names[np.abs(block.force).argmax(axis=1)][block.line] for block in blocks]
    return Readings(
        problem=problem,
        run=np.concatenate([block.run for block in blocks]),
        plane=np.concatenate([names[block.coordinate] for block in blocks]),
        force_plane=np.concatenate(forced),
        speed=np.concatenate([block.set_speed[block.line] for block in blocks]),
        frequency=np.concatenate([block.frequency[block.line] for block in blocks]),
        conjugated=np.concatenate([block.conjugated for block in blocks]),
    )


def _some_lines(problem: Problem, blocks: list[Responses], every: int) -> Problem:
    kept, factors = [], []
    for number, block in enumerate(blocks):
        first = np.searchsorted(block.line, np.arange(block.speed.size))
        run = numbers(block.run[first])
        keep = np.zeros(run.size, dtype=bool)
        keep[np.concatenate([rows[::every] for rows in rows_by(run, np.abs(block.frequency))])] = True
        kept.append(block.lines(keep))
        own = problem.factors[number] if problem.factors else None
        factors.append(None if own is None else own[keep[block.line]])
    return replace(problem, blocks=tuple(kept), factors=tuple(factors))
