"""Modes of a rotor at a speed: natural frequency, damping ratio, shape, mass and spring of its own."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rotorfit.base.array_types import ROUND_OFF, ComplexArray, Float
from rotorfit.base.equality import ByValue
from rotorfit.models.model import RotorModel
from rotorfit.models.motion.stability import eigenvalues, is_image, mode_vectors, seats, whirl_sense

OVERDAMPED = 0.99
"""Damping ratio from which a mode no longer oscillates and has no decrement."""


@dataclass(frozen=True, eq=False, kw_only=True)
class VibrationMode:
    """One mode; complex unless the rotor is passive, its stiffness and mass real and symmetric."""

    s: complex  # eigenvalue, 1/s; of a passive rotor that of the mode by itself, damping between the modes left out
    # deflection of each coordinate, shape ``(n,)``, normalised to one at the coordinate that was asked for
    shape: ComplexArray
    # of the mode by itself, ``shape^T M shape`` and so on, kg, N/m, N s/m; NaN of a rotor that is not passive
    mass: float = np.nan
    stiffness: float = np.nan
    damping: float = np.nan
    turn: float = 1.0  # -1 of a mode in x and y that whirls backward

    @property
    def frequency(self) -> float:
        """Natural frequency, rad/s: undamped of a passive rotor, else damped, and negative for backward whirl."""
        return abs(self.s) if np.isfinite(self.mass) else self.turn * self.s.imag

    @property
    def damping_ratio(self) -> float:
        """Share of critical damping."""
        return -self.s.real / abs(self.s)


def vibration_modes(model: RotorModel, theta: Float, speed: float, *, normalised_at: int = 0) -> list[VibrationMode]:
    """Modes by natural frequency, ascending."""
    coefficients = model.motion(theta, speed)
    if is_passive(model, coefficients):
        return _real_modes(model, coefficients.real, normalised_at)
    found = []
    for s in eigenvalues(model, theta, speed).tolist():
        if np.isfinite(s) and not is_image(model, theta, speed, s):
            shape = mode_vectors(coefficients, np.asarray(s))[1][seats(model)]
            backward = model.frame == "xy" and whirl_sense(model, theta, speed, np.array([s]))[0] < 0
            found.append(VibrationMode(s=s, shape=shape / shape[normalised_at], turn=-1.0 if backward else 1.0))
    return found


@dataclass(frozen=True, eq=False, kw_only=True)
class ModePairs(ByValue):
    """Eigenvalues with left and right modes, scaled so that the receptance is ``sum of right left^T / (j w - s)``.

    A right mode is the deflection that a probe sees; a left mode says how much a force at each coordinate drives it.

    Attributes:
        s: eigenvalues, 1/s, shape ``(m,)``.
        left: left modes, row by row, shape ``(m, n)``.
        right: right modes, row by row, shape ``(m, n)``.
    """

    s: ComplexArray
    left: ComplexArray
    right: ComplexArray


def mode_pairs(model: RotorModel, theta: Float, speed: float) -> ModePairs:
    """Left and right modes of a rotor at a speed; those of different eigenvalues are biorthogonal (Lancaster 1966),
    ``left_i (kappa(s_i) - kappa(s_j)) right_j = 0``. In ``z = x + jy`` isotropic fluids and gyroscopic moments leave
    matrices symmetric, and the two are one but for a factor; modal correction factors, and cross-coupling of x and y,
    make them differ: where a mode is best driven is then not where it is best seen.

    Args:
        model: the rotor; its modes have different eigenvalues.
        theta: parameter vector, shape ``(P,)``.
        speed: rotative speed, rad/s.

    Example:
        >>> rotor = rf.models.OneMode()
        >>> values = {"M": 2.0, "K": 1e5, "Ds": 50.0, "K0": 0.0, "D": 0.0, "lam": 0.0, "Mf": 0.0}
        >>> pairs = rf.models.mode_pairs(rotor, rotor.vector(values), 100.0)
        >>> pairs.s.round(1).tolist()
        [(-12.5-223.3j), (-12.5+223.3j)]
    """
    coefficients = model.motion(theta, speed)
    s = eigenvalues(model, theta, speed)
    s = s[np.isfinite(s)]
    left, right, slope = mode_vectors(coefficients, s)
    places = seats(model)
    return ModePairs(s=s, left=(left / slope[:, None])[:, places], right=right[:, places])


def is_passive(model: RotorModel, coefficients: ComplexArray) -> bool:
    """True if stiffness and mass are real and symmetric: modes are real, and share what each has of either."""
    n = len(model.planes)
    if model.frame != "z" or model.shaft is not None or len(coefficients) != 3 or coefficients.shape[-1] < n:
        return False
    own = coefficients[:, :n, :n]
    if len(model.coordinates) != len(model.read_planes):  # tilts turn with the gyroscope
        return False
    size = np.abs(own).max(axis=(1, 2), keepdims=True)
    real = bool((np.abs(own.imag) <= ROUND_OFF * size).all())
    even = bool((np.abs(own - own.swapaxes(1, 2))[[0, 2]] <= ROUND_OFF * size[[0, 2]]).all())
    return real and even and bool((np.linalg.eigvalsh(own[2].real) > 0).all())


def _real_modes(model: RotorModel, coefficients: Float, normalised_at: int) -> list[VibrationMode]:
    n = len(model.planes)
    K, D, M = coefficients[:, :n, :n]
    root = np.linalg.inv(np.linalg.cholesky(M))
    found = []
    for column in np.linalg.eigh(root @ K @ root.T)[1].T:
        own = root.T @ column
        between = [sum(share * own[model.planes.index(p)] for p, share in shares) for _, shares in model.probes]
        shape = np.concatenate([own, between])
        shape, own = shape / shape[normalised_at], own / shape[normalised_at]
        mass, stiffness, damping = (float(own @ part @ own) for part in (M, K, D))
        decay = damping / (2 * mass)
        s = -decay + np.emath.sqrt(decay**2 - stiffness / mass)
        ratio = decay / np.sqrt(stiffness / mass) if stiffness > 0 else np.nan
        if 0 <= abs(ratio) < 1:
            s = complex(-decay, np.sqrt(stiffness / mass - decay**2))
        found.append(VibrationMode(s=complex(s), shape=shape, mass=mass, stiffness=stiffness, damping=damping))
    return found


def modal_assurance(one: ComplexArray, other: ComplexArray) -> float:
    """Modal assurance criterion of two shapes ``(n,)``: 1 where they are alike but for a factor, 0 at right angles."""
    return float(np.abs(np.vdot(one, other)) ** 2 / (np.vdot(one, one).real * np.vdot(other, other).real))
