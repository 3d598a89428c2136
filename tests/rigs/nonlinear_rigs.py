"""Rotors with laws of eccentricity, for tests."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rotorfit.base.array_types import ComplexArray, Float
from rotorfit.models import EvenPolynomial, MonotoneSpline, Muszynska, OneMode, RotorModel, WhirlWhip
from rotorfit.models.motion.journal import journal
from rotorfit.models.motion.off_centre import static_equilibria
from rotorfit.models.motion.orbits import OrbitEquation

CLEARANCE_UM = 200.0
SPEED = 100.0
"""rad/s"""

ONE_MODE = {"M": 1.2, "K": 8000.0, "Ds": 8.0, "K0": 9000.0, "D": 450.0, "lam": 0.46, "Mf": 0.4}
JUMPING = {"M": 1.2, "K": 2000.0, "Ds": 8.0, "K0": 9000.0, "D": 40.0, "lam": 0.46, "Mf": 0.4}
WHIRL_WHIP = {
    "Md": 0.95, "Ds": 25.0, "K1": 14000.0, "K2": 15000.0, "sigma": 1.0, "Mb": 0.3, "K3": 6000.0, "K0": 10000.0,
    "D": 450.0, "lam": 0.475, "Mf": 0.35,
}  # fmt: skip
POWER = {"n_K": 2.0, "n_D": 1.4, "b": 0.5}
EVEN = {"K0_2": 4e3, "K0_4": 3e4, "D_2": 200.0, "D_4": 900.0, "lam_2": -0.3, "lam_4": -0.2}
SPLINE = {
    "K0_s1": 3e3, "K0_s2": 2e4, "K0_s3": 4e4, "D_s1": 90.0, "D_s2": 400.0, "D_s3": 900.0, "lam_s0": 0.05,
    "lam_s1": 0.1, "lam_s2": 0.2, "lam_s3": 0.3,
}  # fmt: skip


def rig(name: str) -> tuple[RotorModel, NDArray[np.float64]]:
    """A rotor and its parameter vector; ``jumping`` has several orbits under one force between 800 and 1400 rpm."""
    one = ONE_MODE | POWER
    rigs = {
        "muszynska": (OneMode(law=Muszynska(), clearance_um=CLEARANCE_UM), one),
        "even": (OneMode(law=EvenPolynomial(), clearance_um=CLEARANCE_UM), ONE_MODE | EVEN),
        "spline": (OneMode(law=MonotoneSpline(), clearance_um=CLEARANCE_UM), ONE_MODE | SPLINE),
        "jumping": (OneMode(law=Muszynska(), clearance_um=CLEARANCE_UM), JUMPING | POWER | {"n_D": 0.5}),
        "two planes": (WhirlWhip(law=Muszynska(), clearance_um=CLEARANCE_UM), WHIRL_WHIP | POWER),
        "two ratios": (
            OneMode(law=Muszynska(), clearance_um=CLEARANCE_UM, two_lam=True),
            {k: v for k, v in one.items() if k != "lam"} | {"lam_D": 0.46, "lam_M": 0.4},
        ),
    }
    model, values = rigs[name]
    return model, model.vector(values)


def loaded(name: str, newton: complex) -> tuple[RotorModel, Float, ComplexArray, float, float]:
    """A rig under a load at its journal: model, parameters, displacements, eccentricity and attitude."""
    model, theta = rig(name)
    seat = journal(model)
    load = np.zeros(len(model.coordinates), dtype=complex)
    load[seat.at] = newton
    z = static_equilibria(model, theta, SPEED, load)[0]
    return model, theta, z, float(abs(z[seat.at]) / seat.clearance), float(np.angle(z[seat.at]))


def forces(model: RotorModel, plane: int, size: NDArray[np.generic]) -> ComplexArray:
    vector = np.zeros((size.size, len(model.coordinates)), dtype=complex)
    vector[:, plane] = size
    return vector


def orbit_equation(
    model: RotorModel, theta: Float, speed: float, frequency: Float, force: ComplexArray
) -> OrbitEquation:
    """The equation of each line, force of shape ``(L, n)``."""
    seat = journal(model)
    H = model.receptance(theta, frequency, speed)
    drive = np.einsum("lij,lj->li", H, force)[:, seat.at] / seat.clearance
    lines = frequency.size
    return OrbitEquation(
        theta=np.tile(theta, (lines, 1)),
        frequency=frequency,
        speed=np.full(lines, speed),
        drive=np.abs(drive),
        receptance=H[:, seat.at, seat.at],
    )
