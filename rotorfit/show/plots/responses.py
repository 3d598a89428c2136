"""Figures of a fit: polar plot, residuals."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from rotorfit.base.array_types import ComplexArray, Float
from rotorfit.base.digits import significant
from rotorfit.identify.fitting.result import FitResult
from rotorfit.lab.data.experiments import PerturbationTest
from rotorfit.models import RotorModel
from rotorfit.show.plots.bode import (
    cell_title,
    condition_legend,
    direction_marks,
    frequency_label,
    panels_of,
    response_unit,
)
from rotorfit.show.plots.style import GREY, SMALL_TYPE, Sheet, on_sheet, square_axis
from rotorfit.show.plots.sweeps import SweepCondition, SweepCurve, curves, joined, measured_curves


@on_sheet
def plot_polar(fit: FitResult, *, sheet: Sheet) -> Figure:
    """Responses per unit force in the complex plane; filled points forward, open points backward.

    Angles are phase leads of the probe, forward and backward alike. Crosses along the fitted lines are at round
    frequencies, in rpm, signed.
    """
    conditions, found = curves(fit, sheet)
    return _polar(sheet, fit.model, conditions, found, f"Polar plot, {fit.model.name}", "fit")


@on_sheet
def plot_measured_polar(test: PerturbationTest, *, sheet: Sheet) -> Figure:
    """The same of a test before a fit; lines and crosses lead from reading to reading."""
    return _polar(sheet, *measured_curves(test, sheet), "Measured responses", "")


def _polar(
    sheet: Sheet,
    model: RotorModel,
    conditions: Sequence[SweepCondition],
    found: Sequence[SweepCurve],
    title: str,
    line: str,
) -> Figure:
    figure, panels, _ = panels_of(sheet, found, title, rows=1, size=(4.4, 3.9))
    for curve in found:
        (axis,) = panels[curve.coordinate, curve.force_plane]
        colour = curve.condition.colour
        factor, _ = response_unit(sheet, model, curve.coordinate, found)
        face = colour if curve.frequency[-1] > 0 else "none"
        z, fitted = factor * curve.seen, factor * _round(curve)
        axis.plot(z.real, z.imag, "o", ms=3, mfc=face, mec=colour, mew=0.6, alpha=0.5)
        axis.plot(fitted.real, fitted.imag, "-", lw=1.1, color=colour)
    for pair, (axis,) in panels.items():
        mine = [c for c in found if (c.coordinate, c.force_plane) == pair]
        factor, unit = response_unit(sheet, model, pair[0], found)
        axis.set_title(cell_title(model, *pair))
        axis.set(xlabel=f"in phase, {unit}", ylabel=f"quadrature, {unit}", aspect="equal")
        axis.axhline(0, color="0.7", lw=0.6)
        axis.axvline(0, color="0.7", lw=0.6)
        every = np.asarray(factor * np.concatenate([*(c.line_seen for c in mine), np.zeros(1)]), dtype=complex)
        square_axis(axis, every, 1.28)  # and numbers beside the curve; noise of low frequencies may lie outside
        _mark_frequencies(sheet, axis, mine, factor)
    marks = direction_marks(found, "o") | {f"frequency in {sheet.rate_unit}": ("x", GREY)}
    condition_legend(figure, conditions, line, marks)
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
    """Crosses at round frequencies on the fitted lines, each with its number where it hides least."""
    from matplotlib.ticker import MaxNLocator

    top = max(float(np.abs(c.fine).max()) for c in found) * sheet.per_rad_s
    steps = np.asarray(MaxNLocator(nbins=28, steps=[1, 2, 5, 10]).tick_values(-top, top))
    reach = np.ptp(axis.get_xlim()) / 2
    apart = 0.3  # of crosses, in halves of the axis
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
                axis.plot(z.real, z.imag, "x", ms=4.5, mew=1.1, color="black", zorder=5)
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
    """Residuals over their noise against frequency, with the band of two standard deviations, and their histogram."""
    conditions, found = curves(fit, sheet)
    title = f"Residuals over noise, {fit.model.name}: redchi {significant(fit.redchi, 3)}"
    figure, panels, _ = panels_of(sheet, found, title, rows=2, size=(5.2, 1.6))
    for curve in joined(found):
        axis, _ = panels[curve.coordinate, curve.force_plane]
        x = curve.frequency * sheet.per_rad_s
        axis.plot(x, curve.whitened.real, ".", ms=2.5, color=curve.condition.colour, alpha=0.7)
        axis.plot(x, curve.whitened.imag, "x", ms=2.5, mew=0.6, color=curve.condition.colour, alpha=0.7)
    for pair, (axis, histogram) in panels.items():
        axis.set_title(cell_title(fit.model, *pair))
        axis.set(ylabel="residual / noise", xlabel=frequency_label(sheet, found))
        axis.axhspan(-2, 2, color="0.93", zorder=0)
        mine = np.concatenate([c.whitened for c in found if (c.coordinate, c.force_plane) == pair])
        _histogram(histogram, np.concatenate([mine.real, mine.imag]))
    condition_legend(figure, conditions, "", {"real part": (".", GREY), "imaginary part": ("x", GREY)})
    return figure


def _histogram(axis: Any, values: Float) -> None:
    reach = max(4.0, min(float(np.quantile(np.abs(values), 0.99)) * 1.2, 40.0))
    height, edges = np.histogram(np.clip(values, -reach, reach), bins=61, range=(-reach, reach), density=True)
    axis.stairs(height, edges, fill=True, color="0.75")
    u = np.linspace(-reach, reach, 400)
    axis.plot(u, np.exp(-(u**2) / 2) / np.sqrt(2 * np.pi), color="#D55E00", lw=1.2)
    axis.set_xlabel("residual / noise (line: noise alone)")
    axis.set_yticks([])
    axis.grid(visible=False)
