"""A virtual rig for shafts that are not round: the full equations integrated in time, nonlinear in all angles.

Nothing of harmonic balance is in here, so that :class:`rotorfit.models.AnisotropicShaft` can be tested against it. Its
recordings are motion and twist in volts, with Keyphasors, as data acquisition stores them.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rotorfit.base.array_types import ComplexArray, Float
from rotorfit.base.chance import Seed, chance
from rotorfit.base.digits import significant
from rotorfit.base.units import RPM_PER_RAD_S
from rotorfit.lab.simulation.instruments import Probes, keyphasor_volts, notch, write_counts
from rotorfit.lab.simulation.turning_speeds import Sweep
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
class RunUp(Sweep):
    """A motor whose speed changes evenly: a start-up, or a shutdown where the last speed is the lower one."""

    uneven: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Perturbation:
    """An unbalance m r that turns at a speed of its own, swept linearly."""

    mr: float  # unbalance of the perturbator, kg m
    first: float  # speed at the begin, rad/s, positive
    last: float  # speed at the end, rad/s, positive
    forward: bool = False  # whether it turns with the shaft
    heavy_spot: float = 0.0  # angle of the unbalance ahead of the perturbator's mark, rad

    def sweep(self, duration: float) -> RunUp:
        """Angle of the perturbator's mark, and its speed."""
        return RunUp(first=self.first, last=self.last, duration=duration)

    def force(self, time: Float, duration: float) -> ComplexArray:
        """Force of the swept unbalance, N, shape ``(N,)``."""
        turned = self.mr * self.sweep(duration).force(time, self.heavy_spot)
        return turned if self.forward else turned.conj()


def _motor(speed: float | RunUp) -> RunUp:
    """A motor whose speed changes as given, or that turns evenly."""
    return speed if isinstance(speed, RunUp) else RunUp(first=speed, last=speed, duration=1.0)


@dataclass(frozen=True, kw_only=True, eq=False)
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
    motor = _motor(speed)
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
    inertia, kt, ct = p.get("J", 0.0), p.get("kt", 0.0), p.get("ct", 0.0)  # zero of a shaft that does not twist
    if "nu_t" in p:
        kt, ct = inertia * p["nu_t"] ** 2, 2 * p["zeta_t"] * p["nu_t"] * inertia
    rise = motor.slope

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


_NOTCH = {"width": 0.75, "ramp": 0.35}
"""Widths of the notch, its ramps included, and of each ramp, rad."""


@dataclass(frozen=True, kw_only=True)
class Acquisition(Probes):
    """How the virtual signals are taken: by probes as on other rigs, and one for the twist."""

    sample_rate: float = 3200.0
    twist_sensitivity: float = 1000.0  # V/rad
    runout: complex = 0.0  # 1x run-out of the shaft, m, ahead of its mark as a complex number


def record_shaft(
    path: str | os.PathLike[str],
    model: AnisotropicShaft,
    values: Mapping[str, float],
    speed: float | RunUp,
    duration: float,
    *,
    perturbation: Perturbation | None = None,
    acquisition: Acquisition | None = None,
    crack: Crack | None = None,
    support: complex = 0.0,
    rng: Seed = None,
    seed: Seed = None,
) -> Path:
    """Run the virtual shaft and write what its probes see as HDF5, for :func:`rotorfit.read_recording`. The shaft
    starts from its steady state without perturbation. Channels: ``PLANE_X``, ``PLANE_Y``, ``twist``,
    ``keyphasor_shaft`` and, with a perturbation, ``keyphasor_perturbator``; the attributes say the rest."""
    how = acquisition or Acquisition()
    motor = _motor(speed)
    numbers = {"speed": min(motor.first, motor.last), "duration": duration, "sample_rate": how.sample_rate}
    for name, number in numbers.items():
        if not (np.isfinite(number) and number > 0):
            raise ValueError(f"{name} must be positive, got {number}")
    time = np.arange(round(duration * how.sample_rate)) / how.sample_rate
    force = None if perturbation is None else lambda t: complex(perturbation.force(t, duration))
    start = _steady(model, values, motor.first)
    motion = shaft_motion(
        model, dict(values), motor, time, force=force, start=start, crack=crack, support=support, tolerance=1e-9
    )
    turn = motor.angle(time)
    seen = motion.z + how.runout * np.exp(1j * turn)
    plane = model.planes[0]
    signals = {
        f"{plane}_X": how.volts(seen.real),
        f"{plane}_Y": how.volts(seen.imag),
        "keyphasor_shaft": keyphasor_volts(notch(turn, **_NOTCH)),
    }
    if model.torsion is not None:
        signals["twist"] = how.twist_sensitivity * motion.twist
    if perturbation is not None:
        signals["keyphasor_perturbator"] = keyphasor_volts(notch(perturbation.sweep(duration).angle(time), **_NOTCH))
    drawn = np.random.default_rng(chance(rng, seed, 0))
    noisy = {name: volts + how.noise * drawn.normal(size=time.size) for name, volts in signals.items()}
    return write_counts(Path(path), noisy, _attributes(how, perturbation, motor))


def _steady(
    model: AnisotropicShaft, values: Mapping[str, float], speed: float
) -> tuple[complex, complex, float, float]:
    """Displacement and velocity of unbalance, sag and their images at the first instant."""
    theta = model.vector(values)
    orders = {(0, 0): speed, (0, -1): 0.0, (0, 1): 2 * speed}
    z = {order: complex(model.lines(theta, "z", order, 0.0, speed, 0.0)) for order in orders}
    return sum(z.values()), sum(1j * rate * z[order] for order, rate in orders.items()), 0.0, 0.0


def _attributes(how: Acquisition, perturbation: Perturbation | None, motor: RunUp) -> dict[str, str | float]:
    found = how.said() | {"twist_V_per_rad": how.twist_sensitivity}
    if not motor.slope:
        found["speed_rpm"] = motor.first * RPM_PER_RAD_S
    if perturbation is not None:
        found |= {
            "mr_kg_m": perturbation.mr,
            "heavy_spot_deg_ahead_of_mark": float(np.degrees(perturbation.heavy_spot)),
            "whirl": "forward" if perturbation.forward else "backward",
        }
    return found
