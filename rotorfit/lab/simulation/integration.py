"""Integration of the nonlinear equation of motion in time, many rotors or many forces at once, until it is steady.

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

from rotorfit.base.array_types import ComplexArray, Float, Index
from rotorfit.base.digits import significant
from rotorfit.base.units import RPM_PER_RAD_S
from rotorfit.models import RotorModel
from rotorfit.models.motion.journal import Journal, journals
from rotorfit.models.motion.time_steps import RowsInTime

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
        return self.rows.of(self.model.coefficients(self.theta, self.speed))

    @cached_property
    def rows(self) -> RowsInTime:
        """What makes rows without inertia tell an acceleration."""
        return RowsInTime(self.model.coefficients(self.theta, self.speed))

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
    def _journals(self) -> list[tuple[Journal, Callable[[Float], ComplexArray]]]:
        """Journals and the change of their coefficients by eccentricity; rotors that are all alike count as one."""
        alike = (self.theta == self.theta[:1]).all() and (self.speed == self.speed[:1]).all()
        rotors = 0 if alike else slice(None)
        seats = journals(self.model) if self.model.eccentricity_dependent else ()
        return [(seat, seat.change_of(self.theta[rotors], self.speed[rotors])) for seat in seats]

    def eccentricity(self, z: ComplexArray) -> Float:
        """Largest eccentricity of a journal, shape ``(..., L)``, zero in a linear model."""
        eps = [np.abs(z[..., seat.at]) / seat.clearance for seat, _ in self._journals]
        return np.max(eps, axis=0) if eps else np.zeros(z.shape[:-1])

    def acceleration(self, z: ComplexArray, v: ComplexArray, force: ComplexArray) -> ComplexArray:
        """Acceleration of all coordinates, m/s^2, shape ``(L, n)``."""
        free, given = self._free, self.imposed
        inertias: list[tuple[int, ComplexArray]] = []
        force = force.copy() if self._journals else force
        for seat, change_at in self._journals:
            at = seat.at
            if at == given:
                continue
            change = change_at(np.abs(z[:, at]) / seat.clearance)
            force[:, at] -= change[0] * z[:, at] + change[1] * v[:, at]
            if seat.inertia_changes:
                inertias.append((at, change[2]))
        a = (self._own_acceleration @ np.concatenate([z, v], axis=1)[:, :, None])[:, :, 0]
        if given is None:
            a += (self._inverse_mass @ force[:, :, None])[:, :, 0]
        else:
            drive = force[:, free] - self.mass[:, free, given] * force[:, [given]]
            own, a = a, force.copy()
            a[:, free] = own + (self._inverse_mass @ drive[:, :, None])[:, :, 0]
        inverse = self._inverse_mass
        for at, inertia in inertias:  # an entry (b, b) of the mass matrix changes: a rank-one change of its inverse
            place = int(np.flatnonzero(free == at)[0])
            gain = inertia / (1.0 + inertia * inverse[:, place, place])
            a[:, free] -= inverse[:, :, place] * (gain * a[:, at])[:, None]
            if len(inertias) > 1:
                inverse = inverse - gain[:, None, None] * inverse[:, :, [place]] * inverse[:, [place]]
        return np.asarray(a)

    def force(self, z: ComplexArray, v: ComplexArray, a: ComplexArray) -> ComplexArray:
        """Force that a motion needs at an instant, N, shape ``(L, n)``."""
        total = (self._passive @ np.concatenate([z, v], axis=1)[:, :, None])[:, :, 0]
        total += (self.mass @ a[:, :, None])[:, :, 0]
        for seat, change_at in self._journals:
            at = seat.at
            change = change_at(np.abs(z[:, at]) / seat.clearance)
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


_MOST_WINDOWS = 60  # windows in which a motion must settle
_TIME_CONSTANTS = 3.0  # time constants of the slowest transient in a window


class Steady(NamedTuple):
    """Steady motion ``mean + forward exp(jwt) + backward exp(-jwt) + ...``, all of shape ``(L, n)``, and its end."""

    forward: ComplexArray  # amplitude at the signed frequency w of the force
    backward: ComplexArray  # amplitude at -w, zero on a centred circular orbit
    mean: ComplexArray  # constant displacement
    z: ComplexArray  # displacement at the last instant, turned back to that of a force at phase zero
    v: ComplexArray  # velocity at the last instant, turned likewise


def steady_state(
    motion: Motion,
    frequency: Float,
    force: ComplexArray,
    decay: Float,
    *,
    load: ComplexArray | None = None,
    start: tuple[ComplexArray, ComplexArray] | None = None,
    tolerance: float = STEP_TOLERANCE,
) -> Steady:
    """Integrate under ``force exp(jwt) + load`` until nothing changes any more, then measure the motion."""
    zero = np.zeros_like(force)
    z, v = start or (zero, zero)
    load = zero if load is None else load
    parts = {name: np.zeros_like(force) for name in Steady._fields}
    # Where nothing acts a stable rotor is at rest, of no size to which steps could be held.
    driven = (force != 0).any(axis=1) | (load != 0).any(axis=1) | (motion.imposed is not None)
    # Lines within an octave go together, so that windows of whole periods are of like length.
    w, left = np.abs(frequency), np.flatnonzero(driven)
    octave = np.floor(np.log2(w[left] / w.min())) if left.size else left
    groups: list[Index] = []
    # States integrated together: times the 13 slopes of a step of DOP853 they stay below the 4096 elements from which
    # OpenBLAS starts threads, whose waiting for each other takes longer than the product.
    states_together = 300
    for number in np.unique(octave):
        mine = left[octave == number]
        count = -(-mine.size * 2 * force.shape[1] // states_together)
        groups += np.array_split(mine[np.argsort(w[mine], kind="stable")], count)
    for lines in groups:
        chosen = (motion.select(lines), frequency[lines], force[lines], load[lines], decay[lines])
        found = _settle(*chosen, z[lines], v[lines], tolerance)
        for name, values in found._asdict().items():
            parts[name][lines] = values
    return Steady(**parts)


def rest_position(
    motion: Motion, load: ComplexArray, decay: Float, *, tolerance: float = STEP_TOLERANCE
) -> ComplexArray:
    """Integrate under constant loads, from the centre, until nothing moves: the equilibria, shape ``(L, n)``."""
    z, v = np.zeros_like(load), np.zeros_like(load)
    size = _typical(motion, np.zeros(load.shape[0]), np.zeros_like(load), load)
    window = _TIME_CONSTANTS / decay.min()
    for _ in range(_MOST_WINDOWS):
        path = integrate(motion, lambda _: load, z, v, (0.0, window), size=size, rate=decay, tolerance=tolerance)
        moved = np.abs(path.z - path.z[-1]).max(axis=0)
        z, v = path.z[-1], path.v[-1]
        if (moved <= 10 * tolerance * np.abs(z).max(axis=1, keepdims=True)).all():
            return np.asarray(z)
    raise IntegrationError(
        f"{motion.model.name}: the rotor has not come to rest after {significant(_MOST_WINDOWS * window, 3)} s; it may "
        "be unstable under this load"
    )


def _settle(
    motion: Motion,
    w: Float,
    force: ComplexArray,
    load: ComplexArray,
    decay: Float,
    z: ComplexArray,
    v: ComplexArray,
    tolerance: float,
) -> Steady:
    result = {name: np.zeros_like(force) for name in Steady._fields}
    window = max(2 * np.pi / np.abs(w).min(), _TIME_CONSTANTS / decay.min())
    size = _typical(motion, w, force, load) if motion.imposed is None else np.abs(z).max(axis=1)
    rate = np.abs(w) + decay
    left = np.arange(w.size)
    before = np.full(force.shape, np.inf, dtype=complex)
    time = 0.0
    for _ in range(_MOST_WINDOWS):
        drive, constant, omega = force[left], load[left], w[left]

        def push(
            t: float, drive: ComplexArray = drive, constant: ComplexArray = constant, omega: Float = omega
        ) -> ComplexArray:
            return np.asarray(drive * np.exp(1j * omega * t)[:, None] + constant)

        span = (time, time + window)
        path = integrate(motion.select(left), push, z, v, span, size=size[left], rate=rate[left], tolerance=tolerance)
        mean, forward, backward = _phasors(path, omega)
        z, v, time = path.z[-1], path.v[-1], span[1]
        # Within a window a transient shrinks by exp(-3): what has changed is nearly all that is left of it.
        settled = np.abs(forward - before).max(axis=1) <= 10 * tolerance * np.abs(forward).max(axis=1)
        done = left[settled]
        turn = np.exp(-1j * omega * time)[settled, None]
        for name, values in {"forward": forward, "backward": backward, "mean": mean}.items():
            result[name][done] = values[settled]
        result["z"][done] = (z[settled] - mean[settled]) * turn + mean[settled]
        result["v"][done] = v[settled] * turn
        left, z, v, before = left[~settled], z[~settled], v[~settled], forward[~settled]
        if not left.size:
            return Steady(**result)
    raise IntegrationError(
        f"{motion.model.name}: the motion has not settled after {significant(time, 3)} s in {left.size} of {w.size} "
        f"cases, the first at {significant(w[left[0]] * RPM_PER_RAD_S, 4)} rpm; the rotor may be unstable or vibrate "
        "with more than one period"
    )


def _typical(motion: Motion, w: Float, force: ComplexArray, load: ComplexArray) -> Float:
    """Size of the linear response, m, shape ``(L,)``; the clearance limits it."""
    moving = np.einsum("lij,lj->li", motion.model.receptance(motion.theta, w, motion.speed), force)
    at_rest = np.einsum("lij,lj->li", motion.model.receptance(motion.theta, 0.0, motion.speed), load)
    size = (np.abs(moving) + np.abs(at_rest)).max(axis=1)
    limit = motion.model.least_clearance if motion.model.eccentricity_dependent else None
    return np.asarray(size if limit is None else np.minimum(size, limit))


def _phasors(path: Path, frequency: Float) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
    """Mean, forward and backward amplitude by least squares over the last whole periods, shapes ``(L, n)``. Harmonics
    are fitted along: small motion about an eccentric equilibrium has some."""
    orders = [0, 1, -1, 2, -2, 3, -3]
    amplitudes = np.zeros((3, *path.z.shape[1:]), dtype=complex)
    length = path.time[-1] - path.time[0]
    for line, w in enumerate(np.abs(frequency).tolist()):
        period = 2 * np.pi / w
        begin = path.time[-1] - max(np.floor(length / period * (1 + 1e-9)), 1.0) * period
        inside = path.time >= begin - 1e-9 * period
        basis = np.exp(1j * frequency[line] * path.time[inside, None] * np.array(orders))
        amplitudes[:, line] = np.linalg.lstsq(basis, path.z[inside, line], rcond=None)[0][:3]
    return amplitudes[0], amplitudes[1], amplitudes[2]
