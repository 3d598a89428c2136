"""Figure of a profile: how chi-squared rises when a parameter is held at other values."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from rotorfit.plots.style import COLOURS, GREY, grid, literal
from rotorfit.units import RPM_PER_RAD_S

if TYPE_CHECKING:
    from rotorfit.uncertainty.profile import Profile


def plot_profile(profile: Profile) -> Figure:
    """The profile, the parabola of the standard error, the level of the interval and its ends; speeds in rpm.

    Args:
        profile: the curve.
    """
    from scipy.stats import chi2

    factor, unit = (RPM_PER_RAD_S, "rpm") if profile.unit == "rad/s" else (1.0, profile.unit)
    percent = f"{100 * profile.level:g} %"
    figure, axes = grid(1, 1, "", size=(3.45, 2.5))  # two of them side by side in a report
    axis = axes[0, 0]
    values = profile.values * factor
    axis.plot(values, profile.rise, color=COLOURS[0], marker=".", ms=4, lw=1.3, label="profile")
    if math.isfinite(profile.stderr) and profile.stderr > 0:
        x = np.linspace(profile.values[0], profile.values[-1], 200)
        parabola = ((x - profile.value) / profile.stderr) ** 2
        axis.plot(x * factor, parabola, color=GREY, ls="--", lw=1.0, label="standard error")
    goal = float(chi2.ppf(profile.level, 1))
    axis.axhline(goal, color=COLOURS[1], lw=0.9, label=percent)
    for end in profile.interval:
        if math.isfinite(end):
            axis.axvline(end * factor, color=COLOURS[1], lw=0.9, ls=":")
    shown = profile.rise[np.isfinite(profile.rise)]
    axis.set_ylim(0, 1.15 * max(goal, float(shown.max(initial=0.0))))
    axis.set_xlabel(literal(profile.name.replace("_", " ")) + ("" if unit == "1" else f" ({unit})"), fontsize=8)
    axis.set_ylabel("rise of chi-squared", fontsize=8)
    axis.legend(fontsize=7, frameon=False, loc="upper center")
    return figure
