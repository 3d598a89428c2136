"""Values of a machine over time: points with their errors, levels before and after a change."""

from __future__ import annotations

from datetime import datetime
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure

from rotorfit.plots.style import (
    COLOURS,
    GREY,
    SMALL_TYPE,
    date_ticks,
    grid,
    labelled,
    legend_below,
    literal,
    looked,
    per_rad_s,
    prefix,
    rate_unit,
)

if TYPE_CHECKING:
    from rotorfit.monitoring.trend import MachineTrend


@looked
def plot_trend(trend: MachineTrend) -> Figure:
    """One column a place, one panel a value: tests in order of time, levels with the scatter of one test as a band."""
    rows = max(len(place.names) for place in trend.places)
    figure, axes = grid(rows, len(trend.places), "", size=(7.0 / max(len(trend.places), 1), 1.9))
    handles = {}
    for column, place in enumerate(trend.places):
        x = [datetime.fromisoformat(date) for date in place.dates] if place.dated else np.arange(len(place.dates))
        axes[0, column].set_title(literal(place.place), fontsize=SMALL_TYPE + 1)
        for row in range(rows):
            axis = axes[row, column]
            if row >= len(place.names):
                axis.set_visible(False)
                continue
            speed = place.units[row] == "rad/s"
            factor, unit = (per_rad_s(), rate_unit()) if speed else prefix(place.values[:, row], place.units[row])
            values, errors = place.values[:, row] * factor, place.stderr[:, row] * factor
            handles["one test, with its standard error"] = axis.errorbar(
                x, values, errors, fmt="o", color=COLOURS[0], markersize=3, linewidth=1, capsize=2
            )
            if place.change is not None:
                split = place.change.index if place.found else len(place.dates)
                spread = float(np.sqrt(place.change.scatter[row, row])) * factor
                for part in (slice(0, split), slice(split, None)):
                    if len(values[part]):
                        mean = values[part].mean()
                        ends = [x[part][0], x[part][-1]]
                        (handles["level"],) = axis.plot(ends, [mean, mean], color=COLOURS[1], linewidth=1.2)
                        handles["scatter of one test"] = axis.fill_between(
                            ends, mean - spread, mean + spread, color=COLOURS[1], alpha=0.15, linewidth=0
                        )
                if place.found:
                    middle = x[split - 1] + (x[split] - x[split - 1]) / 2
                    handles["change"] = axis.axvline(middle, color=GREY, linestyle="--", linewidth=1)
            axis.set_ylabel(
                labelled(place.names[row].replace("threshold_speed", "threshold speed"), unit), fontsize=SMALL_TYPE
            )
            if row < len(place.names) - 1:
                if place.dated:
                    date_ticks(axis.xaxis)
                axis.tick_params(labelbottom=False)
        _name_tests(axes[len(place.names) - 1, column], place.dates, dated=place.dated)
    legend_below(figure, handles)
    return figure


def _name_tests(axis: Any, dates: tuple[str, ...], *, dated: bool) -> None:
    most_names = 12  # tests from which on their names no longer fit under the axis
    if dated:
        date_ticks(axis.xaxis)
    elif len(dates) <= most_names:
        axis.set_xticks(
            range(len(dates)), [literal(date.rpartition("/")[2]) for date in dates], rotation=30, ha="right"
        )
    else:
        axis.set_xlabel("test", fontsize=SMALL_TYPE)
