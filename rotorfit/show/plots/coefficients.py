"""Coefficients of a bearing or seal against speed."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure

from rotorfit.base.significance import CHANCE_ERRORS
from rotorfit.identify.fitting.quantities import Quantity
from rotorfit.identify.fitting.structure.coefficients import (
    ENTRIES,
    UNITS,
    CoefficientRows,
    Coefficients,
    FrequencyRows,
)
from rotorfit.show.plots.style import (
    GREY,
    HALF,
    MARKERS,
    PAGE,
    Sheet,
    colour_of,
    draw_curve,
    end_labels,
    few_ticks,
    legend_below,
    literal,
    on_sheet,
    panel_title,
    prefix,
)


@on_sheet
def coefficients(table: CoefficientRows, *, sheet: Sheet) -> Figure:
    """Direct and cross-coupled stiffness, damping and inertia and the whirl frequency ratio against speed, a line a
    condition, with error bars of 95 %; coefficients along y and by motion along x are open and dashed."""
    panels = [panel for panel in _PANELS if any(_there(table, name) for name in panel.entries)]
    drawn = [*panels, *([None] if any(np.isfinite(row.whirl_frequency_ratio.value) for row in table.rows) else [])]
    title, columns = f"Coefficients at {literal(table.rows[0].plane)}", min(len(drawn), 3)
    rows = -(-len(drawn) // columns)
    figure, axes = sheet.grid(rows, columns, title, size=(PAGE[0] / max(columns, 2), 2.2), reads=(_READS,))
    series = _series(table)
    for axis in axes.flat[len(drawn) :]:
        axis.remove()
    for panel, axis in zip(drawn, axes.flat, strict=False):
        if panel is None:
            panel_title(axis, "whirl frequency ratio")
            ends = _draw_series(sheet, axis, series, lambda row: row.whirl_frequency_ratio, 1.0)
        else:
            every = [abs(row[name].value) for row in table.rows for name in panel.entries]
            factor, unit = prefix(np.array(every), UNITS[panel.kind])
            panel_title(axis, f"{panel.words}, {unit}")
            first, second = panel.entries
            ends = _draw_series(sheet, axis, series, _entry(first), factor)
            if _there(table, second):
                _draw_series(sheet, axis, series, _entry(second), panel.sign * factor, hollow=True)
            low, high = axis.get_ylim()
            axis.set_ylim(min(low, 0.0), max(high, 0.0))
        few_ticks(axis.xaxis, 3)
        axis.set_xlim(axis.get_xlim())
        end_labels(axis, ends if len(series) > 1 else [])
        axis.set_xlabel(f"shaft speed, {sheet.rate_unit}")
    return figure


class _Panel(NamedTuple):
    """Two coefficients that a round seal has alike, the second with a sign."""

    kind: str
    entries: tuple[str, str]
    sign: float
    words: str


_PANELS = tuple(
    panel
    for kind, what in (("K", "stiffness"), ("C", "damping"), ("M", "inertia"))
    for panel in (
        _Panel(kind, (f"{kind}xx", f"{kind}yy"), 1.0, f"{kind}xx, {kind}yy  {what}"),
        _Panel(kind, (f"{kind}xy", f"{kind}yx"), -1.0, f"{kind}xy, −{kind}yx  {what}"),
    )
)
_READS = "Filled: the first coefficient named, open and dashed: the second. Bars: 95 % of the whole error."


def _entry(name: str) -> Callable[[Coefficients], Quantity]:
    return lambda row: row[name]


def _series(table: CoefficientRows) -> dict[str, list[Coefficients]]:
    """Rows over speed by their other conditions."""
    series: dict[str, list[Coefficients]] = {}
    for row in sorted(table.rows, key=lambda row: row.speed):
        series.setdefault(_with_units(row.condition.rpartition(", ")[0]), []).append(row)
    return series


def _draw_series(
    sheet: Sheet,
    axis: Any,
    series: Mapping[str, Sequence[Coefficients]],
    value: Callable[[Coefficients], Quantity],
    factor: float,
    *,
    hollow: bool = False,
) -> list[tuple[str, float, str]]:
    """A quantity over speed, a line a condition, points of one speed apart; names of the lines at their ends."""
    ends = []
    apart = 0.012 * max((row.speed for rows in series.values() for row in rows), default=0.0) * sheet.per_rad_s
    for number, (name, rows) in enumerate(series.items()):
        known = [row for row in rows if np.isfinite(value(row).value)]
        if not known:
            continue
        colour, marker = colour_of(number, len(series)), MARKERS[number % len(MARKERS)]
        x = np.array([row.speed for row in known]) * sheet.per_rad_s + apart * (number - (len(series) - 1) / 2)
        y = factor * np.array([value(row).value for row in known])
        reach = np.abs(factor) * CHANCE_ERRORS * np.array([value(row).stderr for row in known])
        look = {"ls": "--" if hollow else "-", "mfc": "white" if hollow else colour, "lw": 1.0, "elinewidth": 1.0}
        axis.errorbar(x, y, np.where(np.isfinite(reach), reach, 0.0), marker=marker, color=colour, ms=3.5, **look)
        ends.append((literal(name), float(y[-1]), colour))
    return ends


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
    series = _series(table)
    labels = _draw_series(sheet, axis, series, lambda row: row.whirl_frequency_ratio, 1.0)
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
