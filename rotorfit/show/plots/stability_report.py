"""Figure of a stability report: decrements and the unbalance response, with bands, limits and running speeds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from rotorfit.base.array_types import Float
from rotorfit.base.digits import significant
from rotorfit.identify.uncertainty.stability.record import SENSITIVITY, Curve, StabilityReport, damping_ratio
from rotorfit.show.plots import style


@style.on_sheet
def plot_stability_report(report: StabilityReport, *, sheet: style.Sheet) -> Figure:
    """Decrement against speed, unbalance response, decrement against cross-coupling, sensitivity, with their bands.

    ``ax`` and ``unit`` are as for :meth:`rotorfit.FitResult.plot.bode`.

    Example:
        >>> figure = fit.stability_report(max_speed_rpm=2000).plot()
    """
    more = ((_unbalance, report.unbalance), (_coupling, report.cross_coupling), (_sensitivity, report.sensitivity))
    panels = [_decrements, *(panel for panel, curves in more if curves)]
    title = f"{style.literal(report.rig)}: stability, with {significant(100 * report.level, 4)} % bands"
    figure, axes = sheet.grid(len(panels), 1, title, size=(6.6, 2.4))
    for panel, axis in zip(panels, axes[:, 0], strict=True):
        panel(sheet, report, axis)
    style.legend_below(figure)
    return figure


def _draw(
    axis: Any, curves: Sequence[Curve], x: float, y: float, first: int = 0, critical: Curve | None = None
) -> None:
    ways = {"forward": 0, "backward": 0}
    for number, curve in enumerate(curves, first):
        way = curve.label.partition(" ")[0]
        look: dict[str, Any] = {"color": style.colour_of(number), "ls": ("-", "--", "-.", ":")[number % 4]}
        if way in ways:  # as in figures of a fit: warm and solid, cool and dashed
            colours = [c for c in (style.FORWARD if way == "forward" else style.BACKWARD) if c != style.CRITICAL]
            look = {"color": colours[ways[way] % len(colours)], "ls": "-" if way == "forward" else "--"}
            ways[way] += curve is not critical
        look |= {"lw": 1.2} if curve is not critical else {"lw": 2.2, "color": style.CRITICAL}
        axis.plot(x * curve.x, _clipped(y * curve.y), label=style.literal(curve.label), **look)
        axis.fill_between(x * curve.x, *_clipped(y * curve.band).T, color=look["color"], alpha=style.BAND, lw=0)


def _clipped(values: Float) -> Float:
    """Values that a figure can draw, whatever is infinite."""
    return np.asarray(np.clip(values, -1e9, 1e9))


def _running(sheet: style.Sheet, report: StabilityReport, axis: Any) -> None:
    low, high = (sheet.per_rad_s * speed for speed in report.running)
    if low < high:
        axis.axvspan(low, high, color=style.GREY, alpha=0.15, lw=0, label="running speeds")
    else:
        axis.axvline(high, color=style.GREY, lw=0.9, ls="--", label="running speed")


def _limit(report: StabilityReport, axis: Any) -> None:
    asked = report.criteria[0].limit
    axis.axhline(asked, color=style.CRITICAL, lw=0.9, ls=":", label=f"limit {asked:g}")
    axis.axhline(0.0, color=style.INK, lw=0.7)


def _decrements(sheet: style.Sheet, report: StabilityReport, axis: Any) -> None:
    damped = 3.0  # above which curves are cut off: such a mode is no question of stability
    modes = sorted(report.modes, key=lambda mode: mode.frequency)
    at = sheet.rate_words(report.running[1])
    shown = [
        replace(curve, label=curve.label.split(",")[0] + f", {sheet.rate_words(abs(mode.frequency))} at {at}")
        for curve, mode in zip(report.decrement, modes, strict=True)
        if np.min(curve.y) < damped
    ]
    _draw(axis, shown, sheet.per_rad_s, 1.0, critical=min(shown, key=lambda c: float(np.min(c.y)), default=None))
    _running(sheet, report, axis)
    _limit(report, axis)
    top = max([report.criteria[0].limit, *(float(np.max(np.minimum(c.band, damped))) for c in shown)])
    low = min([0.0, *(float(np.min(c.band)) for c in shown)])
    axis.set_ylim(max(low, -0.5 * top) - 0.1 * top, 1.15 * top)
    axis.set(xlabel=f"speed, {sheet.rate_unit}", ylabel="log. decrement")
    ratio = axis.secondary_yaxis("right", functions=(damping_ratio, _decrement_of))
    ratio.set_ylabel("damping ratio")
    ratio.tick_params(labelsize=7)


def _decrement_of(ratio: Float) -> Float:
    """Logarithmic decrements of damping ratios; those of ratios beyond the axis do not matter."""
    return np.asarray(2 * np.pi * np.tan(np.arcsin(np.clip(ratio, -0.99, 0.99))))


def _unbalance(sheet: style.Sheet, report: StabilityReport, axis: Any) -> None:
    scale, _ = sheet.length
    _draw(axis, report.unbalance, sheet.per_rad_s, scale, first=len(report.decrement))
    _running(sheet, report, axis)
    axis.set_ylim(0.0, None)
    axis.set(xlabel=f"speed, {sheet.rate_unit}", ylabel=f"amplitude, {sheet.amplitude_unit()}")


def _coupling(_: style.Sheet, report: StabilityReport, axis: Any) -> None:
    scale, unit = style.prefix(report.cross_coupling[0].x, "N/m")
    _draw(axis, report.cross_coupling, scale, 1.0, first=len(report.decrement) + 1)
    _limit(report, axis)
    axis.set(xlabel=f"cross-coupled stiffness, {unit}", ylabel="log. decrement")


def _sensitivity(sheet: style.Sheet, report: StabilityReport, axis: Any) -> None:
    _draw(axis, report.sensitivity, sheet.per_rad_s, 1.0, first=len(report.decrement) + 2)
    limit = next(c.limit for c in report.criteria if c.source == SENSITIVITY)
    axis.axhline(limit, color=style.CRITICAL, lw=0.9, ls=":", label=f"limit {limit:g}")
    axis.set_ylim(0.0, None)
    axis.set(xlabel=f"frequency, {sheet.rate_unit}", ylabel="sensitivity")
