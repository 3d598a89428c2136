"""Wide tables, one row a frequency and a column a probe: turned into the tidy table of one row a reading.

Columns are recognised by ``<plane>_<x|y>_<unit>`` (amplitude) with ``<plane>_<x|y>_lag_deg`` or ``_deg``, or by
``<plane>_<x|y>_real_<unit>`` and ``_imag_<unit>``; z (already combined), rx and ry as well. Accelerometers have
``<plane>_<x|y>_acceleration_g``, sensors of velocity ``_velocity_mm_s``, and each probe may have its ``_coherence``.
All other columns are repeated for each probe.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from rotorfit.io.tables.cells import Numbers, taken
from rotorfit.io.tables.table import MOTION, Table
from rotorfit.models.array_types import Float
from rotorfit.units import UNITS, units_of

_CHANNEL = re.compile(r"(?P<plane>.+)_(?P<direction>rx|ry|x|y|z)_(?P<rest>.+)")
NOT_PLANES = ("force", "load", "sigma")
"""Beginnings of names that are no plane's."""


@dataclass(frozen=True, kw_only=True)
class _Column:
    """A column of one probe: its name in the table, the tidy column that it becomes, and the factor to its unit."""

    name: str
    tidy: str
    factor: float


def is_wide(table: Table) -> bool:
    """True if the readings stand in a column a probe."""
    return not {"plane", "direction"} & set(table.cells) and bool(_channels(table))


def is_probe(name: str) -> bool:
    """True if a column is one of a probe."""
    return _parts(name) is not None


def tidy(table: Table) -> Table:
    """The same readings, one a row."""
    channels = _channels(table)
    for (plane, direction), columns in channels.items():
        kinds = sorted(column.tidy.split("_")[0] for column in columns if column.tidy != "coherence")
        if kinds not in (["amplitude", "phase"], ["imag", "real"]):
            have = ", ".join(table.spelled(column.name) for column in columns)
            raise ValueError(
                f"{table.source}: probe {plane} {direction} has {have}; it needs an amplitude and a phase "
                f"({plane}_{direction}_um and {plane}_{direction}_lag_deg or _deg), or _real_um and _imag_um"
            )
    own = {column.name for columns in channels.values() for column in columns}
    rows, count = len(table.lines), len(channels)
    repeated = np.repeat(np.arange(rows), count)
    cells = {name: taken(values, repeated) for name, values in table.cells.items() if name not in own}
    cells["plane"] = [plane for plane, _ in channels] * rows
    cells["direction"] = [direction for _, direction in channels] * rows
    values: dict[str, Float] = {}
    for k, columns in enumerate(channels.values()):
        for column in columns:
            target = values.setdefault(column.tidy, np.full(rows * count, np.nan))
            target[k::count] = table.number((column.name, column.factor), blank=True)
    cells |= {name: Numbers(found) for name, found in values.items()}
    lines = table.lines[repeated]
    names = {name: table.names.get(name, name) for name in cells}
    return replace(table, cells=cells, lines=lines, names=names)


def _channels(table: Table) -> dict[tuple[str, str], list[_Column]]:
    found: dict[tuple[str, str], list[_Column]] = {}
    # The plane as the column of forced planes spells it, or else its first column.
    spelled = {_plain(cell): cell for cell in dict.fromkeys(table.cells.get("force_plane", ()))}
    for name in table.cells:
        if (parts := _parts(name)) is not None:
            size, direction, column = parts
            plane = table.names[name][:size]
            found.setdefault((spelled.setdefault(_plain(plane), plane), direction), []).append(column)
    return {key: columns for key, columns in found.items() if any(not c.tidy.startswith("phase") for c in columns)}


def _plain(plane: str) -> str:
    """A plane's name in one spelling, whatever its case and what parts its words."""
    return re.sub(r"[\W_]+", "_", plane.lower())


def _parts(name: str) -> tuple[int, str, _Column] | None:
    """Length of the plane's name, direction and meaning of the column of a probe; ``None`` for any other."""
    match = _CHANNEL.fullmatch(name)
    if match is None or match["plane"].split("_")[0] in NOT_PLANES:
        return None
    column = _column(name, match["direction"], match["rest"])
    return None if column is None else (len(match["plane"]), match["direction"], column)


def _column(name: str, direction: str, rest: str) -> _Column | None:
    tilt = direction.startswith("r")
    tidy_unit = "urad" if tilt else "um"
    units = MOTION if tilt else units_of("displacement")  # degrees beside a length are those of its phase
    for prefix in ("real", "imag", "amplitude"):
        unit = rest.removeprefix(f"{prefix}_")
        if unit in units and (unit != rest or prefix == "amplitude"):
            return _Column(name=name, tidy=f"{prefix}_{tidy_unit}", factor=units[unit] * 1e6)
    if rest == "coherence":
        return _Column(name=name, tidy=rest, factor=1.0)
    if not tilt and (found := _rate(name, rest)) is not None:
        return found
    unit = rest.removeprefix("phase_")
    if unit in UNITS["phase"]:
        return _Column(name=name, tidy="phase_deg", factor=UNITS["phase"][unit] / UNITS["phase"]["deg"])
    return None


def _rate(name: str, rest: str) -> _Column | None:
    """Meaning of the column of a sensor of velocity or acceleration, in SI units."""
    for quantity, usual in (("velocity", "m_s"), ("acceleration", "m_s2")):
        for prefix, part in ((quantity, "amplitude"), ("real", "real"), ("imag", "imag")):
            unit = rest.removeprefix(f"{prefix}_")
            if unit != rest and unit in UNITS[quantity]:
                return _Column(name=name, tidy=f"{part}_{usual}", factor=UNITS[quantity][unit])
    return None


def renamed(table: Table, columns: Mapping[str, str]) -> Table:
    """The table with columns under the names that rotorfit knows."""
    spelled = {name.lower(): name for name in table.names.values()} | {name: name for name in table.names.values()}
    by_key = {spelling: key for key, spelling in table.names.items()}
    new = {}
    for first, second in columns.items():
        # Either way round: what the file has is its own name.
        turned = first.lower() not in spelled and second.lower() in spelled
        given, name = (second, first) if turned else (first, second)
        if given not in by_key and given.lower() not in spelled:
            raise ValueError(
                f"{table.source} has no column {given!r} to call {name!r} (THEIRS=OURS); it has "
                f"{', '.join(table.names.values())}"
            )
        new[by_key[spelled.get(given, spelled.get(given.lower(), given))]] = name
    cells = {new.get(key, key).lower(): values for key, values in table.cells.items()}
    if len(cells) < len(table.cells):
        raise ValueError(f"{table.source}: two columns would have the same name after renaming: {', '.join(columns)}")
    names = {new.get(key, key).lower(): new.get(key, name) for key, name in table.names.items()}
    return replace(table, cells=cells, names=names)


def with_constants(table: Table, values: Mapping[str, str | float]) -> Table:
    """The table with columns that have one value throughout, for what a file does not say of itself."""
    taken = [name for name in values if name.lower() in table.cells]
    if taken:
        raise ValueError(f"{table.source} has a column {taken[0]!r} of its own; no constant may take its place")
    cells = {name.lower(): [str(value)] * len(table.lines) for name, value in values.items()}
    names = {name.lower(): name for name in values}
    return replace(table, cells={**table.cells, **cells}, names={**table.names, **names})
