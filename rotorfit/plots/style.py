"""Look and units shared by all figures."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

RPM = 30 / np.pi
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00")
"""Okabe and Ito's palette: told apart by colour-blind readers and in grey."""
GREY = "#666666"


def grid(rows: int, columns: int, title: str, *, size: tuple[float, float] = (4.6, 2.3)) -> tuple[Figure, Any]:
    """An empty figure of axes, shape ``(rows, columns)``, ``size`` inches each."""
    figure = Figure(figsize=(size[0] * columns, size[1] * rows + 0.5), layout="constrained")
    figure.suptitle(title, fontsize=11)
    axes = figure.subplots(rows, columns, squeeze=False)
    for axis in axes.flat:
        axis.tick_params(labelsize=8)
        axis.grid(color="0.9", linewidth=0.6)
        axis.set_axisbelow(True)
        for side in ("top", "right"):
            axis.spines[side].set_visible(False)
    return figure, axes


def colour_of(number: int) -> str:
    """Colour of the n-th speed."""
    return COLOURS[number % len(COLOURS)]


def literal(text: str) -> str:
    """Text from data files as it is: a dollar sign would make matplotlib read it as a formula."""
    return text.replace("$", r"\$")


def prefix(values: NDArray[np.float64], unit: str) -> tuple[float, str]:
    """Factor and unit with an SI prefix that brings typical values between 1 and 1000."""
    finite = np.abs(values[np.isfinite(values)])
    top = float(finite.max(initial=0.0))
    for factor, letter in ((1e-9, "G"), (1e-6, "M"), (1e-3, "k"), (1.0, ""), (1e3, "m"), (1e6, "µ"), (1e9, "n")):
        if top * factor >= 1.0:
            return factor, f"{letter}{unit}"
    return 1.0, unit


def legend_below(figure: Figure, handles: Sequence[Any], labels: Sequence[str]) -> None:
    """One legend for all axes, outside of the data."""
    if len(labels):
        figure.legend(handles, labels, loc="outside lower center", ncols=min(len(labels), 6), fontsize=8, frameon=False)
