"""Noise that the readings of a planned test will have."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from numbers import Real

import numpy as np

from rotorfit.base.array_types import Float
from rotorfit.base.names import unknown_name
from rotorfit.estimators.blocks.nonlinear import responses_of
from rotorfit.estimators.misfit.problem import Problem
from rotorfit.identify.fitting.noise.error_bars import with_noise
from rotorfit.identify.fitting.noise.noise_fit import effects_of_runs
from rotorfit.identify.fitting.noise.record import RUN_KINDS, FoundNoise, RunEffect
from rotorfit.lab.data.experiments import DisplacementTest, Experiment, PerturbationTest, RingDownTest, StaticTest

_RUN_SHARES = {kind.removeprefix("run_"): kind for kind in RUN_KINDS}


@dataclass(frozen=True, kw_only=True)
class PlannedNoise:
    """Standard deviations of the real and of the imaginary part of readings."""

    additive: float | Mapping[str, float] | None = None  # um (urad for slopes), of all probes or by plane
    share: float = 0.0  # of each reading, by itself
    common: float = 0.0  # share of the readings, the same for all probes of a line: jitter of force or speed
    # correlation of the readings of neighbouring lines, falling as its powers, or those at distances of 1, 2, ... lines
    memory: float | Sequence[float] = 0.0
    runs: Mapping[str, float] = field(default_factory=dict)  # relative differences of runs (rad for phase), by kind

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
        if isinstance(test, RingDownTest):
            return np.full(len(test), np.nan)  # its records tell
        given = np.array(getattr(test, "sigma", np.full(len(test), np.nan)), dtype=float)
        if isinstance(test, PerturbationTest | StaticTest) and self.additive is not None:
            planes = test.plane.tolist()
            sizes = self.additive if isinstance(self.additive, Mapping) else dict.fromkeys(planes, self.additive)
            for plane in dict.fromkeys(planes):
                if plane not in sizes:
                    raise ValueError(f"noise_um has no value for {plane}; it has {', '.join(sizes)}")
            return np.array([float(sizes[plane]) * 1e-6 for plane in planes])
        if np.isfinite(given).all():
            return given
        if isinstance(test, PerturbationTest | StaticTest | DisplacementTest) and (self.share or self.common):
            no_noise = 1e-30  # noise of readings, m, whose noise is a share of the response alone: far below it
            return np.where(np.isfinite(given), given, no_noise)
        way_out = "noise_um= or noise_share=" if isinstance(test, PerturbationTest | StaticTest) else "its sigma"
        raise ValueError(f"{test.source or test.title}: the noise of its readings is not known; give {way_out}")

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
    if any(responses_of(block) is None for block in problem.blocks):
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
