"""Columns of tidy tables by kind of experiment: all are written, and all but perturbation tests are read.

:data:`_KINDS` says what the columns of each kind are called in a table. Of static loads, impulses, ring-down records
and tables of coefficients ``run`` may be left out: one run. A plane left out is the journal. A row of a line test is
one spectral line of one signal.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rotorfit.base.array_types import Bool
from rotorfit.base.units import RPM_PER_RAD_S, UNITS
from rotorfit.lab.data.experiments import PerturbationTest
from rotorfit.lab.data.rows import Experiment
from rotorfit.lab.data.synchronous import group_speeds
from rotorfit.lab.io.tables.table import Columns, Wanted, columns_for, phase_or_angle, quantity, words
from rotorfit.lab.kinds.coefficient_table import CoefficientTable
from rotorfit.lab.kinds.displacement_test import DisplacementTest
from rotorfit.lab.kinds.free_vibration import ImpulseTest, RingDownTest
from rotorfit.lab.kinds.line_test import LineTest
from rotorfit.lab.kinds.static_test import StaticTest

if TYPE_CHECKING:
    from rotorfit.lab.io.tables.table import Table

_Part = tuple[str, str, Mapping[str, float]]
"""Name of a table's column before its unit, the unit in which it is written, and those in which it is read."""
_PURE = {"ratio": 1.0}
_SPEED, _FREQUENCY, _X, _Y = (
    (name, unit, UNITS[kind])
    for name, unit, kind in (
        ("speed", "rpm", "frequency"), ("frequency", "rpm", "frequency"), ("x", "um", "length"), ("y", "um", "length"),
    )
)  # fmt: skip
_COEFFICIENTS = {"kxx": "N_m", "kxy": "N_m", "cxx": "N_s_m", "cxy": "N_s_m", "mxx": "kg"}
"""Unit by coefficient."""


@dataclass(frozen=True)
class _Column:
    """A column of an experiment: a text, a number, or a complex number of two parts."""

    name: str  # in the experiment
    parts: tuple[_Part, ...] = ()  # columns of a table; none of a text, whose column has its name
    needed: bool = True  # texts may always be left out
    polar: bool = False  # whether the parts are size and angle, not real and imaginary part
    otherwise: str = ""  # text of a column that is left out

    def wanted(self) -> list[Wanted]:
        """Columns of a table to be read; the second part is asked for by its own name."""
        if not self.parts:
            return [words(self.name, needed=False)]
        names = self.name, f"second part of {self.name}"
        parts = zip(names, self.parts, strict=False)
        return [
            quantity(prefix, units, usual if self.needed else "", name=name) for name, (prefix, usual, units) in parts
        ]

    def read(self, columns: Columns) -> NDArray[Any]:
        """The column in SI units."""
        if not self.parts:
            return columns.words(self.name, self.otherwise)
        values = columns.number(self.name, blank=not self.needed)
        if len(self.parts) == 2:
            second = columns.number(f"second part of {self.name}")
            values = np.asarray(values * np.exp(1j * second) if self.polar else values + 1j * second)
            columns.refuse(~np.isfinite(values), self.name, "overflows; check its unit")
        return values

    def written(self, values: NDArray[Any]) -> dict[str, NDArray[Any]]:
        """Columns of a table; none where nothing is known."""
        if not self.parts:
            return {self.name: values}
        if values.size and not np.isfinite(values).any():
            return {}
        parts = (np.abs(values), np.angle(values)) if self.polar else (values.real, values.imag)
        named = zip(self.parts, parts, strict=False)
        return {f"{prefix}_{usual}": part / units[usual.lower()] for (prefix, usual, units), part in named}


def _noise(unit: str, units: Mapping[str, float]) -> _Column:
    return _Column("sigma", (("sigma", unit, units),), needed=False)


_MORE = "; other units by suffix, further columns are attributes"
_RUN = (_Column("run"), _Column("speed", (_SPEED,)))
_ECCENTRICITY = ("eccentricity", "ratio", _PURE)


class _Kind(NamedTuple):
    """An experiment as a table has it."""

    marks: tuple[str, ...]  # beginnings of the name of a column by which a table is known
    run: str  # name of the run where no column names it
    columns: tuple[_Column, ...]  # beside run and speed
    known: str  # for the message of a table without one of them


_KINDS: dict[type[Any], _Kind] = {
    DisplacementTest: _Kind(
        ("force_x_", "force_y_"),
        "",
        (
            _Column("frequency", (_FREQUENCY,)),
            _Column("plane"),
            _Column(
                "displacement",
                (("amplitude", "um", UNITS["displacement"]), ("phase", "deg", UNITS["phase"])),
                polar=True,
            ),
            *(
                _Column(name, ((name, "N", UNITS["force"]), (f"{name}_phase", "deg", UNITS["phase"])), polar=True)
                for name in ("force_x", "force_y")
            ),
            _noise("N", UNITS["force"]),
        ),
        (
            "run, speed_rpm, frequency_rpm, plane, amplitude_um, phase_deg, force_x_N, force_x_phase_deg, force_y_N, "
            "force_y_phase_deg, optional sigma_N"
        ),
    ),
    RingDownTest: _Kind(
        ("time_",),
        "ring-down",
        (
            _Column("time", (("time", "s", {"s": 1.0, "ms": 1e-3, "us": 1e-6}),)),
            _Column("x", (_X,)),
            _Column("y", (_Y,)),
            _Column("eccentricity", (_ECCENTRICITY,), needed=False),
        ),
        "speed_rpm, time_s, x_um, y_um, optional run, eccentricity_ratio",
    ),
    ImpulseTest: _Kind(
        ("damping_ratio",),
        "impulse",
        (
            _Column("frequency", (_FREQUENCY,)),
            _Column("damping_ratio", (("damping", "ratio", _PURE),)),
            _Column("eccentricity", (_ECCENTRICITY,), needed=False),
            _Column("position", (_X, _Y)),
            _noise("rpm", UNITS["frequency"]),
        ),
        "speed_rpm, frequency_rpm, damping_ratio, eccentricity_ratio (or x_um, y_um), optional run, sigma_rpm",
    ),
    StaticTest: _Kind(
        ("load_",),
        "static",
        (
            _Column("load_plane", otherwise="journal"),
            _Column("load", (("load", "N", UNITS["force"]), ("load", "deg", UNITS["angle"])), polar=True),
            _Column("plane", otherwise="journal"),
            _Column("displacement", (_X, _Y)),
            _noise("um", UNITS["length"]),
        ),
        "speed_rpm, load_N, load_deg, x_um, y_um, optional run, plane and load_plane (by default journal), sigma_um",
    ),
    CoefficientTable: _Kind(
        ("kxx_",),
        "",
        (
            _Column("eccentricity", (_ECCENTRICITY,)),
            *(_Column(name, ((name, unit, {unit.lower(): 1.0}),)) for name, unit in _COEFFICIENTS.items()),
            _noise("ratio", _PURE),
        ),
        "speed_rpm, eccentricity_ratio, kxx_N_m, kxy_N_m, cxx_N_s_m, cxy_N_s_m, mxx_kg, optional run, sigma_ratio",
    ),
}

_REFUSED: dict[str, tuple[Callable[[NDArray[Any]], Bool], str]] = {
    "sigma": (lambda values: values <= 0, "is no noise: positive, or blank where it is not known"),
    "eccentricity": (
        lambda values: (values < 0) | (values >= 1),
        "is no eccentricity: |displacement| / clearance, from 0 to below 1",
    ),
    "damping_ratio": (
        lambda values: np.abs(values) >= 1,
        "is no damping ratio of a mode that vibrates, between -1 and 1",
    ),
}
"""Values that a column cannot have, and why."""


def kind_of(table: Table) -> type[Any] | None:
    """The kind of test that the columns of a table tell; None for a perturbation test, which may have attributes named
    like the marks of the others."""
    allowed = [DisplacementTest] if {"force_plane", "direction"} & set(table.cells) else list(_KINDS)
    return next((kind for kind in allowed if any(name.startswith(_KINDS[kind].marks) for name in table.cells)), None)


def read_kind(kind: type[Any], table: Table, speed_tolerance: float) -> Any:
    """The test of a kind that a table holds."""
    _, run, own, known = _KINDS[kind]
    by_ratio = kind is ImpulseTest and bool(table.find("eccentricity", _PURE))
    own = (*_RUN, *(column for column in own if not (by_ratio and column.name == "position")))
    columns = columns_for(table, [one for column in own for one in column.wanted()], known + _MORE)
    values: dict[str, Any] = {column.name: column.read(columns) for column in own}
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
_FORCED = (
    _Column("frequency", (_FREQUENCY,)),
    _Column("force_plane"),
    _Column("force", (("force", "N", UNITS["force"]), ("force_phase", "deg", UNITS["phase"])), polar=True),
    *map(_Column, ("plane", "direction")),
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


def columns_of(test: Experiment) -> dict[str, NDArray[Any]]:
    """Columns of a tidy CSV by name, in rpm, um (urad for slopes and twist), N, degrees and s; of several forces the
    first."""
    if isinstance(test, ImpulseTest) and 0 < np.isfinite(test.eccentricity).sum() < len(test):
        raise ValueError("a CSV holds impulses with eccentricities or with positions, not some with either")
    own = _FORCED if isinstance(test, LineTest | PerturbationTest) else _KINDS[type(test)].columns
    found: dict[str, NDArray[Any]] = {}
    for column in (*_RUN, *own):
        found |= column.written(getattr(test, column.name))
    if not isinstance(test, LineTest | PerturbationTest):
        return found
    values = {"amplitude": np.abs(test.response)}
    if isinstance(test, LineTest):
        found["line"] = test.line
        values = {"real": test.response.real, "imag": test.response.imag}
    elif test.linear.any():
        found["force_direction"] = test.force_direction
    if isinstance(test, LineTest) or np.isfinite(test.sigma).any():
        values["sigma"] = test.sigma
    angular = (test.direction == "twist") | np.char.startswith(test.direction, "r")
    for unit, rows in (("um", ~angular), ("urad", angular)):
        if rows.any():
            found |= {f"{name}_{unit}": np.where(rows, v * 1e6, np.nan) for name, v in values.items()}
    return found if isinstance(test, LineTest) else found | {"phase_deg": np.degrees(np.angle(test.response))}
