"""A force along one axis that was read as a circular one.

``Re(F exp(jwt))`` along x is half of F forward and half of conj(F) backward. If the rotor is isotropic, the forward
parts of the orbits at +w and the backward parts at -w are then values of one rational function of w, its response, on
either side of w = 0. No circular force on an anisotropic rotor makes them that: there the numerator is another function
on either side.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from rotorfit.checks.orbits import ENOUGH, Orbits
from rotorfit.data.findings import Finding, listed
from rotorfit.estimators.noise.reading_noise import noise_from_smoothness
from rotorfit.models.array_types import ComplexArray, Float, Index

GENEROUS = 4.0
"""Values for each coefficient of a rational function that a verdict needs; fewer might follow anything."""

SHARE = (0.05, 0.95)
"""Share of the backward part between which a force along an axis keeps it; isotropic responses do not vary by more."""

AGREES = 1.5
"""Misfit over noise below which a function explains the readings: what the noise's own estimate leaves open."""


def linear_force(orbits: Orbits) -> Iterator[Finding]:
    """Runs that only a force along x or along y explains, though it was given as circular."""
    found: dict[str, set[str]] = {}
    if not _any_share(orbits):
        return
    modes = len({*orbits.plane.tolist(), *orbits.force_plane.tolist()})
    for (run, _, force_plane), at in orbits.groups("run", "speed", "force_plane"):
        planes = dict.fromkeys(orbits.plane[at].tolist())
        told = [_explains(orbits, at[orbits.plane[at] == plane], modes) for plane in planes]
        if True in told and False not in told:
            drive = at[orbits.plane[at] == force_plane]
            found.setdefault(_axis(orbits, drive if drive.size else at), set()).add(run)
    for axis, names in sorted(found.items()):
        runs = [run for run in dict.fromkeys(orbits.run.tolist()) if run in names]
        text = (
            f"Forward and backward answers in {listed(runs)} are those of an isotropic rotor to a force along {axis} "
            "that does not turn (a rotor some ten times stiffer along the other axis would look alike). Read as "
            f"circular it doubles every coefficient: give a column force_direction with {axis} in these rows."
        )
        yield Finding("error", "linear-force", text, orbits.rows_of(np.flatnonzero(np.isin(orbits.run, runs))))


def _any_share(orbits: Orbits) -> bool:
    """Whether orbits of any plane in any run turn so much against the force as a force along an axis makes them."""
    both, wrong = powers(orbits, orbits.right, orbits.wrong)
    return bool(((SHARE[0] * both < wrong) & (wrong < SHARE[1] * both)).any())


def powers(orbits: Orbits, right: ComplexArray, wrong: ComplexArray) -> tuple[Float, Float]:
    """Power of the orbits of each plane in each run, in all and against the force, shape ``(..., G)``."""
    if not orbits.paired.any():
        return np.zeros(1), np.zeros(1)
    along, against = (
        orbits.total(np.where(orbits.paired, np.abs(part) ** 2, 0.0), "run", "speed", "force_plane", "plane")
        for part in (right, wrong)
    )
    return along + against, against


def _explains(orbits: Orbits, at: Index, modes: int) -> bool | None:
    """Whether a force along an axis explains orbits of one plane in one run; ``None`` where they are too few."""
    at = at[np.isfinite(orbits.wrong[at])]
    w = np.abs(orbits.frequency[at])
    if np.unique(w).size < ENOUGH or np.unique(np.sign(orbits.frequency[at])).size > 1:
        return None
    right, wrong = orbits.right[at], orbits.wrong[at]
    share = np.sum(np.abs(wrong) ** 2) / np.sum(np.abs(wrong) ** 2 + np.abs(right) ** 2)
    if not SHARE[0] < share < SHARE[1]:
        return False
    ahead, behind, force = _halves(orbits, at)
    noise = np.hypot(*(noise_from_smoothness(w, part) for part in (orbits.x[at], orbits.y[at]))) / 2
    both = np.concatenate([w, -w])
    size = np.tile(2 * noise / np.abs(force), 2)
    # along y both halves are multiplied by j, which leaves a rational function one
    return _rational(both, np.concatenate([ahead, behind]), size, modes)


def _halves(orbits: Orbits, at: Index) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
    """Response at +w and at -w to the halves of a force along x, and the force's phasor."""
    backward = orbits.frequency[at] < 0
    right, wrong = orbits.right[at], orbits.wrong[at]
    force = np.where(backward, orbits.force[at].conj(), orbits.force[at])
    ahead, behind = np.where(backward, wrong, right), np.where(backward, right, wrong)
    return np.asarray(2 * ahead / force), np.asarray(2 * behind / force.conj()), np.asarray(force)


def _axis(orbits: Orbits, at: Index) -> str:
    """Axis of the force: damping, the part of kappa odd in w, is imaginary; taken along the other axis it is real."""
    ahead, behind, _ = _halves(orbits, at[np.isfinite(orbits.wrong[at])])
    some = (ahead != 0) & (behind != 0)
    ahead, behind = ahead[some], behind[some]
    odd = np.sum((1 / ahead - 1 / behind) * np.abs(ahead * behind))
    return "x" if abs(odd.imag) >= abs(odd.real) else "y"


def _rational(w: Float, values: ComplexArray, sigma: Float, modes: int) -> bool:
    """Whether the response of so many modes goes through values on either side of zero to within their noise.

    More modes than planes might follow an anisotropic rotor under a circular force as well.
    """
    u = w / np.abs(w).max()
    for poles in range(2, 2 * modes + 1, 2):
        unknowns = 2 * poles - 1
        if w.size < GENEROUS * unknowns:
            return False
        top = np.stack([u**k for k in range(poles - 1)], axis=1)
        bottom = np.stack([u**k for k in range(1, poles + 1)], axis=1)
        denominator = np.ones_like(values)
        for _ in range(8):  # the equation error is the response error times the denominator: divide by the last one
            weight = 1 / (denominator * sigma)
            design = np.hstack([top, -values[:, None] * bottom]) * weight[:, None]
            solution, *_ = np.linalg.lstsq(design, values * weight, rcond=None)
            denominator = 1 + bottom @ solution[poles - 1 :]
            denominator = np.where(denominator == 0, 1.0, denominator)
        miss = values - top @ solution[: poles - 1] / denominator
        chi = float(np.sum(np.abs(miss / sigma) ** 2) / (2 * (w.size - unknowns)))
        if chi < AGREES**2:
            return True
    return False
