"""Responses that vanish towards zero frequency: no displacements of a rotor on a stiffness under forces as told.

At w = 0 a rotor answers a force as its stiffness asks, ``1 / (K - j D lam Om)`` for one mode, forward and backward
alike. Velocities go to zero as j w there, accelerations as -w^2, and so do responses to an
unbalance told as a constant force.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from rotorfit.checks.orbits import Orbits
from rotorfit.data.findings import Finding, listed
from rotorfit.models.array_types import ComplexArray, Float

_WINDOWS = 0.35, 0.25, 0.15, 0.1  # shares of the highest frequency up to which lines count as near zero
_FEWEST = 12
_PASSES = 4
_STATIC = 0.15  # response at zero over that in the window, from which there is one
_EXPLAINED = 0.03  # share of the power that a parabola may leave
_TURNED = 0.1  # cosine of its angle from which the sign of a term is plain: a fluid turns it by up to a right angle


def static_limit(orbits: Orbits) -> Iterator[Finding]:
    """Drive points whose response vanishes towards zero frequency, at every speed and in all runs."""
    if orbits.speed.size and np.allclose(np.abs(orbits.frequency), np.abs(orbits.speed)):
        return  # synchronous: every line has a stiffness of its own
    found: dict[str, list[int]] = {}
    for (plane, _, force_plane), at in orbits.groups("plane", "speed", "force_plane"):
        if plane != force_plane:
            continue
        power = _power(orbits.frequency[at], orbits.right[at] / orbits.force[at], np.abs(orbits.force[at]))
        if power is not None:
            found.setdefault(plane, []).append(power)
    powers = {power for own in found.values() for power in own}
    if len(powers) == 1 and (power := powers.pop()):
        text = (
            f"Under forces at {listed(list(found))} responses vanish towards zero frequency, {_TOLD[power]} At zero "
            "frequency a rotor answers a force as its stiffness asks."
        )
        yield Finding("warning", "no-static-response", text)


_TOLD = {
    1: "in proportion to j w: they are velocities told as displacements, or behind a high-pass (AC-coupled channels).",
    -2: "in proportion to -w^2: they are accelerations told as displacements.",
    2: "in proportion to w^2: the forces may be those of an unbalance told as constant (mr_g_mm in place of force_N).",
}


def _power(w: Float, H: ComplexArray, force: Float) -> int | None:
    """Power of jw with which a response begins at zero frequency, -2 for -w^2 and 2 for w^2; 0 where it has a static
    part, None where nothing is told."""
    size = np.abs(w)
    told = (
        _power_within(w[near], H[near], force[near])
        for share in _WINDOWS
        if (near := size <= share * size.max()).sum() >= _FEWEST
    )
    return next((power for power in told if power is not None), None)


def _power_within(w: Float, H: ComplexArray, force: Float) -> int | None:
    """What :func:`_power` answers for one window, from a response with one resonance:
    ``H = (n0 + n1 u + n2 u^2) / (1 + d1 u + d2 u^2)``."""
    if not H.any() or not w.any():
        return None  # a dead probe, or no sweep: said by others
    u = w / np.abs(w).max()
    powers = u[:, None] ** np.arange(3)
    weight = force / force.max()  # of readings with equal noise
    below = np.ones(w.size, dtype=complex)
    for _ in range(_PASSES):  # each weighed by what the denominator was before
        own = (weight / np.abs(below))[:, None]
        design = own * np.hstack([powers, -H[:, None] * powers[:, 1:]])
        terms = np.linalg.lstsq(design, own[:, 0] * H, rcond=None)[0]
        below = 1 + powers[:, 1:] @ terms[3:]
    left = weight * (H - powers @ terms[:3] / below)
    power, lost = (float(np.vdot(part, part).real) for part in (weight * H, left))
    if lost > _EXPLAINED * power:
        return None
    lowest = np.abs(u) <= np.median(np.abs(u))
    level = float(np.median(np.abs(powers @ terms[:3] / below)[lowest]))  # near zero, not at a resonance
    if not level > 0:
        return None
    static, first, second = terms[:3] / level
    variance = lost / (w.size - 5) * np.linalg.pinv(design.conj().T @ design)[0, 0].real
    error = np.sqrt(variance) / level
    if abs(static) + 2 * error > _STATIC:
        return 0 if abs(static) - 2 * error > _STATIC else None
    first *= np.median(np.abs(u))
    if abs(first) > _STATIC:
        return 1 if first.imag > _TURNED * abs(first) and abs(first) > 2 * _STATIC else None
    return (2 if second.real > 0 else -2) if abs(second.real) > _TURNED * abs(second) else None
