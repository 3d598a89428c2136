"""Motion of a linear rotor under any force in time, mode by mode and exact to round-off at a constant speed.

``x' = A x + B f`` falls apart into modes ``q' = s q + b f``; over a step of h the solution is
``q(t + h) = exp(s h) q(t) + int exp(s (h - u)) b f(t + u) du``, the integral by Gauss-Legendre quadrature with four
points, whose error for a force of frequency w is of the order ``(w h)^8 / 10^7``. Where the speed changes and the rotor
with it, the coefficients are those of the middle of a block, which is the shorter the faster the speed changes.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from rotorfit.models import RotorModel
from rotorfit.models.array_types import ComplexArray, Float

_POINTS, _WEIGHTS = np.polynomial.legendre.leggauss(4)


def linear_path(
    model: RotorModel,
    theta: Float,
    *,
    speed: Callable[[Float], Float],
    force: Callable[[Float], ComplexArray],
    rate: float,
    count: int,
) -> ComplexArray:
    """Displacements of all coordinates at equally spaced times, starting from rest, shape ``(count, n)``."""
    from scipy.signal import lfilter

    h, n = 1 / rate, len(model.coordinates)
    inside = (_POINTS + 1) * h / 2
    speeds = speed(np.arange(count, dtype=float) * h)
    change = np.abs(np.diff(speeds)).max(initial=0.0) if model.speed_dependent else 0.0
    # Share of the speed by which it may change within a block, whose coefficients are those of its middle
    speed_change = 1e-4
    block = int(np.clip(speed_change * np.abs(speeds).max() / change, 64, 1 << 15)) if change else 1 << 15
    path = np.zeros((count, n), dtype=complex)
    state = np.zeros(2 * n, dtype=complex)
    for first in range(0, count - 1, block):
        last = min(first + block, count - 1)
        start = np.arange(first, last, dtype=float) * h
        s, shapes, drive = _modes(model, theta, float(speed(np.array([(first + last) / 2 * h]))[0]))
        forces = force((start[:, None] + inside).ravel()).reshape(start.size, 4, n) @ drive.T
        kernel = np.exp(s * (h - inside[:, None])) * (_WEIGHTS * h / 2)[:, None]
        steps = np.einsum("tkm,km->tm", forces, kernel)
        q = np.linalg.solve(shapes, state)
        motion = np.empty((start.size, s.size), dtype=complex)
        for m, growth in enumerate(np.exp(s * h)):
            motion[:, m] = lfilter([1.0], [1.0, -growth], steps[:, m], zi=[growth * q[m]])[0]
        states = motion @ shapes.T
        path[first + 1 : last + 1] = states[:, :n]
        state = states[-1]
    return path


def _modes(model: RotorModel, theta: Float, speed: float) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
    """Eigenvalues, right eigenvectors of displacements and velocities, and what a force gives each mode."""
    stiffness, damping, mass = model.coefficients(theta, speed)
    n = mass.shape[0]
    companion = np.zeros((2 * n, 2 * n), dtype=complex)
    companion[:n, n:] = np.eye(n)
    companion[n:] = -np.linalg.solve(mass, np.hstack([stiffness, damping]))
    s, shapes = np.linalg.eig(companion)
    drive = np.linalg.solve(shapes, np.vstack([np.zeros((n, n)), np.linalg.inv(mass)]))
    return s, shapes, drive
