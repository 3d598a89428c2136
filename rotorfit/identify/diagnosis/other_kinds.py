"""Errors in tests of other kinds: positions under constant loads, free vibration after a blow, imposed orbits."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from rotorfit.base.array_types import Bool, ComplexArray, Float, Index
from rotorfit.base.digits import significant
from rotorfit.base.units import RPM_PER_RAD_S
from rotorfit.identify.diagnosis.orbits import orbits_of, total_power
from rotorfit.identify.diagnosis.readings import rows_of
from rotorfit.identify.diagnosis.signs import AGAINST_SHARE, signs, turned
from rotorfit.lab.data.findings import Finding, listed
from rotorfit.lab.data.from_arrays import perturbation_test
from rotorfit.lab.data.linear_force import directional
from rotorfit.lab.data.ring_down import ring_down_modes
from rotorfit.lab.kinds.displacement_test import DisplacementTest
from rotorfit.lab.kinds.free_vibration import ImpulseTest, RingDownTest
from rotorfit.lab.kinds.static_test import StaticTest


def static_positions(test: StaticTest) -> Iterator[Finding]:
    """Rows without a load, and positions against the load or, by a fluid that turns backward, against the rotation.

    Under a load P a stable journal rests at P / (K - j D lam Omega): along the load and ahead of it in the sense of
    rotation where lam > 0.
    """
    idle = test.load == 0
    if idle.any():
        text = (
            f"The load is zero in {idle.sum()} rows. Positions count from that without a load: subtract it from the "
            "others and remove its row."
        )
        yield Finding("error", "no-load", text, rows_of(idle))
    turned = test.displacement * np.exp(-1j * np.angle(test.load))
    at_load = (test.plane == test.load_plane) & (test.load != 0)
    if back := _runs(test, at_load, turned.real):
        text = (
            f"The journal moves against the load in {listed(back)}. Check the direction of the load (load_deg, from x "
            "towards y), the signs of x and y, or x and y exchanged."
        )
        yield Finding("error", "against-load", text, rows_of(np.isin(test.run, back)))
    elif aside := _runs(test, at_load, turned.imag * np.sign(test.speed)):
        text = (
            f"Under load the journal moves to the side against the rotation in {listed(aside)}: lam would be negative. "
            "Check that x turns towards y with the rotor, the sign of x and y, or x and y exchanged."
        )
        yield Finding("warning", "against-rotation", text, rows_of(np.isin(test.run, aside)))


def _runs(test: StaticTest, at_load: Bool, part: Float) -> list[str]:
    """Runs in which a part of the positions is negative under every load and more than a share of them."""
    found = []
    fewest_loads = 3  # loads of a run from which their positions say a direction
    # Share of the positions that is more than noise and a probe a few degrees off, all loads agreeing
    largest_share_aside = 0.05
    for run in test.runs:
        here = at_load & (test.run == run)
        beyond = -float(part[here].sum()) > largest_share_aside * float(np.abs(test.displacement[here]).sum())
        if here.sum() >= fewest_loads and (part[here] < 0).all() and beyond:
            found.append(run)
    return found


def free_vibration(test: ImpulseTest | RingDownTest) -> Iterator[Finding]:
    """Records that show no mode, and frequencies in another unit than the speed."""
    if isinstance(test, RingDownTest):
        try:
            test, unit = ring_down_modes(test), "the time (time_s, time_ms)"
        except ValueError as error:
            yield Finding("error", "ring-down", f"A record of free vibration cannot be used: {error}.")
            return
    else:
        unit = "the frequency (frequency_rpm, frequency_hz)"
    ratio = np.abs(test.frequency) / np.where(test.speed == 0, np.nan, np.abs(test.speed))
    # Frequency of free vibration over the speed outside of which one of the two, or the time, has another unit
    frequency_ratios = 0.02, 50.0
    odd = np.flatnonzero((ratio < frequency_ratios[0]) | (ratio > frequency_ratios[1]))
    if odd.size:
        first, runs = int(odd[0]), list(dict.fromkeys(test.run[odd].tolist()))
        text = (
            f"Free vibration at {significant(abs(test.frequency[first]) * RPM_PER_RAD_S, 4)} cycles a minute, at a "
            f"speed of {significant(abs(test.speed[first]) * RPM_PER_RAD_S, 4)} rpm, in {listed(runs)}. Check the unit "
            f"of {unit}, or of the speed."
        )
        yield Finding("warning", "frequency-unit", text)


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
