"""Coefficients of a bearing or seal against speed."""

from __future__ import annotations

import re
from itertools import cycle
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from rotorfit.base.significance import CHANCE_ERRORS
from rotorfit.identify.fitting.structure.coefficients import (
    ENTRIES,
    UNITS,
    CoefficientRows,
    Coefficients,
    FrequencyRows,
)
from rotorfit.models.coefficient_tables import COEFFICIENTS
from rotorfit.show.plots.style import (
    GREY,
    HALF,
    MARKERS,
    Sheet,
    colour_of,
    draw_curve,
    end_labels,
    legend_below,
    literal,
    on_sheet,
    prefix,
)

_MARKERS = "os^Dv<>P"


@on_sheet
def coefficients(table: CoefficientRows, *, sheet: Sheet) -> Figure:
    """Stiffness, damping and inertia in x and y against speed, error bars of 95 %; a marker a condition."""
    kinds = [kind for kind in "KCM" if any(_there(table, name) for name in COEFFICIENTS if name[0] == kind)]
    figure, axes = sheet.grid(len(kinds), 1, f"Coefficients at {table.rows[0].plane}", size=(6.5, 2.6))
    series: dict[str, list[Coefficients]] = {}
    for row in sorted(table.rows, key=lambda row: row.speed):
        series.setdefault(_with_units(row.condition.rpartition(", ")[0]), []).append(row)
    for axis, kind in zip(axes[:, 0], kinds, strict=True):
        names = [name for name in COEFFICIENTS if name[0] == kind and _there(table, name)]
        factor, unit = prefix(np.abs([[row[name].value for row in table.rows] for name in names]), UNITS[kind])
        for name in names:
            entry = ("xx", "xy", "yx", "yy").index(name[1:])
            look = {"color": colour_of(entry, 4), "ls": ("-", "--", ":", "-.")[entry], "ms": 3, "lw": 1, "capsize": 2}
            for marker, rows in zip(cycle(_MARKERS), series.values(), strict=False):
                speed = np.array([row.speed for row in rows]) * sheet.per_rad_s
                values = factor * np.array([row[name].value for row in rows])
                error = factor * CHANCE_ERRORS * np.array([row[name].stderr for row in rows])
                shown = np.where(np.isfinite(error), error, 0.0)
                axis.errorbar(speed, values, shown, marker=marker, **look)
        axis.set_ylabel(f"{kind}, {unit}")
    axes[-1, 0].set_xlabel(f"rotative speed, {sheet.rate_unit}")
    names = [name[1:] for name in COEFFICIENTS if name[0] == kinds[0] and _there(table, name)]
    entries: dict[str, Any] = dict(zip(names, axes[0, 0].containers[:: len(series)], strict=True))
    if len(series) > 1:
        looks = ({"color": GREY, "marker": m, "ls": "", "ms": 4} for m in cycle(_MARKERS))
        entries |= dict(zip(series, looks, strict=False))
    legend_below(figure, entries)
    return figure


def _with_units(condition: str) -> str:
    """A condition as people write it: ``P 30 bar`` for ``P_bar=30``."""
    return re.sub(r"(\w+)_(bar|psi|kPa|MPa|Pa|C|K|mm|um|rpm|hz)=([^,]+)", r"\1 \3 \2", condition)


def _there(table: CoefficientRows, name: str) -> bool:
    return any(row[name].value or row[name].stderr for row in table.rows)


@on_sheet
def whirl_ratio(table: CoefficientRows, *, sheet: Sheet) -> Figure:
    """Whirl frequency ratio against speed with its 95 % errors, a colour and marker a condition; half is the usual."""
    figure, ((axis,),) = sheet.grid(1, 1, "", size=HALF)
    axis.set_title("Whirl frequency ratio")
    series: dict[str, list[Coefficients]] = {}
    for row in sorted(table.rows, key=lambda row: row.speed):
        series.setdefault(_with_units(row.condition.rpartition(", ")[0]), []).append(row)
    labels, apart = [], 0.012 * max(row.speed for row in table.rows) * sheet.per_rad_s
    for number, (name, rows) in enumerate(series.items()):
        found = [(row.speed, row.whirl_frequency_ratio) for row in rows]
        known = [(speed, q) for speed, q in found if np.isfinite([q.value, q.stderr]).all()]
        if not known:
            continue
        x = np.array([speed for speed, _ in known]) * sheet.per_rad_s + apart * (number - (len(series) - 1) / 2)
        ends = np.array([q.interval(0.95) for _, q in known])
        y = np.array([q.value for _, q in known])
        colour = colour_of(number, len(series))
        axis.vlines(x, *ends.T, color=colour, lw=1.2)
        axis.plot(x, y, MARKERS[number % len(MARKERS)], color=colour, ms=4.5)
        labels.append((literal(name), float(y[-1]), colour))
    low, high = axis.get_ylim()
    axis.set_ylim(min(low, 0.44), max(high, 0.54))
    axis.axhline(0.5, color=GREY, lw=0.9, ls=(0, (6, 2)), zorder=1)
    end_labels(axis, [*(labels if len(series) > 1 else []), ("half of speed", 0.5, GREY)])
    axis.set_xlabel(f"shaft speed, {sheet.rate_unit}")
    return figure


@on_sheet
def frequency_coefficients(table: FrequencyRows, *, sheet: Sheet) -> Figure:
    """Stiffness and damping against frequency, a colour a condition: points as measured, bands of 95 % as fitted."""
    # Quantile of the error bars that sets the axes: where both runs move alike, a bar is taller than the seal is stiff.
    shown = 0.1
    figure, axes = sheet.grid(
        len(ENTRIES), 2, "Stiffness and damping against frequency", size=(4.6, 2.0), one_abscissa=True
    )
    entries: dict[str, Any] = {}
    for kind, column, si in (("stiffness", 0, "N/m"), ("damping", 1, "N s/m")):
        factor, unit = prefix(
            np.concatenate([np.abs(getattr(row, f"fitted_{kind}")).ravel() for row in table.rows]), si
        )
        for entry, name in enumerate(ENTRIES):
            axis = axes[entry, column]
            ends: list[float] = []
            for number, row in enumerate(table.rows):
                w, colour = row.frequency * sheet.per_rad_s, colour_of(number, len(table.rows))
                value, error, fitted, width = (
                    factor * getattr(row, part)[entry]
                    for part in (kind, f"{kind}_stderr", f"fitted_{kind}", f"fitted_{kind}_stderr")
                )
                own = axis.errorbar(w, value, CHANCE_ERRORS * error, fmt="o", ms=2, lw=0.6, alpha=0.6, color=colour)
                order = np.argsort(w)
                reach = CHANCE_ERRORS * width[order]
                low, high = fitted[order] - reach, fitted[order] + reach
                draw_curve(axis, w[order], fitted[order], reach, colour, lw=1)
                entries.setdefault(row.condition, own)
                ends += [float(low.min()), float(np.quantile(value - CHANCE_ERRORS * error, shown))]
                ends += [float(high.max()), float(np.quantile(value + CHANCE_ERRORS * error, 1 - shown))]
            axis.set_ylabel(f"{'KC'[column]}{name}, {unit}")
            reach = max(ends) - min(ends)
            axis.set_ylim(min(ends) - 0.2 * reach, max(ends) + 0.2 * reach or 1.0)
    for axis in axes[-1]:
        axis.set_xlabel(f"frequency, {sheet.rate_unit}")
    legend_below(figure, entries)
    return figure
