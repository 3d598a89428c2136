"""Estimates of several fits side by side."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from rotorfit.plots.style import colour_of, few_ticks, grid, labelled, literal, looked, prefix

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from rotorfit.uncertainty.comparison import Comparison


@looked
def plot_comparison(comparison: Comparison) -> Figure:
    """A panel a parameter, with the 95 % interval of each fit."""
    fits = comparison.fits
    names = [n for n in comparison.parameters if sum(n in fit.params for fit in fits.values()) > 1 or len(fits) == 1]
    if not names:
        raise ValueError(f"{' and '.join(fits)} have no parameter in common: there is nothing to draw side by side")
    columns = min(3, len(names))
    rows = -(-len(names) // columns)
    figure, axes = grid(rows, columns, "Estimates with 95 % intervals", size=(2.6, 0.6 + 0.3 * len(fits)))
    for axis, name in zip(axes.flat, names, strict=False):
        found = [(i, fit.params[name]) for i, fit in enumerate(fits.values()) if name in fit.params]
        unit = found[0][1].unit
        scale, unit = prefix(np.array([p.value for _, p in found]), unit) if unit.startswith("N") else (1.0, unit)
        for i, p in found:
            low, high = p.interval(0.95) if p.vary else (p.value, p.value)
            if np.isfinite([low, high]).all():
                axis.plot(scale * np.array([low, high]), [i, i], color=colour_of(i), lw=2)
            axis.plot(scale * p.value, i, "o" if p.vary else "|", color=colour_of(i), ms=5)
        axis.set_yticks(range(len(fits)), [literal(label) for label in fits], fontsize=7)
        few_ticks(axis.xaxis, intervals=3)
        axis.set_ylim(len(fits) - 0.5, -0.5)
        axis.set_xlabel(labelled(name, unit))
    for axis in axes.flat[len(names) :]:
        axis.set_visible(False)
    return figure
