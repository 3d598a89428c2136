"""A fit about its optimum, as the study of its residuals takes it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rotorfit.estimators.blocks.correlated import CorrelatedResponses
from rotorfit.estimators.blocks.nonlinear import responses_of
from rotorfit.estimators.blocks.observations import force_plane, sweeps_of
from rotorfit.estimators.blocks.row_keys import rows_by, words
from rotorfit.estimators.blocks.set_speeds import once_per_turn
from rotorfit.estimators.inference.covariance import prior_curvature
from rotorfit.estimators.misfit.problem import Problem
from rotorfit.models.array_types import ComplexArray, Float, Index

_MOST_RUNS = 200  # each costs a small matrix; of more, a difference from run to run is noise
_FEWEST_READINGS = 3  # fewest from which an effect of the run can be estimated
_FLUID = ("K0", "D", "lam", "lam_D")


@dataclass(frozen=True, eq=False, kw_only=True)
class LinearisedFit:
    """A fit about its optimum, all blocks in one row, whitened by the noise of the data. Offsets of the phase reference
    that the fit has as entries are effects of runs here, and no fitted values."""

    r: ComplexArray  # residuals
    J: ComplexArray  # their derivatives by the fitted values, shape ``(R, p)``
    prior: Float  # curvature of the fitted values' priors
    predicted: ComplexArray  # in units of the readings
    sigma: Float  # noise, in units of the readings
    rate: Float  # by which they are multiplied in the quantity that their sensors measured, whose noise is even
    sigma_given: bool  # with the data, for all readings
    channels: tuple[list[Index], ...]  # sweeps of each probe and force plane
    runs: tuple[str, ...]  # their names; empty where differences cannot be looked for
    rows: list[Index]  # readings of each
    kinds: tuple[str, ...]  # of effects of runs that are looked for, those that combine others last
    Z: ComplexArray  # what a unit of each changes, shape ``(R, k)``
    forced: tuple[int, ...]  # kinds that the fit was asked to have: offsets of the phase reference

    @property
    def sweeps(self) -> list[Index]:
        """All sweeps."""
        return [sweep for sweeps in self.channels for sweep in sweeps]

    def name(self, kind: int) -> str:
        """How a kind of effect is called in the fitted vector."""
        return "phase" if kind in self.forced else self.kinds[kind]

    def weighed(self, sigma: Float) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
        """Residuals, derivatives and effects in units of another noise."""
        scale = (sigma / self.sigma)[:, None]
        return self.r / scale[:, 0], self.J / scale, self.Z / scale

    def sensitivity(self, kind: int) -> ComplexArray:
        """Change of the logarithm of the predictions by a unit of an effect."""
        return np.asarray(self.Z[:, kind] * self.sigma / self.predicted)


def linearise(problem: Problem, x: Float) -> LinearisedFit | None:
    """The fit about its optimum; nothing where the data are no sweeps."""
    blocks = [responses_of(block) for block in problem.blocks]
    if any(block is None or not block.frequency.any() for block in blocks) or any(
        isinstance(block, CorrelatedResponses) for block in problem.blocks
    ):
        return None
    channels = channels_of(problem)
    if not any(channels):
        return None
    r, J = problem.jacobian(x)
    sigma = np.concatenate([block.sigma for block in problem.blocks])
    predicted = np.concatenate([block.measured for block in problem.blocks]) + r * sigma
    runs, rows = _runs_of(problem)
    columns = effects_of_runs(problem, x, predicted / sigma, J) if runs else {}
    offsets = _offset_entries(problem) if runs else {}
    for entry, run in offsets.items():
        own = rows[runs.index(run)]
        r[own] -= columns["run_phase"][own] * x[entry]
    kept = np.setdiff1d(np.arange(x.size), list(offsets)).astype(int)
    kinds = tuple(columns)
    return LinearisedFit(
        r=r,
        J=J[:, kept],
        prior=prior_curvature(problem, x)[kept],
        predicted=predicted,
        sigma=sigma,
        rate=np.concatenate([block.rate for block in blocks if block is not None]),
        sigma_given=all(block.sigma_given for block in blocks if block is not None),
        channels=channels,
        runs=runs,
        rows=rows,
        kinds=kinds,
        Z=np.array(list(columns.values())).T if kinds else np.zeros((r.size, 0), dtype=complex),
        forced=(kinds.index("run_phase"),) if offsets else (),
    )


def _runs_of(problem: Problem) -> tuple[tuple[str, ...], list[Index]]:
    """Runs that may differ, with the readings of each; none where they are one, too many, or one has too few."""
    names, number = words(np.concatenate([block.run for block in problem.blocks]))
    rows = rows_by(number)
    if not 2 <= len(names) <= _MOST_RUNS or any(own.size < _FEWEST_READINGS for own in rows):
        return (), []
    return tuple(names), rows


def effects_of_runs(problem: Problem, x: Float, whitened: ComplexArray, J: ComplexArray) -> dict[str, ComplexArray]:
    """Change of whitened predictions by a unit of each kind of effect of runs."""
    by_phase = [block.by_phase for block in map(responses_of, problem.blocks) if block is not None]
    columns = {"run_force": whitened, "run_phase": np.concatenate(by_phase) * whitened}
    for base in _FLUID:
        entries = [i for i, name in enumerate(problem.space.base) if name == base]
        if entries:
            columns["run_lam" if base == "lam_D" else f"run_{base}"] = J[:, entries] @ x[entries]
    if {"run_K0", "run_D"} <= set(columns):
        columns["run_fluid"] = columns["run_K0"] + columns["run_D"]
    return columns


def _offset_entries(problem: Problem) -> dict[int, str]:
    """Entries of the fitted vector that offset the phase reference of a run without a prior, and the run."""
    first = len(problem.space.names)
    bound = {prior.entry for prior in problem.priors}
    parts = [name.partition("[") for name in problem.space.nuisance]
    return {first + i: run[:-1] for i, (kind, _, run) in enumerate(parts) if kind == "phase" and first + i not in bound}


def channels_of(problem: Problem) -> tuple[list[Index], ...]:
    """Sweeps of each probe and force plane, readings counted over all blocks."""
    channels: list[list[Index]] = []
    start = 0
    for whole in problem.blocks:
        block = responses_of(whole)
        if block is not None:
            groups: dict[tuple[int, int], list[Index]] = {}
            plane = force_plane(block)
            synchronous = once_per_turn(np.abs(block.frequency), block.speed).all()
            for sweep in sweeps_of(block, synchronous=bool(synchronous)):
                key = (int(block.coordinate[sweep[0]]), int(plane[sweep[0]]))
                groups.setdefault(key, []).append(start + sweep)
            channels += list(groups.values())
        start += whole.measured.size
    return tuple(channels)


def lines_in(problem: Problem) -> Index:
    """Number of the line of each reading, readings that are no responses each on their own."""
    parts, start = [], 0
    for whole in problem.blocks:
        block = responses_of(whole)
        own = np.arange(whole.measured.size) if block is None else block.line
        parts.append(start + own)
        start += int(own.max(initial=-1)) + 1
    return np.concatenate(parts)
