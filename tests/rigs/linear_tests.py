"""Tests with a force along x or y, made in real coordinates: nothing of it knows of forward and backward parts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

import rotorfit as rf
from rotorfit.base.array_types import Float
from rotorfit.models import RotorModel
from rotorfit.models.motion.journal import journal


def linearised(model: RotorModel, theta: Float, speed: float, eccentricity: float, attitude: float = 0.0) -> Float:
    """Coefficient matrices of small motion in real coordinates, all x then all y.

    For one mode the first is ``[[kxx, kxy], [kyx, kyy]]``, then damping and mass.

    Args:
        model: the rotor.
        theta: parameter vector, shape ``(P,)``.
        speed: rotative speed, rad/s.
        eccentricity: static eccentricity of the journal.
        attitude: direction of its displacement from x towards y, rad.

    Returns:
        shape ``(order + 1, 2n, 2n)``.
    """
    C = model.coefficients(theta, speed, eccentricity)
    n = C.shape[-1]
    real = np.zeros((C.shape[0], 2 * n, 2 * n))
    real[:, :n, :n], real[:, n:, n:] = C.real, C.real
    real[:, n:, :n], real[:, :n, n:] = C.imag, -C.imag
    if model.eccentricity_dependent:
        seat = journal(model)
        N = complex(seat.coupling(theta, speed, eccentricity))
        # N (dz + exp(2 j phi) conj(dz)) = 2 N exp(j phi) Re(exp(-j phi) dz)
        column = 2 * N * np.exp(1j * attitude) * np.array([np.cos(attitude), np.sin(attitude)])
        real[0, seat.at, [seat.at, n + seat.at]] += column.real
        real[0, n + seat.at, [seat.at, n + seat.at]] += column.imag
    return real


def linear_test(
    model: RotorModel,
    theta: Float,
    *,
    speed: float,
    frequency: Float,
    along: str,
    noise: float = 0.0,
    seed: int = 0,
    force: complex = 5.0 * np.exp(0.4j),
    planes: Sequence[str] | None = None,
    gains: Mapping[tuple[str, str], float] | None = None,
) -> rf.PerturbationTest:
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
    return rf.perturbation_test(**{key: np.concatenate(parts) for key, parts in columns.items()}, source="linear")  # type: ignore[arg-type]
