"""Virtual rigs: a model with its true parameters, probes with noise, and one whose motion is recorded.

The motion of a linear rotor under any force in time is found mode by mode, exact to round-off at a constant speed.
``x' = A x + B f`` falls apart into modes ``q' = s q + b f``; over a step of h the solution is
``q(t + h) = exp(s h) q(t) + int exp(s (h - u)) b f(t + u) du``, the integral by Gauss-Legendre quadrature with four
points, whose error for a force of frequency w is of the order ``(w h)^8 / 10^7``. Where the speed changes and the rotor
with it, the coefficients are those of the middle of a block, which is the shorter the faster the speed changes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rotorfit.base.array_types import ComplexArray, Float
from rotorfit.base.digits import significant
from rotorfit.base.units import RPM_PER_RAD_S
from rotorfit.lab.simulation.instruments import Instruments, Played
from rotorfit.lab.simulation.integration import IntegrationError, Motion
from rotorfit.lab.simulation.turbulence import Turbulence
from rotorfit.lab.simulation.turning_speeds import Rotation, Wander
from rotorfit.models import RotorModel, threshold_speed
from rotorfit.models.motion.journal import journal, journals
from rotorfit.models.motion.off_centre import off_centre_eigenvalues, static_equilibria
from rotorfit.models.motion.stability import growth_rate, roots
from rotorfit.models.motion.time_steps import RowsInTime, TimeSteps
from rotorfit.models.shafts.angular_rates import angular_rates, real_numbers


@dataclass(frozen=True, eq=False, kw_only=True)
class VirtualRig:
    """The rig of a simulated test: rotor and instruments."""

    model: RotorModel  # the rotor
    theta: Float  # its true parameters, shape ``(P,)``
    noise: float  # standard deviation of the noise of a reading, as a fraction of the rms reading in its run
    tolerance: float  # of the integration in time
    rng: np.random.Generator  # source of the noise
    exact: bool = False  # whether steady motion is that of the phasor equations, not integrated in time

    def __post_init__(self) -> None:
        self.motion(np.zeros(1))  # refuses equations that do not determine a motion in time

    @property
    def seat(self) -> int:
        """Coordinate that constant loads act on by default: the first journal, or the last plane."""
        return journals(self.model)[0].at if self.model.eccentricity_dependent else len(self.model.planes) - 1

    def motion(self, speed: Float, imposed: int | None = None) -> Motion:
        """Equations of motion of as many rotors as speeds."""
        return Motion(model=self.model, theta=np.tile(self.theta, (speed.size, 1)), speed=speed, imposed=imposed)

    def decay(self, speed: float, load: ComplexArray | None = None) -> float:
        """Rate at which the slowest transient about the resting rotor dies out, 1/s."""
        where = f"at {significant(speed * RPM_PER_RAD_S, 4)} rpm"
        if load is None or not load.any() or not self.model.eccentricity_dependent:
            rate = float(growth_rate(self.model, self.theta, speed))
        else:
            seat, newton = journal(self.model), f"{significant(np.abs(load).max(), 4)} N"
            rest = static_equilibria(self.model, self.theta, speed, load)[0][seat.at]
            eccentricity = float(np.abs(rest)) / seat.clearance
            if eccentricity >= 1 - 1e-6:
                raise ValueError(f"a load of {newton} presses the journal against the wall; reduce it")
            rate = float(off_centre_eigenvalues(self.model, self.theta, speed, eccentricity).real.max())
            where += f" under a load of {newton}"
        if rate >= 0:
            onset = threshold_speed(self.model, self.theta)
            limit = f"; centred it is stable below {significant(onset.speed * RPM_PER_RAD_S, 4)} rpm" if onset else ""
            raise ValueError(
                f"{self.model.name} with these parameters is unstable {where} (vibration grows at "
                f"{significant(rate, 3)} 1/s), so that nothing can be measured there{limit}"
            )
        return -rate

    def load(self, newton: complex, plane: str | None) -> ComplexArray:
        """Vector of a constant load, N, shape ``(n,)``."""
        self.need_circular("constant loads")
        vector = np.zeros(len(self.model.coordinates), dtype=complex)
        vector[self.seat if plane is None else self.model.coordinate(plane, "z")] = newton
        return vector

    def need_circular(self, what: str) -> None:
        """Refuse a model that keeps x and y apart."""
        if self.model.frame != "z":
            raise ValueError(f"{self.model.name} keeps x and y apart; {what} are simulated in complex coordinates only")

    def sigma(self, exact: NDArray[Any], groups: NDArray[Any]) -> Float:
        """Standard deviation of the noise of each reading: the same for all of a group."""
        number = np.unique(groups, axis=0, return_inverse=True)[1].reshape(-1)
        power = np.bincount(number, np.abs(exact) ** 2) / np.bincount(number)
        return np.asarray(self.noise * np.sqrt(power)[number])

    def noisy(self, exact: ComplexArray, sigma: Float) -> ComplexArray:
        """Phasors with independent noise of equal size in real and imaginary part."""
        return np.asarray(exact + sigma * (self.rng.normal(size=exact.size) + 1j * self.rng.normal(size=exact.size)))

    def sigma_given(self, sigma: Float) -> Float:
        """The noise as it is given with the data: unknown where there is none."""
        return np.where(sigma > 0, sigma, np.nan)


def positive(name: str, values: ArrayLike) -> Float:
    """Values as an array, all positive."""
    array = np.atleast_1d(real_numbers(values, name, "positive numbers"))
    if not array.size or not (np.isfinite(array) & (array > 0)).all():
        raise ValueError(f"{name} must be positive numbers, got {values!r}")
    return array


def rates_rpm(name: str, values: ArrayLike) -> Float:
    """Rotative speeds or frequencies as an array, signed, rpm."""
    return np.atleast_1d(angular_rates(values, name, "rpm"))


def some_planes(model: RotorModel, planes: str | Sequence[str] | None) -> tuple[str, ...]:
    """Planes by name, all by default."""
    chosen = model.planes if planes is None else (planes,) if isinstance(planes, str) else tuple(planes)
    unknown = [plane for plane in chosen if plane not in model.planes]
    if unknown or not chosen:
        raise ValueError(f"planes {', '.join(unknown) or '()'} unknown; {model.name} has {', '.join(model.planes)}")
    return chosen


Force = Callable[[Float], ComplexArray]


@dataclass(frozen=True, eq=False, kw_only=True)
class RecordedRig(VirtualRig):
    """A rotor with its instruments."""

    noise: float = 0.0  # of readings; that of volts is the instruments'
    tolerance: float = 1e-6
    instruments: Instruments  # what measures it
    residual: float  # unbalance of the rotor itself, kg m
    turbulence: Turbulence | None = None  # force of the flow in every run

    def run(
        self,
        name: str,
        shaft: Rotation,
        acting: Mapping[str, Force],
        time: Float,
        attributes: Mapping[str, str | float],
        **more: Any,
    ) -> Played:
        """A run under forces ``Fx + j Fy`` at some planes while the shaft turns."""
        model, theta = self.model, self.theta
        integrated = nonlinear_path if model.eccentricity_dependent else linear_path
        rate = self.instruments.sample_rate
        flow = self.turbulence and self.turbulence.force(model.planes, time.size, rate, self.rng)

        def generalised(t: Float) -> ComplexArray:
            found = np.zeros((t.size, len(model.coordinates)), dtype=complex)
            forces = [(plane, force(t)) for plane, force in acting.items()]
            for plane, f in [*forces, *(zip(model.planes, flow(t).T, strict=True) if flow else ())]:
                if model.frame == "z":
                    found[:, model.coordinate(plane, "z")] += f
                else:
                    found[:, model.coordinate(plane, "x")] += f.real
                    found[:, model.coordinate(plane, "y")] += f.imag
            return found

        path = integrated(model, theta, speed=shaft.speed, force=generalised, rate=rate, count=time.size)
        path = path * model.functions.factors(theta)
        axes = {(c.plane, c.axis): path[:, i] for i, c in enumerate(model.coordinates)}
        if model.frame == "z":
            motion = {plane: z for (plane, axis), z in axes.items() if axis == "z"}
        else:
            motion = {plane: axes[plane, "x"].real + 1j * axes[plane, "y"].real for plane in model.planes}
        return Played(name=name, motion=motion, shaft=shaft.angle(time), attributes=attributes, **more)

    def settling(self, speed: float) -> float:
        """Time after which the rotor has forgotten how it started, s; one with a law may whirl."""
        if not self.model.eccentricity_dependent:
            self.decay(speed)
        rate = abs(float(growth_rate(self.model, self.theta, speed)))
        return min(12 / rate, 60.0)  # exp(-12) is less than the noise of probes

    def shaft(self, speed: float) -> Wander:
        """The shaft's rotation at a speed, rad/s, that wanders as the instruments say."""
        return Wander.drawn(speed, self.instruments.wander, self.rng)


_POINTS, _WEIGHTS = np.polynomial.legendre.leggauss(4)


def linear_path(
    model: RotorModel,
    theta: Float,
    *,
    speed: Callable[[Float], Float],
    force: Callable[[Float], ComplexArray],
    rate: float,
    count: int,
) -> ComplexArray:
    """Displacements of all coordinates at equally spaced times, starting from rest, shape ``(count, n)``."""
    from scipy.signal import lfilter

    h, n = 1 / rate, len(model.coordinates)
    inside = (_POINTS + 1) * h / 2
    speeds = speed(np.arange(count, dtype=float) * h)
    change = np.abs(np.diff(speeds)).max(initial=0.0) if model.speed_dependent else 0.0
    speed_change = 1e-4  # share by which it may change within a block, whose coefficients are those of its middle
    block = int(np.clip(speed_change * np.abs(speeds).max() / change, 64, 1 << 15)) if change else 1 << 15
    path = np.zeros((count, n), dtype=complex)
    state = np.zeros(2 * n, dtype=complex)
    for first in range(0, count - 1, block):
        last = min(first + block, count - 1)
        start = np.arange(first, last, dtype=float) * h
        s, shapes, drive = _modes(model, theta, float(speed(np.array([(first + last) / 2 * h]))[0]))
        forces = force((start[:, None] + inside).ravel()).reshape(start.size, 4, n) @ drive.T
        kernel = np.exp(s * (h - inside[:, None])) * (_WEIGHTS * h / 2)[:, None]
        steps = np.einsum("tkm,km->tm", forces, kernel)
        q = np.linalg.solve(shapes, state)
        motion = np.empty((start.size, s.size), dtype=complex)
        for m, growth in enumerate(np.exp(s * h)):
            motion[:, m] = lfilter([1.0], [1.0, -growth], steps[:, m], zi=[growth * q[m]])[0]
        states = motion @ shapes.T
        path[first + 1 : last + 1] = states[:, :n]
        state = states[-1]
    return path


def _modes(model: RotorModel, theta: Float, speed: float) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
    """Eigenvalues, right eigenvectors of displacements and velocities, and what a force gives each mode."""
    coefficients = model.coefficients(theta, speed)
    stiffness, damping, mass = RowsInTime(coefficients).of(coefficients)
    n = mass.shape[0]
    companion = np.zeros((2 * n, 2 * n), dtype=complex)
    companion[:n, n:] = np.eye(n)
    companion[n:] = -np.linalg.solve(mass, np.hstack([stiffness, damping]))
    s, shapes = np.linalg.eig(companion)
    drive = np.linalg.solve(shapes, np.vstack([np.zeros((n, n)), np.linalg.inv(mass)]))
    return s, shapes, drive


def nonlinear_path(
    model: RotorModel,
    theta: Float,
    *,
    speed: Callable[[Float], Float],
    force: Callable[[Float], ComplexArray],
    rate: float,
    count: int,
) -> ComplexArray:
    """Displacements of all coordinates at equally spaced times, starting from rest, shape ``(count, n)``.

    The fluid is that at the speed and at the eccentricity of the moment, so that the path goes on beyond the onset of
    instability, on the whirl that the law limits. Steps become finer until they are fine enough at the eccentricity
    that was reached.
    """
    seat, ends = journal(model), speed(np.array([0.0, (count - 1) / rate]))
    steps, enough = 0, _steps(model, theta, ends, 0.0, rate)
    path = np.zeros((0, len(model.coordinates)), dtype=complex)
    while steps < enough:
        steps = enough
        path = _path(model, theta, speed=speed, force=force, rate=rate, count=count, steps=steps)
        reached = np.abs(path[:, seat.at]).max() / seat.clearance if path.shape[0] == count else 1.0
        enough = _steps(model, theta, ends, min(float(reached), 0.99), rate)  # beside the wall nothing is fine enough
    if path.shape[0] < count:
        where = f"{model.name}: the journal touches the wall after {significant(path.shape[0] / rate, 3)} s"
        raise IntegrationError(f"{where}; take a smaller force or a lower speed")
    return path


def _steps(model: RotorModel, theta: Float, speeds: Float, eccentricity: float, rate: float) -> int:
    """Steps a sample in which the fastest motion up to an eccentricity, that of eigenvalue s, errs by
    ``(s h)^4 / 120``, a millionth of itself."""
    orbits = np.linspace(0.0, eccentricity, 20)[:, None]
    fastest = float(np.nanmax(np.abs(roots(model.functions.values(theta, speeds, orbits)))))
    return math.ceil(fastest / (0.1 * rate))


def _path(
    model: RotorModel,
    theta: Float,
    *,
    speed: Callable[[Float], Float],
    force: Callable[[Float], ComplexArray],
    rate: float,
    count: int,
    steps: int,
) -> ComplexArray:
    """The path by so many steps a sample, up to where it leaves the clearance."""
    samples, seat = -(-4096 // steps), journal(model)  # in a block
    walk = TimeSteps(model, theta, 1 / (rate * steps), samples * steps)
    state = np.zeros((2, len(model.coordinates)), dtype=complex)
    parts = [state[:1]]
    for first in range(0, count - 1, samples):
        t = first / rate + np.arange(2 * samples * steps + 1) / (2 * rate * steps)
        states = walk.path(state, speed(t), force(t))
        inside = np.abs(states[:, 0, seat.at]) < seat.clearance  # False of what is not a number
        kept = samples if inside.all() else int(inside.argmin()) // steps
        parts.append(states[steps - 1 :: steps, 0][:kept])
        state = states[-1]
        if kept < samples:
            break
    return np.concatenate(parts)[:count]
