"""A test that was not made yet, as the problem that its fit will solve: errors to expect, and what stays open."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from rotorfit.base.array_types import Bool, ComplexArray, Float, Index
from rotorfit.base.digits import significant
from rotorfit.base.units import RPM_PER_RAD_S
from rotorfit.estimators.inference import covariance
from rotorfit.estimators.inference.causes import Cause, columns
from rotorfit.estimators.inference.identifiability import Identifiability, diagnose
from rotorfit.estimators.minimisation.batch import with_measured
from rotorfit.estimators.misfit.problem import Derivatives, Problem
from rotorfit.estimators.noise.residuals import scatter
from rotorfit.estimators.noise.run_effects import real_rows
from rotorfit.identify.fitting.causes.listing import listed
from rotorfit.identify.fitting.causes.solution import SolvedCauses, not_found_yet
from rotorfit.identify.fitting.noise.noise_fit import channels_of, lines_in
from rotorfit.identify.fitting.problem_setup import build_problem
from rotorfit.identify.fitting.settings import FitSettings
from rotorfit.lab.data.rows import Experiment
from rotorfit.lab.data.weights import dwells
from rotorfit.models import RotorModel, threshold_speed
from rotorfit.models.motion.stability import decay_rate
from rotorfit.studies.planning.guesses import Guess, Values, guess
from rotorfit.studies.planning.noise import PlannedNoise, with_differences
from rotorfit.studies.planning.targets import Target


@dataclass(frozen=True, eq=False, kw_only=True)
class Expectation:
    """The problem of a test that was not made yet, its readings those that the guessed rotor would give."""

    problem: Problem
    guess: Guess
    noise: PlannedNoise
    band: float  # modulus of eigenvalues that count, rad/s
    constant: Float  # noise of each reading that does not depend on it, shape ``(R,)``
    relative: Float  # noise of each reading over its size, shape ``(R,)``
    causes: tuple[Cause, ...]  # beside the model, that its fit will solve with the values

    @cached_property
    def solved(self) -> SolvedCauses | None:
        """The causes as the fit will have them if none of them shows."""
        return not_found_yet(self.problem, self.guess.centre, self.causes) if self.causes else None

    @property
    def told(self) -> Bool:
        """Causes that the test tells rather than leaves on trust, shape ``(k,)``."""
        half = 0.5  # share of what was open of a cause
        return np.zeros(0, dtype=bool) if self.solved is None else self.solved.errors.determined > half

    @property
    def line(self) -> Index:
        """Line of each reading, shape ``(R,)``."""
        return lines_in(self.problem)

    def longer(self, factor: Float) -> Expectation:
        """The same test with each reading averaged so many times as long, shape ``(R,)``."""
        root = 1 / np.sqrt(factor)
        return replace(
            self, problem=self.problem.with_noise(root), constant=self.constant * root, relative=self.relative * root
        )

    def errors(self) -> tuple[Float, Identifiability]:
        """Covariance of the estimate at the guess, shape ``(p, p)``, and what the test leaves open."""
        problem, x = self.problem, self.guess.centre
        derivatives = Derivatives(problem, x)
        root, _ = covariance.information(problem, x, derivatives.residuals, derivatives)
        space = problem.space
        names, base = (*space.names, *space.nuisance), (*space.base, *space.nuisance)
        covar, verdict = diagnose(space.model, names, base, x, root, covariance.parameter_scales(problem, x))
        return covar + covar @ self._scatter(derivatives.whole) @ covar, verdict

    def _scatter(self, jacobian: ComplexArray) -> Float:
        """Addition to the scatter of the cost's gradient by errors that readings have in common, shape ``(p, p)``."""
        added = np.zeros((jacobian.shape[1], jacobian.shape[1]))
        if lags := self.noise.lags():
            sweeps = [sweep for sweeps in channels_of(self.problem) for sweep in sweeps]
            added += scatter(jacobian, sweeps, lags)
        if self.noise.common:
            sigma = self.problem.sigma
            predicted = np.concatenate(self.problem.predict(self.guess.centre))
            own = jacobian.conj() * (self.noise.common * _of_motion(self.problem) * predicted / sigma)[:, None]
            line = self.line
            together = np.zeros((int(line.max()) + 1, own.shape[1]), dtype=complex)
            np.add.at(together, line, own)
            for part, sign in ((together, 1.0), (own, -1.0)):
                added += sign * (part.T @ part.conj()).real
        return added

    def rows(self, draws: Float) -> Float:
        """Derivatives of whitened readings at vectors ``(D, p)``, real and imaginary parts, shape ``(D, 2 R, p)``.
        Those at which the rotor is unstable at the speed of a response are zero: such a line gives nothing."""
        return np.array([real_rows(self.problem.jacobian(x)[1] * self._weight(x)).T for x in draws])

    def columns(self, draws: Float) -> Float:
        """The same derivatives by one size of each cause, shape ``(D, 2 R, k)``."""
        size = np.array([cause.size for cause in self.causes])
        return np.array([real_rows(columns(self.problem, x, self.causes) * size * self._weight(x)).T for x in draws])

    def slopes(self, target: Target, x: Float) -> Float:
        """Derivatives of a quantity by the fitted vector and by one size of each cause, shape ``(p + k,)``."""
        own, solved = target.at(x)[1], self.solved
        return own if solved is None else np.append(own, target.by_causes(x, solved) * solved.errors.size)

    def _weight(self, x: Float) -> Float:
        """Noise at the guess over that at a vector, zero where the rotor is unstable, shape ``(R, 1)``."""
        own = np.hypot(self.constant, self.relative * np.abs(np.concatenate(self.problem.predict(x))))
        return np.asarray(self.problem.sigma / own * self.steady(x))[:, None]

    def steady(self, x: Float) -> Float:
        """One for readings whose rotor is stable, zero for others, shape ``(R,)``."""
        steady = np.ones(self.constant.size)
        for readings, _, _ in _unstable(self.problem, x, self.band):
            steady[readings] = 0.0
        return steady


def expect(
    model: RotorModel,
    tests: Sequence[Experiment],
    settings: FitSettings,
    values: Values,
    noise: PlannedNoise,
    draws: int,
    seed: int,
    band: float,
    before: Mapping[str, float] | None = None,
) -> Expectation:
    """The problem of tests that were not made yet. ``before``: sizes of causes that an earlier fit had, of whatever
    tests."""
    planned = [_unread(test, noise.of_rows(test)) for test in tests]
    problem = build_problem(model, planned, settings)
    vectors = guess(problem.space, values, draws, seed)
    problem = replace(problem, blocks=tuple(block.from_rest() for block in problem.blocks))
    for _, theta, speed in _unstable(problem, vectors.centre, band):
        refuse_speed(model, theta, speed, band)
    predicted = problem.predict(vectors.centre)
    unit = build_problem(model, [_unread(test, np.ones(len(test))) for test in tests], settings)
    constant = problem.sigma
    pairs = unit.sigma  # below one where two probes share a reading
    shares = [np.full(b.measured.size, noise.share_of(t)) for b, t in zip(problem.blocks, tests, strict=True)]
    relative = np.hypot(pairs * np.concatenate(shares), noise.common) * _of_motion(problem)
    sizes = np.abs(np.concatenate(predicted))
    problem = problem.with_noise(np.hypot(constant, relative * sizes) / constant)
    problem = with_measured(problem, np.concatenate(predicted))
    problem, centre = with_differences(problem, vectors.centre, noise.runs)
    wider = np.zeros((len(vectors.draws), centre.size))
    wider[:, : vectors.centre.size] = vectors.draws
    causes: tuple[Cause, ...] = ()
    if settings.causes is not None:
        given = {**settings.sizes, **(before or {})}
        causes = listed(problem, centre, given, settings.calibration, of_another=before is not None)
    return Expectation(
        problem=problem,
        guess=Guess(centre=centre, draws=wider),
        noise=noise,
        band=band,
        constant=constant,
        relative=relative,
        causes=causes,
    )


def _of_motion(problem: Problem) -> Float:
    """One for readings of motion or force, whose noise may grow with them, zero for eigenvalues and coefficients."""
    return np.concatenate([np.full(block.measured.size, float(block.of_motion)) for block in problem.blocks])


def _unread(test: Experiment, sigma: Float) -> Experiment:
    """A planned test, refused where it would be solved for influences."""
    if test.synchronous and dwells(test):
        raise ValueError(
            f"{test.source or 'the test'}: weights at dwell speeds are solved for influences, whose errors "
            "come from repeats; plan start-ups, or responses at other frequencies than 1x"
        )
    return test.unread(sigma)


def _unstable(problem: Problem, x: Float, band: float) -> Iterator[tuple[Index, Float, float]]:
    """Readings at a speed at which the rotor whirls by itself, its parameters and the speed."""
    theta, readings = problem.space.theta(x), problem.by_block(np.arange(problem.sigma.size))
    for block, places in zip(problem.blocks, readings, strict=True):
        base = block.responses
        if base is not None and not base.imposed:
            _, group, speed = base.condition
            for number in np.flatnonzero(decay_rate(base.model, theta[group], speed, band) < 0).tolist():
                yield places[base.condition_readings[number]], theta[group[number]], float(speed[number])


def refuse_speed(model: RotorModel, theta: Float, speed: float, band: float) -> None:
    """Refuse a speed at which the guessed rotor whirls by itself."""
    onset = threshold_speed(model, theta, band=band)
    at = f"{significant(speed * RPM_PER_RAD_S, 5)} rpm"
    words = f"the guessed rotor is unstable at {at} and has no steady response there"
    if onset:
        words += f"; speeds are allowed below the threshold of {significant(onset.speed * RPM_PER_RAD_S, 5)} rpm"
    raise ValueError(words)
