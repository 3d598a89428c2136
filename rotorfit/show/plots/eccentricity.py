"""Figures of a fluid that changes with eccentricity: its law, and nonlinear minus linear stiffness (Figs 13 to 15)."""

from __future__ import annotations

from itertools import cycle
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from rotorfit.base.array_types import Index
from rotorfit.identify.fitting.propagation import by_values_of_causes
from rotorfit.identify.fitting.result import FitResult
from rotorfit.models.coefficient_tables import changing_fluids, law_curves
from rotorfit.show.plots import journal, style
from rotorfit.show.plots.journal import rig_of
from rotorfit.show.plots.sweeps import levels


@style.on_sheet
def plot_law(fit: FitResult, *, sheet: style.Sheet) -> Figure:
    """K0, D and lam against eccentricity with their 95 % bands; ticks below mark the eccentricities of the data.

    Dotted beyond the data, where the law alone speaks. A law that changes with speed has a curve for each tested one.
    """
    changing_fluids(fit.model)
    limit, measured = journal.reach(fit), journal.eccentricities(fit)
    eps = np.linspace(0.0, limit + 0.15 * min(limit, 1 - limit), 200)
    series = journal.law_series(fit)
    sets = [law_curves(fit.model, fit.thetas[group], eps, speed) for group, speed in series]
    figure, axes = sheet.grid(len(sets[0]), 1, f"{rig_of(fit)}: fluid against eccentricity", size=(5.6, 2.2))
    seen = eps <= limit
    for place, axis in enumerate(axes[:, 0]):
        curves = [curves[place] for curves in sets]
        every = np.concatenate([curve.value for curve in curves])
        factor, unit = style.prefix(every, curves[0].unit)
        for number, ((group, speed), curve) in enumerate(zip(series, curves, strict=True)):
            colour, value = style.colour_of(number, len(series)), factor * curve.value
            band = factor * journal.half_width(
                fit, group, curve.slope, by_values_of_causes(fit, curve.slope, group, speed)
            )
            axis.plot(eps[seen], value[seen], color=colour, lw=1.4)
            axis.plot(eps[~seen], value[~seen], ":", color=colour, lw=1.4)
            axis.fill_between(eps, value - band, value + band, color=colour, alpha=style.BAND, lw=0)
        axis.set_ylabel(style.labelled(curves[0].name, unit))
        style.logarithmic_over_decades(axis, factor * every)
        ticks = {"color": style.GREY, "ms": 7, "mew": 0.6, "transform": axis.get_xaxis_transform()}
        axis.plot(measured, np.zeros(measured.size), "|", **ticks)
    axes[-1, 0].set_xlabel("eccentricity of the journal over clearance")
    speeds = ["" if speed is None else sheet.rate_words(speed) for _, speed in series]
    groups = [style.literal(journal.group_label(fit, group)) for group, _ in series]
    names = [", ".join(filter(None, both)) for both in zip(groups, speeds, strict=True)]
    entries = style.in_colours(names) if len(names) > 1 else {}
    entries |= {"fit and 95 % band": {"lw": 1.4}, "beyond the data": {"lw": 1.4, "ls": ":"}}
    style.legend_below(figure, entries | {"eccentricities of the data": {"ls": "", "marker": "|", "ms": 7}})
    return figure


@style.on_sheet
def plot_relative_law(fit: FitResult, *, sheet: style.Sheet) -> Figure:
    """K0, D and lam over their values in the centre against eccentricity in one panel: the half figure of a law.

    Bands hold 95 %; of several conditions the last is drawn. Dotted beyond the data.
    """
    changing_fluids(fit.model)
    limit = journal.reach(fit)
    eps = np.linspace(0.0, limit + 0.15 * min(limit, 1 - limit), 200)
    group, speed = journal.law_series(fit)[-1]
    curves = [c for c in law_curves(fit.model, fit.thetas[group], eps, speed) if c.value[0]]
    figure, ((axis,),) = sheet.grid(1, 1, "", size=style.HALF)
    style.panel_title(axis, "Fluid over its value in the centre")
    ends, seen = [], eps <= limit
    looks = zip(cycle(style.COLOURS), cycle(("-", "--", "-.")), strict=True)
    for curve, (colour, look) in zip(curves, looks, strict=False):
        half = journal.half_width(fit, group, curve.slope, by_values_of_causes(fit, curve.slope, group, speed))
        value, band = curve.value / curve.value[0], half / abs(curve.value[0])
        style.draw_curve(axis, eps[seen], value[seen], band[seen], colour, look)
        axis.plot(eps[~seen], value[~seen], ":", color=colour, lw=1.3)
        ends.append((style.literal(curve.name), float(value[-1]), colour))
    axis.axhline(1.0, color=style.AXES, lw=0.7, zorder=1)
    axis.set_xlabel("eccentricity of the journal over clearance")
    axis.set_xlim(0.0, eps[-1])
    style.logarithmic_over_decades(axis, np.concatenate([curve.value / curve.value[0] for curve in curves]))
    style.end_labels(axis, ends)
    return figure


@style.on_sheet
def plot_nonlinear_stiffness(fit: FitResult, *, sheet: style.Sheet) -> Figure:
    """Nonlinear minus linear dynamic stiffness at the journal, as in Figs 13 to 15.

    Points are the data minus what the fitted model has for a vanishing orbit, lines the law's. Left against frequency,
    one colour a force level; right against eccentricity. Above the direct, below the quadrature part.
    """
    changing_fluids(fit.model)
    blocks = list(journal.journal_lines(fit, static=False))
    if not blocks:
        raise ValueError("this fit has no circular orbits of the journal to plot")
    sweeps = [part for lines in blocks for part in _sweeps(sheet, lines)]
    sweeps.sort(key=lambda part: (part[1].speed[part[2][0]], float(np.median(part[1].eccentricity[part[2]]))))
    names = list(dict.fromkeys(name for name, _, _ in sweeps))
    size = np.concatenate([np.abs(lines.stiffness - lines.linear) for lines in blocks])
    factor, unit = style.prefix(np.array([np.quantile(size, 0.9)]), "N/m")
    figure, axes = sheet.grid(2, 2, f"{rig_of(fit)}: nonlinear minus linear stiffness at the journal", size=(5.0, 2.7))
    for name, lines, rows in sweeps:
        _draw_sweep(sheet, fit, axes, lines, rows, style.colour_of(names.index(name), len(names)), factor)
    for row, part in enumerate(("direct", "quadrature")):
        axes[row, 0].set_ylabel(f"{part}, {unit}")
        for axis in axes[row]:
            axis.axhline(0, color=style.AXES, lw=0.7, zorder=1)
    axes[1, 0].set_xlabel(f"perturbation frequency, {sheet.rate_unit} (backward < 0 < forward)")
    axes[1, 1].set_xlabel("eccentricity of the journal over clearance")
    looks = {"data ± 1 sd minus linear model": {"ls": "", "marker": "o", "ms": 3}, "the fitted law": {"lw": 1.2}}
    style.legend_below(figure, style.in_colours(names) | looks)
    return figure


def _sweeps(sheet: style.Sheet, lines: journal.JournalLines) -> list[tuple[str, journal.JournalLines, Index]]:
    """Rows of each speed and force level, by frequency, with a name for the legend."""
    level = np.array(levels(np.abs(lines.force), lines.frequency))
    found = []
    for speed in np.unique(lines.speed):
        for value in np.unique(level[lines.speed == speed]).tolist():
            rows = np.flatnonzero((lines.speed == speed) & (level == value))
            found.append((f"{sheet.rate_words(speed)}, {value}", lines, rows[np.argsort(lines.frequency[rows])]))
    return found


def _draw_sweep(
    sheet: style.Sheet, fit: FitResult, axes: Any, lines: journal.JournalLines, rows: Index, colour: str, factor: float
) -> None:
    theta = fit.thetas
    w, change = lines.frequency[rows], lines.stiffness[rows] - lines.linear[rows]
    eps, sigma = lines.eccentricity[rows], factor * lines.stiffness_sigma[rows]
    fitted_eps = lines.fitted_eccentricity[rows]
    drive = [
        journal.drive_stiffness(fit.model, theta[g], 1j * f, speed, np.array([e]))[0][0]
        for g, f, speed, e in zip(lines.group[rows], w, lines.speed[rows], fitted_eps, strict=True)
    ]
    fitted = np.array(drive) - lines.linear[rows]
    for row, part in enumerate((np.real, np.imag)):
        for axis, x, x_fit in (
            (axes[row, 0], w * sheet.per_rad_s, w * sheet.per_rad_s),
            (axes[row, 1], eps, fitted_eps),
        ):
            axis.errorbar(
                x, factor * part(change), yerr=sigma, fmt="o", ms=2.5, color=colour, elinewidth=0.5, alpha=0.6, zorder=2
            )
            for side in (w < 0, w > 0):
                axis.plot(x_fit[side], factor * part(fitted)[side], "-", color=colour, lw=1.2, zorder=3)
