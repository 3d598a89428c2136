"""Starts where there is no closed form: many, with short fits, until one is deep enough and found twice.

The first of them are for tests that do not read every coordinate of the rotor. Where force and probe are at the
journal, zeros of its response are the frequencies at which the rest of the rotor would vibrate with the journal held. A
rotor whose rest has these frequencies gives the motion that was not read, and with both the closed form gives all else.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain, islice

import numpy as np
from numpy.typing import NDArray

from rotorfit.estimators.blocks.observations import Responses
from rotorfit.estimators.blocks.response import dynamic_stiffness
from rotorfit.estimators.misfit.problem import Problem
from rotorfit.estimators.significance import OPEN_ERRORS, SIGNIFICANT_ERRORS
from rotorfit.estimators.starting.closed_form import ClosedFormError, closed_form
from rotorfit.estimators.starting.rational_fit import RationalFit, rational_fit
from rotorfit.estimators.starting.start_points import (
    RANDOM,
    ShortFits,
    Start,
    full_vector,
    inside_bounds,
    noise_limit,
    random_starts,
    short_fits,
)
from rotorfit.models.array_types import RANK_TOLERANCE, ComplexArray, Float, Index
from rotorfit.models.digits import significant
from rotorfit.models.motion.stability import companion

_LOCAL_MINIMUM = "perhaps a local minimum"
"""How a note begins that says so."""

FEW_STARTS, _MOST_STARTS = 24, 72
"""Starts tried where the minimum found is deep, but perhaps not the deepest; and where it is not. Chosen."""
_BESIDE = np.repeat([0.05, 0.2], 8)  # spread of the logarithm of starts beside an end
_SAME_COST = 0.5  # cost to which short fits that end in one minimum agree
_DEVIATIONS_OF_TWO, _DEVIATIONS_OF_ONE = 1.0, 2.5
"""Standard deviations by which the misfit may exceed that of ratios of polynomials: where two of few starts lead to the
minimum, and where no second one does but none deeper lies beside. Chosen; where many were tried it is a quantile."""

_RIVAL_COST = OPEN_ERRORS**2 / 2  # cost above the least up to which another minimum is not to be ruled out


@dataclass(frozen=True, eq=False, kw_only=True)
class _Ends:
    """Where short fits ended, the best first."""

    x: Float  # shape ``(W, p)``
    cost: Float  # shape ``(W,)``
    far: NDArray[np.bool_]  # whether they began at starts of their own, not beside another's end, shape ``(W,)``

    @property
    def together(self) -> int:
        """How many starts of their own ended in the best minimum."""
        return int(np.sum(self.far & (self.cost < self.cost[0] + _SAME_COST)))

    def joined(self, found: ShortFits, *, far: bool) -> _Ends:
        """With more ends."""
        cost = np.concatenate([self.cost, found.cost])
        order = np.argsort(cost, kind="stable")
        fars = np.concatenate([self.far, np.full(found.cost.size, far)])
        return _Ends(x=np.concatenate([self.x, found.x])[order], cost=cost[order], far=fars[order])


def best_of_many(problem: Problem, reason: str) -> Start:
    """The deepest end of short fits, and notes on how it was found and what may be deeper."""
    blocks = [block for block in problem.blocks if isinstance(block, Responses)]
    _refuse_undetermined(problem, blocks)
    ratios = rational_fit(blocks) if problem.loss == "linear" else None
    limits = _limits(problem, ratios)
    ends = _search(problem, _candidates(problem, blocks, ratios), limits)
    ends = _beside(problem, ends, limits[0])
    note = f"no closed form ({reason}); the best of {ends.far.sum()} starts was taken"
    doubt = _doubt(problem, ends, limits, ratios)
    x = ends.x[0, : len(problem.space.names)]
    return Start(x=x, kind=RANDOM, notes=(note, *doubt), perhaps_local=bool(doubt))


def _refuse_undetermined(problem: Problem, blocks: Sequence[Responses]) -> None:
    """Refuse readings that determine no value, by the rank of derivatives at a random vector: a search would wander."""
    x = next(random_starts(problem, 1))
    _, complex_columns = problem.jacobian(x)
    columns = np.concatenate([complex_columns.real, complex_columns.imag])
    length = np.linalg.norm(columns, axis=0)
    _, power, rows = np.linalg.svd(columns / np.where(length > 0, length, 1.0))
    unseen = rows[np.pad(power, (0, len(rows) - power.size)) <= RANK_TOLERANCE * power[0]]
    if problem.priors or not (np.abs(unseen).max(axis=0, initial=0.0) > np.sqrt(RANK_TOLERANCE)).all():
        return
    names = np.array([str(coordinate) for coordinate in problem.space.model.coordinates])
    read = names[np.unique(np.concatenate([block.coordinate for block in blocks]))]
    driven = names[np.unique(np.concatenate([np.nonzero(block.force)[1] for block in blocks]))]
    missing = ", ".join(name for name in names.tolist() if name not in read or name not in driven)
    raise ValueError(
        f"none of the {len(problem.space.names)} values of {problem.space.model.name} can be determined from these "
        f"data: readings are of {', '.join(read)} under forces on {', '.join(driven)}, and other values can make up "
        f"for each. {f'Read and force {missing} too, give' if missing else 'Give'} values that are known, or fit a "
        "model with fewer"
    )


def best_beside(problem: Problem, starts: Float) -> Float:
    """The deepest end of short fits from starts, shape ``(W, p)``, and from beside it, shape ``(p,)``."""
    ends = _none(problem).joined(short_fits(problem, starts), far=True)
    return np.asarray(_beside(problem, ends, -np.inf).x[0])


def _none(problem: Problem) -> _Ends:
    return _Ends(x=np.empty((0, problem.space.size)), cost=np.empty(0), far=np.empty(0, dtype=bool))


def _limits(problem: Problem, ratios: RationalFit | None) -> tuple[float, float]:
    """Costs below which a minimum is taken for the deepest, and below which it may be."""
    if ratios is None:
        # What stands round a known shaft is little: a minimum that leaves the noise alone is taken as of a closed form.
        explained = problem.space.model.shaft is not None and problem.loss == "linear"
        return noise_limit(problem) if explained else -np.inf, noise_limit(problem)
    sure, likely = (
        ratios.limit(len(problem.space.names), deviations) for deviations in (_DEVIATIONS_OF_TWO, SIGNIFICANT_ERRORS)
    )
    return sure, likely


def _candidates(problem: Problem, blocks: list[Responses], ratios: RationalFit | None) -> Iterator[Float]:
    every = random_starts(problem, _MOST_STARTS)
    return every if ratios is None else islice(chain(unread_starts(problem, blocks, ratios), every), _MOST_STARTS)


def _search(problem: Problem, candidates: Iterator[Float], limits: tuple[float, float]) -> _Ends:
    """Short fits until two of few end in a minimum as deep as the first limit, or two of many as the second."""
    ends = _none(problem)
    at_once = 4  # starts fitted before the ends are looked at
    while starts := list(islice(candidates, at_once)):
        ends = ends.joined(short_fits(problem, np.array(starts)), far=True)
        if ends.together > 1 and ends.cost[0] <= limits[int(ends.cost.size >= FEW_STARTS)]:
            break
    return ends


def _beside(problem: Problem, ends: _Ends, sure: float) -> _Ends:
    """With ends of short fits from beside the best one, round after round, until several lead no deeper. A sharp
    resonance between coarse lines has a minimum in every gap: the deepest is a small change of the parameters away,
    which few of many starts all over their range hit. Skipped where the best is taken for the deepest."""
    rng = np.random.default_rng(0)
    count, fruitless = len(problem.space.names), 0
    most_fruitless = 4  # rounds of such starts in a row that lead no deeper
    for _ in range(20):
        least = ends.cost[0]
        if fruitless == most_fruitless or (ends.together > 1 and least <= sure):
            break
        starts = np.tile(ends.x[0], (_BESIDE.size, 1))
        changes = np.exp(_BESIDE[:, None] * rng.normal(size=(_BESIDE.size, count)))
        starts[:, :count] = inside_bounds(starts[:, :count] * changes, problem.space)
        ends = ends.joined(short_fits(problem, starts), far=False)
        fruitless = 0 if ends.cost[0] < least - _SAME_COST else fruitless + 1
    return ends


def _doubt(problem: Problem, ends: _Ends, limits: tuple[float, float], ratios: RationalFit | None) -> tuple[str, ...]:
    """A sentence where the minimum may not be the deepest, or not the only one so deep."""
    tried, least = int(ends.far.sum()), float(ends.cost[0])
    led = f"{ends.together} of {tried} starts lead here"
    if least > limits[1] and ratios is not None:
        return (
            f"{_LOCAL_MINIMUM}, or not this rotor: chi-squared is {significant(2 * least, 4)}, where ratios of "
            "polynomials "
            f"with as many poles leave {significant(2 * ratios.cost, 4)}; {led}. Give start values for what is known",
        )
    alone = limits[0] if ratios is None else ratios.limit(len(problem.space.names), _DEVIATIONS_OF_ONE)
    if ends.together < 2 and least > alone:
        return (
            f"{_LOCAL_MINIMUM}: {led}, and chi-squared is {significant(2 * least, 4)} for {problem.n_data} "
            "data. Give start "
            "values for what is known",
        )
    other = _another(problem, ends)
    if other is None:
        return ()
    return (
        f"{_LOCAL_MINIMUM}: another one has chi-squared {significant(2 * other, 4)} where this one has "
        f"{significant(2 * least, 4)}. "
        "More readings separate them, or values known beforehand",
    )


def _another(problem: Problem, ends: _Ends) -> float | None:
    """Cost of another minimum nearly as deep as the best: predictions differ by more than the costs tell."""
    best = problem.residuals(ends.x[0])
    for x in ends.x[1:][ends.cost[1:] < ends.cost[0] + 2 * _RIVAL_COST]:
        if _apart(problem, best, x, ends.cost[0]):
            end = short_fits(problem, x[None])
            if end.cost[0] < ends.cost[0] + _RIVAL_COST and _apart(problem, best, end.x[0], ends.cost[0]):
                return float(end.cost[0])
    return None


def _apart(problem: Problem, best: ComplexArray, x: Float, least: float) -> bool:
    """True if a vector is in another valley: within one, half the squared distance is what the cost grows by."""
    other = problem.residuals(x)
    distance = 0.5 * float(np.sum(np.abs(other - best) ** 2))
    return distance > _RIVAL_COST + 4 * (0.5 * float(np.sum(np.abs(other) ** 2)) - least)


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
        derivative=None,
    )
