"""A virtual rig: a model with its true parameters, probes with noise, and checks that it can be run at all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rotorfit.models import RotorModel, threshold_speed
from rotorfit.models.array_types import ComplexArray, Float
from rotorfit.models.digits import significant
from rotorfit.models.motion.journal import journal
from rotorfit.models.motion.off_centre import off_centre_eigenvalues, static_equilibria
from rotorfit.models.motion.stability import growth_rate
from rotorfit.models.shafts.angular_rates import angular_rates, real_numbers
from rotorfit.simulation.integration import Motion
from rotorfit.units import RPM_PER_RAD_S


@dataclass(frozen=True, eq=False, kw_only=True)
class VirtualRig:
    """The rig of a simulated test: rotor and instruments."""

    model: RotorModel  # the rotor
    theta: Float  # its true parameters, shape ``(P,)``
    noise: float  # standard deviation of the noise of a reading, as a fraction of the rms reading in its run
    tolerance: float  # of the integration in time
    rng: np.random.Generator  # source of the noise

    def __post_init__(self) -> None:
        self.motion(np.zeros(1))  # refuses equations that do not determine a motion in time

    @property
    def seat(self) -> int:
        """Coordinate that constant loads act on by default: the journal, or the last plane."""
        return journal(self.model).at if self.model.eccentricity_dependent else len(self.model.planes) - 1

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
