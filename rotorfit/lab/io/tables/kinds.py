"""Tests of other kinds than responses to forces read from tidy tables.

Each kind says what its columns are called in a table. Of static loads, impulses, ring-down records
and tables of coefficients ``run`` may be left out: one run. A plane left out is the journal. A row of a line test is
one spectral line of one signal.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rotorfit.base.array_types import Bool
from rotorfit.base.units import RPM_PER_RAD_S, UNITS
from rotorfit.lab.data.rows import Experiment
from rotorfit.lab.data.synchronous import group_speeds
from rotorfit.lab.data.table_columns import PURE, RUN, Column
from rotorfit.lab.io.tables.table import Columns, Wanted, columns_for, phase_or_angle, quantity, words
from rotorfit.lab.kinds.coefficient_table import CoefficientTable
from rotorfit.lab.kinds.displacement_test import DisplacementTest
from rotorfit.lab.kinds.free_vibration import ImpulseTest, RingDownTest
from rotorfit.lab.kinds.line_test import LineTest
from rotorfit.lab.kinds.operating_test import OperatingTest
from rotorfit.lab.kinds.static_test import StaticTest

if TYPE_CHECKING:
    from rotorfit.lab.io.tables.table import Table

_MORE = "; other units by suffix, further columns are attributes"
_KINDS: tuple[type[Experiment], ...] = (
    DisplacementTest, RingDownTest, ImpulseTest, StaticTest, CoefficientTable, OperatingTest,
)  # fmt: skip


def _wanted(column: Column) -> list[Wanted]:
    """Columns of a table to be read; the second part is asked for by its own name."""
    if not column.parts:
        return [words(column.name, needed=False)]
    names = column.name, f"second part of {column.name}"
    parts = zip(names, column.parts, strict=False)
    return [
        quantity(prefix, units, usual if column.needed else "", name=name) for name, (prefix, usual, units) in parts
    ]


def _read(column: Column, columns: Columns) -> NDArray[Any]:
    """The column in SI units."""
    if not column.parts:
        return columns.words(column.name, column.otherwise)
    values = columns.number(column.name, blank=not column.needed)
    if len(column.parts) == 2:
        second = columns.number(f"second part of {column.name}")
        values = np.asarray(values * np.exp(1j * second) if column.polar else values + 1j * second)
        columns.refuse(~np.isfinite(values), column.name, "overflows; check its unit")
    return values


_REFUSED: dict[str, tuple[Callable[[NDArray[Any]], Bool], str]] = {
    "sigma": (lambda values: values <= 0, "is not a size of noise: positive, or blank where it is not known"),
    "eccentricity": (
        lambda values: (values < 0) | (values >= 1),
        "is not an eccentricity: |displacement| / clearance, from 0 to below 1",
    ),
    "damping_ratio": (
        lambda values: np.abs(values) >= 1,
        "is not the damping ratio of a mode that vibrates: between -1 and 1",
    ),
}
"""Values that a column cannot have, and why."""


def kind_of(table: Table) -> type[Experiment] | None:
    """The kind of test that the columns of a table tell; None for a perturbation test, which may have attributes named
    like the marks of the others."""
    allowed = (DisplacementTest,) if {"force_plane", "direction"} & set(table.cells) else _KINDS
    return next((kind for kind in allowed if any(name.startswith(kind.layout.marks) for name in table.cells)), None)


def read_kind(kind: type[Experiment], table: Table, speed_tolerance: float) -> Any:
    """The test of a kind that a table holds."""
    own, _, run, known = kind.layout
    by_ratio = kind is ImpulseTest and bool(table.find("eccentricity", PURE))
    own = (*RUN, *(column for column in own if not (by_ratio and column.name == "position")))
    columns = columns_for(table, [one for column in own for one in _wanted(column)], known + _MORE)
    values: dict[str, Any] = {column.name: _read(column, columns) for column in own}
    for name, (bad, why) in _REFUSED.items():
        if name in values:
            columns.refuse(bad(values[name]), name, why)
    if not columns.has("run"):
        values["run"] = np.broadcast_to(run, columns.rows)
    if kind is DisplacementTest:  # measured line by line
        values["speed_tolerance"] = speed_tolerance
    else:
        values["speed"] = group_speeds(values["speed"], values["run"], speed_tolerance)
    if kind is StaticTest and not columns.has("load_plane"):
        values["load_plane"] = values["plane"]
    if kind is CoefficientTable and not values["run"].any():  # each speed is a run
        values["run"] = np.array([f"{value:.6g} rpm" for value in (values["speed"] * RPM_PER_RAD_S).tolist()])
    if by_ratio:
        values["position"] = np.full(columns.rows, complex(np.nan))
    return kind(**values, attributes=columns.attributes, source=table.source)


# ---- line tests --------------------------------------------------------------------------------------------------

LINE_COLUMNS = (
    "run, speed_rpm, frequency_rpm, force_plane, force_N, force_phase_deg, plane, direction (z or twist), line (w, "
    "2Om-w, 1x, w-Om, ...), real_um, imag_um, sigma_um of motion, real_urad, imag_urad, sigma_urad of twist"
)
_PARTS = ("real", "imag", "sigma")
_TURNS = {"urad": 1e-6, "mrad": 1e-3, "rad": 1.0}


def line_test(table: Table, speed_tolerance: float) -> LineTest:
    """Build a line test; columns: :data:`LINE_COLUMNS`."""
    columns = columns_for(
        table,
        (
            *(words(name) for name in ("run", "force_plane", "plane", "direction", "line")),
            quantity("speed", UNITS["frequency"], "rpm"),
            quantity("frequency", UNITS["frequency"], "rpm"),
            quantity("force", UNITS["force"], "N"),
            *phase_or_angle(table),
            *(quantity(part, UNITS["length"], "um") for part in _PARTS),
            *(quantity(part, _TURNS, name=f"{part} of twist") for part in _PARTS),
        ),
        LINE_COLUMNS + _MORE,
    )
    direction, frequency = columns.words("direction"), columns.number("frequency")
    for row in np.flatnonzero(~np.isin(direction, ("z", "twist"))).tolist():
        raise ValueError(f"{table.where(row, 'direction')}: {str(direction[row])!r} unknown; allowed: z, twist")
    parts = {}
    for part in _PARTS:
        twisting = direction == "twist"
        motion, twist = columns.number(part, blank=True), columns.number(f"{part} of twist", blank=True)
        parts[part] = np.where(twisting, twist, motion)
        for row in np.flatnonzero(np.isnan(parts[part])).tolist() if part != "sigma" else ():
            wanted = f"{part}_urad" if twisting[row] else f"{part}_um"
            raise ValueError(f"{table.source}: line {table.lines[row]} has no {wanted}")
    run = columns.words("run")
    return LineTest(
        run=run,
        speed=group_speeds(columns.number("speed"), run, speed_tolerance),
        frequency=frequency,
        force_plane=columns.words("force_plane"),
        force=columns.number("force") * np.exp(1j * columns.force_phase(frequency)),
        plane=columns.words("plane"),
        direction=direction,
        line=columns.words("line"),
        response=parts["real"] + 1j * parts["imag"],
        sigma=parts["sigma"],
        attributes=columns.attributes,
        source=table.source,
    )
