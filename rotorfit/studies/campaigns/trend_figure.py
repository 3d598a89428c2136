"""Trends of a campaign: fitted parameters with error bars against a condition of the runs (Figs 19 and 20)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Unpack

import numpy as np
from matplotlib.figure import Figure

from rotorfit.show.plots.figure_keywords import PlotKeywords
from rotorfit.show.plots.style import (
    Sheet,
    colour_of,
    draw_curve,
    end_labels,
    labelled,
    legend_below,
    literal,
    on_sheet,
    prefix,
)
from rotorfit.studies.campaigns.campaign import Campaign
from rotorfit.studies.campaigns.trends import Trend

_MARKERS = ("o", "s", "^", "D", "v", "P")
_MOST_BESIDE = 8  # groups that are named beside their lines
_READS = "Points: runs, with one standard error. Weighted {}, with one standard error."


@on_sheet
def plot_trends(trends: Sequence[Trend], by: str | None = None, rig: str = "", *, sheet: Sheet) -> Figure:
    """One panel a parameter, one colour and marker a group, the weighted line with its standard error as a band."""
    if not trends:
        raise ValueError("no run has a resolved value of these parameters: there is nothing to plot")
    parameters = list(dict.fromkeys(trend.parameter for trend in trends))
    groups = list(dict.fromkeys(trend.group for trend in trends))
    against = list(dict.fromkeys(trend.against for trend in trends))
    title = ": ".join(filter(None, (literal(rig), f"{', '.join(parameters)} against {', '.join(against)}")))
    degree = max(trend.degree for trend in trends)
    reads = (_READS.format("lines" if degree < 2 else f"polynomials of degree {degree}"),)
    figure, axes = sheet.grid(len(parameters), len(against), title, size=(6.0, 2.3), reads=reads)
    named = groups if groups != [""] else []
    beside = named if len(named) <= _MOST_BESIDE else []  # of the lines; more are named below
    handles: dict[str, Any] = {}
    beyond = 0
    for row, parameter in enumerate(parameters):
        for axis, name in zip(axes[row], against, strict=True):
            mine = [trend for trend in trends if (trend.parameter, trend.against) == (parameter, name)]
            factor, unit, hidden = _panel(axis, mine, groups, handles)
            if beside:
                _name_groups(axis, mine, groups, factor)
            beyond = max(beyond, hidden)
        axes[row, 0].set_ylabel(labelled(parameter, unit))
    for axis, name in zip(axes[-1], against, strict=True):
        axis.set_xlabel(literal(name) + (", others held" if len(against) > 1 else ""))
    entries = {} if beside else {literal(group if by is None else f"{by} {group}"): handles[group] for group in named}
    if beyond:
        entries[f"{beyond} of the runs, far less certain, lie beyond the frame"] = {"ls": ""}
    legend_below(figure, entries)
    return figure


def _name_groups(axis: Any, trends: Sequence[Trend], groups: Sequence[str], factor: float) -> None:
    """Groups at the right ends of their lines."""
    last = {t.group: t.at(float(t.x[-1])).value if np.isfinite(t.slope.value) else float(t.value[-1]) for t in trends}
    axis.set_xlim(axis.get_xlim())
    ends = [(literal(g), factor * value, colour_of(groups.index(g), len(groups))) for g, value in last.items()]
    end_labels(axis, ends)


def _panel(
    axis: Any, trends: Sequence[Trend], groups: Sequence[str], handles: dict[str, Any]
) -> tuple[float, str, int]:
    """One parameter against one attribute; returns its factor and unit, and the number of runs out of the frame."""
    values = np.concatenate([t.value for t in trends])
    errors = np.concatenate([t.stderr for t in trends])
    largest_error_ratio = 8.0  # standard errors over their median beyond which a run does not set the limits of a panel
    sure = errors <= largest_error_ratio * np.median(errors)
    factor, unit = prefix(values[sure], trends[0].unit)
    for trend in trends:
        number = groups.index(trend.group)
        colour, marker = colour_of(number, len(groups)), _MARKERS[number % len(_MARKERS)]
        look = {"fmt": marker, "color": colour, "markersize": 4, "linewidth": 1, "capsize": 2}
        handles[trend.group] = axis.errorbar(trend.x, trend.value * factor, trend.stderr * factor, **look)
        if np.isfinite(trend.slope.value):
            x = np.linspace(trend.x[0], trend.x[-1], 50)
            line = [trend.at(float(at)) for at in x]
            middle = np.array([q.value for q in line]) * factor
            error = np.array([q.stderr for q in line]) * factor
            draw_curve(axis, x, middle, error, colour, lw=1)
    low, high = (values - errors)[sure].min() * factor, (values + errors)[sure].max() * factor
    margin = 0.08 * (high - low)
    axis.set_ylim(low - margin, high + margin)
    away = (values * factor < low - margin) | (values * factor > high + margin)
    return factor, unit, int(away.sum())


class CampaignPlots:
    """Figures of a campaign; ``campaign.plot(against=...)`` is that of its trends."""

    def __init__(self, campaign: Campaign) -> None:
        self._campaign = campaign

    def trends(
        self,
        parameters: str | Sequence[str] | None = None,
        *,
        against: str | Sequence[str],
        by: str | None = None,
        degree: int = 1,
        **look: Unpack[PlotKeywords],
    ) -> Figure:
        """Parameters with error bars and trend lines or curves against attributes, a column of panels each.

        ``parameters``, ``against``, ``by`` and ``degree`` are as for :meth:`rotorfit.Campaign.trends`,
        ``ax`` and ``unit`` as for :meth:`rotorfit.FitResult.plot.bode`.
        """
        found = self._campaign.trends(parameters, against=against, by=by, degree=degree)
        return plot_trends(found, by, self._campaign.rig, **look)

    __call__ = trends
