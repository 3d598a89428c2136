"""Columns that are turned into the rows of a tidy table: a column a probe, and a force along x beside one along y.

Columns of a probe are recognised by ``<plane>_<x|y>_<unit>`` (amplitude) with ``<plane>_<x|y>_lag_deg`` or ``_deg``, or
by ``<plane>_<x|y>_real_<unit>`` and ``_imag_<unit>``; z (already combined), rx and ry as well. Accelerometers have
``<plane>_<x|y>_acceleration_g``, sensors of velocity ``_velocity_mm_s``, and each probe may have its ``_coherence``.
All other columns are repeated for each probe.

A row with ``force_x_N, force_x_phase_deg, force_y_N, force_y_phase_deg`` is one reading under two forces that are
measured at once (two shakers, a magnetic bearing, cross-talk of the other shaker), which the tidy table has as two rows
that differ in force and ``force_direction``.
"""

from __future__ import annotations

import re
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from rotorfit.io.tables.cells import Numbers
from rotorfit.io.tables.table import MOTION, Table
from rotorfit.models.array_types import Float
from rotorfit.units import UNITS, si_factor, units_of

_CHANNEL = re.compile(r"(?P<plane>.+)_(?P<direction>rx|ry|x|y|z)_(?P<rest>.+)")
NOT_PLANES = ("force", "load", "sigma")
"""Beginnings of names that are no plane's."""


class _Column(NamedTuple):
    """A column of one probe."""

    name: str  # in the table
    tidy: str  # that it becomes
    factor: float  # to the unit of that


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
    rows, count = len(table.lines), len(channels)
    values: dict[str, Float] = {}
    for k, columns in enumerate(channels.values()):
        for column in columns:
            target = values.setdefault(column.tidy, np.full(rows * count, np.nan))
            target[k::count] = table.number((column.name, column.factor), blank=True)
    own = {column.name for columns in channels.values() for column in columns}
    places = {"plane": [plane for plane, _ in channels] * rows, "direction": [at for _, at in channels] * rows}
    repeated = table.rows(np.repeat(np.arange(rows), count), without=own).with_columns(places)
    return repeated.with_columns({name: Numbers(found) for name, found in values.items()})


def _channels(table: Table) -> dict[tuple[str, str], list[_Column]]:
    """Columns by plane and direction of the probe."""

    def plain(plane: str) -> str:  # in one spelling, whatever its case and what parts its words
        return re.sub(r"[\W_]+", "_", plane.lower())

    found: dict[tuple[str, str], list[_Column]] = {}
    # The plane as the column of forced planes spells it, or else its first column.
    spelled = {plain(cell): cell for cell in dict.fromkeys(table.cells.get("force_plane", ()))}
    for name in table.cells:
        if (parts := _parts(name)) is not None:
            size, direction, column = parts
            plane = table.names[name][:size]
            found.setdefault((spelled.setdefault(plain(plane), plane), direction), []).append(column)
    return {key: columns for key, columns in found.items() if any(not c.tidy.startswith("phase") for c in columns)}


def _parts(name: str) -> tuple[int, str, _Column] | None:
    """Length of the plane's name, direction and meaning of the column of a probe; ``None`` for any other."""
    match = _CHANNEL.fullmatch(name)
    if match is None or match["plane"].split("_")[0] in NOT_PLANES:
        return None
    meaning = _meaning(match["rest"], tilt=match["direction"].startswith("r"))
    return None if meaning is None else (len(match["plane"]), match["direction"], _Column(name, *meaning))


def _meaning(rest: str, *, tilt: bool) -> tuple[str, float] | None:
    """Tidy column, and factor to its unit, that the end of the name of a probe's column means."""
    units = MOTION if tilt else units_of("displacement")  # degrees beside a length are those of its phase
    for part in ("real", "imag", "amplitude"):
        unit = rest.removeprefix(f"{part}_")
        if unit in units and (unit != rest or part == "amplitude"):
            return f"{part}_{'urad' if tilt else 'um'}", units[unit] * 1e6
    if rest == "coherence":
        return rest, 1.0
    for quantity, usual in () if tilt else (("velocity", "m_s"), ("acceleration", "m_s2")):  # in SI units
        for prefix, part in ((quantity, "amplitude"), ("real", "real"), ("imag", "imag")):
            unit = rest.removeprefix(f"{prefix}_")
            if unit != rest and unit in UNITS[quantity]:
                return f"{part}_{usual}", UNITS[quantity][unit]
    unit = rest.removeprefix("phase_")
    return ("phase_deg", UNITS["phase"][unit] / si_factor("phase", "deg")) if unit in UNITS["phase"] else None


# ---- forces along x and along y ---------------------------------------------------------------------------------


def with_force_rows(table: Table) -> Table:
    """The table with a row for each force in place of columns for each axis; as it is without such columns.

    Raises:
        ValueError: a force without its phase, or columns of the usual force beside them.
    """
    given = {axis: found for axis in "xy" if (found := _force_columns(table, axis)) is not None}
    if not given:
        return table
    own = {name for force, phase in given.values() for name, _ in (force, phase)}
    usual = ("force", UNITS["force"]), ("mr", UNITS["unbalance"]), ("force_phase", UNITS["phase"])
    beside = [name for prefix, units in (*usual, ("force_angle", UNITS["angle"])) for name in table.find(prefix, units)]
    beside += [name for name in ("force_direction",) if name in table.cells]
    if beside:
        both = " and ".join(table.spelled(name) for name in (beside[0], sorted(own)[0]))
        raise ValueError(
            f"{table.source}: {both} are both given. Forces along x and y are in columns of their own; leave "
            f"{', '.join(table.spelled(name) for name in beside)} out"
        )
    axes = list(given)
    size, phase = (np.stack([table.number(found[k]) for found in given.values()], axis=1) for k in (0, 1))
    # first that of the shaker that drives the run, then its cross-talk
    runs = table.cells.get("run", [""] * len(table.lines))
    power: dict[str, Float] = {}
    for run, row in zip(runs, size, strict=True):
        power[run] = power.get(run, 0.0) + row**2
    order = {run: np.argsort(-own, kind="stable") for run, own in power.items()}
    place = np.array([order[run] for run in runs])
    new = {
        "force_direction": [axes[k] for k in place.ravel().tolist()],
        "force_N": Numbers(np.take_along_axis(size, place, axis=1).ravel()),
        "force_phase_deg": Numbers(np.take_along_axis(phase, place, axis=1).ravel() / si_factor("phase", "deg")),
    }
    rows = table.rows(np.repeat(np.arange(len(size)), len(axes)), without=own).with_columns(new)
    return replace(
        rows, written={**table.written, **dict.fromkeys(("force_n", "force_direction"), "force_x_N, force_y_N")}
    )


def _force_columns(table: Table, axis: str) -> tuple[tuple[str, float], tuple[str, float]] | None:
    """Columns of the force along an axis and of its phase, with their factors to SI."""
    found = []
    for prefix, units in ((f"force_{axis}", UNITS["force"]), (f"force_{axis}_phase", UNITS["phase"])):
        own = table.find(prefix, units)
        if len(own) > 1:
            raise ValueError(f"{table.source}: {prefix} is given twice, as {' and '.join(own)}; keep one of them")
        found.append(next(iter(own.items()), None))
    size, phase = found
    if size is not None and phase is not None:
        return size, phase
    if size is None and phase is None:
        return None
    lacking = f"force_{axis}_phase_deg" if phase is None else f"force_{axis}_N"
    raise ValueError(f"{table.source}: missing columns: {lacking}. A force along {axis} has a size and a phase")
