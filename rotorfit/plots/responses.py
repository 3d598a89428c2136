"""Figures of a fit: dynamic stiffness, Bode, polar, residuals; those of nonlinear fluids have modules of their own."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from rotorfit.estimators.blocks.nonlinear import responses_of
from rotorfit.models.array_types import ComplexArray, Float
from rotorfit.plots.dynamic_stiffness import draw_dynamic_stiffness
from rotorfit.plots.eccentricity import plot_law, plot_nonlinear_stiffness
from rotorfit.plots.stability import plot_stability
from rotorfit.plots.static_and_impulse import plot_static_locus, plot_static_stiffness, plot_velocity_ratio
from rotorfit.plots.style import GREY, PHASE_LABEL, SMALL_TYPE, decade_ticks, grid, legend_below, literal
from rotorfit.plots.sweeps import SweepCondition, SweepCurve, curves, forced_planes, joined
from rotorfit.plots.uncertainty import plot_corner, plot_traces
from rotorfit.units import RPM_PER_RAD_S

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from rotorfit.fitting.result import FitResult

__all__ = [
    "plot_bode",
    "plot_corner",
    "plot_dynamic_stiffness",
    "plot_law",
    "plot_nonlinear_stiffness",
    "plot_polar",
    "plot_residuals",
    "plot_stability",
    "plot_static_locus",
    "plot_static_stiffness",
    "plot_traces",
    "plot_velocity_ratio",
]


@dataclass(frozen=True, eq=False)
class _Panels:
    """Axes of each measured pair of probe and force, one row of axes or more a pair; no pair's panel is empty."""

    axes: Mapping[tuple[int, int], Sequence[Any]]
    bottom: Sequence[Any]


def _panels(
    found: Sequence[SweepCurve], title: str, *, rows: int, size: tuple[float, float], one_abscissa: bool = False
) -> tuple[Figure, _Panels]:
    """A figure with a panel for each probe (down) and force (across), packed where not all of them were measured."""
    pairs = sorted({(c.coordinate, c.force_plane) for c in found})
    probes, forces = sorted({p for p, _ in pairs}), sorted({f for _, f in pairs})
    if len(pairs) == len(probes) * len(forces):
        place = {(p, f): (probes.index(p), forces.index(f)) for p, f in pairs}
    else:
        place = {pair: divmod(i, 2) for i, pair in enumerate(pairs)}
    down, across = (max(where[k] for where in place.values()) + 1 for k in (0, 1))
    figure, axes = grid(rows * down, across, title, size=size, one_abscissa=one_abscissa)
    for row, column in {(r, c) for r in range(down) for c in range(across)} - set(place.values()):
        for axis in axes[rows * row : rows * (row + 1), column]:
            axis.remove()
    shown = {pair: list(axes[rows * r : rows * (r + 1), c]) for pair, (r, c) in place.items()}
    lowest = {c: max(r for r, other in place.values() if other == c) for _, c in place.values()}
    bottom = [axes[rows * (r + 1) - 1, c] for c, r in lowest.items()]
    for axis in bottom:
        axis.tick_params(labelbottom=True)
    return figure, _Panels(shown, bottom)


def _response_unit(fit: FitResult, coordinate: int) -> tuple[float, str]:
    """Factor to and name of the unit in which a response to a force is shown."""
    if all(base.imposed for base in map(responses_of, fit.problem.blocks) if base is not None and base.frequency.any()):
        return 1e-6, "N/µm"
    return 1e6, "µrad/N" if fit.model.coordinates[coordinate].axis == "r" else "µm/N"


def _cell_title(fit: FitResult, coordinate: int, force_plane: int) -> str:
    probe = fit.model.coordinates[coordinate]
    reading = {"r": "tilt at ", "x": "x at ", "y": "y at "}.get(probe.axis, "")
    return literal(f"{reading}{probe.plane}, {forced_planes(fit.model, force_plane)}")


def plot_bode(fit: FitResult) -> Figure:
    """Amplitude and phase of every response per unit force against signed perturbation frequency.

    Rows are probes (amplitude, then phase), columns force planes; colours are rotative speeds and, of nonlinear fluids,
    levels of the force. Points are measured; lines are fitted, with their 95 % bands. The phase is that by which the
    probe leads a force along it, forward and backward alike, as an analyser shows it.
    """
    conditions, found = curves(fit)
    title = f"Bode plot, {fit.model.name}"
    figure, panels = _panels(found, title, rows=2, size=(5.2, 1.9), one_abscissa=True)
    for curve in joined(found):
        amplitude, phase = panels.axes[curve.coordinate, curve.force_plane]
        colour, x, fine = curve.condition.colour, curve.frequency * RPM_PER_RAD_S, curve.fine * RPM_PER_RAD_S
        factor, _ = _response_unit(fit, curve.coordinate)
        line, (relative, turn) = factor * np.abs(curve.fitted), curve.band
        amplitude.plot(x, factor * np.abs(curve.measured), ".", ms=2.5, color=colour, alpha=0.6)
        amplitude.plot(fine, line, "-", lw=1.1, color=colour)
        reach = np.exp(np.minimum(relative, 20.0))
        amplitude.fill_between(fine, line / reach, line * reach, color=colour, alpha=0.25, lw=0)
        phase.plot(x, _degrees(curve.seen), ".", ms=2.5, color=colour, alpha=0.6)
        angle, half = _unwrapped(curve.line_seen), np.rad2deg(turn)
        phase.plot(fine, angle, "-", lw=1.1, color=colour)
        phase.fill_between(fine, angle - half, angle + half, color=colour, alpha=0.25, lw=0)
    for (probe, force), (amplitude, phase) in panels.axes.items():
        amplitude.set_yscale("log")
        decade_ticks(amplitude.yaxis)
        _amplitude_limits(amplitude, [c for c in found if (c.coordinate, c.force_plane) == (probe, force)], fit)
        amplitude.set_title(_cell_title(fit, probe, force), fontsize=8)
        amplitude.set_ylabel(_response_unit(fit, probe)[1], fontsize=8)
        imposed = _response_unit(fit, probe)[1] == "N/µm"
        phase.set_ylabel("phase lead of the force, deg" if imposed else PHASE_LABEL, fontsize=8)
        phase.set_yticks([-180, -90, 0, 90, 180])
        phase.set_ylim(-190, 190)
    for axis in panels.bottom:
        axis.set_xlabel(_frequency_label(found), fontsize=8)
    _condition_legend(figure, conditions, "fit and 95 % band")
    return figure


def _amplitude_limits(axis: Any, found: Sequence[SweepCurve], fit: FitResult) -> None:
    """Limits around points and lines: bands of what is not determined would leave nothing else to be seen."""
    factor, _ = _response_unit(fit, found[0].coordinate)
    sizes = np.concatenate([np.abs(np.r_[c.measured, c.fitted]) for c in found])
    sizes = factor * sizes[np.isfinite(sizes) & (sizes > 0)]
    if sizes.size:
        axis.set_ylim(float(sizes.min()) / 1.5, 1.5 * float(sizes.max()))


def _frequency_label(found: Sequence[SweepCurve]) -> str:
    both = any(c.frequency.min() < 0 for c in found) and any(c.frequency.max() > 0 for c in found)
    return "frequency, rpm (backward < 0 < forward)" if both else "frequency, rpm"


def _degrees(values: ComplexArray) -> Float:
    return np.asarray(np.rad2deg(np.angle(values)))


def _unwrapped(values: ComplexArray) -> Float:
    """Phase in degrees, broken where it jumps over the cut so that no line crosses the plot."""
    phase = _degrees(values)
    return np.where(np.abs(np.diff(phase, prepend=phase[:1])) > 180, np.nan, phase)


def _condition_legend(
    figure: Figure, conditions: Sequence[SweepCondition], line: str, marks: Sequence[tuple[str, str, str]] = ()
) -> None:
    """Legend: conditions, then points and line, then further marks (marker, face, words)."""
    from matplotlib.lines import Line2D

    handles: list[Any] = [Line2D([], [], color=c.colour, lw=2) for c in conditions]
    points = marks or ((".", GREY, "measured"),)
    handles += [Line2D([], [], color=GREY, ls="", marker=m, mfc=face, ms=4) for m, face, _ in points]
    labels = [*(c.name for c in conditions), *(words for *_, words in points)]
    if line:
        handles.append(Line2D([], [], color=GREY, lw=1.2))
        labels.append(line)
    legend_below(figure, handles, labels)


def plot_polar(fit: FitResult) -> Figure:
    """Responses per unit force in the complex plane; filled points forward, open points backward.

    Angles are phase leads of the probe, forward and backward alike. Crosses along the fitted lines are at round
    frequencies, in rpm, signed.
    """
    conditions, found = curves(fit)
    figure, panels = _panels(found, f"Polar plot, {fit.model.name}", rows=1, size=(4.4, 3.9))
    for curve in found:
        (axis,) = panels.axes[curve.coordinate, curve.force_plane]
        colour = curve.condition.colour
        factor, _ = _response_unit(fit, curve.coordinate)
        face = colour if curve.frequency[-1] > 0 else "none"
        z, fitted = factor * curve.seen, factor * curve.line_seen
        axis.plot(z.real, z.imag, "o", ms=3, mfc=face, mec=colour, mew=0.6, alpha=0.5)
        axis.plot(fitted.real, fitted.imag, "-", lw=1.1, color=colour)
    for pair, (axis,) in panels.axes.items():
        mine = [c for c in found if (c.coordinate, c.force_plane) == pair]
        factor, unit = _response_unit(fit, pair[0])
        axis.set_title(_cell_title(fit, *pair), fontsize=8)
        axis.set_xlabel(f"in phase, {unit}", fontsize=8)
        axis.set_ylabel(f"quadrature, {unit}", fontsize=8)
        axis.set_aspect("equal")
        axis.axhline(0, color="0.7", lw=0.6)
        axis.axvline(0, color="0.7", lw=0.6)
        every = np.asarray(factor * np.concatenate([*(c.line_seen for c in mine), np.zeros(1)]), dtype=complex)
        _square(axis, every)
        _mark_frequencies(axis, mine, factor, 0.58 * max(np.ptp(every.real), np.ptp(every.imag), 1e-12))
    both = len({bool(c.frequency[-1] > 0) for c in found}) > 1
    marks = (
        [("o", GREY, "measured, forward"), ("o", "none", "measured, backward")] if both else [("o", GREY, "measured")]
    )
    _condition_legend(figure, conditions, "fit", [*marks, ("x", GREY, "frequency in rpm")])
    return figure


def _mark_frequencies(axis: Any, found: Sequence[SweepCurve], factor: float, reach: float) -> None:
    """Crosses at round frequencies on the fitted lines, each with its number where there is room for it."""
    from matplotlib.ticker import MaxNLocator

    top = max(float(np.abs(c.fine).max()) for c in found) * RPM_PER_RAD_S
    steps = np.asarray(MaxNLocator(nbins=28, steps=[1, 2, 5, 10]).tick_values(-top, top))
    placed: list[complex] = []
    for curve in found:
        x = curve.fine * RPM_PER_RAD_S
        for rpm in sorted(steps[(steps >= x[0]) & (steps <= x[-1]) & (steps != 0)], key=abs):
            z = factor * complex(np.interp(rpm, x, curve.line_seen.real), np.interp(rpm, x, curve.line_seen.imag))
            if all(abs(z - other) > 0.3 * reach for other in placed):
                placed.append(z)
                axis.plot(z.real, z.imag, "x", ms=4.5, mew=1.1, color="black", zorder=5)
                left = z.real > np.mean(axis.get_xlim())  # towards the middle, where there is room
                axis.annotate(
                    f"{rpm:.0f}".replace("-", "−"),
                    (z.real, z.imag),
                    xytext=(-4 if left else 4, 3),
                    textcoords="offset points",
                    ha="right" if left else "left",
                    fontsize=SMALL_TYPE,
                    color=curve.condition.colour,
                    zorder=5,
                    clip_on=True,
                )


def _square(axis: Any, values: ComplexArray) -> None:
    """Square limits around the fitted curve; noise of low frequencies may lie outside."""
    middle = complex(values.real.min() + values.real.max(), values.imag.min() + values.imag.max()) / 2
    reach = 0.58 * max(np.ptp(values.real), np.ptp(values.imag), 1e-12)
    axis.set_xlim(middle.real - reach, middle.real + reach)
    axis.set_ylim(middle.imag - reach, middle.imag + reach)


def plot_residuals(fit: FitResult) -> Figure:
    """Residuals over their noise against frequency, with the band of two standard deviations, and their histogram."""
    conditions, found = curves(fit)
    title = f"Residuals over noise, {fit.model.name}: redchi {fit.redchi:.3g}"
    figure, panels = _panels(found, title, rows=2, size=(5.2, 1.6))
    for curve in joined(found):
        axis, _ = panels.axes[curve.coordinate, curve.force_plane]
        x = curve.frequency * RPM_PER_RAD_S
        axis.plot(x, curve.whitened.real, ".", ms=2.5, color=curve.condition.colour, alpha=0.7)
        axis.plot(x, curve.whitened.imag, "x", ms=2.5, mew=0.6, color=curve.condition.colour, alpha=0.7)
    for pair, (axis, histogram) in panels.axes.items():
        axis.set_title(_cell_title(fit, *pair), fontsize=8)
        axis.set_ylabel("residual / noise", fontsize=8)
        axis.set_xlabel(_frequency_label(found), fontsize=8)
        axis.axhspan(-2, 2, color="0.93", zorder=0)
        mine = np.concatenate([c.whitened for c in found if (c.coordinate, c.force_plane) == pair])
        _histogram(histogram, np.concatenate([mine.real, mine.imag]))
    _condition_legend(figure, conditions, "", [(".", GREY, "real part"), ("x", GREY, "imaginary part")])
    return figure


def _histogram(axis: Any, values: Float) -> None:
    reach = max(4.0, min(float(np.quantile(np.abs(values), 0.99)) * 1.2, 40.0))
    height, edges = np.histogram(np.clip(values, -reach, reach), bins=61, range=(-reach, reach), density=True)
    axis.stairs(height, edges, fill=True, color="0.75")
    u = np.linspace(-reach, reach, 400)
    axis.plot(u, np.exp(-(u**2) / 2) / np.sqrt(2 * np.pi), color="#D55E00", lw=1.2)
    axis.set_xlabel("residual / noise (line: noise alone)", fontsize=8)
    axis.set_yticks([])
    axis.grid(visible=False)


# ---- dynamic stiffness ----------------------------------------------------------------------


def plot_dynamic_stiffness(fit: FitResult) -> Figure:
    """Direct and quadrature dynamic stiffness against signed frequency: data by eq. (7), the fit and its 95 % band.

    One row for each entry of the matrix, or, with more than two coordinates, one panel for each with both parts in it.
    Where not all planes were forced, and of nonlinear fluids, whose stiffness changes with the force, the drive-point
    stiffness (force over response, other planes free) takes the place of eq. (7), with one curve a force level.
    Intercept, curvature and slope of a linear model's lines are written into the panels: they are the parameters.
    """
    return draw_dynamic_stiffness(fit)
