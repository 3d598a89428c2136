"""Errors in tests that impose orbits."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from rotorfit.base.array_types import ComplexArray, Index
from rotorfit.identify.diagnosis.orbits import orbits_of, total_power
from rotorfit.identify.diagnosis.signs import AGAINST_SHARE, signs, turned
from rotorfit.lab.data.findings import Finding, listed, rows_of
from rotorfit.lab.data.from_arrays import perturbation_test
from rotorfit.lab.data.linear_force import directional
from rotorfit.lab.kinds.displacement_test import DisplacementTest


def imposed_orbits(test: DisplacementTest) -> Iterator[Finding]:
    """Orbits of no size, forces that turn against the orbit, and forces that drive it where they must resist."""
    still = test.displacement == 0
    if still.any():
        text = f"The imposed orbit is zero in {still.sum()} rows; remove them, they have no dynamic stiffness."
        yield Finding("error", "no-orbit", text, rows_of(still))
    if not still.all():
        moved = np.flatnonzero(~still)
        yield from (finding.at_rows(moved) for finding in _turning(test.select(moved)))


def _turning(test: DisplacementTest) -> Iterator[Finding]:
    count, backward = len(test), test.frequency < 0
    pairs = np.stack([np.arange(count), count + np.arange(count), np.full(count, -1)], axis=1)
    along, against = directional(np.concatenate([test.force_x, test.force_y]), pairs, backward)
    mine = {run: test.run == run for run in test.runs}
    power = {run: [total_power(part[own]) for part in (along, against)] for run, own in mine.items()}
    wrong = [run for run, (right, other) in power.items() if other > AGAINST_SHARE * (right + other)]
    if wrong:
        text = (
            f"The force turns mostly against the imposed orbit, in {listed(wrong)}. Check x and y of the force "
            "exchanged, one of the two inverted, phases of lag read as lead, or the sign of the frequency."
        )
        yield Finding("error", "wrong-direction", text, rows_of(np.isin(test.run, wrong)))
        return
    torn = np.zeros(count, dtype=bool)
    for own in mine.values():
        torn[own] = turned(along[own], against[own])
    if torn.any():
        runs = listed(tuple(dict.fromkeys(test.run[torn].tolist())))
        text = (
            f"In {torn.sum()} lines the force turns against the imposed orbit, in the others of the same runs along "
            f"it, and nowhere between the two: {runs}. Check the sign of the frequency in these lines, and those of "
            "the forces."
        )
        yield Finding("error", "turned-lines", text, rows_of(torn))
        return
    driven = np.flatnonzero(along)
    moved = np.where(backward, test.displacement.conj(), test.displacement)[driven] / along[driven]
    yield from _signs(test.select(driven), moved, driven)


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
