"""Eigenvalues against rotative speed: where the margin of stability ends."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from rotorfit.estimators.blocks.nonlinear import responses_of
from rotorfit.estimators.matching import cheapest_rows
from rotorfit.fitting.digits import interval as interval_words
from rotorfit.fitting.quantities import THRESHOLD
from rotorfit.models import AnisotropicShaft, Turning, eigenvalues
from rotorfit.models.array_types import ComplexArray, Float
from rotorfit.plots.journal import group_label
from rotorfit.plots.shaft_lines import plot_turning_stability
from rotorfit.plots.style import COLOURS, GREY, grid, legend_below, literal
from rotorfit.units import RPM_PER_RAD_S

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from rotorfit.fitting.quantities import Quantity
    from rotorfit.fitting.result import FitResult


_THRESHOLD = COLOURS[1]
_MODES = tuple(c for c in COLOURS if c != _THRESHOLD)
"""Colours of modes: all but the threshold's."""


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
    top = _highest_speed(fit, np.nan if onset is None else onset.value)
    speeds = np.linspace(0.0, top, 400)
    s = _tracked(eigenvalues(fit.model, np.broadcast_to(theta, (speeds.size, theta.size)), speeds))
    s = np.where(np.abs(s) <= fit.stability_band, s, complex(np.nan, np.nan))
    s = s[:, np.isfinite(s).any(axis=0)]
    label = group_label(fit, group)
    title = f"Stability, {fit.model.name}" + (f", {literal(label)}" if label else "")
    figure, axes = grid(2, 2, title, size=(5.4, 2.6))
    growth, frequency, damping, decrement = axes.flat
    size = np.where(np.abs(s) > 0, np.abs(s), np.nan)
    zeta = -s.real / size
    overdamped = 0.99  # damping ratio from which a mode no longer oscillates and has no decrement
    swings = np.abs(zeta) < overdamped
    delta = np.where(swings, 2 * np.pi * zeta / np.sqrt(np.where(swings, 1 - zeta**2, 1.0)), np.nan)
    panels = ((growth, s.real), (frequency, s.imag * RPM_PER_RAD_S), (damping, zeta), (decrement, delta))
    for axis, values in panels:
        for mode in range(s.shape[1]):
            axis.plot(speeds * RPM_PER_RAD_S, values[:, mode], color=_MODES[mode % len(_MODES)], lw=1.4)
        axis.set_xlabel("rotative speed, rpm", fontsize=8)
        axis.set_xlim(0, top * RPM_PER_RAD_S)
        _mark_tested(axis, tested)
        _mark_threshold(axis, onset)
    _unstable_half(growth, s.real, above=True)
    _unstable_half(damping, zeta, above=False)
    largest = 3.0  # largest decrement worth a place on its axis: what matters is near zero
    _unstable_half(decrement, np.minimum(delta, largest), above=False)
    frequency.plot(speeds * RPM_PER_RAD_S, speeds * RPM_PER_RAD_S, "--", color="0.6", lw=0.9)
    span = np.nanmax(np.abs(s.imag), initial=0.0) * RPM_PER_RAD_S
    frequency.set_ylim(-1.1 * span, 1.1 * span)
    names = ("growth rate, 1/s", "damped frequency, rpm", "damping ratio", "logarithmic decrement")
    for axis, name in zip((growth, frequency, damping, decrement), names, strict=True):
        axis.set_ylabel(name, fontsize=8)
    _legend(figure, _mode_names(s, speeds, float(tested.max(initial=0.0))), onset, tested=bool(tested.size))
    return figure


def _mark_tested(axis: Any, speeds: Float) -> None:
    """A triangle on the speed axis at each tested speed."""
    for speed in speeds.tolist():
        at = speed * RPM_PER_RAD_S
        axis.plot(at, 0.0, "^", color="black", ms=5, clip_on=False, transform=axis.get_xaxis_transform())


def _tested_speeds(fit: FitResult, group: int) -> Float:
    """Speeds, rad/s, at which the group's data were measured; none where the speed was swept."""
    blocks = [b for b in map(responses_of, fit.problem.blocks) if b is not None]
    mine = [np.unique(b.speed[b.group == group]) for b in blocks]
    distinct = np.unique(np.concatenate([*mine, np.zeros(0)]))
    return distinct if np.isin(distinct, fit.speeds).all() else np.zeros(0)


def _mark_threshold(axis: Any, onset: Quantity | None) -> None:
    if onset is None:
        return
    axis.axvline(onset.value * RPM_PER_RAD_S, color=_THRESHOLD, lw=1.4)
    if np.isfinite(onset.stderr):
        low, high = onset.interval(0.95)
        axis.axvspan(low * RPM_PER_RAD_S, high * RPM_PER_RAD_S, color=_THRESHOLD, alpha=0.3, lw=0)


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


def _mode_names(s: ComplexArray, speeds: Float, at: float) -> list[str]:
    """Words for each mode: its whirl and its frequency at a speed."""
    row = s[int(np.argmin(np.abs(speeds - at)))]
    whirl = ["forward" if value.imag > 0 else "backward" for value in row]
    rpm = np.abs(row.imag) * RPM_PER_RAD_S
    return [
        f"{way} mode, {f:.4g} rpm at {at * RPM_PER_RAD_S:.4g} rpm" if np.isfinite(f) else "mode beyond the tested band"
        for way, f in zip(whirl, rpm.tolist(), strict=True)
    ]


def _legend(figure: Figure, modes: list[str], onset: Quantity | None, *, tested: bool) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    handles: list[Any] = [Line2D([], [], color=_MODES[i % len(_MODES)], lw=1.4) for i in range(len(modes))]
    labels = list(modes)
    if onset is not None:
        handles.append(Line2D([], [], color=_THRESHOLD, lw=1.4))
        low, high = (RPM_PER_RAD_S * end for end in onset.interval(0.95))
        interval = f", 95 % {interval_words(low, high)}" if np.isfinite(high) else ""
        labels.append(f"threshold {onset.value * RPM_PER_RAD_S:.5g}{interval} rpm")
    handles.append(Patch(color=_THRESHOLD, alpha=0.15))
    labels.append("unstable")
    handles.append(Line2D([], [], color="0.6", lw=0.9, ls="--"))
    labels.append("1×: frequency = speed")
    if tested:
        handles.append(Line2D([], [], color="black", marker="^", ls=""))
        labels.append("tested speeds")
    legend_below(figure, handles, labels)


def _highest_speed(fit: FitResult, onset: float) -> float:
    """Speed axis that shows the threshold with some room, or the tested speeds where there is none."""
    tested = max(float(np.max(experiment.speed, initial=0.0)) for experiment in fit.experiments)
    return 1.25 * max(onset, tested) if np.isfinite(onset) else 1.5 * max(tested, 1.0)


def _tracked(s: ComplexArray) -> ComplexArray:
    """Order the eigenvalues of each speed so that every column follows one mode."""
    ordered = s.copy()
    for k in range(1, len(s)):
        guess = ordered[k - 1] if k == 1 else 2 * ordered[k - 1] - ordered[k - 2]
        distance = np.nan_to_num(np.abs(s[k][:, None] - guess), nan=1e12)
        ordered[k] = s[k][cheapest_rows(distance)]
    return ordered
