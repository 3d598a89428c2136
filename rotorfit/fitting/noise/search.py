"""Find out what the residuals of a fit are: noise of some shape, noise with memory, differences of runs, or misfit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from rotorfit.estimators.blocks.correlated import CorrelatedResponses
from rotorfit.estimators.blocks.nonlinear import responses_of
from rotorfit.estimators.blocks.row_keys import words
from rotorfit.estimators.blocks.sweeps import force_plane, sweeps_of
from rotorfit.estimators.misfit.problem import Problem
from rotorfit.estimators.noise.correlation import Memory, memory
from rotorfit.estimators.noise.noise_levels import Shape, fit_probes, likelihood
from rotorfit.estimators.noise.run_effects import MixedModel, Solved, runs_agree, select_effects, share_alike
from rotorfit.fitting.noise.record import NoiseVerdict
from rotorfit.models.array_types import ComplexArray, Float, Index

_CLEARLY = 4.0
"""Standard deviations from which memory along the sweeps is more than chance."""
_SHORT = 0.25
"""Correlation of neighbouring residuals below which it matters little."""
_SURE = 0.005
"""Probability of telling, as a warning, of an effect of runs that do not differ."""
_PERHAPS, _PERHAPS_OF_TWO = 0.1, 0.2
"""The same of letting the errors allow for one, without a warning; with two runs.

Runs that differ agree by chance in some tests, and then nothing widens: the laxer this level, the fewer. Both tests of
an effect err to the safe side: at 0.1 runs that agree are given one in 2 to 3 fits of 100, and at 0.2 in 5; each is
several to forty times as wide, so that the mean width grows by 1 to 30 %. Two runs need 0.2 to hold D in 85 % where
forces differ by 1 %: two that agree are then 1.4 to 2.1 times as wide on average. The median stays.
``benchmarks/honest_errors.py`` counts all of it.
"""
GAIN = 12.0
"""Twice the gain in log likelihood, for each probe, from which noise by residuals replaces that of the data alone."""
AGREES = 1.5
"""Squared residuals over those of the noise up to which the two are of one size."""
RESPONSE, SPEED = "of the response", "of the speed, as it moves the response"
_SAME = 1e-9
"""Relative change of the noise that changes nothing."""
_MOST_RUNS = 200
_FEWEST = 3  # readings of a run that can tell something of it
_FLUID = ("K0", "D", "lam", "lam_D")


@dataclass(frozen=True, eq=False, kw_only=True)
class Residuals:
    """A fit about its optimum, all blocks in one row, whitened by the noise of the data."""

    r: ComplexArray  # residuals, derivatives by the fitted vector, curvature of its priors
    J: ComplexArray  # residuals, derivatives by the fitted vector, curvature of its priors
    prior: Float  # residuals, derivatives by the fitted vector, curvature of its priors
    y: ComplexArray  # predictions and noise, in their units
    sigma: Float  # predictions and noise, in their units
    sigma_given: bool  # whether the noise was given with the data
    channels: tuple[list[Index], ...]  # sweeps of each probe and force plane
    runs: tuple[str, ...]  # names of the runs, and the readings of each
    rows: list[Index]  # names of the runs, and the readings of each
    kinds: tuple[str, ...]  # effects of runs that are looked for, and what a unit of each changes, shape ``(R, k)``
    Z: ComplexArray  # effects of runs that are looked for, and what a unit of each changes, shape ``(R, k)``
    free: int  # how many of the kinds, the first ones, are none combined of others
    kept: Index  # entries of the fitted vector that J has

    @property
    def sweeps(self) -> list[Index]:
        """All sweeps."""
        return [sweep for sweeps in self.channels for sweep in sweeps]

    @cached_property
    def sums(self) -> MixedModel:
        """Sums over runs for all kinds of effects, under the noise of the data."""
        return MixedModel.of(self.r, self.J, self.Z, self.rows, self.prior)

    @cached_property
    def along(self) -> dict[str, Float]:
        """Squares of what noise may grow with: the response, as by a force that jitters, or its change by the speed."""
        found = {RESPONSE: np.asarray(np.abs(self.y) ** 2)}
        if "run_lam" in self.kinds:
            found[SPEED] = np.asarray(np.abs(self.Z[:, self.kinds.index("run_lam")] * self.sigma) ** 2)
        return found


@dataclass(frozen=True, eq=False, kw_only=True)
class _Left:
    """What a mixed model with given noise leaves."""

    data: Residuals  # the fit
    solved: Solved  # its estimates
    left: ComplexArray  # residuals and sensitivities in units of that noise
    own: ComplexArray  # residuals and sensitivities in units of that noise
    power: Float  # squared residuals, leverage made good, in units of the readings, and 1 - leverage
    weight: Float  # squared residuals, leverage made good, in units of the readings, and 1 - leverage

    def redchi(self, sigma: Float) -> float:
        """Mean squared residual over the noise's."""
        return float(np.sum(self.weight * self.power / sigma**2) / np.sum(self.weight))

    def shapes(self, along: str) -> list[list[Shape]]:
        """Noise of each probe by restricted likelihood; ``along`` names what it may grow with."""
        if along not in self._shapes:
            size2 = self.data.along[along]
            self._shapes[along] = fit_probes(self.data.channels, self.power, self.weight, size2, along=along)
        return self._shapes[along]

    @cached_property
    def _shapes(self) -> dict[str, list[list[Shape]]]:
        return {}


def residuals_of(problem: Problem, x: Float) -> Residuals | None:
    """The fit about its optimum; nothing where the data are no sweeps."""
    blocks = [responses_of(block) for block in problem.blocks]
    if any(block is None or not block.frequency.any() for block in blocks) or any(
        isinstance(block, CorrelatedResponses) for block in problem.blocks
    ):
        return None
    r, J = problem.jacobian(x)
    offsets = offset_entries(problem)
    sigma = np.concatenate([block.sigma for block in problem.blocks])
    y = np.concatenate([block.measured for block in problem.blocks]) + r * sigma
    prior = np.zeros(x.size)
    for one in problem.priors:
        prior[one.entry] += one.terms(float(x[one.entry]))[2]
    channels = channels_of(problem)
    runs, rows = _runs_of(problem)
    kinds, Z = _effects(problem, x, y / sigma, J) if runs else ((), np.zeros((r.size, 0), dtype=complex))
    kept = np.arange(x.size)
    if offsets and kinds:  # offsets of the phase reference are effects of runs, of unknown size
        column, r = Z[:, kinds.index("run_phase")], r.copy()
        for entry, run in offsets.items():
            own = rows[runs.index(run)]
            r[own] -= column[own] * x[entry]
        kept = np.setdiff1d(np.arange(x.size), list(offsets))
        J, prior = J[:, kept], prior[kept]
    free = sum(kind != "run_fluid" for kind in kinds)
    return Residuals(
        r=r,
        J=J,
        prior=prior,
        y=y,
        sigma=sigma,
        sigma_given=all(block.sigma_given for block in blocks if block is not None),
        channels=channels,
        runs=runs,
        rows=rows,
        kinds=kinds,
        Z=Z,
        free=free,
        kept=kept,
    )


def _runs_of(problem: Problem) -> tuple[tuple[str, ...], list[Index]]:
    """Runs that may differ, with the readings of each; none where they are one, too many, or one has too few."""
    names, number = words(np.concatenate([block.run for block in problem.blocks]))
    order, ends = np.argsort(number, kind="stable"), np.cumsum(np.bincount(number))
    rows = np.split(order, ends[:-1])
    if not 2 <= len(names) <= _MOST_RUNS or any(own.size < _FEWEST for own in rows):
        return (), []
    return tuple(names), rows


def channels_of(problem: Problem) -> tuple[list[Index], ...]:
    """Sweeps of each probe and force plane, readings counted over all blocks."""
    channels: list[list[Index]] = []
    start = 0
    for whole in problem.blocks:
        block = responses_of(whole)
        if block is not None:
            groups: dict[tuple[int, int], list[Index]] = {}
            plane = force_plane(block)
            away = np.abs(np.abs(block.frequency) - block.speed)
            synchronous = bool(np.all(away <= 1e-4 * np.abs(block.speed)))
            for sweep in sweeps_of(block, synchronous=synchronous):
                key = (int(block.coordinate[sweep[0]]), int(plane[sweep[0]]))
                groups.setdefault(key, []).append(start + sweep)
            channels += list(groups.values())
        start += whole.measured.size
    return tuple(channels)


def sweeps_in(problem: Problem) -> list[Index]:
    """All sweeps of a problem."""
    return [sweep for sweeps in channels_of(problem) for sweep in sweeps]


def lines_in(problem: Problem) -> Index:
    """Number of the line of each reading, readings that are no responses each on their own."""
    parts, start = [], 0
    for whole in problem.blocks:
        block = responses_of(whole)
        own = np.arange(whole.measured.size) if block is None else block.line
        parts.append(start + own)
        start += int(own.max(initial=-1)) + 1
    return np.concatenate(parts)


def offset_entries(problem: Problem) -> dict[int, str]:
    """Entries of the fitted vector that offset the phase reference of a run without a prior, and the run."""
    first = len(problem.space.names)
    bound = {prior.entry for prior in problem.priors}
    parts = [name.partition("[") for name in problem.space.nuisance]
    return {first + i: run[:-1] for i, (kind, _, run) in enumerate(parts) if kind == "phase" and first + i not in bound}


def turn_of(problem: Problem) -> ComplexArray:
    """Change of the logarithm of each prediction by a phase lead, per rad."""
    parts = []
    for block in map(responses_of, problem.blocks):
        assert block is not None
        backward = (block.frequency[block.line] < 0) & (block.model.frame == "z")
        parts.append(np.where(backward, -1j, 1j))
    return np.concatenate(parts)


def _effects(problem: Problem, x: Float, y: ComplexArray, J: ComplexArray) -> tuple[tuple[str, ...], ComplexArray]:
    """Kinds of effects of runs, and the change of whitened predictions by a unit of each."""
    columns = {"run_force": y, "run_phase": turn_of(problem) * y}
    for base in _FLUID:
        entries = [i for i, name in enumerate(problem.space.base) if name == base]
        if entries:
            columns["run_lam" if base == "lam_D" else f"run_{base}"] = sum(J[:, i] * x[i] for i in entries)
    if {"run_K0", "run_D"} <= set(columns):
        columns["run_fluid"] = columns["run_K0"] + columns["run_D"]
    return tuple(columns), np.array(list(columns.values())).T


def _leave(data: Residuals, sigma: Float, kinds: Sequence[int], variance: Float) -> _Left:
    r, J, Z = data.r, data.J, data.Z[:, list(kinds)]
    if sigma is not data.sigma:
        scale = sigma / data.sigma
        r, J, Z = r / scale, J / scale[:, None], Z / scale[:, None]
    solved = _model(data, sigma).part(kinds).solve(variance)
    rest = solved.rest(r, J, Z, data.rows)
    power, weight = made_good(rest.residuals, rest.leverage, sigma)
    return _Left(data=data, solved=solved, left=rest.residuals, own=rest.own, power=power, weight=weight)


def made_good(residuals: ComplexArray, leverage: Float, sigma: Float) -> tuple[Float, Float]:
    """Squared residuals, leverage made good, in units of the readings, and 1 - leverage."""
    # A reading that alone determines something has no residual to judge by.
    weight = np.clip(1 - leverage, 0.02, 1.0)
    return np.abs(residuals) ** 2 / 2 * sigma**2 / weight, weight


def _shapes(data: Residuals, found: _Left, along: Sequence[str]) -> tuple[list[Shape], Float]:
    """Noise of all probes by restricted likelihood, and sigma of each reading."""
    shapes: list[Shape] = []
    for trials in zip(*(found.shapes(name) for name in along), strict=True):
        gains = [sum(shape.log_likelihood for shape in trial) for trial in trials]
        best = int(np.argmax(gains))
        shapes += trials[best if 2 * (gains[best] - gains[0]) > GAIN else 0]
    sigma = np.empty(data.r.size)
    for shape in shapes:
        sigma[shape.rows] = np.sqrt(shape.variance(data.along[shape.along]))
    return shapes, sigma


@dataclass(frozen=True, eq=False, kw_only=True)
class Search:
    """What the residuals are, before the fit is repeated with it."""

    data: Residuals  # the fit
    verdict: NoiseVerdict  # what the residuals are
    memory: Memory  # what the residuals are
    shapes: list[Shape]  # noise of the residuals, and of each reading as it is to be taken
    sigma: Float  # noise of the residuals, and of each reading as it is to be taken
    variance: Float  # of the effects of runs, by kind, zero where runs do not differ
    perhaps: Float  # variance of effects that runs may have though chance explains them as well, by kind
    freedom: Float  # degrees of freedom of both, by kind, zero where runs do not differ
    solved: Solved  # estimates with that noise and these effects
    weight: Float  # one less the leverage of each reading

    @property
    def chosen(self) -> list[int]:
        """Kinds of effects of runs that were found."""
        return [int(kind) for kind in np.flatnonzero(self.variance)]


def search_noise(data: Residuals, *, forced: Sequence[int] = ()) -> Search:
    """Tell noise, its shape and its memory, differences of runs, and misfit apart."""
    variance, perhaps = _between_runs(data, forced)
    chosen = np.flatnonzero(variance).tolist()
    found = _leave(data, data.sigma, chosen, variance[chosen])
    sigma = data.sigma
    shapes, other = _own_noise(data, found)
    remembered = memory(found.left, found.own, found.solved.outer, data.sweeps)
    if chosen or not _plainly(data, found, shapes, remembered):
        for _ in range(2):
            before, sigma = sigma, _taken(data, found)
            if np.allclose(sigma, before, rtol=_SAME, atol=0):
                break
            found = _leave(data, sigma, chosen, variance[chosen])
        shapes, other = _own_noise(data, found)
        remembered = memory(found.left, found.own, found.solved.outer, data.sweeps)
    ratio = found.redchi(data.sigma)
    verdict = _verdict(data, remembered, ratio, known=data.sigma_given or _explains(data, found, shapes))
    if verdict is not NoiseVerdict.SHAPED:
        other = data.sigma * (np.sqrt(max(1.0, ratio)) if chosen else 1.0)
        shapes = []
    if verdict is NoiseVerdict.MISFIT:
        chosen = []  # what runs seem to differ by may be the model's
        variance = perhaps = np.zeros_like(variance)
        found = _leave(data, sigma, chosen, variance[chosen])
        remembered = memory(found.left, found.own, found.solved.outer, data.sweeps)
    both, freedom = variance + perhaps, np.zeros_like(variance)
    if both.any():
        freedom[both > 0] = _model(data, other).part(np.flatnonzero(both).tolist()).freedom(both[both > 0])
    return Search(
        data=data,
        verdict=verdict,
        memory=remembered,
        shapes=shapes,
        sigma=other,
        variance=variance,
        perhaps=perhaps,
        freedom=freedom,
        solved=found.solved,
        weight=found.weight,
    )


def _verdict(data: Residuals, remembered: Memory, ratio: float, *, known: bool) -> NoiseVerdict:
    """What residuals with a memory and a redchi are; ``known``: noise that was told, or is as the data have it."""
    if remembered.first > _SHORT and remembered.z > _CLEARLY:
        return NoiseVerdict.FOLLOWING if ratio < AGREES else NoiseVerdict.MISFIT
    if not known:
        return NoiseVerdict.SHAPED
    return NoiseVerdict.LARGER if data.sigma_given and ratio > AGREES else NoiseVerdict.AS_FOUND


def _between_runs(data: Residuals, forced: Sequence[int]) -> tuple[Float, Float]:
    """Variances of the effects of runs, zero where runs agree: those that surely are, and those that may be."""
    sure, perhaps = np.zeros((2, len(data.kinds)))
    level = _PERHAPS_OF_TWO if len(data.runs) == 2 else _PERHAPS
    # Noise that was told is only ever taken larger, under which runs agree all the more.
    if not data.kinds or (data.sigma_given and not forced and runs_agree(data.sums, level=level)):
        return sure, perhaps
    within = _leave(data, data.sigma, range(data.free), np.full(data.free, np.inf))
    sigma, ratio = _taken(data, within), within.redchi(data.sigma)
    slow = _slow(data, within, sigma)
    if slow > 1 and ratio >= AGREES:
        return sure, perhaps  # the model misses within every run
    model = _model(data, sigma * slow)
    sure = select_effects(model, level=_SURE, forced=forced)
    # Noise of another size than that of the data has a shape that is guessed, which a lax test would take for runs.
    if not set(np.flatnonzero(sure).tolist()) - set(forced) and ratio < AGREES:
        perhaps = np.where(sure > 0, 0.0, select_effects(model, level=level, forced=forced))
    if len(data.runs) == 2 and not forced and np.count_nonzero(sure + perhaps) == 1:
        shared = share_alike(model)  # which kind it is two runs hardly tell
        sure, perhaps = (shared, perhaps) if sure.any() else (sure, shared)
    return sure, perhaps


def _own_noise(data: Residuals, found: _Left) -> tuple[list[Shape], Float]:
    """Noise by the residuals, where none was told."""
    return ([], data.sigma) if data.sigma_given else _shapes(data, found, tuple(data.along))


def _plainly(data: Residuals, found: _Left, shapes: Sequence[Shape], remembered: Memory) -> bool:
    """Whether residuals are the noise of the data within half of every limit: weighing them anew would change nothing.

    Noise that was told, without priors, is weighed anew by one factor only.
    """
    if data.sigma_given:
        return not data.prior.any()
    return bool(forgetful(remembered.first, remembered.z)) and _explains(data, found, shapes, GAIN / 2)


def forgetful(first: Float | float, z: Float | float) -> Any:
    """Whether residuals hardly follow one another, by half of either limit."""
    return (np.asarray(first) < _SHORT / 2) | (np.asarray(z) < _CLEARLY / 2)


def _taken(data: Residuals, found: _Left) -> Float:
    """Noise by which readings are weighed on the way: as told, but not less than residuals ask; else by their shape."""
    if data.sigma_given:
        return np.asarray(data.sigma * np.sqrt(max(1.0, found.redchi(data.sigma))))
    return _shapes(data, found, (RESPONSE,))[1]


def _slow(data: Residuals, within: _Left, sigma: Float) -> float:
    """Root of the factor by which noise with memory weighs more on what changes slowly along a sweep."""
    rows = memory(within.left * data.sigma / sigma, within.own, within.solved.outer, data.sweeps)
    follows = rows.first > _SHORT and rows.z > _CLEARLY
    return float(np.sqrt(1 + 2 * sum(rows.lags))) if follows else 1.0


def _model(data: Residuals, sigma: Float) -> MixedModel:
    if sigma is data.sigma:
        return data.sums
    scale = sigma / data.sigma
    if np.ptp(scale) <= _SAME * scale[0]:
        return data.sums.louder(float(scale[0]), data.prior)
    return MixedModel.of(data.r / scale, data.J / scale[:, None], data.Z / scale[:, None], data.rows, data.prior)


def _explains(data: Residuals, found: _Left, shapes: Sequence[Shape], gain: float = GAIN) -> bool:
    """Whether the residuals are as likely under the noise of the data as under one of their own, up to a gain."""
    now = sum(shape.log_likelihood for shape in shapes)
    return 2 * (now - float(likelihood(found.power, found.weight, data.sigma**2))) < gain * len(data.channels)
