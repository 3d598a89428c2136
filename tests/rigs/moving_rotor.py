"""A floating stator whose rotor moves too, in its own supports: lines solved one by one, nothing of the package."""

from __future__ import annotations

import numpy as np
import pandas as pd
from numpy.typing import NDArray

STATOR, ROTOR = 14.0, 20.0  # kg
SEAL = {
    "K": np.array([[6.0e6, 2.6e6], [-2.5e6, 5.6e6]]),
    "C": np.array([[9.0e3, 1.1e3], [-1.0e3, 8.6e3]]),
    "M": np.array([[2.1, 0.25], [-0.2, 2.3]]),
}
HZ = np.arange(20.0, 300.0, 10.0)


def _motion(drive: NDArray[np.complex128], *, wet: bool) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """Motion of the stator and of the rotor, m, under forces on the stator, each ``(L, 2)``."""
    w = 2 * np.pi * HZ[:, None, None]
    two = np.eye(2)
    seal = (SEAL["K"] + 1j * w * SEAL["C"] - w**2 * SEAL["M"]) * wet
    rods = np.array([[1.5e5, 5e3], [5e3, 1.8e5]]) + 1j * w * 150.0 * two - w**2 * STATOR * two
    supports = (3.0e8 + 4e3j * w - w**2 * ROTOR) * two
    system = np.block([[rods + seal, -seal], [-seal, supports + seal]])
    found = np.linalg.solve(system, np.concatenate([drive, 0 * drive], axis=1)[..., None])[..., 0]
    return found[:, :2], found[:, 2:]


def table(rpm: float, *, wet: bool, seed: int) -> pd.DataFrame:
    """Load cells, relative probes and accelerometers of a run shaken along x and of one along y."""
    rng, w, parts = np.random.default_rng(seed), 2 * np.pi * HZ, []

    def noisy(values: NDArray[np.complex128], sigma: float) -> NDArray[np.complex128]:
        return values + sigma * (rng.normal(size=values.shape) + 1j * rng.normal(size=values.shape))

    for shaken in (0, 1):
        drive = np.full((HZ.size, 2), 6.0 + 0j)
        drive[:, shaken] = 300.0 if wet else 60.0
        stator, rotor = _motion(drive, wet=wet)
        force, probes, g = noisy(drive, 0.05), noisy(stator - rotor, 1e-8), noisy(-stator * w[:, None] ** 2, 2e-3)
        columns = {
            "run": f"{'wet' if wet else 'dry'} shaken {'xy'[shaken]}", "speed_rpm": rpm, "frequency_hz": HZ,
            "force_x_N": np.abs(force[:, 0]), "force_x_phase_deg": np.degrees(np.angle(force[:, 0])),
            "force_y_N": np.abs(force[:, 1]), "force_y_phase_deg": np.degrees(np.angle(force[:, 1])),
            "force_sigma_N": 0.05, "force_plane": "stator",
        }  # fmt: skip
        for way in (0, 1):
            read = (("stator", probes[:, way], 1e-8), ("housing", g[:, way] / -(w**2), 2e-3 / w**2))
            for plane, z, sigma in read:
                own = {"plane": plane, "direction": "xy"[way], "amplitude_um": 1e6 * np.abs(z)}
                own |= {"phase_deg": np.degrees(np.angle(z)), "sigma_um": 1e6 * sigma}
                parts.append(pd.DataFrame({**columns, **own}))
    return pd.concat(parts, ignore_index=True)
