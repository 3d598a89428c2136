"""Look and units shared by all figures."""

from __future__ import annotations

from collections.abc import Sequence
from io import BytesIO
from typing import Any, cast

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import Locator, LogFormatter, LogLocator, MaxNLocator

from rotorfit.models.array_types import Float

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00")
"""Okabe and Ito's palette: distinguished by colour-blind readers and in grey."""
GREY = "#666666"
PHASE_LABEL = "phase lead of the probe, deg"
PAGE = (7.08, 8.8)
"""Largest width and height of a figure, inches: what A4 leaves between its margins, so that print keeps its size."""
SMALL_TYPE = 7
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
    figure = ShownFigure(figsize=(width, height), layout="constrained")
    if title:
        figure.suptitle(title, fontsize=10)
    axes = figure.subplots(rows, columns, squeeze=False, sharex="col" if one_abscissa else "none")
    for axis in axes.flat:
        few_ticks(axis.xaxis)
        few_ticks(axis.yaxis)
        axis.tick_params(labelsize=SMALL_TYPE)
        axis.grid(color="0.9", linewidth=0.6)
        axis.set_axisbelow(True)
        for side in ("top", "right"):
            axis.spines[side].set_visible(False)
    return figure, axes


def few_ticks(axis: Any, intervals: int = 6) -> None:
    """Give a linear axis of x or y few ticks."""
    axis.set_major_locator(MaxNLocator(nbins=intervals, steps=[1, 2, 2.5, 5, 10]))


class _BetweenDecades(Locator):
    """Two and five times the powers of ten, or round numbers on an axis that holds fewer than two of these."""

    def tick_values(self, vmin: float, vmax: float) -> list[float]:
        low, high = sorted((vmin, vmax))
        powers = 10.0 ** np.arange(np.floor(np.log10(low)), np.ceil(np.log10(high)) + 1)
        ticks = np.outer(powers, (1.0, 2.0, 5.0)).ravel()
        if np.count_nonzero((ticks >= low) & (ticks <= high)) < 2:
            ticks = np.asarray(MaxNLocator(nbins=3, steps=[1, 2, 5, 10]).tick_values(low, high))
        return [float(tick) for tick in ticks if low <= tick <= high and not np.isclose(powers, tick).any()]

    def __call__(self) -> list[float]:
        return self.tick_values(*cast("Any", self.axis).get_view_interval())


def decade_ticks(axis: Any) -> None:
    """Write the labels of a logarithmic axis as 0.1, 1, 10, with 2 and 5 between where it spans few decades."""
    axis.set_major_locator(LogLocator())
    axis.set_minor_locator(_BetweenDecades())
    axis.set_major_formatter(LogFormatter())
    labelled = 1.5  # decades of a logarithmic axis up to which ticks between powers of ten are labelled too
    axis.set_minor_formatter(LogFormatter(labelOnlyBase=False, minor_thresholds=(labelled, labelled)))
    axis.set_tick_params(which="minor", labelsize=axis.get_tick_params(which="major").get("labelsize"))


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
        room = figure.get_figwidth() * 72 / (0.55 * SMALL_TYPE)  # letters in a row
        columns = int(room / (max(len(label) for label in labels) + 6))
        figure.legend(
            handles,
            labels,
            loc="outside lower center",
            ncols=min(max(columns, 1), len(labels), 6),
            fontsize=SMALL_TYPE,
            frameon=False,
        )


def picture_of(figure: Figure, file_format: str = "png", dpi: float = 200.0) -> bytes:
    """A figure as the bytes of a file, drawn once: ``savefig`` draws a figure twice to place its labels."""
    stream = BytesIO()
    if file_format != "png":
        figure.savefig(stream, format=file_format, dpi=dpi)
        return stream.getvalue()
    figure.set_dpi(dpi)
    # Half the time of the default, one file in thirty larger.
    FigureCanvasAgg(figure).print_png(stream, pil_kwargs={"compress_level": 3})
    return stream.getvalue()
