"""Bode plots of a fit, and the response of a forced plane with its dynamic stiffness."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MultipleLocator

from rotorfit.base.array_types import ComplexArray, Float
from rotorfit.base.digits import significant
from rotorfit.base.names import unknown_name
from rotorfit.identify.fitting.result import FitResult
from rotorfit.lab.data.experiments import PerturbationTest
from rotorfit.models import RotorModel
from rotorfit.show.plots import style
from rotorfit.show.plots.dynamic_stiffness import draw_drive_point
from rotorfit.show.plots.journal import rig_of
from rotorfit.show.plots.sweeps import (
    SweepCondition,
    SweepCurve,
    curves,
    forced_planes,
    joined,
    leading,
    measured_curves,
)


def panels_of(
    sheet: style.Sheet,
    found: Sequence[SweepCurve],
    title: str,
    *,
    rows: int,
    size: tuple[float, float],
    one_abscissa: bool = False,
    reads: Sequence[str] = (),
) -> tuple[Figure, dict[tuple[int, int], list[Any]], list[Any]]:
    """A figure with a panel for each probe (down) and force (across), packed where not all of them were measured, and
    side by side where a page is too short for all probes of one force.

    Returns:
        the figure, the axes of each pair, one row of axes or more, and the axes at the bottom.
    """
    pairs = sorted({(c.coordinate, c.force_plane) for c in found})
    probes, forces = sorted({p for p, _ in pairs}), sorted({f for _, f in pairs})
    shortest = 0.6 * rows * size[1]  # of a pair, inches
    columns = next((n for n in (1, 2) if -(-len(pairs) // n) * shortest <= style.PAGE[1]), 3)
    if len(pairs) == len(probes) * len(forces) and (len(forces) > 1 or columns == 1):
        place = {(p, f): (probes.index(p), forces.index(f)) for p, f in pairs}
    else:
        place = {pair: divmod(i, max(columns, 2)) for i, pair in enumerate(pairs)}
    down, across = (max(where[k] for where in place.values()) + 1 for k in (0, 1))
    pages = max(1.0, across / 3)  # of more than three forces a page would hold no readable panel
    figure, axes = sheet.grid(
        rows * down, across, title, size=size, one_abscissa=one_abscissa, reads=reads, pages=pages
    )
    for row, column in {(r, c) for r in range(down) for c in range(across)} - set(place.values()):
        for axis in axes[rows * row : rows * (row + 1), column]:
            axis.remove()
    shown = {pair: list(axes[rows * r : rows * (r + 1), c]) for pair, (r, c) in place.items()}
    lowest = {c: max(r for r, other in place.values() if other == c) for _, c in place.values()}
    bottom = [axes[rows * (r + 1) - 1, c] for c, r in lowest.items()]
    for axis in bottom:
        axis.tick_params(labelbottom=True)
    if across > 2:
        for axis in (axis for pair in shown.values() for axis in pair):
            style.few_ticks(axis.xaxis, 3)
    return figure, shown, bottom


def response_unit(
    sheet: style.Sheet, model: RotorModel, coordinate: int, found: Sequence[SweepCurve]
) -> tuple[float, str]:
    """Factor to and name of the unit in which a response to a force, or a force over an imposed orbit, is shown."""
    if all(c.imposed for c in found):
        return 1 / sheet.length[0], f"N/{sheet.length[1]}"
    factor, unit = (1e6, "µrad") if model.coordinates[coordinate].axis == "r" else sheet.length
    return factor, f"{unit}/N"


def cell_title(model: RotorModel, coordinate: int, force_plane: int) -> str:
    """Title of the panel of a probe and a force, for matplotlib."""
    return style.literal(panel_name(model, coordinate, force_plane))


def panel_name(model: RotorModel, coordinate: int, force_plane: int) -> str:
    """Words for a probe and a force."""
    return f"{_probe_name(model, coordinate)}, {forced_planes(model, force_plane)}"


def probe_title(model: RotorModel, coordinate: int) -> str:
    """Title of the panel of a probe, for matplotlib."""
    return style.literal(_probe_name(model, coordinate))


def _probe_name(model: RotorModel, coordinate: int) -> str:
    probe = model.coordinates[coordinate]
    reading = {"r": "tilt at ", "x": "x at ", "y": "y at "}.get(probe.axis, "")
    return f"{reading}{probe.plane}"


_RUNS_ON = (
    "Angle: motion ahead of the force, counted in the direction of rotation; it runs on through zero frequency.",
    "Points: measured, paler where σ exceeds 12 % of the response, not drawn above 50 %. All panels share one scale.",
)
_LEADS = (
    "Phase: lead of the probe over a force along it, forward and backward alike.",
    "Points: measured, paler where σ exceeds 12 % of the response, not drawn above 50 %. All panels share one scale.",
)

AGAINST = ("frequency", "ratio", "size")
"""Axes of responses: signed frequency, its ratio to the rotative speed, or its size."""


@dataclass(frozen=True, kw_only=True)
class _Axis:
    """Axis of responses, and the unbalance for which amplitudes are drawn."""

    sheet: style.Sheet
    found: Sequence[SweepCurve]  # all that the figure shows
    against: str
    mr: float | None

    def x(self, curve: SweepCurve, frequency: Float) -> Float:
        """Places of frequencies, rad/s, along the axis."""
        if self.against == "ratio":
            return frequency / curve.condition.speed
        return (np.abs(frequency) if self.against == "size" else frequency) * self.sheet.per_rad_s

    def scale(self, frequency: Float) -> Float | float:
        """Factor from responses to a unit force to those to the unbalance."""
        return 1.0 if self.mr is None else self.mr * frequency**2

    @property
    def runs_on(self) -> bool:
        """True if the phase is that of x + jy, counted in the direction of rotation, through zero frequency."""
        both = any(c.frequency.min() < 0 for c in self.found) and any(c.frequency.max() > 0 for c in self.found)
        return self.against != "size" and both and all(c.signed for c in self.found)

    def label(self) -> str:
        """Words below the axis."""
        if self.against == "ratio":
            return "frequency over rotative speed (backward < 0 < forward)"
        return (
            f"frequency, {self.sheet.rate_unit}" if self.against == "size" else frequency_label(self.sheet, self.found)
        )

    def style(self, curve: SweepCurve) -> tuple[str, str]:
        """Style of the line, and face of points: of backward responses on an axis of sizes dashed and open."""
        backward = self.against == "size" and bool(np.nanmax(curve.frequency) < 0)
        return ("--", "none") if backward else ("-", curve.condition.colour)


def _axis_of(sheet: style.Sheet, found: Sequence[SweepCurve], against: str, mr: float | None) -> _Axis:
    if against not in AGAINST:
        raise ValueError(unknown_name("abscissa", against, AGAINST))
    if against == "ratio" and any(np.isnan(c.condition.speed) for c in found):
        raise ValueError("against='ratio' needs a constant rotative speed; of start-ups frequency is the speed")
    if mr is not None and not (np.isfinite(mr) and mr > 0):
        raise ValueError(f"mr is {mr!r}; an unbalance is above zero, kg m")
    return _Axis(sheet=sheet, found=found, against=against, mr=mr)


@style.on_sheet
def plot_bode(
    fit: FitResult,
    *,
    sheet: style.Sheet,
    against: str = "frequency",
    mr: float | None = None,
    beside: FitResult | None = None,
    every: bool = False,
) -> Figure:
    """Amplitude and phase of responses per unit force against signed perturbation frequency.

    Rows are probes (amplitude, then phase), columns force planes; colours are rotative speeds and, of nonlinear fluids,
    levels of the force. Points are measured; lines are fitted, with their 95 % bands. The phase is that by which the
    probe leads a force along it, forward and backward alike, as an analyser shows it.

    ``against``: ``ratio`` draws over frequency over rotative speed (Fig. 9), ``size`` forward and backward over one
    another, these dashed and open (Fig. 8). ``mr``, kg m: amplitudes under that unbalance. ``beside``: drawn dotted.
    ``every``: all responses of more than three planes.
    """
    conditions, whole = curves(fit, sheet)
    found, left_out = leading(fit.model, whole, every=every)
    along = _axis_of(sheet, found, against, mr)
    others = [] if beside is None else leading(fit.model, curves(beside, sheet)[1], every=every)[0]
    title = f"{rig_of(fit)}: responses{_weight(mr)} and the fit"
    figure = _bode(fit.model, found, along, title, others, left_out)
    marks = direction_marks(found, ".", " (fit dashed)") if against == "size" else None
    told = "" if beside is None else style.literal(beside.message)
    condition_legend(figure, conditions, "fit and 95 % band", marks, told)
    return figure


@style.on_sheet
def plot_measured_bode(
    test: PerturbationTest, *, sheet: style.Sheet, against: str = "frequency", mr: float | None = None
) -> Figure:
    """The same of a test before a fit; lines lead from reading to reading."""
    model, conditions, found = measured_curves(test, sheet)
    figure = _bode(model, found, _axis_of(sheet, found, against, mr), f"Measured responses{_weight(mr)}")
    condition_legend(figure, conditions, "", direction_marks(found, ".", " (dashed)") if against == "size" else None)
    return figure


def _bode(
    model: RotorModel,
    found: Sequence[SweepCurve],
    along: _Axis,
    title: str,
    others: Sequence[SweepCurve] = (),
    left_out: Sequence[str] = (),
) -> Figure:
    """Curves in their panels, without a legend; of others their lines alone."""
    reads = (*(_RUNS_ON if along.runs_on else _LEADS), *left_out)
    low = 1.33 if len({(c.coordinate, c.force_plane) for c in found}) > 1 else 1.8  # inches of a panel
    figure, panels, bottom = panels_of(
        along.sheet, found, title, rows=2, size=(5.2, low), one_abscissa=True, reads=reads
    )
    for curve in found if along.against == "size" else joined(found):
        draw_bode(model, panels[curve.coordinate, curve.force_plane], curve, along)
    for curve in joined(others):
        amplitude, phase = panels[curve.coordinate, curve.force_plane]
        factor, _ = _bode_unit(model, curve.coordinate, along)
        fine, look = along.x(curve, curve.fine), {"ls": ":", "lw": 1.3, "color": curve.condition.colour}
        amplitude.plot(fine, factor * along.scale(curve.fine) * np.abs(curve.fitted), **look)
        angle = _unwrapped(curve)[0] if along.runs_on else broken_phase(curve.line_seen)
        phase.plot(fine, angle, **look)
    for (probe, force), pair in panels.items():
        own = [c for c in found if (c.coordinate, c.force_plane) == (probe, force)]
        finish_bode(model, pair, own, along)
        style.panel_title(pair[0], cell_title(model, probe, force))
    _share_scales(panels)
    for axis in bottom:
        axis.set_xlabel(short_label(along.label(), bottom))
    return figure


def short_label(words: str, bottom: Sequence[Any]) -> str:
    """A label of an axis, without what stands in brackets where panels are narrow."""
    wide = 2  # panels side by side up to which there is room for all
    return words if len(bottom) <= wide else words.partition(" (")[0]


def _share_scales(panels: Mapping[tuple[int, int], Sequence[Any]]) -> None:
    """One scale of amplitudes of one unit, and one of angles, so that panels compare at sight."""
    for row in (0, 1):
        by_unit: dict[str, list[Any]] = {}
        for pair in panels.values():
            by_unit.setdefault(pair[row].get_ylabel(), []).append(pair[row])
        for axes in by_unit.values():
            ends = np.array([axis.get_ylim() for axis in axes])
            low, high = float(ends[:, 0].min()), float(ends[:, 1].max())
            for axis in axes:
                axis.set_ylim(low, high)
                if isinstance(axis.yaxis.get_major_locator(), MultipleLocator):
                    _angle_ticks(axis)


def _angle_ticks(axis: Any) -> None:
    """Ticks at angles that run on: quarters of a turn, halves, or, of many modes, more."""
    low, high = axis.get_ylim()
    quarters = 400  # degrees up to which there is room for them
    step = 90 if high - low < quarters else 180 * max(math.ceil((high - low) / 900), 1)
    axis.yaxis.set_major_locator(MultipleLocator(step))


def _weight(mr: float | None) -> str:
    """The unbalance that amplitudes are drawn for, in words of a title."""
    return "" if mr is None else f" for {significant(mr * 1e6, 4)} g mm"


def direction_marks(found: Sequence[SweepCurve], marker: str, more: str = "") -> dict[str, tuple[str, str]]:
    """Entries of the legend for forward and backward points that are drawn over one another."""
    both = len({bool(c.frequency[-1] > 0) for c in found}) > 1
    filled = {"measured, forward" if both else "measured": (marker, style.GREY)}
    return filled | ({f"measured, backward{more}": (marker, "none")} if both else {})


def draw_bode(model: RotorModel, pair: Sequence[Any], curve: SweepCurve, along: _Axis) -> None:
    """One response in its panels of amplitude and phase: points paler where less certain, none above half."""
    amplitude, phase = pair
    colour, x, fine = curve.condition.colour, along.x(curve, curve.frequency), along.x(curve, curve.fine)
    factor, _ = _bode_unit(model, curve.coordinate, along)
    look, face = along.style(curve)
    line, (relative, turn) = factor * along.scale(curve.fine) * np.abs(curve.fitted), curve.band
    measured, angle, fitted_angle = np.abs(curve.measured), degrees(curve.seen), broken_phase(curve.line_seen)
    if along.runs_on:
        fitted_angle, expected = _unwrapped(curve)
        angle = _beside(degrees(curve.measured), expected)
    shade = style.shades(colour, style.opacity_of(curve.uncertainty))
    shown = np.isfinite(shade[:, 3]) & (shade[:, 3] > 0)
    edge: dict[str, Any] = {"facecolors": "none", "edgecolors": shade[shown]} if face == "none" else {"c": shade[shown]}
    points = {
        "s": 6,
        "marker": curve.condition.marker,
        "linewidths": 0.6 if face == "none" else 0,
        "zorder": 2.1,
    } | edge
    amplitude.scatter(x[shown], (factor * along.scale(curve.frequency) * measured)[shown], **points)
    amplitude.plot(fine, line, look, lw=1.3, color=colour)
    reach = np.exp(np.minimum(relative, 20.0))
    amplitude.fill_between(fine, line / reach, line * reach, color=colour, alpha=style.BAND, lw=0)
    phase.scatter(x[shown], angle[shown], **points)
    half_turn = 180.0  # a phase that may be any fills the turn, not an axis of a million turns
    half = np.minimum(np.rad2deg(turn), half_turn)
    style.draw_curve(phase, fine, fitted_angle, half, colour, look, lw=1.3)


def _unwrapped(curve: SweepCurve) -> tuple[Float, Float]:
    """Angle of the fitted line in degrees, which runs on from backward to forward, along it and at the readings."""
    known = np.flatnonzero(np.isfinite(curve.fitted) & np.isfinite(curve.fine))
    order = known[np.argsort(curve.fine[known], kind="stable")]
    angle, along = np.full(curve.fitted.size, np.nan), np.rad2deg(np.unwrap(np.angle(curve.fitted[order])))
    slowest = along[np.argmin(np.abs(curve.fine[order]))]  # a rotor follows a slow force
    angle[order] = along - 360 * np.round(slowest / 360)
    return angle, np.asarray(np.interp(curve.frequency, curve.fine[order], angle[order]))


def _beside(angle: Float, line: Float) -> Float:
    """Angles on the turn that is next to a line."""
    return np.asarray(angle - 360 * np.round((angle - line) / 360))


def finish_bode(model: RotorModel, pair: Sequence[Any], found: Sequence[SweepCurve], along: _Axis) -> None:
    """Scales, limits and names of the panels of amplitude and phase."""
    amplitude, phase = pair
    factor, unit = _bode_unit(model, found[0].coordinate, along)
    amplitude.set_yscale("log")
    style.decade_ticks(amplitude.yaxis)
    shown = [(along.scale(c.fine) * np.abs(c.fitted),) for c in found]
    # Limits around lines: points of low frequencies, and bands of what is not determined, would leave nothing else.
    sizes = factor * np.concatenate([part for both in shown for part in both])
    sizes = sizes[np.isfinite(sizes) & (sizes > 0)]
    if sizes.size:
        amplitude.set_ylim(float(sizes.min()) / 1.4, 1.4 * float(sizes.max()))
    imposed = unit.startswith("N/")
    roomy = 4  # rows of panels up to which whole words fit beside one
    place = amplitude.get_subplotspec()
    if place is not None and place.get_gridspec().nrows > roomy:
        amplitude.set_ylabel(unit, fontsize=style.SMALL_TYPE)
        phase.set_ylabel("phase, deg", fontsize=style.SMALL_TYPE)
    else:
        amplitude.set_ylabel(unit if imposed else f"amplitude, {unit}")
        phase.set_ylabel("phase of the force, deg" if imposed else "phase, deg")
    if along.runs_on:
        phase.set_ylabel("angle, deg")
        _angle_ticks(phase)
    else:
        style.phase_axis(phase)


def _bode_unit(model: RotorModel, coordinate: int, along: _Axis) -> tuple[float, str]:
    """Factor to and name of the unit of amplitudes, per force or under an unbalance."""
    factor, unit = response_unit(along.sheet, model, coordinate, along.found)
    if along.mr is None:
        return factor, unit
    if unit.startswith("N/"):
        raise ValueError("mr is for responses to a force; these orbits were imposed")
    return factor, along.sheet.amplitude_unit(unit.removesuffix("/N"))


@style.on_sheet
def plot_drive_point(
    fit: FitResult, *, sheet: style.Sheet, plane: str | None = None, mr: float | None = None
) -> Figure:
    """Phase, amplitude and dynamic stiffness of a forced plane above one another, a colour a condition (Fig. 11).

    Conditions are speeds, or values of the attribute by which parameters were fitted: a pressure, a temperature.
    ``plane``: a forced one, the last unless given. ``mr``, kg m: amplitudes under that unbalance.
    """
    conditions, every = curves(fit, sheet)
    own = [c for c in every if c.coordinate == c.force_plane]
    names = [fit.model.coordinates[c.coordinate].plane for c in own]
    if not own or (plane is not None and plane not in names):
        raise ValueError(unknown_name("plane that was forced and read", str(plane), sorted(set(names))))
    chosen = plane if plane is not None else names[-1]
    found = [c for c, name in zip(own, names, strict=True) if name == chosen]
    along = _axis_of(sheet, found, "frequency", mr)
    title = f"{rig_of(fit)}: drive point at {style.literal(chosen)}{_weight(mr)}"
    figure, axes = sheet.grid(4, 1, title, size=(6.2, 1.9), one_abscissa=True)
    phase, amplitude, direct, quadrature = axes[:, 0]
    for curve in joined(found):
        draw_bode(fit.model, (amplitude, phase), curve, along)
    finish_bode(fit.model, (amplitude, phase), found, along)
    draw_drive_point(sheet, fit, (direct, quadrature), found[0].coordinate)
    quadrature.set_xlabel(along.label())
    condition_legend(figure, conditions, "fit and 95 % band")
    return figure


def frequency_label(sheet: style.Sheet, found: Sequence[SweepCurve]) -> str:
    """Words below an axis of signed frequency."""
    both = any(c.frequency.min() < 0 for c in found) and any(c.frequency.max() > 0 for c in found)
    return f"frequency, {sheet.rate_unit} (backward < 0 < forward)" if both else f"frequency, {sheet.rate_unit}"


def degrees(values: ComplexArray) -> Float:
    """Phase in degrees."""
    return np.asarray(np.rad2deg(np.angle(values)))


def broken_phase(values: ComplexArray) -> Float:
    """Phase in degrees, broken where it jumps over the cut so that no line crosses the plot."""
    phase = degrees(values)
    return np.where(np.abs(np.diff(phase, prepend=phase[:1])) > 180, np.nan, phase)


def condition_legend(
    figure: Figure,
    conditions: Sequence[SweepCondition],
    line: str,
    marks: Mapping[str, tuple[str, str]] | None = None,
    dotted: str = "",
) -> None:
    """Legend: conditions, then points and line, then further marks, by their words marker and face."""
    few = len(conditions) <= len(style.COLOURS) and marks is None
    if few and style.key_beside_title(figure, [(c.name, c.colour, c.marker) for c in conditions]):
        if dotted:
            style.legend_below(figure, {dotted: {"lw": 1.3, "ls": ":"}})
        return
    entries: dict[str, Any] = {c.name: {"color": c.colour, "lw": 2} for c in conditions}
    for words, (marker, face) in (marks or {"measured": (".", style.GREY)}).items():
        entries[words] = {"ls": "", "marker": marker, "mfc": face, "ms": 4}
    entries |= {line: {"lw": 1.2}} if line else {}
    style.legend_below(figure, entries | ({dotted: {"lw": 1.3, "ls": ":"}} if dotted else {}))
