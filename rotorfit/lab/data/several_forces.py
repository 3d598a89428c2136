"""Readings under several forces at once: written once per force, one row of a test.

Two-plane balancing leaves the first trial weight in: rows that agree in run, speed, frequency, plane, direction and
reading, and name different planes of the force, are one reading under the sum of these forces. So are, in synchronous
runs, rows that name one plane with weights at different angles, in two holes. Two shakers, or the two axes of a
magnetic bearing, act at one plane along x and along y at once: rows that differ in the force's direction.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rotorfit.estimators.blocks.row_keys import combined, distinguished, numbers, rows_by
from rotorfit.lab.data.experiments import PerturbationTest, records

_PROBE = ("run", "speed", "frequency", "plane", "direction")
"""Columns that rows of one reading share, beside the reading itself."""

Where = Callable[[int], str]
"""The place of a row, for messages."""


def gathered(test: PerturbationTest, where: Where | None = None) -> PerturbationTest:
    """The test with rows of readings under several forces put together. A run has several where some reading stands
    under several planes, both axes or two weights of one plane; all its readings have to stand under the same ones."""
    named = where or (lambda row: f"row {row + 1}")
    if not (np.diff(np.sort(test.response.real)) == 0).any():
        _refuse_two_readings(test, named)
        return test
    first, group = distinguished(*[getattr(test, name) for name in _PROBE], *_readings(test))
    place = combined(numbers(test.force_plane), numbers(test.force_direction))
    leading_row = first[group]
    anew = place != place[leading_row]
    if test.synchronous:
        loaded = (test.force != 0) & (test.force[leading_row] != 0)
        anew = anew | (loaded & (test.force != test.force[leading_row]))
    anew = anew & (test.response != 0) & np.isfinite(test.response)
    if not anew.any():
        _refuse_two_readings(test, named)
        return test
    runs = set(test.run[anew].tolist())
    groups = [rows.tolist() for rows in rows_by(group)]
    inside = np.isin(test.run, list(runs))
    kept: list[int] = []
    own = test.force.copy()
    further: dict[int, tuple[tuple[str, complex, str], ...]] = {}
    for rows in groups:
        if inside[rows[0]]:
            _refuse_contradictions(test, rows, named)
            loaded = [row for row in rows if test.force[row] != 0] or rows[:1]
            kept.append(loaded[0])
            (_, own[loaded[0]], _), *others = _summed(test, loaded)
            further[loaded[0]] = tuple(others)
        else:
            kept += rows
    kept.sort()
    _refuse_unequal_planes(test, [rows for rows in groups if inside[rows[0]]], named)
    found = replace(test, force=own, further_forces=records(further.get(row, ()) for row in range(len(test))))
    return found.select(np.array(kept, dtype=np.intp))


def written_per_force(test: PerturbationTest) -> PerturbationTest:
    """The test with a row for each force, as files hold it; :func:`gathered` undoes it."""
    if not test.several.any():
        return test
    rows: list[int] = []
    forces: list[tuple[str, complex, str]] = []
    for row in range(len(test)):
        own = test.acting(row)
        rows += [row] * len(own)
        forces += own
    spread = test.select(np.array(rows, dtype=np.intp))
    planes, values, along = zip(*forces, strict=True)
    return replace(
        spread,
        force_plane=np.array(planes),
        force=np.array(values, dtype=complex),
        force_direction=np.array(along),
        further_forces=np.array([], dtype=object),
    )


def refuse_several(test: PerturbationTest, what: str) -> None:
    """Refuse readings under several forces at once where ``what``, a noun with its article, does not take them."""
    if test.several.any():
        row = int(np.flatnonzero(test.several)[0])
        acting = test.select(np.array([row])).forces[0].replace(" + ", " and ")
        raise ValueError(
            f"{test.source or 'the test'}: in run {test.run[row]} forces act at {acting} at once, which {what} does "
            "not take; leave such runs out, exclude={'run': ...}"
        )


def _readings(test: PerturbationTest) -> tuple[NDArray[Any], NDArray[Any]]:
    """Columns that are equal where readings are; one that is not finite is like no other."""
    finite = np.isfinite(test.response)
    return np.where(finite, test.response, 0), np.where(finite, -1, np.arange(len(test)))


def _place(test: PerturbationTest, row: int) -> str:
    """Where a force acts: its plane, with the axis of one that does not turn."""
    plane, along = str(test.force_plane[row]), str(test.force_direction[row])
    return plane if along == "circular" else f"{plane} along {along}"


def _summed(test: PerturbationTest, rows: list[int]) -> list[tuple[str, complex, str]]:
    """Plane, force and direction of each place, its forces summed, in the order of the rows."""
    forces: dict[tuple[str, str], complex] = {}
    for row in rows:
        place = str(test.force_plane[row]), str(test.force_direction[row])
        forces[place] = forces.get(place, 0j) + complex(test.force[row])
    return [(plane, force, along) for (plane, along), force in forces.items()]


def _refuse_contradictions(test: PerturbationTest, rows: list[int], named: Where) -> None:
    """Refuse two forces at one place and angle, as of a line written twice, and circular ones beside others."""
    seen: dict[tuple[str, float], int] = {}
    for row in rows:
        place = _place(test, row)
        at = place, float(np.round(np.angle(test.force[row]), 6))
        if at in seen:
            same = test.force[row] == test.force[seen[at]]
            raise ValueError(
                f"{named(row)}: the {'same force' if same else 'second force'} at {place} for one reading of run "
                f"{test.run[row]} ({named(seen[at])} has the first); "
                + ("write it once" if same else "write two weights at one angle as one, their sum")
            )
        seen[at] = row
    kinds = dict.fromkeys(test.force_direction[rows].tolist())
    if len(kinds) > 1 and "circular" in kinds:
        raise ValueError(
            f"{named(rows[-1])}: forces that act at once are all circular or all along axes; this reading of run "
            f"{test.run[rows[0]]} has {' and '.join(kinds)}"
        )


def _refuse_unequal_planes(test: PerturbationTest, groups: list[list[int]], named: Where) -> None:
    """Refuse runs whose readings do not all stand under the same forces, a place counted as often as it has one."""
    acting = [(rows[0], Counter(_place(test, row) for row in rows)) for rows in groups]
    most: dict[str, Counter[str]] = {}
    for row, places in acting:
        run = str(test.run[row])
        most[run] = max(most.get(run, Counter()), places, key=Counter.total)
    for row, places in acting:
        run = str(test.run[row])
        expected = most[run]
        if places != expected:
            lacking = " and ".join(sorted((expected - places or places).elements()))
            raise ValueError(
                f"{named(row)}: in run {run} forces act at {' and '.join(sorted(expected.elements()))} at once, but "
                f"this reading of {test.plane[row]} {test.direction[row]} stands under "
                f"{' and '.join(sorted(places.elements()))} alone; write the same reading again for {lacking}, or name "
                "runs apart"
            )


def _refuse_two_readings(test: PerturbationTest, named: Where) -> None:
    """Refuse synchronous runs in which one probe reads twice at one speed, under different planes of the force."""
    if not test.synchronous:
        return
    first, number = distinguished(*[getattr(test, name) for name in _PROBE])
    others, plane = first[number], numbers(test.force_plane)
    twice = np.flatnonzero((plane != plane[others]) & (test.force != 0) & (test.force[others] != 0))
    if twice.size:
        row = int(twice[0])
        other = int(others[row])
        raise ValueError(
            f"{named(row)}: run {test.run[row]} has two readings of {test.plane[row]} {test.direction[row]} at one "
            f"speed, under a weight at {test.force_plane[other]} ({named(other)}) and at {test.force_plane[row]}. "
            "If both weights were in, write the same reading for each; otherwise name the runs apart"
        )
