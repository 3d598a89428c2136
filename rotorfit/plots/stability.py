"""Eigenvalues against rotative speed: where the margin of stability ends."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from rotorfit.estimators.blocks.nonlinear import responses_of
from rotorfit.estimators.matching import cheapest_rows
from rotorfit.fitting.quantities import THRESHOLD, Quantity
from rotorfit.fitting.result import FitResult
from rotorfit.models import AnisotropicShaft, Turning, eigenvalues
from rotorfit.models.array_types import ComplexArray, Float
from rotorfit.models.digits import interval as interval_words
from rotorfit.models.digits import with_error
from rotorfit.models.motion.stability import whirls_forward
from rotorfit.plots.journal import group_label
from rotorfit.plots.shaft_lines import mark_speeds, plot_turning_stability
from rotorfit.plots.style import COLOURS, GREY, grid, legend_below, literal, looked, per_rad_s, rate_unit, rate_words

_THRESHOLD = COLOURS[1]
_MODES = tuple(c for c in COLOURS if c != _THRESHOLD)
"""Colours of modes: all but the threshold's."""


@looked
def plot_stability(fit: FitResult, *, group: int = 0) -> Figure:
    """Modes against rotative speed, with the threshold and its 95 % interval.

    Growth rate and damped frequency above, damping ratio and logarithmic decrement below.
    """
    if isinstance(fit.model, AnisotropicShaft | Turning):
        return plot_turning_stability(fit)
    theta = fit.thetas[group]
    onset = (
        replace(fit.threshold_of(group), systematic=fit.systematic(THRESHOLD)) if fit.model.speed_dependent else None
    )
    onset = onset if onset is not None and np.isfinite(onset.value) else None
    tested = _tested_speeds(fit, group)
    # Shows the threshold with some room, or the tested speeds where there is none.
    fastest = max(float(np.max(experiment.speed, initial=0.0)) for experiment in fit.experiments)
    top = 1.5 * max(fastest, 1.0) if onset is None else 1.25 * max(onset.value, fastest)
    speeds = np.union1d(np.linspace(0.0, top, 400), tested[-1:])  # at which the legend and tables name frequencies
    s = _tracked(eigenvalues(fit.model, np.broadcast_to(theta, (speeds.size, theta.size)), speeds))
    s = np.where(np.abs(s) <= fit.stability_band, s, complex(np.nan, np.nan))
    s = _by_whirl(fit, theta, s[:, np.isfinite(s).any(axis=0)], speeds, float(tested.max(initial=0.0)))
    label = group_label(fit, group)
    title = f"Stability, {fit.model.name}" + (f", {literal(label)}" if label else "")
    figure, axes = grid(2, 2, title, size=(5.4, 2.6))
    growth, frequency, damping, decrement = axes.flat
    size = np.where(np.abs(s) > 0, np.abs(s), np.nan)
    zeta = -s.real / size
    overdamped = 0.99  # damping ratio from which a mode no longer oscillates and has no decrement
    swings = np.abs(zeta) < overdamped
    delta = np.where(swings, 2 * np.pi * zeta / np.sqrt(np.where(swings, 1 - zeta**2, 1.0)), np.nan)
    panels = ((growth, s.real), (frequency, s.imag * per_rad_s()), (damping, zeta), (decrement, delta))
    for axis, values in panels:
        for mode in range(s.shape[1]):
            axis.plot(speeds * per_rad_s(), values[:, mode], color=_MODES[mode % len(_MODES)], lw=1.4)
        axis.set_xlabel(f"rotative speed, {rate_unit()}")
        axis.set_xlim(0, top * per_rad_s())
        mark_speeds(axis, tested.tolist())
        if onset is not None:
            _mark_threshold(axis, onset)
    _unstable_half(growth, s.real, above=True)
    _unstable_half(damping, zeta, above=False)
    largest = 3.0  # largest decrement worth a place on its axis: what matters is near zero
    _unstable_half(decrement, np.minimum(delta, largest), above=False)
    frequency.plot(speeds * per_rad_s(), speeds * per_rad_s(), "--", color="0.6", lw=0.9)
    span = np.nanmax(np.abs(s.imag), initial=0.0) * per_rad_s()
    frequency.set_ylim(-1.1 * span, 1.1 * span)
    measured = _resonances(fit, group, tested, span / per_rad_s())
    frequency.plot(*(part * per_rad_s() for part in measured), "o", ms=5, mfc="none", mec="black", mew=0.9, zorder=4)
    names = ("growth rate, 1/s", f"damped frequency, {rate_unit()}", "damping ratio", "logarithmic decrement")
    for axis, name in zip((growth, frequency, damping, decrement), names, strict=True):
        axis.set_ylabel(name)
    modes = _mode_names(s, speeds, float(tested.max(initial=0.0)))
    entries: dict[str, Any] = {name: {"color": _MODES[i % len(_MODES)], "lw": 1.4} for i, name in enumerate(modes)}
    if onset is not None:
        entries[_threshold_words(onset)] = {"color": _THRESHOLD, "lw": 1.4}
    entries["unstable"] = Patch(color=_THRESHOLD, alpha=0.15)
    entries["1×: frequency = speed"] = {"color": "0.6", "lw": 0.9, "ls": "--"}
    if tested.size:
        entries["tested speeds"] = {"color": "black", "marker": "^", "ls": ""}
    if measured[0].size:
        entries["resonances of the responses"] = {"color": "black", "marker": "o", "mfc": "none", "ls": ""}
    legend_below(figure, entries)
    return figure


def _mark_threshold(axis: Any, onset: Quantity) -> None:
    axis.axvline(onset.value * per_rad_s(), color=_THRESHOLD, lw=1.4)
    if np.isfinite(onset.stderr):
        low, high = onset.interval(0.95)
        axis.axvspan(low * per_rad_s(), high * per_rad_s(), color=_THRESHOLD, alpha=0.3, lw=0)


def _threshold_words(onset: Quantity) -> str:
    low, high = (per_rad_s() * end for end in onset.interval(0.95))
    known = np.isfinite(high) and high > low
    value = with_error(onset.value * per_rad_s(), (high - low) / 4 if known else np.nan)[0]
    return f"threshold {value} {rate_unit()}" + (f", 95 % {interval_words(low, high)}" if known else "")


def _tested_speeds(fit: FitResult, group: int) -> Float:
    """Speeds, rad/s, at which the group's data were measured; none where the speed was swept."""
    blocks = [b for b in map(responses_of, fit.problem.blocks) if b is not None]
    mine = [np.unique(b.speed[b.group == group]) for b in blocks]
    distinct = np.unique(np.concatenate([*mine, np.zeros(0)]))
    return distinct if np.isin(distinct, fit.speeds).all() else np.zeros(0)


def _resonances(fit: FitResult, group: int, tested: Float, span: float) -> tuple[Float, Float]:
    """Tested speeds and the frequencies, rad/s, at which measured responses peak there (Fig. 32)."""
    found: list[tuple[float, float]] = []
    for base in (b for b in map(responses_of, fit.problem.blocks) if b is not None and not b.imposed):
        drive = np.abs(base.force).max(axis=1)[base.line]
        for speed in tested.tolist():
            mine = (base.group == group)[base.line] & (base.speed[base.line] == speed) & (drive > 0)
            for label in np.unique(base.label[mine]).tolist():
                rows = np.flatnonzero(mine & (base.label == label) & (base.sigma < 0.2 * np.abs(base.measured)))
                found += [
                    (speed, w) for w in _peaks(base.frequency[base.line[rows]], base.measured[rows] / drive[rows])
                ]
    shown = np.array([pair for pair in found if abs(pair[1]) <= span]).reshape(-1, 2)
    return shown[:, 0], shown[:, 1]


def _peaks(w: Float, response: ComplexArray) -> list[float]:
    """Frequencies of the peaks of a response from which it falls to half on either side before it rises again."""
    found: list[float] = []
    for side in (w < 0, w > 0):
        order = np.argsort(w[side])
        size, at = np.abs(response[side])[order], w[side][order]
        for k, top in enumerate(size.tolist()):
            ends = [part[(part > top) | (part < top / 2)][:1] for part in (size[:k][::-1], size[k + 1 :])]
            if all(end.size and end[0] < top for end in ends):
                found.append(float(at[k]))
    return found


def _unstable_half(axis: Any, values: Float, *, above: bool) -> None:
    """Limits that leave out modes of far more damping than the others, and a tint where motion grows."""
    stable = -values if above else values
    shown = stable[np.isfinite(stable)]
    high = min(float(shown.max()), 8 * float(np.median(np.abs(shown)))) if shown.size else 1.0
    high = high if high > 0 else 1.0
    low = min(-0.12 * high, 1.1 * float(shown.min(initial=0.0)))
    axis.axhline(0, color=GREY, lw=0.8)
    if above:
        axis.set_ylim(-1.1 * high, -low)
        axis.axhspan(0, -low, color=_THRESHOLD, alpha=0.1, lw=0)
    else:
        axis.set_ylim(low, 1.1 * high)
        axis.axhspan(low, 0, color=_THRESHOLD, alpha=0.1, lw=0)


def _by_whirl(fit: FitResult, theta: Float, s: ComplexArray, speeds: Float, at: float) -> ComplexArray:
    """Modes with the sign of their whirl at a speed: in x and y one of each conjugate pair."""
    if fit.model.frame != "xy":
        return s
    k = int(np.argmin(np.abs(speeds - at)))
    s = s[:, s[k].imag >= 0]
    forward = whirls_forward(fit.model, theta, float(speeds[k]), s[k])
    return np.asarray(s.real + 1j * np.where(forward, 1.0, -1.0) * np.abs(s.imag))


def _mode_names(s: ComplexArray, speeds: Float, at: float) -> list[str]:
    """Words for each mode: its whirl and its frequency at a speed."""
    row = s[int(np.argmin(np.abs(speeds - at)))]
    whirl = ["forward" if value.imag > 0 else "backward" for value in row]
    return [
        f"{way} mode, {rate_words(f)} at {rate_words(at)}" if np.isfinite(f) else "mode beyond the tested band"
        for way, f in zip(whirl, np.abs(row.imag).tolist(), strict=True)
    ]


def _tracked(s: ComplexArray) -> ComplexArray:
    """Order the eigenvalues of each speed so that every column follows one mode."""
    ordered = s.copy()
    for k in range(1, len(s)):
        guess = ordered[k - 1] if k == 1 else 2 * ordered[k - 1] - ordered[k - 2]
        distance = np.nan_to_num(np.abs(s[k][:, None] - guess), nan=1e12)
        ordered[k] = s[k][cheapest_rows(distance)]
    return ordered
