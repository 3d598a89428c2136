"""Cells of a CSV file as columns of text, found and converted by name and unit."""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rotorfit.io.cells import read_cells
from rotorfit.io.sampling import time_factor
from rotorfit.models.array_types import Float, Text
from rotorfit.models.parameters import unknown_name
from rotorfit.units import UNITS, find_unit, units_of

PERTURBATION_COLUMNS = (
    "run, speed_rpm, frequency_rpm, force_plane, force_N (or mr_g_mm), force_phase_deg, plane, direction, "
    "amplitude_um, phase_deg (or real_um, imag_um), optional sigma_um, probe_radius_mm, force_direction (circular, x, "
    "y); "
    "other units by suffix, further columns are attributes"
)
MOTION = units_of("displacement", "tilt")
_PREFIXES = {
    "speed": UNITS["frequency"],
    "frequency": UNITS["frequency"],
    "force_phase": UNITS["phase"],
    "phase": UNITS["phase"],
    "force": UNITS["force"],
    "mr": UNITS["unbalance"],
    "amplitude": MOTION,
    "real": MOTION,
    "imag": MOTION,
    "sigma": MOTION,
    "probe_radius": UNITS["length"],
}


@dataclass(kw_only=True)
class Table:
    """Cells of a CSV file as text, and what of it has been understood so far.

    Attributes:
        source: name of the file, for messages.
        cells: column by lower-case name.
        lines: line of the file of each row.
        names: column names as the file spells them, by lower-case name.
    """

    source: str
    cells: Mapping[str, Sequence[str]]
    lines: Sequence[int]
    names: Mapping[str, str]
    used: set[str] = field(default_factory=set)
    missing: list[str] = field(default_factory=list)

    def find(self, prefix: str, units: Mapping[str, float], wanted: str = "") -> dict[str, float]:
        """Columns ``prefix_unit`` with their factors to SI; without any, ``wanted`` goes on the list of the missing."""
        found: dict[str, float] = {}
        for name in self.cells:
            factor = self._factor(name, prefix, units)
            if factor is not None:
                found[name] = factor
        self.used |= set(found)
        if not found and wanted:
            self.missing.append(wanted)
        return found

    def _factor(self, name: str, prefix: str, units: Mapping[str, float]) -> float | None:
        """Factor to SI of a column that is a quantity in a known unit."""
        if not name.startswith(prefix + "_"):
            return None
        try:
            return find_unit(self.names[name][len(prefix) + 1 :], units)
        except ValueError as reason:
            raise ValueError(f"{self.source}: column {self.names[name]!r}: {reason}") from reason

    def one(self, prefix: str, units: Mapping[str, float], wanted: str = "") -> tuple[str, float] | None:
        """The only column ``prefix_unit``.

        Raises:
            ValueError: there are several.
        """
        found = self.find(prefix, units, wanted)
        if len(found) > 1:
            raise ValueError(f"{self.source}: {prefix} is given twice, as {' and '.join(found)}; keep one of them")
        return next(iter(found.items()), None)

    def text(self, name: str) -> str:
        """Name of a text column, noted as missing if it is not there."""
        if name in self.cells:
            self.used.add(name)
        else:
            self.missing.append(name)
        return name

    def words(self, name: str) -> Text:
        """Cells of a text column, none of them blank."""
        cells = self.cells[name]
        if "" in cells:
            raise ValueError(f"{self.where(cells.index(''), name)} is blank; every reading needs its {name}")
        return np.array(cells, dtype=str)

    def number(self, column: tuple[str, float], *, blank: bool = False) -> Float:
        """Cells of a numeric column times its factor; blank cells are NaN where ``blank`` allows them."""
        name, factor = column
        values = _floats(self.cells[name])
        if values is None:
            row = next(i for i, cell in enumerate(self.cells[name]) if _floats([cell]) is None)
            cell = self.cells[name][row]
            hint = "; write decimals with a point" if _floats([cell.replace(",", ".", 1)]) is not None else ""
            raise ValueError(f"{self.where(row, name)}: {cell!r} is not a number{hint}")
        empty = np.array([not cell for cell in self.cells[name]])
        bad = ~np.isfinite(values) & ~(empty & blank)
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
        return f"{self.source}: line {self.lines[row]}, column {self.names[name]!r}"

    def check_columns(self, known: str) -> None:
        """Refuse missing columns, and columns that are a known quantity with an unknown unit.

        Raises:
            ValueError: lists what is missing, what was not recognised and what is known.
        """
        extra = [name for name in self.cells if name not in self.used]
        if self.missing and self._raw():
            columns = ", ".join(self.names.values())[:80]
            raise ValueError(
                f"{self.source} looks like raw signals ({len(self.lines)} samples of {columns}), not like vectors: "
                f"`rotorfit template {self.source} > rig.toml` makes a setup to fill in; then give --setup rig.toml, "
                "or use rf.read_recording"
            )
        if self.missing:
            unknown = ", ".join(_suggest(self.names[name]) for name in extra) or "none"
            raise ValueError(
                f"{self.source}: missing columns: {', '.join(self.missing)}. Columns not recognised: {unknown}. "
                f"Known: {known}"
            )
        for name in extra:
            prefix = next((p for p in _PREFIXES if name.startswith(p + "_")), None)
            near = difflib.get_close_matches(name, ["sigma_um", "probe_radius_mm"], n=1, cutoff=0.85)
            if prefix and self._factor(name, prefix, _PREFIXES[prefix]) is not None:
                raise ValueError(
                    f"{self.source}: column {self.names[name]!r} has no place in this test. Known: {known}. If it is "
                    "an attribute of the test, give it another name"
                )
            if prefix or near:
                tail = unknown_name("unit", name[len(prefix) + 1 :], _PREFIXES[prefix]) if prefix else ""
                raise ValueError(
                    f"{self.source}: unknown column {self.names[name]!r}; "
                    f"{tail or f'did you mean {near[0]!r}?'} If it is an attribute of the test, give it another name"
                )

    def _raw(self) -> bool:
        """Whether this holds samples over time: nothing of a test is in it, but times or very many rows."""
        times = {name for name in self.cells if time_factor(name) is not None}
        if self.used - times:
            return False
        return bool(times) or len(self.lines) >= 1000

    def attributes(self) -> dict[str, NDArray[Any]]:
        """All columns not used otherwise, as numbers where every cell is one (blank: NaN), else as text."""
        extra = {self.names[name]: cells for name, cells in self.cells.items() if name not in self.used}
        numbers = {name: _floats(cells) if any(cells) else None for name, cells in extra.items()}
        return {
            name: np.array(cells, dtype=str) if (values := numbers[name]) is None else values
            for name, cells in extra.items()
        }


def _floats(cells: Sequence[str]) -> Float | None:
    try:
        return np.array([cell or "nan" for cell in cells]).astype(float)
    except ValueError:
        return None


def _suggest(name: str) -> str:
    columns = [f"{prefix}_{unit}" for prefix, units in _PREFIXES.items() for unit in units]
    near = difflib.get_close_matches(name.lower(), ["run", "force_plane", "plane", "direction", *columns], n=1)
    return f"{name!r} (did you mean {near[0]!r}?)" if near else repr(name)


def read_table(path: str | Path, sheet: str | None = None) -> Table:
    """Columns of text of a CSV file (comma, semicolon or tab) or of a sheet of an Excel file.

    Args:
        path: the file.
        sheet: name of the sheet, by default the first.

    Raises:
        ValueError: the file is empty, has no rows, repeats a column, or a row is not as long as the header.
        FileNotFoundError: no such file.
    """
    source = Path(path).name
    found = read_cells(Path(path), sheet)
    if found is None:
        raise ValueError(f"{source} is empty; a tidy CSV has a header and rows. Known columns: {PERTURBATION_COLUMNS}")
    header = found.header
    if not found.rows:
        raise ValueError(f"{source} has one line, {','.join(header)[:80]!r}, and no rows below it; nothing to read")
    names = {name.replace("µ", "u").replace("μ", "u").lower(): name for name in header}
    if len(names) < len(header) or "" in names:
        raise ValueError(f"{source}: every column needs a name of its own, the header is {', '.join(header)}")
    columns = [list(column) for column in zip(*found.rows, strict=True)]
    return Table(source=source, cells=dict(zip(names, columns, strict=True)), lines=found.lines, names=names)
