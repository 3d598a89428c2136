"""Forces measured along x and along y at once: two shakers, a magnetic bearing, cross-talk of the other shaker.

A row with ``force_x_N, force_x_phase_deg, force_y_N, force_y_phase_deg`` is one reading under two forces, which the
tidy table has as two rows that differ in force and ``force_direction``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from rotorfit.io.tables.cells import Numbers, taken
from rotorfit.io.tables.table import Table
from rotorfit.models.array_types import Float
from rotorfit.units import UNITS, si_factor

_AXES = ("x", "y")


def with_force_rows(table: Table) -> Table:
    """The table with a row for each force in place of columns for each axis; as it is without such columns.

    Raises:
        ValueError: a force without its phase, or columns of the usual force beside them.
    """
    columns = {axis: _columns(table, axis) for axis in _AXES}
    given = {axis: found for axis, found in columns.items() if found is not None}
    if not given:
        return table
    own = {name for force, phase in given.values() for name, _ in (force, phase)}
    _refuse_beside(table, own)
    axes = list(given)
    size, phase = (np.stack([table.number(found[k]) for found in given.values()], axis=1) for k in (0, 1))
    place = [[axes.index(axis) for axis in order] for order in _first_axes(table, dict(zip(axes, size.T, strict=True)))]
    rows = np.repeat(np.arange(len(size)), len(axes))
    cells = {name: taken(values, rows) for name, values in table.cells.items() if name not in own}
    new: dict[str, Sequence[str]] = {
        "force_direction": [axes[k] for order in place for k in order],
        "force_n": Numbers(np.take_along_axis(size, np.array(place), axis=1).ravel()),
        "force_phase_deg": Numbers(
            np.take_along_axis(phase, np.array(place), axis=1).ravel() / si_factor("phase", "deg")
        ),
    }
    names = {name: spelled for name, spelled in table.names.items() if name in cells} | {name: name for name in new}
    written = {**table.written, "force_n": "force_x_N, force_y_N", "force_direction": "force_x_N, force_y_N"}
    renamed = {**names, "force_n": "force_N"}
    return replace(table, cells={**cells, **new}, names=renamed, lines=table.lines[rows], written=written)


def _columns(table: Table, axis: str) -> tuple[tuple[str, float], tuple[str, float]] | None:
    """Columns of the force along an axis and of its phase, with their factors to SI."""
    found = []
    for prefix, units in ((f"force_{axis}", UNITS["force"]), (f"force_{axis}_phase", UNITS["phase"])):
        own = table.find(prefix, units)
        if len(own) > 1:
            raise ValueError(f"{table.source}: {prefix} is given twice, as {' and '.join(own)}; keep one of them")
        found.append(next(iter(own.items()), None))
    size, phase = found
    if size is None and phase is None:
        return None
    if size is None or phase is None:
        lacking = f"force_{axis}_phase_deg" if phase is None else f"force_{axis}_N"
        raise ValueError(f"{table.source}: missing columns: {lacking}. A force along {axis} has a size and a phase")
    return size, phase


def _refuse_beside(table: Table, taken: set[str]) -> None:
    usual = ("force", UNITS["force"]), ("mr", UNITS["unbalance"]), ("force_phase", UNITS["phase"])
    beside = [name for prefix, units in (*usual, ("force_angle", UNITS["angle"])) for name in table.find(prefix, units)]
    beside += [name for name in ("force_direction",) if name in table.cells]
    if beside:
        both = " and ".join(table.spelled(name) for name in (beside[0], sorted(taken)[0]))
        raise ValueError(
            f"{table.source}: {both} are both given. Forces along x and y are in columns of their own; leave "
            f"{', '.join(table.spelled(name) for name in beside)} out"
        )


def _first_axes(table: Table, sizes: dict[str, Float]) -> list[tuple[str, ...]]:
    """Axes of each row's forces, that of the shaker that drives the run before that of its cross-talk."""
    runs = table.cells.get("run", [""] * len(table.lines))
    power: dict[str, dict[str, float]] = {}
    for axis, values in sizes.items():
        for run, value in zip(runs, values.tolist(), strict=True):
            own = power.setdefault(run, dict.fromkeys(sizes, 0.0))
            own[axis] += value * value
    order = {run: tuple(sorted(own, key=lambda axis: -own[axis])) for run, own in power.items()}
    return [order[run] for run in runs]
