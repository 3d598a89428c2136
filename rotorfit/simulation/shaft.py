"""A virtual rig for shafts that are not round: the full equations integrated in time, nonlinear in all angles.

Nothing of harmonic balance is in here, so that :class:`rotorfit.models.AnisotropicShaft` can be tested against it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from rotorfit.models.array_types import ComplexArray, Float
from rotorfit.models.digits import significant
from rotorfit.models.shafts.anisotropic_shaft import AnisotropicShaft


@dataclass(frozen=True, kw_only=True)
class Crack:
    """A crack that opens and closes: where its side of the shaft is stretched, ``stiffness`` is missing there.

    The shaft loses ``stiffness`` along the crack's direction while the deflection ``u = Re(z exp(-j(theta + angle)))``
    is positive, nothing while it is negative: potential ``-stiffness max(u, 0)^2 / 2``. A heavy horizontal shaft
    breathes once a turn.
    """

    stiffness: float  # stiffness missing when open, N/m
    angle: float = 0.0  # direction of the crack ahead of the Keyphasor mark, rad


@dataclass(frozen=True, kw_only=True)
class Perturbation:
    """An unbalance m r that turns at a speed of its own, swept linearly."""

    mr: float  # unbalance of the perturbator, kg m
    first: float  # speed at the begin, rad/s, positive
    last: float  # speed at the end, rad/s, positive
    forward: bool = False  # whether it turns with the shaft
    heavy_spot: float = 0.0  # angle of the unbalance ahead of the perturbator's mark, rad

    def angle(self, time: Float, duration: float) -> Float:
        """Angle of the perturbator's mark, rad."""
        return np.asarray(self.first * time + (self.last - self.first) / (2 * duration) * time**2)

    def force(self, time: Float, duration: float) -> ComplexArray:
        """Force of the swept unbalance, N, shape ``(N,)``."""
        d = 1.0 if self.forward else -1.0
        rate = self.first + (self.last - self.first) / duration * time
        turn = np.exp(1j * d * (self.angle(time, duration) + self.heavy_spot))
        return np.asarray(self.mr * (rate**2 - 1j * d * (self.last - self.first) / duration) * turn)


@dataclass(frozen=True, kw_only=True)
class RunUp:
    """A motor whose speed changes evenly: a start-up, or a shutdown where the last speed is the lower one."""

    first: float  # speed at the begin, rad/s, positive
    last: float  # speed at the end, rad/s, positive
    duration: float  # s

    @property
    def acceleration(self) -> float:
        """rad/s^2."""
        return (self.last - self.first) / self.duration

    def angle(self, time: Float) -> Float:
        """Angle of the shaft's mark at the motor end, rad."""
        return np.asarray(self.first * time + self.acceleration / 2 * time**2)


def steady(speed: float) -> RunUp:
    """A motor that turns evenly."""
    return RunUp(first=speed, last=speed, duration=1.0)


@dataclass(frozen=True, kw_only=True)
class ShaftMotion:
    """Motion of the shaft in time."""

    time: Float  # instants, s, shape ``(T,)``
    z: ComplexArray  # displacement of the disk, m
    velocity: ComplexArray  # of the disk, m/s
    twist: Float  # of the disk against the motor, rad
    twist_rate: Float  # its rate, rad/s


def shaft_motion(
    model: AnisotropicShaft,
    values: dict[str, float],
    speed: float | RunUp,
    time: Float,
    *,
    force: Callable[[float], complex] | None = None,
    start: tuple[complex, complex, float, float] = (0.0, 0.0, 0.0, 0.0),
    crack: Crack | None = None,
    support: complex = 0.0,
    tolerance: float = 1e-10,
) -> ShaftMotion:
    """Integrate the full equations (physics as in :mod:`rotorfit.models.shafts.anisotropic_shaft`) by DOP853."""
    from scipy.integrate import solve_ivp

    instants = np.asarray(time, dtype=float)
    if instants.ndim != 1 or instants.size < 2 or not (np.diff(instants) > 0).all():
        raise ValueError("time must be at least two ascending instants, s")
    motor = speed if isinstance(speed, RunUp) else steady(speed)
    slope = _equations(model, values, motor, force, crack, support)
    z, v, phi, rate = start
    begin = np.array([np.real(z), np.imag(z), np.real(v), np.imag(v), phi, rate])
    fast = max(abs(motor.first), abs(motor.last), np.sqrt(values["K"] / values["M"]), values.get("nu_t", 0.0), 1.0)
    small = 1e-6 * tolerance * np.array([1.0, 1.0, fast, fast, 1.0, fast])
    found = solve_ivp(
        slope,
        (instants[0], instants[-1]),
        begin,
        method="DOP853",
        t_eval=instants,
        rtol=max(tolerance, 1e-13),
        atol=small,
        max_step=0.5 / fast,
    )
    if not found.success or not np.isfinite(found.y).all():
        raise RuntimeError(
            f"{model.name}: the motion cannot be followed past {significant(found.t[-1], 4)} s; it grows without limit"
        )
    x, y, vx, vy, twist, twist_rate = found.y
    return ShaftMotion(time=found.t, z=x + 1j * y, velocity=vx + 1j * vy, twist=twist, twist_rate=twist_rate)


def _equations(
    model: AnisotropicShaft,
    values: dict[str, float],
    motor: RunUp,
    force: Callable[[float], complex] | None,
    crack: Crack | None,
    support: complex,
) -> Callable[[float, Float], list[float]]:
    p = dict(zip(model.parameter_names, model.vector(values).tolist(), strict=True))
    M, D, K = p["M"], p["D"], p["K"]
    delta, eps, side = complex(p["dK_cos"], p["dK_sin"]), complex(p["ec"], p["es"]), complex(p["Px"], p["Py"])
    inertia, kt, ct = _torsion_constants(model, p)
    rise = motor.acceleration

    def slope(t: float, state: Float) -> list[float]:
        x, y, vx, vy, phi, rate = state.tolist()
        z, v = complex(x, y), complex(vx, vy)
        motor_speed, motor_angle = motor.first + rise * t, (motor.first + rise / 2 * t) * t
        turn = complex(np.exp(1j * (motor_angle + phi)))
        pull = delta * turn * turn * z.conjugate()
        load = side + (force(t) if force is not None else 0.0)
        R = M * eps * (motor_speed + rate) ** 2 * turn + load - D * v - K * z - pull - support * z.conjugate()
        torque = (delta * (z.conjugate() * turn) ** 2).imag - ct * rate - kt * phi
        if crack is not None:
            axis = turn * complex(np.exp(1j * crack.angle))
            u = z * axis.conjugate()
            opening = crack.stiffness * max(u.real, 0.0)
            R += opening * axis
            torque += opening * u.imag
        # M z'' = R - j M eps theta'' turn, put into the twist's equation, leaves J theta'' alone.
        angular = (torque - (eps.conjugate() * turn.conjugate() * R).imag) / inertia if inertia else rise
        a = R / M - 1j * eps * turn * angular
        return [vx, vy, a.real, a.imag, rate, angular - rise]

    return slope


def _torsion_constants(model: AnisotropicShaft, p: dict[str, float]) -> tuple[float, float, float]:
    """J, kt and ct of named values, zero for a shaft that does not twist."""
    if model.torsion is None:
        return 0.0, 0.0, 0.0
    if model.torsion == "stiffness":
        return p["J"], p["kt"], p["ct"]
    return p["J"], p["J"] * p["nu_t"] ** 2, 2 * p["zeta_t"] * p["nu_t"] * p["J"]
