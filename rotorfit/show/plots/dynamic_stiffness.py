"""Dynamic stiffness of a fit."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np
from matplotlib.figure import Figure

from rotorfit.base.array_types import ComplexArray, Float
from rotorfit.base.digits import significant
from rotorfit.base.names import unknown_name
from rotorfit.estimators.blocks.nonlinear import OrbitResponses
from rotorfit.estimators.blocks.observations import Responses, force_plane, read_at_the_force
from rotorfit.estimators.blocks.response import probe_factors
from rotorfit.estimators.starting.force_balance import stiffness_matrices
from rotorfit.identify.fitting.causes.slopes import stiffness_slopes
from rotorfit.identify.fitting.propagation import by_values_of_causes
from rotorfit.identify.fitting.result import FitResult
from rotorfit.identify.uncertainty.predict import rotor_changes
from rotorfit.models.motion.neglected_terms import fluid_coordinates
from rotorfit.show.plots import style
from rotorfit.show.plots.journal import half_width, rig_of
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
_NAMED = 4
"""Conditions up to which lines are named where they end; more have a legend."""

_READS = (
    "Points: measured, paler where less certain; not drawn beyond the axis or where 2σ exceeds half of it. Lines: fit,",
    "with its 95 % band. Ringed: more than 3.5σ off it. Open: the plane named second, moved by the first.",
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
    for axis, kind in zip(pair, ("direct", "quadrature"), strict=True):
        axis.set_ylabel(f"{kind}, {axis.get_title(loc='left').replace(chr(10), ' ').rpartition(', ')[2]}")
        axis.set_title("")
        for words in [text for text in axis.texts if text.get_gid() == style.BELOW]:
            words.remove()


@style.on_sheet
def plot_dynamic_stiffness(
    fit: FitResult, *, sheet: style.Sheet, against: str = "frequency", every: bool = False
) -> Figure:
    """Direct and quadrature dynamic stiffness against signed frequency: data by eq. (7), the fit and its 95 % band.

    One row for each entry of the matrix, or, with three coordinates, one panel for each with both parts in it; of more
    coordinates a row for each of the diagonal, and such panels with ``every``.
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
    if full and n == 2 and fit.model.frame == "z":  # both directions of coupling in one panel
        entries = [(0, 0), (1, 1), (0, 1)]
    if not entries:
        raise ValueError(_NO_STIFFNESS)
    most, drawn = 3, len(entries)  # coordinates whose matrix can be read on a page
    reads: tuple[str, ...] = _READS
    if full and n > most and not every:
        entries = [entry for entry in entries if entry[0] == entry[1]]
        reads = (*_READS, f"{len(entries)} of {drawn} entries, those on the diagonal; every=True draws all.")
    kind = "dynamic stiffness" if full else "drive-point dynamic stiffness, other planes free"
    together = len(entries) == n * n > 4 and against != "square"
    rows, columns, size = (n, n, (3.6, 2.4)) if together else (len(entries), 2, (5.4, 1.7))
    title = f"{rig_of(fit)}: {kind}"
    pages = max(1.0, columns / most)
    reads = () if together else reads
    figure, axes = sheet.grid(rows, columns, title, size=size, one_abscissa=True, reads=reads, pages=pages)
    for axis in axes.flat if columns >= most else ():
        style.few_ticks(axis.xaxis, 3)
    for place, (row, column) in enumerate(entries):
        pair = (axes[row, column],) * 2 if together else tuple(axes[place])
        _entry(sheet, fit, shown, pair, row, column, full, against)
    for number, axis in enumerate(axes[-1]):
        words = abscissa_words(sheet, against, squared=number == 0 and not together)
        axis.set_xlabel(words if columns < most else words.replace("perturbation frequency", "frequency"))
    figure.align_xlabels(axes[-1])
    point, line = {"marker": "o", "ls": "", "ms": 4}, {"lw": 1.3}
    legend: dict[str, Any] = {s.condition.name: {"color": s.condition.colour, "lw": 2} for s in shown}
    if together:
        legend |= {"direct, measured": point, "quadrature, measured": point | {"mfc": "none"}}
        legend |= {"direct, fit": line, "quadrature, fit": line | {"ls": "--"}}
    elif len(shown) <= _NAMED:
        return figure
    style.legend_below(figure, legend)
    return figure


@style.on_sheet
def plot_quadrature(fit: FitResult, *, sheet: style.Sheet) -> Figure:
    """Quadrature stiffness at the fluid's plane, or the last that was forced: the half figure of a first screen.

    Its slope is the damping; it is zero where the fluid on average turns with the whirl.
    """
    shown = _shown(sheet, fit)
    measured = sorted({(p.row, p.column) for s in shown for p in s.points if p.row == p.column})
    if not measured:
        raise ValueError(_NO_STIFFNESS)
    full = any(p.row != p.column for s in shown for p in s.points) or len(fit.model.coordinates) == 1
    seats = [pair for pair in measured if pair[0] in fluid_coordinates(fit.model)]
    row, column = (seats or measured)[-1]
    figure, ((axis,),) = sheet.grid(1, 1, "", size=style.HALF)
    hidden = figure.add_subplot(axis.get_subplotspec())  # of the direct part, which this figure leaves out
    _entry(sheet, fit, shown, (hidden, axis), row, column, full, "frequency")
    hidden.remove()
    plane = style.literal(fit.model.coordinates[row].plane)
    unit = axis.get_title(loc="left").replace("\n", " ").rpartition(", ")[2]
    style.panel_title(axis, f"Quadrature stiffness at {plane}, {unit}", pad=5)
    for words in [text for text in axis.texts if text.get_gid() == style.BELOW]:
        words.remove()  # numbers and counts, which stand elsewhere on a first screen
    axis.set_xlabel(f"frequency of the force, {sheet.rate_unit}", labelpad=4)
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
    moved = rotor_changes(fit, block) / probe_factors(block.base, fit.thetas)[:, None]
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
            by = (1 / drive if base.imposed else -drive / response**2)[:, None]
            change, beside = by * by_theta, by * moved[rows]
            direct = half_width(fit, group, change.real, beside.real)
            quadrature = half_width(fit, group, change.imag, beside.imag)
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
    symmetric = fit.model.frame == "z" and len(fit.model.coordinates) == 2  # in x and y the couplings differ
    mirrored = symmetric and row != column and pair[0] is not pair[1]
    wanted = {(row, column), (column, row)} if mirrored else {(row, column)}
    points = [[p for p in s.points if (p.row, p.column) in wanted] for s in shown]
    values = [np.abs(np.r_[k.kappa.real, k.kappa.imag]) for k in every]
    factor, unit = style.prefix(np.concatenate(values), _unit(fit, row, column))
    together = pair[0] is pair[1]
    _limits(pair, factor, every, [p for several in points for p in several])
    left_out, widened = [0, 0], math.sqrt(fit.redchi) if fit.model_limited else 1.0
    for rank, (some, curves, measured) in enumerate(zip(shown, lines, points, strict=True)):
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
                expected = factor * part(_along(curves, p.frequency))
                hollow = second or (p.row, p.column) != (row, column)
                marks = style.Marks(colour=colour, marker=style.MARKERS[rank % 4], hollow=hollow)
                # A response that is all noise looks stiffer or softer, and surer, than the fit has it.
                size = np.abs(np.nan_to_num(_along(curves, p.frequency))) / np.abs(p.kappa)
                sigma = factor * p.sigma * np.maximum(size, 1.0) ** 2
                left_out[number] += style.draw_points(axis, x, y, sigma, expected, marks, widened=widened)
    name, count = _name(fit, row, column), sum(p.kappa.size for several in points for p in several)
    if together:
        style.panel_title(pair[0], f"{name}, {unit}")
        return
    for number, (axis, kind) in enumerate(zip(pair, ("direct", "quadrature"), strict=True)):
        style.panel_title(axis, f"{name}, {kind}, {unit}", pad=13)
        if left_out[number]:
            style.above(axis, f"{left_out[number]} of {count} points not drawn")
        _name_lines(sheet, axis, shown, lines, factor, (np.real, np.imag)[number], against, squared=number == 0)
    if full and not fit.model.eccentricity_dependent:
        if len(shown) <= _NAMED:
            _readings(fit, shown, pair, row, column, against)
        _mark_whirl(sheet, fit, shown, pair[1], row, column, against)


def _along(curves: Sequence[_Line], frequency: Float) -> ComplexArray:
    """What fitted lines have at the frequencies of points, NaN where there is none."""
    found = np.full(frequency.size, complex(np.nan, np.nan))
    for line in curves:
        own = (frequency >= line.frequency[0]) & (frequency <= line.frequency[-1])
        real, imaginary = (np.interp(frequency[own], line.frequency, f(line.kappa)) for f in (np.real, np.imag))
        found[own] = real + 1j * imaginary
    return found


def _name_lines(
    sheet: style.Sheet,
    axis: Any,
    shown: Sequence[_Shown],
    lines: Sequence[Sequence[_Line]],
    factor: float,
    part: Any,
    against: str,
    *,
    squared: bool,
) -> None:
    """Conditions beside the ends of their lines; where all fall on one curve, that they do."""
    if not 1 < len(shown) <= _NAMED or not all(lines):
        return
    last = [max(some, key=lambda line: line.frequency[-1]).kappa for some in lines]
    ends = [factor * float(part(kappa)[-1]) for kappa in last]
    low, high = axis.get_ylim()
    middle = [factor * float(part(kappa)[kappa.size // 4]) for kappa in last]
    if np.ptp(ends) < 0.02 * (high - low) and np.ptp(middle) < 0.02 * (high - low):
        style.end_labels(axis, [("all on one", ends[0], style.GREY)], weight="normal")
        return
    style.end_labels(axis, [(s.condition.name, end, s.condition.colour) for s, end in zip(shown, ends, strict=True)])


def _lines(fit: FitResult, shown: _Shown, row: int, column: int, full: bool) -> list[_Line]:
    """Fitted lines of an entry: those along the data of a nonlinear rotor, else one on a fine grid."""
    if fit.model.eccentricity_dependent:
        return shown.lines.get((row, column), [])
    return [_fitted(fit, shown, row, column, full)]


def _fitted(fit: FitResult, shown: _Shown, row: int, column: int, full: bool) -> _Line:
    """Fitted entry on a fine grid and half-widths of its 95 % band, by the delta method."""
    model, condition = fit.model, shown.condition
    w = np.linspace(shown.low, shown.high, 300)
    speed: Float = w if np.isnan(condition.speed) else np.full(w.size, condition.speed)
    theta = fit.thetas[condition.group]
    kappa: ComplexArray = model.dynamic_stiffness(theta, w, speed)
    s = 1j * (w if model.frame == "z" else np.abs(w))
    jacobian = model.functions.jacobian(np.broadcast_to(theta, (w.size, theta.size)), speed)
    value: ComplexArray = kappa[:, row, column]
    weight = np.zeros_like(kappa)  # of each entry of the matrix in the change of the value
    weight[:, row, column] = 1.0
    if not full:
        H = np.linalg.inv(kappa)
        value = np.asarray(1 / H[:, row, row])
        # d(1/H_pp) = H_p. dkappa H_.p / H_pp^2
        weight = H[:, row, :, None] * H[:, :, row][:, None, :] * (value**2)[:, None, None]
    entries = weight[:, jacobian.rows, jacobian.columns] * s[:, None] ** jacobian.powers * jacobian.values
    by_theta = np.zeros((w.size, theta.size + 2), dtype=complex)  # two more inputs: speed and eccentricity
    np.add.at(by_theta.T, jacobian.inputs, entries.T)
    slope, solved, group = by_theta[:, : theta.size], fit.settings.solved, condition.group
    moved = by_values_of_causes(fit, slope, group, speed) if solved else np.zeros((w.size, 0), dtype=complex)
    if solved:
        added = stiffness_slopes(model, theta, np.asarray(s.imag), np.asarray(speed), solved)
        moved = moved + np.einsum("kwij,wij->wk", added, weight)
    direct, quadrature = half_width(fit, group, slope.real, moved.real), half_width(fit, group, slope.imag, moved.imag)
    return _Line(frequency=w, kappa=value, direct=direct, quadrature=quadrature)


def _limits(pair: tuple[Any, ...], factor: float, curves: Sequence[_Line], points: Sequence[Points]) -> None:
    """Axes hold the fit with its band, not the scatter of the data; of a constant, what its readings scatter by."""
    size = max(float(np.abs(line.kappa).max()) for line in curves)
    sigma = factor * np.concatenate([np.zeros(0), *(p.sigma for p in points)])
    least = 6 * float(np.quantile(sigma, 0.25)) if sigma.size else 0.0  # of readings that tell it well
    for axis in dict.fromkeys(pair):
        drawn = [
            (line.kappa.imag, line.quadrature) if number else (line.kappa.real, line.direct)
            for own, number in zip(pair, (0, 1), strict=True)
            if own is axis
            for line in curves
        ]
        alone = [value for value, _ in drawn]
        # a band that filled the panel would not be seen as one
        ends = [factor * (value + side * half) for value, half in drawn for side in (-1.5, 1.5)]
        fitted = np.concatenate([factor * value for value in alone])
        both = np.concatenate(ends)
        if np.ptp(fitted) > least:  # a band of what is hardly determined leaves room for the fit
            beyond = 0.6 * np.ptp(fitted)
            both = np.clip(both, fitted.min() - beyond, fitted.max() + beyond)
        low, high = float(both.min()), float(both.max())
        reach = max(high - low, least, 1e-6 * factor * size) or 1.0
        middle, half = (low + high) / 2, reach * (0.5 + 0.12)
        axis.set_ylim(middle - half, middle + half)


def _readings(
    fit: FitResult, shown: Sequence[_Shown], pair: tuple[Any, ...], row: int, column: int, against: str
) -> None:
    """Write what the lines mean: intercept and curvature of the direct part, slope of the quadrature part.

    They hold for the last of several speeds, which the box then names.
    """
    theta = fit.thetas
    condition = shown[-1].condition
    speed = 0.0 if np.isnan(condition.speed) else condition.speed
    C = fit.model.coefficients(theta[condition.group], speed)[:, row, column]
    others = [
        fit.model.coefficients(theta[s.condition.group], np.nan_to_num(s.condition.speed))[:, row, column]
        for s in shown[:-1]
    ]
    # Of which condition a coefficient is, where others have another.
    where = ["" if all(np.isclose(other[k], C[k], rtol=1e-6) for other in others) else f", {condition.name}"
             for k in range(len(C))]  # fmt: skip
    stiffness, unit = style.prefix(np.array([C[0].real]), _unit(fit, row, column))
    direct = f"at 0{where[0]}: {_symbols(fit, 0, row, column)}{style.number_words(C[0].real * stiffness)} {unit}"
    if len(C) > 2 and abs(C[2].real) > 0:
        named = "−slope" if against == "square" else "−curvature/2"
        mass = ("kg", "kg m", "kg m²")[[fit.model.coordinates[k].axis for k in (row, column)].count("r")]
        direct += f"    {named}: {_symbols(fit, 2, row, column)}{style.number_words(C[2].real)} {mass}"
    damping = _unit(fit, row, column).replace("N", "N s", 1)
    quadrature = f"slope{where[1]}: {style.number_words(C[1].real)} {damping}" if abs(C[1].real) > 0 else ""
    for axis, text in zip(pair, (direct, quadrature), strict=True):
        if text:
            style.below(axis, text)


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
    axis.axhline(0, color=style.AXES, lw=0.8, zorder=1)
    marked: list[tuple[float, str, str]] = []
    for some in shown:
        condition = some.condition
        whirl = theta[condition.group][names.index("lam")] * condition.speed
        if np.isfinite(whirl) and some.low < whirl < some.high:
            at = float(places(sheet, np.array(whirl), condition.speed, against, squared=False))
            text = f"λΩ = {sheet.rate_words(whirl)}" if against != "ratio" else f"λ = {significant(at, 4)}"
            marked.append((at, text, condition.colour))
            axis.plot(at, 0, "D", ms=4.5, mfc="white", mec=condition.colour, mew=1.2, zorder=5)
    if not marked or len(marked) > _NAMED:
        return
    low, high = axis.get_xlim()
    points = np.concatenate([np.zeros((0, 2)), *(np.asarray(drawn.get_offsets()) for drawn in axis.collections)])
    across, up = (axis.transData + axis.transAxes.inverted()).transform(points).T
    letter = 0.6 * style.SMALL_TYPE / 72 * axis.figure.figure.dpi / axis.bbox.width  # of the axis
    levels = np.arange(0.07, 1.0, 0.14).tolist()  # heights, from below: right of lines that rise nothing is drawn
    for at, text, colour in sorted(marked):
        side, begin = ("right", -1) if at > low + 0.75 * (high - low) else ("left", 0)
        left = (at - low) / (high - low) + begin * letter * len(text)
        inside = (across > left) & (across < left + letter * len(text))
        hidden = [int((inside & (np.abs(up - level) < 0.07)).sum()) for level in levels]
        height = levels.pop(int(np.argmin(hidden)))
        axis.annotate(
            text, (at, 0), (at, height), textcoords=("data", "axes fraction"), ha=side, va="center",
            fontsize=style.SMALL_TYPE, color=colour, zorder=6, path_effects=style.halo(),
            arrowprops={"arrowstyle": "-", "color": colour, "lw": 0.7, "shrinkB": 3, "relpos": (0, 1)},
        )  # fmt: skip


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
    return style.literal(f"{short[0]} – {short[1]}")
