"""Which columns a test is read from: declared first, found all together or refused, then read.

A builder says with :func:`words`, :func:`quantity` and :func:`optional` what it wants, and :func:`columns_for` answers
with a record that has all of it. Only that record hands out values, so none is read from a file that lacks a column.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rotorfit.io.sampling import time_factor
from rotorfit.io.tables.cells import NOT_TAKEN, lacking, taken
from rotorfit.io.tables.table import READING, Table, floats
from rotorfit.models.array_types import Bool, ComplexArray, Float, Text
from rotorfit.models.parameters import unknown_name
from rotorfit.units import UNITS

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
    """A column that a test is read from; made by :func:`words`, :func:`quantity`, :func:`optional`."""

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


def quantity(prefix: str, usual: str, units: Mapping[str, float], *, name: str = "", several: bool = False) -> Wanted:
    """A column of numbers in a unit that its name ends with, without which a file is refused."""
    return Wanted(name=name or prefix, prefix=prefix, units=units, missing=f"{prefix}_{usual}", several=several)


def optional(prefix: str, units: Mapping[str, float], *, name: str = "", several: bool = False) -> Wanted:
    """A column of numbers that may be left out."""
    return Wanted(name=name or prefix, prefix=prefix, units=units, several=several)


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
    phase = optional if given else partial(quantity, usual="deg")
    return phase("force_phase", units=UNITS["phase"]), optional("force_angle", UNITS["angle"])


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

    def phasor(self, size: str, angle: str) -> ComplexArray:
        """Complex numbers of two columns, their size and their angle."""
        return np.asarray(self.number(size) * np.exp(1j * self.number(angle)))

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
    names = ["run", "force_plane", "plane", "direction", *(f"{p}_{unit}" for p, us in PREFIXES.items() for unit in us)]
    unknown = []
    for name in map(table.names.__getitem__, others):
        near = difflib.get_close_matches(name.lower(), names, n=1)
        unknown.append(f"{name!r} (did you mean {near[0]!r}?)" if near else repr(name))
    raise ValueError(
        f"{table.source}: missing columns: {', '.join(missing)}. Columns not recognised: "
        f"{', '.join(unknown) or 'none'}. Known: {known}. A column of another name is said with it (columns=, "
        "--column NAME=THEIRS)"
    )


def _refuse_mistaken(table: Table, name: str, known: str) -> None:
    """Refuse a column that nothing asks for if it was hardly meant as an attribute of the test."""
    prefix = next((p for p in PREFIXES if name.startswith(p + "_")), None)
    if prefix in ("velocity", "acceleration"):  # of a flow, say, where the motion was read by other sensors
        return
    near = difflib.get_close_matches(name, ["sigma_um", "probe_radius_mm"], n=1, cutoff=0.85)
    if prefix and table.factor(name, prefix, PREFIXES[prefix]) is not None:
        raise ValueError(
            f"{table.source}: column {table.names[name]!r} has no place in this test. Known: {known}. If it is "
            "an attribute of the test, give it another name"
        )
    if prefix or near:
        tail = unknown_name("unit", name[len(prefix) + 1 :], PREFIXES[prefix]) if prefix else ""
        raise ValueError(
            f"{table.source}: unknown column {table.names[name]!r}; "
            f"{tail or f'did you mean {near[0]!r}?'} If it is an attribute of the test, give it another name"
        )
