"""Dynamic stiffness of a fit."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np
from matplotlib.figure import Figure

from rotorfit.base.array_types import ComplexArray, Float
from rotorfit.base.digits import significant
from rotorfit.base.names import unknown_name
from rotorfit.base.significance import CHANCE_ERRORS
from rotorfit.estimators.blocks.nonlinear import OrbitResponses
from rotorfit.estimators.blocks.observations import Responses, force_plane, read_at_the_force
from rotorfit.estimators.blocks.response import probe_factors
from rotorfit.estimators.inference.covariance import standard_error
from rotorfit.estimators.starting.force_balance import stiffness_matrices
from rotorfit.identify.fitting.result import FitResult
from rotorfit.show.plots import style
from rotorfit.show.plots.journal import half_width
from rotorfit.show.plots.sweeps import SweepCondition, sweeps

_FITTED_LINES = 3  # drawing order of fitted lines, above what was measured


@dataclass(frozen=True, eq=False, kw_only=True)
class Points:
    """Measured stiffness of one entry: frequency, speed, value, sigma."""

    row: int
    column: int
    frequency: Float
    speed: Float
    kappa: ComplexArray
    sigma: Float


@dataclass(frozen=True, eq=False, kw_only=True)
class _Line:
    """Fitted stiffness of one entry and the half-widths of its 95 % band: frequency, value, direct, quadrature."""

    frequency: Float
    kappa: ComplexArray
    direct: Float
    quadrature: Float


@dataclass(frozen=True, eq=False, kw_only=True)
class _Shown:
    """The panel of a condition: its range of frequencies, its points, and lines that only the data show."""

    condition: SweepCondition
    low: float
    high: float
    points: list[Points]
    lines: dict[tuple[int, int], list[_Line]]


_NO_STIFFNESS = (
    "no dynamic stiffness was measured: it takes readings at the plane of a force that acts alone, or all planes read "
    "under a force at each of them in turn, at the same speeds and frequencies"
)
AGAINST = ("frequency", "square", "ratio")
"""Axes of dynamic stiffness: frequency, its square for the direct part, or its ratio to the speed."""


def draw_drive_point(sheet: style.Sheet, fit: FitResult, pair: tuple[Any, Any], coordinate: int) -> None:
    """Direct and quadrature part at a forced coordinate, other planes free, in two panels."""
    shown = _shown(sheet, fit)
    full = len(fit.model.coordinates) == 1
    if not full:
        _, parts = sweeps(fit, sheet)
        shown = [replace(s, points=[]) for s in shown]
        for number, some in enumerate(shown):
            for part in parts:
                keep = (part.condition == number) & (part.responses.frequency != 0)
                if keep.any():
                    some.points.extend(drive_points(_motion(part.responses.lines(keep), fit)))
    _entry(sheet, fit, shown, pair, coordinate, coordinate, full, "frequency")
    unit = pair[0].get_ylabel().rpartition(", ")[2]
    pair[0].set_ylabel(f"direct, {unit}")
    pair[1].set_ylabel(f"quadrature, {unit}")
    for axis in pair:
        axis.set_title("")


@style.on_sheet
def plot_dynamic_stiffness(fit: FitResult, *, sheet: style.Sheet, against: str = "frequency") -> Figure:
    """Direct and quadrature dynamic stiffness against signed frequency: data by eq. (7), the fit and its 95 % band.

    One row for each entry of the matrix, or, with more than two coordinates, one panel for each with both parts in it.
    Where not all planes were forced, and of nonlinear fluids, whose stiffness changes with the force, the drive-point
    stiffness (force over response, other planes free) takes the place of eq. (7), with one curve a force level.
    Intercept, curvature and slope of a linear model's lines are written into the panels: they are the parameters.

    ``against``: ``square`` draws the direct part against the square of the frequency, straight lines (Figs 6, 25, 36),
    ``ratio`` against frequency over rotative speed.
    """
    if against not in AGAINST:
        raise ValueError(unknown_name("abscissa", against, AGAINST))
    shown = _shown(sheet, fit)
    if against == "ratio" and any(np.isnan(some.condition.speed) for some in shown):
        raise ValueError("against='ratio' needs a constant rotative speed; of start-ups frequency is the speed")
    n = len(fit.model.coordinates)
    full = any(p.row != p.column for s in shown for p in s.points) or n == 1
    measured = sorted({(p.row, p.column) for s in shown for p in s.points})
    entries = list(np.ndindex(n, n)) if full else measured
    if not entries:
        raise ValueError(_NO_STIFFNESS)
    kind = "Dynamic stiffness" if full else "Drive-point dynamic stiffness, other planes free"
    together = full and n > 2 and against != "square"
    rows, columns, size = (n, n, (3.6, 2.4)) if together else (len(entries), 2, (5.4, 2.2))
    figure, axes = sheet.grid(rows, columns, f"{kind}, {fit.model.name}", size=size, one_abscissa=True)
    for place, (row, column) in enumerate(entries):
        pair = (axes[row, column],) * 2 if together else tuple(axes[place])
        _entry(sheet, fit, shown, pair, row, column, full, against)
    for number, axis in enumerate(axes[-1]):
        axis.set_xlabel(abscissa_words(sheet, against, squared=number == 0 and not together))
    point, line = {"marker": "o", "ls": "", "ms": 4}, {"lw": 1.3}
    legend: dict[str, Any] = {s.condition.name: {"color": s.condition.colour, "lw": 2} for s in shown}
    if together:
        legend |= {"direct, measured": point, "quadrature, measured": point | {"mfc": "none"}}
        legend |= {"direct, fit": line, "quadrature, fit": line | {"ls": "--"}}
    else:
        legend |= {"measured ± 1 sd": point, "fit and 95 % band": line}
    style.legend_below(figure, legend)
    return figure


def abscissa_words(sheet: style.Sheet, against: str, *, squared: bool) -> str:
    """Words below an axis."""
    if against == "square" and squared:
        return "square of the frequency, 1000 rad²/s²"
    if against == "ratio":
        return "perturbation frequency over rotative speed"
    return f"perturbation frequency, {sheet.rate_unit}"


def places(sheet: style.Sheet, frequency: Float, speed: Float | float, against: str, *, squared: bool) -> Float:
    """Places of frequencies, rad/s, along an axis."""
    if against == "square" and squared:
        return frequency**2 / 1e3
    return np.asarray(frequency / speed) if against == "ratio" else frequency * sheet.per_rad_s


def _shown(sheet: style.Sheet, fit: FitResult) -> list[_Shown]:
    conditions, parts = sweeps(fit, sheet)
    found = []
    for number, condition in enumerate(conditions):
        kept = [(part, (part.condition == number) & (part.responses.frequency != 0)) for part in parts]
        mine = [(part, keep) for part, keep in kept if keep.any()]
        w = np.concatenate([part.responses.frequency[keep] for part, keep in mine])
        w = w if fit.model.frame == "z" else np.abs(w)
        points = [p for part, keep in mine for p in _measured(_motion(part.responses.lines(keep), fit), fit)]
        lines: dict[tuple[int, int], list[_Line]] = {}
        for part, keep in mine:
            if isinstance(part.block, OrbitResponses):
                for place, line in _along_the_data(fit, part.block.lines(keep), condition.group):
                    lines.setdefault((place, place), []).append(line)
        found.append(_Shown(condition=condition, low=float(w.min()), high=float(w.max()), points=points, lines=lines))
    return found


def _motion(block: Responses, fit: FitResult) -> Responses:
    """The motion that was read: the factors that the fit has of the probes taken out."""
    if block.imposed:
        return block
    factor = probe_factors(block, fit.thetas)
    return replace(block, measured=block.measured / factor, sigma=block.sigma / np.abs(factor))


def _measured(block: Responses, fit: FitResult) -> list[Points]:
    """Entries of eq. (7), or the drive points where not all planes were forced or each force has a stiffness."""
    most = 400  # measured points a panel; more only blacken it
    if not block.imposed and not fit.model.eccentricity_dependent:
        measured = stiffness_matrices(block)
        if measured.frequency.size:
            some = slice(None, None, max(1, measured.frequency.size // most))
            beside = 0.0 if block.beside is None else block.beside[measured.first_line]
            kappa, w, speed = np.asarray(measured.kappa - beside)[some], measured.frequency[some], measured.speed[some]
            every = np.ndindex(kappa.shape[1:])
            sigma = measured.sigma[some]
            return [
                Points(row=i, column=j, frequency=w, speed=speed, kappa=kappa[:, i, j], sigma=sigma[:, i, j])
                for i, j in every
            ]
    # A drive point of rotor and rig together says nothing of the rotor's alone.
    return drive_points(block) if block.beside is None else []


def drive_points(block: Responses) -> list[Points]:
    """Force over response at the forced coordinate (or measured force over imposed displacement)."""
    own = read_at_the_force(block) & (block.measured != 0)
    points = []
    for p in np.unique(force_plane(block)).tolist():
        rows = np.flatnonzero(own & (block.coordinate == p))
        if not rows.size:
            continue
        line, value, sigma = block.line[rows], block.measured[rows], block.sigma[rows]
        drive = block.force[line, p]
        kappa = value / drive if block.imposed else drive / value
        sigma = sigma / np.abs(drive) if block.imposed else sigma * np.abs(kappa / value)
        w, speed = block.frequency[line], block.speed[line]
        points.append(Points(row=p, column=p, frequency=w, speed=speed, kappa=kappa, sigma=sigma))
    return points


def _along_the_data(fit: FitResult, block: OrbitResponses, group: int) -> Iterator[tuple[int, _Line]]:
    """Drive-point stiffness of a nonlinear rotor at the orbits that the fit has at the data's lines."""
    base = block.base
    value, slope = block.motion_jacobian(fit.thetas)
    own, w = read_at_the_force(base), base.frequency[base.line]
    for p in np.unique(force_plane(base)).tolist():
        for forward in (False, True):
            rows = np.flatnonzero(own & (base.coordinate == p) & ((w > 0) == forward))
            if not rows.size:
                continue
            rows = rows[np.argsort(w[rows], kind="stable")]
            drive, response = base.force[base.line[rows], p], value[rows]
            by_theta = slope[rows]
            kappa = response / drive if base.imposed else drive / response
            change = by_theta / drive[:, None] if base.imposed else -by_theta * (drive / response**2)[:, None]
            direct, quadrature = half_width(fit, group, change.real), half_width(fit, group, change.imag)
            yield p, _Line(frequency=w[rows], kappa=kappa, direct=direct, quadrature=quadrature)


def _entry(
    sheet: style.Sheet,
    fit: FitResult,
    shown: Sequence[_Shown],
    pair: tuple[Any, ...],
    row: int,
    column: int,
    full: bool,
    against: str,
) -> None:
    lines = [_lines(fit, s, row, column, full) for s in shown]
    every = [line for several in lines for line in several]
    points = [[p for p in s.points if (p.row, p.column) == (row, column)] for s in shown]
    values = [np.abs(np.r_[k.kappa.real, k.kappa.imag]) for k in every]
    factor, unit = style.prefix(np.concatenate(values), _unit(fit, row, column))
    together = pair[0] is pair[1]
    for some, curves, measured in zip(shown, lines, points, strict=True):
        colour, speed = some.condition.colour, some.condition.speed
        for number, (axis, part) in enumerate(zip(pair, (np.real, np.imag), strict=True)):
            second, squared = number == 1 and together, number == 0 and not together
            for line in curves:
                x = places(sheet, line.frequency, speed, against, squared=squared)
                half = factor * (line.quadrature if number else line.direct)
                look = "--" if second else "-"
                style.draw_curve(axis, x, factor * part(line.kappa), half, colour, look, zorder=_FITTED_LINES)
            for p in measured:
                x, y = places(sheet, p.frequency, speed, against, squared=squared), factor * part(p.kappa)
                bars = np.stack([y - factor * p.sigma, y + factor * p.sigma, np.full_like(y, np.nan)], axis=1).ravel()
                axis.plot(np.repeat(x, 3), bars, "-", lw=0.5, color=colour, alpha=0.45, zorder=2)
                face = "none" if second else colour
                axis.plot(x, y, "o", ms=2, mfc=face, mec=colour, mew=0.5, alpha=0.45, zorder=2)
    _limits(pair, factor, [line.kappa for line in every], [p.kappa for several in points for p in several])
    name = _name(fit, row, column)
    pair[0].set_ylabel(f"{name}, {unit}")
    if not together:
        pair[0].set_title("direct" if row == column == 0 else "")
        pair[1].set_title("quadrature" if row == column == 0 else "")
        if full and not fit.model.eccentricity_dependent:
            _readings(sheet, fit, shown, pair, row, column, against)


def _lines(fit: FitResult, shown: _Shown, row: int, column: int, full: bool) -> list[_Line]:
    """Fitted lines of an entry: those along the data of a nonlinear rotor, else one on a fine grid."""
    if fit.model.eccentricity_dependent:
        return shown.lines.get((row, column), [])
    return [_fitted(fit, shown, row, column, full)]


def _fitted(fit: FitResult, shown: _Shown, row: int, column: int, full: bool) -> _Line:
    """Fitted entry on a fine grid and half-widths of its 95 % band, by the delta method."""
    model, space = fit.model, fit.problem.space
    condition = shown.condition
    w = np.linspace(shown.low, shown.high, 300)
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
    by_theta = np.zeros((w.size, theta.size + 2), dtype=complex)  # two more inputs: speed and eccentricity
    np.add.at(by_theta.T, jacobian.inputs, entries.T)
    slope = space.pull_back(by_theta[:, : theta.size], condition.group)
    bands = [CHANCE_ERRORS * standard_error(part, fit.covar) for part in (slope.real, slope.imag)]
    return _Line(frequency=w, kappa=value, direct=bands[0], quadrature=bands[1])


def _limits(
    pair: tuple[Any, ...], factor: float, curves: Sequence[ComplexArray], points: Sequence[ComplexArray]
) -> None:
    """Axes hold the fit and the middle half of the data, not all of these.

    Near zero frequency an unbalance force leaves error bars taller than the rotor is stiff; and about an entry that is
    nearly zero all data scatter further than the fit reaches.
    """
    size = max(float(np.abs(k).max()) for k in curves)
    drawn = [(axis, part) for axis, part in zip(pair, (np.real, np.imag), strict=True)]
    for axis in dict.fromkeys(pair):
        shown, measured = (
            factor * np.concatenate([np.zeros(0), *(part(k) for own, part in drawn if own is axis for k in which)])
            for which in (curves, points)
        )
        middle = np.quantile(measured, (0.25, 0.75)) if measured.size else shown[:1]
        low, high = float(min(shown.min(), middle.min())), float(max(shown.max(), middle.max()))
        reach = max(high - low, 0.25 * max(abs(low), abs(high)))
        if reach <= 1e-6 * factor * size:
            reach = factor * size or 1.0  # an entry that the model does not have, and no data to compare with
        axis.set_ylim(low - 0.25 * reach, high + 0.25 * reach)


def _readings(
    sheet: style.Sheet,
    fit: FitResult,
    shown: Sequence[_Shown],
    pair: tuple[Any, ...],
    row: int,
    column: int,
    against: str,
) -> None:
    """Write what the lines mean: intercept and curvature of the direct part, slope of the quadrature part.

    They hold for the last of several speeds, which the box then names.
    """
    theta = fit.thetas
    condition = shown[-1].condition
    speed = 0.0 if np.isnan(condition.speed) else condition.speed
    where = f"{condition.name}:\n" if len(shown) > 1 else ""
    C = fit.model.coefficients(theta[condition.group], speed)[:, row, column]
    stiffness, unit = style.prefix(np.array([C[0].real]), _unit(fit, row, column))
    direct = f"at 0: {_symbols(fit, 0, row, column)}{style.number_words(C[0].real * stiffness)} {unit}"
    if len(C) > 2 and abs(C[2].real) > 0:
        named = "−slope" if against == "square" else "−curvature/2"
        mass = ("kg", "kg m", "kg m²")[[fit.model.coordinates[k].axis for k in (row, column)].count("r")]
        direct += f"\n{named}: {_symbols(fit, 2, row, column)}{style.number_words(C[2].real)} {mass}"
    damping = _unit(fit, row, column).replace("N", "N s", 1)
    quadrature = f"slope: {style.number_words(C[1].real)} {damping}" if abs(C[1].real) > 0 else ""
    box = {"boxstyle": "round,pad=0.25", "facecolor": "white", "edgecolor": "0.8", "alpha": 0.85}
    for axis, text in zip(pair, (direct, quadrature), strict=True):
        if text:
            side, x = _clear_side(axis)
            axis.text(
                x, 0.04, where + text, transform=axis.transAxes, fontsize=7, va="bottom", ha=side, bbox=box, zorder=5
            )
    _mark_whirl(sheet, fit, shown, pair[1], row, column, against)


def _clear_side(axis: Any) -> tuple[str, float]:
    """Where along the lower edge a box hides least of the fit: its alignment and place, in parts of the axis."""
    fits = [line.get_xydata() for line in axis.lines if line.get_zorder() == _FITTED_LINES]
    at = axis.transAxes.inverted().transform(axis.transData.transform(np.concatenate(fits)))
    extent = (0.46, 0.28)  # width and height of the boxes of readings, generously, in parts of an axis
    low = at[at[:, 1] < extent[1], 0]
    begins = {"left": 0.02, "center": 0.5 - extent[0] / 2, "right": 0.98 - extent[0]}
    side = min(begins, key=lambda name: int(np.sum((low > begins[name]) & (low < begins[name] + extent[0]))))
    return side, {"left": 0.02, "center": 0.5, "right": 0.98}[side]


def _symbols(fit: FitResult, power: int, row: int, column: int) -> str:
    """The parameters that make a coefficient, ``K1 + K2 = ``, where they are few; empty where they are not."""
    model = fit.model
    named = [ca.SX.sym(name) for name in model.parameter_names]
    theta, _, _, matrices, _ = model.symbolic
    entry = ca.substitute(matrices[power].re[row, column], theta, ca.vertcat(*named))
    words = str(entry).strip("()")
    longest = 16  # letters of an expression that is read at a glance
    plain = len(words) <= longest and not set(words) & set("@*/?(")
    sign = "−" if words.startswith("-") else ""
    spaced = sign + words.removeprefix("-").replace("+", " + ").replace("-", " − ")
    return f"{style.literal(spaced)} = " if plain and any(name in words for name in model.parameter_names) else ""


def _mark_whirl(
    sheet: style.Sheet, fit: FitResult, shown: Sequence[_Shown], axis: Any, row: int, column: int, against: str
) -> None:
    """Mark lam Omega where the fluid's quadrature stiffness crosses zero, labels stepping down so that none meet."""
    names = fit.model.parameter_names
    if row != column or row != len(fit.model.coordinates) - 1 or not {"D", "lam"} <= set(names):
        return
    theta = fit.thetas
    axis.axhline(0, color="0.6", lw=0.7, zorder=1)
    marked: dict[float, tuple[str, str]] = {}
    for some in shown:
        condition = some.condition
        whirl = theta[condition.group][names.index("lam")] * condition.speed
        if np.isfinite(whirl) and some.low < whirl < some.high:
            at = float(places(sheet, np.array(whirl), condition.speed, against, squared=False))
            text = f"λΩ = {sheet.rate_words(whirl)}" if against != "ratio" else f"λ = {significant(at, 4)}"
            marked.setdefault(round(at, 9), (text, condition.colour))
    for at, (_, colour) in marked.items():
        axis.axvline(at, color=colour, lw=0.9, ls=":", zorder=1)
    labels = {text: (at, colour) for at, (text, colour) in sorted(marked.items(), reverse=True)}
    most = 4  # labels that find room above one another, and above the box of the slope
    ordered = sorted((at, text, colour) for text, (at, colour) in labels.items())
    low, high = axis.get_xlim()
    for number, which in enumerate(np.unique(np.linspace(0, len(ordered) - 1, most).astype(int)) if ordered else ()):
        at, text, colour = ordered[which]
        side = "left" if at - low < 0.6 * (high - low) else "right"
        place = {"xy": (at, 0.97 - 0.1 * number), "xycoords": ("data", "axes fraction"), "ha": side}
        box = {"facecolor": "white", "alpha": 0.6, "lw": 0, "pad": 0.3}
        look = {"fontsize": 7, "color": colour, "va": "top", "bbox": box, "zorder": 4}
        apart = 4 if side == "left" else -4
        axis.annotate(text, xytext=(apart, 0), textcoords="offset points", **place, **look)


def _unit(fit: FitResult, row: int, column: int) -> str:
    force_or_moment = "N m" if fit.model.coordinates[row].axis == "r" else "N"
    if fit.model.coordinates[column].axis == "r":
        return f"{force_or_moment}/rad"
    return "N" if force_or_moment == "N m" else "N/m"


def _name(fit: FitResult, row: int, column: int) -> str:
    if len(fit.model.coordinates) == 1:
        return "κ"
    first, second = fit.model.coordinates[row], fit.model.coordinates[column]
    short = [c.plane if c.axis == "z" else f"{c.plane}.{c.axis}" for c in (first, second)]
    return style.literal(f"κ {short[0]}–{short[1]}")
