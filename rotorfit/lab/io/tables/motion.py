"""Readings of a table as displacements, of probes, of slopes, of sensors of velocity or acceleration; and their noise.

A displacement x moves at ``jw x`` and accelerates by ``-w^2 x``, so that readings of accelerometers are divided by
``(jw)^2``, and their noise by ``w^2``, line by line. What a sensor gave is kept as the attribute
:data:`~rotorfit.lab.data.experiments.MEASURED`: noise that was not given is estimated where it is even, in the
sensor's own quantity.

The noise of frequency responses may be given by their coherence, as analysers report it. An estimate ``|H|`` from n
independent averages has the random error ``sqrt((1 - g) / (2 n g))`` of itself in size and, in radians, in phase, g
being the (squared) coherence (Bendat and Piersol, Random Data, 4th ed. 2010, chapter 9): so much of the reading in its
real and in its imaginary part. The coherence is an estimate itself: what n averages leave to the noise has
v = 2 (n - 1) degrees of freedom. ``n - 3`` in place of n makes the errors of values that are fitted with such weights
right on average: the unbiased variance has n - 1, and weights that scatter like chi-squared with v degrees of freedom
cost a factor v / (v - 4).
"""

from __future__ import annotations

import re

import numpy as np

from rotorfit.base.array_types import ComplexArray, Float, Index, Text
from rotorfit.base.units import UNITS, units_of
from rotorfit.lab.data.experiments import DERIVATIVES
from rotorfit.lab.io.tables.cells import lacking
from rotorfit.lab.io.tables.table import READING, Columns, Table

FEWEST_AVERAGES = 5
"""Averages that noise from coherence takes: fewer leave weights whose scatter is as large as they are."""
_DECIMALS = re.compile(r"[+-]?\d*\.(\d+)")


def with_amplitudes(table: Table) -> Table:
    """The table with ``acceleration_g`` and ``velocity_mm_s`` called ``amplitude_g`` and ``amplitude_mm_s``.

    Beside an amplitude in the same rows such a column is no reading but a condition of the test, as a flow velocity is.
    """
    readings = [name for prefix in ("amplitude", "real", "imag") for name in table.find(prefix, READING)]
    new = {}
    for quantity in ("acceleration", "velocity"):
        for name in table.find(quantity, UNITS[quantity]):
            beside = [~lacking(table.cells[name]) & ~lacking(table.cells[other]) for other in readings]
            if not np.any(beside):
                new[name] = f"amplitude_{name.removeprefix(quantity + '_')}"
    return table.renamed(new) if new else table


def response(columns: Columns, direction: Text, frequency: Float) -> tuple[ComplexArray, Index]:
    """Readings as displacements, m or rad, and how often the sensor differentiated them, shape ``(R,)`` each."""
    parts = ("amplitude",) if "amplitude" in columns.found else ("real", "imag")
    (value, order), *imaginary = (_motion(columns, name, direction) for name in parts)
    table = columns.table
    if imaginary:
        for row in np.flatnonzero(order != imaginary[0][1]).tolist():
            where = f"{table.source}: line {table.lines[row]}"
            raise ValueError(f"{where}: real and imaginary part are in units of two quantities; give both in one")
        reading = np.asarray(value + 1j * imaginary[0][0])
    else:
        reading = np.asarray(value * np.exp(1j * columns.number("phase")))
        for name in columns.found["amplitude"]:  # negative: a real part, a level in dB or a sign slip
            negative = table.number((name, 1.0), blank=True) < 0
            table.refuse(negative, name, "is negative; amplitudes are not, real parts go to real_um, imag_um")
    signed = np.where(np.char.endswith(direction, "z"), frequency, np.abs(frequency))
    columns.refuse((order > 0) & (frequency == 0), "frequency", "is no motion, which has no velocity or acceleration")
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.where(order > 0, reading / (1j * signed) ** order, reading)), order


def noise(columns: Columns, direction: Text, frequency: Float, reading: ComplexArray) -> Float:
    """Standard deviation of real and of imaginary part of each reading, NaN where nothing is said of it."""
    if columns.has("coherence") and (columns.has("averages") or not columns.has("sigma")):
        return _noise_of_coherence(columns, np.abs(reading))
    if not columns.has("sigma"):
        return np.broadcast_to(np.nan, frequency.shape)
    sigma, order = _motion(columns, "sigma", direction)
    columns.refuse(sigma <= 0, "sigma", "must be positive, or blank where the noise is not known")
    with np.errstate(divide="ignore"):
        return np.asarray(sigma / np.abs(frequency) ** order)


def _motion(columns: Columns, name: str, direction: Text) -> tuple[Float, Index]:
    """Each row's value from the column of its kind, and how often the sensor differentiated; of noise it may be blank.

    A slope is an angle, or a length that an axial probe read over its radius.
    """
    table, tilt = columns.table, np.char.startswith(direction, "r")
    value, order = np.full(direction.shape, np.nan), np.zeros(direction.shape, dtype=np.intp)
    taken = np.full(value.size, -1)
    found = list(columns.found[name].items())
    for number, (column, factor) in enumerate(found):
        unit = column.split("_", 1)[1]
        angle, length = unit in units_of("tilt"), unit in units_of("displacement")
        own = table.number((column, factor), blank=True)
        if length and not angle:
            r = columns.number("probe_radius", blank=True)  # NaN without
            slope = np.divide(own, r, out=np.full_like(own, np.nan), where=r != 0)
            own = np.where(tilt, np.abs(slope) if name == "sigma" else slope, own)
        here = np.isfinite(own) & (tilt if angle else ~tilt | length)
        if (twice := np.flatnonzero(here & (taken >= 0))).size:
            row = int(twice[0])
            both = " and ".join(table.spelled(one) for one in (found[taken[row]][0], column))
            raise ValueError(f"{table.source}: given twice, as {both} (line {table.lines[row]}); keep one of them")
        taken[here], value[here] = number, own[here]
        order[here] = next((k for k, kind in enumerate(DERIVATIVES) if k and unit in UNITS[kind]), 0)
    blank = np.flatnonzero(np.isnan(value))
    if blank.size and name != "sigma":
        row = int(blank[0])
        of_slope = f"{name}_urad, or a length with probe_radius_mm, is needed"
        spelled = ", ".join(table.spelled(column) for column in columns.found[name])
        raise ValueError(
            f"{table.source}: line {table.lines[row]}, direction {table.cells['direction'][row]}: "
            f"{of_slope if tilt[row] else 'a length is needed, or its rate'}; columns {spelled} give none"
        )
    return value, order


def _noise_of_coherence(columns: Columns, size: Float) -> Float:
    """Standard deviation of real and of imaginary part of readings of a size; NaN where the coherence is blank."""
    table = columns.table
    if columns.has("sigma"):
        raise ValueError(f"{table.source}: both sigma and coherence are given, two sources of the noise; keep one")
    if not columns.has("averages"):
        raise ValueError(
            f"{table.source}: coherence says how large the noise is together with the number of averages behind it; "
            "add a column averages, or constants={'averages': 20} (--constant averages=20)"
        )
    given = columns.number("coherence", blank=True)
    columns.refuse((given < 0) | (given > 1), "coherence", "is not a coherence: 0 to 1, a fraction, not per cent or dB")
    columns.refuse(given == 0, "coherence", "throughout: all readings are noise alone")
    averages = columns.number("averages")
    columns.refuse(
        (averages < FEWEST_AVERAGES) | (averages != np.round(averages)),
        "averages",
        f"averages: noise from coherence takes a whole number of them, {FEWEST_AVERAGES} or more; with fewer give "
        "sigma_um, or leave the coherence out and the noise is estimated from the readings",
    )
    said = given[np.isfinite(given)]
    if said.size and (said == 1).all():
        raise ValueError(
            f"{table.source}: the coherence is 1 in all rows, as of a single average or of figures that were rounded; "
            "it does not say how large the noise is. Export more digits, or leave the column out"
        )
    # half a unit of the last decimal written: by so much a coherence of 1.000 may be less than one
    decimals = [_DECIMALS.match(cell) for cell in table.cells["coherence"]]
    half_digit = 0.5 * 10.0 ** -max((len(match[1]) for match in decimals if match), default=0)
    found = np.minimum(given, 1 - half_digit)
    return np.asarray(size * np.sqrt((1 - found) / (2 * (averages - 3) * found)))
