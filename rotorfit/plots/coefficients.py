"""Coefficients of a bearing or seal against speed."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from rotorfit.estimators.significance import CHANCE_ERRORS
from rotorfit.fitting.structure.coefficient_rows import UNITS, CoefficientRows
from rotorfit.fitting.structure.frequency_rows import ENTRIES, FrequencyRows
from rotorfit.models.shafts.plane_forces import COEFFICIENTS
from rotorfit.plots.style import colour_of, grid, legend_below, looked, per_rad_s, prefix, rate_unit


@looked
def coefficients(table: CoefficientRows) -> Figure:
    """Stiffness, damping and inertia in x and y against speed, error bars of 95 %.

    Args:
        table: of :meth:`FitResult.coefficient_table`.
    """
    kinds = [kind for kind in "KCM" if any(_there(table, name) for name in COEFFICIENTS if name[0] == kind)]
    figure, axes = grid(len(kinds), 1, f"Coefficients at {table.rows[0].plane}", size=(6.5, 2.6))
    speed = np.array([row.speed for row in table.rows]) * per_rad_s()
    for axis, kind in zip(axes[:, 0], kinds, strict=True):
        names = [name for name in COEFFICIENTS if name[0] == kind and _there(table, name)]
        size = np.array([[row[name].value for row in table.rows] for name in names])
        factor, unit = prefix(np.abs(size), UNITS[kind])
        for values, name in zip(size, names, strict=True):
            error = CHANCE_ERRORS * np.array([row[name].stderr for row in table.rows])
            shown = np.where(np.isfinite(error), error, 0.0)
            place = ("xx", "xy", "yx", "yy").index(name[1:])
            axis.errorbar(
                speed, factor * values, factor * shown, fmt="o-", ms=3, lw=1, capsize=2, color=colour_of(place, 4)
            )
        axis.set_ylabel(f"{kind}, {unit}")
    axes[-1, 0].set_xlabel(f"rotative speed, {rate_unit()}")
    handles = axes[0, 0].containers
    legend_below(figure, list(handles), [n[1:] for n in COEFFICIENTS if n[0] == kinds[0] and _there(table, n)])
    return figure


def _there(table: CoefficientRows, name: str) -> bool:
    return any(row[name].value or row[name].stderr for row in table.rows)


@looked
def frequency_coefficients(table: FrequencyRows) -> Figure:
    """Stiffness and damping against frequency, a colour a condition: points as measured, bands of 95 % as fitted.

    Args:
        table: of :meth:`FitResult.frequency_coefficients`.
    """
    # Quantile of the error bars that sets the axes: where both runs move alike, a bar is taller than the seal is stiff.
    shown = 0.1
    figure, axes = grid(len(ENTRIES), 2, "Stiffness and damping against frequency", size=(4.6, 2.0), one_abscissa=True)
    handles = []
    for kind, column, si in (("stiffness", 0, "N/m"), ("damping", 1, "N s/m")):
        factor, unit = prefix(
            np.concatenate([np.abs(getattr(row, f"fitted_{kind}")).ravel() for row in table.rows]), si
        )
        for entry, name in enumerate(ENTRIES):
            axis = axes[entry, column]
            ends: list[float] = []
            for number, row in enumerate(table.rows):
                w, colour = row.frequency * per_rad_s(), colour_of(number, len(table.rows))
                value, error, fitted, width = (
                    factor * getattr(row, part)[entry]
                    for part in (kind, f"{kind}_stderr", f"fitted_{kind}", f"fitted_{kind}_stderr")
                )
                own = axis.errorbar(w, value, CHANCE_ERRORS * error, fmt="o", ms=2, lw=0.6, alpha=0.6, color=colour)
                order = np.argsort(w)
                axis.plot(w[order], fitted[order], lw=1, color=colour)
                reach = CHANCE_ERRORS * width[order]
                low, high = fitted[order] - reach, fitted[order] + reach
                axis.fill_between(w[order], low, high, alpha=0.25, color=colour, lw=0)
                handles += [own] if not column and not entry else []
                ends += [float(low.min()), float(np.quantile(value - CHANCE_ERRORS * error, shown))]
                ends += [float(high.max()), float(np.quantile(value + CHANCE_ERRORS * error, 1 - shown))]
            axis.set_ylabel(f"{'KC'[column]}{name}, {unit}", fontsize=8)
            reach = max(ends) - min(ends)
            axis.set_ylim(min(ends) - 0.2 * reach, max(ends) + 0.2 * reach or 1.0)
    for axis in axes[-1]:
        axis.set_xlabel(f"frequency, {rate_unit()}", fontsize=8)
    legend_below(figure, handles, [row.condition for row in table.rows])
    return figure
