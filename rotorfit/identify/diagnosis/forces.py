"""Forces along one axis and forces that turn, the one read as the other.

``Re(F exp(jwt))`` along x is half of F forward and half of conj(F) backward. If the rotor is isotropic, the forward
parts of the orbits at +w and the backward parts at -w are then values of one rational function of w, its response, on
either side of w = 0. No circular force on an anisotropic rotor makes them that: there the numerator is another function
on either side. And a force along an axis drives a rotor forward and backward at once: what answers to one of the two
alone, at most frequencies, was driven by a force that turns.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from rotorfit.base.array_types import ComplexArray, Float, Index
from rotorfit.base.digits import significant
from rotorfit.estimators.noise.sweep_noise import noise_from_smoothness
from rotorfit.estimators.signals.ratios import best_ratio
from rotorfit.identify.diagnosis.orbits import FEWEST_READINGS, Orbits, enough, total_power
from rotorfit.identify.diagnosis.probe_pairs import LARGEST_REDCHI
from rotorfit.lab.data.experiments import PerturbationTest
from rotorfit.lab.data.findings import Finding, listed, rows_of
from rotorfit.lab.data.linear_force import probe_pairs

BACKWARD_SHARES = (0.05, 0.95)
"""Share of the backward part between which a force along an axis keeps it; isotropic responses do not vary by more."""


def force_along_axis(orbits: Orbits) -> Iterator[Finding]:
    """Runs that only a force along x or along y explains, though it was given as circular."""
    found: dict[str, set[str]] = {}
    modes = len({*orbits.plane.tolist(), *orbits.force_plane.tolist()}) if orbits.paired.any() else 0
    for (run, _, force_plane), at in orbits.groups("run", "speed", "force_plane") if modes else ():
        planes = dict.fromkeys(orbits.plane[at].tolist())
        explained = [_explains(orbits, at[orbits.plane[at] == plane], modes) for plane in planes]
        if True in explained and False not in explained:
            drive = at[orbits.plane[at] == force_plane]
            ahead, behind, _ = _halves(orbits, drive if drive.size else at)
            some = np.isfinite(ahead) & np.isfinite(behind) & (ahead != 0) & (behind != 0)
            ahead, behind = ahead[some], behind[some]
            # Damping, the part of kappa odd in w, is imaginary; taken along the other axis it is real.
            odd = np.sum((1 / ahead - 1 / behind) * np.abs(ahead * behind))
            found.setdefault("x" if abs(odd.imag) >= abs(odd.real) else "y", set()).add(run)
    for axis, names in sorted(found.items()):
        runs = [run for run in dict.fromkeys(orbits.run.tolist()) if run in names]
        text = (
            f"Forward and backward answers in {listed(runs)} are those of an isotropic rotor to a force along {axis} "
            "that does not turn (a rotor some ten times stiffer along the other axis would look alike). Read as "
            f"circular it doubles every coefficient: give a column force_direction with {axis} in these rows."
        )
        rows = orbits.rows_of(np.flatnonzero(np.isin(orbits.run, runs)))
        code, undo = "linear-force", f"force_direction {axis}"
        yield Finding("error", code, text, rows, remedy=undo, correction=code)


def exchanged_axes(test: PerturbationTest) -> Iterator[Finding]:
    """Forces along x and y whose plane moves as if its mass were negative in one direction and positive across it."""
    for plane in test.force_planes if test.linear.any() else ():
        elsewhere = np.array(
            [any(at != plane for at, *_ in acting) for acting in test.further_forces.tolist()], dtype=bool
        )
        own = np.flatnonzero(test.linear & (test.force_plane == plane) & (test.plane == plane) & ~elsewhere)
        pairs, _ = probe_pairs(test.select(own), np.ones(own.size, dtype=bool))
        if len(pairs) < 2 * FEWEST_READINGS:
            continue
        rows = own[pairs[:, 0]]
        amplitude = test.response[own[pairs]]
        force = np.zeros((rows.size, 2), dtype=complex)
        for k, row in enumerate(rows.tolist()):
            for _, size, along in test.acting(row):
                force[k, "xy".index(along)] += size
        power = np.sum(np.abs(force) ** 2, axis=0)
        mass = _moving_mass(test.frequency[rows], amplitude, force) if power.min() > 0.05 * power.max() else None
        if mass is None or not -2 < mass[0] / mass[1] < -0.5:
            continue
        across = abs(mass[2])
        what = "x and y are exchanged" if across > 0.5 * mass[1] else "one of x and y is inverted"
        text = (
            f"Under the forces at {plane} {significant(mass[1], 3)} kg move in one direction and "
            f"{significant(mass[0], 3)} kg across it, as no "
            f"body's do: {what}, either of the forces or of the probes. Check channels and cables of both."
        )
        yield Finding("error", "axes", text, rows_of(np.isin(np.arange(len(test)), own[pairs])))


def _moving_mass(w: Float, amplitude: ComplexArray, force: ComplexArray) -> tuple[float, float, float] | None:
    """Lesser and greater principal value of the inertia in ``F = (K + jw C - w^2 M) A``, kg, and its part that couples
    x with y; None where these matrices do not stand for the plane."""
    columns = np.hstack([amplitude, 1j * w[:, None] * amplitude, -(w[:, None] ** 2) * amplitude])
    design, wanted = np.vstack([columns.real, columns.imag]), np.vstack([force.real, force.imag])
    scale = np.linalg.norm(design, axis=0)
    design = design / np.where(scale > 0, scale, 1.0)
    found, _, rank, _ = np.linalg.lstsq(design, wanted, rcond=1e-8)
    poor = 0.1 * np.sum(wanted**2)  # power of the forces that is left, or that moves the mass
    inertia = (found / scale[:, None])[4:].T
    moving = np.sum(np.abs(columns[:, 4:] @ inertia.T) ** 2)
    if rank < design.shape[1] or np.sum((wanted - design @ found) ** 2) > poor or moving < poor:
        return None
    low, high = np.linalg.eigvalsh((inertia + inertia.T) / 2)
    return float(low), float(high), float(inertia[0, 1] + inertia[1, 0]) / 2


def turning_force(test: PerturbationTest) -> Iterator[Finding]:
    """Runs whose orbits turn one way throughout, though the force was given along an axis."""
    if not test.linear.any():
        return
    x, y = probe_pairs(test, test.linear)[0].T
    ahead = np.abs(test.response[x] + 1j * test.response[y]) ** 2
    behind = np.abs(test.response[x] - 1j * test.response[y]) ** 2
    turns: dict[str, bool] = {}
    # Share of the lesser half, in power, that is none: a rotor whose forward whirl hardly loses more than it gains
    # answers 30 times less backward only next to its resonance
    negligible_share = 1e-3
    for run, plane in dict.fromkeys(zip(test.run[x].tolist(), test.force_plane[x].tolist(), strict=True)):
        own = np.flatnonzero((test.run[x] == run) & (test.force_plane[x] == plane) & (ahead + behind > 0))
        if own.size >= FEWEST_READINGS:
            lesser, greater = sorted((ahead[own], behind[own]), key=np.sum)
            turns[run] = turns.get(run, True) and bool(np.median(lesser / (lesser + greater)) < negligible_share)
    found = [run for run, turning in turns.items() if turning]
    if found:
        text = (
            f"All orbits in {listed(found)} turn one way, as under a force that turns; one along an axis drives a "
            "rotor forward and backward at once. Leave force_direction out there, or write circular."
        )
        code, undo = "turning-force", "force_direction circular"
        yield Finding("error", code, text, rows_of(np.isin(test.run, found)), remedy=undo, correction=code)


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
    noise = math.hypot(*(noise_from_smoothness(w, part) for part in orbits.xy(at))) / 2
    some = enough(w.size)
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


def _rational(w: Float, values: ComplexArray, sigma: Float, modes: int) -> bool:
    """True if the response of so many modes goes through values on either side of zero to within their noise. More
    modes than planes might follow an anisotropic rotor under a circular force as well."""
    u = w / np.abs(w).max()
    # Values for each coefficient of a rational function that a verdict needs; fewer might follow anything
    lines_a_coefficient = 4.0
    for poles in range(2, 2 * modes + 1, 2):
        unknowns = 2 * poles - 1
        if w.size < lines_a_coefficient * unknowns:
            return False
        powers = np.asarray(np.polynomial.chebyshev.chebvander(u, poles), dtype=float)
        _, _, cost = best_ratio(values, sigma, powers, powers[:, : poles - 1])
        if cost / (w.size - unknowns) < LARGEST_REDCHI:
            return True
    return False
