"""Integration of the nonlinear equation of motion in time, many rotors or many forces at once.

``C0(eps) z + C1(eps) z' + C2(eps) z'' = F(t)`` with ``eps = |z_b(t)| / clearance`` at every instant. Nothing here
assumes circular or small motion: what the phasor equations say of these is checked against it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from rotorfit.models import RotorModel
from rotorfit.models.array_types import ComplexArray, Float, Index
from rotorfit.models.digits import significant
from rotorfit.models.motion.journal import Journal, journal

Force = Callable[[float], ComplexArray]

STEP_TOLERANCE = 1e-9
"""Error allowed in one step of the integration, as a fraction of the motion."""


class IntegrationError(RuntimeError):
    """The motion could not be followed, or has no steady state to settle in."""


class Path(NamedTuple):
    """Motion in time: instants ``(T,)``, displacements and velocities ``(T, L, n)``."""

    time: Float  # s, shape ``(T,)``
    z: ComplexArray  # displacements, m, shape ``(T, L, n)``
    v: ComplexArray  # velocities, m/s, likewise


@dataclass(frozen=True, eq=False, kw_only=True)
class Motion:
    """The equation of motion of L rotors, each in n coordinates."""

    model: RotorModel  # the rotor
    theta: Float  # parameter vectors, shape ``(L, P)``
    speed: Float  # rotative speed, rad/s, shape ``(L,)``
    imposed: int | None = None  # coordinate whose acceleration is given, in the place of the force on it

    def __post_init__(self) -> None:
        if self.model.order != 2:
            raise ValueError(
                f"{self.model.name} has an equation of motion of order {self.model.order}; one of order 2 can be "
                f"integrated in time. Leave the out_of_band blocks out"
            )
        if self.model.shaft is not None:
            raise ValueError(
                f"{self.model.name} is known at its planes as condensed from many fast modes, which is no equation "
                f"of motion in time; integrate a lumped model, such as WhirlWhip"
            )
        mass = self.mass[:, self._free[:, None], self._free]
        if mass.size and not (np.linalg.cond(mass) < 1e12).all():
            raise ValueError(f"{self.model.name}: a coordinate has no mass, so that its motion is undetermined in time")

    @cached_property
    def centred(self) -> ComplexArray:
        """Coefficient matrices of the centred rotor, shape ``(L, 3, n, n)``."""
        return self.model.coefficients(self.theta, self.speed)

    @property
    def mass(self) -> ComplexArray:
        """Mass matrices of the centred rotor, shape ``(L, n, n)``."""
        return self.centred[:, 2]

    @cached_property
    def _passive(self) -> ComplexArray:
        """Stiffness and damping of the centred rotor side by side, shape ``(L, n, 2n)``."""
        return np.concatenate([self.centred[:, 0], self.centred[:, 1]], axis=2)

    @cached_property
    def _own_acceleration(self) -> ComplexArray:
        """Acceleration of the centred rotor by its displacement and velocity, the free rows of ``(L, n, 2n)``."""
        return np.asarray(-self._inverse_mass @ self._passive[:, self._free])

    @cached_property
    def _free(self) -> Index:
        """Coordinates that are not imposed."""
        return np.array([i for i in range(len(self.model.coordinates)) if i != self.imposed], dtype=np.intp)

    @cached_property
    def _inverse_mass(self) -> ComplexArray:
        mass = self.mass[:, self._free[:, None], self._free]
        return np.asarray(np.linalg.inv(mass), dtype=complex)

    @cached_property
    def _journal(self) -> Journal | None:
        return journal(self.model) if self.model.eccentricity_dependent else None

    @cached_property
    def _change(self) -> Callable[[Float], ComplexArray]:
        """Change of the journal's coefficients by its eccentricity; rotors that are all alike count as one."""
        if self._journal is None:
            raise TypeError(f"{self.model.name} does not depend on eccentricity")
        alike = (self.theta == self.theta[:1]).all() and (self.speed == self.speed[:1]).all()
        rotors = 0 if alike else slice(None)
        return self._journal.change_of(self.theta[rotors], self.speed[rotors])

    def eccentricity(self, z: ComplexArray) -> Float:
        """Eccentricity of the journal, shape ``(..., L)``, zero in a linear model."""
        if self._journal is None:
            return np.zeros(z.shape[:-1])
        return np.asarray(np.abs(z[..., self._journal.at]) / self._journal.clearance)

    def acceleration(self, z: ComplexArray, v: ComplexArray, force: ComplexArray) -> ComplexArray:
        """Acceleration of all coordinates, m/s^2, shape ``(L, n)``."""
        seat, free, given = self._journal, self._free, self.imposed
        inertia: ComplexArray | None = None
        if seat is not None:
            change = self._change(self.eccentricity(z))
            force = force.copy()
            if seat.at != given:
                force[:, seat.at] -= change[0] * z[:, seat.at] + change[1] * v[:, seat.at]
                inertia = change[2] if seat.inertia_changes else None
        a = (self._own_acceleration @ np.concatenate([z, v], axis=1)[:, :, None])[:, :, 0]
        if given is None:
            a += (self._inverse_mass @ force[:, :, None])[:, :, 0]
        else:
            drive = force[:, free] - self.mass[:, free, given] * force[:, [given]]
            own, a = a, force.copy()
            a[:, free] = own + (self._inverse_mass @ drive[:, :, None])[:, :, 0]
        if seat is not None and inertia is not None:
            # Only the entry (b, b) of the mass matrix changes: a rank-one change of its inverse.
            at, place = seat.at, int(np.flatnonzero(free == seat.at)[0])
            gain = inertia * a[:, at] / (1.0 + inertia * self._inverse_mass[:, place, place])
            a[:, free] -= self._inverse_mass[:, :, place] * gain[:, None]
        return np.asarray(a)

    def force(self, z: ComplexArray, v: ComplexArray, a: ComplexArray) -> ComplexArray:
        """Force that a motion needs at an instant, N, shape ``(L, n)``."""
        total = (self._passive @ np.concatenate([z, v], axis=1)[:, :, None])[:, :, 0]
        total += (self.mass @ a[:, :, None])[:, :, 0]
        if self._journal is not None:
            at, change = self._journal.at, self._change(self.eccentricity(z))
            total[:, at] += change[0] * z[:, at] + change[1] * v[:, at] + change[2] * a[:, at]
        return np.asarray(total)

    def select(self, lines: Index) -> Motion:
        """Some of the rotors."""
        return Motion(model=self.model, theta=self.theta[lines], speed=self.speed[lines], imposed=self.imposed)


def integrate(
    motion: Motion,
    force: Force,
    z: ComplexArray,
    v: ComplexArray,
    span: tuple[float, float],
    *,
    size: ArrayLike,
    rate: ArrayLike,
    times: Float | None = None,
    tolerance: float = STEP_TOLERANCE,
) -> Path:
    """Integrate by the explicit method DOP853 with error control."""
    from scipy.integrate import solve_ivp

    count, n = z.shape

    def slope(time: float, state: ComplexArray) -> ComplexArray:
        position, velocity = state.reshape(2, count, n)
        change = np.empty((2, count, n), dtype=complex)
        change[0], change[1] = velocity, motion.acceleration(position, velocity, force(time))
        return change.ravel()

    # The error norm is a mean over all states: one line of many must not hide behind the others.
    strict = tolerance / np.sqrt(2 * count * n)
    small = np.broadcast_to(np.asarray(size, dtype=float) * strict, (count,))
    fast = np.broadcast_to(np.asarray(rate, dtype=float), (count,))
    atol = np.concatenate([np.repeat(small, n), np.repeat(small * fast, n)])
    begin = np.concatenate([z.ravel(), v.ravel()]).astype(complex)
    with np.errstate(all="ignore"):  # a trial step beyond the clearance gives NaN and is cut
        result = solve_ivp(
            slope,
            span,
            begin,
            method="DOP853",
            t_eval=times,
            rtol=max(strict, 1e-13),
            atol=atol,
            max_step=0.25 * np.pi / fast.max(),  # least squares need some instants in each period
        )
    states = result.y.T.reshape(-1, 2, count, n)
    path = Path(result.t, states[:, 0], states[:, 1])
    if not result.success or not np.isfinite(states).all():
        raise IntegrationError(
            f"{motion.model.name}: the motion cannot be followed past {significant(result.t[-1], 4)} s: the "
            f"journal touches the wall or the motion grows without limit"
        )
    eccentricity = motion.eccentricity(path.z)
    if eccentricity.max(initial=0.0) >= 1.0:
        worst = int(np.argmax(eccentricity.max(axis=0)))
        raise IntegrationError(
            f"{motion.model.name}: the journal touches the wall in case {worst + 1} of {count}; reduce the force"
        )
    return path
