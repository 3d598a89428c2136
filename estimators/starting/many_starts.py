"""Starts where there is no closed form: many, with short fits, until one is deep enough and found twice.

The first of them follow the poles of a rational fit: ratios of polynomials go on from j w into the half plane of
motion that grows, ``s = decay + j w``, where every resonance is as wide as one likes. A rotor is fitted there, where
minima are few, and again ever nearer to the axis (a homotopy); its poles then are those of the data.

The next are for tests that do not read every coordinate of the rotor. Where force and probe are at the journal, zeros
of its response are the frequencies at which the rest of the rotor would vibrate with the journal held. A rotor whose
rest has these frequencies gives the motion that was not read, and with both the closed form gives all else.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from itertools import chain, islice

import numpy as np
from numpy.typing import NDArray

from rotorfit.base.array_types import RANK_TOLERANCE, ComplexArray, Float, Index
from rotorfit.base.digits import significant
from rotorfit.base.significance import OPEN_ERRORS, SIGNIFICANT_ERRORS
from rotorfit.estimators.blocks.observations import Responses, linear_responses
from rotorfit.estimators.blocks.response import dynamic_stiffness
from rotorfit.estimators.blocks.set_speeds import ONLY_1X, once_per_turn
from rotorfit.estimators.misfit.problem import Problem
from rotorfit.estimators.signals.ratios import best_ratio
from rotorfit.estimators.starting.closed_form import ClosedFormError, closed_form
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
    blocks = linear_responses(problem.blocks)
    _refuse_undetermined(problem, blocks)
    ratios = rational_fit(blocks) if problem.loss == "linear" else None
    limits = _limits(problem, ratios)
    candidates = random_starts(problem, _MOST_STARTS)
    if ratios is not None:
        first = chain(starts_by_poles(problem, blocks, ratios), unread_starts(problem, blocks, ratios))
        candidates = islice(chain(first, candidates), _MOST_STARTS)
    ends = _none(problem)
    at_once = 4  # starts fitted before the ends are looked at
    while starts := list(islice(candidates, at_once)):
        ends = ends.joined(short_fits(problem, np.array(starts)), far=True)
        # Two of few starts end in a minimum as deep as the first limit, or two of many as the second.
        if ends.together > 1 and ends.cost[0] <= limits[int(ends.cost.size >= FEW_STARTS)]:
            break
    ends = _beside(problem, ends, limits[0])
    note = f"no closed form ({reason}); the best of {ends.far.sum()} starts was taken"
    doubt = _doubt(problem, ends, limits, ratios)
    x = _by_convention(problem, ends.x[0])[: len(problem.space.names)]
    return Start(x=x, kind=RANDOM, notes=(note, *doubt), perhaps_local=bool(doubt))


def _by_convention(problem: Problem, x: Float) -> Float:
    """A vector with the sign that values typically have where data leave it open, as that of a coupling whose square
    alone they hold."""
    cost, scale = problem.cost(x), problem.space.typical
    for entry in np.flatnonzero(x[: scale.size] * scale < 0).tolist():
        other = x.copy()
        other[entry] = -x[entry]
        if problem.space.lower[entry] <= other[entry] <= problem.space.upper[entry]:
            x = other if abs(problem.cost(other) - cost) < _SAME_COST else x
    return x


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
    turning = all(once_per_turn(block.frequency, block.speed).all() for block in blocks)
    raise ValueError(
        f"none of the {len(problem.space.names)} values of {problem.space.model.name} can be determined from these "
        f"data: readings are of {', '.join(read)} under forces on {', '.join(driven)}, and other values can make up "
        f"for each. {f'Read and force {missing} too, give' if missing else 'Give'} values that are known, or fit a "
        f"model with fewer{f'; {ONLY_1X}' if turning and problem.space.model.speed_dependent else ''}"
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
    size = len(problem.space.names)
    return ratios.limit(size, _DEVIATIONS_OF_TWO), ratios.limit(size, SIGNIFICANT_ERRORS)


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
    least, chi2 = float(ends.cost[0]), significant(2 * float(ends.cost[0]), 4)
    led = f"{ends.together} of {ends.far.sum()} starts lead here"
    if least > limits[1] and ratios is not None:
        return (
            f"{_LOCAL_MINIMUM}, or not this rotor: chi-squared is {chi2}, where ratios of polynomials with as many "
            f"poles leave {significant(2 * ratios.cost, 4)}; {led}. Give start values for what is known",
        )
    alone = limits[0] if ratios is None else ratios.limit(len(problem.space.names), _DEVIATIONS_OF_ONE)
    if ends.together < 2 and least > alone:
        return (
            f"{_LOCAL_MINIMUM}: {led}, and chi-squared is {chi2} for {problem.n_data} data. Give start values for "
            "what is known",
        )
    best = problem.residuals(ends.x[0])
    for x in ends.x[1:][ends.cost[1:] < least + 2 * _RIVAL_COST]:
        if _apart(problem, best, x, least):
            end = short_fits(problem, x[None])
            if end.cost[0] < least + _RIVAL_COST and _apart(problem, best, end.x[0], least):
                return (
                    f"{_LOCAL_MINIMUM}: another one has chi-squared {significant(2 * end.cost[0], 4)} where this one "
                    f"has {chi2}. More readings separate them, or values known beforehand",
                )
    return ()


def _apart(problem: Problem, best: ComplexArray, x: Float, least: float) -> bool:
    """True if a vector is in another valley, its predictions differing by more than the costs tell: within one, half
    the squared distance is what the cost grows by."""
    other = problem.residuals(x)
    distance = 0.5 * float(np.sum(np.abs(other - best) ** 2))
    return distance > _RIVAL_COST + 4 * (0.5 * float(np.sum(np.abs(other) ** 2)) - least)


def starts_by_poles(problem: Problem, blocks: Sequence[Responses], fit: RationalFit) -> Iterator[Float]:
    """Starts, shape ``(p,)`` each, the best first: of rotors whose response is that of a rational fit off the axis."""
    if len(blocks) < len(problem.blocks):
        return
    starts = np.array([full_vector(problem, problem.space.typical), *random_starts(problem, FEW_STARTS - 1)])
    best = 4  # ends that are followed to the axis
    top = max(ratio.top for ratio in fit.ratios)
    for decay in (0.3, 0.1, 0.03):  # of the highest frequency: resonances from far wider than their distances
        ends = short_fits(replace(problem, loss="soft_l1", blocks=fit.off_axis(blocks, decay * top)), starts)
        starts = ends.x[np.argsort(ends.cost, kind="stable")[: best if decay < 0.3 else 2 * best]]
    yield from starts


@dataclass(frozen=True, eq=False, kw_only=True)
class _GrowingResponses(Responses):
    """Responses to forces that grow, ``exp(decay t)``."""

    decay: float  # 1/s

    @cached_property
    def s(self) -> ComplexArray:
        """The variable decay + j w of each line."""
        return np.asarray(self.decay + 1j * self.frequency)


def unread_starts(problem: Problem, blocks: Sequence[Responses], fit: RationalFit) -> Iterator[Float]:
    """Starts, shape ``(p,)`` each, the likeliest first; none where force and probe are never at one coordinate."""
    read = np.concatenate([np.isfinite(block.amplitudes()[0]) for block in blocks])
    if read[0].all() or (read != read[0]).any():  # nothing unread, or not the same in all lines
        return
    unread = np.flatnonzero(~read[0])
    typical = full_vector(problem, problem.space.typical)
    draws = 6  # rotors drawn for each zero: mass and damping of the rest are not given
    power = np.array([problem.space.model.parameter(name).frequency_power for name in problem.space.base])
    for drawn in (typical, *random_starts(problem, draws - 1)):
        rest = blocks[0].model.coefficients(problem.space.theta(drawn)[0], float(blocks[0].speed[0]))
        matrix, scale = companion(rest[:, unread][:, :, unread])
        slowest = np.abs(np.linalg.eigvals(matrix)).max() / scale  # one over the lowest frequency of the rest
        for zero in fit.zeros:
            # All frequencies are scaled so that the lowest one of the rest, what was read being held, is the zero.
            start = full_vector(problem, drawn[: power.size] * (zero * slowest) ** power)
            theta = problem.space.theta(start)
            try:
                found = closed_form(problem.space, tuple(_completed(block, theta, unread) for block in blocks))
            except ClosedFormError:
                continue
            yield full_vector(problem, found.x)


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


@dataclass(frozen=True, eq=False, kw_only=True)
class _Ratios:
    """Ratios of polynomials with one denominator, fitted to the readings of one condition."""

    block: int  # number of the block
    readings: Index  # which of its readings, shape ``(m,)``
    frequency: Float  # of each over the largest, ``top``, shape ``(m,)``
    force: ComplexArray  # on each, shape ``(m,)``
    pair: Index  # number of the numerator of each, shape ``(m,)``
    denominator: ComplexArray  # coefficients of Chebyshev's polynomials
    numerators: ComplexArray  # those of each pair of probe and plane, shape ``(pairs, zeros + 1)``
    top: float  # largest frequency, rad/s
    cost: float  # half the sum of squares that they leave
    unknowns: int  # real unknowns
    zeros: tuple[float, ...]  # frequencies in the band at which a driven plane stands still, rad/s

    def response(self, decay: float) -> ComplexArray:
        """Readings of forces that grow with so many 1/s."""
        powers = np.polynomial.chebyshev.chebvander(self.frequency - 1j * decay / self.top, self.denominator.size - 1)
        own = self.numerators[self.pair]
        over = np.sum(powers[:, : own.shape[1]] * own, axis=1)
        return np.asarray(over / (powers @ self.denominator) * self.force)


@dataclass(frozen=True, eq=False, kw_only=True)
class RationalFit:
    """Ratios of polynomials fitted to responses."""

    ratios: tuple[_Ratios, ...]  # those of each condition
    zeros: tuple[float, ...]  # frequencies of their zeros, rad/s, ascending

    @property
    def cost(self) -> float:
        """Half the sum of squares that they leave."""
        return sum(one.cost for one in self.ratios)

    @property
    def unknowns(self) -> int:
        """Real unknowns."""
        return sum(one.unknowns for one in self.ratios)

    @property
    def data(self) -> int:
        """Real numbers of the data."""
        return sum(2 * one.readings.size for one in self.ratios)

    def off_axis(self, blocks: Sequence[Responses], decay: float) -> tuple[Responses, ...]:
        """Blocks as they would be of forces that grow with so many 1/s, each reading as sure as the others."""
        share = 0.02  # of each reading, its noise: only ratios of noises matter
        found = []
        for number, block in enumerate(blocks):
            columns = {f.name: getattr(block, f.name) for f in fields(block)}
            measured = block.measured.copy()
            for ratio in self.ratios:
                if ratio.block == number:
                    measured[ratio.readings] = ratio.response(decay)
            noise = share * np.abs(measured)
            found.append(_GrowingResponses(**{**columns, "measured": measured, "sigma": noise, "decay": decay}))
        return tuple(found)

    def limit(self, unknowns: int, deviations: float) -> float:
        """Cost that a rotor with so many poles leaves, to so many standard deviations of chi-squared."""
        level = max(1.0, 2 * self.cost / (self.data - self.unknowns))
        spare = max(self.unknowns - unknowns, 1)
        return float(self.cost + level * (spare + deviations * np.sqrt(2 * spare)) / 2)


def rational_fit(blocks: Sequence[Responses]) -> RationalFit | None:
    """Ratios of polynomials in frequency with as many poles as the model has; None of models and readings without such
    ratios. At one speed every response is ``N(w)/d(w)`` with one denominator for all of them. With the last denominator
    as weight the fit is linear (Sanathanan and Koerner 1963): no start, no local minimum. It holds every rotor with so
    many poles, so that a fit of the rotor which misses the data by much more has not found them."""
    fits: list[_Ratios] = []
    for number, block in enumerate(blocks):
        if block.model.frame != "z" or block.model.shaft is not None or block.imposed:
            return None
        if (np.count_nonzero(block.force, axis=1) != 1).any() or not block.frequency.any():
            return None
        for readings in block.at_set_speed().condition_readings:
            fit = _fit(block, number, readings)
            if fit is None:
                return None
            fits.append(fit)
    zeros: list[float] = []
    same_frequency = 0.02  # relative difference of frequencies that are one
    for w in sorted(w for fit in fits for w in fit.zeros):
        if not zeros or w > (1 + same_frequency) * zeros[-1]:  # those that two speeds or directions share are one
            zeros.append(w)
    return RationalFit(ratios=tuple(fits), zeros=tuple(zeros))


def _fit(block: Responses, number: int, readings: Index) -> _Ratios | None:
    order, size = block.model.order, len(block.model.coordinates)
    poles, zeros = order * size, order * (size - 1)
    line, probe = block.line[readings], block.coordinate[readings]
    plane = np.argmax(np.abs(block.force[line]), axis=1)
    force = block.force[line, plane]
    pairs, pair = np.unique(probe * size + plane, return_inverse=True)
    unknowns = 2 * (poles + pairs.size * (zeros + 1))
    data_an_unknown = 2.0  # real data an unknown from which on the residuals of the ratios show the noise
    if 2 * readings.size < data_an_unknown * unknowns:
        return None
    top = float(np.abs(block.frequency[line]).max())
    powers = np.asarray(np.polynomial.chebyshev.chebvander(block.frequency[line] / top, poles), dtype=float)
    numerators = np.zeros((readings.size, pairs.size, zeros + 1))
    numerators[np.arange(readings.size), pair.reshape(-1)] = powers[:, : zeros + 1]
    response, sigma = block.measured[readings] / force, block.sigma[readings] / np.abs(force)
    denominator, numerator, cost = best_ratio(response, sigma, powers, numerators.reshape(readings.size, -1))
    seen = numerator.reshape(pairs.size, zeros + 1)[pairs // size == pairs % size]
    zeros_seen = [float(abs(w)) for own in seen for w in np.polynomial.chebyshev.chebroots(own)]
    return _Ratios(
        block=number,
        readings=readings,
        frequency=block.frequency[line] / top,
        force=force,
        pair=pair.reshape(-1),
        denominator=denominator,
        numerators=numerator.reshape(pairs.size, zeros + 1),
        top=top,
        cost=cost,
        unknowns=unknowns,
        zeros=tuple(w * top for w in zeros_seen if 0 < w < 1),  # in the band
    )
