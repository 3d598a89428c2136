"""Beyond the onset of instability: the circular whirl that the rotor keeps up by itself, from whirl to whip.

A journal that circles with the eccentricity eps sees constant coefficients, hence the orbit is exact where
``kappa(jw, Om, eps)`` is singular at a real w: eps and w follow from the speed.

A small motion about the orbit, ``z = (Z + zeta(t)) exp(jwt)``, changes the eccentricity by ``Re(zeta_b)/clearance`` and
the coefficients with it, which couples zeta and its conjugate as a static eccentricity does. One eigenvalue of that is
zero, as an orbit may be shifted in time; the others tell whether the orbit is stable.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from rotorfit.base.array_types import Bool, ComplexArray, Float
from rotorfit.base.equality import ByValue
from rotorfit.models.model import RotorModel
from rotorfit.models.motion.journal import journal
from rotorfit.models.motion.stability import roots, threshold_speed
from rotorfit.models.shafts.turning import shifted_sides

LARGEST_WHIRL = 0.97
"""Eccentricity up to which a whirl is followed; laws that grow without limit mean little beyond."""


@dataclass(frozen=True, eq=False, kw_only=True)
class WhirlBranch(ByValue):
    """Self-excited circular orbits from the onset on.

    Attributes:
        eccentricity: orbit radius of the journal over clearance, from zero on, ``(E,)`` like all but the last two.
        speed: rotative speed at which the journal circles so, rad/s.
        frequency: of the whirl, rad/s, signed.
        stable: whether small disturbances of the orbit die out.
        orbit: complex deflection of each coordinate, m, that of the journal real, shape ``(E, n)``.
        gradient: derivatives of speed, rad/s, and eccentricity by the parameters, at right angles to the branch where
            the onset and the clearance are of one length, shape ``(E, 2, P)``.
    """

    eccentricity: Float
    speed: Float
    frequency: Float
    stable: Bool
    orbit: ComplexArray
    gradient: Float


def whirl_branch(model: RotorModel, theta: ArrayLike, *, max_speed: float | None = None) -> WhirlBranch | None:
    """Follow the whirl that begins at the threshold speed, by its arc length, round folds where there are any.

    Args:
        model: a rotor with a law of eccentricity.
        theta: parameter vector, shape ``(P,)``.
        max_speed: speed beyond which it is not followed, rad/s; by default ten times the threshold.

    Returns:
        the branch, up to ``LARGEST_WHIRL`` or ``max_speed``; None for a rotor that is stable up to there.

    Raises:
        ValueError: a rotor whose fluid does not change with eccentricity, x and y apart, or a known structure.
    """
    if not model.eccentricity_dependent:
        raise ValueError(f"{model.name} as used here grows without limit beyond the onset; give it a law")
    if model.shaft is not None:
        raise ValueError(f"the whirl of {model.name} beyond the onset is not followed: its structure has no polynomial")
    seat, values = journal(model), np.asarray(theta, dtype=float)
    onset = threshold_speed(model, values)
    top = math.inf if max_speed is None else max_speed
    if onset is None or not onset.speed > 0 or onset.speed > top:
        return None
    top = 10 * onset.speed if max_speed is None else max_speed
    scale = np.array([abs(onset.whirl_frequency), onset.speed, 1.0])
    here = _Point(model, values, np.array([onset.whirl_frequency, onset.speed, 0.0]), scale, seat.at)
    points, along, stride = [here], here.tangent(np.array([0.0, 0.0, 1.0])), 0.01
    most = 2000  # points
    least_stride, largest_stride = 1e-6, 0.02  # arc lengths, in units of the onset and the clearance
    while len(points) < most and stride > least_stride:
        found = here.ahead(along, stride)
        if found is None or found.x[2] < 0:
            stride /= 2
            continue
        if found.x[2] > LARGEST_WHIRL or not 0 < found.x[1] <= top:
            break
        along, here = found.tangent(along), found
        points.append(here)
        stride = min(1.3 * stride, largest_stride)
    return WhirlBranch(
        eccentricity=np.array([p.x[2] for p in points]),
        speed=np.array([p.x[1] for p in points]),
        frequency=np.array([p.x[0] for p in points]),
        stable=np.array([p.is_stable() for p in points]),
        orbit=np.array([p.shape * p.x[2] * seat.clearance for p in points]),
        gradient=np.array([p.normal() for p in points]),
    )


class _Point:
    """Frequency, speed and eccentricity ``x``, and the smallest singular value there; with its vectors held, ``u kappa
    v`` has the derivatives of the singularity."""

    def __init__(self, model: RotorModel, theta: Float, x: Float, scale: Float, at: int) -> None:
        self.model, self.theta, self.x, self.scale, self.at = model, theta, x, scale, at
        w, speed, eps = x.tolist()
        self.coefficients = model.coefficients(theta, speed, eps)
        orders = np.arange(len(self.coefficients))
        powers = (1j * w) ** orders
        left, sizes, right = np.linalg.svd(np.einsum("k,kij->ij", powers, self.coefficients))
        u, v = left[:, -1].conj(), right[-1].conj()
        self.miss = float(sizes[-1])
        self.size = float(np.abs(powers) @ np.abs(self.coefficients).max(axis=(1, 2)))
        self.shape = v / v[at]
        jacobian = model.functions.jacobian(theta, speed, eps)
        part = powers[jacobian.powers] * jacobian.values
        by_input = np.zeros(theta.size + 2, dtype=complex)
        np.add.at(by_input, jacobian.inputs, part * u[jacobian.rows] * v[jacobian.columns])
        by_w = 1j * (u @ np.einsum("k,kij->ij", orders[1:] * powers[:-1], self.coefficients[1:]) @ v)
        by_x = np.array([by_w, *by_input[-2:]]) * scale
        self.slope = np.stack([by_x.real, by_x.imag])
        self.by_theta = np.stack([by_input[:-2].real, by_input[:-2].imag])
        changes = (jacobian.inputs == theta.size + 1) & (jacobian.rows == at) & (jacobian.columns == at)
        self.coupling = complex(part[changes].sum()) * eps / 2

    def tangent(self, before: Float) -> Float:
        """Direction of the branch, in units of the scale, on from the one before."""
        direction = np.linalg.svd(self.slope)[2][-1]
        return np.asarray(direction if direction @ before >= 0 else -direction)

    def normal(self) -> Float:
        """Derivatives of speed and eccentricity, at right angles to the branch, by the parameters, shape ``(2, P)``."""
        along = np.linalg.svd(self.slope)[2][-1] * [0.0, 1.0, 1.0]
        system = np.vstack([self.slope, along])
        right = np.vstack([-self.by_theta, np.zeros(self.theta.size)])
        return np.asarray((np.linalg.lstsq(system, right, rcond=None)[0] * self.scale[:, None])[1:])

    def ahead(self, along: Float, stride: float) -> _Point | None:
        """The point of the branch a stride ahead, by Newton across the branch; None where it does not settle."""
        x = self.x + stride * along * self.scale
        for _ in range(12):
            if not 0 <= x[2] < 1 or not x[1] > 0:
                return None
            point = _Point(self.model, self.theta, x, self.scale, self.at)
            if point.miss <= 1e-11 * point.size:
                return point
            system = np.vstack([point.slope, along])
            step = np.linalg.lstsq(system, np.array([-point.miss, 0.0, 0.0]), rcond=None)[0]
            if np.abs(step).max() > 0.5:
                return None
            x = x + step * self.scale
        return None

    def is_stable(self) -> bool:
        """True if all small motions about the orbit die out but the one along it."""
        C, w, at = self.coefficients, float(self.x[0]), self.at
        n = C.shape[-1]
        away = 0.5 * abs(w)  # the polynomial is written about a point that is no eigenvalue, as zero is one
        turning = shifted_sides(C, np.asarray(away + 1j * w))
        for row, value in ((at, self.coupling), (n + at, self.coupling.conjugate())):
            turning[0, row, [at, n + at]] += value
        s = roots(turning)
        s = s[np.isfinite(s)] + away
        others = np.delete(s, np.argmin(np.abs(s)))
        return bool((others.real < 1e-9 * abs(w)).all())
