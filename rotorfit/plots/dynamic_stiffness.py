"""Panels of the dynamic stiffness plot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rotorfit.estimators.closed_form import StiffnessMatrices, stiffness_matrices
from rotorfit.estimators.observations import Responses
from rotorfit.plots.style import GREY, RPM, colour_of, grid, legend_below, literal, prefix

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from rotorfit.fitting.result import FitResult

Float = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

_CONFIDENCE = 1.96  # 95 % of a normal distribution
_CURVE_POINTS = 300
_SHOWN = 400  # measured points a panel; more only blacken it


@dataclass(frozen=True, eq=False)
class _Condition:
    """One legend entry: a parameter group at a speed, or a synchronous run."""

    name: str
    group: int
    speed: float  # NaN for synchronous runs, whose speed is the frequency
    low: float
    high: float
    points: list[tuple[int, int, Float, ComplexArray, Float]]  # row, column, frequency, kappa, sigma


def draw_dynamic_stiffness(fit: FitResult, blocks: Sequence[Responses]) -> Figure:
    """Draw the figure of :func:`rotorfit.plots.responses.plot_dynamic_stiffness`."""
    conditions = [c for block in blocks for c in _conditions(block)]
    full = any(row != column for c in conditions for row, column, *_ in c.points) or len(fit.model.coordinates) == 1
    n = len(fit.model.coordinates)
    entries = (
        [(i, j) for i in range(n) for j in range(n)]
        if full
        else sorted({(r, c) for k in conditions for r, c, *_ in k.points})
    )
    kind = "Dynamic stiffness" if full else "Drive-point dynamic stiffness, other planes free"
    together = full and n > 2
    figure, axes = (
        grid(n, n, f"{kind}, {fit.model.name}", size=(3.6, 2.4))
        if together
        else grid(len(entries), 2, f"{kind}, {fit.model.name}", size=(5.4, 2.5))
    )
    for place, (row, column) in enumerate(entries):
        pair = (axes[row, column],) * 2 if together else tuple(axes[place])
        _entry(fit, conditions, pair, row, column, full)
    for axis in axes[-1]:
        axis.set_xlabel("perturbation frequency, rpm", fontsize=9)
    _legend(figure, conditions, together)
    return figure


def _conditions(block: Responses) -> list[_Condition]:
    n = len(block.model.coordinates)
    measured = stiffness_matrices(block) if not block.imposed else None
    found = []
    synchronous = np.unique(block.speed).size > 12
    speeds = [np.nan] if synchronous else np.unique(block.speed).tolist()
    for group in np.unique(block.group).tolist():
        for speed in speeds:
            lines = (block.group == group) & (synchronous | (block.speed == speed))
            if not lines.any():
                continue
            w = block.frequency[lines] if block.model.frame == "z" else np.abs(block.frequency[lines])
            points = (
                _from_matrices(measured, block, group, speed, n)
                if measured is not None and measured.frequency.size
                else _drive_points(block, lines)
            )
            name = "synchronous" if synchronous else f"{speed * RPM:.0f} rpm"
            found.append(_Condition(name, group, speed, float(w.min()), float(w.max()), points))
    return found


def _from_matrices(
    measured: StiffnessMatrices, block: Responses, group: int, speed: float, n: int
) -> list[tuple[int, int, Float, ComplexArray, Float]]:
    keep = (block.group[measured.first_line] == group) & (np.isnan(speed) | (measured.speed == speed))
    step = max(1, int(keep.sum()) // _SHOWN)
    chosen = np.flatnonzero(keep)[::step]
    return [
        (i, j, measured.frequency[chosen], measured.kappa[chosen, i, j], measured.sigma[chosen, i, j])
        for i in range(n)
        for j in range(n)
    ]


def _drive_points(block: Responses, lines: NDArray[np.bool_]) -> list[tuple[int, int, Float, ComplexArray, Float]]:
    """Force over response at the forced coordinate (or measured force over imposed displacement)."""
    line = block.line
    plane = np.argmax(np.abs(block.force), axis=1)[line]
    points = []
    for p in np.unique(plane).tolist():
        rows = np.flatnonzero(lines[line] & (plane == p) & (block.coordinate == p))
        if not rows.size:
            continue
        drive, value = block.force[line[rows], p], block.measured[rows]
        ratio = value / drive if block.imposed else drive / value
        sigma = block.sigma[rows] / np.abs(drive) if block.imposed else block.sigma[rows] * np.abs(drive / value**2)
        points.append((p, p, block.frequency[line[rows]], ratio, sigma))
    return points


def _entry(
    fit: FitResult, conditions: Sequence[_Condition], pair: tuple[Any, ...], row: int, column: int, full: bool
) -> None:
    curves = [_fitted(fit, c, row, column, full) for c in conditions]
    unit = _unit(fit, row, column)
    factor, shown = prefix(np.concatenate([np.abs(np.r_[k.real, k.imag]) for _, k, _, _ in curves]), unit)
    together = pair[0] is pair[1]
    for number, (condition, (w, kappa, band_re, band_im)) in enumerate(zip(conditions, curves, strict=True)):
        colour = colour_of(number)
        parts = ((kappa.real, band_re, "-"), (kappa.imag, band_im, "--" if together else "-"))
        for axis, (value, band, style) in zip(pair, parts, strict=True):
            axis.plot(w * RPM, factor * value, style, color=colour, lw=1.3, zorder=3)
            axis.fill_between(w * RPM, factor * (value - band), factor * (value + band), color=colour, alpha=0.25, lw=0)
        for i, j, frequency, measured, sigma in condition.points:
            if (i, j) == (row, column):
                _points(pair, frequency, factor * measured, factor * sigma, colour)
    _limits(pair, factor, curves, [c for k in conditions for i, j, _, c, _ in k.points if (i, j) == (row, column)])
    name = _name(fit, row, column)
    pair[0].set_ylabel(f"{name}, {shown}", fontsize=8)
    if not together:
        pair[0].set_title("direct" if row == column == 0 else "", fontsize=9)
        pair[1].set_title("quadrature" if row == column == 0 else "", fontsize=9)
        if full:
            _readings(fit, conditions, pair, row, column)


def _points(pair: tuple[Any, ...], frequency: Float, value: ComplexArray, sigma: Float, colour: str) -> None:
    together = pair[0] is pair[1]
    for axis, part, face in ((pair[0], value.real, colour), (pair[1], value.imag, "none" if together else colour)):
        axis.errorbar(
            frequency * RPM, part, yerr=sigma, fmt="o", ms=2, mfc=face, mec=colour, mew=0.5, color=colour,
            elinewidth=0.5, alpha=0.45, zorder=2,
        )  # fmt: skip


def _fitted(
    fit: FitResult, condition: _Condition, row: int, column: int, full: bool
) -> tuple[Float, ComplexArray, Float, Float]:
    """Fitted entry on a fine grid and half-widths of its 95 % band (direct, quadrature), by the delta method."""
    model, space = fit.model, fit.problem.space
    w = np.linspace(condition.low, condition.high, _CURVE_POINTS)
    speed = w if np.isnan(condition.speed) else np.full(w.size, condition.speed)
    theta = space.theta(fit.x)[condition.group]
    kappa: ComplexArray = model.dynamic_stiffness(theta, w, speed)
    s = 1j * (w if model.frame == "z" else np.abs(w))
    jacobian = model.functions.jacobian(np.broadcast_to(theta, (w.size, theta.size)), speed)
    if full:
        value: ComplexArray = kappa[:, row, column]
        weight = ((jacobian.rows == row) & (jacobian.columns == column)).astype(complex)[None, :]
    else:
        H = np.linalg.inv(kappa)
        value = np.asarray(1 / H[:, row, row])
        # d(1/H_pp) = H_p. dkappa H_.p / H_pp^2
        weight = H[:, row, :][:, jacobian.rows] * H[:, :, row][:, jacobian.columns] * (value**2)[:, None]
    entries = weight * s[:, None] ** jacobian.powers * jacobian.values
    slope = np.zeros((w.size, fit.x.size), dtype=complex)
    index = space.index[condition.group]
    for e, parameter in enumerate(jacobian.inputs.tolist()):
        if parameter < len(index) and index[parameter] >= 0:
            slope[:, index[parameter]] += entries[:, e]
    bands = [
        _CONFIDENCE * np.sqrt(np.maximum(np.einsum("li,ij,lj->l", g, fit.covar, g), 0))
        for g in (slope.real, slope.imag)
    ]
    return w, value, bands[0], bands[1]


def _limits(
    pair: tuple[Any, ...],
    factor: float,
    curves: Sequence[tuple[Float, ComplexArray, Float, Float]],
    points: Sequence[ComplexArray],
) -> None:
    """Axes follow the fit: near zero frequency an unbalance force leaves error bars taller than the rotor is stiff.

    Where the fit is nothing but zero, the axes follow the middle of the data.
    """
    size = max(float(np.abs(k).max()) for _, k, _, _ in curves)
    values = [factor * np.concatenate([part(k) for _, k, _, _ in curves]) for part in (np.real, np.imag)]
    groups = [(pair[0], np.concatenate(values))] if pair[0] is pair[1] else list(zip(pair, values, strict=True))
    for axis, shown in groups:
        low, high = float(shown.min()), float(shown.max())
        reach = max(high - low, 0.25 * max(abs(low), abs(high)))
        if reach < 1e-6 * factor * size:
            spread = [np.abs(c.imag if axis is pair[1] else c.real) for c in points]
            reach = 4 * factor * float(np.median(np.concatenate(spread))) if spread else factor * size
        axis.set_ylim(low - 0.25 * reach, high + 0.25 * reach)


def _readings(fit: FitResult, conditions: Sequence[_Condition], pair: tuple[Any, ...], row: int, column: int) -> None:
    """Write what the lines mean: intercept and curvature of the direct part, slope of the quadrature part."""
    theta = fit.problem.space.theta(fit.x)
    condition = conditions[-1]
    speed = 0.0 if np.isnan(condition.speed) else condition.speed
    C = fit.model.coefficients(theta[condition.group], speed)[:, row, column]
    stiffness, unit = prefix(np.array([C[0].real]), _unit(fit, row, column))
    direct = f"at 0: {C[0].real * stiffness:.4g} {unit}"
    if len(C) > 2 and abs(C[2].real) > 0:
        direct += f"\n−curvature/2: {C[2].real:.4g} {_mass_unit(fit, row, column)}"
    quadrature = (
        f"slope: {C[1].real:.4g} {_unit(fit, row, column).replace('N', 'N s', 1)}" if abs(C[1].real) > 0 else ""
    )
    box = {"boxstyle": "round,pad=0.25", "facecolor": "white", "edgecolor": "0.8", "alpha": 0.85}
    for axis, text in zip(pair, (direct, quadrature), strict=True):
        if text:
            axis.text(0.02, 0.04, text, transform=axis.transAxes, fontsize=7, va="bottom", bbox=box, zorder=5)
    _mark_whirl(fit, conditions, pair[1], row, column)


def _mark_whirl(fit: FitResult, conditions: Sequence[_Condition], axis: Any, row: int, column: int) -> None:
    """Mark lam Omega where the fluid's quadrature stiffness crosses zero."""
    names = fit.model.parameter_names
    if row != column or row != len(fit.model.coordinates) - 1 or not {"D", "lam"} <= set(names):
        return
    theta = fit.problem.space.theta(fit.x)
    for number, condition in enumerate(conditions):
        whirl = theta[condition.group][names.index("lam")] * condition.speed
        if np.isfinite(whirl) and condition.low < whirl < condition.high:
            axis.axvline(whirl * RPM, color=colour_of(number), lw=0.9, ls=":", zorder=1)
            axis.annotate(
                f"λΩ = {whirl * RPM:.0f} rpm", (whirl * RPM, 0.97 - 0.1 * number), xycoords=("data", "axes fraction"),
                xytext=(4, 0), textcoords="offset points", fontsize=7, color=colour_of(number), va="top",
            )  # fmt: skip
    axis.axhline(0, color="0.6", lw=0.7, zorder=1)


def _unit(fit: FitResult, row: int, column: int) -> str:
    axes = fit.model.coordinates[row].axis == "r", fit.model.coordinates[column].axis == "r"
    return {(False, False): "N/m", (False, True): "N/rad", (True, False): "N", (True, True): "N m/rad"}[axes]


def _mass_unit(fit: FitResult, row: int, column: int) -> str:
    tilts = [fit.model.coordinates[k].axis for k in (row, column)].count("r")
    return ("kg", "kg m", "kg m²")[tilts]


def _name(fit: FitResult, row: int, column: int) -> str:
    if len(fit.model.coordinates) == 1:
        return "κ"
    first, second = fit.model.coordinates[row], fit.model.coordinates[column]
    short = [c.plane if c.axis == "z" else f"{c.plane}.{c.axis}" for c in (first, second)]
    return literal(f"κ {short[0]}–{short[1]}")


def _legend(figure: Figure, conditions: Sequence[_Condition], together: bool) -> None:
    from matplotlib.lines import Line2D

    handles: list[Any] = [Line2D([], [], color=colour_of(i), lw=2) for i in range(len(conditions))]
    labels = [c.name for c in conditions]
    extra = (
        [("o", "", GREY, "direct, measured"), ("o", "", "none", "quadrature, measured")]
        if together
        else [("o", "", GREY, "measured ± 1 sd")]
    )
    handles += [Line2D([], [], color=GREY, marker=m, ls=ls, mfc=face, ms=4) for m, ls, face, _ in extra]
    labels += [label for *_, label in extra]
    handles.append(Line2D([], [], color=GREY, lw=1.3))
    labels.append("fit and 95 % band")
    legend_below(figure, handles, labels)
