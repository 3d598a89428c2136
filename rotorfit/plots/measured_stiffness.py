"""Measured dynamic stiffness of a test, without any model of the rotor."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from rotorfit.data.experiments import PerturbationTest
from rotorfit.estimators.blocks.observations import acts_alone
from rotorfit.models.array_types import ComplexArray, Float
from rotorfit.models.parameters import unknown_name
from rotorfit.observing.circular import observe
from rotorfit.observing.measured_stiffness import dynamic_stiffness, isotropic_planes
from rotorfit.plots.dynamic_stiffness import AGAINST, abscissa_words
from rotorfit.plots.style import colour_of, grid, legend_below, literal, looked, per_rad_s, prefix, rate_words

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_Entry = tuple[str, Float, Float, ComplexArray, Float]
"""Name of an entry, its frequencies and speeds, rad/s, values and their noise, N/m."""


@looked
def plot_measured_stiffness(
    test: PerturbationTest, planes: Sequence[str] | None = None, against: str = "frequency"
) -> Figure:
    """Direct and quadrature dynamic stiffness of a test: eq. (7), or force over response where it has no solution."""
    if against not in AGAINST:
        raise ValueError(unknown_name("abscissa", against, AGAINST))
    entries = _entries(test, tuple(planes or test.planes))
    speeds = np.unique(np.concatenate([np.round(speed, 2) for _, _, speed, _, _ in entries]))
    swept = speeds.size > 12  # more speeds than a test dwells at: a start-up
    size = np.concatenate([np.abs(kappa) for *_, kappa, _ in entries])
    factor, unit = prefix(np.array([np.quantile(size, 0.9)]), "N/m")
    figure, axes = grid(len(entries), 2, "Measured dynamic stiffness", size=(5.4, 2.2), one_abscissa=True)
    for row, (name, w, speed, kappa, sigma) in zip(axes, entries, strict=True):
        for number, (axis, part) in enumerate(zip(row, (kappa.real, kappa.imag), strict=True)):
            for k, value in enumerate([np.nan] if swept else speeds.tolist()):
                here = np.isfinite(speed) if swept else np.round(speed, 2) == value
                x = _places(w[here], speed[here], against, squared=number == 0)
                style: dict[str, Any] = {"fmt": "o", "ms": 2.2, "elinewidth": 0.5, "alpha": 0.6}
                axis.errorbar(x, factor * part[here], factor * sigma[here], color=colour_of(k, speeds.size), **style)
            middle = factor * part[sigma < 0.5 * np.abs(kappa)]  # near zero frequency an unbalance tells nothing
            if middle.size:
                low, high = float(middle.min()), float(middle.max())
                axis.set_ylim(low - 0.15 * (high - low), high + 0.15 * (high - low) or 1.0)
            axis.axhline(0, color="0.6", lw=0.7, zorder=1)
        row[0].set_ylabel(f"{name}, {unit}", fontsize=8)
    for number, title in enumerate(("direct", "quadrature")):
        axes[0, number].set_title(title, fontsize=8)
        axes[-1, number].set_xlabel(abscissa_words(against, squared=number == 0), fontsize=8)
    if not swept:
        from matplotlib.lines import Line2D

        marks = [Line2D([], [], color=colour_of(k, speeds.size), marker="o", ls="") for k in range(speeds.size)]
        legend_below(figure, marks, [rate_words(value) for value in speeds.tolist()])
    return figure


def _places(frequency: Float, speed: Float, against: str, *, squared: bool) -> Float:
    if against == "square" and squared:
        return frequency**2 / 1e3
    return frequency / speed if against == "ratio" else frequency * per_rad_s()


def _entries(test: PerturbationTest, names: tuple[str, ...]) -> list[_Entry]:
    """Entries of eq. (7), or of the drive points where it has no solution."""
    pairs = [(i, j) for i in range(len(names)) for j in range(len(names))]
    try:
        found = dynamic_stiffness(test, names)
    except ValueError:
        drive = _drive_points(test, names)
        if not drive:
            raise
        return drive
    return [
        (_name(names, i, j), found.frequency, found.speed, found.kappa[:, i, j], found.sigma[:, i, j]) for i, j in pairs
    ]


def _name(names: tuple[str, ...], i: int, j: int) -> str:
    return literal(f"κ {names[i]}–{names[j]}") if len(names) > 1 else "κ"


def _drive_points(test: PerturbationTest, names: tuple[str, ...]) -> list[_Entry]:
    """Force over response at each plane that was forced and read, the others free."""
    chosen = test.select(np.isin(test.plane, names) & np.isin(test.force_plane, names))
    if not len(chosen):
        return []
    block = observe(isotropic_planes(names), chosen, np.zeros(len(chosen), dtype=np.intp))
    line, alone = block.line, acts_alone(block)[block.line]
    found = []
    for p, name in enumerate(names):
        drive = block.force[line, p]
        rows = np.flatnonzero((block.coordinate == p) & (drive != 0) & (block.measured != 0) & alone)
        if rows.size:
            kappa = drive[rows] / block.measured[rows]
            sigma = block.sigma[rows] * np.abs(kappa / block.measured[rows])
            at = line[rows]
            found.append((literal(f"force over response, {name}"), block.frequency[at], block.speed[at], kappa, sigma))
    return found
