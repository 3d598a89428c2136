"""Figures of a fit: polar plot, residuals."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import cycle
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from rotorfit.base.array_types import ComplexArray
from rotorfit.base.digits import significant
from rotorfit.identify.fitting.result import FitResult
from rotorfit.lab.data.experiments import PerturbationTest
from rotorfit.models import RotorModel
from rotorfit.show.plots.bode import (
    cell_title,
    condition_legend,
    frequency_label,
    panels_of,
    response_unit,
    short_label,
)
from rotorfit.show.plots.journal import rig_of
from rotorfit.show.plots.style import (
    AXES,
    GREY,
    HALF,
    MARKERS,
    SMALL_TYPE,
    Sheet,
    halo,
    on_sheet,
    opacity_of,
    panel_title,
    shades,
    square_axis,
)
from rotorfit.show.plots.sweeps import SweepCondition, SweepCurve, curves, joined, measured_curves

_POLAR = (
    "Angle: lead of the probe over a force along it. Points: measured, open ones backward, paler where less certain.",
    "Circles: frequency of the force, with its number.",
)
_RESIDUALS = (
    "Points: real part, crosses: imaginary part. Noise alone leaves 95 % of them between the dashed lines at 2 and −2.",
)


@on_sheet
def plot_polar(fit: FitResult, *, sheet: Sheet) -> Figure:
    """Responses per unit force in the complex plane; filled points forward, open points backward.

    Angles are phase leads of the probe, forward and backward alike. Circles along the fitted lines are at round
    frequencies, in rpm, signed.
    """
    conditions, found = curves(fit, sheet)
    return _polar(sheet, fit.model, conditions, found, f"{rig_of(fit)}: polar responses and the fit", "fit")


@on_sheet
def plot_measured_polar(test: PerturbationTest, *, sheet: Sheet) -> Figure:
    """The same of a test before a fit; lines and circles lead from reading to reading."""
    return _polar(sheet, *measured_curves(test, sheet), "Measured responses", "")


def _polar(
    sheet: Sheet,
    model: RotorModel,
    conditions: Sequence[SweepCondition],
    found: Sequence[SweepCurve],
    title: str,
    line: str,
) -> Figure:
    figure, panels, _ = panels_of(sheet, found, title, rows=1, size=(4.4, 2.3), reads=_POLAR)
    for curve in found:
        (axis,) = panels[curve.coordinate, curve.force_plane]
        colour = curve.condition.colour
        factor, _ = response_unit(sheet, model, curve.coordinate, found)
        z, fitted = factor * curve.seen, factor * _round(curve)
        shade = shades(colour, opacity_of(curve.uncertainty))
        shown = shade[:, 3] > 0
        look: dict[str, Any] = {"s": 8, "marker": curve.condition.marker, "linewidths": 0, "c": shade[shown]}
        if curve.frequency[-1] < 0:
            look |= {"linewidths": 0.6, "c": None, "facecolors": "none", "edgecolors": shade[shown]}
        axis.scatter(z.real[shown], z.imag[shown], **look)
        axis.plot(fitted.real, fitted.imag, "-", lw=1.2, color=colour)
    for pair, (axis,) in panels.items():
        mine = [c for c in found if (c.coordinate, c.force_plane) == pair]
        factor, unit = response_unit(sheet, model, pair[0], found)
        panel_title(axis, cell_title(model, *pair), share=0.62)  # of a square panel
        axis.set(xlabel=f"in phase, {unit}", ylabel=f"quadrature, {unit}", aspect="equal")
        axis.axhline(0, color=AXES, lw=0.7, zorder=1)
        axis.axvline(0, color=AXES, lw=0.7, zorder=1)
        every = np.asarray(factor * np.concatenate([*(c.line_seen for c in mine), np.zeros(1)]), dtype=complex)
        square_axis(axis, every, 1.28)  # and numbers beside the curve; noise of low frequencies may lie outside
        _mark_frequencies(sheet, axis, mine, factor)
    condition_legend(figure, conditions, line)
    return figure


def _round(curve: SweepCurve) -> ComplexArray:
    """The fitted line as a probe shows it, with so many points that the loop of a sharp resonance is no polygon."""
    if curve.fine.size <= curve.frequency.size:  # a line along the readings
        return curve.line_seen
    from scipy.interpolate import CubicSpline

    finer = 6  # points for each of a fitted line: of a resonance with 1 % of damping every second degree of its loop
    along = np.linspace(0, curve.fine.size - 1, finer * (curve.fine.size - 1) + 1)
    return np.asarray(CubicSpline(np.arange(curve.fine.size), curve.line_seen)(along), dtype=complex)


def _mark_frequencies(sheet: Sheet, axis: Any, found: Sequence[SweepCurve], factor: float) -> None:
    """Circles at round frequencies on the fitted lines, each with its number where it hides least."""
    from matplotlib.ticker import MaxNLocator

    top = max(float(np.abs(c.fine).max()) for c in found) * sheet.per_rad_s
    steps = np.asarray(MaxNLocator(nbins=28, steps=[1, 2, 5, 10]).tick_values(-top, top))
    reach = np.ptp(axis.get_xlim()) / 2
    apart = 0.75  # of circles, in halves of the axis
    placed: list[complex] = []
    every = factor * np.concatenate([c.line_seen[np.isfinite(c.line_seen)] for c in found])
    cell = 0.02 * reach  # places nearer than this count once
    drawn = np.asarray(np.unique(np.round(every / cell)) * cell, dtype=complex)
    for curve in found:
        x = curve.fine * sheet.per_rad_s
        for rpm in sorted(steps[(steps >= x[0]) & (steps <= x[-1]) & (steps != 0)], key=abs):
            z = factor * complex(np.interp(rpm, x, curve.line_seen.real), np.interp(rpm, x, curve.line_seen.imag))
            if all(abs(z - other) > apart * reach for other in placed):
                placed.append(z)
                axis.plot(z.real, z.imag, "o", ms=3.6, mfc="white", mec=curve.condition.colour, mew=1.1, zorder=5)
                words = significant(rpm, 4).replace("-", "−")
                right, up, drawn = _clear_corner(axis, z, len(words), drawn)
                axis.annotate(
                    words,
                    (z.real, z.imag),
                    xytext=(4 * right, 3 * up),
                    textcoords="offset points",
                    ha="left" if right > 0 else "right",
                    va="bottom" if up > 0 else "top",
                    fontsize=SMALL_TYPE,
                    color=curve.condition.colour,
                    path_effects=halo(),
                    zorder=5,
                )


def _clear_corner(axis: Any, z: complex, letters: int, drawn: ComplexArray) -> tuple[int, int, ComplexArray]:
    """Corner of a point in which its number hides least of what is drawn, and that with the number."""
    (left, right), (low, high) = axis.get_xlim(), axis.get_ylim()
    smaller = 0.85  # of the room of the axes, what labels of ticks and equal scales leave
    room = smaller * min(axis.bbox.width, axis.bbox.height) / axis.figure.dpi * 72  # points
    point = (right - left) / room  # of type, in units of the data
    width, height = (0.6 * SMALL_TYPE * letters + 4) * point, (SMALL_TYPE + 3) * point

    def hidden(corner: tuple[int, int]) -> float:
        x, y = z.real + corner[0] * width, z.imag + corner[1] * height
        across, along = (drawn - z).real * corner[0] / width, (drawn - z).imag * corner[1] / height
        inside = (across > 0) & (across < 1) & (along > 0) & (along < 1)
        return float(np.count_nonzero(inside)) if left < x < right and low < y < high else np.inf

    best = min(((1, 1), (-1, 1), (1, -1), (-1, -1)), key=hidden)
    x, y = np.meshgrid(np.linspace(0.05, 0.95, 8), np.linspace(0.05, 0.95, 6))
    return *best, np.concatenate([drawn, (z + best[0] * width * x + 1j * best[1] * height * y).ravel()])


@on_sheet
def plot_residuals(fit: FitResult, *, sheet: Sheet) -> Figure:
    """Residuals over their noise against frequency, with lines at two standard deviations, a panel a response."""
    conditions, found = curves(fit, sheet)
    title = f"{rig_of(fit)}: residuals over noise, redchi {significant(fit.redchi, 3)}"
    figure, panels, bottom = panels_of(sheet, found, title, rows=1, size=(5.2, 1.6), reads=_RESIDUALS)
    for curve in joined(found):
        (axis,) = panels[curve.coordinate, curve.force_plane]
        x, look = curve.frequency * sheet.per_rad_s, {"color": curve.condition.colour, "alpha": 0.7}
        axis.plot(x, curve.whitened.real, curve.condition.marker, ms=2.4, mew=0, **look)
        axis.plot(x, curve.whitened.imag, "x", ms=2.4, mew=0.6, **look)
    largest = max(3.5, 1.05 * max(float(np.abs(c.whitened.view(float)).max(initial=0.0)) for c in found))
    for pair, (axis,) in panels.items():
        panel_title(axis, cell_title(fit.model, *pair))
        axis.set(ylabel="residual / noise", ylim=(-largest, largest))
        for level in (-2, 2):
            axis.axhline(level, color=GREY, lw=0.9, ls=(0, (4, 2)), zorder=1)
    for axis in bottom:
        axis.set_xlabel(short_label(frequency_label(sheet, found), bottom))
    condition_legend(figure, conditions, "")
    return figure


@on_sheet
def plot_largest_response(fit: FitResult, *, sheet: Sheet) -> Figure:
    """Amplitude of the largest response against frequency in one panel: the half figure of a rotor without fluid."""
    found = curves(fit, sheet)[1]
    largest = max(found, key=lambda curve: float(np.nanmax(np.abs(curve.fitted), initial=0.0)))
    own = [c for c in found if (c.coordinate, c.force_plane) == (largest.coordinate, largest.force_plane)]
    factor, unit = response_unit(sheet, fit.model, largest.coordinate, own)
    figure, ((axis,),) = sheet.grid(1, 1, "", size=HALF)
    panel_title(axis, cell_title(fit.model, largest.coordinate, largest.force_plane))
    for curve in joined(own):
        x, shade = curve.frequency * sheet.per_rad_s, shades(curve.condition.colour, opacity_of(curve.uncertainty))
        axis.scatter(x, factor * np.abs(curve.measured), s=8, c=shade, marker=curve.condition.marker, linewidths=0)
        axis.plot(curve.fine * sheet.per_rad_s, factor * np.abs(curve.fitted), color=curve.condition.colour, lw=1.5)
    axis.set(xlabel=frequency_label(sheet, own), ylabel=f"amplitude, {unit}")
    axis.set_ylim(0, 1.18 * factor * max(float(np.nanmax(np.abs(curve.fitted), initial=0.0)) for curve in own))
    return figure


@on_sheet
def plot_misfit(fit: FitResult, *, sheet: Sheet) -> Figure:
    """All residuals over their noise against frequency in one panel: the half figure of a fit that is not good."""
    conditions, found = curves(fit, sheet)
    figure, ((axis,),) = sheet.grid(1, 1, "", size=HALF)
    axis.set_title("Residuals over their noise")
    marks = dict(zip([c.name for c in conditions], cycle(MARKERS), strict=False))
    for curve in joined(found):
        x = np.tile(curve.frequency * sheet.per_rad_s, 2)
        look = {"marker": marks[curve.condition.name], "ls": "", "ms": 2.2, "alpha": 0.6, "mew": 0}
        both = np.concatenate([curve.whitened.real, curve.whitened.imag])
        axis.plot(x, both, color=curve.condition.colour, label=curve.condition.name, **look)
    for level in (-2, 2):
        axis.axhline(level, color=GREY, lw=0.9, ls=(0, (4, 2)))
    axis.set_xlabel(frequency_label(sheet, found))
    axis.text(0.99, 0.98, "noise alone: 95 % between the dashed lines", transform=axis.transAxes, ha="right", va="top",
              fontsize=SMALL_TYPE, color=GREY, path_effects=halo())  # fmt: skip
    return figure
