"""Recordings of the virtual shaft: motion and twist in volts, with Keyphasors, as data acquisition stores them."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rotorfit.models import AnisotropicShaft
from rotorfit.models.array_types import Float
from rotorfit.simulation.instruments import Probes, keyphasor_volts, notch, write_counts
from rotorfit.simulation.shaft import Crack, Perturbation, RunUp, shaft_motion, steady
from rotorfit.units import RPM_PER_RAD_S


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
    seed: int = 0,
) -> Path:
    """Run the virtual shaft and write what its probes see as HDF5, for :func:`rotorfit.read_recording`. The shaft
    starts from its steady state without perturbation. Channels: ``PLANE_X``, ``PLANE_Y``, ``twist``,
    ``keyphasor_shaft`` and, with a perturbation, ``keyphasor_perturbator``; the attributes say the rest."""
    how = acquisition or Acquisition()
    motor = speed if isinstance(speed, RunUp) else steady(speed)
    for name, number in (
        ("speed", min(motor.first, motor.last)),
        ("duration", duration),
        ("sample_rate", how.sample_rate),
    ):
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
        "keyphasor_shaft": _keyphasor(turn),
    }
    if model.torsion is not None:
        signals["twist"] = how.twist_sensitivity * motion.twist
    if perturbation is not None:
        signals["keyphasor_perturbator"] = _keyphasor(perturbation.angle(time, duration))
    rng = np.random.default_rng(seed)
    noisy = {name: volts + how.noise * rng.normal(size=time.size) for name, volts in signals.items()}
    return write_counts(Path(path), noisy, _attributes(how, perturbation, motor))


def _steady(
    model: AnisotropicShaft, values: Mapping[str, float], speed: float
) -> tuple[complex, complex, float, float]:
    """Displacement and velocity of unbalance, sag and their images at the first instant."""
    theta = model.vector(values)
    orders = {(0, 0): speed, (0, -1): 0.0, (0, 1): 2 * speed}
    z = {order: complex(model.lines(theta, "z", order, 0.0, speed, 0.0)) for order in orders}
    return sum(z.values()), sum(1j * rate * z[order] for order, rate in orders.items()), 0.0, 0.0


def _keyphasor(angle: Float) -> Float:
    # Widths of the notch, its ramps included, and of each ramp, rad.
    return keyphasor_volts(notch(angle, width=0.75, ramp=0.35))


def _attributes(how: Acquisition, perturbation: Perturbation | None, motor: RunUp) -> dict[str, str | float]:
    found = how.said() | {"twist_V_per_rad": how.twist_sensitivity}
    if not motor.acceleration:
        found["speed_rpm"] = motor.first * RPM_PER_RAD_S
    if perturbation is not None:
        found |= {
            "mr_kg_m": perturbation.mr,
            "heavy_spot_deg_ahead_of_mark": float(np.degrees(perturbation.heavy_spot)),
            "whirl": "forward" if perturbation.forward else "backward",
        }
    return found
