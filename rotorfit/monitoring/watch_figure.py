"""Watched values over the tests, and the evidence that they have changed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import datetime

import numpy as np
from matplotlib.figure import Figure

from rotorfit.monitoring.alarms import MARGIN, Rule
from rotorfit.plots.style import COLOURS, GREY, SMALL_TYPE, date_ticks, grid, labelled, legend_below, prefix
from rotorfit.units import RPM_PER_RAD_S


def plot_rules(rules: Sequence[Rule], dates: Mapping[int, str]) -> Figure:
    """One row a rule: values with their standard errors by date, and the evidence against its limit."""
    figure, axes = grid(len(rules), 2, "", size=(3.5, 1.8))
    handles = {}
    for row, rule in enumerate(rules):
        watched = rule.watched
        when = [datetime.fromisoformat(dates[test]) for test in watched.tests]
        speed = watched.unit == "rad/s"
        factor, unit = (RPM_PER_RAD_S, "rpm") if speed else prefix(watched.value, watched.unit)
        handles["one test, with its standard error"] = axes[row, 0].errorbar(
            when, watched.value * factor, watched.stderr * factor, fmt="o", color=COLOURS[0], markersize=3, linewidth=1
        )
        if np.isfinite(rule.required):
            required = axes[row, 0].axhline(rule.required * factor, color=COLOURS[1], linewidth=1)
            handles["required"] = required
        name = "threshold speed" if rule.name == MARGIN else rule.name
        axes[row, 0].set_ylabel(labelled(name, unit), fontsize=SMALL_TYPE)
        least_evidence = 0.1  # where the axis of the evidence ends; below 1 nothing speaks for a change
        shown = np.clip(rule.evidence, least_evidence, 10 * rule.limit)
        axes[row, 1].plot(
            np.arange(1, len(shown) + 1), shown, marker="o", markersize=2.5, color=COLOURS[2], linewidth=1
        )
        limit = axes[row, 1].axhline(rule.limit, color=GREY, linestyle="--", linewidth=1)
        handles["evidence at which the alarm is raised"] = limit
        axes[row, 1].set_yscale("log")
        axes[row, 1].set_ylabel("evidence", fontsize=SMALL_TYPE)
        axes[row, 1].set_xlabel("test, in order of arrival" if row == len(rules) - 1 else "", fontsize=SMALL_TYPE)
        date_ticks(axes[row, 0].xaxis)
    legend_below(figure, handles)
    return figure
