"""A virtual rig with a floating stator, shaken along x, then along y: what a seal laboratory records.

Made by inverting matrices of real coordinates at each frequency; nothing of what fits use.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
import pandas as pd
from numpy.typing import NDArray

Coefficients = Mapping[str, float]
STATOR_MASS = 14.0
"""kg."""


def FLUID(rpm: float) -> dict[str, float]:  # noqa: N802
    """Coefficients of a seal whose cross-coupling grows with speed, by the names of ``Anisotropic``."""
    share = rpm / 3000.0
    return {
        "Kxx": 2.4e6 + 2e5 * share, "Kxy": 1.2e6 * share, "Kyx": -1.25e6 * share, "Kyy": 2.2e6 + 3e5 * share,
        "Dxx": 5200.0, "Dxy": 700.0 * share, "Dyx": -650.0 * share, "Dyy": 4900.0,
        "Mxx": 0.0, "Mxy": 0.0, "Myx": 0.0, "Myy": 0.0,
    }  # fmt: skip


def matrices(coefficients: Coefficients) -> list[NDArray[np.float64]]:
    """Stiffness, damping and inertia, 2 x 2."""
    return [np.array([[coefficients[f"{k}{i}{j}"] for j in "xy"] for i in "xy"]) for k in "KDM"]


def dry_stiffness(w: NDArray[np.float64], mass: float) -> NDArray[np.complex128]:
    """Stator on flexible rods with a damped pipe that has a resonance in the band, shape ``(L, 2, 2)``."""
    rods = np.array([[3.0e5, 2.0e4], [2.0e4, 3.6e5]])
    damping = np.array([[160.0, 10.0], [10.0, 140.0]])
    pipe = 0.6 * (2 * np.pi * 90.0) ** 2  # N/m
    absorbed = pipe * (-0.6 * w**2) / (pipe + 60j * w - 0.6 * w**2)
    lines, along_x = w[:, None, None], np.diag([1.0, 0.0])
    steady = rods + 1j * lines * damping - lines**2 * mass * np.eye(2)
    return np.asarray(steady + absorbed[:, None, None] * along_x)


def floating_stator(
    *,
    speeds_rpm: Sequence[float],
    frequency_hz: NDArray[np.float64] | None = None,
    fluid: Callable[[float], Coefficients] | None = FLUID,
    mass: float = STATOR_MASS,
    force: float = 600.0,
    cross_talk: float = 0.03,
    force_noise: float = 0.0,
    motion_noise: float = 0.0,
    force_sigma: float | None = None,
    sigma_um: float | None = None,
    exact: bool = False,
    seed: int = 0,
) -> pd.DataFrame:
    """A table with forces and readings along both axes.

    Args:
        fluid: coefficients by speed; None is a dry run.
        mass: of the stator; zero leaves the whole dry structure out.
        force_noise: N, of each part of each force.
        motion_noise: um, of each part of each reading.
    """
    hz = np.linspace(20.0, 200.0, 37) if frequency_hz is None else frequency_hz
    w, rng = 2 * np.pi * hz, np.random.default_rng(seed)

    def noise(size: float, count: int) -> NDArray[np.complex128]:
        return np.asarray(size * (rng.standard_normal((count, 2)) + 1j * rng.standard_normal((count, 2))))

    parts = []
    for rpm in speeds_rpm:
        kappa = dry_stiffness(w, mass) if mass else np.zeros((w.size, 2, 2), dtype=complex)
        if fluid is not None:
            K, D, M = matrices(fluid(rpm))
            kappa = kappa + K + 1j * w[:, None, None] * D - w[:, None, None] ** 2 * M
        for axis in (0, 1):
            F = np.zeros((w.size, 2), dtype=complex)
            F[:, axis] = force * np.exp(0.2j)
            F[:, 1 - axis] = cross_talk * force * np.exp(1j * (0.9 + w / 600.0))
            A = np.linalg.solve(kappa, F[..., None])[..., 0]
            if not exact:
                F, A = F + noise(force_noise, w.size), A + noise(motion_noise * 1e-6, w.size)
            for way in (0, 1):
                parts.append(
                    pd.DataFrame(
                        {
                            "run": f"{rpm:g} shaken {'xy'[axis]}", "speed_rpm": rpm, "frequency_hz": hz,
                            "force_x_N": np.abs(F[:, 0]), "force_x_phase_deg": np.degrees(np.angle(F[:, 0])),
                            "force_y_N": np.abs(F[:, 1]), "force_y_phase_deg": np.degrees(np.angle(F[:, 1])),
                            "plane": "stator", "direction": "xy"[way],
                            "amplitude_um": np.abs(A[:, way]) * 1e6, "phase_deg": np.degrees(np.angle(A[:, way])),
                        }
                    )
                )  # fmt: skip
    table = pd.concat(parts, ignore_index=True)
    if force_sigma is not None:
        table["force_sigma_N"] = force_sigma
    if sigma_um is not None:
        table["sigma_um"] = sigma_um
    return table
