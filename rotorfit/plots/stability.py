"""Eigenvalues against rotative speed: where the margin of stability ends."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rotorfit.models import eigenvalues
from rotorfit.plots.style import COLOURS, GREY, RPM, grid, legend_below

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from rotorfit.fitting.result import FitResult

_CONFIDENCE = 1.96


def plot_stability(fit: FitResult, *, group: int = 0) -> Figure:
    """Growth rate and damped frequency of every mode against rotative speed, with the threshold and its 95 % interval.

    Args:
        fit: the fit.
        group: parameter group, where parameters were fitted per attribute.
    """
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    theta = fit.problem.space.theta(fit.x)[group]
    onset = fit.threshold_of(group) if fit.model.speed_dependent else None
    found = onset is not None and np.isfinite(onset.value)
    top = _highest_speed(fit, onset.value if found and onset is not None else np.nan)
    speeds = np.linspace(0.0, top, 400)
    s = _tracked(eigenvalues(fit.model, np.broadcast_to(theta, (speeds.size, theta.size)), speeds))
    s = np.where(np.abs(s) <= fit.stability_band, s, complex(np.nan, np.nan))
    figure, axes = grid(1, 2, f"Stability, {fit.model.name}", size=(5.4, 3.6))
    growth, frequency = axes[0]
    s = s[:, np.isfinite(s).any(axis=0)]
    for mode in range(s.shape[1]):
        for axis, values in ((growth, s[:, mode].real), (frequency, s[:, mode].imag * RPM)):
            axis.plot(speeds * RPM, values, color=COLOURS[mode % len(COLOURS)], lw=1.4)
    growth.axhspan(0, 1e9, color="#D55E00", alpha=0.08, lw=0)
    growth.axhline(0, color=GREY, lw=0.8)
    shown = s.real[np.isfinite(s.real)]
    low = max(float(shown.min()), -8 * float(np.median(np.abs(shown)))) if shown.size else -1.0
    growth.set_ylim(1.1 * low, max(0.12 * abs(low), 1.1 * float(shown.max(initial=0.0))))
    frequency.plot(speeds * RPM, speeds * RPM, "--", color="0.6", lw=0.9)
    frequency.annotate("1×", (0.93 * top * RPM, 0.93 * top * RPM), fontsize=8, color=GREY, ha="right", va="bottom")
    span = np.nanmax(np.abs(s.imag), initial=0.0) * RPM
    frequency.set_ylim(-1.1 * span, 1.1 * span)
    growth.set_ylabel("growth rate, 1/s (unstable above 0)", fontsize=9)
    frequency.set_ylabel("damped frequency, rpm (backward < 0)", fontsize=9)
    handles: list[Any] = []
    labels: list[str] = []
    for axis in (growth, frequency):
        axis.set_xlabel("rotative speed, rpm", fontsize=9)
        axis.set_xlim(0, top * RPM)
        for speed in fit.speeds:
            axis.plot(speed * RPM, 0.0, "^", color="black", ms=6, transform=axis.get_xaxis_transform(), clip_on=False)
        if found and onset is not None:
            axis.axvline(onset.value * RPM, color="#D55E00", lw=1.4)
            if np.isfinite(onset.stderr):
                half = _CONFIDENCE * onset.stderr
                axis.axvspan((onset.value - half) * RPM, (onset.value + half) * RPM, color="#D55E00", alpha=0.3, lw=0)
    if fit.speeds.size:
        handles.append(Line2D([], [], color="black", marker="^", ls=""))
        labels.append("tested speeds")
    if found and onset is not None:
        handles.append(Line2D([], [], color="#D55E00", lw=1.4))
        interval = f" ± {_CONFIDENCE * onset.stderr * RPM:.2g} (95 %)" if np.isfinite(onset.stderr) else ""
        labels.append(f"threshold {onset.value * RPM:.1f}{interval} rpm")
    handles.append(Patch(color="#D55E00", alpha=0.15))
    labels.append("unstable")
    legend_below(figure, handles, labels)
    return figure


def _highest_speed(fit: FitResult, onset: float) -> float:
    """Speed axis that shows the threshold with some room, or the tested speeds where there is none."""
    tested = max(float(np.max(experiment.speed, initial=0.0)) for experiment in fit.experiments)
    return 1.25 * max(onset, tested) if np.isfinite(onset) else 1.5 * max(tested, 1.0)


def _tracked(s: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """Order the eigenvalues of each speed so that every column follows one mode."""
    from scipy.optimize import linear_sum_assignment

    ordered = s.copy()
    for k in range(1, len(s)):
        guess = ordered[k - 1] if k == 1 else 2 * ordered[k - 1] - ordered[k - 2]
        distance = np.nan_to_num(np.abs(guess[:, None] - s[k][None, :]), nan=1e12)
        ordered[k] = s[k][linear_sum_assignment(distance)[1]]
    return ordered
