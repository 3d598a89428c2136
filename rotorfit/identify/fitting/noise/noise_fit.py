"""A fit about its optimum solved with given noise and effects of runs, and the noise that its residuals have."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from rotorfit.base.array_types import ComplexArray, Float, Index
from rotorfit.estimators.blocks.observations import force_plane, sweeps_of
from rotorfit.estimators.blocks.row_keys import rows_by, words
from rotorfit.estimators.blocks.set_speeds import once_per_turn
from rotorfit.estimators.inference.covariance import prior_curvature
from rotorfit.estimators.minimisation.own_columns import OwnColumns, own_basis, without
from rotorfit.estimators.minimisation.projection import Projection
from rotorfit.estimators.misfit.problem import Problem
from rotorfit.estimators.noise.residuals import Memory, Shape, fit_probes, likelihood, memory
from rotorfit.estimators.noise.run_effects import LEAST_RESIDUAL_SHARE, MixedModel, MixedSolution, Residuals
from rotorfit.identify.fitting.causes.solution import JointSearch

_FLUID = ("K0", "D", "lam", "lam_D")

RESPONSE, SPEED = "of the response", "of the speed, as it moves the response"
"""Quantities that noise may grow with."""


@dataclass(frozen=True, eq=False, kw_only=True)
class LinearisedFit:
    """A fit about its optimum, all blocks in one row, whitened by the noise of the data. Offsets of the phase reference
    that the fit has as entries are effects of runs here, and no fitted values."""

    r: ComplexArray  # residuals, without causes
    J: ComplexArray  # their derivatives by the fitted values but ``own``, shape ``(R, p)``
    prior: Float  # curvature of these values' priors
    solved: ComplexArray  # residuals at the optimum, causes included
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
    own: tuple[OwnColumns, ...] = ()  # fitted values that act on one channel alone, of a single run

    @property
    def sweeps(self) -> list[Index]:
        """All sweeps."""
        return [sweep for sweeps in self.channels for sweep in sweeps]

    @cached_property
    def sizes(self) -> dict[str, Float]:
        """Squares of what noise may grow with, in units of what the sensors measured."""
        found = {RESPONSE: np.abs(self.predicted) ** 2 * self.rate**2}  # as by a force that jitters
        if "run_lam" in self.kinds:
            found[SPEED] = np.abs(self.Z[:, self.kinds.index("run_lam")] * self.sigma) ** 2 * self.rate**2
        return found

    @cached_property
    def alone(self) -> NoiseFit:
        """The fit with the noise of the data and without effects of runs."""
        return NoiseFit.of(self, self.sigma, np.zeros(len(self.kinds)))

    def weighed(self, sigma: Float) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
        """Residuals, derivatives and effects in units of another noise, and what :attr:`own` leaves of them."""
        scale, r, J, Z = (sigma / self.sigma)[:, None], self.r[:, None], self.J, self.Z
        if (scale != 1).any():  # else there is no need of copies
            r, J, Z = r / scale, J / scale, Z / scale
        if self.own:
            basis = self.own_basis(sigma)
            r, J = without(self.own, basis, r), without(self.own, basis, J)
        return r[:, 0], J, Z

    def own_basis(self, sigma: Float) -> ComplexArray:
        """Orthonormal columns that span :attr:`own` in units of a noise."""
        return own_basis(self.own, sigma / self.sigma)


def linearise(problem: Problem, x: Float, beside: JointSearch | None = None) -> LinearisedFit | None:
    """The fit about its optimum, with causes solved beside its values; nothing where the data are no sweeps."""
    blocks, channels = problem.responses, channels_of(problem)
    if len(blocks) < len(problem.blocks) or not all(block.frequency.any() for block in blocks) or not any(channels):
        return None
    if not all(block.independent for block in problem.blocks):
        return None
    sigma = problem.sigma
    # Runs that may differ, with the readings of each; none where they are one, too many, or one has too few.
    names, number = words(problem.run)
    rows = rows_by(number)
    most_runs = 200  # each costs a small matrix; of more, a difference from run to run is noise
    fewest_readings = 3  # fewest from which an effect of the run can be estimated
    comparable = 2 <= len(names) <= most_runs and all(own.size >= fewest_readings for own in rows)
    runs, rows = (tuple(names), rows) if comparable else ((), [])
    projection = None if runs or beside is not None else Projection.of(problem)
    own: tuple[OwnColumns, ...] = ()
    values: Index = np.arange(x.size)
    if projection is None:
        r, J = problem.jacobian(x)
    else:  # effects of runs would tie channels together
        (r, J, own), values = projection.derivatives(x), projection.kept
    predicted = problem.measured + r * sigma
    columns = effects_of_runs(problem, x, predicted / sigma, J) if runs else {}
    # Entries of the fitted vector that offset the phase reference of a run without a prior, and the run.
    first, bound = len(problem.space.names), {prior.entry for prior in problem.priors}
    parts = enumerate((name.partition("[") for name in problem.space.nuisance if runs), first)
    offsets = {entry: run[:-1] for entry, (kind, _, run) in parts if kind == "phase" and entry not in bound}
    for entry, run in offsets.items():
        some = rows[runs.index(run)]
        r[some] -= columns["run_phase"][some] * x[entry]
    kept = np.flatnonzero(~np.isin(values, list(offsets)))
    kinds = tuple(columns)
    J, prior, solved = J[:, kept], prior_curvature(problem, x)[values[kept]], r
    if beside is not None:  # sizes of causes are values too, of which something is known beforehand
        J, prior = np.hstack([J, beside.columns]), np.concatenate([prior, beside.before**-2])
        r = r - beside.columns @ beside.sizes
    return LinearisedFit(
        r=r,
        J=J,
        prior=prior,
        solved=solved,
        predicted=predicted,
        sigma=sigma,
        rate=np.concatenate([block.rate for block in blocks]),
        sigma_given=all(block.sigma_given for block in blocks),
        channels=channels,
        runs=runs,
        rows=rows,
        kinds=kinds,
        Z=np.array(list(columns.values())).T if kinds else np.zeros((r.size, 0), dtype=complex),
        forced=(kinds.index("run_phase"),) if offsets else (),
        own=own,
    )


def effects_of_runs(problem: Problem, x: Float, whitened: ComplexArray, J: ComplexArray) -> dict[str, ComplexArray]:
    """Change of whitened predictions by a unit of each kind of effect of runs."""
    by_phase = np.concatenate([block.by_phase for block in problem.responses])
    columns = {"run_force": whitened, "run_phase": by_phase * whitened}
    for base in _FLUID:
        entries = [i for i, name in enumerate(problem.space.base) if name == base]
        if entries:
            columns["run_lam" if base == "lam_D" else f"run_{base}"] = J[:, entries] @ x[entries]
    if {"run_K0", "run_D"} <= set(columns):
        columns["run_fluid"] = columns["run_K0"] + columns["run_D"]
    return columns


def channels_of(problem: Problem) -> tuple[list[Index], ...]:
    """Sweeps of each probe and force plane, readings counted over all blocks."""
    channels: list[list[Index]] = []
    start = 0
    for whole in problem.blocks:
        block = whole.responses
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
        block = whole.responses
        own = np.arange(whole.measured.size) if block is None else block.line
        parts.append(start + own)
        start += int(own.max(initial=-1)) + 1
    return np.concatenate(parts)


_LEAST_SHAPE_GAIN = 12.0
"""Twice the gain in log likelihood, for each probe, from which noise by residuals replaces that of the data alone: the
99.75 % point of chi-squared with the two parts of a shape as degrees of freedom."""


@dataclass(frozen=True, eq=False, kw_only=True)
class NoiseFit:
    """A mixed model solved with given noise and effects of runs."""

    data: LinearisedFit
    sigma: Float  # noise that weighed the readings, in their units
    solution: MixedSolution
    residuals: Residuals  # in units of sigma

    @classmethod
    def of(cls, data: LinearisedFit, sigma: Float, variance: Float) -> NoiseFit:
        """Solve with variances of the effects by kind, zero for those that runs do not have."""
        kinds = np.flatnonzero(variance)
        r, J, Z = data.weighed(sigma)
        solution = MixedModel.of(r, J, Z[:, kinds], data.rows, data.prior).solve(variance[kinds])
        residuals = solution.residuals(r, J, Z[:, kinds], data.rows)
        if data.own:
            basis = data.own_basis(sigma)
            leverage = residuals.leverage + np.sum(np.abs(basis) ** 2, axis=1) / 2
            sensitivities = np.hstack([residuals.sensitivities, basis])
            residuals = replace(residuals, leverage=leverage, sensitivities=sensitivities)
        return cls(data=data, sigma=sigma, solution=solution, residuals=residuals)

    @cached_property
    def weight(self) -> Float:
        """One less the leverage of each reading."""
        return np.clip(1 - self.residuals.leverage, LEAST_RESIDUAL_SHARE, 1.0)

    @cached_property
    def power(self) -> Float:
        """Squared residuals, leverage-corrected, in units of what the sensors measured."""
        return np.asarray(np.abs(self.residuals.values) ** 2 / 2 * self.sigma**2 / self.weight * self.data.rate**2)

    @cached_property
    def power_given(self) -> Float:
        """Square of the noise of the data in the same units."""
        return np.asarray(self.data.sigma**2 * self.data.rate**2)

    @property
    def redchi(self) -> float:
        """Mean squared residual over the noise of the data."""
        return float(np.sum(self.weight * self.power / self.power_given) / np.sum(self.weight))

    def shapes(self, along: str) -> list[list[Shape]]:
        """Noise of each probe by restricted likelihood, of which a share may grow with something."""
        if along not in self._shapes:
            sizes = self.data.sizes[along]
            self._shapes[along] = fit_probes(self.data.channels, self.power, self.weight, sizes, along=along)
        return self._shapes[along]

    @cached_property
    def _shapes(self) -> dict[str, list[list[Shape]]]:
        return {}

    def memory(self, sigma: Float) -> Memory:
        """Correlation along the sweeps of residuals in units of a noise."""
        values, sensitivities = self.residuals.values * (self.sigma / sigma), self.residuals.sensitivities
        count = self.data.prior.size
        outer = np.eye(sensitivities.shape[1])  # own columns come last, orthonormal
        outer[:count, :count] = self.solution.outer
        return memory(values, sensitivities, outer, self.data.sweeps)


def reweighted(data: LinearisedFit, variance: Float) -> NoiseFit:
    """The mixed model weighed by the noise of its own residuals."""
    fit = NoiseFit.of(data, data.sigma, variance) if variance.any() else data.alone
    # Times that the fit is weighed anew by the noise of its residuals: in nineteen of twenty fits of
    # ``benchmarks/honest_errors.py`` a third would change sigma by less than a percent.
    for _ in range(2):
        sigma = weighing_sigma(fit)
        if np.array_equal(sigma, fit.sigma):
            break
        fit = NoiseFit.of(data, sigma, variance)
    return fit


def weighing_sigma(fit: NoiseFit) -> Float:
    """Noise to weigh by: as given, but not less than residuals ask; else as they have it."""
    if fit.data.sigma_given:
        return np.asarray(fit.data.sigma * np.sqrt(max(1.0, fit.redchi)))
    return sigma_of_residuals(fit, (RESPONSE,))[1]


def sigma_of_residuals(fit: NoiseFit, along: Sequence[str]) -> tuple[list[Shape], Float]:
    """Noise of all probes by restricted likelihood, and sigma of each reading."""
    data, sigma = fit.data, fit.data.sigma.copy()
    shapes: list[Shape] = []
    for trials in zip(*(fit.shapes(a) for a in along if a in data.sizes), strict=True):
        gains = [sum(shape.log_likelihood for shape in trial) for trial in trials]
        best = int(np.argmax(gains))
        shapes += trials[best if 2 * (gains[best] - gains[0]) > _LEAST_SHAPE_GAIN else 0]
    for shape in shapes:
        sigma[shape.rows] = np.sqrt(shape.variance(data.sizes[shape.along])) / data.rate[shape.rows]
    return shapes, sigma


def explains(fit: NoiseFit, shapes: Sequence[Shape]) -> bool:
    """True if the residuals are about as likely under the noise of the data as under one of their own."""
    now = sum(shape.log_likelihood for shape in shapes)
    given = likelihood(fit.power, fit.weight, fit.power_given)
    return 2 * (now - given) < _LEAST_SHAPE_GAIN * len(fit.data.channels)
