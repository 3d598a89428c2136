"""Vibration over speed before and after balancing, one panel a probe."""

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
        axis.plot(x, before, "o-" if few else "-", ms=3.5, lw=1.2, color="0.55", label="as it is")
        axis.plot(x, after, "o-" if few else "-", ms=3.5, lw=1.4, color="C0", label="with the weights")
        low, high = np.maximum(after - half, 0.0), after + half
        axis.fill_between(x, low, high, color="C0", alpha=0.25, lw=0, label="95 % band")
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
