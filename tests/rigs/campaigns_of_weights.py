"""Simulated campaigns of trial weights: one mode, mountings that scatter as no fitted structure assumes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

import rotorfit as rf

RPM = np.pi / 30
PLANES = ("disk1", "disk2")
PROBES = (("disk1", "x"), ("disk1", "y"), ("disk2", "x"), ("disk2", "y"))
GAIN = np.array([0.42 * np.exp(0.2j), -1j * 0.45 * np.exp(-0.1j), 1.0, -1j * 0.9 * np.exp(0.1j)])  # of each probe
WEIGHTS = (  # (plane, degrees): the seven mountings of the RK-4 data set
    ("disk1", 0.0), ("disk2", 0.0), ("disk1", 180.0), ("disk1", 90.0),
    ("disk2", -90.0), ("disk2", 180.0), ("disk2", 90.0),
)  # fmt: skip
TRUTH = {"M": 3.0, "wn": 1640 * RPM, "zeta": 0.03, "phi_disk2": 1.1, "datum": 1.35}


def influences(speed: float, truth: dict[str, float] = TRUTH) -> NDArray[np.complex128]:
    """Response of the four probes per kg m in the two planes at a speed, shape ``(4, 2)``."""
    wn = truth["wn"]
    mode = speed**2 / (truth["M"] * (wn**2 - speed**2 + 2j * truth["zeta"] * wn * speed))
    turn = np.exp(1j * truth["datum"])
    return np.asarray(mode * turn * GAIN[:, None] / GAIN[0] * np.array([1.0, truth["phi_disk2"]]))


def campaign(
    rng: np.random.Generator,
    *,
    weights: tuple[tuple[str, float], ...] = WEIGHTS,
    mounting_um: float = 0.2,
    weight_error: float = 0.005,
    repeats: int = 3,
    repeat_um: float = 0.035,
    mr: float = 3e-5,
    names: str = "{mounting}-{repeat}",
) -> rf.PerturbationTest:
    """A campaign at two dwell speeds.

    A mounting moves each probe by a vector that grows with the square of the speed (a bracket, a bow), different by
    probe and larger at the first one; and each weight errs by a complex fraction of itself.
    """
    sizes = mounting_um * 1e-6 * np.array([2.0, 0.6, 0.5, 0.8])
    rows: dict[str, list[object]] = {
        n: [] for n in ("run", "speed", "plane", "direction", "response", "force_plane", "force")
    }
    bow = GAIN / GAIN[0] * 6e-6 * np.exp(-1.2j)
    for number, (at, degrees) in enumerate(weights):
        unbalance = 0.0 if at == "none" else mr * np.exp(1j * np.radians(degrees))
        error = weight_error * complex(*rng.normal(size=2))
        moved = sizes * (rng.normal(size=4) + 1j * rng.normal(size=4))
        own = [moved + 0.3 * sizes * (rng.normal(size=4) + 1j * rng.normal(size=4)) for _ in range(2)]
        drift = rng.normal(0.0, 1.5, 2)  # rpm; repeats follow within a tenth
        for repeat in range(repeats):
            for dwell, rpm in enumerate((1004.0, 1206.0)):
                speed = (rpm + drift[dwell] + rng.normal(0.0, 0.1)) * RPM
                a = influences(speed)
                column = 0 if at == "none" else PLANES.index(at)
                growth = (speed / (1004 * RPM)) ** 2
                value = a[:, column] * unbalance * (1 + error) + a @ np.array([2e-5, 3e-5j]) + bow * growth
                value = value + own[dwell] * growth
                value = value + repeat_um * 1e-6 * (rng.normal(size=4) + 1j * rng.normal(size=4))
                for (plane, direction), reading in zip(PROBES, value, strict=True):
                    rows["run"].append(names.format(mounting=f"M{number:02d}", repeat=repeat + 1))
                    rows["speed"].append(speed)
                    rows["plane"].append(plane)
                    rows["direction"].append(direction)
                    rows["response"].append(reading)
                    rows["force_plane"].append(PLANES[0] if at == "none" else at)
                    rows["force"].append(unbalance * speed**2)
    arrays = {name: np.array(values) for name, values in rows.items()}
    return rf.perturbation_test(frequency=arrays["speed"], **arrays)
