"""Readings of a table as displacements: of probes, of slopes, and of sensors of velocity or acceleration.

A displacement x moves at ``jw x`` and accelerates by ``-w^2 x``, so that readings of accelerometers are divided by
``(jw)^2``, and their noise by ``w^2``, line by line. What a sensor gave is kept as the attribute
:data:`~rotorfit.data.experiments.MEASURED`: noise that was not given is estimated where it is even, in the sensor's own
quantity.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from rotorfit.data.experiments import DERIVATIVES
from rotorfit.io.tables.cells import lacking
from rotorfit.io.tables.table import READING, Table
from rotorfit.io.tables.wanted_columns import Columns
from rotorfit.models.array_types import Bool, ComplexArray, Float, Index, Text
from rotorfit.units import UNITS, units_of

_SAID = {"acceleration": UNITS["acceleration"], "velocity": UNITS["velocity"]}
"""Beginnings of columns that say what was measured, as ``acceleration_g``; the unit alone says it too, ``real_g``."""


def with_amplitudes(table: Table) -> Table:
    """The table with ``acceleration_g`` and ``velocity_mm_s`` called ``amplitude_g`` and ``amplitude_mm_s``.

    Beside an amplitude in the same rows such a column is no reading but a condition of the test, as a flow velocity is.
    """
    readings = [name for prefix in ("amplitude", "real", "imag") for name in table.find(prefix, READING)]
    new = {}
    for quantity, units in _SAID.items():
        for name in table.find(quantity, units):
            beside = [~lacking(table.cells[name]) & ~lacking(table.cells[other]) for other in readings]
            if not np.any(beside):
                new[name] = f"amplitude_{name.removeprefix(quantity + '_')}"
    if not new:
        return table
    return replace(
        table,
        cells={new.get(name, name): cells for name, cells in table.cells.items()},
        names={new.get(name, name): new.get(name, spelled) for name, spelled in table.names.items()},
        written={**table.written, **{new[name]: table.spelled(name) for name in new}},
    )


def response(columns: Columns, direction: Text, frequency: Float) -> tuple[ComplexArray, Index]:
    """Readings as displacements, m or rad, and how often the sensor differentiated them, shape ``(R,)`` each."""
    parts = ("amplitude",) if "amplitude" in columns.found else ("real", "imag")
    (value, order), *imaginary = (motion(columns, name, direction) for name in parts)
    if imaginary:
        _refuse_two_kinds(columns, order != imaginary[0][1])
        reading = np.asarray(value + 1j * imaginary[0][0])
    else:
        reading = np.asarray(value * np.exp(1j * columns.number("phase")))
        _refuse_negative(columns)
    signed = np.where(np.char.endswith(direction, "z"), frequency, np.abs(frequency))
    columns.refuse((order > 0) & (frequency == 0), "frequency", "is no motion, which has no velocity or acceleration")
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.where(order > 0, reading / (1j * signed) ** order, reading)), order


def motion(columns: Columns, name: str, direction: Text, *, blank: bool = False) -> tuple[Float, Index]:
    """Each row's value from the column of its kind, and how often the sensor differentiated.

    A slope is an angle, or a length over the probe's radius.
    """
    tilt = np.char.startswith(direction, "r")
    value, order = np.full(direction.shape, np.nan), np.zeros(direction.shape, dtype=np.intp)
    taken = np.full(value.size, -1)
    found = list(columns.found[name].items())
    for number, (column, factor) in enumerate(found):
        unit = column.split("_", 1)[1]
        angle = unit in units_of("tilt")
        own = columns.table.number((column, factor), blank=True)
        if not angle and unit in units_of("displacement"):
            own = _over_radius(columns, own, tilt, positive=name == "sigma")
        here = np.isfinite(own) & (tilt if angle else ~tilt | (unit in units_of("displacement")))
        if (twice := np.flatnonzero(here & (taken >= 0))).size:
            row = int(twice[0])
            both = " and ".join(columns.table.spelled(one) for one in (found[taken[row]][0], column))
            raise ValueError(
                f"{columns.table.source}: given twice, as {both} (line {columns.table.lines[row]}); keep one of them"
            )
        taken[here] = number
        value[here], order[here] = own[here], _order(unit)
    lacking = np.isnan(value) & (not blank)
    if lacking.any():
        _refuse_lacking(columns, name, int(np.flatnonzero(lacking)[0]), tilt)
    return value, order


def over_frequency(values: Float, order: Index, frequency: Float) -> Float:
    """Sizes of velocities or accelerations as those of displacements, shape ``(R,)``."""
    with np.errstate(divide="ignore"):
        return np.asarray(values / np.abs(frequency) ** order)


def measured_names(order: Index) -> Text:
    """Quantity that the sensor of each reading measured, in a word."""
    return np.array(list(DERIVATIVES))[order]


def _order(unit: str) -> int:
    return next((k for k, kind in enumerate(DERIVATIVES) if k and unit in UNITS[kind]), 0)


def _over_radius(columns: Columns, length: Float, tilt: Bool, *, positive: bool) -> Float:
    """Lengths that an axial probe read, over its radius where the reading is a slope; NaN without a radius."""
    if not columns.has("probe_radius"):
        return np.where(tilt, np.nan, length)
    r = columns.number("probe_radius", blank=True)
    slope = np.divide(length, r, out=np.full_like(length, np.nan), where=r != 0)
    return np.where(tilt, np.abs(slope) if positive else slope, length)


def _refuse_lacking(columns: Columns, name: str, row: int, tilt: Bool) -> None:
    table = columns.table
    what = (
        f"{name}_urad, or a length with probe_radius_mm, is needed" if tilt[row] else "a length is needed, or its rate"
    )
    spelled = ", ".join(table.spelled(column) for column in columns.found[name])
    raise ValueError(
        f"{table.source}: line {table.lines[row]}, direction {columns.table.cells['direction'][row]}: {what}; "
        f"columns {spelled} give none"
    )


def _refuse_two_kinds(columns: Columns, differ: Bool) -> None:
    rows = np.flatnonzero(differ)
    if rows.size:
        where = f"{columns.table.source}: line {columns.table.lines[int(rows[0])]}"
        raise ValueError(f"{where}: real and imaginary part are in units of two quantities; give both in one")


def _refuse_negative(columns: Columns) -> None:
    """Refuse a negative amplitude: a real part, a level in dB or a sign slip, never an amplitude."""
    table = columns.table
    for name in columns.found["amplitude"]:
        negative = table.number((name, 1.0), blank=True) < 0
        table.refuse(negative, name, "is negative; amplitudes are not, real parts go to real_um, imag_um")
