"""Records of swept tests, integrated in time mode by mode: nothing of the frequency domain is used."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

ABSCISSAE, WEIGHTS = np.polynomial.legendre.leggauss(4)


@dataclass(frozen=True)
class Rotor:
    """Sums of modes ``q' = s q + f``, ``z = residues @ q``."""

    poles: np.ndarray  # (M,)
    residues: np.ndarray  # (P, M)

    def receptance(self, w: np.ndarray) -> np.ndarray:
        """Shape ``(P, W)``."""
        return self.residues @ (1 / (1j * w - self.poles[:, None]))

    def motion(self, force, rate: float, count: int) -> np.ndarray:
        """Motion from rest, ``(P, count)``; each step's integral by Gauss-Legendre quadrature, exact to round-off."""
        h = 1 / rate
        inside = (ABSCISSAE + 1) * h / 2
        start = np.arange(count - 1) * h
        forces = force(start[:, None] + inside)
        q = np.zeros((self.poles.size, count), complex)
        for k, s in enumerate(self.poles):
            step = forces @ (np.exp(s * (h - inside)) * WEIGHTS * h / 2)
            q[k, 1:] = lfilter([1.0], [1.0, -np.exp(s * h)], step)
        return self.residues @ q


def two_modes(speed: float = 157.0) -> Rotor:
    """A whirl-whip rotor at two planes: complex eigenvalues, one of them lightly damped."""
    mass = np.diag([0.9, 0.4])
    damping = np.diag([3.0, 450.0])
    stiffness = np.array([[30e3, -24e3], [-24e3, 40e3 - 450j * 0.475 * speed]])
    companion = np.block([[np.zeros((2, 2)), np.eye(2)], [-np.linalg.solve(mass, np.c_[stiffness, damping])]])
    poles, shapes = np.linalg.eig(companion)
    drive = np.linalg.solve(shapes, np.array([0, 0, 1 / 0.9, 0]))
    return Rotor(poles, shapes[:2] * drive)


@dataclass(frozen=True)
class Sweep:
    """A frequency that rises evenly, with a wobble: angle, its derivatives and the force of a turning mass."""

    first: float
    last: float
    duration: float
    wobble: float = 0.03
    mr: float = 2e-5

    def angle(self, t: np.ndarray) -> np.ndarray:
        slope = (self.last - self.first) / self.duration
        return self.first * t + slope * t**2 / 2 + self.wobble * np.sin(7.0 * t)

    def speed(self, t: np.ndarray) -> np.ndarray:
        return self.first + (self.last - self.first) / self.duration * t + 7.0 * self.wobble * np.cos(7.0 * t)

    def acceleration(self, t: np.ndarray) -> np.ndarray:
        return (self.last - self.first) / self.duration - 49.0 * self.wobble * np.sin(7.0 * t)

    def force(self, t: np.ndarray) -> np.ndarray:
        return self.mr * (self.speed(t) ** 2 - 1j * self.acceleration(t)) * np.exp(1j * self.angle(t))
