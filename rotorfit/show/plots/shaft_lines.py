"""Spectral lines of a shaft that is not round against perturbation frequency or speed, and its stability."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from rotorfit.base.array_types import ComplexArray, Float, Index
from rotorfit.estimators.blocks.shaft_lines import LineResponses, PairResponses, is_image_line
from rotorfit.identify.fitting.anisotropy import searched_speed, unstable_speeds
from rotorfit.identify.fitting.result import FitResult
from rotorfit.lab.kinds.line_test import LineTest
from rotorfit.models import eigenvalues
from rotorfit.models.shafts.combination_lines import line_order
from rotorfit.show.plots import style
from rotorfit.show.plots.bode import broken_phase
from rotorfit.show.plots.journal import rig_of


@dataclass(frozen=True, eq=False, kw_only=True)
class _Curve:
    """One line of one signal at one speed per unit of force, frequencies ascending.

    Lines of a start-up have the rotative speed in place of the frequency, and no one speed (NaN).
    """

    title: str
    unit: str
    speed: float
    frequency: Float
    measured: ComplexArray
    sigma: Float
    fitted: ComplexArray
    fine: Float  # frequencies of the fitted line
    line_fitted: ComplexArray


@style.on_sheet
def plot_lines(fit: FitResult, *, sheet: style.Sheet) -> Figure:
    """Amplitude and phase of each line per unit of force against the signed perturbation frequency, data and fit.

    Lines 1x and 2x of start-ups are drawn as they are, against speed.
    """
    curves = list(_curves(fit))
    if not curves:
        raise ValueError("this fit has no spectral lines under a force or of a start-up to plot")
    kinds = list(dict.fromkeys(c.title for c in curves))
    speeds = sorted({c.speed for c in curves if not np.isnan(c.speed)})
    per_force = ", per unit of force" if speeds else ""
    figure, axes = sheet.grid(len(kinds), 2, f"{rig_of(fit)}: lines of the shaft{per_force}", size=(3.54, 1.9))
    for (size, phase), kind in zip(axes, kinds, strict=True):
        own = [c for c in curves if c.title == kind]
        factor, name = style.prefix(np.concatenate([np.abs(c.fitted) for c in own]), own[0].unit)
        for curve in own:
            colour = style.GREY if np.isnan(curve.speed) else style.colour_of(speeds.index(curve.speed), len(speeds))
            _draw(sheet, size, phase, curve, factor, colour)
        size.set_ylabel(f"{_written(kind)}\n{name}", fontsize=style.SMALL_TYPE)
        size.set_yscale("log")
        style.decade_ticks(size.yaxis)
        top = max(float(np.abs(c.fitted).max()) for c in own) * factor
        low = min(float(np.abs(c.fitted).min()) for c in own) * factor
        size.set_ylim(max(low / 3, top / 1e5), 3 * top)
        words = "phase lead, deg" if own[0].unit.startswith("rad") else "angle of x + jy, deg"
        phase.set_ylabel(words, fontsize=style.SMALL_TYPE)
        style.phase_axis(phase)
        if np.isnan(own[0].speed) or kind == [c.title for c in curves if not np.isnan(c.speed)][-1]:
            words = (_RUNNING if np.isnan(own[0].speed) else _PERTURBED).format(sheet.rate_unit)
            for axis in (size, phase):
                axis.set_xlabel(words, fontsize=style.SMALL_TYPE)
    point = {"marker": "o", "ms": 3, "ls": ""}
    entries: dict[str, Any] = {
        f"measured at {name}": {**look, **point}
        for name, look in style.in_colours([sheet.rate_words(v) for v in speeds]).items()
    }
    if any(np.isnan(c.speed) for c in curves):
        entries["measured, start-up"] = point
    style.legend_below(figure, entries | {"fit": {"color": style.INK, "lw": 0.9}})
    return figure


def _written(line: str) -> str:
    """The name of a line as formulas are written: 2Ω − w for 2Om-w."""
    return style.literal(re.sub(r"(?<=[\w)])-", " − ", line).replace("-", "−").replace("Om", "Ω"))


_PERTURBED, _RUNNING = "perturbation frequency w, {} (negative: backward)", "rotative speed, {}"


def _curves(fit: FitResult) -> Iterator[_Curve]:
    for block, predicted in zip(fit.problem.blocks, fit.problem.predict(fit.x), strict=True):
        if not isinstance(block, LineResponses | PairResponses):
            continue
        for title, rows in _kinds(fit, block):
            still = rows[block.force[rows] == 0]
            if isinstance(block, LineResponses) and np.unique(block.speed[still]).size >= LineTest.START_UP:
                yield _curve(fit, block, f"{title}\nstart-up", np.nan, still, predicted)
            rounded = np.round(block.speed[rows], 3)
            for speed in np.unique(rounded).tolist():
                here = rows[(rounded == speed) & (block.force[rows] != 0)]
                if here.size:
                    yield _curve(fit, block, title, speed, here, predicted)


def _curve(
    fit: FitResult, block: LineResponses | PairResponses, title: str, speed: float, rows: Index, predicted: ComplexArray
) -> _Curve:
    """Readings of a line against frequency, or without force against speed, per unit of what drives them; and the fit
    on a grid fine enough for sharp resonances."""
    x = block.speed if np.isnan(speed) else block.frequency
    rows = rows[np.argsort(x[rows])]
    drive = np.ones(rows.size) if np.isnan(speed) else np.abs(block.force[rows])
    fine = np.linspace(x[rows[0]], x[rows[-1]], style.CURVE_POINTS)
    first = int(rows[0])
    theta, direction, line = fit.thetas[int(block.reading_group[first])], str(block.direction[first]), block.line[first]
    if isinstance(block, PairResponses):
        base, turning = block.base, float(block.speed[first])
        place, force = base.coordinate[first], base.force[base.line[first]] / np.abs(block.force[first])
        pair = base.model.receptance(theta, fine - turning, turning)[:, place] @ force
        pair = pair * base.model.functions.factors(theta)[place]
        fitted = pair.conj() if is_image_line(block.line)[first] else pair
    elif np.isnan(speed):
        fitted = block.model.lines(theta, direction, line_order(direction, str(line)), 0.0, fine, 0.0)
    else:
        force = np.interp(fine, x[rows], drive) * np.exp(1j * np.angle(block.force[first]))
        order, turning = line_order(direction, str(line)), float(block.speed[first])
        fitted = block.model.lines(theta, direction, order, fine, turning, force) / np.abs(force)
    return _Curve(
        title=title,
        unit=("rad" if direction == "twist" else "m") + ("" if np.isnan(speed) else "/N"),
        speed=speed,
        frequency=x[rows],
        measured=block.measured[rows] / drive,
        sigma=block.sigma[rows] / drive,
        fitted=predicted[rows] / drive,
        fine=fine,
        line_fitted=np.asarray(fitted),
    )


def _kinds(fit: FitResult, block: LineResponses | PairResponses) -> Iterator[tuple[str, Index]]:
    """Title of each kind of line, with its readings."""
    if isinstance(block, LineResponses):
        for direction, _, rows in block.kinds:
            yield f"{'twist' if direction == 'twist' else 'motion'} at {block.line[rows[0]]}", rows
        return
    planes, n = fit.model.planes, len(fit.model.planes)
    forced = np.argmax(np.abs(block.base.force), axis=1)[block.base.line]
    for place, drive in np.unique(np.column_stack([block.base.coordinate, forced]), axis=0).tolist():
        rows = np.flatnonzero((block.base.coordinate == place) & (forced == drive))
        yield f"{planes[place % n]} at {block.line[rows[0]]}\nforce at {planes[drive]}", rows


def _points(axis: Any, x: Float, y: Float, curve: _Curve, colour: str) -> None:
    """Readings, paler where less certain; none whose error exceeds half of it."""
    shade = style.shades(colour, style.opacity_of(curve.sigma / np.abs(curve.fitted)))
    shown = shade[:, 3] > 0
    axis.scatter(x[shown], y[shown], s=6, c=shade[shown], linewidths=0, zorder=2.1)


def _draw(sheet: style.Sheet, size: Any, phase: Any, curve: _Curve, factor: float, colour: str) -> None:
    rpm = curve.frequency * sheet.per_rad_s
    _points(size, rpm, np.abs(curve.measured) * factor, curve, colour)
    fine = curve.fine * sheet.per_rad_s
    size.plot(fine, np.abs(curve.line_fitted) * factor, color=style.INK, lw=0.9, zorder=3)
    _points(phase, rpm, np.degrees(np.angle(curve.measured)), curve, colour)
    phase.plot(fine, broken_phase(curve.line_fitted), color=style.INK, lw=0.9, zorder=3)


def turning_stability(sheet: style.Sheet, fit: FitResult) -> Figure:
    """Growth rate and whirl frequency of a shaft that is not round against rotative speed, unstable bands shaded."""
    speeds, s, bands = _turning_modes(fit)
    figure, axes = sheet.grid(1, 2, f"{rig_of(fit)}: stability over speed", size=(3.54, 2.8))
    growth, whirl = axes[0]
    rpm = speeds * sheet.per_rad_s
    growth.plot(rpm, np.sort(s.real, axis=1), color=style.COLOURS[0], lw=1.3)
    growth.axhline(0, color=style.GREY, lw=0.8)
    growth.set_ylabel("growth rate, 1/s")
    ahead = np.concatenate([s.imag + speeds[:, None], speeds[:, None] - s.imag], axis=1)
    whirl.plot(rpm, np.sort(ahead, axis=1) * sheet.per_rad_s, ".", color=style.COLOURS[0], ms=1.2)
    whirl.plot(rpm, rpm, "--", color=style.AXES, lw=0.9)
    whirl.set_ylabel(f"frequencies of free motion, {sheet.rate_unit}")
    for axis in axes[0]:
        axis.set_xlabel(f"rotative speed, {sheet.rate_unit}")
        axis.set_xlim(0, rpm[-1])
        _mark_bands(sheet, axis, bands)
        style.tested_speeds(axis, [speed * sheet.per_rad_s for speed in _tested(fit)])
    ranges = ", ".join(f"{low * sheet.per_rad_s:.0f} to {sheet.rate_words(high)}" for low, high in bands)
    entries: dict[str, Any] = {
        "lateral modes and their images": {"color": style.COLOURS[0], "lw": 1.3},
        "1×: frequency = speed": {"color": style.AXES, "lw": 0.9, "ls": "--"},
        "tested speed": {"color": style.GREY, "lw": 0.9, "ls": (0, (2, 2))},
    }
    style.legend_below(
        figure, entries | ({f"unstable, {ranges}": Patch(color=style.CRITICAL, alpha=0.2)} if bands else {})
    )
    return figure


def _turning_modes(fit: FitResult) -> tuple[Float, ComplexArray, list[tuple[float, float]]]:
    """Speeds, finer about the ends of unstable bands; the eigenvalues there; and these bands."""
    model, theta = fit.model, fit.theta()
    if not model.turns:
        raise ValueError(f"{model.name} does not turn its stiffness")
    top = searched_speed(fit)
    bands = unstable_speeds(model, theta, top)
    edges = [speed for band in bands for speed in band]
    speeds = np.unique(np.concatenate([np.linspace(0.0, top, 600), *(v * np.linspace(0.99, 1.01, 41) for v in edges)]))
    return speeds, eigenvalues(model, np.broadcast_to(theta, (speeds.size, theta.size)), speeds), bands


def _tested(fit: FitResult) -> list[float]:
    """Tested speeds, rad/s, of a sweep its ends."""
    ends = [float(end) for e in fit.experiments for end in (np.min(e.speed), np.max(e.speed))]
    return fit.speeds.tolist() or [min(ends), max(ends)]


def _mark_bands(sheet: style.Sheet, axis: Any, bands: Iterable[tuple[float, float]]) -> None:
    for low, high in bands:
        axis.axvspan(low * sheet.per_rad_s, high * sheet.per_rad_s, color=style.CRITICAL, alpha=0.2, lw=0)


@style.on_sheet
def plot_growth(fit: FitResult, *, sheet: style.Sheet) -> Figure:
    """Growth rate of the least damped mode of a shaft that is not round: a half figure of a first screen."""
    speeds, s, bands = _turning_modes(fit)
    figure, ((axis,),) = sheet.grid(1, 1, "", size=style.HALF)
    axis.plot(speeds * sheet.per_rad_s, s.real.max(axis=1), color=style.COLOURS[0])
    axis.axhline(0, color=style.INK, lw=0.9)
    style.panel_title(axis, "Growth rate of the least damped mode, 1/s")
    axis.set(xlabel=f"shaft speed, {sheet.rate_unit}", xlim=(0, speeds[-1] * sheet.per_rad_s))
    _mark_bands(sheet, axis, bands)
    style.tested_speeds(axis, [speed * sheet.per_rad_s for speed in _tested(fit)])
    low, high = axis.get_ylim()
    axis.set_ylim(low, max(high, 0.1 * (high - low)))
    return figure


@style.on_sheet
def plot_line(fit: FitResult, *, sheet: style.Sheet) -> Figure:
    """The line that an uneven shaft adds, else the first, with its fit: a half figure of a first screen."""
    every = [curve for curve in _curves(fit) if not np.isnan(curve.speed)] or list(_curves(fit))
    kind = next((c.title for c in every if "2Om" in c.title), every[0].title)
    own = [curve for curve in every if curve.title == kind]
    factor, unit = style.prefix(np.concatenate([np.abs(c.fitted) for c in own]), own[0].unit)
    figure, ((axis,),) = sheet.grid(1, 1, "", size=style.HALF)
    style.panel_title(axis, f"{_written(kind[:1].upper() + kind[1:])}, {unit}")
    for number, curve in enumerate(own):
        colour = style.colour_of(number, len(own))
        _points(axis, curve.frequency * sheet.per_rad_s, np.abs(curve.measured) * factor, curve, colour)
        axis.plot(curve.fine * sheet.per_rad_s, np.abs(curve.line_fitted) * factor, color=style.INK, lw=1.2)
    axis.set_ylim(0, 1.18 * factor * max(float(np.abs(c.line_fitted).max()) for c in own))
    axis.set_xlabel((_RUNNING if np.isnan(own[0].speed) else "perturbation frequency w, {}").format(sheet.rate_unit))
    return figure


@style.on_sheet
def plot_line_misfit(fit: FitResult, *, sheet: style.Sheet) -> Figure:
    """Residuals of all lines over their noise: the half figure of a fit that is not good."""
    figure, ((axis,),) = sheet.grid(1, 1, "", size=style.HALF)
    for curve in _curves(fit):
        whitened = (curve.measured - curve.fitted) / curve.sigma
        for part, marker in ((whitened.real, "o"), (whitened.imag, "x")):
            axis.plot(curve.frequency * sheet.per_rad_s, part, marker, ms=2.4, color=style.COLOURS[0], alpha=0.6)
    style.misfit_panel(axis)
    axis.set_xlabel(f"frequency, {sheet.rate_unit}")
    return figure
