"""Forces along one axis and forces that turn, the one read as the other.

``Re(F exp(jwt))`` along x is half of F forward and half of conj(F) backward. If the rotor is isotropic, the forward
parts of the orbits at +w and the backward parts at -w are then values of one rational function of w, its response, on
either side of w = 0. No circular force on an anisotropic rotor makes them that: there the numerator is another function
on either side. And a force along an axis drives a rotor forward and backward at once: what answers to one of the two
alone, at most frequencies, was driven by a force that turns.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from rotorfit.data.experiments import PerturbationTest
from rotorfit.data.findings import Finding, listed
from rotorfit.data.linear_force import probe_pairs
from rotorfit.diagnosis.orbits import FEWEST_READINGS, Orbits, total_power
from rotorfit.diagnosis.probe_pairs import LARGEST_REDCHI
from rotorfit.estimators.noise.reading_noise import noise_from_smoothness
from rotorfit.estimators.signals.ratios import best_ratio
from rotorfit.models.array_types import ComplexArray, Float, Index

_LINES_A_COEFFICIENT = 4.0
"""Values for each coefficient of a rational function that a verdict needs; fewer might follow anything."""

BACKWARD_SHARES = (0.05, 0.95)
"""Share of the backward part between which a force along an axis keeps it; isotropic responses do not vary by more."""

_NEGLIGIBLE_SHARE = 1e-3
"""Share of the lesser half, in power, that is none: a rotor whose forward whirl hardly loses more than it gains answers
30 times less backward only next to its resonance."""


def force_along_axis(orbits: Orbits) -> Iterator[Finding]:
    """Runs that only a force along x or along y explains, though it was given as circular."""
    found: dict[str, set[str]] = {}
    modes = len({*orbits.plane.tolist(), *orbits.force_plane.tolist()}) if orbits.paired.any() else 0
    for (run, _, force_plane), at in orbits.groups("run", "speed", "force_plane") if modes else ():
        planes = dict.fromkeys(orbits.plane[at].tolist())
        explained = [_explains(orbits, at[orbits.plane[at] == plane], modes) for plane in planes]
        if True in explained and False not in explained:
            drive = at[orbits.plane[at] == force_plane]
            found.setdefault(_axis(orbits, drive if drive.size else at), set()).add(run)
    for axis, names in sorted(found.items()):
        runs = [run for run in dict.fromkeys(orbits.run.tolist()) if run in names]
        text = (
            f"Forward and backward answers in {listed(runs)} are those of an isotropic rotor to a force along {axis} "
            "that does not turn (a rotor some ten times stiffer along the other axis would look alike). Read as "
            f"circular it doubles every coefficient: give a column force_direction with {axis} in these rows."
        )
        rows = orbits.rows_of(np.flatnonzero(np.isin(orbits.run, runs)))
        yield Finding("error", "linear-force", text, rows, undo=f"force_direction {axis}")


def turning_force(test: PerturbationTest) -> Iterator[Finding]:
    """Runs whose orbits turn one way throughout, though the force was given along an axis."""
    if not test.linear.any():
        return
    x, y = probe_pairs(test, test.linear)[0].T
    ahead = np.abs(test.response[x] + 1j * test.response[y]) ** 2
    behind = np.abs(test.response[x] - 1j * test.response[y]) ** 2
    turns: dict[str, bool] = {}
    for run, plane in dict.fromkeys(zip(test.run[x].tolist(), test.force_plane[x].tolist(), strict=True)):
        own = np.flatnonzero((test.run[x] == run) & (test.force_plane[x] == plane) & (ahead + behind > 0))
        if own.size >= FEWEST_READINGS:
            lesser, greater = sorted((ahead[own], behind[own]), key=np.sum)
            turns[run] = turns.get(run, True) and bool(np.median(lesser / (lesser + greater)) < _NEGLIGIBLE_SHARE)
    found = [run for run, turning in turns.items() if turning]
    if found:
        text = (
            f"All orbits in {listed(found)} turn one way, as under a force that turns; one along an axis drives a "
            "rotor forward and backward at once. Leave force_direction out there, or write circular."
        )
        rows = tuple(np.flatnonzero(np.isin(test.run, found)).tolist())
        yield Finding("error", "turning-force", text, rows, undo="force_direction circular")


def _explains(orbits: Orbits, at: Index, modes: int) -> bool | None:
    """True if a force along an axis explains orbits of one plane in one run; ``None`` where they are too few."""
    at = at[np.isfinite(orbits.wrong[at])]
    w = np.abs(orbits.frequency[at])
    if np.unique(w).size < FEWEST_READINGS or np.unique(np.sign(orbits.frequency[at])).size > 1:
        return None
    against, along = total_power(orbits.wrong[at]), total_power(orbits.right[at])
    if not BACKWARD_SHARES[0] * (along + against) < against < BACKWARD_SHARES[1] * (along + against):
        return False
    ahead, behind, force = _halves(orbits, at)
    noise = np.hypot(*(noise_from_smoothness(w, part) for part in (orbits.x[at], orbits.y[at]))) / 2
    some = slice(None, None, -(-w.size // 5000))  # so many lines are enough for a verdict
    size = np.tile((2 * noise / np.abs(force))[some], 2)
    # along y both halves are multiplied by j, which leaves a rational function one
    return _rational(np.concatenate([w[some], -w[some]]), np.concatenate([ahead[some], behind[some]]), size, modes)


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
    """True if the response of so many modes goes through values on either side of zero to within their noise. More
    modes than planes might follow an anisotropic rotor under a circular force as well."""
    u = w / np.abs(w).max()
    for poles in range(2, 2 * modes + 1, 2):
        unknowns = 2 * poles - 1
        if w.size < _LINES_A_COEFFICIENT * unknowns:
            return False
        powers = np.asarray(np.polynomial.chebyshev.chebvander(u, poles), dtype=float)
        _, _, cost = best_ratio(values, sigma, powers, powers[:, : poles - 1])
        if cost / (w.size - unknowns) < LARGEST_REDCHI:
            return True
    return False
