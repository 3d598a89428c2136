"""Look and units shared by all figures."""

from __future__ import annotations

from collections.abc import Sequence
from io import BytesIO
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from rotorfit.models.array_types import Float
from rotorfit.plots.layout import PanelLayout
from rotorfit.plots.ticks import few_ticks

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00")
"""Okabe and Ito's palette: told apart by colour-blind readers and in grey."""
GREY = "#666666"
PAGE = (7.08, 8.8)
"""Largest width and height of a figure, inches: what A4 leaves between its margins, so that print keeps its size."""
SMALL = 7
"""Smallest type, points."""


class ShownFigure(Figure):
    """A figure that a notebook shows without pyplot, which would keep every figure ever made."""

    def _repr_png_(self) -> bytes:
        stream = BytesIO()
        self.savefig(stream, format="png", dpi=120)
        return stream.getvalue()


def grid(
    rows: int, columns: int, title: str, *, size: tuple[float, float] = (4.6, 2.3), one_abscissa: bool = False
) -> tuple[Figure, Any]:
    """An empty figure of axes, shape ``(rows, columns)``."""
    width, height = min(size[0] * columns, PAGE[0]), min(size[1] * rows + 0.5, PAGE[1])
    figure = ShownFigure(figsize=(width, height), layout=PanelLayout())
    if title:
        figure.suptitle(title, fontsize=10)
    axes = figure.subplots(rows, columns, squeeze=False, sharex="col" if one_abscissa else "none")
    for axis in axes.flat:
        few_ticks(axis.xaxis)
        few_ticks(axis.yaxis)
        axis.tick_params(labelsize=SMALL)
        axis.grid(color="0.9", linewidth=0.6)
        axis.set_axisbelow(True)
        for side in ("top", "right"):
            axis.spines[side].set_visible(False)
    return figure, axes


def colour_of(number: int, count: int = 0) -> str:
    """Colour of one of several speeds; of more than the palette holds, on a scale from dark to light."""
    if count <= len(COLOURS):
        return COLOURS[number % len(COLOURS)]
    from matplotlib import colormaps
    from matplotlib.colors import to_hex

    return to_hex(colormaps["viridis"](0.92 * number / (count - 1)))


def literal(text: str) -> str:
    """Text from data files as it is: a dollar sign would make matplotlib read it as a formula."""
    return text.replace("$", r"\$")


def prefix(values: Float, unit: str) -> tuple[float, str]:
    """Factor and unit with an SI prefix that brings typical values between 1 and 1000."""
    finite = np.abs(values[np.isfinite(values)])
    top = float(finite.max(initial=0.0))
    for factor, letter in ((1e-9, "G"), (1e-6, "M"), (1e-3, "k"), (1.0, ""), (1e3, "m"), (1e6, "µ"), (1e9, "n")):
        if top * factor >= 1.0:
            return factor, f"{letter}{unit}"
    return 1.0, unit


def legend_below(figure: Figure, handles: Sequence[Any], labels: Sequence[str]) -> None:
    """One legend for all axes, outside of the data, in as many columns as the width holds."""
    if len(labels):
        room = figure.get_figwidth() * 72 / (0.55 * SMALL)  # letters in a row
        columns = int(room / (max(len(label) for label in labels) + 6))
        figure.legend(
            handles,
            labels,
            loc="outside lower center",
            ncols=min(max(columns, 1), len(labels), 6),
            fontsize=SMALL,
            frameon=False,
        )
