"""Look a test over before fitting: slips of sign, direction, scale and plan that the data themselves give away."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rotorfit.checks.amplitudes import amplitudes
from rotorfit.checks.copies import copied_runs
from rotorfit.checks.half_turns import half_turns
from rotorfit.checks.imposed_orbits import imposed_orbits
from rotorfit.checks.linear_force import linear_force
from rotorfit.checks.orbits import NEAR_1X, orbits_of
from rotorfit.checks.plain import surely_turning
from rotorfit.checks.probe_angles import turned_probes
from rotorfit.checks.probe_pairs import uneven_probes
from rotorfit.checks.ramp import ramps
from rotorfit.checks.readings import clipped, unread
from rotorfit.checks.scale import peak_to_peak, reciprocity
from rotorfit.checks.signs import signs, wrong_direction
from rotorfit.checks.static_limit import static_limit
from rotorfit.checks.still_and_free import free_vibration, static_positions
from rotorfit.checks.turning_force import turning_force
from rotorfit.data.experiments import (
    DisplacementTest,
    Experiment,
    ImpulseTest,
    PerturbationTest,
    RingDownTest,
    StaticTest,
    plane_groups,
)
from rotorfit.data.findings import NO_COPIES, Finding, listed
from rotorfit.data.synchronous import DIFFERENCED
from rotorfit.data.weights import Influences, weighed
from rotorfit.estimators.blocks.row_keys import words
from rotorfit.units import RPM_PER_RAD_S

SLOWEST = 0.1
"""Highest frequency of a test over the highest speed below which it is likely in another unit: whirl by the fluid, near
half the speed, is out of reach of such a test, and in Hz for rpm a sixtieth is left of what was meant."""


_ONE = np.array([1.0, 60.0, RPM_PER_RAD_S])
"""One rpm, Hz and rad/s in rpm."""
_FEWEST = 4  # steps of a run from which they are no chance
_NEARLY_ALL = 0.9  # of them: each block of a table may have been continued by itself


def check(test: Experiment) -> list[Finding]:
    """Findings about a test, errors first.

    Recognised are readings that are not finite, doubled, zero or cut off, forces of zero, implausible amplitudes,
    frequencies in another unit than speeds, readings at 1x, gaps in the plan of the test (planes without force, one
    direction only, one frequency only), conjugated FRFs, responses in the wrong direction, forces along an axis given
    as circular and the reverse, readings inverted from some frequency on, a reversed sense of rotation, peak-to-peak
    amplitudes in some channels, start-ups without partner, positions against their load, records without a mode, free
    vibration in another unit than the speed, run-ups too fast to settle; said are the scatter between mountings of
    weights and the number of modes that weights at dwell speeds show.

    Args:
        test: what was measured, SI units.

    Example:
        >>> [finding.code for finding in rf.check(rig) if finding.severity == "error"]
        []
    """
    return _check(test)


def errors(test: Experiment) -> list[Finding]:
    """The errors among the findings of :func:`check`."""
    return [finding for finding in _check(test, only_errors=True) if finding.severity == "error"]


def _check(test: Experiment, *, only_errors: bool = False) -> list[Finding]:
    numeric = _finite(test)
    findings = list(_numbers(test, numeric))
    finite = np.flatnonzero(numeric)
    if finite.size:
        rest = test if finite.size == len(test) else test.select(finite)
        told = list(_of_its_kind(rest, only_errors))
        for finding in told:  # rows of the finite part back to rows of the test
            rows = tuple(finite[list(finding.rows)].tolist())
            findings.append(Finding(finding.severity, finding.code, finding.message, rows))
    order = ("error", "warning", "note")
    return sorted(findings, key=lambda finding: order.index(finding.severity))


def _of_its_kind(test: Experiment, only_errors: bool) -> Iterator[Finding]:
    match test:
        case PerturbationTest() | DisplacementTest():
            yield from _physics(test, only_errors)
        case StaticTest():
            yield from static_positions(test)
        case ImpulseTest() | RingDownTest():
            yield from free_vibration(test)


def _physics(test: PerturbationTest | DisplacementTest, only_errors: bool) -> Iterator[Finding]:
    if not only_errors:
        yield from _duplicates(test)
    yield from amplitudes(test)
    if not only_errors:
        yield from _plan(test)
    if isinstance(test, DisplacementTest):
        yield from imposed_orbits(test)
    if isinstance(test, PerturbationTest):
        yield from unread(test)
        yield from clipped(test)
        yield from turning_force(test)
        forced = np.flatnonzero(test.force != 0)
        if not forced.size:
            return  # a reference run alone
        orbits = orbits_of(test if forced.size == len(test) else test.select(forced), forced)
        if not orbits.frequency.size or (
            only_errors and surely_turning(orbits, orbits.right, orbits.wrong, orbits.speed)
        ):
            return
        linear = list(linear_force(orbits))
        wrong = linear or list(wrong_direction(orbits))
        yield from wrong
        turned = [] if wrong else list(turned_probes(orbits))
        if not only_errors:
            uneven = [] if wrong else list(uneven_probes(orbits))
            filtered = any(finding.code == "probe-filter" for finding in uneven)  # which halves amplitudes too
            twice = [] if linear or filtered else list(peak_to_peak(orbits))
            yield from twice or uneven
            if not (linear or wrong or twice or any(finding.severity == "warning" for finding in uneven)):
                yield from reciprocity(orbits)
            if not wrong:
                yield from static_limit(orbits)
            yield from half_turns(orbits)
        yield from turned
        if not wrong and not turned:  # else the right component is only a residue
            yield from signs(orbits)


def _plan(test: PerturbationTest | DisplacementTest) -> Iterator[Finding]:
    """What is missing in the plan of a test, which is no error."""
    yield from _filled(test)
    yield from _frequencies(test)
    if isinstance(test, PerturbationTest):
        yield from _planes(test)
        yield from _start_ups(test)
        yield from ramps(test)


_MAY_BE_NAN = ("sigma", "eccentricity", "position")
"""Columns in which NaN stands for what was not measured, or was told in another column."""


def _finite(test: Any) -> NDArray[np.bool_]:
    numeric = [getattr(test, name) for name in test._columns() if name not in _MAY_BE_NAN]
    columns = [np.isfinite(values) for values in numeric if values.dtype.kind in "fc"]
    return np.logical_and.reduce(columns) if columns else np.ones(len(test), dtype=bool)


def _rows(mask: NDArray[Any]) -> tuple[int, ...]:
    return tuple(int(row) for row in np.flatnonzero(mask))


_REFERENCE = (
    "This is a reference run: no reading has a force. Alone it says nothing of the rotor; put it together with the "
    "runs that have a trial weight, rf.join_runs([reference, trial])."
)


def _numbers(test: Experiment, finite: NDArray[np.bool_]) -> Iterator[Finding]:
    if not len(test):
        yield Finding("error", "empty", "The test has no readings.")
        return
    if not finite.all():
        text = f"Not finite: {(~finite).sum()} readings; remove them, test.select(...) with the rows to keep."
        yield Finding("error", "not-finite", text, _rows(~finite))
    sigma = getattr(test, "sigma", np.array([1.0]))
    if (sigma <= 0).any():
        text = f"The noise sigma is not positive in {(sigma <= 0).sum()} rows; NaN stands for unknown noise."
        yield Finding("error", "sigma", text, _rows(sigma <= 0))
    # Runs without a weight are what the others are compared with, where weights are solved together.
    if isinstance(test, PerturbationTest) and (test.force == 0).any() and _solved(test) is None:
        if (test.force == 0).all() and test.synchronous:
            yield Finding("warning", "reference-run", _REFERENCE)
            return
        text = f"The force is zero in {(test.force == 0).sum()} rows; remove them, they have no dynamic stiffness."
        yield Finding("error", "no-force", text, _rows(test.force == 0))


def _duplicates(test: PerturbationTest | DisplacementTest) -> Iterator[Finding]:
    told = test.response if isinstance(test, PerturbationTest) else test.displacement
    if not (np.diff(np.sort(told.real)) == 0).any() or np.unique(told).size == told.size:
        return
    columns = [getattr(test, name).tolist() for name in test._columns() if name != "sigma"]
    first: dict[Any, int] = {}
    again = np.array([first.setdefault(key, i) != i for i, key in enumerate(zip(*columns, strict=True))])
    if again.any():
        text = f"Copies: {again.sum()} readings repeat an earlier row to the last digit. {NO_COPIES}"
        yield Finding("warning", "duplicate", text, _rows(again))
    yield from copied_runs([test])[0]


def _frequencies(test: PerturbationTest | DisplacementTest) -> Iterator[Finding]:
    synchronous = isinstance(test, PerturbationTest) and test.synchronous
    yield from _units(test)
    turning = test.speed != 0
    near = turning & (np.abs(np.abs(test.frequency) - np.abs(test.speed)) <= NEAR_1X * np.abs(test.speed))
    if near.any() and not synchronous:
        text = (
            f"Near 1x: {near.sum()} readings are at once-per-turn frequency, where run-out and residual unbalance add "
            "to the response. Subtract the slow roll, read(..., slow_roll=...), or remove them."
        )
        yield Finding("warning", "near-1x", text, _rows(near))
    both_ways = isinstance(test, PerturbationTest) and bool(test.linear.any())
    if not synchronous and not both_ways and (np.all(test.frequency >= 0) or np.all(test.frequency <= 0)):
        there, lacking = ("forward", "backward") if np.all(test.frequency >= 0) else ("backward", "forward")
        text = (
            f"All runs are {there}. {lacking.capitalize()} runs separate fluid damping from lam and anisotropy from "
            "both; without them parameters are less certain than the noise suggests."
        )
        yield Finding("warning", "one-direction", text)
    names, run = words(test.run)
    begin = np.concatenate([[0], np.cumsum(np.bincount(run))[:-1]])
    of_runs = np.round(test.frequency, 6)[np.argsort(run, kind="stable")]
    one = np.minimum.reduceat(of_runs, begin) == np.maximum.reduceat(of_runs, begin)
    single = [name for name, alone in zip(names, one.tolist(), strict=True) if alone]
    if single and not (isinstance(test, PerturbationTest) and _solved(test) is not None):
        text = f"Runs with one frequency only: {listed(single)}; they cannot show how dynamic stiffness varies with it."
        yield Finding("warning", "single-frequency", text, _rows(np.isin(test.run, single)))


def _filled(test: PerturbationTest | DisplacementTest) -> Iterator[Finding]:
    """Speeds that rise by one from row to row, as where a spreadsheet continued a number downwards."""
    step = np.diff(test.speed) * RPM_PER_RAD_S
    if not step.any():
        return
    inside = (test.run[1:] == test.run[:-1]) & (np.abs(test.frequency - test.speed)[1:] > 0)
    ones = np.isclose(step[:, None], _ONE, rtol=1e-6).any(axis=1)
    runs = [
        run
        for run in test.runs
        if (of := inside & (test.run[1:] == run)).sum() >= _FEWEST and ones[of].mean() > _NEARLY_ALL
    ]
    if runs:
        text = (
            f"The speed rises by one from row to row in {listed(runs)}, as where a spreadsheet continued the number "
            "downwards instead of copying it. Check the column of the speed."
        )
        yield Finding("warning", "filled-speed", text, _rows(np.isin(test.run, runs)))


def _units(test: PerturbationTest | DisplacementTest) -> Iterator[Finding]:
    """Frequencies far below the speeds, as where they are in Hz and read as rpm."""
    highest, fastest = float(np.abs(test.frequency).max()), float(np.abs(test.speed).max())
    if 0 < highest < SLOWEST * fastest:
        text = (
            f"The frequencies are low: {highest * RPM_PER_RAD_S:.4g} rpm at the most, at speeds up to "
            f"{fastest * RPM_PER_RAD_S:.4g} rpm. If one of the two is in Hz or rad/s, name its unit (frequency_hz, "
            "speed_hz): wrong, it falsifies every parameter, lam first of all, and a fit may not notice."
        )
        yield Finding("warning", "frequency-unit", text)


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


def _solved(test: PerturbationTest) -> Influences | None:
    """Influences of weights at dwell speeds, None where there are none to solve for."""
    try:
        return weighed(test)
    except ValueError:  # a fit says why; what else is odd about the test is worth knowing
        return None


def _start_ups(test: PerturbationTest) -> Iterator[Finding]:
    if not test.synchronous:
        return
    found = _solved(test)
    if found is not None:
        none = _rows(np.zeros(len(test), dtype=bool))
        yield Finding("note", "mountings", f"Weights are solved together: {'; '.join(found.remarks)}.", none)
        if found.modes_told:
            yield Finding("note", "modes", f"{found.modes_told.capitalize()}.", none)
        return
    raw = np.asarray(test.attributes.get(DIFFERENCED, np.zeros(len(test))) != 1)
    if raw.any():
        runs = tuple(dict.fromkeys(test.run[raw].tolist()))
        text = (
            f"Start-ups not differenced (eq. 20): {listed(runs)}. They contain residual unbalance, bow and run-out. "
            "Repeat them with the weight moved by 180 degrees, or call difference_synchronous if both runs are here."
        )
        yield Finding("warning", "not-differenced", text, _rows(raw))
