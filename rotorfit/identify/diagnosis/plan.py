"""Gaps in the plan of a test, and odd speeds and frequencies."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from rotorfit.base.digits import counted, significant
from rotorfit.base.units import RPM_PER_RAD_S
from rotorfit.estimators.blocks.row_keys import rows_by
from rotorfit.estimators.signals.ring_down import fit_ramp
from rotorfit.identify.diagnosis.orbits import SYNCHRONOUS_DISTANCE
from rotorfit.lab.data.experiments import PerturbationTest, plane_groups
from rotorfit.lab.data.findings import Finding, listed, rows_of
from rotorfit.lab.data.rows import Experiment
from rotorfit.lab.data.synchronous import DIFFERENCED
from rotorfit.lab.data.weights import Influences, solved_together

_ONE = np.array([1.0, 60.0, RPM_PER_RAD_S])
"""One rpm, Hz and rad/s in rpm."""


def plan(test: Experiment) -> Iterator[Finding]:
    """Speeds, frequencies, planes and start-ups that a fit can do less with, which is no error."""
    try:
        influences = solved_together(test)
    except ValueError:  # a fit says why; what else is odd about the test is worth knowing
        influences = None
    yield from _filled(test)
    yield from _units(test)
    yield from _frequencies(test, influences)
    if (responses := test.perturbation) is not None:
        yield from _planes(responses)
        if responses.synchronous:
            yield from _start_ups(responses, influences)
            yield from _ramps(responses)


def _filled(test: Experiment) -> Iterator[Finding]:
    """Speeds that rise by one from row to row, as where a spreadsheet continued a number downwards."""
    step = np.diff(test.speed) * RPM_PER_RAD_S
    if not step.any():
        return
    inside = (test.run[1:] == test.run[:-1]) & (np.abs(test.frequencies - test.speed)[1:] > 0)
    ones = np.isclose(step[:, None], _ONE, rtol=1e-6).any(axis=1)
    names, number = test.category("run")
    of = number[1:][inside]
    count, by_one = (np.bincount(of, own, len(names)) for own in (None, ones[inside]))
    fewest_steps = 4  # steps of a run from which they are no chance
    repeated_share = 0.9  # of them: each block of a table may have been continued by itself
    runs = np.array(names)[(count >= fewest_steps) & (by_one > repeated_share * count)].tolist()
    if runs:
        text = (
            f"The speed rises by one from row to row in {listed(runs)}, as where a spreadsheet continued the number "
            "downwards instead of copying it. Check the column of the speed."
        )
        yield Finding("warning", "filled-speed", text, rows_of(np.isin(test.run, runs)))


def _units(test: Experiment) -> Iterator[Finding]:
    """Frequencies far below the speeds, as where they are in Hz and read as rpm."""
    highest, fastest = float(np.abs(test.frequencies).max()), float(np.abs(test.speed).max())
    # Highest frequency of a test over the highest speed below which it is likely in another unit: whirl by the fluid,
    # near half the speed, is out of reach of such a test, and in Hz for rpm a sixtieth is left of what was meant
    least_frequency_ratio = 0.1
    if 0 < highest < least_frequency_ratio * fastest:
        text = (
            f"The frequencies are low: {significant(highest * RPM_PER_RAD_S, 4)} rpm at the most, at speeds up to "
            f"{significant(fastest * RPM_PER_RAD_S, 4)} rpm. If one of the two is in Hz or rad/s, name its unit "
            "(frequency_hz, speed_hz): a wrong unit makes every parameter wrong, lam most of "
            "all, and a fit may not notice."
        )
        yield Finding("warning", "frequency-unit", text, remedy="frequency_hz, speed_hz")


def _frequencies(test: Experiment, influences: Influences | None) -> Iterator[Finding]:
    w, speed = np.abs(test.frequencies), np.abs(test.speed)
    near = (speed != 0) & (np.abs(w - speed) <= SYNCHRONOUS_DISTANCE * speed)
    synchronous, both_ways = test.synchronous, test.drives_both_ways
    if near.any() and not synchronous:
        text = (
            f"Near 1x: {counted(near.sum(), 'reading')} at once-per-turn frequency, where run-out and residual "
            "unbalance add to the response. Subtract the slow roll (slow_roll=, --slow-roll-below), or remove them."
        )
        yield Finding("warning", "near-1x", text, rows_of(near), remedy="slow_roll, drop_near_1x")
    forward, backward = np.all(test.frequencies >= 0), np.all(test.frequencies <= 0)
    if not synchronous and not both_ways and (forward or backward):
        there, lacking = ("forward", "backward") if forward else ("backward", "forward")
        text = (
            f"All runs are {there}. {lacking.capitalize()} runs separate fluid damping from lam and anisotropy from "
            "both; without them parameters are less certain than the noise suggests."
        )
        yield Finding("warning", "one-direction", text)
    runs = rows_by(test.category("run").number)
    single = [str(test.run[own[0]]) for own in runs if np.ptp(np.round(test.frequencies[own], 6)) == 0]
    if single and influences is None:
        text = f"Runs with one frequency only: {listed(single)}; they cannot show how dynamic stiffness varies with it."
        yield Finding("warning", "single-frequency", text, rows_of(np.isin(test.run, single)))


def _planes(test: PerturbationTest) -> Iterator[Finding]:
    measured, forced = test.planes, test.force_planes
    unforced = [plane for plane in measured if plane not in forced]
    if unforced:
        text = (
            f"No force was applied at {listed(unforced)}: eq. (7) needs a force at each measured plane in turn. A fit "
            "of a model still works, with parameters that may not be identifiable."
        )
        yield Finding("note", "force-planes", text)
    blind = [plane for plane in forced if plane not in measured]
    if blind:
        text = f"Forces act at {listed(blind)} where nothing is measured; there is no drive point to check signs at."
        yield Finding("note", "measured-planes", text)
    groups = plane_groups(test)
    if len(groups) > 1:
        apart = "; ".join(", ".join(group) for group in groups)
        text = f"No run connects these planes: {apart}. If they belong to two rigs, fit them apart."
        yield Finding("warning", "unconnected-planes", text)


def _start_ups(test: PerturbationTest, found: Influences | None) -> Iterator[Finding]:
    if found is not None:
        yield Finding("note", "mountings", f"Weights are solved together: {'; '.join(found.remarks)}.")
        if found.modes_told:
            yield Finding("note", "modes", f"{found.modes_told.capitalize()}.")
        return
    raw = np.asarray(test.attributes.get(DIFFERENCED, np.zeros(len(test))) != 1)
    if raw.any():
        runs = tuple(dict.fromkeys(test.run[raw].tolist()))
        text = (
            f"Start-ups not differenced (eq. 20): {listed(runs)}. They contain residual unbalance, bow and run-out. "
            "Repeat them with the weight moved by 180 degrees, or call difference_synchronous if both runs are here."
        )
        yield Finding("warning", "not-differenced", text, rows_of(raw))


def _ramps(test: PerturbationTest) -> Iterator[Finding]:
    """Runs whose amplitude beats beyond its resonance as a ramp of speed makes it; one channel tells it for the run."""
    for run in test.runs:
        mine = test.run == run
        channels = zip(test.plane[mine].tolist(), test.direction[mine].tolist(), strict=True)
        for plane, direction in dict.fromkeys(channels):
            rows = np.flatnonzero(mine & (test.plane == plane) & (test.direction == direction))
            found = fit_ramp(test.speed[rows], test.response[rows])
            if found is None:
                continue
            rpm = RPM_PER_RAD_S
            text = (
                f"{plane} {direction} of run {run} beats beyond its resonance, from {found.beats_from * rpm:.0f} rpm "
                f"on: the speed changed by about {abs(found.rate) * rpm:.0f} rpm/s, too fast for the vibration to "
                f"settle. Taken as settled the resonance comes out at {found.steady_wn * rpm:.0f} rpm, with the ramp "
                f"fitted too at {found.wn * rpm:.0f} +- {significant(found.wn_error * rpm, 1)} rpm. Leave out what "
                "beats, and run through the resonance more slowly."
            )
            late = rows[test.speed[rows] >= found.beats_from]
            yield Finding("warning", "ramp", text, tuple(late.tolist()), remedy="leave out what beats")
            break
