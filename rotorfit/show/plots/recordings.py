"""Figures of a recording, of the arrays of :mod:`rotorfit.lab.recordings.views`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from rotorfit.base.array_types import Float
from rotorfit.base.digits import significant
from rotorfit.lab.recordings.angle_track import Marks, SpeedTrack
from rotorfit.lab.recordings.reduction.reductions import swept_vectors
from rotorfit.lab.recordings.views import Cascade, Centreline, Clearance, OrderVectors, Stretch, vectors_over_time
from rotorfit.show.plots import style

if TYPE_CHECKING:
    from rotorfit.lab.recordings.recording import Recording

_SHAFT, _PERTURBATOR = "black", style.COLOURS[1]
_MARK_COLOURS = {"shaft": _SHAFT, "perturbator": _PERTURBATOR}
_TURNS = 8.0  # of a window: a resonance of 2 % damping is some turns long
_FILTERED = {"shaft": "1x", "perturbator": "w"}
_LABEL = {"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 0.5}
"""Ground of a label that spectra would run through."""


@style.on_sheet
def plot_timebase(stretches: Sequence[Stretch], name: str, *, sheet: style.Sheet) -> Figure:
    """x and y of each plane over time, with a dot at every pulse of a mark."""
    figure, axes = sheet.grid(len(stretches), 1, style.literal(f"{name}: time base"), size=(7.5, 2.4))
    handles: dict[str, Any] = {}
    for axis, part in zip(axes[:, 0], stretches, strict=True):
        traces = {"x": part.z.real, "y": part.z.imag} if np.iscomplexobj(part.z) else {"along the probe": part.z}
        for colour, (label, values) in zip((style.COLOURS[0], style.COLOURS[2]), traces.items(), strict=False):
            handles[label] = axis.plot(part.t, values * sheet.position_unit[0], color=colour, linewidth=0.9)[0]
            for mark, times in part.dots.items():
                at = np.interp(times, part.t, values * sheet.position_unit[0])
                look = {"color": _MARK_COLOURS[mark], "markersize": 4, "linestyle": ""}
                handles[f"mark of the {mark}"] = axis.plot(times, at, marker="o", **look)[0]
        axis.set_ylabel(style.literal(f"{part.plane}, {sheet.position_unit[1]}"))
        axis.margins(x=0.01)
    axes[-1, 0].set_xlabel("time, s")
    handles = dict(sorted(handles.items(), key=lambda entry: entry[0].startswith("mark")))
    style.legend_below(figure, handles)
    return figure


@style.on_sheet
def plot_orbit(stretches: Sequence[Stretch], name: str, *, sheet: style.Sheet) -> Figure:
    """Orbits as recorded and filtered to each mark, with Keyphasor dots; a row a plane."""
    marks = list(stretches[0].filtered)
    at = f"{stretches[0].t.mean():.2f} s"
    speeds = ", ".join(f"{mark} {sheet.rate_words(abs(v))}" for mark, v in stretches[0].speeds.items())
    title = style.literal(f"{name} at {at}: orbits" + (f" ({speeds})" if speeds else ""))
    figure, axes = sheet.grid(len(stretches), 1 + len(marks), title, size=(3.1, 2.9))
    handles: dict[str, Any] = {}
    for row, part in zip(axes, stretches, strict=True):
        _orbit(sheet, row[0], part, part.z * sheet.position_unit[0], part.dots, handles)
        if part.clearance is not None:
            handles |= _draw_clearance(sheet, row[0], part.clearance)
        row[0].set_title(style.literal(f"{part.plane}, {'without run-out' if part.cleaned else 'as recorded'}"))
        for axis, mark in zip(row[1:], marks, strict=True):
            _orbit(sheet, axis, part, part.filtered[mark] * sheet.position_unit[0], {mark: part.dots[mark]}, handles)
            axis.set_title(style.literal(f"{part.plane}, {_FILTERED[mark]} of the {mark}"))
    style.legend_below(figure, handles)
    return figure


def _orbit(
    sheet: style.Sheet, axis: Any, part: Stretch, z: NDArray[Any], dots: dict[str, Float], handles: dict[str, Any]
) -> None:
    axis.plot(z.real, z.imag, color=style.COLOURS[0], linewidth=0.8)
    for mark, times in dots.items():
        x, y = np.interp(times, part.t, z.real), np.interp(times, part.t, z.imag)
        handles[f"mark of the {mark}"] = axis.plot(x, y, "o", color=_MARK_COLOURS[mark], markersize=4)[0]
    middle = complex(np.mean(z)) if np.isfinite(z).all() else 0j
    reach = 1.1 * float(np.nanmax(np.abs(z - middle), initial=1e-3))
    _plane_of_motion(sheet, axis, middle, reach)
    for side in (axis.xaxis, axis.yaxis):
        style.few_ticks(side, 4)
    if not np.isfinite(z).any():
        text = "not distinguished from the other mark"
        axis.text(0.5, 0.5, text, transform=axis.transAxes, ha="center", fontsize=style.SMALL_TYPE, color=style.GREY)
        axis.set(xticks=[], yticks=[])


def _plane_of_motion(sheet: style.Sheet, axis: Any, middle: complex, reach: float) -> None:
    """Limits of x and y about a place, with their names."""
    axis.set(xlim=(middle.real - reach, middle.real + reach), ylim=(middle.imag - reach, middle.imag + reach))
    axis.set(xlabel=f"x, {sheet.position_unit[1]}", ylabel=f"y, {sheet.position_unit[1]}", aspect="equal")


def _draw_clearance(sheet: style.Sheet, axis: Any, clearance: Clearance) -> dict[str, Any]:
    """The circle that the shaft can move in, whole; returns its entry of a legend."""
    turn = clearance.centre + clearance.radius * np.exp(1j * np.linspace(0, 2 * np.pi, 181))
    z = turn * sheet.position_unit[0]
    ends = np.array([*axis.get_xlim()]) + 1j * np.array([*axis.get_ylim()])
    style.square_axis(axis, np.concatenate([ends, z]), 1.06)
    words = "clearance" if clearance.known else "clearance about the mean position (no centre_V)"
    return {words: axis.plot(z.real, z.imag, color=style.GREY, linewidth=1, linestyle="--", label=words, zorder=1)[0]}


@style.on_sheet
def plot_centreline(lines: Sequence[Centreline], name: str, *, sheet: style.Sheet) -> Figure:
    """Mean position of the shaft relative to the start of the recording, coloured by speed, else by time."""
    figure, axes = sheet.grid(
        1, len(lines), style.literal(f"{name}: shaft centreline from the gap voltages"), size=(4.0, 3.0)
    )
    handles: dict[str, Any] = {}
    for axis, line in zip(axes[0], lines, strict=True):
        z = line.z * sheet.position_unit[0]
        by_speed = np.isfinite(line.speed).all() and np.ptp(line.speed) > 0.02 * np.abs(line.speed).max()
        values, label = (
            (np.abs(line.speed) * sheet.per_rad_s, f"speed, {sheet.rate_unit}") if by_speed else (line.t, "time, s")
        )
        axis.plot(z.real, z.imag, color=style.GRID, linewidth=0.7, zorder=1)
        drawn = axis.scatter(z.real, z.imag, c=values, s=9, cmap=style.ramp(), zorder=2)
        look = {"color": style.COLOURS[1], "markersize": 6, "markerfacecolor": "none", "linestyle": ""}
        handles["start"] = axis.plot(z[0].real, z[0].imag, marker="s", **look)[0]
        scale = figure.colorbar(drawn, ax=axis, shrink=0.6)
        scale.set_label(label)
        scale.ax.tick_params(labelsize=7)
        middle = (z.real.min() + z.real.max() + 1j * (z.imag.min() + z.imag.max())) / 2
        reach = max(1.1 * float(np.abs(z - middle).max()), 1.0)  # less than a micrometre is not worth a figure of it
        _plane_of_motion(sheet, axis, middle, reach)
        if line.clearance is not None:
            handles |= _draw_clearance(sheet, axis, line.clearance)
        axis.set_title(style.literal(line.plane))
    style.legend_below(figure, handles)
    return figure


def vectors_shown(record: Recording, marks: Marks, reference: str, turns: float | None) -> OrderVectors:
    """Vectors of a sweep as a fit gets them; of others, or where their number of turns is given, those of windows."""
    swept = swept_vectors(record) if turns is None and reference == "perturbator" else None
    return swept or vectors_over_time(record, marks, reference, turns=_TURNS if turns is None else turns)


@style.on_sheet
def plot_bode(vectors: OrderVectors, name: str, *, sheet: style.Sheet) -> Figure:
    """Amplitude and phase of every probe's vector over the speed of its mark; a column a plane."""
    planes = list(dict.fromkeys(plane for plane, _ in vectors.probes))
    figure, axes = sheet.grid(2, len(planes), style.literal(f"{name}: {_what(vectors)}"), size=(4.4, 2.5))
    rpm, over = np.abs(vectors.speed) * sheet.per_rad_s, _axis_of(vectors)
    x = rpm if over == "speed" else vectors.t
    # Where windows cannot tell the mark's turns from the other mark's, there is no vector.
    good = np.flatnonzero(np.isfinite(vectors.phasors).all(axis=0))
    missing = good.size and not np.isfinite(vectors.phasors[:, good[0] : good[-1]]).all()
    for (top, bottom), plane in zip(axes.T, planes, strict=True):
        own = [(angle, row) for (at, angle), row in zip(vectors.probes, vectors.phasors, strict=True) if at == plane]
        for number, (angle, values) in enumerate(own):
            look: dict[str, Any] = {"color": style.COLOURS[number % len(style.COLOURS)], "linewidth": 1}
            top.plot(x, np.abs(values) * sheet.length[0], label=f"probe at {np.degrees(angle):g}°", **look)
            bottom.plot(x, _unwrapped(values, own[0][1]), **look)
        top.set_title(style.literal(plane))
        top.set_ylabel(f"amplitude, {sheet.amplitude_unit()}")
        top.set_ylim(bottom=0)
        top.legend(fontsize=8, title="gaps: at orders of the other mark" if missing else None, title_fontsize=7)
        bottom.set_ylabel(style.PHASE_LABEL)
        bottom.set_xlabel(f"speed of the {vectors.reference}, {sheet.rate_unit}" if over == "speed" else "time, s")
    return figure


def _what(vectors: OrderVectors) -> str:
    what = "1x vectors" if vectors.reference == "shaft" else "vectors at the perturbation frequency"
    return f"{what}, by tracking windows" if np.isfinite(vectors.t).all() else what


def _axis_of(vectors: OrderVectors) -> str:
    return "speed" if np.ptp(vectors.speed) > 0.05 * np.abs(vectors.speed).max() else "time"


def _unwrapped(values: NDArray[Any], first: NDArray[Any]) -> Float:
    """Phase in degrees without jumps, within half a turn of the plane's first probe; NaN where there is no vector."""

    def without_jumps(vector: NDArray[Any]) -> Float:
        phase = np.full(vector.size, np.nan)
        good = np.isfinite(vector)
        phase[good] = np.degrees(np.unwrap(np.angle(vector[good])))
        return phase

    phase = without_jumps(values)
    off = phase - without_jumps(first)
    turns = np.round(np.median(off[np.isfinite(off)]) / 360) if np.isfinite(off).any() else 0.0
    return np.asarray(phase - 360 * turns)


@style.on_sheet
def plot_polar(vectors: OrderVectors, name: str, *, sheet: style.Sheet) -> Figure:
    """Locus of every probe's vector, speeds written beside it; angles from the probe, with phase lead."""
    columns = min(len(vectors.probes), 2)
    rows = -(-len(vectors.probes) // columns)
    title = style.literal(f"{name}: {_what(vectors)}, {sheet.amplitude_unit()}")
    figure, axes = sheet.grid(rows, columns, title, size=(3.5, 3.5), projection="polar")
    for axis in axes.flat[len(vectors.probes) :]:
        axis.set_visible(False)
    for axis, (plane, angle), values in zip(axes.flat, vectors.probes, vectors.phasors, strict=False):
        factor, look = sheet.length[0], {"ms": 3, "ls": "", "marker": "o"}
        axis.plot(np.angle(values), np.abs(values) * factor, color=style.COLOURS[0], linewidth=1)  # a gap stays a gap
        for words, value in _round_speeds(sheet, vectors, values) if _axis_of(vectors) == "speed" else ():
            out, place = value / abs(value), (np.angle(value), abs(value) * factor)
            axis.plot(*place, color=style.COLOURS[1], **look)
            beside = {"ha": "left" if out.real > 0 else "right", "va": "bottom" if out.imag > 0 else "top"}
            offset = (4 * out.real, 4 * out.imag)
            axis.annotate(words, place, offset, textcoords="offset points", fontsize=7, color=style.GREY, **beside)
        axis.set_title(style.literal(f"{plane}, probe at {np.degrees(angle):g}°"))
        axis.tick_params(labelsize=7)
        axis.yaxis.set_major_locator(MaxNLocator(nbins=4, steps=[1, 2, 2.5, 5, 10]))
        axis.set_rlabel_position(_clear_direction(values))
        axis.grid(color=style.GRID, linewidth=0.6)
    return figure


def _round_speeds(sheet: style.Sheet, vectors: OrderVectors, values: NDArray[Any]) -> list[tuple[str, complex]]:
    """Round speeds, in words, and vectors there: far enough from each other on the locus to be read."""
    good = np.flatnonzero(np.isfinite(values))
    if good.size < 2:
        return []
    speed = np.abs(vectors.speed[good]) * sheet.per_rad_s
    order = np.argsort(speed)
    steps = MaxNLocator(nbins=30, steps=[1, 2, 2.5, 5, 10]).tick_values(speed.min(), speed.max())
    apart = 0.22 * float(np.abs(values[good]).max())
    chosen: list[tuple[str, complex]] = []
    for at in steps[(steps >= speed.min()) & (steps <= speed.max())].tolist():
        value = complex(np.interp(at, speed[order], values[good][order]))
        if abs(value) > apart and all(abs(value - other) > apart for _, other in chosen):
            chosen.append((significant(at, 5), value))
    return chosen


def _clear_direction(values: NDArray[Any]) -> float:
    """Direction in degrees that is farthest from the locus: there the numbers of the circles stand."""
    angles = np.degrees(np.angle(values[np.isfinite(values)]))
    candidates = np.arange(22.5, 360.0, 45.0)  # between the spokes
    apart = np.abs((candidates[:, None] - angles + 180.0) % 360.0 - 180.0).min(axis=1, initial=180.0)
    return float(candidates[np.argmax(apart)])


@style.on_sheet
def plot_full_spectrum(
    spectra: dict[str, tuple[Float, Float]],
    lines: dict[str, float],
    name: str,
    limit: float | None = None,
    marks: Mapping[str, float] = MappingProxyType({}),
    *,
    sheet: style.Sheet,
) -> Figure:
    """Full spectrum of each plane: a circle of radius A has amplitude A at its signed frequency.

    ``marks``: frequencies to mark, rad/s, by name, as those of modes (Fig. 29a).
    """
    figure, axes = sheet.grid(len(spectra), 1, style.literal(f"{name}: full spectrum"), size=(7.5, 2.4))
    edge = max(_worth_seeing(*each) for each in spectra.values()) if limit is None else limit
    for axis, (plane, (frequency, amplitude)) in zip(axes[:, 0], spectra.items(), strict=True):
        inside = np.abs(frequency) <= edge
        axis.plot(frequency[inside], amplitude[inside] * sheet.length[0], color=style.COLOURS[0], linewidth=0.8)
        top = float(amplitude[inside].max(initial=0.0)) * sheet.length[0]
        for label, at in lines.items():
            if abs(at) <= edge:
                axis.axvline(at, color=style.GREY, linewidth=0.6, linestyle=":")
                words = label.replace("-", "−")
                axis.text(at, top * 1.04, words, fontsize=7, color=style.GREY, ha="center", bbox=_LABEL)
        for label, at in marks.items():
            if abs(at) <= 2 * np.pi * edge:
                axis.axvline(at / (2 * np.pi), color=style.COLOURS[1], linewidth=0.8, linestyle="--")
                look = {"fontsize": 7, "color": style.COLOURS[1], "ha": "center", "bbox": _LABEL}
                axis.text(at / (2 * np.pi), top * 1.13, style.literal(label), **look)
        axis.set_xlim(-edge, edge)
        axis.set_ylim(0, top * (1.25 if marks else 1.15) or 1.0)
        axis.set_ylabel(style.literal(f"{plane}, {sheet.amplitude_unit()}"))
    axes[-1, 0].set_xlabel("frequency, Hz (backward < 0 < forward)")
    return figure


def _worth_seeing(frequency: Float, amplitude: Float) -> float:
    """Frequency that holds everything above a fiftieth of the largest line, with some room."""
    high = amplitude > 0.02 * amplitude.max(initial=0.0)
    return float(np.clip(1.25 * np.abs(frequency[high]).max(initial=1.0), 10.0, np.abs(frequency).max()))


@style.on_sheet
def plot_cascade(
    cascade: Cascade,
    name: str,
    limit: float | None = None,
    lines: Mapping[str, tuple[float, float]] = MappingProxyType({}),
    *,
    sheet: style.Sheet,
) -> Figure:
    """Full-spectrum cascade with order lines: one spectrum a line, shifted up by time, speed or perturbation.

    ``lines``: further lines to mark, factors of w and of the speed by name.
    """
    edge = _worth_seeing(cascade.frequency, cascade.amplitude.max(axis=0)) if limit is None else limit
    inside = np.abs(cascade.frequency) <= edge
    frequency, amplitude = cascade.frequency[inside], cascade.amplitude[:, inside] * sheet.length[0]
    scale, label = sheet.positions(cascade.over)
    position = cascade.position * scale
    spacing = np.ptp(position) / max(position.size - 1, 1) or 1.0
    height = 7 * spacing / float(amplitude.max(initial=1e-9))
    full = cascade.direction is None
    what = "full-spectrum cascade" if full else f"cascade of {cascade.direction}"
    figure, ((axis,),) = sheet.grid(1, 1, style.literal(f"{name}, {cascade.plane}: {what}"), size=(style.PAGE[0], 5.9))
    style.draw_cascade(axis, frequency, amplitude * height, position)
    _order_lines(axis, cascade, position, edge, lines)
    axis.set_xlim(-edge if full else 0, edge)
    axis.set_ylim(position.min() - spacing, position.max() + 10 * spacing)
    axis.set_xlabel("frequency, Hz (backward < 0 < forward)" if full else "frequency, Hz")
    axis.set_ylabel(label)
    axis.tick_params(labelsize=8)
    bar = float(f"{amplitude.max(initial=1e-9) / 2:.1g}")
    right = 0.96 * edge
    foot = position.max() + 5.5 * spacing  # above the labels of the lines
    axis.plot([right, right], [foot, foot + bar * height], color=style.INK, zorder=999)
    axis.text(right - 0.025 * edge, foot, f"{bar:g} {sheet.amplitude_unit()}", fontsize=8, ha="right", zorder=999)
    return figure


def _order_lines(
    axis: Any, cascade: Cascade, position: Float, edge: float, further: Mapping[str, tuple[float, float]]
) -> None:
    """Orders of the shaft, the perturbation and its image, where their frequencies are known."""
    shaft, perturbation = cascade.shaft / (2 * np.pi), cascade.perturbation / (2 * np.pi)
    lines = {"1x": shaft, "2x": 2 * shaft, "w": perturbation, "2x − w": 2 * shaft - perturbation}
    if cascade.direction is None:
        lines |= {"−1x": -shaft, "−2x": -2 * shaft, "−w": -perturbation}
    lines |= {style.literal(name): of_w * perturbation + of_speed * shaft for name, (of_w, of_speed) in further.items()}
    if cascade.direction is not None:
        lines = {name: np.abs(at) for name, at in lines.items()}
    for label, at in lines.items():
        draw_order_line(axis, label, np.where(np.abs(at) <= edge, at, np.nan), position, edge)


def draw_order_line(axis: Any, label: str, at: Float, position: Float, edge: float) -> None:
    """An order along spectra that stand at positions, NaN where it is not shown; its label stands at its end."""
    order = np.argsort(position)
    at, position = at[order], position[order]
    shown = np.flatnonzero(np.isfinite(at))
    if not shown.size:
        return
    colour = style.COLOURS[1] if "w" in label else style.GREY
    axis.plot(at, position, color=colour, linewidth=0.8, linestyle="--", zorder=998, alpha=0.7)
    at_edge = 0.93 * edge  # beyond it a label would reach out of the axes
    place = (float(np.clip(at[shown[-1]], -0.99 * edge, 0.99 * edge)), float(position[shown[-1]]))
    side = "right" if place[0] > at_edge else "left" if place[0] < -at_edge else "center"
    look = {"fontsize": 8, "color": colour, "ha": side, "zorder": 999, "bbox": _LABEL}
    axis.annotate(label, place, (0, 14 if "w" in label else 4), textcoords="offset points", **look)


@style.on_sheet
def plot_speed(tracks: Sequence[SpeedTrack], name: str, *, sheet: style.Sheet) -> Figure:
    """Speed and acceleration of each mark over time, with the speed from pulse to pulse as dots."""
    figure, axes = sheet.grid(2, len(tracks), style.literal(f"{name}: speed and sweep rate"), size=(5.0, 2.4))
    for column, each in enumerate(tracks):
        top, bottom = axes[:, column]
        colour = style.COLOURS[column % len(style.COLOURS)]
        look = {"color": style.AXES, "markersize": 2, "rasterized": True}
        top.plot(each.raw_t, each.raw_speed * sheet.per_rad_s, ".", label="from pulse to pulse", **look)
        top.plot(each.t, each.speed * sheet.per_rad_s, color=colour, linewidth=1, label="smoothed")
        top.set_title(each.mark)
        top.set_ylabel(f"speed, {sheet.rate_unit}")
        top.legend(fontsize=8)
        bottom.plot(each.t, each.acceleration * sheet.per_rad_s, color=colour, linewidth=1)
        bottom.set_ylabel(f"sweep rate, {sheet.rate_unit}/s")
        bottom.set_xlabel("time, s")
        steady = float(np.mean(each.speed)) * sheet.per_rad_s / 100  # a shaft this near to one speed keeps it
        for axis in (top, bottom):
            low, high = axis.get_ylim()
            room = max(steady - (high - low), 0.0) / 2
            axis.set_ylim(low - room, high + room)
    return figure
