"""Values of a machine over time: points with their errors, levels before and after a change, evidence of alarms."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure

from rotorfit.base.units import RPM_PER_RAD_S
from rotorfit.show.plots import style
from rotorfit.studies.monitoring.alarms import MARGIN, Rule
from rotorfit.studies.monitoring.trend import as_time

if TYPE_CHECKING:
    from rotorfit.studies.monitoring.trend import MachineTrend


@style.on_sheet
def plot_trend(trend: MachineTrend, *, sheet: style.Sheet) -> Figure:
    """One column a place, one panel a value: tests in order of time, levels with the scatter of one test as a band.

    ``ax`` and ``unit`` are as for :meth:`rotorfit.FitResult.plot.bode`.
    """
    rows = max(len(place.names) for place in trend.places)
    figure, axes = sheet.grid(rows, len(trend.places), "", size=(7.0 / max(len(trend.places), 1), 1.9))
    handles = {}
    for column, place in enumerate(trend.places):
        x = [as_time(date, place.place) for date in place.dates] if place.dated else np.arange(len(place.dates))
        axes[0, column].set_title(style.literal(place.place), fontsize=style.SMALL_TYPE + 1)
        for row in range(rows):
            axis = axes[row, column]
            if row >= len(place.names):
                axis.set_visible(False)
                continue
            speed = place.units[row] == "rad/s"
            factor, unit = (
                (sheet.per_rad_s, sheet.rate_unit) if speed else style.prefix(place.values[:, row], place.units[row])
            )
            values, errors = place.values[:, row] * factor, place.stderr[:, row] * factor
            handles["one test, with its standard error"] = axis.errorbar(
                x, values, errors, fmt="o", color=style.COLOURS[0], markersize=3, linewidth=1, capsize=2
            )
            if place.change is not None:
                split = place.change.index if place.found else len(place.dates)
                spread = float(np.sqrt(place.change.scatter[row, row])) * factor
                for part in (slice(0, split), slice(split, None)):
                    if len(values[part]):
                        mean = values[part].mean()
                        ends = [x[part][0], x[part][-1]]
                        (handles["level"],) = axis.plot(ends, [mean, mean], color=style.CRITICAL, linewidth=1.2)
                        handles["scatter of one test"] = axis.fill_between(
                            ends, mean - spread, mean + spread, color=style.CRITICAL, alpha=0.15, linewidth=0
                        )
                if place.found:
                    middle = x[split - 1] + (x[split] - x[split - 1]) / 2
                    handles["change"] = axis.axvline(middle, color=style.GREY, linestyle="--", linewidth=1)
            axis.set_ylabel(
                style.labelled(place.names[row].replace("threshold_speed", "threshold speed"), unit),
                fontsize=style.SMALL_TYPE,
            )
            if row < len(place.names) - 1:
                if place.dated:
                    style.date_ticks(axis.xaxis)
                axis.tick_params(labelbottom=False)
        _name_tests(axes[len(place.names) - 1, column], place.dates, dated=place.dated)
    style.legend_below(figure, handles)
    return figure


def _name_tests(axis: Any, dates: tuple[str, ...], *, dated: bool) -> None:
    most_names = 12  # tests from which on their names no longer fit under the axis
    if dated:
        style.date_ticks(axis.xaxis)
    elif len(dates) <= most_names:
        axis.set_xticks(
            range(len(dates)), [style.literal(date.rpartition("/")[2]) for date in dates], rotation=30, ha="right"
        )
    else:
        axis.set_xlabel("test", fontsize=style.SMALL_TYPE)


def plot_rules(rules: Sequence[Rule], dates: Mapping[int, str]) -> Figure:
    """One row a rule: values with their standard errors by date, and the evidence against its limit."""
    figure, axes = style.PLAIN.grid(len(rules), 2, "", size=(3.5, 1.8))
    handles = {}
    for row, (rule, (left, right)) in enumerate(zip(rules, axes, strict=True)):
        watched = rule.watched
        when = [as_time(dates[test], f"test {test}") for test in watched.tests]
        speed = watched.unit == "rad/s"
        factor, unit = (RPM_PER_RAD_S, "rpm") if speed else style.prefix(watched.value, watched.unit)
        handles["one test, with its standard error"] = left.errorbar(
            when,
            watched.value * factor,
            watched.stderr * factor,
            fmt="o",
            color=style.COLOURS[0],
            markersize=3,
            linewidth=1,
        )
        if np.isfinite(rule.required):
            handles["required"] = left.axhline(rule.required * factor, color=style.CRITICAL, linewidth=1)
        name = "threshold speed" if rule.name == MARGIN else rule.name
        left.set_ylabel(style.labelled(name, unit), fontsize=style.SMALL_TYPE)
        style.date_ticks(left.xaxis)
        least_evidence = 0.1  # where the axis of the evidence ends; below 1 nothing speaks for a change
        shown = np.clip(rule.evidence, least_evidence, 10 * rule.limit)
        right.plot(np.arange(1, len(shown) + 1), shown, marker="o", markersize=2.5, color=style.COLOURS[2], linewidth=1)
        limit = right.axhline(rule.limit, color=style.GREY, linestyle="--", linewidth=1)
        handles["evidence at which the alarm is raised"] = limit
        right.set_yscale("log")
        right.set_ylabel("evidence", fontsize=style.SMALL_TYPE)
        right.set_xlabel("test, in order of arrival" if row == len(rules) - 1 else "", fontsize=style.SMALL_TYPE)
    style.legend_below(figure, handles)
    return figure
