"""Volts of a floating stator that is shaken along x, then along y, integrated in time; nothing of what fits use."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
from numpy.typing import NDArray
from scipy.signal import chirp, lsim
from seal_rig import FLUID, STATOR_MASS, matrices

RATE = 1024.0
"""Hz, at which the motion is sampled."""


def rods() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Stiffness and damping of what holds the dry stator."""
    return np.array([[3.0e5, 2.0e4], [2.0e4, 3.6e5]]), np.array([[160.0, 10.0], [10.0, 140.0]])


def shaken(
    folder: Path,
    *,
    rpm: float,
    wet: bool = True,
    cross_talk: float = 0.03,
    motion_noise: float = 2e-7,
    force: float = 600.0,
    force_noise: float = 0.3,
    duration: float = 12.0,
    band_hz: tuple[float, float] = (10.0, 210.0),
    both: bool = False,
    seed: int = 0,
) -> list[Path]:
    """Two recordings; the other shaker follows by 2 ms, weaker; with ``both`` it runs a sweep of its own."""
    K, C = rods()
    if wet:
        fluid, damping, _ = matrices(FLUID(rpm))
        K, C = K + fluid, C + damping
    inverse = np.eye(2) / STATOR_MASS
    system = (
        np.block([[np.zeros((2, 2)), np.eye(2)], [-inverse @ K, -inverse @ C]]),
        np.vstack([np.zeros((2, 2)), inverse]),
        np.hstack([np.eye(2), np.zeros((2, 2))]),
        np.zeros((2, 2)),
    )
    fine = 4  # steps of the integration between two samples
    t = np.arange(int(duration * RATE * fine)) / (RATE * fine)
    rng, paths = np.random.default_rng(seed), []
    for axis in (0, 1):
        F = np.zeros((t.size, 2))
        F[:, axis] = force * chirp(t, band_hz[0], duration, band_hz[1])
        F[:, 1 - axis] = cross_talk * force * chirp(np.maximum(t - 2e-3, 0.0), band_hz[0], duration, band_hz[1])
        if both:
            F[:, 1 - axis] = cross_talk * force * chirp(t, band_hz[1], duration, band_hz[0])
        held = F.copy()  # forces between steps are straight lines, which lack (w dt)^2 / 12 of a sine
        held[1:-1] -= np.diff(F, 2, axis=0) / 12
        motion = lsim(system, held, t)[1][::fine]
        F = F[::fine] + force_noise * rng.standard_normal((motion.shape[0], 2))
        motion = motion + motion_noise * rng.standard_normal(motion.shape)
        name = f"{'wet' if wet else 'dry'}-{rpm:g}-shaken-{'xy'[axis]}"
        with h5py.File(folder / f"{name}.h5", "w") as file:
            file.attrs.update(sample_rate_hz=RATE, speed_rpm=rpm, rotation="ccw")
            for way, letter in enumerate("XY"):
                file[f"stator_{letter}"] = -10.0 + 8e3 * motion[:, way]
                file[f"cell_{letter}"] = 0.01 * F[:, way]
        paths.append(folder / f"{name}.h5")
    return paths


def multisine(folder: Path, tones_hz: NDArray[np.float64], *, seed: int = 0) -> list[Path]:
    """Two recordings of the steady motion under sines with phases of Schroeder, and 3 % of them along the other axis,
    each line solved by itself; 4.3 s, which holds no whole number of periods. The fluid is that of 3000 rpm, the shaft
    has no mark and is said to rest: no orders."""
    w, rng = 2 * np.pi * tones_hz, np.random.default_rng(seed)
    K, C = (own + more for own, more in zip(rods(), matrices(FLUID(3000.0))[:2], strict=True))
    kappa = K + 1j * w[:, None, None] * C - w[:, None, None] ** 2 * STATOR_MASS * np.eye(2)
    waves = np.exp(1j * np.outer(np.arange(int(4.3 * RATE)) / RATE, w))
    paths = []
    for axis in (0, 1):
        F = np.zeros((w.size, 2), dtype=complex)
        F[:, axis] = 60.0 * np.exp(1j * np.pi * np.arange(w.size) ** 2 / w.size)
        F[:, 1 - axis] = 0.03 * F[:, axis] * np.exp(0.4j)
        A = np.linalg.solve(kappa, F[..., None])[..., 0]
        force, motion = ((waves @ part).real for part in (F, A))
        name = folder / f"tones-shaken-{'xy'[axis]}.h5"
        with h5py.File(name, "w") as file:
            file.attrs.update(sample_rate_hz=RATE, speed_rpm=0.0, rotation="ccw")
            for way, letter in enumerate("XY"):
                moved = motion[:, way] + 1e-7 * rng.standard_normal(len(motion))
                file[f"stator_{letter}"] = -10.0 + 8e3 * moved
                file[f"cell_{letter}"] = 0.01 * (force[:, way] + 0.05 * rng.standard_normal(len(force)))
        paths.append(name)
    return paths


SETUP = """
[[probe]]
plane = "stator"
channel = "stator_X"
angle_deg = 0.0
sensitivity_V_per_mm = 8.0

[[probe]]
plane = "stator"
channel = "stator_Y"
angle_deg = 90.0
sensitivity_V_per_mm = 8.0

[force]
plane = "stator"
channel_x = "cell_X"
channel_y = "cell_Y"
sensitivity_V_per_N = 0.01
"""
"""``rig.toml``."""
