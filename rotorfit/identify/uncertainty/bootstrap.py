"""Parametric bootstrap: fits of data simulated from a fit, and the spread of what they find."""

from __future__ import annotations

import math
from collections.abc import Mapping
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Any

import numpy as np

from rotorfit.base.array_types import Bool, ComplexArray, Float
from rotorfit.base.digits import interval, significant, with_error
from rotorfit.base.equality import ByValue
from rotorfit.base.executors import carry_out
from rotorfit.base.names import unknown_name
from rotorfit.base.text_table import Table, Wide
from rotorfit.estimators.inference.caused_problem import CausedProblem
from rotorfit.estimators.minimisation.batch import batch_fit
from rotorfit.estimators.minimisation.least_squares import Options
from rotorfit.estimators.misfit.problem import Problem
from rotorfit.identify.fitting.fit_file import fit_from_json, fit_to_json
from rotorfit.identify.fitting.result import FitResult
from rotorfit.identify.uncertainty.derived import Derived, Draws, onsets_of
from rotorfit.identify.uncertainty.target import OF_ONE_MODEL, caused_problem

# Data without a minimum nearby are common where the noise is large; what runs away need not be followed far. At a bound
# Gauss-Newton may stall: the exact Hessian then finishes.
_OPTIONS = Options(max_iterations=50)


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Bootstrap(ByValue, Draws):
    """Estimates from simulated data.

    Attributes:
        fit: the fit that the data were simulated from.
        names: of the fitted entries.
        samples: their estimates, one row a simulation, failures left out, shape ``(N, p)``, SI units.
        failures: simulations whose fit did not converge.
        seed: of the random numbers.
        message: what is to be known of the samples.
        sizes: of causes beside the model, likewise, shape ``(N, k)``; None without any.
    """

    fit: FitResult
    names: tuple[str, ...]
    samples: Float
    failures: int
    seed: int
    message: str
    sizes: Float | None = None

    def parameter(self, name: str) -> Derived:
        """Estimates of one entry.

        Args:
            name: of a fitted parameter or nuisance entry, ``"lam"``.

        Raises:
            KeyError: no such entry; the message names the nearest.
            ValueError: the data do not determine it.
        """
        if name not in self.fit.params or name not in self.names:
            raise KeyError(unknown_name("fitted parameter", name, tuple(self.stderr)))
        if not self.fit.params[name].resolved:
            raise ValueError(f"{name} is not determined by these data: its estimates mean nothing")
        samples = self._reflected[:, self.names.index(name)]
        return Derived(name=name, unit=self.fit.params[name].unit, samples=samples)

    @property
    def _reflected(self) -> Float:
        """Vectors by whose simulation the fit would have been found; the estimates themselves without causes, whose
        simulated data all have the same truth."""
        return self.samples if self.sizes is None else 2 * self.fit.x - self.samples

    @property
    def stderr(self) -> dict[str, float]:
        """Standard deviation of the estimates by name, infinite for what the data do not determine.

        What runs differ by is no parameter and is left out.
        """
        known = self.fit.params
        spread = np.full(len(self.names), math.inf) if self._few else self.samples.std(axis=0, ddof=1)
        return {
            name: float(own) if known[name].resolved else math.inf
            for name, own in zip(self.names, spread, strict=True)
            if name in known
        }

    @property
    def _few(self) -> bool:
        """True if there are too few estimates for a spread."""
        return len(self.samples) < 2  # estimates that have a spread

    @property
    def covar(self) -> Float:
        """Covariance of the estimates, shape ``(p, p)``."""
        shape = len(self.names), len(self.names)
        return np.full(shape, math.nan) if self._few else np.asarray(np.cov(self.samples, rowvar=False)).reshape(shape)

    def interval(self, name: str, probability: float = 0.95) -> tuple[float, float]:
        """Interval from the central quantiles of the estimates; infinite for what the data do not determine.

        Args:
            name: of a fitted parameter or nuisance entry, ``"lam"``.
            probability: share of the distribution inside, between 0 and 1.
        """
        if self._few or (name in self.stderr and not self.fit.params[name].resolved):
            return -math.inf, math.inf
        return super().interval(name, probability)

    def threshold_speed(self, at: Mapping[str, Any] | None = None) -> Derived:
        """Threshold speed of every estimate, rad/s, see :class:`~rotorfit.identify.uncertainty.derived.Onsets`.

        Args:
            at: group of parameters, ``{"speed_rpm": 1000}``; needed where some were fitted per attribute.
        """
        space, group, solved = self.fit.problem.space, self.fit.group(at), self.fit.settings.solved
        theta = np.asarray(space.theta(self._reflected)[:, group])
        sizes = None if self.sizes is None or solved is None else 2 * solved.errors.value - self.sizes
        found = onsets_of(self.fit, theta, group, self.seed, sizes)
        return Derived(name="threshold speed", unit="rad/s", samples=found.speed, note=found.note)

    def parts(self) -> list[str | Table]:
        """What is printed: estimates, spreads and intervals beside the standard errors of the fit."""
        rows: list[list[str | Wide]] = [["parameter", "fit", "stderr", "bootstrap", "bias", "95 % interval", "unit"]]
        for name, spread in self.stderr.items():
            p = self.fit.params[name]
            if not p.resolved:
                rows.append([name, Wide("not determined by the data", 2)])
                continue
            low, high = self.interval(name)
            bias = math.nan if self._few else float(self.samples[:, self.names.index(name)].mean()) - p.value
            spreads = significant(spread, 2), significant(bias, 2)
            rows.append([name, *with_error(p.value, p.stderr), *spreads, interval(low, high), p.unit])
        head = f"parametric bootstrap: {len(self.samples)} simulated data sets, {self.failures} fits failed"
        return [head, Table(rows, "<22 >14 >12 >12 >12 >28 <1"), self.message]


def bootstrap(
    fit: FitResult, *, n: int = 500, seed: int = 0, accelerate: bool | None = None, executor: Executor | None = None
) -> Bootstrap:
    """Simulate data from the fitted model with the noise of the data, fit each, and look at the spread.

    The noise is that of the data, times sqrt(redchi) where the model limits the fit, as in ``stderr``. Nuisance entries
    with a prior, such as gains of a calibration, are drawn from it: every simulated test has errors of calibration of
    its own. Priors of parameters stay as they are and hold the estimates back. Causes beside the model are drawn
    from what is known of them before the data, none of one sign below zero, and solved with every fit by their columns
    at the joint optimum; what an estimate misses its own truth by, taken from the fit, is then where the truth may be.
    Beside spectra, whose likelihood is not that of normal readings, causes move the estimates by what the data leave of
    them.
    """
    if fit.method == "closed form":
        raise ValueError("a closed form cannot be bootstrapped by fits; use the result of rf.fit")
    if n < 2:
        raise ValueError(f"n is {n}; a spread needs at least two simulated data sets")
    rng = np.random.default_rng(seed)
    truth = np.tile(fit.x, (n, 1))  # nuisance entries with priors are drawn
    for prior in fit.problem.priors:
        if prior.entry >= len(fit.problem.space.names):
            truth[:, prior.entry] = prior.distribution.rvs(size=n, random_state=rng)
    readings = 4_000_000  # readings simulated and fitted in one go
    step = max(1, readings // (fit.ndata // 2))
    samples, good = [], []
    caused, solved = _beside_causes(fit), fit.settings.solved
    for begin in range(0, n, step):
        part = truth[begin : begin + step]
        if caused is None:
            x, found = _fitted(fit, _simulate(fit, part, rng), accelerate, executor)
            samples.append(fit.x + x - part)
        else:
            sizes = caused.causes.before(len(part), rng)
            taken = part - caused.taken_up(sizes)
            moved = caused.moved_by(_simulate(fit, taken, rng), sizes)
            y, found = _fitted(fit, moved, accelerate, executor)
            samples.append(caused.start + y - np.hstack([part, sizes]))
        good.append(found)
    converged = np.concatenate(good)
    estimates = np.concatenate(samples)[converged]
    acting = None if caused is None else estimates[:, fit.x.size :] * caused.causes.size
    if caused is None and solved is not None:
        acting = solved.errors.drawn(len(estimates), rng)
        estimates += (acting - solved.errors.value) @ solved.errors.moves.T
    times = f" times {significant(math.sqrt(fit.widening), 3)}" if fit.widening > 1 else ""
    message = f"noise of the data{times}"
    if fit.settings.force_spectrum:
        message += f"; spectrum of the force ({fit.settings.force_spectrum}) as the fit chose it"
    if not converged.all():
        message += f"; {n - converged.sum()} of {n} fits did not converge and are left out"
    if converged.sum() < 2:
        message += ", which leaves too few for a spread: the data do not hold these estimates fast"
    if fit.model_uncertainty is not None:
        message += f". {OF_ONE_MODEL}"
    return Bootstrap(
        fit=fit,
        names=fit.var_names,
        samples=estimates[:, : fit.x.size],
        failures=int(n - converged.sum()),
        seed=seed,
        message=message,
        sizes=acting,
    )


def _beside_causes(fit: FitResult) -> CausedProblem | None:
    """The problem beside causes where readings are normal."""
    return caused_problem(fit) if all(block.normal for block in fit.problem.blocks) else None


def _fitted(
    fit: FitResult, measured: ComplexArray, accelerate: bool | None, executor: Executor | None
) -> tuple[Float, Bool]:
    """Estimates from sets of readings, and which of them converged; beside causes from whitened changes of readings,
    with their sizes."""
    if executor is None and (caused := _beside_causes(fit)) is not None:
        return caused.minima(measured, _OPTIONS)
    if executor is None:
        result = batch_fit(fit.problem, measured, fit.x, accelerate=accelerate, options=_OPTIONS)
        return result.x, result.converged
    members_of_a_part = 32  # simulated tests sent to a worker at once. Chosen.
    parts = [measured[begin : begin + members_of_a_part] for begin in range(0, len(measured), members_of_a_part)]
    done = carry_out(partial(_fitted_elsewhere, fit_to_json(fit), accelerate), parts, executor)
    return np.concatenate([x for x, _ in done]), np.concatenate([converged for _, converged in done])


def _fitted_elsewhere(text: str, accelerate: bool | None, measured: ComplexArray) -> tuple[Float, Bool]:
    """The same on a worker, to which a fit goes as text."""
    return _fitted(_fit_of(text), measured, accelerate, None)


@lru_cache(maxsize=4)
def _fit_of(text: str) -> FitResult:
    """The fit, which a worker keeps from part to part."""
    return fit_from_json(text)


def _simulate(fit: FitResult, truth: Float, rng: np.random.Generator) -> ComplexArray:
    """Readings of each vector with noise, shape ``(n, R)``."""
    problem: Problem = fit.problem.with_noise(math.sqrt(fit.widening))
    same = bool((truth == truth[0]).all())
    exact = np.array([np.concatenate(problem.predict(x)) for x in (truth[:1] if same else truth)])
    shape = (len(truth), exact.shape[1])
    noise = rng.standard_normal(shape) + 1j * rng.standard_normal(shape)
    stop = 0
    for block in problem.blocks:
        start, stop = stop, stop + block.measured.size
        noise[:, start:stop] = block.weighed(exact[:, start:stop]).drawn(noise[:, start:stop])
    return np.asarray(exact + problem.sigma * noise)
