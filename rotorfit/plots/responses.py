"""Figures of a fit: dynamic stiffness, Bode, polar, residuals; those of nonlinear fluids have modules of their own."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rotorfit.estimators.nonlinear import responses_of
from rotorfit.estimators.observations import Responses
from rotorfit.plots.chains import plot_corner, plot_traces
from rotorfit.plots.dynamic_stiffness import draw_dynamic_stiffness
from rotorfit.plots.eccentricity import plot_law, plot_nonlinear_stiffness
from rotorfit.plots.stability import plot_stability
from rotorfit.plots.static_and_impulse import plot_static_locus, plot_static_stiffness, plot_velocity_ratio
from rotorfit.plots.style import GREY, RPM, colour_of, grid, legend_below, literal

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

_FINE = 1500  # points of a fitted line

Float = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]


@dataclass(frozen=True, eq=False)
class _Curve:
    """One probe's response to one force at one speed and in one direction, frequencies ascending."""

    coordinate: int
    force_plane: int
    condition: str
    frequency: Float
    measured: ComplexArray  # per unit of force (or per unit of imposed displacement)
    whitened: ComplexArray
    fine: Float  # frequencies of the fitted line
    fitted: ComplexArray


def _circular_blocks(fit: FitResult) -> list[tuple[Responses, ComplexArray]]:
    predicted = fit.problem.predict(fit.x)
    bases = [responses_of(block) for block in fit.problem.blocks]
    pairs = [(b, p) for b, p in zip(bases, predicted, strict=True) if b is not None and b.frequency.any()]
    if not pairs:
        raise ValueError("this fit has no responses to a circular force to plot")
    return pairs


def _condition_names(block: Responses) -> NDArray[np.str_]:
    """What tells the sweeps of a block apart in a legend: the speed, or that it is synchronous."""
    if np.unique(block.speed).size > 12:
        return np.full(block.speed.size, "synchronous")
    return np.array([f"{v:.0f} rpm" for v in (block.speed * RPM).tolist()])


def _curves(fit: FitResult) -> Iterator[_Curve]:
    for block, predicted in _circular_blocks(fit):
        names = _condition_names(block)[block.line]
        w = block.frequency[block.line]
        plane = np.argmax(np.abs(block.force), axis=1)[block.line]
        drive = block.force[block.line, plane]
        keys = np.column_stack([block.coordinate, plane, block.label, w < 0])
        for key in np.unique(keys, axis=0):
            for name in np.unique(names):
                rows = np.flatnonzero((keys == key).all(axis=1) & (names == name))
                rows = rows[np.argsort(w[rows])]
                if rows.size:
                    miss = (predicted[rows] - block.measured[rows]) / block.sigma[rows]
                    fine, fitted = _fitted_line(fit, block, rows, predicted[rows] / drive[rows])
                    yield _Curve(
                        int(key[0]), int(key[1]), str(name), w[rows], block.measured[rows] / drive[rows],
                        miss, fine, fitted,
                    )  # fmt: skip


def _fitted_line(
    fit: FitResult, block: Responses, rows: NDArray[np.intp], predicted: ComplexArray
) -> tuple[Float, ComplexArray]:
    """Fitted response along a sweep, on a grid fine enough for sharp resonances where the model is linear."""
    line, model = block.line[rows], block.model
    w = block.frequency[line]
    if block.imposed or model.eccentricity_dependent:
        return w, predicted
    fine = np.linspace(w[0], w[-1], _FINE)
    speed = np.interp(fine, w, block.speed[line])
    group, coordinate = int(block.group[line[0]]), int(block.coordinate[rows[0]])
    theta = fit.problem.space.theta(fit.x)[group]
    drive = block.force[line[0]]
    direction = drive / drive[np.argmax(np.abs(drive))]
    response = model.receptance(theta, fine, speed)[:, coordinate] @ direction
    return fine, response * model.functions.factors(theta)[coordinate]


def _layout(fit: FitResult) -> tuple[list[_Curve], list[int], list[int], list[str]]:
    """Curves, and the coordinates, force planes and conditions that occur."""
    curves = list(_curves(fit))
    conditions = sorted({c.condition for c in curves}, key=lambda name: (len(name), name))
    return curves, sorted({c.coordinate for c in curves}), sorted({c.force_plane for c in curves}), conditions


def _response_unit(fit: FitResult, coordinate: int) -> tuple[float, str]:
    """Factor to and name of the unit in which a response to a force is shown."""
    if all(block.imposed for block, _ in _circular_blocks(fit)):
        return 1e-6, "N/µm"
    return 1e6, "µrad/N" if fit.model.coordinates[coordinate].axis == "r" else "µm/N"


def _cell_title(fit: FitResult, coordinate: int, force_plane: int) -> str:
    probe, force = fit.model.coordinates[coordinate], fit.model.coordinates[force_plane]
    reading = {"r": "tilt at ", "x": "x at ", "y": "y at "}.get(probe.axis, "")
    return literal(f"{reading}{probe.plane}, force at {force.plane}")


def plot_bode(fit: FitResult) -> Figure:
    """Amplitude and phase of every response per unit force against signed perturbation frequency.

    Rows are probes (amplitude, then phase), columns force planes, colours rotative speeds; points are measured, lines
    fitted.

    Raises:
        ValueError: the fit has no circular responses.
    """
    curves, coordinates, forces, conditions = _layout(fit)
    figure, axes = grid(2 * len(coordinates), len(forces), f"Bode plot, {fit.model.name}", size=(5.2, 1.9))
    for curve in curves:
        row, column = 2 * coordinates.index(curve.coordinate), forces.index(curve.force_plane)
        colour = colour_of(conditions.index(curve.condition))
        factor, unit = _response_unit(fit, curve.coordinate)
        x = curve.frequency * RPM
        amplitude, phase = axes[row, column], axes[row + 1, column]
        amplitude.semilogy(x, factor * np.abs(curve.measured), ".", ms=2.5, color=colour, alpha=0.6)
        amplitude.semilogy(curve.fine * RPM, factor * np.abs(curve.fitted), "-", lw=1.1, color=colour)
        phase.plot(x, _degrees(curve.measured), ".", ms=2.5, color=colour, alpha=0.6)
        phase.plot(curve.fine * RPM, _unwrapped(curve.fitted), "-", lw=1.1, color=colour)
        amplitude.set_title(_cell_title(fit, curve.coordinate, curve.force_plane), fontsize=9)
        amplitude.set_ylabel(unit, fontsize=8)
        phase.set_ylabel("phase lead, deg", fontsize=8)
        phase.set_yticks([-180, -90, 0, 90, 180])
        phase.set_ylim(-190, 190)
    for axis in axes[-1]:
        axis.set_xlabel(_frequency_label(curves), fontsize=9)
    _condition_legend(figure, conditions)
    return figure


def _frequency_label(curves: list[_Curve]) -> str:
    both = any(c.frequency.min() < 0 for c in curves) and any(c.frequency.max() > 0 for c in curves)
    return "perturbation frequency, rpm (backward < 0 < forward)" if both else "frequency, rpm"


def _degrees(values: ComplexArray) -> Float:
    return np.asarray(np.rad2deg(np.angle(values)))


def _unwrapped(values: ComplexArray) -> Float:
    """Phase in degrees, broken where it jumps over the cut so that no line crosses the plot."""
    phase = _degrees(values)
    return np.where(np.abs(np.diff(phase, prepend=phase[:1])) > 180, np.nan, phase)


def _condition_legend(figure: Figure, conditions: list[str]) -> None:
    from matplotlib.lines import Line2D

    handles: list[Any] = [Line2D([], [], color=colour_of(i), lw=2) for i in range(len(conditions))]
    handles += [Line2D([], [], color=GREY, ls="", marker="."), Line2D([], [], color=GREY, lw=1.2)]
    legend_below(figure, handles, [*conditions, "measured", "fitted"])


def plot_polar(fit: FitResult) -> Figure:
    """Responses per unit force in the complex plane; filled points forward, open points backward.

    Raises:
        ValueError: the fit has no circular responses.
    """
    curves, coordinates, forces, conditions = _layout(fit)
    figure, axes = grid(len(coordinates), len(forces), f"Polar plot, {fit.model.name}", size=(4.4, 3.9))
    for curve in curves:
        axis = axes[coordinates.index(curve.coordinate), forces.index(curve.force_plane)]
        colour = colour_of(conditions.index(curve.condition))
        factor, unit = _response_unit(fit, curve.coordinate)
        face = colour if curve.frequency[-1] > 0 else "none"
        z, fitted = factor * curve.measured, factor * curve.fitted
        axis.plot(z.real, z.imag, "o", ms=3, mfc=face, mec=colour, mew=0.6, alpha=0.7)
        axis.plot(fitted.real, fitted.imag, "-", lw=1.1, color=colour)
        axis.set_title(_cell_title(fit, curve.coordinate, curve.force_plane), fontsize=9)
        axis.set_xlabel(f"in phase, {unit}", fontsize=8)
        axis.set_ylabel(f"quadrature, {unit}", fontsize=8)
        axis.set_aspect("equal")
        axis.axhline(0, color="0.7", lw=0.6)
        axis.axvline(0, color="0.7", lw=0.6)
    for row, coordinate in enumerate(coordinates):
        for column, force in enumerate(forces):
            shown = [c.fitted for c in curves if (c.coordinate, c.force_plane) == (coordinate, force)]
            factor, _ = _response_unit(fit, coordinate)
            _square(axes[row, column], np.asarray(factor * np.concatenate([*shown, np.zeros(1)]), dtype=complex))
    _condition_legend(figure, conditions)
    return figure


def _square(axis: Any, values: ComplexArray) -> None:
    """Square limits around the fitted curve; noise of low frequencies may lie outside."""
    middle = complex(values.real.min() + values.real.max(), values.imag.min() + values.imag.max()) / 2
    reach = 0.58 * max(np.ptp(values.real), np.ptp(values.imag), 1e-12)
    axis.set_xlim(middle.real - reach, middle.real + reach)
    axis.set_ylim(middle.imag - reach, middle.imag + reach)


def plot_residuals(fit: FitResult) -> Figure:
    """Residuals over their noise against frequency, with the band of two standard deviations, and their histogram.

    Raises:
        ValueError: the fit has no circular responses.
    """
    curves, coordinates, forces, conditions = _layout(fit)
    title = f"Residuals over noise, {fit.model.name}: redchi {fit.redchi:.3g}"
    figure, axes = grid(len(coordinates) + 1, len(forces), title, size=(5.2, 2.1))
    for curve in curves:
        axis = axes[coordinates.index(curve.coordinate), forces.index(curve.force_plane)]
        colour = colour_of(conditions.index(curve.condition))
        x = curve.frequency * RPM
        axis.plot(x, curve.whitened.real, ".", ms=2.5, color=colour, alpha=0.7)
        axis.plot(x, curve.whitened.imag, "x", ms=2.5, mew=0.6, color=colour, alpha=0.7)
        axis.set_title(_cell_title(fit, curve.coordinate, curve.force_plane), fontsize=9)
        axis.set_ylabel("residual / noise", fontsize=8)
        axis.set_xlabel(_frequency_label(curves), fontsize=8)
    for axis in axes[: len(coordinates)].flat:
        axis.axhspan(-2, 2, color="0.93", zorder=0)
    for place, force in enumerate(forces):
        mine = np.concatenate([c.whitened for c in curves if c.force_plane == force])
        _histogram(axes[-1, place], np.concatenate([mine.real, mine.imag]))
    from matplotlib.lines import Line2D

    handles: list[Any] = [Line2D([], [], color=colour_of(i), lw=2) for i in range(len(conditions))]
    handles += [Line2D([], [], color=GREY, ls="", marker=m) for m in (".", "x")]
    legend_below(figure, handles, [*conditions, "real part", "imaginary part"])
    return figure


def _histogram(axis: Any, values: Float) -> None:
    reach = max(4.0, min(float(np.quantile(np.abs(values), 0.99)) * 1.2, 40.0))
    axis.hist(np.clip(values, -reach, reach), bins=61, range=(-reach, reach), density=True, color="0.75")
    u = np.linspace(-reach, reach, 400)
    axis.plot(u, np.exp(-(u**2) / 2) / np.sqrt(2 * np.pi), color="#D55E00", lw=1.2)
    axis.set_xlabel("residual / noise (line: noise alone)", fontsize=8)
    axis.set_yticks([])
    axis.grid(visible=False)


# ---- dynamic stiffness ----------------------------------------------------------------------


def plot_dynamic_stiffness(fit: FitResult) -> Figure:
    """Direct and quadrature dynamic stiffness against signed frequency: data by eq. (7), the fit and its 95 % band.

    One row for each entry of the matrix, or, with more than two coordinates, one panel for each with both parts in it.
    Where not all planes were forced, the drive-point stiffness (force over response, other planes free) takes the place
    of eq. (7). Intercept, curvature and slope of the fitted lines are written into the panels: they are the parameters.

    Raises:
        ValueError: the fit has no circular responses.
    """
    return draw_dynamic_stiffness(fit, [block for block, _ in _circular_blocks(fit)])
