"""Columns of a table as text, found and converted by name and unit; and which of them a test is read from.

A :class:`Table` never changes. A builder says with :func:`words` and :func:`quantity` what it wants, and
:func:`columns_for` answers with a record that has all of it, or refuses the table. Only that record hands out
values, so none is read from a file that lacks a column.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rotorfit.base.array_types import Bool, Float, Index, Text
from rotorfit.base.digits import counted
from rotorfit.base.file_reading import check_whole, shown
from rotorfit.base.names import nearest, unknown_name
from rotorfit.base.units import UNITS, find_unit, units_of
from rotorfit.lab.data.findings import Finding
from rotorfit.lab.io.sampling import time_factor
from rotorfit.lab.io.tables.cells import NOT_TAKEN, Numbers, frame_cells, lacking, read_cells, taken
from rotorfit.lab.io.tables.json_records import SUFFIXES, json_frame
from rotorfit.lab.io.tables.stiffness_tables import refuse_ratios

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


@dataclass(frozen=True, kw_only=True, eq=False)
class Table:
    """Cells of a CSV file."""

    source: str  # name of the file, for messages
    cells: Mapping[str, Sequence[str]]  # column by lower-case name
    lines: Index  # line of the file of each row
    names: Mapping[str, str]  # column names in their own case, by lower-case name
    written: Mapping[str, str] = field(default_factory=dict)  # as the file has them, where that differs
    found: tuple[Finding, ...] = ()  # what was left out on the way here

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

    def noted(self, code: str, words: str) -> Table:
        """The table with a note on what was left out of it."""
        return replace(self, found=(*self.found, Finding("note", code, words)))

    def lines_of(self, rows: Index) -> str:
        """``lines 3, 4``, the first five of those that rows stand in, for messages."""
        distinct = list(dict.fromkeys(self.lines[rows].tolist()))
        more = ", ..." if len(distinct) > 5 else ""
        return f"line{'s' * (len(distinct) > 1)} {', '.join(map(str, distinct[:5]))}{more}"

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
                f"{self.where(row, name)}: {cell} where a finite number is needed ({counted(bad.sum(), 'such cell')} "
                "in the column); remove the readings that were not taken"
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
    source = Path(path).name if isinstance(path, str | Path) else "DataFrame"
    beside: list[str] = []
    if isinstance(path, str | Path) and Path(path).suffix.lower() not in SUFFIXES:
        check_whole(Path(path), "a table")
        found = read_cells(Path(path), sheet, is_text, is_unit, progress)
    else:
        frame, beside = json_frame(Path(path)) if isinstance(path, str | Path) else (path, beside)
        found = frame_cells(frame, is_text, source)
    if found is None:
        raise ValueError(f"{source} is empty; a tidy CSV has a header and rows. Known columns: {PERTURBATION_COLUMNS}")
    header, columns, lines = found
    if not lines.size:
        raise ValueError(f"{source} has one line, {','.join(header)[:80]!r}, and no rows below it; nothing to read")
    names = {name.replace("µ", "u").replace("μ", "u").lower(): name for name in header}
    if len(names) < len(header) or "" in names:
        raise ValueError(f"{source}: every column needs a name of its own, the header is {', '.join(header)}")
    table = Table(source=source, cells=dict(zip(names, columns, strict=True)), lines=lines, names=names)
    if not beside:
        return table
    keys = f"{source}: keys beside the records are not read: {', '.join(map(shown, beside))}"
    return table.noted("keys", f"{keys}; what holds for all readings is given with --constant NAME=VALUE (constants=)")


# ---- columns that a test is read from ------------------------------------------------------------------------------

PREFIXES = {
    "speed": UNITS["frequency"],
    "frequency": UNITS["frequency"],
    **{f"force_{axis}_phase": UNITS["phase"] for axis in "xy"},
    **{f"force_{axis}": UNITS["force"] for axis in "xy"},
    "force_sigma": UNITS["force"],
    "force_phase": UNITS["phase"],
    "force_angle": UNITS["angle"],
    "phase": UNITS["phase"],
    "force": UNITS["force"],
    "mr": UNITS["unbalance"],
    "amplitude": READING,
    "acceleration": UNITS["acceleration"],
    "velocity": UNITS["velocity"],
    "real": READING,
    "imag": READING,
    "sigma": READING,
    "probe_radius": UNITS["length"],
}
"""Units of the quantities of perturbation tests by the beginning of their columns' names."""


@dataclass(frozen=True, kw_only=True)
class Wanted:
    """A column that a test is read from; made by :func:`words` or :func:`quantity`."""

    name: str  # by which the values are asked for
    prefix: str  # beginning of the column's name, before its unit; the whole name of a column of text
    units: Mapping[str, float] | None = None  # factor to SI by unit; none for text
    missing: str = ""  # its name in the error for a file without it; empty where the column may be left out
    several: bool = False  # whether there may be one in units of length and one in units of angle

    def columns(self, table: Table) -> dict[str, float]:
        """Columns of a table that are this one, with their factors to SI."""
        if self.units is None:
            return {self.prefix: 1.0} if self.prefix in table.cells else {}
        found = table.find(self.prefix, self.units)
        if len(found) > 1 and not self.several:
            raise ValueError(
                f"{table.source}: {self.prefix} is given twice, as {' and '.join(found)}; keep one of them"
            )
        return found


def words(name: str, *, needed: bool = True) -> Wanted:
    """A column of text."""
    return Wanted(name=name, prefix=name, missing=name if needed else "")


def quantity(
    prefix: str, units: Mapping[str, float], usual: str = "", *, name: str = "", several: bool = False
) -> Wanted:
    """A column of numbers in a unit that its name ends with; without a usual one it may be left out."""
    missing = f"{prefix}_{usual}" if usual else ""
    return Wanted(name=name or prefix, prefix=prefix, units=units, missing=missing, several=several)


def phase_or_angle(table: Table) -> tuple[Wanted, Wanted]:
    """The columns of a turning force's angle, of which a file has one: see :meth:`Columns.force_phase`."""
    for name in table.cells:
        if name.startswith("force_angle_lag"):
            raise ValueError(
                f"{table.source}: column {table.spelled(name)!r}: an angle from x towards y does not lag; give "
                "force_angle_deg with its sign, or force_phase_lag_deg"
            )
    given = table.find("force_angle", UNITS["angle"])
    if given and (phases := table.find("force_phase", UNITS["phase"])):
        both = " and ".join(table.names[next(iter(found))] for found in (phases, given))
        raise ValueError(f"{table.source}: both {both} are given; keep one of them")
    return quantity("force_phase", UNITS["phase"], "" if given else "deg"), quantity("force_angle", UNITS["angle"])


@dataclass(frozen=True, kw_only=True)
class Columns:
    """Columns of a table under the names by which a test asks for them; made by :func:`columns_for`."""

    table: Table  # where they stand
    found: Mapping[str, Mapping[str, float]]  # factor to SI by column of the table, by name

    @property
    def rows(self) -> int:
        """Number of rows."""
        return len(self.table.lines)

    @cached_property
    def attributes(self) -> dict[str, NDArray[Any]]:
        """All other columns, as numbers where every cell is one (blank, or as n/a: NaN), else as text."""
        used = _names(self.found)
        extra = {self.table.names[name]: cells for name, cells in self.table.cells.items() if name not in used}
        found = {}
        for name, cells in extra.items():
            missing = lacking(cells, NOT_TAKEN)
            values = floats(taken(cells, np.flatnonzero(~missing)))
            if values is None or missing.all():
                found[name] = np.array(cells, dtype=str)
            else:
                found[name] = np.full(len(cells), np.nan)
                found[name][~missing] = values
        return found

    def has(self, name: str) -> bool:
        """True if an optional column is there."""
        return bool(self.found[name])

    def words(self, name: str, otherwise: str = "") -> Text:
        """Cells of a column of text, none of them blank."""
        if not self.found[name]:
            return np.broadcast_to(otherwise, self.rows)
        column = next(iter(self.found[name]))
        cells = self.table.cells[column]
        if "" in cells:
            raise ValueError(f"{self.table.where(cells.index(''), column)} is blank; every reading needs its {column}")
        if len(set(cells)) == 1:  # shown in every row, kept once
            return np.broadcast_to(cells[0], len(cells))
        return np.array(cells, dtype=str)

    def number(self, name: str, *, blank: bool = False) -> Float:
        """A column in SI units; NaN in blank cells, and throughout if it is not there."""
        if not self.found[name]:
            return np.broadcast_to(np.nan, self.rows)
        return self.table.number(next(iter(self.found[name].items())), blank=blank)

    def force_phase(self, frequency: Float) -> Float:
        """Phases of turning forces, the delta of eq. (2), rad.

        ``force_angle`` is the angle at which a force points at the time of the mark, from x towards y: it counts with
        the turning of a forward force and against that of a backward one. ``force_phase`` is the phase itself.
        """
        if self.has("force_angle"):
            return np.where(frequency < 0, -1.0, 1.0) * self.number("force_angle")
        return self.number("force_phase")

    def where(self, row: int, name: str) -> str:
        """Place of a cell of a column that is there, for messages."""
        return self.table.where(row, next(iter(self.found[name])))

    def refuse(self, bad: Bool, name: str, why: str) -> None:
        """Refuse the first bad row of a column that is there, as :meth:`Table.refuse` does."""
        if bad.any():
            self.table.refuse(bad, next(iter(self.found[name])), why)


def columns_for(table: Table, wanted: Iterable[Wanted], known: str) -> Columns:
    """The columns that a test is read from."""
    wanted = tuple(wanted)
    found = {one.name: one.columns(table) for one in wanted}
    missing = [one.missing for one in wanted if one.missing and not found[one.name]]
    used = _names(found)
    others = [name for name in table.cells if name not in used]
    if missing:
        _refuse_missing(table, others, missing, known)
    for name in others:
        _refuse_mistaken(table, name, known)
    return Columns(table=table, found=found)


def _names(found: Mapping[str, Mapping[str, float]]) -> set[str]:
    return {name for columns in found.values() for name in columns}


def _refuse_missing(table: Table, others: Sequence[str], missing: Sequence[str], known: str) -> None:
    """Refuse a table without columns that a test needs; ``others`` are those that it has and that are not used."""
    times = {name for name in table.cells if time_factor(name) is not None}
    if not set(table.cells) - {*others} - times and (times or len(table.lines) >= 1000):  # nothing of a test is in it
        columns = ", ".join(table.names.values())[:80]
        raise ValueError(
            f"{table.source} looks like raw signals ({len(table.lines)} samples of {columns}), not like vectors: "
            f"`rotorfit template {table.source} > rig.toml` makes a setup to fill in; then read it with that "
            "(rf.read_recording, --setup rig.toml)"
        )
    refuse_ratios(table, others)
    names = ["run", "force_plane", "plane", "direction", *(f"{p}_{unit}" for p, us in PREFIXES.items() for unit in us)]
    unknown = []
    for name in map(table.names.__getitem__, others):
        odd = _odd_unit(name.lower())
        near = nearest(name.lower(), names, 0.85 if odd else 0.6)  # no other quantity than the one that is named
        unknown.append(f"{name!r} (did you mean {near!r}?)" if near else f"{name!r}{odd}")
    raise ValueError(
        f"{table.source}: missing columns: {', '.join(missing)}. Columns not recognised: "
        f"{', '.join(unknown) or 'none'}. Known: {known}. A column of another name is said with it (columns=, "
        "--column THEIRS=OURS)"
    )


def _odd_unit(name: str) -> str:
    """Why the column of a quantity in an unknown unit is none, in brackets; empty for other columns."""
    prefix = next((p for p in PREFIXES if name.startswith(p + "_")), None)
    if prefix is None:
        return ""
    unit = name[len(prefix) + 1 :]
    if unit.partition("_")[0] in ("db", "dbm", "dbv"):
        return " (a level in dB: its amplitude is the reference times 10^(dB/20))"
    return f" (its unit {unit!r} is none of {', '.join(_units_of(prefix))})"


def _units_of(prefix: str) -> list[str]:
    """Units that a quantity usually has, for sentences: of readings lengths, without the ways to say an amplitude."""
    usual = UNITS["length"] if prefix in ("amplitude", "real", "imag", "sigma") else PREFIXES[prefix]
    return [unit for unit in usual if not unit.endswith(("_pk", "_0p", "_pp", "_rms"))]


def _refuse_mistaken(table: Table, name: str, known: str) -> None:
    """Refuse a column that nothing asks for if it was hardly meant as an attribute of the test."""
    if name in ("sigma", "force_sigma", "probe_radius"):  # what no column in another unit says instead
        units = ", ".join(_units_of(name))
        raise ValueError(f"{table.source}: column {table.names[name]!r} has no unit; {name}_UNIT has one of {units}")
    prefix = next((p for p in PREFIXES if name.startswith(p + "_")), None)
    if prefix in ("velocity", "acceleration"):  # of a flow, say, where the motion was read by other sensors
        return
    near = nearest(name, ["sigma_um", "probe_radius_mm"], 0.85)
    if prefix and table.factor(name, prefix, PREFIXES[prefix]) is not None:
        raise ValueError(
            f"{table.source}: column {table.names[name]!r} has no place in this test. Known: {known}. If it is "
            "an attribute of the test, give it another name"
        )
    if prefix or near:
        tail = f"{unknown_name('unit', name[len(prefix) + 1 :], _units_of(prefix))}." if prefix else ""
        raise ValueError(
            f"{table.source}: unknown column {table.names[name]!r}; "
            f"{tail or f'did you mean {near!r}?'} If it is an attribute of the test, give it another name"
        )
