"""Eigenvalues against rotative speed: where the margin of stability ends."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from rotorfit.base.array_types import ComplexArray, Float, Index
from rotorfit.base.digits import interval as interval_words
from rotorfit.base.digits import with_error
from rotorfit.base.matching import cheapest_rows
from rotorfit.identify.fitting.causes.slopes import eigenvalue_slopes
from rotorfit.identify.fitting.propagation import theta_at
from rotorfit.identify.fitting.quantities import Quantity
from rotorfit.identify.fitting.result import FitResult
from rotorfit.models import eigenvalues
from rotorfit.models.motion.stability import whirls_forward
from rotorfit.show.plots import style
from rotorfit.show.plots.journal import group_label, speeds_of
from rotorfit.show.plots.shaft_lines import mark_speeds, turning_stability

_THRESHOLD = style.COLOURS[1]
_MODES = tuple(c for c in style.COLOURS if c != _THRESHOLD)
"""Colours of modes: all but the threshold's."""


@style.on_sheet
def plot_stability(fit: FitResult, *, sheet: style.Sheet, group: int = 0, beside: FitResult | None = None) -> Figure:
    """Modes against rotative speed, with the threshold and its 95 % interval.

    Growth rate and damped frequency above, damping ratio and logarithmic decrement below; ``beside`` is drawn dashed.
    """
    if fit.model.turns:
        return turning_stability(sheet, fit)
    onset, tested = _onset_shown(fit, group), _tested_speeds(fit, group)
    # Shows the threshold with some room, or the tested speeds where there is none.
    fastest = max(float(np.max(experiment.speed, initial=0.0)) for experiment in fit.experiments)
    top = 1.5 * max(fastest, 1.0) if onset is None else 1.25 * max(onset.value, fastest)
    other = _onset_shown(beside, group)
    top = top if other is None else max(top, min(1.1 * other.value, 2.5 * top))
    speeds = np.union1d(np.linspace(0.0, top, 400), tested[-1:])  # at which the legend and tables name frequencies
    named_at = int(np.argmin(np.abs(speeds - tested.max(initial=0.0))))
    s, x = _modes(fit, group, speeds, named_at), speeds * sheet.per_rad_s
    label = group_label(fit, group)
    title = f"Stability, {fit.model.name}" + (f", {style.literal(label)}" if label else "")
    figure, axes = sheet.grid(2, 2, title, size=(5.4, 2.6))
    _draw_modes(sheet, axes, x, s)
    if beside is not None:
        _draw_modes(sheet, axes, x, _modes(beside, group, speeds, named_at), ls="--", lw=1.1)
    for axis in axes.flat:
        axis.set(xlabel=f"rotative speed, {sheet.rate_unit}", xlim=(0, x[-1]))
        mark_speeds(sheet, axis, tested.tolist())
        if other is not None:
            axis.axvline(other.value * sheet.per_rad_s, color=_THRESHOLD, lw=1.1, ls="--")
        if onset is not None:
            axis.axvline(onset.value * sheet.per_rad_s, color=_THRESHOLD, lw=1.4)
            if np.isfinite(onset.stderr):
                low, high = (end * sheet.per_rad_s for end in onset.interval(0.95))
                axis.axvspan(low, high, color=_THRESHOLD, alpha=0.3, lw=0)
    frequency = axes[0, 1]
    frequency.plot(x, x, "--", color="0.6", lw=0.9)
    span = np.nanmax(np.abs(s.imag), initial=0.0)
    frequency.set_ylim(-1.1 * span * sheet.per_rad_s, 1.1 * span * sheet.per_rad_s)
    measured = [part * sheet.per_rad_s for part in _resonances(fit, group, tested, span)]
    frequency.plot(*measured, "o", ms=5, mfc="none", mec="black", mew=0.9, zorder=4)
    modes = _mode_names(sheet, s[named_at], float(tested.max(initial=0.0)))
    entries: dict[str, Any] = {name: {"color": _MODES[i % len(_MODES)], "lw": 1.4} for i, name in enumerate(modes)}
    if onset is not None:
        entries[_threshold_words(sheet, onset)] = {"color": _THRESHOLD, "lw": 1.4}
    if beside is not None:
        entries[_beside_words(sheet, beside, other)] = {"color": "black", "lw": 1.1, "ls": "--"}
    entries["unstable"] = Patch(color=_THRESHOLD, alpha=0.15)
    entries["1×: frequency = speed"] = {"color": "0.6", "lw": 0.9, "ls": "--"}
    if tested.size:
        entries["tested speeds"] = {"color": "black", "marker": "^", "ls": ""}
    if measured[0].size:
        entries["resonances of the responses"] = {"color": "black", "marker": "o", "mfc": "none", "ls": ""}
    style.legend_below(figure, entries)
    return figure


def _onset_shown(fit: FitResult | None, group: int) -> Quantity | None:
    """The threshold speed that is drawn, where there is one."""
    if fit is None or not fit.model.speed_dependent or not np.isfinite(fit.threshold_of(group).value):
        return None
    return fit.threshold_of(group)


def _beside_words(sheet: style.Sheet, beside: FitResult, onset: Quantity | None) -> str:
    return style.literal(beside.message) + ("" if onset is None else f": {_threshold_words(sheet, onset)}")


def _draw_modes(sheet: style.Sheet, axes: Any, x: Float, s: ComplexArray, **look: Any) -> None:
    """Growth rate and frequency of each mode above, its damping ratio and decrement below."""
    zeta = -s.real / np.where(np.abs(s) > 0, np.abs(s), np.nan)
    overdamped = 0.99  # damping ratio from which a mode no longer oscillates and has no decrement
    swings = np.abs(zeta) < overdamped
    delta = np.where(swings, 2 * np.pi * zeta / np.sqrt(np.where(swings, 1 - zeta**2, 1.0)), np.nan)
    panels = {
        "growth rate, 1/s": s.real,
        f"damped frequency, {sheet.rate_unit}": s.imag * sheet.per_rad_s,
        "damping ratio": zeta,
        "logarithmic decrement": delta,
    }
    for axis, (name, values) in zip(axes.flat, panels.items(), strict=True):
        axis.set_ylabel(name)
        for mode in range(s.shape[1]):
            axis.plot(x, values[:, mode], color=_MODES[mode % len(_MODES)], **{"lw": 1.4, **look})
    largest = 3.0  # largest decrement worth a place on its axis: what matters is near zero
    _unstable_half(axes[0, 0], s.real, above=True)
    _unstable_half(axes[1, 0], zeta, above=False)
    _unstable_half(axes[1, 1], np.minimum(delta, largest), above=False)


def _threshold_words(sheet: style.Sheet, onset: Quantity) -> str:
    low, high = (sheet.per_rad_s * end for end in onset.interval(0.95))
    known = np.isfinite(high) and high > low
    value = with_error(onset.value * sheet.per_rad_s, (high - low) / 4 if known else np.nan)[0]
    return f"threshold {value} {sheet.rate_unit}" + (f", 95 % {interval_words(low, high)}" if known else "")


def _tested_speeds(fit: FitResult, group: int) -> Float:
    """Tested speeds, rad/s, at which a group has readings."""
    if not fit.speeds.size:
        return fit.speeds
    near = [_nearest(fit.speeds, speeds_of(block, group)) for block in fit.problem.blocks]
    return np.asarray(fit.speeds[np.unique(np.concatenate(near))])


def _nearest(speeds: Float, to: Float) -> Index:
    """Which of the speeds, in ascending order, is nearest to each of others."""
    return np.searchsorted((speeds[1:] + speeds[:-1]) / 2, to)


def _resonances(fit: FitResult, group: int, tested: Float, span: float) -> tuple[Float, Float]:
    """Tested speeds and the frequencies, rad/s, at which measured responses peak there (Fig. 32)."""
    found: list[tuple[float, float]] = []
    for base in (b for b in fit.problem.responses if not b.imposed):
        drive = np.abs(base.force).max(axis=1)[base.line]
        nearest = _nearest(tested, base.speed)
        for number, speed in enumerate(tested.tolist()):
            mine = ((base.group == group) & (nearest == number))[base.line] & (drive > 0)
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
    axis.axhline(0, color=style.GREY, lw=0.8)
    limits = (low, 1.1 * high)
    axis.set_ylim([-limits[1], -limits[0]] if above else limits)
    axis.axhspan(*((0, -low) if above else (low, 0)), color=_THRESHOLD, alpha=0.1, lw=0)


def _modes(fit: FitResult, group: int, speeds: Float, at: int) -> ComplexArray:
    """Eigenvalues of the rotor with the causes that were found, up to the band, at each speed; each column those of one
    mode, with the sign of its whirl at one of the speeds: in x and y one of each conjugate pair."""
    theta = theta_at(fit, group, float(speeds[at]))
    s = eigenvalues(fit.model, np.array([theta_at(fit, group, speed) for speed in speeds.tolist()]), speeds)
    for k in range(1, len(s)):
        guess = s[k - 1] if k == 1 else 2 * s[k - 1] - s[k - 2]
        s[k] = s[k][cheapest_rows(np.nan_to_num(np.abs(s[k][:, None] - guess), nan=1e12))]
    s = np.where(np.abs(s) <= fit.stability_band, s, complex(np.nan, np.nan))
    s = s[:, np.isfinite(s).any(axis=0)]
    s = s + _shifts(fit, group, speeds, s, at)
    if fit.model.frame != "xy":
        return s
    s = s[:, s[at].imag >= 0]
    forward = whirls_forward(fit.model, theta, float(speeds[at]), s[at])
    return np.asarray(s.real + 1j * np.where(forward, 1.0, -1.0) * np.abs(s.imag))


def _shifts(fit: FitResult, group: int, speeds: Float, s: ComplexArray, at: int) -> ComplexArray:
    """What causes beside the values of the model change of eigenvalues, as the tables of modes have it: worked out at
    some speeds, and along straight lines between them."""
    solved = fit.settings.solved
    found = np.zeros_like(s)
    if solved is None:
        return found
    places = np.unique([at, *np.linspace(0, speeds.size - 1, 21).astype(int)])
    for mode in range(s.shape[1]):
        some = places[np.isfinite(s[places, mode])]
        if some.size:
            moved = [
                eigenvalue_slopes(fit.model, theta_at(fit, group, v), v, value, solved) @ solved.errors.value
                for v, value in zip(speeds[some].tolist(), s[some, mode].tolist(), strict=True)
            ]
            found[:, mode] = np.interp(speeds, speeds[some], moved)
    return found


def _mode_names(sheet: style.Sheet, s: ComplexArray, at: float) -> list[str]:
    """Words for each mode: its whirl and its frequency at a speed."""
    return [
        f"{'forward' if value.imag > 0 else 'backward'} mode, {sheet.rate_words(abs(value.imag))} at "
        f"{sheet.rate_words(at)}"
        if np.isfinite(value)
        else "mode beyond the tested band"
        for value in s
    ]
