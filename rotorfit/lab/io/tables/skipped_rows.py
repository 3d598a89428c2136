"""Omissions of a table: empty readings, the weight of a reference run, the run, an only plane."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from rotorfit.base.array_types import Bool
from rotorfit.base.digits import counted
from rotorfit.base.units import RPM_PER_RAD_S, UNITS, units_of
from rotorfit.lab.io.tables.cells import NOT_TAKEN, Numbers, lacking, taken
from rotorfit.lab.io.tables.table import READING, Table, floats

_MARK = re.compile(r"[+-]?9{3,5}(\.(0+|9+))?")
"""Values that instruments write where they have no reading: 999, -999, 9999.9, ..."""


def without_empty(table: Table) -> Table:
    """The table without the rows whose reading was not taken.

    A reading is empty where none of its amplitudes (or its real or imaginary part) or where its phase has a number.
    """
    _refuse_marks(table)
    lengths = [list(table.find(prefix, READING)) for prefix in ("amplitude", "real", "imag")]
    needed = [names for names in (*lengths, list(table.find("phase", UNITS["phase"]))) if names]
    missing = [[lacking(table.cells[name], NOT_TAKEN) for name in names] for names in needed]
    empty = (
        np.logical_or.reduce([np.logical_and.reduce(own) for own in missing]) if missing else np.zeros(0, dtype=bool)
    )
    if not empty.any() or empty.all():
        return table
    _refuse_halves(table, empty)
    where = table.lines_of(np.flatnonzero(empty))
    words = f"{table.source}: {empty.sum()} of {empty.size} readings are empty and were skipped ({where})"
    return table.rows(np.flatnonzero(~empty)).noted("empty", words)


def without_standstill(table: Table) -> Table:
    """The table without the lines at frequency zero of sensors of velocity or acceleration, which say nothing there."""
    units = units_of("velocity", "acceleration")
    names = [name for prefix in ("amplitude", "real") for name in table.find(prefix, units)]
    column = table.find("frequency", UNITS["frequency"])
    values = floats(table.cells[next(iter(column))]) if names and len(column) == 1 else None
    if values is None:
        return table
    still = ~np.logical_and.reduce([lacking(table.cells[name]) for name in names]) & (values == 0)
    if not still.any() or still.all():
        return table
    words = f"{table.source}: {counted(still.sum(), 'reading')} at frequency zero left out: nothing accelerates there"
    return table.rows(np.flatnonzero(~still)).noted("standstill", words)


def without_incoherent(table: Table) -> Table:
    """The table without the rows of coherence zero, whose readings are noise alone."""
    values = floats(table.cells["coherence"]) if "coherence" in table.cells else None
    if values is None or not (values == 0).any() or (values == 0).all():
        return table
    rows = np.flatnonzero(values == 0)
    words = (
        f"{table.source}: {rows.size} of {values.size} readings have coherence zero, noise alone, and were left out "
        f"(first in line {table.lines[int(rows[0])]})"
    )
    return table.rows(np.flatnonzero(values != 0)).noted("incoherent", words)


_READING = ("run", "plane", "direction")
_FORCE = ("force", "mr")


def _refuse_halves(table: Table, empty: Bool) -> None:
    """Refuse an empty reading that another row of its run has, under a force at another plane.

    Several forces at once are written with the reading in each row; without one of them the others are wrong.
    """
    if not {*_READING, "force_plane"} <= set(table.cells):
        return
    conditions = [*table.find("speed", UNITS["frequency"]), *table.find("frequency", UNITS["frequency"])]
    keys = list(zip(*[table.cells[name] for name in (*_READING, *conditions)], strict=True))
    taken = {keys[row]: row for row in np.flatnonzero(~empty).tolist()}
    for row in np.flatnonzero(empty).tolist():
        other = taken.get(keys[row])
        if other is not None and table.cells["force_plane"][row] != table.cells["force_plane"][other]:
            cells = table.cells
            raise ValueError(
                f"{table.source}: line {table.lines[row]}, {cells['plane'][row]} {cells['direction'][row]} of run "
                f"{cells['run'][row]} under a force at {cells['force_plane'][row]} is empty, and line "
                f"{table.lines[other]} has it under one at {cells['force_plane'][other]}. If both acted at once, "
                "write the reading in both rows; if one was not read, name the runs apart or leave its row out"
            )


def _refuse_marks(table: Table) -> None:
    """Refuse 999 and its like where no other amplitude, or no other phase, comes near."""
    amplitudes = [name for prefix in ("amplitude", "real", "imag") for name in table.find(prefix, READING)]
    mark_ratio = 10.0  # times the largest other amplitude
    for name in (*amplitudes, *table.find("phase", UNITS["phase"])):
        cells = table.cells[name]
        asked: Sequence[int] = range(len(cells))
        if isinstance(cells, Numbers):
            asked = np.flatnonzero(np.isin(np.floor(np.abs(cells.values)), (999, 9999, 99999))).tolist()
        marked = [row for row in asked if _MARK.fullmatch(cells[row])]
        if not marked:
            continue
        others = ~lacking(cells, NOT_TAKEN)
        others[marked] = False
        values = floats(taken(cells, np.flatnonzero(others)))
        if values is None or not values.size:
            continue
        mark = float(cells[marked[0]])
        if abs(mark) > mark_ratio * np.abs(values).max() if name in amplitudes else np.abs(values - mark).min() > 360.0:
            raise ValueError(
                f"{table.where(marked[0], name)}: {cells[marked[0]]} is far from all others ({len(marked)} such "
                "cells in the column). If instruments write it where there is no reading, leave the cells blank"
            )


def with_reference_rows(table: Table) -> Table:
    """The table with a weight of zero, at the first plane named, where plane, size and angle of the weight are blank.

    A row with a plane and no size stays as it is and is refused: the size may have been forgotten.
    """
    weights, planes = table.find("mr", UNITS["unbalance"]), table.cells.get("force_plane", ())
    if not weights or "" not in planes:
        return table
    angles = [name for prefix in ("force_phase", "force_angle") for name in table.find(prefix, UNITS["phase"])]
    columns = ["force_plane", *weights, *angles]
    without = np.logical_and.reduce([lacking(table.cells[name]) for name in columns])
    if not without.any() or without.all():
        return table
    zero = {"force_plane": next(filter(None, planes))}
    cells = {
        name: [zero.get(name, "0") if blank else cell for cell, blank in zip(table.cells[name], without, strict=True)]
        for name in columns
    }
    return table.with_columns(cells)


def completed(table: Table, *, forced: bool) -> Table:
    """The table with the columns that may be left out: ``plane``, ``force_plane``, ``run``.

    A plane left out is the journal; the force acts at the only plane that there is; without runs, each plane that is
    forced at each speed is one.
    """
    cells = table.cells
    added: dict[str, Sequence[str]] = {}
    if "plane" not in cells:
        added["plane"] = ["journal"] * len(table.lines)
    planes = cells.get("plane", ("journal",))
    if forced and "force_plane" not in cells and len(set(planes)) == 1:
        added["force_plane"] = [planes[0]] * len(table.lines)
    by = "force_plane" if forced else "plane"
    if "run" not in cells and by in {*cells, *added}:
        names = [name for name in cells if name != "force_plane" and name.partition("_")[0] not in _FORCE]
        first: dict[tuple[str, ...], int] = {}  # row by reading; in one run forces at two planes act at once
        readings = zip(*[cells[name] for name in names], strict=True) if forced and "force_plane" in cells else ()
        for row, key in enumerate(readings):
            other = first.setdefault(key, row)
            one, two = (cells["force_plane"][k] for k in (other, row))
            if one != two:
                raise ValueError(
                    f"{table.source}: lines {table.lines[other]} and {table.lines[row]} have the same reading under "
                    f"forces at {one} and at {two}; add a column run that says whether they acted at once, in one run"
                )
        added["run"] = _runs(table, cells.get(by) or added[by])
    return table.with_columns(added)


def _runs(table: Table, forced: Sequence[str]) -> list[str]:
    """Names of runs: the plane that is forced, and the speed where there are several that are held."""
    columns = table.find("speed", UNITS["frequency"])
    speeds: Sequence[str] = [""] * len(forced)
    if len(columns) == 1:
        values = table.number(next(iter(columns.items())))
        distinct = np.unique(np.round(values * RPM_PER_RAD_S))
        if 1 < distinct.size <= max(8, len(forced) // 40):
            speeds = [f" {value:.0f} rpm" for value in np.round(values * RPM_PER_RAD_S)]
    return [f"{plane}{speed}" for plane, speed in zip(forced, speeds, strict=True)]
