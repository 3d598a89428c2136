"""Noise of frequency responses from their coherence, as analysers report it.

An estimate ``|H|`` from n independent averages has the random error ``sqrt((1 - g) / (2 n g))`` of itself in size and,
in radians, in phase, g being the (squared) coherence (Bendat and Piersol, Random Data, 4th ed. 2010, chapter 9): so
much of the reading in its real and in its imaginary part. The coherence is an estimate itself: what n averages leave to
the noise has v = 2 (n - 1) degrees of freedom. ``n - 3`` in place of n makes the errors of values that are fitted with
such weights right on average: the unbiased variance has n - 1, and weights that scatter like chi-squared with v
degrees of freedom cost a factor v / (v - 4).
"""

from __future__ import annotations

import re

import numpy as np

from rotorfit.data.findings import Finding
from rotorfit.io.tables.table import Table, floats, kept
from rotorfit.io.tables.wanted_columns import Columns
from rotorfit.models.array_types import Float

FEWEST_AVERAGES = 5
"""Averages that noise from coherence takes: fewer leave weights whose scatter is as large as they are."""
_DECIMALS = re.compile(r"[+-]?\d*\.(\d+)")


def without_incoherent(table: Table) -> tuple[Table, list[Finding]]:
    """The table without the rows of coherence zero, whose readings are noise alone, and how many these are."""
    values = floats(table.cells["coherence"]) if "coherence" in table.cells else None
    if values is None or not (values == 0).any() or (values == 0).all():
        return table, []
    rows = np.flatnonzero(values == 0)
    words = (
        f"{table.source}: {rows.size} of {values.size} readings have coherence zero, noise alone, and were left out "
        f"(first in line {table.lines[int(rows[0])]})"
    )
    return kept(table, np.flatnonzero(values != 0)), [Finding("note", "incoherent", words)]


def noise_of_coherence(columns: Columns, size: Float) -> Float:
    """Standard deviation of real and of imaginary part of readings of a size; NaN where the coherence is blank.

    Raises:
        ValueError: coherences that are none, or say nothing of noise, averages that are missing, few or no numbers.
    """
    table = columns.table
    if columns.has("sigma"):
        raise ValueError(f"{table.source}: both sigma and coherence are given, two sources of the noise; keep one")
    if not columns.has("averages"):
        raise ValueError(
            f"{table.source}: coherence says how large the noise is together with the number of averages behind it; "
            "add a column averages, or constants={'averages': 20} (--constant averages=20)"
        )
    given = columns.number("coherence", blank=True)
    columns.refuse(
        (given < 0) | (given > 1), "coherence", "is no coherence, which is from 0 to 1 (a fraction, not per cent or dB)"
    )
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
    found = np.minimum(given, 1 - _half_digit(table))
    return np.asarray(size * np.sqrt((1 - found) / (2 * (averages - 3) * found)))


def _half_digit(table: Table) -> float:
    """Half a unit of the last decimal written: by so much a coherence of 1.000 may be less than one."""
    found = [_DECIMALS.match(cell) for cell in table.cells["coherence"]]
    return 0.5 * 10.0 ** -max((len(match[1]) for match in found if match), default=0)
