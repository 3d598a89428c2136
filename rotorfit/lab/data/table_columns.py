"""Columns of tidy tables as kinds of experiments have them: what each is called in a table, in which unit."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rotorfit.base.array_types import Float, Text
from rotorfit.base.units import UNITS

Part = tuple[str, str, Mapping[str, float]]
"""Name of a table's column before its unit, the unit in which it is written, and those in which it is read."""
PURE = {"ratio": 1.0}
SPEED, FREQUENCY, X, Y = (
    (name, unit, UNITS[kind])
    for name, unit, kind in (
        ("speed", "rpm", "frequency"), ("frequency", "rpm", "frequency"), ("x", "um", "length"), ("y", "um", "length"),
    )
)  # fmt: skip


@dataclass(frozen=True)
class Column:
    """A column of an experiment: a text, a number, or a complex number of two parts."""

    name: str  # in the experiment
    parts: tuple[Part, ...] = ()  # columns of a table; none of a text, whose column has its name
    needed: bool = True  # texts may always be left out
    polar: bool = False  # whether the parts are size and angle, not real and imaginary part
    otherwise: str = ""  # text of a column that is left out

    def written(self, values: NDArray[Any]) -> dict[str, NDArray[Any]]:
        """Columns of a table; none where nothing is known."""
        if not self.parts:
            return {self.name: values}
        if values.size and not np.isfinite(values).any():
            return {}
        parts = (np.abs(values), np.angle(values)) if self.polar else (values.real, values.imag)
        named = zip(self.parts, parts, strict=False)
        return {f"{prefix}_{usual}": part / units[usual.lower()] for (prefix, usual, units), part in named}


def noise(unit: str, units: Mapping[str, float]) -> Column:
    """Column of the noise of readings, blank where it is not known.

    Args:
        unit: in which it is written.
        units: those in which it is read.
    """
    return Column("sigma", (("sigma", unit, units),), needed=False)


RUN = (Column("run"), Column("speed", (SPEED,)))
ECCENTRICITY = ("eccentricity", "ratio", PURE)


class Layout(NamedTuple):
    """An experiment as a table has it."""

    columns: tuple[Column, ...]  # beside run and speed
    marks: tuple[str, ...] = ()  # beginnings of the name of a column by which a table is known
    run: str = ""  # name of the run where no column names it
    known: str = ""  # for the message of a table without one of them


FORCED = (
    Column("frequency", (FREQUENCY,)),
    Column("force_plane"),
    Column("force", (("force", "N", UNITS["force"]), ("force_phase", "deg", UNITS["phase"])), polar=True),
    *map(Column, ("plane", "direction")),
)
"""Columns of a test under a force, beside what was read."""


def in_units_of(direction: Text, values: Mapping[str, Float]) -> dict[str, Float]:
    """Columns of readings in um, of slopes and twist in urad.

    Args:
        direction: of each row.
        values: readings and their noise by the name of the column, m or rad.
    """
    angular = (direction == "twist") | np.char.startswith(direction, "r")
    found: dict[str, Float] = {}
    for unit, rows in (("um", ~angular), ("urad", angular)):
        if rows.any():
            found |= {f"{name}_{unit}": np.where(rows, own * 1e6, np.nan) for name, own in values.items()}
    return found
