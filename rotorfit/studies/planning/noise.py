"""Noise that the readings of a planned test will have."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from numbers import Real
from typing import TypeAlias

import numpy as np

from rotorfit.base.array_types import Bool, Float
from rotorfit.base.names import unknown_name
from rotorfit.estimators.misfit.problem import Problem
from rotorfit.identify.fitting.noise.error_bars import with_noise
from rotorfit.identify.fitting.noise.noise_fit import effects_of_runs
from rotorfit.identify.fitting.noise.record import RUN_KINDS, FoundNoise, NoiseVerdict, RunEffect
from rotorfit.identify.fitting.problem_setup import build_problem
from rotorfit.identify.fitting.result import FitResult
from rotorfit.lab.data.experiments import PerturbationTest
from rotorfit.lab.data.rows import Experiment

_RUN_SHARES = {kind.removeprefix("run_"): kind for kind in RUN_KINDS}


Place: TypeAlias = tuple[str, str, bool]
"""Run, plane, and whether a slope is read there."""


@dataclass(frozen=True, kw_only=True)
class NoiseOfFit:
    """Noise of readings that an earlier fit found, ``sigma^2 = constant^2 + (share |reading|)^2``."""

    constant: Mapping[Place, float]  # by response
    share: float
    memory: tuple[float, ...]  # correlations of neighbouring lines
    runs: Mapping[str, float]  # differences of runs

    @classmethod
    def of(cls, fit: FitResult) -> NoiseOfFit:
        """That of its readings as they were made, x and y apart."""
        tests = [_with_unit_noise(test) for test in fit.experiments]
        alone = build_problem(fit.model, tests, replace(fit.settings, noise=None, noise_scale={}))
        places: list[Place] = []
        parts = []
        for block, one, test in zip(fit.problem.blocks, alone.blocks, tests, strict=True):
            base, unit = block.responses, one.responses
            if base is None or unit is None or test.perturbation is None:
                continue
            at = [base.model.coordinates[k] for k in base.coordinate.tolist()]
            places += [(run, c.plane, c.axis == "r") for run, c in zip(base.run.tolist(), at, strict=True)]
            parts.append([(base.sigma / unit.sigma) ** 2 * fit.widening, np.abs(base.measured) ** 2])
        constant, share = _constant_and_share(places, *np.hstack(parts)) if parts else ({}, 0.0)
        study = fit.noise
        return cls(
            constant=constant,
            share=share,
            memory=study.lags if study is not None and study.verdict is NoiseVerdict.CORRELATED else (),
            runs={
                effect.kind.removeprefix("run_"): effect.sd
                for effect in (() if study is None else study.effects)
                if effect.kind in RUN_KINDS
            },
        )

    def of_rows(self, test: PerturbationTest) -> Float:
        """What of it does not grow with the readings, for the rows of a test: that of the same response, else the
        median of those of its plane; NaN at planes that were not read."""
        found = []
        for run, plane, direction in zip(test.run.tolist(), test.plane.tolist(), test.direction.tolist(), strict=True):
            tilt = direction.startswith("r")
            alike = [size for (_, *where), size in self.constant.items() if where == [plane, tilt]]
            found.append(self.constant.get((run, plane, tilt), float(np.median(alike)) if alike else math.nan))
        return np.array(found)


def _with_unit_noise(test: Experiment) -> Experiment:
    return test.corrected(lambda responses: replace(responses, sigma=np.ones(len(responses))))


def _constant_and_share(places: Sequence[Place], square: Float, size: Float) -> tuple[dict[Place, float], float]:
    """Constant noise of each response, and the share of the readings in all, by their variances and squares."""
    from scipy.optimize import nnls  # late: loading it takes longer than a plan

    names = list(dict.fromkeys(places))
    number = np.array([names.index(place) for place in places])
    columns = np.hstack([np.eye(len(names))[number], size[:, None]]) / square[:, None]
    # Each part in its own measure, lest one look like nothing beside the other.
    scale = np.abs(columns).max(axis=0)
    found = np.sqrt(nnls(columns / scale, np.ones(square.size))[0] / scale)
    least = 1e-30  # noise, m, where all of it is a share of the readings
    return {name: max(float(one), least) for name, one in zip(names, found, strict=False)}, float(found[-1])


@dataclass(frozen=True, kw_only=True)
class PlannedNoise:
    """Standard deviations of the real and of the imaginary part of readings."""

    additive: float | Mapping[str, float] | None = None  # um (urad for slopes), of all probes or by plane
    share: float = 0.0  # of each reading, by itself
    common: float = 0.0  # share of the readings, the same for all probes of a line: jitter of force or speed
    # correlation of the readings of neighbouring lines, falling as its powers, or those at distances of 1, 2, ... lines
    memory: float | Sequence[float] = 0.0
    runs: Mapping[str, float] = field(default_factory=dict)  # relative differences of runs (rad for phase), by kind
    found: NoiseOfFit | None = None  # by an earlier fit, for responses of which nothing else is said

    def __post_init__(self) -> None:
        memory = self.memory if isinstance(self.memory, Sequence) else (self.memory,)
        shares = [("noise_share", self.share), ("common_share", self.common), *(("memory", one) for one in memory)]
        for name, value in shares:
            if not (isinstance(value, Real) and 0 <= float(value) < 1):
                raise ValueError(f"{name} is {value!r}; it is a share, from 0 to below 1")
        given = self.additive.values() if isinstance(self.additive, Mapping) else (self.additive,)
        for size in given:
            if size is not None and not (isinstance(size, Real) and 0 < float(size) < np.inf):
                raise ValueError(f"noise_um is {size!r}; it is a positive number of micrometres, or one by plane")
        for kind, sd in self.runs.items():
            if kind not in _RUN_SHARES:
                raise ValueError(unknown_name("difference of runs", kind, _RUN_SHARES))
            if not (isinstance(sd, Real) and 0 < float(sd) < 1):
                raise ValueError(f"runs: {kind} is {sd!r}; a standard deviation between 0 and 1 is needed")

    def of_rows(self, test: Experiment) -> Float:
        """Noise of the rows of a test that does not depend on its readings, in their unit; what it says, else NaN."""
        if test.tells_noise:
            return np.full(len(test), np.nan)
        given = np.array(getattr(test, "sigma", np.full(len(test), np.nan)), dtype=float)
        if self.found is not None and (responses := test.perturbation) is not None:
            given = np.where(self.is_found(test), self.found.of_rows(responses), given)
        if test.reads == "motion" and self.additive is not None:
            planes = test.plane_of_rows.tolist()
            sizes = self.additive if isinstance(self.additive, Mapping) else dict.fromkeys(planes, self.additive)
            for plane in dict.fromkeys(planes):
                if plane not in sizes:
                    raise ValueError(f"noise_um has no value for {plane}; it has {', '.join(sizes)}")
            return np.array([float(sizes[plane]) * 1e-6 for plane in planes])
        if np.isfinite(given).all():
            return given
        if test.reads and (self.share or self.common):
            no_noise = 1e-30  # noise of readings, m, whose noise is a share of the response alone: far below it
            return np.where(np.isfinite(given), given, no_noise)
        way_out = "noise_um= or noise_share=" if test.reads == "motion" else "its sigma"
        raise ValueError(f"{test.source or test.title}: the noise of its readings is not known; give {way_out}")

    def is_found(self, test: Experiment) -> Bool:
        """Rows of a test whose noise is that of the earlier fit: of its responses, and where the test says none."""
        responses = test.perturbation
        if self.found is None or responses is None:
            return np.zeros(len(test), dtype=bool)
        names = [(run, plane) for run, plane, _ in self.found.constant]
        read = [pair in names for pair in zip(responses.run.tolist(), responses.plane.tolist(), strict=True)]
        return np.array(read) | np.isnan(responses.sigma)

    def share_of(self, test: Experiment) -> float:
        """Noise of each reading of a test over its size."""
        found = self.found.share if self.found is not None and self.is_found(test).all() else 0.0
        return math.hypot(self.share, found)

    def lags(self) -> tuple[float, ...]:
        """Correlations along a sweep at distances of 1, 2, ... lines, as long as they count."""
        if isinstance(self.memory, Sequence):
            return tuple(self.memory)
        counted = 0.01  # least correlation that counts: each adds itself to a variance, twice
        found = [self.memory]
        while found[-1] * self.memory > counted:
            found.append(found[-1] * self.memory)
        return tuple(found) if self.memory else ()


def with_differences(problem: Problem, x: Float, runs: Mapping[str, float]) -> tuple[Problem, Float]:
    """The problem and a vector of it with differences of runs as entries that have priors, as fits have them."""
    if not runs:
        return problem, x
    if any(block.responses is None for block in problem.blocks):
        raise ValueError("runs= is for responses to forces; give the sigma of eigenvalues and the like as it is")
    names = tuple(dict.fromkeys(problem.run.tolist()))
    predicted, jacobian = np.concatenate(problem.predict(x)), problem.jacobian(x)[1]
    sigma = problem.sigma
    columns = effects_of_runs(problem, x, predicted / sigma, jacobian)
    effects = []
    for kind, sd in runs.items():
        if _RUN_SHARES[kind] not in columns:
            allowed = (name for name, column in _RUN_SHARES.items() if column in columns)
            raise ValueError(unknown_name(f"difference of runs of {problem.space.model.name}", kind, allowed))
        sensitivity = columns[_RUN_SHARES[kind]] * sigma / predicted
        parts = tuple(problem.by_block(sensitivity))
        column = _RUN_SHARES[kind]
        effects.append(RunEffect(kind=column, sd=float(sd), freedom=np.inf, runs=names, sensitivities=parts))
    same = tuple(problem.by_block(np.ones(sigma.size)))
    wider = with_noise(problem, FoundNoise(factors=same, effects=tuple(effects), before=x))
    return wider, np.concatenate([x, np.zeros(wider.space.size - x.size)])
