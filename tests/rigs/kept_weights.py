"""Simulated balancing: a reference, a weight aft, a second one forward while the first stays in; and exact answers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

import rotorfit as rf
from rotorfit.lab.data.balancing import Balance

Complex = NDArray[np.complex128]
SPEEDS = np.array([300.0, 377.0])
PROBES = (("aft", "x"), ("aft", "y"), ("fwd", "x"), ("fwd", "y"))
SIGMA = 2e-7


def random_rig(rng: np.random.Generator) -> tuple[Complex, Complex]:
    """Vibration of four probes at two speeds, m, and influences of two planes, m/(kg m): shapes (8,) and (8, 2)."""
    residual = 15e-6 * (rng.normal(size=8) + 1j * rng.normal(size=8))
    return residual, 0.9 * (rng.normal(size=(8, 2)) + 1j * rng.normal(size=(8, 2)))


def runs(
    rng: np.random.Generator, residual: Complex, influence: Complex, further: tuple[Complex, ...] = (), *, given: bool
) -> rf.PerturbationTest:
    """A reference, a weight aft, a second one forward while the first stays in; readings probe by probe, speed by
    speed."""
    first, second = (1e-5 * np.exp(1j * rng.uniform(0, 6.28)) for _ in range(2))
    rows: dict[str, list[object]] = {}
    states = ([0, 0], [first, 0], [first, second], *further)
    for number, weights in enumerate(states):
        noise = SIGMA * (rng.normal(size=8) + 1j * rng.normal(size=8))
        for cell, response in enumerate((residual + influence @ np.array(weights) + noise).tolist()):
            (plane, direction), speed = PROBES[cell // 2], float(SPEEDS[cell % 2])
            for force_plane, weight in zip(("aft", "fwd"), weights, strict=True):
                cells = {"run": f"run {number}", "speed": speed, "frequency": speed, "force_plane": force_plane}
                cells |= {"force": weight * speed**2, "plane": plane, "direction": direction, "response": response}
                for name, value in cells.items():
                    rows.setdefault(name, []).append(value)
    return rf.perturbation_test(**rows, sigma=SIGMA if given else np.nan)  # type: ignore[arg-type]


def best_weights(residual: Complex, influence: Complex, limit: float = np.inf) -> Complex:
    """Least squares on real and imaginary parts; with a limit by projected gradients."""
    A = np.block([[influence.real, -influence.imag], [influence.imag, influence.real]])
    b = np.concatenate([residual.real, residual.imag])
    x = -np.linalg.lstsq(A, b, rcond=None)[0]
    step = 1 / np.linalg.eigvalsh(A.T @ A)[-1]
    for _ in range(0 if np.isinf(limit) else 600):
        x = x - step * (A.T @ (A @ x + b))
        size = np.hypot(x[:2], x[2:])
        x = x * np.tile(np.minimum(1.0, limit / size), 2)
    return x[:2] + 1j * x[2:]


def held(found: Balance, truth: Complex) -> list[bool]:
    """True where the interval of a weight's size, and of its angle, holds the truth; a size at its limit has none."""
    inside = []
    for plane, true in zip(found.planes, truth.tolist(), strict=True):
        (low, high), (early, late) = found.interval(plane)
        if plane not in found.at_limit:
            inside.append(low <= abs(true) <= high)
        inside.append(abs(np.angle(true * np.exp(-0.5j * (early + late)))) <= (late - early) / 2)
    return inside


MORE = (np.array([-1e-5j, 3e-6]), np.array([2e-6, -9e-6]))
