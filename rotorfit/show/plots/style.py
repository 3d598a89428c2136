"""Look and units shared by all figures."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import wraps
from inspect import Parameter, Signature, signature
from io import BytesIO
from typing import Any, cast

import numpy as np
from matplotlib import rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure, FigureBase, SubFigure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.lines import Line2D
from matplotlib.ticker import Locator, LogFormatter, LogLocator, MaxNLocator
from PIL import Image

from rotorfit.base.array_types import ComplexArray, Float
from rotorfit.base.digits import significant
from rotorfit.base.names import unknown_name
from rotorfit.base.units import UNITS

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00")
"""Okabe and Ito's palette: distinguished by colour-blind readers and in grey."""
GREY = "#666666"
PHASE_LABEL = "phase lead of the probe, deg"
PAGE = (7.08, 8.8)
"""Largest width and height of a figure, inches: what A4 leaves between its margins, so that print keeps its size."""
SMALL_TYPE, TYPE = 7, 8
"""Smallest type and that of names, points."""
_SETTINGS: Any = {
    "axes.titlesize": TYPE, "axes.labelsize": TYPE, "legend.fontsize": SMALL_TYPE, "legend.frameon": False,
    "axes.titley": 1.0,  # nothing stands above the axes that a title would have to be moved for, which takes long
}  # fmt: skip
"""matplotlib's settings while a figure is drawn."""
BAND = 0.25
"""Opacity of a 95 % band."""
CURVE_POINTS = 800
"""Points of a fitted curve, so many that sharp resonances keep their peaks."""


@dataclass(frozen=True)
class Sheet:
    """Where a figure is drawn, and the units of its frequencies and lengths, by their names in column names."""

    ax: Any = None
    rate: str = "rpm"
    length_unit: str = "um"

    @classmethod
    def of(cls, ax: Any = None, unit: str | Sequence[str] | None = None) -> Sheet:
        """That of ``ax`` and ``unit`` as users give them, see :func:`on_sheet`."""
        sheet = cls(ax=ax)
        rates, lengths = UNITS["frequency"], UNITS["displacement"]
        for name in [unit] if isinstance(unit, str) else unit or ():
            plain = name.replace("µ", "u").replace("/", "_").lower()
            if plain not in rates and plain not in lengths:
                raise ValueError(unknown_name("unit of a figure", name, [*rates, *lengths]))
            sheet = replace(sheet, rate=plain) if plain in rates else replace(sheet, length_unit=plain)
        return sheet

    @property
    def per_rad_s(self) -> float:
        """Factor from rad/s to the unit of frequency."""
        return 1 / UNITS["frequency"][self.rate]

    @property
    def rate_unit(self) -> str:
        """Unit of frequencies, as it is written."""
        return _NAMES.get(self.rate, self.rate)

    def rate_words(self, value: float) -> str:
        """A frequency or speed given in rad/s, with its unit."""
        return f"{significant(value * self.per_rad_s, 4)} {self.rate_unit}"

    @property
    def length(self) -> tuple[float, str]:
        """Factor from m to the unit of length, and its name."""
        base, _, peak = self.length_unit.partition("_")
        name = " ".join(part for part in (_NAMES.get(base, base), peak) if part)
        return 1 / UNITS["displacement"][self.length_unit], name

    @property
    def position_unit(self) -> tuple[float, str]:
        """Factor from m to the unit of positions and radii, which are not counted pp or rms, and its name."""
        base = self.length_unit.partition("_")[0]
        return 1 / UNITS["displacement"][base], _NAMES.get(base, base)

    def amplitude_unit(self, unit: str | None = None) -> str:
        """A unit of amplitudes, by default that of lengths, with 0-pk unless it is pp or rms already."""
        name = self.length[1] if unit is None else unit
        return name if name.endswith((" pp", " rms")) else f"{name} 0-pk"

    def positions(self, over: str) -> tuple[float, str]:
        """Factor and name of the axis along which spectra stand above one another."""
        if over == "time":
            return 1.0, "time, s"
        what = "speed of the shaft" if over == "speed" else "perturbation frequency"
        return self.per_rad_s, f"{what}, {self.rate_unit}"

    def grid(
        self,
        rows: int,
        columns: int,
        title: str,
        *,
        size: tuple[float, float] = (4.6, 2.3),
        one_abscissa: bool = False,
        projection: str | None = None,
    ) -> tuple[Figure, Any]:
        """An empty figure of axes, shape ``(rows, columns)``."""
        share: Any = "col" if one_abscissa else "none"
        given = self.ax
        drawn_on = given is not None and not isinstance(given, FigureBase)
        panels: Any = np.atleast_1d(np.asarray(given, dtype=object)) if drawn_on else np.empty(0)
        if panels.size > 1 and panels.size != rows * columns:
            raise ValueError(f"ax has {panels.size} axes; this figure has {rows} x {columns} panels")
        if panels.size == rows * columns:
            axes = panels.reshape(rows, columns)
            figure = axes[0, 0].figure
        else:
            figure = _room(given, min(size[0] * columns, PAGE[0]), min(size[1] * rows + 0.5, PAGE[1]))
            kind = {"projection": projection}
            axes = figure.subplots(rows, columns, squeeze=False, sharex=share, subplot_kw=kind)
        if title and given is None:
            figure.suptitle(title, fontsize=10)
        for axis in axes.flat if projection is None else ():
            few_ticks(axis.xaxis)
            few_ticks(axis.yaxis)
            axis.tick_params(labelsize=SMALL_TYPE)
            axis.xaxis.label.set_size(TYPE)
            axis.yaxis.label.set_size(TYPE)
            axis.grid(color="0.9", linewidth=0.6)
            axis.set_axisbelow(True)
            axis.spines[["top", "right"]].set_visible(False)
            axis.spines[:].set_in_layout(False)  # ticks and labels reach further, and are measured anyway
        return figure, axes


PLAIN = Sheet()
"""A figure of its own, in rpm and µm."""
_NAMES = {"um": "µm", "rad_s": "rad/s", "hz": "Hz"}
"""Units whose names are written otherwise than in column names."""


def on_sheet(draw: Callable[..., Figure]) -> Callable[..., Figure]:
    """Let a function that draws on a ``sheet`` take ``ax`` and ``unit`` in its place.

    ``ax``: axes to draw in, one or as many as the figure has panels; one place for several panels is divided, and a
    (sub)figure filled. ``unit``: of frequencies (rpm, hz, rad_s, cpm), of lengths (um, mil, mm, um_pp, ...), or both,
    ``("hz", "mil_pp")``.
    """

    @wraps(draw)
    def drawn(*arguments: Any, ax: Any = None, unit: str | Sequence[str] | None = None, **options: Any) -> Figure:
        with rc_context(_SETTINGS):
            return draw(*arguments, sheet=Sheet.of(ax, unit), **options)

    own = [p for p in signature(draw).parameters.values() if p.name != "sheet"]
    both = [Parameter(name, Parameter.KEYWORD_ONLY, default=None) for name in ("ax", "unit")]
    drawn.__signature__ = Signature([*own, *both])  # type: ignore[attr-defined]  # what ``help`` shows
    return drawn


def number_words(value: float, digits: int = 4) -> str:
    """A number with so many significant digits, zeros at its end too: 28.30, not 28.3."""
    text = f"{value:#.{digits}g}".rstrip(".")
    return text.replace("-", "−", 1) if text.startswith("-") else text


class ShownFigure(Figure):
    """A figure that a notebook shows without pyplot, which would keep every figure ever made."""

    def _repr_png_(self) -> bytes:
        stream = BytesIO()
        self.savefig(stream, format="png", dpi=120)
        return stream.getvalue()


def _room(given: Any, width: float, height: float) -> Any:
    """A figure of its own, the one given, or the place of given axes."""
    if given is None:
        return ShownFigure(figsize=(width, height), layout="constrained")
    if isinstance(given, FigureBase):
        return given
    (place,) = np.atleast_1d(np.asarray(given))
    spec = place.get_subplotspec()
    if spec is None:
        raise ValueError("ax stands in no grid that could be divided; give axes of plt.subplots, or a figure")
    figure = place.figure
    place.remove()
    return figure.add_subfigure(spec)


class _Inside(MaxNLocator):
    """Ticks between the limits only: those beside them would be made, measured and not drawn."""

    def tick_values(self, vmin: float, vmax: float) -> Any:
        ticks = np.asarray(super().tick_values(vmin, vmax))
        low, high = sorted((vmin, vmax))
        return ticks[(ticks >= low - 1e-9 * (high - low)) & (ticks <= high + 1e-9 * (high - low))]


def few_ticks(axis: Any, intervals: int = 6) -> None:
    """Give a linear axis of x or y few ticks."""
    axis.set_major_locator(_Inside(nbins=intervals, steps=[1, 2, 2.5, 5, 10]))


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


def logarithmic_over_decades(axis: Any, values: Any) -> None:
    """A logarithmic ordinate where positive values span more than two decades: a few of them would hide the others."""
    if np.min(values) > 0 and np.max(values) > 100 * np.min(values):
        axis.set_yscale("log")
        decade_ticks(axis.yaxis)


class _Plain(LogFormatter):
    """Numbers below one as people write them: 0.1, not 1e-01."""

    def __call__(self, x: float, pos: int | None = None) -> str:
        return f"{x:g}" if super().__call__(x, pos) else ""


def decade_ticks(axis: Any) -> None:
    """Write the labels of a logarithmic axis as 0.1, 1, 10, with 2 and 5 between where it spans few decades."""
    axis.set_major_locator(LogLocator())
    axis.set_minor_locator(_BetweenDecades())
    axis.set_major_formatter(_Plain())
    labelled = 1.5  # decades of a logarithmic axis up to which ticks between powers of ten are labelled too
    axis.set_minor_formatter(_Plain(labelOnlyBase=False, minor_thresholds=(labelled, labelled)))
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
    """Factor and unit with an SI prefix that brings typical values between 1 and 1000; none for kg and for ratios."""
    if unit == "1" or unit.startswith("kg"):
        return 1.0, unit
    finite = np.abs(values[np.isfinite(values)])
    top = float(finite.max(initial=0.0))
    for factor, letter in ((1e-9, "G"), (1e-6, "M"), (1e-3, "k"), (1.0, ""), (1e3, "m"), (1e6, "µ"), (1e9, "n")):
        if top * factor >= 1.0:
            return factor, f"{letter}{unit}"
    return 1.0, unit


def labelled(name: str, unit: str) -> str:
    """A quantity with its unit, as axes show them."""
    return literal(name if unit == "1" else f"{name}, {unit}")


def date_ticks(axis: Any) -> None:
    """Few dates along an axis, each as short as it can be."""
    from matplotlib.dates import AutoDateLocator, ConciseDateFormatter

    ticks = AutoDateLocator(minticks=2, maxticks=5)
    axis.set_major_locator(ticks)
    axis.set_major_formatter(ConciseDateFormatter(ticks))


def draw_curve(axis: Any, x: Float, y: Float, half: Float, colour: str, style: str = "-", **look: Any) -> None:
    """A line with its band."""
    axis.plot(x, y, style, color=colour, **{"lw": 1.3, **look})
    axis.fill_between(x, y - half, y + half, color=colour, alpha=BAND, lw=0)


def draw_cascade(axis: Any, x: Float, heights: Float, levels: Float) -> None:
    """Spectra above one another, those in front hiding those behind."""
    for rank, row in enumerate(np.argsort(-levels, kind="stable")):
        curve = levels[row] + heights[row]
        axis.fill_between(x, levels[row], curve, color="white", lw=0, zorder=3 + rank)
        axis.plot(x, curve, color=COLOURS[0], lw=0.6, zorder=3 + rank)


def phase_axis(axis: Any) -> None:
    """One turn of phase in degrees."""
    axis.set(yticks=[-180, -90, 0, 90, 180], ylim=(-190, 190))


def square_axis(axis: Any, z: ComplexArray, room: float) -> None:
    """Equal limits of x and y about some places, so many times the half of their extent."""
    low, high = complex(z.real.min(), z.imag.min()), complex(z.real.max(), z.imag.max())
    middle, reach = (low + high) / 2, room * max((high - low).real, (high - low).imag, 1e-12) / 2
    axis.set(xlim=(middle.real - reach, middle.real + reach), ylim=(middle.imag - reach, middle.imag + reach))


def in_colours(names: Sequence[str], count: int | None = None) -> dict[str, Any]:
    """Entries of a legend for curves that differ in colour."""
    return {
        name: {"color": colour_of(i, len(names) if count is None else count), "lw": 2} for i, name in enumerate(names)
    }


def legend_below(figure: Any, entries: Mapping[str, Any] | None = None) -> None:
    """One legend for all axes, outside of the data, in as many columns as the width holds.

    ``entries``: by its words an artist, or how a line looks; by default all that was drawn with a label.
    """
    if entries is None:
        drawn = [axis.get_legend_handles_labels() for axis in figure.axes]
        entries = {label: handle for some in drawn for handle, label in zip(*some, strict=True)}
    labels = list(entries)
    handles = [Line2D([], [], **{"color": GREY, **e}) if isinstance(e, Mapping) else e for e in entries.values()]
    whole = figure.figure if isinstance(figure, SubFigure) else figure
    if labels and not isinstance(whole.get_layout_engine(), ConstrainedLayoutEngine):
        figure.axes[-1].legend(handles, labels, fontsize=SMALL_TYPE, frameon=False)
    elif labels:
        room = figure.bbox.width / whole.dpi * 72 / (0.55 * SMALL_TYPE)  # letters in a row
        beside = 11  # letters whose room a line and the gaps beside it take
        widths = [
            sum(max(map(len, column)) + beside for column in np.array_split(np.array(labels, dtype=object), count))
            for count in range(1, min(len(labels), 6) + 1)
        ]
        columns = max([count for count, width in enumerate(widths, 1) if width <= room], default=1)
        style = {"fontsize": SMALL_TYPE, "frameon": False}
        figure.legend(handles, labels, loc="outside lower center", ncols=columns, **style)


def picture_of(figure: Figure, file_format: str = "png", dpi: float = 200.0) -> bytes:
    """A figure as the bytes of a file, drawn once: ``savefig`` draws a figure twice to place its labels."""
    stream = BytesIO()
    if file_format != "png":
        figure.savefig(stream, format=file_format, dpi=dpi)
        return stream.getvalue()
    figure.set_dpi(dpi)
    for axis in (axis for axes in figure.axes for axis in (axes.xaxis, axes.yaxis)):
        if not axis.get_label_text():
            axis.set_label_coords(0.5, 0.5)  # otherwise all labels of ticks are measured to place an empty one
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    # 256 colours, which no eye tells from all: a third of the bytes, in less than half the time of the default.
    picture = Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")
    picture = picture.quantize(method=Image.Quantize.FASTOCTREE)
    # The octree's white is the mean with what is nearly white, which a printer would print.
    picture.putpalette([255 if level == 254 else level for level in picture.getpalette() or []])
    picture.save(stream, "png", compress_level=3, dpi=(dpi, dpi))
    return stream.getvalue()
