"""Coefficients of a bearing or seal against speed."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from rotorfit.estimators.significance import CHANCE_ERRORS
from rotorfit.fitting.structure.coefficient_rows import UNITS, CoefficientRows
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
