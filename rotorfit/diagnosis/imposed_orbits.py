"""Slips of sign and direction in tests where an orbit is imposed and the forces are measured."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from rotorfit.data.experiments import DisplacementTest, perturbation_test
from rotorfit.data.findings import Finding, listed
from rotorfit.data.linear_force import directional
from rotorfit.diagnosis.orbits import orbits_of
from rotorfit.diagnosis.signs import AGAINST_SHARE, signs, turned
from rotorfit.models.array_types import ComplexArray, Index


def imposed_orbits(test: DisplacementTest) -> Iterator[Finding]:
    """Orbits of no size, forces that turn against the orbit, and forces that drive it where they must resist."""
    still = np.flatnonzero(test.displacement == 0)
    if still.size:
        text = f"The imposed orbit is zero in {still.size} rows; remove them, they have no dynamic stiffness."
        yield Finding("error", "no-orbit", text, tuple(still.tolist()))
    moved = np.flatnonzero(test.displacement)
    if not moved.size:
        return
    for finding in _turning(test.select(moved)):
        yield finding.at_rows(moved)


def _turning(test: DisplacementTest) -> Iterator[Finding]:
    count, backward = len(test), test.frequency < 0
    pairs = np.stack([np.arange(count), count + np.arange(count), np.full(count, -1)], axis=1)
    along, against = directional(np.concatenate([test.force_x, test.force_y]), pairs, backward)
    wrong = [run for run in test.runs if _mostly_against(along[test.run == run], against[test.run == run])]
    if wrong:
        text = (
            f"The force turns mostly against the imposed orbit, in {listed(wrong)}. Check x and y of the force "
            "exchanged, one of the two inverted, phases of lag read as lead, or the sign of the frequency."
        )
        yield Finding("error", "wrong-direction", text, tuple(np.flatnonzero(np.isin(test.run, wrong)).tolist()))
        return
    torn = np.zeros(count, dtype=bool)
    for run in test.runs:
        torn[test.run == run] = turned(along[test.run == run], against[test.run == run])
    if torn.any():
        runs = listed(tuple(dict.fromkeys(test.run[torn].tolist())))
        text = (
            f"In {torn.sum()} lines the force turns against the imposed orbit, in the others of the same runs along "
            f"it, and nowhere between the two: {runs}. Check the sign of the frequency in these lines, and those of "
            "the forces."
        )
        yield Finding("error", "turned-lines", text, tuple(np.flatnonzero(torn).tolist()))
        return
    driven = np.flatnonzero(along)
    moved = np.where(backward, test.displacement.conj(), test.displacement)[driven] / along[driven]
    yield from _signs(test.select(driven), moved, driven)


def _mostly_against(along: ComplexArray, against: ComplexArray) -> bool:
    both, wrong = (float(np.sum(np.abs(part) ** 2)) for part in (np.concatenate([along, against]), against))
    return wrong > AGAINST_SHARE * both


def _signs(test: DisplacementTest, response: ComplexArray, rows: Index) -> Iterator[Finding]:
    """Signs of the dynamic stiffness, as of a test with a force of 1 N at the plane of the orbit."""
    forced = perturbation_test(
        run=test.run,
        speed=test.speed,
        frequency=test.frequency,
        force_plane=test.plane,
        force=1.0,
        plane=test.plane,
        direction="z",
        response=response,
    )
    for found in signs(orbits_of(forced, np.arange(len(forced)))):
        if found.code == "conjugated":
            runs = tuple(dict.fromkeys(test.run[list(found.rows)].tolist()))
            text = (
                "Damping would be negative (quadrature dynamic stiffness falls with frequency) in "
                f"{listed(runs)}: the forces are those of the rotor on what surrounds it, with the other sign, or "
                "phases of lag were read as lead."
            )
            yield Finding(found.severity, "negative-damping", text, found.rows).at_rows(rows)
        else:
            yield found.at_rows(rows)
