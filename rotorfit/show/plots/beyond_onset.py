"""Whirl beyond the onset, and the threshold under a side load, of fluids that change with eccentricity."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Polygon

from rotorfit.base.array_types import Float
from rotorfit.base.digits import significant
from rotorfit.identify.fitting.causes.slopes import onset_term_slopes
from rotorfit.identify.fitting.propagation import by_values_of_causes
from rotorfit.identify.fitting.result import FitResult
from rotorfit.models.motion.journal import journal
from rotorfit.models.motion.whirl import WhirlBranch, whirl_branch
from rotorfit.show.plots import style
from rotorfit.show.plots.journal import half_width, reach, rig_of

_STABLE, _UNSTABLE = style.COLOURS[0], style.COLOURS[1]


@style.on_sheet
def plot_whirl(fit: FitResult, *, sheet: style.Sheet, group: int = 0, max_speed: float | None = None) -> Figure:
    """Radius and frequency of the self-excited whirl against rotative speed, with the 95 % band of the radius.

    Dashed where the orbit is unstable: there it jumps, or the journal returns to the centre.
    """
    theta = fit.thetas[group]
    onset = fit.threshold_of(group).value
    if not np.isfinite(onset):
        raise ValueError("the fitted rotor is stable at every speed: there is no whirl")
    top = 2.5 * onset if max_speed is None else max_speed
    branch = whirl_branch(fit.model, theta, max_speed=top)
    if branch is None:
        limit = f"{significant(top * sheet.per_rad_s, 5)} {sheet.rate_unit}"
        raise ValueError(f"the threshold speed is beyond {limit}: give max_speed or max_speed_rpm")
    figure, axes = sheet.grid(2, 1, f"{rig_of(fit)}: whirl beyond the onset", size=(5.8, 2.5), one_abscissa=True)
    radius, frequency = axes[:, 0]
    factor, unit = sheet.position_unit
    clearance = journal(fit.model).clearance
    share = onset / branch.speed[0]  # by which the causes that were found move it
    speed = share * branch.speed * sheet.per_rad_s
    for axis, y in (
        (radius, branch.eccentricity * clearance * factor),
        (frequency, branch.frequency * sheet.per_rad_s),
    ):
        for stable, look in ((True, "-"), (False, "--")):
            shown = np.where(branch.stable == stable, y, np.nan)
            axis.plot(speed, shown, look, color=_STABLE if stable else _UNSTABLE, lw=1.4)
        axis.axvline(speed[0], color=style.GREY, lw=0.9, ls=":")
    across = _across(fit, group, branch)
    signs = np.sign(np.gradient(branch.eccentricity)), -np.sign(np.gradient(branch.speed))  # to one side of the branch
    edges = []  # as far in speed as the error of the onset says, still at right angles to the branch that was moved
    for side in (1, -1):
        x = speed + side * signs[0] * across[0] * sheet.per_rad_s
        y = (branch.eccentricity + side * signs[1] * across[1] / share) * clearance * factor
        edges.append(np.column_stack([x, y]))
    radius.add_patch(Polygon(np.concatenate([edges[0], edges[1][::-1]]), color=_STABLE, alpha=style.BAND, lw=0))
    radius.axhline(clearance * factor, color=style.GREY, lw=0.8)
    radius.set_ylabel(f"radius of the journal's orbit, {unit}")
    frequency.set_ylabel(f"frequency of the whirl, {sheet.rate_unit}")
    frequency.set_xlabel(f"rotative speed, {sheet.rate_unit}")
    ratio = branch.frequency[0] / onset
    ends = np.array([speed[0], speed.max()])
    frequency.plot(ends, ratio * ends, ":", color=style.GREY, lw=1.0)
    for axis in (radius, frequency):
        axis.set_xlim(speed[0] - 0.1 * np.ptp(ends), speed.max() + 0.03 * np.ptp(ends))
    radius.set_ylim(bottom=0)
    entries: dict[str, Any] = {"stable whirl, 95 % band": {"color": _STABLE, "lw": 1.4}}
    if not branch.stable.all():
        entries["unstable"] = {"color": _UNSTABLE, "lw": 1.4, "ls": "--"}
    entries[f"onset, and {ratio:.3f} times the speed"] = {"lw": 1.0, "ls": ":"}
    style.legend_below(figure, entries | {"clearance": {"lw": 0.8}})
    return figure


def _across(fit: FitResult, group: int, branch: WhirlBranch) -> list[Float]:
    """Half-widths of the 95 % band in speed, rad/s, and eccentricity, at right angles to the branch. What acts beside
    the values of the model moves speeds by the same share as the onset."""
    onset, solved = fit.onset(group), fit.settings.solved
    moved = np.zeros((branch.speed.size, 2, 0))
    if onset is not None and solved is not None:
        size = np.array([onset.speed, 1.0])
        along = np.column_stack([np.gradient(branch.speed), np.gradient(branch.eccentricity)]) / size
        normal = np.column_stack([along[:, 1], -along[:, 0]]) / np.hypot(*along.T)[:, None]
        shift = np.outer(branch.speed, onset_term_slopes(fit.model, fit.thetas[group], onset, solved)) / onset.speed**2
        moved = by_values_of_causes(fit, branch.gradient, group, branch.speed[:, None])
        moved = moved + (normal * size)[:, :, None] * (normal[:, :1] * shift)[:, None]
    return [half_width(fit, group, branch.gradient[:, place], moved[:, place]) for place in (0, 1)]


@style.on_sheet
def plot_side_load(fit: FitResult, *, sheet: style.Sheet) -> Figure:
    """Threshold speed against the static eccentricity of the journal, and against the load that holds it there.

    A load moves the journal to where the film is stiffer and turns slower: the rotor is stable up to a higher speed.
    """
    if len(fit.problem.space.index) > 1:
        raise ValueError("parameters differ between tests: fit one condition for a figure of its threshold")
    eps, values, ends, loads = _thresholds(fit)
    if eps.size < 2:
        raise ValueError("the fitted rotor has no threshold speed at any eccentricity that could be searched")
    figure, axes = sheet.grid(1, 2, f"{rig_of(fit)}: threshold speed under a side load", size=(3.5, 2.8))
    factor, unit = style.prefix(loads, "N")
    for axis, x, words in zip(
        axes[0],
        (eps, factor * loads),
        ("static eccentricity over clearance", f"side load at the journal, {unit}"),
        strict=True,
    ):
        axis.plot(x, values * sheet.per_rad_s, color=_STABLE, lw=1.4)
        axis.fill_between(x, *(ends * sheet.per_rad_s), color=_STABLE, alpha=style.BAND, lw=0)
        axis.fill_between(x, values * sheet.per_rad_s, axis.get_ylim()[1], color=_UNSTABLE, alpha=0.08, lw=0)
        axis.set_xlabel(words)
        axis.set_xlim(0, float(x.max()))
        axis.set_ylabel(f"threshold speed, {sheet.rate_unit}")
    entries = {
        "threshold speed and 95 % band": Patch(color=_STABLE, alpha=0.5),
        "unstable": Patch(color=_UNSTABLE, alpha=0.15),
    }
    style.legend_below(figure, entries)
    return figure


def _thresholds(fit: FitResult) -> tuple[Float, Float, Float, Float]:
    """Eccentricities, thresholds and the ends of their intervals, rad/s, and side loads, N."""
    model, theta = fit.model, fit.theta()
    seat = journal(model)
    rows = []
    for eps in np.linspace(0.0, min(0.9, 1.15 * max(reach(fit), 0.4)), 25).tolist():
        found = fit.threshold_speed(eccentricity=eps)
        if not np.isfinite(found.value):
            break  # stable at every speed from here on
        held = model.receptance(theta, 0.0, found.value, eps)[seat.at, seat.at]
        ends = found.interval(0.95) if np.isfinite(found.stderr) else (np.nan, np.nan)
        rows.append((eps, found.value, *ends, eps * seat.clearance / abs(held)))
    columns = np.array(rows).reshape(-1, 5).T
    return columns[0], columns[1], columns[2:4], columns[4]
