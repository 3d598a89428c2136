"""Where residuals that are no noise of the readings come from: single lines, hit by unbalance at 1x, by hum, or by a
slip of the hand; one component of all readings, as where noise was simulated."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rotorfit.base.array_types import Float, Index
from rotorfit.base.digits import significant
from rotorfit.base.faults import of_program
from rotorfit.base.units import RPM_PER_RAD_S
from rotorfit.estimators.misfit.problem import Problem
from rotorfit.estimators.starting.start_points import short_fits
from rotorfit.estimators.starting.starts import find_start
from rotorfit.identify.fitting.noise.noise_fit import lines_in

_FAR = 25.0  # times a line's redchi must exceed that of the others, five standard deviations of their noise
_MOST_SHARE = 0.02  # share of the lines that are single ones; more are a misfit
_FEWEST = 20  # lines from which on the others say what the noise is


@dataclass(frozen=True, kw_only=True)
class BadLines:
    """Lines that miss by far more than all others."""

    places: tuple[str, ...]  # run and frequency of each in words, the worst first
    redchi: float  # of the others

    def sentence(self, redchi: float) -> str:
        """What is wrong, and what to do."""
        several = len(self.places) > 1
        return (
            f"redchi is {significant(redchi, 3)} by {len(self.places)} line{'s' * several} alone "
            f"({', '.join(self.places[:3])}): without {'them' if several else 'it'} it would be "
            f"{significant(self.redchi, 2)}, as where 1x or hum moves a line. Standard errors are widened for "
            f'{"them" if several else "it"}: leave {"them" if several else "it"} out, or fit with loss="soft_l1" '
            "(--loss soft_l1)"
        )


def bad_lines(problem: Problem, x: Float, enough: float) -> BadLines | None:
    """The few lines without which a fit's redchi would be no more than ``enough``; None where others miss too.

    They may have drawn the fit to them, so that others seem to miss as well: the worst are hidden, the rest is fitted
    again, and again without those that are the worst then (least trimmed squares). Where that leads nowhere, it begins
    anew from the data without the largest readings, as a weight at 1x makes them.

    Args:
        problem: with the readings as they are.
        x: the values that were found, shape ``(p,)``.
        enough: redchi.
    """
    if problem.loss != "linear" or len(problem.responses) < len(problem.blocks):
        return None
    line = np.unique(lines_in(problem), return_inverse=True)[1].reshape(-1)
    count = 2 * np.bincount(line)
    if count.size < _FEWEST:
        return None
    most = max(1, int(_MOST_SHARE * count.size))

    def without(worst: Index) -> Problem:
        """The problem in which some lines have no weight."""
        hidden = 1e4  # factor on the noise of their readings
        return problem.with_noise(np.where(np.isin(line, worst), hidden, 1.0))

    def trimmed(x: Float) -> BadLines | None:
        """The worst lines by turns with a fit of the others."""
        for _ in range(4):
            own = _squares(problem, x, line) / count
            worst = np.argsort(own)[::-1][:most]
            far = worst[own[worst] > _FAR * max(1.0, float(np.median(own)) / np.log(2))]
            rest = _of_others(problem, x, line, far)
            if far.size and rest <= enough:
                words = tuple(_place(problem, int(np.flatnonzero(line == one)[0])) for one in far)
                return BadLines(places=words, redchi=rest)
            x = short_fits(without(worst), x[None]).best
        return None

    found, far_off = trimmed(x), 10.0  # times ``enough`` from which a fit may have been drawn anywhere
    if found is None and _of_others(problem, x, line, np.zeros(0, dtype=np.intp)) > far_off * enough:
        size = np.bincount(line, weights=np.abs(np.concatenate([b.measured / b.sigma for b in problem.blocks])) ** 2)
        try:
            found = trimmed(find_start(without(np.argsort(size)[::-1][:most]), {}).x)
        except ValueError as reason:  # the others give no start
            if of_program(reason):
                raise
    return found


def _squares(problem: Problem, x: Float, line: Index) -> Float:
    """Sum of squared residuals of each line."""
    return np.asarray(np.bincount(line, weights=np.abs(problem.residuals(x)) ** 2), dtype=float)


def _of_others(problem: Problem, x: Float, line: Index, worst: Index) -> float:
    """redchi without some lines."""
    left = np.delete(_squares(problem, x, line), worst).sum()
    return float(left / max(2 * np.sum(~np.isin(line, worst)) - problem.space.size, 1))


def _place(problem: Problem, reading: int) -> str:
    """Run and frequency of a reading in words."""
    frequency = np.concatenate([np.abs(block.frequency[block.line]) for block in problem.responses])
    speed = np.concatenate([np.abs(block.speed[block.line]) for block in problem.responses])
    w, run = float(frequency[reading]), str(problem.run[reading])
    near_1x = 0.02  # relative distance from the turning speed within which a line is said to be at it
    at_1x = ", the turning speed" if abs(w - float(speed[reading])) < near_1x * w else ""
    return f"{run} at {significant(w * RPM_PER_RAD_S, 4)} rpm{at_1x}"


def one_component(problem: Problem, x: Float) -> str:
    """The only component of the readings that scatters, in words; empty where both do."""
    if len(problem.responses) < len(problem.blocks):
        return ""
    r, predicted = problem.residuals(x), np.concatenate(problem.predict(x))
    along = r * np.where(predicted == 0, 1.0, predicted.conj() / np.where(predicted == 0, 1.0, np.abs(predicted)))
    # Of the squares, up to which a component does not scatter: what the values that are fitted may carry over to it
    none_share = 0.01 + problem.space.size / problem.n_data
    for parts, first, second in ((along, "amplitudes", "phases"), (r, "real parts", "imaginary parts")):
        squares = float(np.sum(parts.real**2)), float(np.sum(parts.imag**2))
        if min(squares) < none_share * sum(squares):
            return first if squares[0] > squares[1] else second
    return ""
