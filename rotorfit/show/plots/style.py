"""Look and units shared by all figures."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import wraps
from inspect import Parameter, Signature, signature
from io import BytesIO
from typing import Any, NamedTuple, cast

import numpy as np
from cycler import cycler
from matplotlib import rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgba_array
from matplotlib.figure import Figure, FigureBase, SubFigure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.lines import Line2D
from matplotlib.ticker import Locator, LogFormatter, LogLocator, MaxNLocator
from PIL import Image
from scipy.optimize import isotonic_regression

from rotorfit.base.array_types import ComplexArray, Float
from rotorfit.base.digits import significant
from rotorfit.base.names import unknown_name
from rotorfit.base.units import UNITS, shown_units

COLOURS = ("#0B4F8A", "#E58A1F", "#7CCFC4", "#7A1F5C")
"""Of conditions and traces: told apart by colour-blind readers, the first two in grey print too."""
MARKERS = "os^D"
"""Of the same: a second sign beside the colour."""
RAMP = ("#9CC4E4", "#4A90C4", "#0B4F8A")
"""Of an ordered set, from its least to its largest: pressures, and more speeds than there are colours."""
FORWARD, BACKWARD = ("#E58A1F", "#B23A0C", "#8A2C0D", "#F2B866"), ("#0B4F8A", "#4A90C4", "#7CC6BD", "#4B5A66")
"""Of modes by their whirl, warm ones solid, cool ones dashed."""
CRITICAL = "#B23A0C"
"""Of what becomes unstable, its threshold, and a limit."""
SHARES = ("#CBD5DC", "#78AEDA", "#B23A0C")
"""Of an error: noise, bounded by the data, on trust."""
BOUNDED = "#2F6CA3"
"""Of words about what is bounded by the data, whose bar is too pale for type."""
REGIONS = ("#D3DFEA", "#85A7C4")
"""Of regions of a posterior: outer, inner."""
INK, GREY, AXES, GRID, UNSTABLE = "#1F2933", "#667784", "#8A98A4", "#DDE3E8", "#FBE9E2"
"""Of text, second text, axes, the grid, and the half of a panel where motion grows."""
PHASE_LABEL = "phase lead of the probe, deg"
PAGE = (7.08, 8.8)
"""Largest width and height of a figure, inches: what A4 leaves between its margins, so that print keeps its size."""
SMALL_TYPE, TYPE, TITLE_TYPE = 7, 8, 10
"""Smallest type, that of names, and that of the figure's title, points."""
_SETTINGS: Any = {
    "axes.titlesize": TYPE, "axes.labelsize": TYPE, "legend.fontsize": SMALL_TYPE, "legend.frameon": False,
    "axes.formatter.useoffset": False,  # 1200 and 1201, not 0 and 1 beside a number that is easily overlooked
    "axes.titley": 1.0,  # nothing stands above the axes that a title would have to be moved for, which takes long
    "axes.titlelocation": "left", "axes.titleweight": "bold", "axes.titlepad": 5,
    "text.color": INK, "axes.labelcolor": INK, "xtick.labelcolor": INK, "ytick.labelcolor": INK,
    "axes.edgecolor": AXES, "xtick.color": AXES, "ytick.color": AXES, "axes.linewidth": 0.7,
    "axes.prop_cycle": cycler(color=COLOURS), "xtick.major.size": 3, "ytick.major.size": 3, "lines.linewidth": 1.5,
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
    rate: str = field(default_factory=lambda: shown_units().rate)
    length_unit: str = field(default_factory=lambda: shown_units().length)

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
        reads: Sequence[str] = (),
        pages: float = 1.0,
    ) -> tuple[Figure, Any]:
        """An empty figure of axes, shape ``(rows, columns)``, at most so many pages wide, and the square of them high;
        ``reads``: lines on how to read it, below the title."""
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
            figure = _room(
                given, min(size[0] * columns, pages * PAGE[0]), min(size[1] * rows + 0.5, pages**2 * PAGE[1])
            )
            kind = {"projection": projection}
            axes = figure.subplots(rows, columns, squeeze=False, sharex=share, subplot_kw=kind)
        if title and given is None:
            title_of(figure, title, reads)
        for axis in axes.flat if projection is None else ():
            few_ticks(axis.xaxis)
            few_ticks(axis.yaxis)
            axis.tick_params(labelsize=SMALL_TYPE)
            axis.xaxis.label.set_size(TYPE)
            axis.yaxis.label.set_size(TYPE)
            axis.grid(color=GRID, linewidth=0.6)
            axis.set_axisbelow(True)
            axis.spines[["top", "right"]].set_visible(False)
            axis.spines[:].set_in_layout(False)  # ticks and labels reach further, and are measured anyway
        return figure, axes


def title_of(figure: Any, title: str, reads: Sequence[str] = ()) -> None:
    """The title at the left, and below it lines on how to read the figure, whose room the title keeps for them."""
    left, top = 0.01, 3 / 72  # of the width; inches from the top, as constrained layout has them
    width, height = (part / figure.figure.dpi for part in (figure.bbox.width, figure.bbox.height))
    title = "\n".join(lines_within(title, width, TITLE_TYPE))
    lines = [line for words in ([" ".join(reads)] if reads else []) for line in lines_within(words, width, 0.88 * TYPE)]
    spare = "\n" * -(-len(lines) * TYPE // TITLE_TYPE)
    figure.suptitle(title + spare, x=left, ha="left", fontsize=TITLE_TYPE, fontweight="bold")
    line, begin = 1.25 * TYPE / 72, 1.25 * (1 + title.count("\n")) * TITLE_TYPE / 72 + 2 / 72
    for number, words in enumerate(lines):
        below = 1 - (top + begin + number * line) / height
        figure.text(left, below, words, fontsize=TYPE, color=GREY, ha="left", va="top", in_layout=False)


def key_beside_title(figure: Any, names: Sequence[tuple[str, str, str]]) -> bool:
    """Few conditions by their marker and colour, at the right of the title; False where they have no room there.

    ``names``: words, colour and marker.
    """
    if figure._suptitle is None or len(names) < 2:
        return len(names) < 2
    letters = 0.62 * TYPE / 72  # inches of a letter in bold type
    title = letters * len(figure._suptitle.get_text().strip()) * TITLE_TYPE / TYPE
    room, gap = figure.bbox.width / figure.figure.dpi, 3
    widths = [letters * (len(words) + gap) for words, _, _ in names]
    if title + sum(widths) + 0.3 > room:
        return False
    height, right = figure.bbox.height / figure.figure.dpi, room - 0.08
    for (words, colour, marker), width in zip(reversed(names), reversed(widths), strict=True):
        at = 1 - (3 + 0.7 * TITLE_TYPE) / 72 / height
        look = {"color": colour, "fontsize": TYPE, "fontweight": "bold", "va": "center", "in_layout": False}
        figure.text(right / room, at, words, ha="right", **look)
        right -= width
        place = Line2D([(right + 1.2 * letters) / room], [at], marker=marker, color=colour, ms=5, ls="")
        place.set(transform=figure.transSubfigure if hasattr(figure, "transSubfigure") else figure.transFigure)
        place.set_in_layout(False)
        figure.add_artist(place)
    return True


def lines_within(words: str, width: float, size: float) -> list[str]:
    """Words in lines of a width in inches, by the mean width of bold letters of a size in points."""
    return textwrap.wrap(words, max(int(0.98 * width * 72 / (0.62 * size)), 10), break_long_words=False) or [""]


def panel_title(axis: Any, words: str, *, beside: float = 0.42, **look: Any) -> None:
    """The title of a panel, in lines that its column of the figure holds, without the inches ``beside`` for labels."""
    place = axis.get_subplotspec()
    columns = 1 if place is None else place.get_gridspec().ncols
    width = axis.figure.bbox.width / axis.figure.figure.dpi / columns
    axis.set_title("\n".join(lines_within(words, width - beside, TYPE)), **look)


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


BELOW = "reading"
"""Mark of words that stand about a panel."""
HALF = (3.6, 2.36)
"""Inches of the two half figures of a first screen."""


def halo(colour: str = "white") -> list[Any]:
    """What keeps text readable on lines."""
    from matplotlib.patheffects import withStroke

    return [withStroke(linewidth=2.4, foreground=colour)]


def opacity_of(share: Float) -> Float:
    """Opacity of readings by sigma over their size: pale from 12 %, none above half, full where no sigma is known."""
    pale, none, least, full = 0.12, 0.5, 0.15, 0.85
    known = np.nan_to_num(share, nan=0.0)
    fading = full - (full - least) * np.clip((known - pale) / (none - pale), 0.0, 1.0)
    return np.where(known > none, 0.0, fading)


def shades(colour: str, opacity: Float) -> Float:
    """A colour at several opacities, shape ``(n, 4)``."""
    found = np.asarray(to_rgba_array(colour).repeat(opacity.size, axis=0))
    found[:, 3] = opacity
    return found


class Marks(NamedTuple):
    """How the points of a condition look."""

    colour: str
    marker: str = "o"
    hollow: bool = False


def draw_points(
    axis: Any, x: Float, y: Float, sigma: Float, expected: Float, marks: Marks, *, widened: float = 1.0
) -> int:
    """Readings, paler where less certain; the number of those that are not drawn.

    Left out is what lies beyond the axis, and what 2 sigma of exceeds half of it. A reading more than 3.5 sigma off
    what is expected, sigma ``widened`` as errors are, is always drawn, ringed, at the edge where it lies beyond.
    """
    low, high = axis.get_ylim()
    size = high - low
    told = np.nan_to_num(2 * sigma, nan=0.0) < size / 2
    odd = told & (np.abs(y - expected) > 3.5 * widened * sigma) & (sigma > 0)
    shown = told & (((y >= low) & (y <= high)) | odd)
    opacity = np.clip(0.85 * (1 - 4 * np.nan_to_num(sigma) / size), 0.15, 0.85)
    at, reach = np.clip(y, low + 0.01 * size, high - 0.01 * size), (7.0, 1.0)
    shade = shades(marks.colour, opacity[shown])
    face: dict[str, Any] = {"facecolors": "none", "edgecolors": shade} if marks.hollow else {"c": shade}
    look = {"marker": marks.marker, "linewidths": 0.7 if marks.hollow else 0, "zorder": 2.2}
    axis.scatter(x[shown], at[shown], s=reach[0], **face, **look)
    if (shown & odd).any():
        ring = {"facecolors": "none", "edgecolors": marks.colour, "linewidths": reach[1], "zorder": 4, "clip_on": False}
        axis.scatter(x[shown & odd], at[shown & odd], s=36, **ring)
    return int(np.count_nonzero(~shown))


def misfit_panel(axis: Any) -> None:
    """The panel of residuals of a first screen: its title, and what noise alone would leave."""
    axis.set_title("Residuals over their noise")
    for level in (-2, 2):
        axis.axhline(level, color=GREY, lw=0.9, ls=(0, (4, 2)))
    above(axis, "noise: 95 % within dashes")


def tested_speeds(axis: Any, speeds: Sequence[float]) -> None:
    """A dashed line at each speed that was tested, in the units of the axis."""
    for speed in speeds:
        axis.axvline(speed, color=GREY, lw=0.9, ls=(0, (2, 2)), zorder=1)


def below(axis: Any, words: str) -> None:
    """What a curve reads, below the ticks of the panel at its left, and above a label of the axis."""
    axis.xaxis.labelpad = 2.1 * SMALL_TYPE
    axis.annotate(
        words, (0, 0), (0, -2.1 * SMALL_TYPE), xycoords="axes fraction", textcoords="offset points", ha="left",
        va="top", fontsize=SMALL_TYPE, color=GREY, annotation_clip=False, gid=BELOW,
    )  # fmt: skip


def above(axis: Any, words: str) -> None:
    """What is not drawn, above the panel at its right, below a title that is padded for it."""
    axis.annotate(
        words, (1, 1), (0, 2), xycoords="axes fraction", textcoords="offset points", ha="right", va="bottom",
        fontsize=SMALL_TYPE, color=GREY, annotation_clip=False, gid=BELOW,
    )  # fmt: skip


def end_labels(
    axis: Any, labels: Sequence[tuple[str, float, str]], *, inside: bool = False, weight: str = "bold"
) -> None:
    """Names of curves at their right ends in their colours, pushed apart where they would overlap.

    ``labels``: words, value of the curve at its end, colour; what ends beyond the axis has none. ``inside``: left of
    the ends, where another scale stands at the right.
    """
    low, high = axis.get_ylim()
    shown = [label for label in labels if low <= label[1] <= high]
    if not shown:
        return
    to_axis = axis.transData + axis.transAxes.inverted()
    height = axis.bbox.height / axis.figure.figure.dpi * 0.5  # the layout is not made yet
    apart = 1.2 * SMALL_TYPE / 72 / height
    places = np.array([np.clip(to_axis.transform((axis.get_xlim()[1], value))[1], 0.02, 0.98) for _, value, _ in shown])
    order, steps = np.argsort(places), apart * np.arange(places.size)
    moved = steps + np.clip(isotonic_regression(places[order] - steps).x, 0.02, max(1.0 - steps[-1], 0.02))
    for place, which in zip(moved.tolist(), order.tolist(), strict=True):
        words, _, colour = shown[which]
        own = float(places[which])
        away = abs(place - own) > apart / 2
        lead = {
            "arrowstyle": "-",
            "color": colour,
            "lw": 0.6,
            "shrinkA": 1,
            "shrinkB": 0,
            "relpos": (float(inside), 0.5),
        }
        axis.annotate(
            words, (1, own), ((-1 if inside else 1) * (12 if away else 4), (place - own) * height * 72),
            xycoords="axes fraction", textcoords="offset points", arrowprops=lead if away else None,
            va="center", ha="right" if inside else "left", fontsize=SMALL_TYPE, fontweight=weight, color=colour,
            annotation_clip=False, path_effects=halo(), zorder=6,
        )  # fmt: skip


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
    """Colour of one of several conditions; of more than there are colours, on a scale from light to dark."""
    if count <= len(COLOURS):
        return COLOURS[number % len(COLOURS)]
    from matplotlib.colors import to_hex

    return to_hex(ramp()(number / (count - 1)))


def ramp() -> Any:
    """Colours of an ordered set, from its least to its largest."""
    from matplotlib.colors import LinearSegmentedColormap

    return LinearSegmentedColormap.from_list("ordered", RAMP)


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
    low = complex(np.nanmin(z.real), np.nanmin(z.imag))
    high = complex(np.nanmax(z.real), np.nanmax(z.imag))
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
