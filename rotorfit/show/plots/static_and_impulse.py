"""Figures of static loads and impulses: locus of the journal, stiffness and velocity ratio (Figs 26 to 29)."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from rotorfit.base.array_types import ComplexArray, Float
from rotorfit.estimators.blocks.small_motion import FreeVibrations
from rotorfit.identify.fitting.propagation import by_values_of_causes
from rotorfit.identify.fitting.result import FitResult
from rotorfit.models.coefficient_tables import changing_fluids, law_curves
from rotorfit.models.motion.off_centre import off_centre_eigenvalues
from rotorfit.show.plots import style
from rotorfit.show.plots.journal import JournalLines, drive_stiffness, half_width, journal_lines, law_series, rig_of

_POINTS = {"fmt": "o", "ms": 3.5, "elinewidth": 0.7}  # look of readings with their errors


def _static(fit: FitResult) -> list[JournalLines]:
    changing_fluids(fit.model)
    found = list(journal_lines(fit, static=True))
    if not found:
        raise ValueError("this fit has no static loads with the journal's position to plot")
    return found


def _curves(lines: JournalLines) -> list[tuple[int, float, float]]:
    """Parameter group, speed and largest eccentricity of each locus."""
    pairs = np.unique(np.column_stack([lines.group, lines.speed]), axis=0)
    return [
        (int(g), float(v), float(lines.eccentricity[(lines.group == g) & (lines.speed == v)].max())) for g, v in pairs
    ]


def _speeds(blocks: list[JournalLines]) -> list[float]:
    return sorted({round(float(v), 6) for lines in blocks for v in lines.speed})


@style.on_sheet
def plot_static_locus(fit: FitResult, *, sheet: style.Sheet) -> Figure:
    """Positions of the journal under constant loads, as in Fig. 26, over the clearance; the circle is the wall.

    Points are measured, lines the fitted locus from the centre to the largest load; positions are turned so that the
    load points down.
    """
    from matplotlib.patches import Circle

    blocks = _static(fit)
    speeds, theta = _speeds(blocks), fit.thetas
    figure, axes = sheet.grid(1, 1, f"{rig_of(fit)}: journal under static loads", size=(6.0, 5.4))
    axis = axes[0, 0]
    for lines in blocks:
        clearance = float(np.abs(lines.position[0]) / lines.eccentricity[0])
        # The load's direction is that of the displacement of a rotor with a real stiffness.
        down = -1j / np.exp(1j * np.angle(lines.stiffness * lines.position))
        turned = lines.position * down / clearance
        for group, speed, largest in _curves(lines):
            colour = style.colour_of(speeds.index(round(speed, 6)))
            here = (lines.group == group) & (lines.speed == speed)
            z, error = turned[here], lines.sigma[here] / clearance
            axis.errorbar(z.real, z.imag, error, error, color=colour, **_POINTS)
            eps = np.linspace(0.0, largest, style.CURVE_POINTS)
            kappa, _ = drive_stiffness(fit.model, theta[group], 0j, speed, eps)
            locus = -1j * eps * np.abs(kappa) / kappa
            axis.plot(locus.real, locus.imag, "-", color=colour, lw=1.3)
    for radius in (0.25, 0.5, 0.75, 1.0):
        axis.add_patch(Circle((0, 0), radius, fill=False, color=style.GREY if radius == 1 else style.GRID, lw=1.0))
        axis.text(0, radius, f"{radius:g}", fontsize=7, color=style.GREY, ha="center", va="bottom")
    axis.annotate("", (0, -1.2), (0, -1.03), arrowprops={"arrowstyle": "-|>", "color": style.GREY})
    axis.text(0.04, -1.14, "load", fontsize=8, color=style.GREY)
    axis.set(xlim=(-1.1, 1.1), ylim=(-1.22, 1.12), aspect="equal")
    axis.set(xlabel="across the load, over clearance", ylabel="against the load, over clearance")
    _legend(sheet, figure, speeds, "fitted locus")
    return figure


@style.on_sheet
def plot_static_stiffness(fit: FitResult, *, sheet: style.Sheet) -> Figure:
    """Static load over displacement against eccentricity, as in Figs 27 and 28.

    Above its part across the load over rotative speed, lam D for one mode; below its part along the load,
    ``K + K0 - Mf lam^2 Om^2`` for one mode. Lines are fitted, with 95 % bands.
    """
    blocks = _static(fit)
    speeds, theta = _speeds(blocks), fit.thetas
    across = np.concatenate([np.abs(lines.stiffness.imag / lines.speed) for lines in blocks if lines.speed.all()])
    scales = (
        style.prefix(across, "N s/m"),
        style.prefix(np.concatenate([lines.stiffness.real for lines in blocks]), "N/m"),
    )
    figure, axes = sheet.grid(2, 1, f"{rig_of(fit)}: static stiffness of the journal", size=(5.6, 2.6))
    for lines in blocks:
        for group, speed, largest in _curves(lines):
            here = np.flatnonzero((lines.group == group) & (lines.speed == speed))
            colour = style.colour_of(speeds.index(round(speed, 6)))
            eps = np.linspace(0.0, largest + 0.05 * min(largest, 1 - largest), style.CURVE_POINTS)
            kappa, slope = drive_stiffness(fit.model, theta[group], 0j, speed, eps)
            measured, sigma = lines.stiffness[here], lines.stiffness_sigma[here]
            turning = -1.0 / speed if speed else np.nan
            parts = (
                (turning * scales[0][0], measured.imag, kappa.imag, slope.imag),
                (scales[1][0], measured.real, kappa.real, slope.real),
            )
            for axis, (factor, points, curve, by) in zip(axes[:, 0], parts, strict=True):
                if not np.isfinite(factor):
                    continue
                moved = by_values_of_causes(fit, by, group, speed)
                error, band = np.abs(factor) * sigma, np.abs(factor) * half_width(fit, group, by, moved)
                axis.errorbar(lines.eccentricity[here], factor * points, error, color=colour, **_POINTS)
                style.draw_curve(axis, eps, factor * curve, band, colour)
    single = len(fit.model.coordinates) == 1
    axes[0, 0].set_ylabel(f"{'λD' if single else 'across the load / Ω'}, {scales[0][1]}")
    axes[1, 0].set_ylabel(f"{'K + K0 − Mf λ²Ω²' if single else 'along the load'}, {scales[1][1]}")
    axes[1, 0].set_xlabel("eccentricity of the journal over clearance")
    _legend(sheet, figure, speeds, "fit and 95 % band")
    return figure


@style.on_sheet
def plot_velocity_ratio(fit: FitResult, *, sheet: style.Sheet) -> Figure:
    """Damped frequency over rotative speed from impulse tests against eccentricity, as in Fig. 29.

    The paper reads these ratios as lam; they are eigenvalues of the rotor, drawn as solid lines, and lam itself,
    dashed with its 95 % band, may lie elsewhere.
    """
    changing_fluids(fit.model)
    blocks = [block for block in fit.problem.blocks if isinstance(block, FreeVibrations)]
    if not blocks:
        raise ValueError("this fit has no impulse tests to plot")
    speeds = sorted({round(float(v), 6) for block in blocks for v in block.speed})
    figure, axes = sheet.grid(1, 1, f"{rig_of(fit)}: velocity ratio from impulse tests", size=(5.6, 3.6))
    axis = axes[0, 0]
    limit = max(float(block.measured_eccentricity(fit.thetas).max()) for block in blocks)
    eps = np.linspace(0.0, limit + 0.1 * min(limit, 1 - limit) or 0.5, style.CURVE_POINTS)
    for block in blocks:
        _draw_vibrations(fit, axis, block, speeds, eps)
    more = {"lam and 95 % band": {"lw": 1.2, "ls": "--"}} if _draw_ratios(fit, axis, speeds, eps) else {}
    axis.set(ylabel="damped frequency over rotative speed", xlabel="eccentricity of the journal over clearance")
    axis.set_ylim(bottom=min(0.0, axis.get_ylim()[0]))
    _legend(sheet, figure, speeds, "fitted eigenvalue", more)
    return figure


def _draw_vibrations(fit: FitResult, axis: Any, block: FreeVibrations, speeds: list[float], eps: Float) -> None:
    """Measured frequencies over speed, and the fitted eigenvalues along the eccentricities, a colour each speed."""
    theta, fitted = fit.thetas, block.predict(fit.thetas)
    rest = block.measured_eccentricity(theta)
    for group, speed in np.unique(np.column_stack([block.reading_group, block.speed]), axis=0):
        here = np.flatnonzero((block.reading_group == group) & (block.speed == speed))
        colour = style.colour_of(speeds.index(round(float(speed), 6)))
        ratio, error = block.measured[here].imag / speed, block.sigma[here] / speed
        axis.errorbar(rest[here], ratio, error, color=colour, zorder=3, **_POINTS)
        for branch in _branches(fit, theta[int(group)], float(speed), eps, rest[here], fitted[here]):
            axis.plot(eps, branch / speed, "-", color=colour, lw=1.3)


def _draw_ratios(fit: FitResult, axis: Any, speeds: list[float], eps: Float) -> bool:
    """Velocity ratios of the law, dashed, with 95 % bands; in the speed's colour where they change with it. False where
    the model has none."""
    drawn = False
    for group, speed in law_series(fit):
        colour = style.GREY if speed is None else style.colour_of(int(np.argmin(np.abs(np.array(speeds) - speed))))
        for curve in law_curves(fit.model, fit.thetas[group], eps, speed):
            if not curve.name.startswith("lam"):
                continue
            band = half_width(fit, group, curve.slope, by_values_of_causes(fit, curve.slope, group, speed))
            style.draw_curve(axis, eps, curve.value, band, colour, "--", lw=1.2)
            axis.text(eps[-1], curve.value[-1], f" {curve.name.replace('lam', 'λ')}", fontsize=8, color=colour)
            drawn = True
    return drawn


def _branches(
    fit: FitResult, theta: Float, speed: float, eps: Float, measured_at: Float, fitted: ComplexArray
) -> list[Float]:
    """Damped frequencies of the measured modes along the eccentricities, each followed from where it was measured."""
    every = [off_centre_eigenvalues(fit.model, theta, speed, float(e)) for e in eps]
    found: list[Float] = []
    for at, s in zip(measured_at, fitted, strict=True):
        begin = int(np.argmin(np.abs(eps - at)))
        branch = np.empty(eps.size, dtype=complex)
        for steps in (range(begin, eps.size), range(begin, -1, -1)):
            last = s
            for k in steps:
                last = branch[k] = every[k][np.argmin(np.abs(every[k] - last))]
        if not any(np.allclose(branch.imag, other, rtol=1e-6, atol=1e-6 * abs(s)) for other in found):
            found.append(np.asarray(branch.imag))
    return found


def _legend(
    sheet: style.Sheet, figure: Figure, speeds: list[float], line: str, more: Mapping[str, Any] = MappingProxyType({})
) -> None:
    entries = style.in_colours([sheet.rate_words(v) for v in speeds], 0)
    style.legend_below(
        figure, entries | {"measured": {"ls": "", "marker": "o", "ms": 4}, line: {"lw": 1.3}} | dict(more)
    )
