"""The picture on the first pages: a force, the response, what is read from it with the digits of ``print(fit)``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Arc, Polygon, Rectangle

import rotorfit as rf
from rotorfit.base.digits import with_error
from rotorfit.base.units import RPM_PER_RAD_S
from rotorfit.show.plots import style

SURE_UM = 15.0
"""Amplitude, um, from which readings are drawn in full; smaller ones are mostly noise."""
STEPS = ("1  Turn a known force", "2  Measure the response", "3  Read rotor and fluid")
NAMES = {"D": "damping D", "lam": "velocity ratio λ", "Mf": "fluid inertia Mf"}


def demo_fit() -> rf.FitResult:
    """The fit of the first page and of ``rotorfit demo``."""
    return rf.fit(rf.models.WhirlWhip(), rf.datasets.rig_lumped(), known={"K3": 6000.0})


def numbers(fit: rf.FitResult) -> dict[str, tuple[str, str, str]]:
    """Value, error and unit of what is read, in the digits of the print."""
    found = {}
    for name, words in NAMES.items():
        p = fit.params[name]
        found[words] = (*with_error(p.value, p.stderr), "" if p.unit == "1" else p.unit)
    return found


def _rig(axis: Any) -> None:
    """Disk and journal on a shaft, seen from the side."""
    axis.add_patch(Rectangle((0.2, -0.06), 6.0, 0.12, color="#8B98A5"))
    axis.add_patch(Polygon([(0, -0.75), (0.5, -0.75), (0.25, -0.06)], color="#5F7082"))
    axis.add_patch(Rectangle((2.3, -1.0), 0.6, 2.0, color="#5F7082"))
    for side in (1, -1):
        axis.add_patch(Rectangle((4.7, 0.7 if side > 0 else -0.95), 1.3, 0.25, color=style.INK))
        axis.add_patch(Rectangle((4.7, 0.5 if side > 0 else -0.7), 1.3, 0.2, color="#C6DFF2"))
    axis.add_patch(Rectangle((4.78, -0.5), 1.14, 1.0, color="#5F7082"))
    for x in (3.2, 4.4):
        axis.plot([x, x], [-0.95, -0.2], color=style.INK, lw=2.4, solid_capstyle="butt")
    axis.add_patch(Arc((5.35, 0.0), 1.3, 2.8, theta1=-50, theta2=225, color=style.CRITICAL, lw=1.8))
    axis.add_patch(Polygon([(4.77, -1.05), (5.02, -0.93), (5.10, -1.34)], color=style.CRITICAL))
    axis.text(2.6, 1.2, "disk", ha="center")
    axis.text(3.8, -1.35, "probes", ha="center")
    axis.text(5.35, 1.62, "rotating force", ha="center", color=style.CRITICAL, weight="bold")
    axis.text(5.35, -2.1, "journal in\nits fluid film", ha="center", va="center", color="#2E74AE")
    axis.set(xlim=(-0.1, 6.9), ylim=(-2.6, 2.1), aspect="equal")
    axis.axis("off")


def _response(axis: Any, fit: rf.FitResult) -> None:
    """What the journal answers to a force there, per unit force, with the fitted curve."""
    (test,) = fit.experiments
    for speed, colour, marker, place in ((1000, *_look(0), (-3500, 27)), (2000, *_look(1), (-1950, 68))):
        rows = (np.abs(test.set_speed * RPM_PER_RAD_S - speed) < 1) & (test.direction == "x")
        rows &= (test.plane == "journal") & (test.force_plane == "journal")
        size = 1e6 * np.abs(test.response[rows] / test.force[rows])
        told = np.clip(1e6 * np.abs(test.response[rows]) / SURE_UM, 0.1, 0.85)
        shade = style.shades(colour, told)
        axis.scatter(test.frequency[rows] * RPM_PER_RAD_S, size, s=9, marker=marker, c=shade, linewidths=0)
        for side in (-1, 1):
            w = side * np.linspace(0.5, 380.0, 400)
            curve = fit.model.receptance(fit.theta(), w, speed / RPM_PER_RAD_S)[:, 1, 1]
            axis.plot(w * RPM_PER_RAD_S, 1e6 * np.abs(curve), color=colour, lw=1.5)
        axis.text(*place, f"{speed} rpm", color=colour, weight="bold")
    axis.axvline(0, color=style.AXES, lw=0.7)
    axis.set(xlim=(-3750, 3750), xticks=(-2000, 0, 2000), yscale="log", ylim=(1, 110), yticks=(1, 10, 100))
    axis.set_yticklabels(["1", "10", "100"])
    axis.set(xlabel="frequency of the force, rpm", ylabel="journal, µm/N")
    axis.grid(color=style.GRID, lw=0.6)


def _look(number: int) -> tuple[str, str]:
    return style.COLOURS[number], style.MARKERS[number]


def _read(axis: Any, fit: rf.FitResult) -> None:
    """Three numbers, one below the other."""
    for row, (words, (value, error, unit)) in enumerate(numbers(fit).items()):
        axis.text(0.0, 0.84 - 0.36 * row, words, color=style.GREY, va="center")
        axis.text(1.0, 0.84 - 0.36 * row, f"{value} ± {error} {unit}".strip(), ha="right", va="center", weight="bold")
    axis.axis("off")


def _damping(axis: Any, fit: rf.FitResult) -> None:
    """Damping of the mode that becomes unstable, and where."""
    onset = fit.threshold_speed().to("rpm")
    speeds, least, last = np.linspace(4000, 1000, 61), list[float](), None
    for speed in speeds:
        modes = [(mode.frequency.value, mode.damping.value) for mode in fit.natural_frequencies(speed_rpm=float(speed))]
        start = last or min(modes, key=lambda mode: mode[1])  # followed from where it is unstable
        last = min(modes, key=lambda mode: abs(mode[0] - start[0]) + 200 * abs(mode[1] - start[1]))
        least.append(last[1])
    axis.axhspan(-0.12, 0.0, color=style.UNSTABLE, lw=0)
    axis.axhline(0, color=style.INK, lw=0.9)
    axis.plot(speeds, least, color=style.CRITICAL, lw=2.2)
    axis.plot(onset.value, 0.0, "o", color=style.CRITICAL, mfc="white", ms=6)
    axis.text(1050, -0.06, f"unstable above {onset.value:.0f}", color=style.CRITICAL, weight="bold", va="center")
    axis.text(3950, 0.34, "damping, whirl mode", color=style.CRITICAL, ha="right")
    axis.set(xlim=(1000, 4000), xticks=(1000, 2000, 3000, 4000), ylim=(-0.12, 0.45), yticks=(0, 0.3))
    axis.set_xlabel("shaft speed, rpm")
    axis.grid(color=style.GRID, lw=0.6)


def wide(fit: rf.FitResult) -> Figure:
    """The three steps beside one another."""
    figure = plt.figure(figsize=(9.2, 3.1))
    areas = {"rig": (0.0, 0.03, 0.31, 0.86), "response": (0.385, 0.16, 0.27, 0.70)}
    areas |= {"read": (0.725, 0.52, 0.265, 0.34), "damping": (0.76, 0.16, 0.215, 0.31)}
    axes = {name: figure.add_axes(area) for name, area in areas.items()}
    _fill(axes, fit)
    for left, words in zip((0.01, 0.37, 0.725), STEPS, strict=True):
        figure.text(left, 0.93, words, weight="bold", fontsize=10.5)
    return figure


def narrow(fit: rf.FitResult) -> Figure:
    """The same for a telephone, below one another."""
    figure = plt.figure(figsize=(3.75, 6.8))
    areas = {"rig": (0.02, 0.71, 0.96, 0.25), "response": (0.16, 0.445, 0.8, 0.21)}
    areas |= {"read": (0.04, 0.23, 0.92, 0.10), "damping": (0.16, 0.07, 0.78, 0.145)}
    axes = {name: figure.add_axes(area) for name, area in areas.items()}
    _fill(axes, fit)
    for height, words in zip((0.965, 0.675, 0.355), STEPS, strict=True):
        figure.text(0.02, height, words, weight="bold", fontsize=10.5)
    return figure


def _fill(axes: dict[str, Any], fit: rf.FitResult) -> None:
    _rig(axes["rig"])
    _response(axes["response"], fit)
    _read(axes["read"], fit)
    _damping(axes["damping"], fit)
    for name in ("response", "damping"):
        axes[name].spines[["top", "right"]].set_visible(False)


def save(folder: Path) -> None:
    """Draw both forms into a folder."""
    fit = demo_fit()
    look = {"font.size": 8.5, "axes.edgecolor": style.AXES, "text.color": style.INK, "axes.axisbelow": True}
    with plt.rc_context(look):
        for name, draw, dpi in (("overview", wide, 150), ("overview_narrow", narrow, 200)):
            draw(fit).savefig(folder / f"{name}.png", dpi=dpi)
    plt.close("all")
