"""Cells of a CSV file as columns of text, found and converted by name and unit; they never change.

Which of them a test needs: :mod:`rotorfit.io.tables.wanted_columns`.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from rotorfit.io.tables.cells import Numbers, frame_cells, lacking, read_cells, taken
from rotorfit.models.array_types import Bool, Float, Index
from rotorfit.units import find_unit, units_of

if TYPE_CHECKING:
    from pandas import DataFrame

PERTURBATION_COLUMNS = (
    "run, speed_rpm, frequency_rpm, force_plane, force_N (or mr_g_mm), force_phase_deg (or force_angle_deg), plane, "
    "direction, amplitude_um (or acceleration_g, velocity_mm_s), phase_deg (or real_um, imag_um), optional sigma_um "
    "(or coherence and averages), probe_radius_mm, force_direction (circular, x, y); other units by suffix, further "
    "columns are attributes"
)
MOTION = units_of("displacement", "tilt")
READING = MOTION | units_of("velocity", "acceleration")


@dataclass(frozen=True, kw_only=True)
class Table:
    """Cells of a CSV file."""

    source: str  # name of the file, for messages
    cells: Mapping[str, Sequence[str]]  # column by lower-case name
    lines: Index  # line of the file of each row
    names: Mapping[str, str]  # column names in their own case, by lower-case name
    written: Mapping[str, str] = field(default_factory=dict)  # as the file has them, where that differs

    def spelled(self, name: str) -> str:
        """Name of a column as it stands in the file."""
        return self.written.get(name, self.names[name])

    def rows(self, rows: Index, without: Container[str] = ()) -> Table:
        """Some of the rows, any number of times each, without some of the columns."""
        cells = {name: taken(values, rows) for name, values in self.cells.items() if name not in without}
        return replace(self, cells=cells, names={key: self.names[key] for key in cells}, lines=self.lines[rows])

    def with_columns(self, columns: Mapping[str, Sequence[str]]) -> Table:
        """The table with further columns, or other cells in columns that it has."""
        names = {name.lower(): name for name in columns}
        cells = {name.lower(): values for name, values in columns.items()}
        return replace(self, cells={**self.cells, **cells}, names={**names, **self.names})

    def renamed(self, new: Mapping[str, str]) -> Table:
        """The table with some columns under other names; messages go on to spell them as the file does."""
        keys = {key: new.get(key, key).lower() for key in self.cells}
        return replace(
            self,
            cells={keys[key]: values for key, values in self.cells.items()},
            names={keys[key]: new.get(key, self.names[key]) for key in keys},
            written={keys[key]: self.spelled(key) for key in keys},
        )

    def find(self, prefix: str, units: Mapping[str, float]) -> dict[str, float]:
        """Columns ``prefix_unit`` with their factors to SI, by lower-case name."""
        factors = {name: self.factor(name, prefix, units) for name in self.cells}
        return {name: factor for name, factor in factors.items() if factor is not None}

    def factor(self, name: str, prefix: str, units: Mapping[str, float]) -> float | None:
        """Factor to SI of a column; ``None`` where it is not this quantity in a known unit."""
        if not name.startswith(prefix + "_"):
            return None
        try:
            return find_unit(self.names[name][len(prefix) + 1 :], units)
        except ValueError as reason:
            raise ValueError(f"{self.source}: column {self.spelled(name)!r}: {reason}") from reason

    def number(self, column: tuple[str, float], *, blank: bool = False) -> Float:
        """Cells of a numeric column in SI units; blank ones are NaN."""
        name, factor = column
        values = floats(self.cells[name])
        if values is None:
            row = next(i for i, cell in enumerate(self.cells[name]) if floats([cell]) is None)
            cell = self.cells[name][row]
            hint = "; write decimals with a point" if floats([cell.replace(",", ".", 1)]) is not None else ""
            raise ValueError(f"{self.where(row, name)}: {cell!r} is not a number{hint}")
        bad = ~np.isfinite(values)
        if blank and bad.any():
            bad &= ~lacking(self.cells[name])
        if bad.any():
            row = int(np.flatnonzero(bad)[0])
            cell = self.cells[name][row] or "a blank cell"
            raise ValueError(
                f"{self.where(row, name)}: {cell} where a finite number is needed ({bad.sum()} such cells in the "
                f"column); remove the readings that were not taken"
            )
        return np.asarray(values * factor)

    def where(self, row: int, name: str) -> str:
        """Place of a cell, for messages."""
        return f"{self.source}: line {self.lines[row]}, column {self.spelled(name)!r}"

    def refuse(self, bad: Bool, name: str, why: str) -> None:
        """Refuse the first bad row."""
        if bad.any():
            row = int(np.flatnonzero(bad)[0])
            raise ValueError(f"{self.where(row, name)}: {self.cells[name][row]} {why}")


def floats(cells: Sequence[str]) -> Float | None:
    """Cells as numbers, blank ones as NaN; None if one of them is not a number."""
    if isinstance(cells, Numbers):
        return cells.values
    longest_number = 64  # characters of a number; what is longer is none
    if max(map(len, cells), default=0) > longest_number:
        return None
    try:
        return np.array([cell or "nan" for cell in cells]).astype(float)
    except ValueError:
        return None


def read_table(
    path: str | Path | DataFrame,
    sheet: str | None,
    is_text: Callable[[str], bool],
    is_unit: Callable[[str], bool],
    progress: Callable[[float], None],
) -> Table:
    """Columns of a CSV file (comma, semicolon or tab), of a sheet of an Excel file or of a table in memory; those that
    are text by their names stay as they are written."""
    if isinstance(path, str | Path):
        source, found = Path(path).name, read_cells(Path(path), sheet, is_text, is_unit, progress)
    else:
        source, found = "DataFrame", frame_cells(path, is_text)
    if found is None:
        raise ValueError(f"{source} is empty; a tidy CSV has a header and rows. Known columns: {PERTURBATION_COLUMNS}")
    header, columns, lines = found
    if not lines.size:
        raise ValueError(f"{source} has one line, {','.join(header)[:80]!r}, and no rows below it; nothing to read")
    names = {name.replace("µ", "u").replace("μ", "u").lower(): name for name in header}
    if len(names) < len(header) or "" in names:
        raise ValueError(f"{source}: every column needs a name of its own, the header is {', '.join(header)}")
    return Table(source=source, cells=dict(zip(names, columns, strict=True)), lines=lines, names=names)
