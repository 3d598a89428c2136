"""Figures of a fit: polar plot, residuals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import cycle
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.transforms import Bbox

from rotorfit.base.array_types import ComplexArray, Float
from rotorfit.base.digits import significant
from rotorfit.identify.fitting.result import FitResult
from rotorfit.lab.data.experiments import PerturbationTest
from rotorfit.models import RotorModel
from rotorfit.show.plots.bode import (
    cell_title,
    condition_legend,
    frequency_label,
    panels_of,
    probe_title,
    response_unit,
    short_label,
)
from rotorfit.show.plots.journal import rig_of
from rotorfit.show.plots.style import (
    GREY,
    GRID,
    HALF,
    MARKERS,
    PAGE,
    SMALL_TYPE,
    TYPE,
    Sheet,
    halo,
    lines_within,
    misfit_panel,
    on_sheet,
    opacity_of,
    panel_title,
    shades,
    square_axis,
)
from rotorfit.show.plots.sweeps import MOST_PANELS, SweepCondition, SweepCurve, curves, joined, leading, measured_curves

_TURNING = "Angle: motion ahead of the force, counted in the direction of rotation, 0° to the right."
_LEADING = "Angle: lead of the probe over a force along it, 0° to the right."
_POLAR = "Circles with numbers: frequency of the force, {}. Each panel is cut to its curve; + is zero."
_BESIDE = 0.08
"""Inches beside the panels of polar plots, which have no labels there."""
_RESIDUALS = (
    "Points: real part, crosses: imaginary part. Noise alone leaves 95 % of them between the dashed lines at 2 and −2.",
)


@on_sheet
def plot_polar(fit: FitResult, *, sheet: Sheet, every: bool = False) -> Figure:
    """Responses per unit force in the complex plane, backward and forward in panels of their own.

    Angles are those of x + jy over the force, counted in the direction of rotation; of x and y apart, phase leads of
    the probe. Circles along the fitted lines are at round frequencies, rings about zero have one step.
    """
    conditions, whole = curves(fit, sheet)
    found, left_out = leading(fit.model, whole, every=every)
    title = f"{rig_of(fit)}: polar responses and the fit"
    return _polar(sheet, fit.model, conditions, found, title, "fit", left_out)


@on_sheet
def plot_measured_polar(test: PerturbationTest, *, sheet: Sheet) -> Figure:
    """The same of a test before a fit; lines and circles lead from reading to reading, where these are known."""
    model, conditions, found = measured_curves(test, sheet)
    known = [replace(c, fitted=np.where(opacity_of(c.uncertainty) > 0, c.fitted, np.nan)) for c in found]
    return _polar(sheet, model, conditions, known, "Measured responses", "")


def _polar(
    sheet: Sheet,
    model: RotorModel,
    conditions: Sequence[SweepCondition],
    found: Sequence[SweepCurve],
    title: str,
    line: str,
    left_out: Sequence[str] = (),
) -> Figure:
    panels = sorted({(c.coordinate, c.force_plane, _is_forward(c)) for c in found})
    ways, pairs = sorted({forward for *_, forward in panels}), sorted({panel[:2] for panel in panels})
    few, several = 2, 6  # pairs beside one another, and pairs from which there are three
    across = len(ways) * (min(len(pairs), few) if len(pairs) <= several else 3)
    rows = -(-len(pairs) * len(ways) // across)
    pages = max(1.0, len({force for _, force in pairs}) / 3)
    side = pages * PAGE[0] / max(across, 2)
    signed = all(c.signed for c in found)
    reads = (_TURNING if signed else _LEADING, _POLAR.format(sheet.rate_unit), *left_out)
    lines = max(len(lines_within(cell_title(model, *pair), side - _BESIDE, TYPE)) for pair in pairs)
    words = 0.35 + 0.2 * max(lines - 2, 0) + 0.2 * (across > 4)  # inches of those about a panel
    above = 0.45  # of those above and below all panels
    figure, axes = sheet.grid(rows, across, title, size=(side, side + words + above / rows), reads=reads, pages=pages)
    places = dict(zip([(*pair, way) for pair in pairs for way in ways], axes.flat, strict=False))
    for axis in {*axes.flat} - {places[panel] for panel in panels}:
        axis.remove()
    for panel in panels:
        own = [c for c in found if (c.coordinate, c.force_plane, _is_forward(c)) == panel]
        factor, unit = response_unit(sheet, model, panel[0], found)
        way = (("forward" if panel[2] else "backward") + ("\n" if across > 4 else ", ")) if len(ways) > 1 else ""
        panel_title(places[panel], cell_title(model, *panel[:2]), beside=_BESIDE)
        _draw_polar(sheet, places[panel], own, factor, signed=signed)
        places[panel].set_xlabel(f"{way}ring {_draw_rings(places[panel])} {unit}", fontsize=SMALL_TYPE)
    condition_legend(figure, conditions, line)
    return figure


def _is_forward(curve: SweepCurve) -> bool:
    return bool(curve.frequency[-1] > 0)


def _draw_polar(sheet: Sheet, axis: Any, found: Sequence[SweepCurve], factor: float, *, signed: bool) -> None:
    """Curves of one probe, one force and one direction of whirl, cut to their fitted lines."""
    lines = [factor * (c.fitted if signed else c.line_seen) for c in found]
    for curve, line in zip(found, lines, strict=True):
        z, rounded = factor * (curve.measured if signed else curve.seen), _rounded(line, curve)
        shade = shades(curve.condition.colour, opacity_of(curve.uncertainty))
        shown = shade[:, 3] > 0
        look: dict[str, Any] = {"s": 8, "marker": curve.condition.marker, "linewidths": 0, "c": shade[shown]}
        axis.scatter(z.real[shown], z.imag[shown], **look)
        axis.plot(rounded.real, rounded.imag, "-", lw=1.2, color=curve.condition.colour)
    square_axis(axis, np.concatenate([*lines, np.zeros(1)]), 1.28)  # numbers stand beside the curve
    axis.set(aspect="equal", xticks=[], yticks=[])
    _mark_frequencies(sheet, axis, found, lines)


def _draw_rings(axis: Any) -> str:
    """Zero, and rings about it with one round step; the step."""
    from matplotlib.patches import Circle

    (left, right), (low, high) = axis.get_xlim(), axis.get_ylim()
    third = (right - left) / 6  # of half the width
    step = next(size * 10.0**power for power in [int(np.floor(np.log10(third)))] for size in (1, 2, 5, 10)
                if size * 10.0**power >= third)  # fmt: skip
    axis.grid(visible=False)
    axis.spines[:].set(visible=True, color=GRID)
    farthest = float(np.hypot(max(-left, right), max(-low, high)))
    for radius in np.arange(step, farthest, step).tolist():
        axis.add_patch(Circle((0, 0), radius, fill=False, ec=GRID, lw=0.6, zorder=0.5))
    for draw in (axis.axhline, axis.axvline):
        draw(0, color=GRID, lw=0.9, zorder=0.5)
    axis.plot(0, 0, "+", color=GREY, ms=7, zorder=3)
    return significant(step, 2)


def _rounded(line: ComplexArray, curve: SweepCurve) -> ComplexArray:
    """The line of a curve with so many points that the loop of a sharp resonance is no polygon."""
    if curve.fine.size <= curve.frequency.size:  # a line along the readings
        return line
    from scipy.interpolate import CubicSpline

    finer = 6  # points for each of a fitted line: of a resonance with 1 % of damping every second degree of its loop
    along = np.linspace(0, curve.fine.size - 1, finer * (curve.fine.size - 1) + 1)
    return np.asarray(CubicSpline(np.arange(curve.fine.size), line)(along), dtype=complex)


def _mark_frequencies(sheet: Sheet, axis: Any, found: Sequence[SweepCurve], lines: Sequence[ComplexArray]) -> None:
    """Circles at round frequencies on the fitted lines, each with its number where it hides least."""
    from matplotlib.ticker import MaxNLocator

    top = max(float(np.abs(c.fine).max()) for c in found) * sheet.per_rad_s
    steps = np.asarray(MaxNLocator(nbins=28, steps=[1, 2, 5, 10]).tick_values(-top, top))
    reach = np.ptp(axis.get_xlim()) / 2
    apart = 0.3  # of circles, in halves of the axis
    placed: list[complex] = []
    taken: list[Bbox] = []
    every = np.concatenate([line[np.isfinite(line)] for line in lines])
    cell = 0.02 * reach  # places nearer than this count once
    drawn = np.asarray(np.unique(np.round(every / cell)) * cell, dtype=complex)
    points = _shown_points(axis)
    for rpm in sorted(steps[steps != 0].tolist(), key=abs):  # each frequency of all curves before the next
        for curve, line in zip(found, lines, strict=True):
            x = curve.fine * sheet.per_rad_s
            z = complex(np.interp(rpm, x, line.real), np.interp(rpm, x, line.imag))
            if not x[0] <= rpm <= x[-1] or any(abs(z - other) <= apart * reach for other in placed):
                continue
            words = significant(abs(rpm), 4)
            corner = _clear_corner(axis, z, len(words), drawn, taken, points)
            if corner is None:
                continue
            (right, up), box = corner
            placed.append(z)
            taken.append(box)
            axis.plot(z.real, z.imag, "o", ms=3.6, mfc="white", mec=curve.condition.colour, mew=1.1, zorder=5)
            axis.annotate(
                words, (z.real, z.imag), (4 * right, 3 * up), textcoords="offset points",
                ha="left" if right > 0 else "right", va="bottom" if up > 0 else "top",
                fontsize=SMALL_TYPE, color=curve.condition.colour, path_effects=halo(), zorder=5,
            )  # fmt: skip


def _shown_points(axis: Any) -> Float:
    """Places of the readings in a panel, shape ``(n, 2)``."""
    return np.concatenate([np.asarray(drawn.get_offsets()) for drawn in axis.collections])


def _clear_corner(
    axis: Any, z: complex, letters: int, drawn: ComplexArray, taken: Sequence[Bbox], points: Float
) -> tuple[tuple[int, int], Bbox] | None:
    """Corner of a point in which its number hides least of the lines, and its room there; None where all are outside
    of the axes, or taken by other numbers or readings."""
    smaller = 0.85  # of the room of the axes, what labels of ticks and equal scales leave
    room = smaller * min(axis.bbox.width, axis.bbox.height) / axis.figure.dpi * 72  # points
    point = axis.viewLim.width / room  # of type, in units of the data
    width, height = (0.6 * SMALL_TYPE * letters + 4) * point, (SMALL_TYPE + 3) * point
    free = []
    for corner in ((1, 1), (-1, 1), (1, -1), (-1, -1)):
        x, y = z.real + corner[0] * width, z.imag + corner[1] * height
        box = Bbox([[min(x, z.real), min(y, z.imag)], [max(x, z.real), max(y, z.imag)]])
        if axis.viewLim.contains(x, y) and not box.count_overlaps(taken) and not box.count_contains(points):
            hidden = box.count_contains(np.column_stack([drawn.real, drawn.imag]))
            free.append((hidden, corner, box))
    return min(free, key=lambda one: one[0])[1:] if free else None


@on_sheet
def plot_residuals(fit: FitResult, *, sheet: Sheet) -> Figure:
    """Residuals over their noise against frequency, with lines at two standard deviations.

    A panel a response, or of more than nine responses a panel a probe, with those to all forces.
    """
    conditions, found = curves(fit, sheet)
    title = f"{rig_of(fit)}: residuals over noise, redchi {significant(fit.redchi, 3)}"
    by_probe = len({(c.coordinate, c.force_plane) for c in found}) > MOST_PANELS
    reads = (*_RESIDUALS, "Each panel holds one probe under all forces.") if by_probe else _RESIDUALS
    shown = [replace(c, force_plane=c.coordinate) for c in found] if by_probe else found
    figure, panels, bottom = panels_of(sheet, shown, title, rows=1, size=(5.2, 1.6), reads=reads)
    for curve in (replace(c, force_plane=c.coordinate) if by_probe else c for c in joined(found)):
        (axis,) = panels[curve.coordinate, curve.force_plane]
        x, look = curve.frequency * sheet.per_rad_s, {"color": curve.condition.colour, "alpha": 0.7}
        axis.plot(x, curve.whitened.real, curve.condition.marker, ms=2.4, mew=0, **look)
        axis.plot(x, curve.whitened.imag, "x", ms=2.4, mew=0.6, **look)
    largest = max(3.5, 1.05 * max(float(np.abs(c.whitened.view(float)).max(initial=0.0)) for c in found))
    for pair, (axis,) in panels.items():
        panel_title(axis, probe_title(fit.model, pair[0]) if by_probe else cell_title(fit.model, *pair))
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
    marks = dict(zip([c.name for c in conditions], cycle(MARKERS), strict=False))
    for curve in joined(found):
        x = np.tile(curve.frequency * sheet.per_rad_s, 2)
        look = {"marker": marks[curve.condition.name], "ls": "", "ms": 2.2, "alpha": 0.6, "mew": 0}
        both = np.concatenate([curve.whitened.real, curve.whitened.imag])
        axis.plot(x, both, color=curve.condition.colour, label=curve.condition.name, **look)
    misfit_panel(axis)
    axis.set_xlabel(frequency_label(sheet, found))
    return figure
