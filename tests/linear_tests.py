"""Tests with a force along x or y, made in real coordinates: nothing of it knows of forward and backward parts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from rotorfit.data.experiments import PerturbationTest, perturbation_test
from rotorfit.models import RotorModel
from rotorfit.models.off_centre import linearised


def linear_test(
    model: RotorModel,
    theta: NDArray[np.float64],
    *,
    speed: float,
    frequency: NDArray[np.float64],
    along: str,
    noise: float = 0.0,
    seed: int = 0,
    force: complex = 5.0 * np.exp(0.4j),
    planes: Sequence[str] | None = None,
    gains: Mapping[tuple[str, str], float] | None = None,
) -> PerturbationTest:
    """Sweeps at every plane, read in x and y, from the equation of motion in real coordinates, all x then all y.

    Args:
        noise: standard deviation of each part of a reading, as a fraction of the plane's rms reading.
    """
    rng = np.random.default_rng(seed)
    matrices = linearised(model, theta, speed, 0.0)
    n = len(model.coordinates)
    s = 1j * frequency[:, None, None]
    kappa = sum(matrix * s**power for power, matrix in enumerate(matrices))
    columns: dict[str, list[NDArray[np.generic]]] = {}
    for plane in planes or model.planes:
        drive = np.zeros(2 * n, dtype=complex)
        drive[model.coordinate(plane, "z") + n * (along == "y")] = force
        motion = np.linalg.solve(kappa, np.broadcast_to(drive, (frequency.size, 2 * n))[..., None])[..., 0]
        for number, coordinate in enumerate(model.coordinates):
            both = motion[:, [number, n + number]]
            level = noise * float(np.sqrt(np.mean(np.abs(both) ** 2)))
            for k, axis in enumerate("xy"):
                error = rng.normal(size=frequency.size) + 1j * rng.normal(size=frequency.size)
                row = {
                    "run": f"{plane} {speed:g} {along}",
                    "speed": speed,
                    "frequency": frequency,
                    "force_plane": plane,
                    "force": force,
                    "force_direction": along,
                    "plane": coordinate.plane,
                    "direction": ("r" if coordinate.axis == "r" else "") + axis,
                    "response": (both[:, k] + level * error) * (gains or {}).get((coordinate.plane, axis), 1.0),
                }
                for key, cell in row.items():
                    columns.setdefault(key, []).append(np.broadcast_to(np.asarray(cell), frequency.shape))
    return perturbation_test(**{key: np.concatenate(parts) for key, parts in columns.items()}, source="linear")  # type: ignore[arg-type]
