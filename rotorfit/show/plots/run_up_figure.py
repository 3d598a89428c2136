"""Figures of balancing: vibration before and after, over speed and at a glance, and where the weights go."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from rotorfit.base.significance import quantile
from rotorfit.lab.data.balancing import Balance
from rotorfit.show.plots import style


@style.on_sheet
def plot_balance(found: Balance, *, sheet: style.Sheet) -> Figure:
    """Amplitude at each probe as it is and with the correction weights, with its 95 % band.

    ``ax`` and ``unit`` are as for :meth:`rotorfit.FitResult.plot.bode`.

    Example:
        >>> weighed = rf.influence(rf.read(rf.datasets.path("rk4_sync.csv")))
        >>> figure = rf.balance(weighed, planes=["disk2"]).plot()
    """
    probes = list(dict.fromkeys(found.readings))
    columns = min(len(probes), 2)
    rows = -(-len(probes) // columns)
    planes = ", ".join(found.planes)
    figure, axes = sheet.grid(rows, columns, style.literal(f"Vibration with weights in {planes}"), size=(4.2, 2.2))
    scale, unit = sheet.length
    reach = quantile(0.95, found.freedom)
    number = np.array([probes.index(probe) for probe in found.readings])
    flat = axes.reshape(-1)
    for axis in flat[len(probes) :]:
        axis.set_visible(False)
    for k, (probe, axis) in enumerate(zip(probes, flat, strict=False)):
        own = np.flatnonzero(number == k)
        own = own[np.argsort(found.speed[own], kind="stable")]
        x, few = found.speed[own] * sheet.per_rad_s, own.size <= 8
        before, after = np.abs(found.before[own]) * scale, np.abs(found.expected[own]) * scale
        half = reach * found.stderr[own] * scale
        axis.plot(x, before, "s--" if few else "--", ms=3.5, lw=1.2, color=style.GREY, label="as it is")
        axis.plot(x, after, "o-" if few else "-", ms=3.5, lw=1.4, color=style.COLOURS[0], label="with the weights")
        low, high = np.maximum(after - half, 0.0), after + half
        axis.fill_between(x, low, high, color=style.COLOURS[0], alpha=0.25, lw=0, label="95 % band")
        if not np.isfinite(after).any():
            style.above(axis, "not controlled: no run tells what the weights do here")
        style.panel_title(axis, style.literal(" ".join(probe)))
        axis.set_ylim(bottom=0)
        if k >= len(probes) - columns:
            axis.set_xlabel(f"speed, {sheet.rate_unit}")
        if k % columns == 0:
            axis.set_ylabel(f"amplitude, {sheet.amplitude_unit(unit)}")
    style.legend_below(figure)
    return figure


@style.on_sheet
def plot_levels(found: Balance, *, sheet: style.Sheet) -> Figure:
    """The largest readings as they are and with the weights, these with 95 % bars: a half figure of a first screen."""
    most = 8  # readings that have room
    figure, ((axis,),) = sheet.grid(1, 1, "", size=style.HALF)
    scale, unit = sheet.length
    rows = np.argsort(-np.abs(found.before))[:most][::-1]
    places = np.arange(rows.size)
    before, after = (scale * np.abs(values[rows]) for values in (found.before, found.expected))
    half = scale * quantile(0.95, found.freedom) * found.stderr[rows]
    axis.hlines(places, np.fmin(before, after), np.fmax(before, after), color=style.GRID, lw=1.2)
    axis.plot(before, places, "s", ms=4.5, color=style.GREY)
    axis.errorbar(after, places, xerr=np.vstack([np.minimum(half, after), half]), fmt="o", ms=4.5, lw=1.2)
    names = [f"{' '.join(found.readings[row])}, {sheet.rate_words(found.speed[row])}" for row in rows.tolist()]
    axis.set_yticks(places, [style.literal(name) for name in names])
    axis.set_ylim(-0.6, rows.size - 0.4)
    axis.set_xlim(left=0)
    style.panel_title(axis, "■ as it is, ● with the weights, 95 %", beside=0)
    axis.set_xlabel(f"amplitude, {sheet.amplitude_unit(unit)}")
    return figure


@style.on_sheet
def plot_weights(found: Balance, *, sheet: style.Sheet) -> Figure:
    """The weights by amount and angle, with 95 % bars: a half figure of a first screen."""
    figure, ((axis,),) = sheet.grid(1, 1, "", size=style.HALF, projection="polar")
    largest = max(float(np.abs(found.weight).max()) * 1e6, 1e-9)
    for number, (plane, weight) in enumerate(zip(found.planes, found.weight.tolist(), strict=True)):
        size, angle, colour = abs(weight) * 1e6, float(np.angle(weight)), style.colour_of(number, len(found.planes))
        (low, high), (early, late) = found.interval(plane)
        if np.isfinite(high):
            axis.plot([angle, angle], [1e6 * low, 1e6 * high], color=colour, lw=1.2)
            axis.plot(np.linspace(early, late, 60), np.full(60, size), color=colour, lw=1.2)
        axis.plot(angle, size, style.MARKERS[number % len(style.MARKERS)], ms=5, color=colour)
        words = f"{plane} {style.number_words(size, 3)}"
        side = "left" if np.cos(angle) < 0 else "right"  # towards the middle of the figure
        axis.annotate(
            style.literal(words), (angle, size), (6 if side == "left" else -6, 4), textcoords="offset points",
            ha=side, va="bottom", fontsize=style.SMALL_TYPE, fontweight="bold", color=colour,
            path_effects=style.halo(), zorder=6,
        )  # fmt: skip
    axis.set_rlim(0, 1.25 * largest)
    axis.set_yticklabels([])
    axis.set_thetagrids(range(0, 360, 45), fontsize=style.SMALL_TYPE)
    axis.grid(color=style.GRID, lw=0.6)
    axis.set_title("Weights to add, g mm", pad=22, loc="center")
    axis.set_xlabel("angle: degrees of force_phase_deg", fontsize=style.SMALL_TYPE)
    return figure
