"""Trends of a campaign: fitted parameters with error bars against a condition of the runs (Figs 19 and 20)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from rotorfit.campaigns.trends import Trend
from rotorfit.plots.style import COLOURS, grid, legend_below, prefix

_MARKERS = ("o", "s", "^", "D", "v", "P")


def plot_trends(trends: Sequence[Trend], by: str | None = None) -> Figure:
    """One panel a parameter, one colour and marker a group, the weighted line with its standard error as a band.

    Args:
        trends: of one or several parameters against one attribute.
        by: attribute that makes the groups, for the legend.

    Raises:
        ValueError: no trends.
    """
    if not trends:
        raise ValueError("no run has a resolved value of these parameters: there is nothing to plot")
    parameters = list(dict.fromkeys(trend.parameter for trend in trends))
    groups = list(dict.fromkeys(trend.group for trend in trends))
    against = trends[0].against
    figure, axes = grid(len(parameters), 1, f"{', '.join(parameters)} against {against}", size=(6.0, 2.5))
    handles = {}
    for axis, parameter in zip(axes[:, 0], parameters, strict=True):
        mine = [trend for trend in trends if trend.parameter == parameter]
        factor, unit = (
            (1.0, "1") if mine[0].unit == "1" else prefix(np.concatenate([t.value for t in mine]), mine[0].unit)
        )
        for trend in mine:
            number = groups.index(trend.group)
            colour, marker = COLOURS[number % len(COLOURS)], _MARKERS[number % len(_MARKERS)]
            handles[trend.group] = axis.errorbar(
                trend.x, trend.value * factor, trend.stderr * factor, fmt=marker, color=colour, markersize=4,
                linewidth=1, capsize=2,
            )  # fmt: skip
            if np.isfinite(trend.slope.value):
                x = np.linspace(trend.x[0], trend.x[-1], 50)
                line = [trend.at(float(at)) for at in x]
                middle = np.array([q.value for q in line]) * factor
                error = np.array([q.stderr for q in line]) * factor
                axis.plot(x, middle, color=colour, linewidth=1)
                axis.fill_between(x, middle - error, middle + error, color=colour, alpha=0.2, linewidth=0)
        axis.set_ylabel(parameter if unit == "1" else f"{parameter} ({unit})", fontsize=8)
    axes[-1, 0].set_xlabel(against, fontsize=8)
    if groups != [""]:
        labels = [group if by is None else f"{by} {group}" for group in groups]
        legend_below(figure, [handles[group] for group in groups], labels)
    return figure
