"""Measured dynamic stiffness of a test, without any model of the rotor."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from rotorfit.base.array_types import ComplexArray, Float
from rotorfit.base.names import unknown_name
from rotorfit.lab.data.experiments import PerturbationTest
from rotorfit.lab.observing.circular import observe
from rotorfit.lab.observing.measured_stiffness import IsotropicPlanes, dynamic_stiffness
from rotorfit.show.plots.dynamic_stiffness import AGAINST, abscissa_words, drive_points, places
from rotorfit.show.plots.style import AXES, Sheet, colour_of, in_colours, legend_below, literal, on_sheet, prefix

_Entry = tuple[str, Float, Float, ComplexArray, Float]
"""Name of an entry, its frequencies and speeds, rad/s, values and their noise, N/m."""


@on_sheet
def plot_measured_stiffness(
    test: PerturbationTest, planes: Sequence[str] | None = None, against: str = "frequency", *, sheet: Sheet
) -> Figure:
    """Direct and quadrature dynamic stiffness of a test: eq. (7), or force over response where it has no solution."""
    if against not in AGAINST:
        raise ValueError(unknown_name("abscissa", against, AGAINST))
    entries = _entries(test, tuple(planes or test.planes))
    speeds = np.unique(np.concatenate([np.round(speed, 2) for _, _, speed, _, _ in entries]))
    swept = speeds.size > 12  # more speeds than a test dwells at: a start-up
    size = np.concatenate([np.abs(kappa) for *_, kappa, _ in entries])
    factor, unit = prefix(np.array([np.quantile(size, 0.9)]), "N/m")
    figure, axes = sheet.grid(len(entries), 2, "Measured dynamic stiffness", size=(5.4, 2.2), one_abscissa=True)
    for row, (name, w, speed, kappa, sigma) in zip(axes, entries, strict=True):
        for number, (axis, part) in enumerate(zip(row, (kappa.real, kappa.imag), strict=True)):
            for k, value in enumerate([np.nan] if swept else speeds.tolist()):
                here = np.isfinite(speed) if swept else np.round(speed, 2) == value
                x = places(sheet, w[here], speed[here], against, squared=number == 0)
                style: dict[str, Any] = {"fmt": "o", "ms": 2.2, "elinewidth": 0.5, "alpha": 0.6}
                axis.errorbar(x, factor * part[here], factor * sigma[here], color=colour_of(k, speeds.size), **style)
            middle = factor * part[sigma < 0.5 * np.abs(kappa)]  # near zero frequency an unbalance tells nothing
            if middle.size:
                low, high = float(middle.min()), float(middle.max())
                axis.set_ylim(low - 0.15 * (high - low), high + 0.15 * (high - low) or 1.0)
            axis.axhline(0, color=AXES, lw=0.7, zorder=1)
        row[0].set_ylabel(f"{name}, {unit}")
    for number, title in enumerate(("direct", "quadrature")):
        axes[0, number].set_title(title)
        axes[-1, number].set_xlabel(abscissa_words(sheet, against, squared=number == 0))
    if not swept:
        names = [sheet.rate_words(value) for value in speeds.tolist()]
        legend_below(figure, {name: {**look, "marker": "o", "ls": ""} for name, look in in_colours(names).items()})
    return figure


def _entries(test: PerturbationTest, names: tuple[str, ...]) -> list[_Entry]:
    """Entries of eq. (7), or where it has no solution force over response at each plane that was forced and read."""
    try:
        found = dynamic_stiffness(test, names)
    except ValueError:
        chosen = test.select(np.isin(test.plane, names) & np.isin(test.force_plane, names))
        none = np.zeros(len(chosen), dtype=np.intp)
        drive = drive_points(observe(IsotropicPlanes(names), chosen, none)) if len(chosen) else []
        if not drive:
            raise
        title = "force over response, {}"
        return [(literal(title.format(names[p.row])), p.frequency, p.speed, p.kappa, p.sigma) for p in drive]
    pairs = [(i, j) for i in range(len(names)) for j in range(len(names))]
    words = {(i, j): literal(f"κ {names[i]}–{names[j]}") if len(names) > 1 else "κ" for i, j in pairs}
    return [(words[i, j], found.frequency, found.speed, found.kappa[:, i, j], found.sigma[:, i, j]) for i, j in pairs]
