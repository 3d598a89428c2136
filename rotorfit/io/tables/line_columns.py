"""Tidy CSV files of spectral lines: one row is one line of one signal."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rotorfit.data.experiments import LineTest
from rotorfit.data.synchronous import group_speeds
from rotorfit.io.tables.wanted_columns import Columns, columns_for, optional, phase_or_angle, quantity, words
from rotorfit.models.array_types import Bool, Float
from rotorfit.units import UNITS, si_factor

if TYPE_CHECKING:
    from rotorfit.io.tables.table import Table

LINE_COLUMNS = (
    "run, speed_rpm, frequency_rpm, force_plane, force_N, force_phase_deg, plane, direction (z or twist), line (w, "
    "2Om-w, 1x, w-Om, ...), real_um, imag_um, sigma_um of motion, real_urad, imag_urad, sigma_urad of twist; further "
    "columns are attributes"
)
_PARTS = ("real", "imag", "sigma")
_TURNS = {"urad": 1e-6, "mrad": 1e-3, "rad": 1.0}


def line_test(table: Table, speed_tolerance: float) -> LineTest:
    """Build a line test; columns: :data:`LINE_COLUMNS`."""
    columns = columns_for(
        table,
        (
            *(words(name) for name in ("run", "force_plane", "plane", "direction", "line")),
            quantity("speed", "rpm", UNITS["frequency"]),
            quantity("frequency", "rpm", UNITS["frequency"]),
            quantity("force", "N", UNITS["force"]),
            *phase_or_angle(table),
            *(quantity(part, "um", UNITS["length"]) for part in _PARTS),
            *(optional(part, _TURNS, name=f"{part} of twist") for part in _PARTS),
        ),
        LINE_COLUMNS,
    )
    run, direction = columns.words("run"), columns.words("direction")
    wrong = np.flatnonzero(~np.isin(direction, ("z", "twist")))
    if wrong.size:
        row = int(wrong[0])
        raise ValueError(f"{table.where(row, 'direction')}: {str(direction[row])!r} unknown; allowed: z, twist")
    speed, frequency = columns.number("speed"), columns.number("frequency")
    parts = {part: _either(columns, direction == "twist", part) for part in _PARTS}
    return LineTest(
        run=run,
        speed=group_speeds(speed, run, speed_tolerance),
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


def _either(columns: Columns, twisting: Bool, part: str) -> Float:
    """A quantity that stands in the column of motion or of twist, each row in its own."""
    motion, twist = columns.number(part, blank=True), columns.number(f"{part} of twist", blank=True)
    values = np.where(twisting, twist, motion)
    if np.isnan(values).any() and part != "sigma":
        row = int(np.flatnonzero(np.isnan(values))[0])
        wanted = f"{part}_urad" if twisting[row] else f"{part}_um"
        raise ValueError(f"{columns.table.source}: line {columns.table.lines[row]} has no {wanted}")
    return values


def line_columns(test: LineTest) -> dict[str, NDArray[Any]]:
    """Columns of a CSV file by name, in rpm, um, urad, N and degrees."""
    rpm = si_factor("frequency", "rpm")
    twisting = test.direction == "twist"
    found: dict[str, NDArray[Any]] = {
        "run": test.run,
        "speed_rpm": test.speed / rpm,
        "frequency_rpm": test.frequency / rpm,
        "force_plane": test.force_plane,
        "force_N": np.abs(test.force),
        "force_phase_deg": np.degrees(np.angle(test.force)),
        "plane": test.plane,
        "direction": test.direction,
        "line": test.line,
    }
    values = {"real": test.response.real, "imag": test.response.imag, "sigma": test.sigma}
    for unit, rows in (("um", ~twisting), ("urad", twisting)):
        if rows.any():
            found |= {f"{name}_{unit}": np.where(rows, v * 1e6, np.nan) for name, v in values.items()}
    return found
