"""Room for titles, labels and legends around the panels of a figure, and drawing a figure once.

Most of the time of a figure goes into the sizes of its labels. Matplotlib's constrained layout measures every label
eight times and ``savefig`` draws the figure twice. Here each is measured once.
"""

from __future__ import annotations

from dataclasses import dataclass
from io import BytesIO
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.transforms import Bbox, ScaledTranslation

from rotorfit.models.array_types import Float, Index

_PAD = 0.04167
"""Room around everything, inches: that of matplotlib's constrained layout."""
_COMPRESSION = 3
"""Of PNG files: half the time of the default, one file in thirty larger."""


class PanelLayout(ConstrainedLayoutEngine):
    """Panels of equal size in a grid, as constrained layout has them, every label measured once.

    Figures with more than that, such as colour bars, are left to constrained layout.
    """

    def execute(self, fig: Figure) -> None:
        """Place the axes of a figure, and their labels beside the numbers."""
        panels: list[Any] = list(fig.axes)
        if not panels or any(_cell(axis) is None for axis in panels):
            super().execute(fig)
            return
        grid = panels[0].get_subplotspec().get_gridspec()
        around = [_surroundings(axis) for axis in panels]
        margins = np.array([found.margins for found in around]) / fig.dpi + _PAD
        rows, columns = np.array([_cell(axis) for axis in panels]).T
        left, right = (_largest(margins[:, k], columns, grid.ncols) for k in (0, 2))
        bottom, top = (_largest(margins[:, k], rows, grid.nrows) for k in (1, 3))
        above, below = _title_height(fig), _legend_height(fig)
        width = (fig.get_figwidth() - float(np.sum(left + right))) / grid.ncols
        height = (fig.get_figheight() - above - below - float(np.sum(bottom + top))) / grid.nrows
        if width <= 0 or height <= 0:
            super().execute(fig)
            return
        size = np.array([fig.get_figwidth(), fig.get_figheight()])
        for axis, row, column, found in zip(panels, rows.tolist(), columns.tolist(), around, strict=True):
            x = left[: column + 1].sum() + right[:column].sum() + column * width
            y = size[1] - above - top[: row + 1].sum() - bottom[:row].sum() - (row + 1) * height
            axis.set_position(Bbox.from_bounds(x / size[0], y / size[1], width / size[0], height / size[1]))
            axis.set_in_layout(True)  # which placing by hand ends
            _fix_labels(axis, found)


def _cell(axis: Any) -> tuple[int, int] | None:
    """Row and column of axes that fill one cell of a grid."""
    spec = axis.get_subplotspec()
    if spec is None or len(spec.rowspan) > 1 or len(spec.colspan) > 1:
        return None
    return spec.rowspan.start, spec.colspan.start


@dataclass(frozen=True, kw_only=True)
class _Surroundings:
    """What stands around axes, pixels."""

    margins: tuple[float, float, float, float]  # that labels, titles and others reach beyond the axes
    below: float  # from the axes to the label of x, and to that of y
    left: float  # from the axes to the label of x, and to that of y


def _surroundings(axis: Any) -> _Surroundings:
    """Measure what stands around axes.

    Matplotlib's own measure of axes asks five times for the numbers along them: for their size, for the places of the
    labels, of the title and of the ends of both lines.
    """
    if not axis.get_visible():
        return _Surroundings(margins=(0.0, 0.0, 0.0, 0.0), below=0.0, left=0.0)
    axis.apply_aspect()
    inner = axis.bbox
    along_x, along_y = (_numbers(side) for side in (axis.xaxis, axis.yaxis))
    others = [a.get_tightbbox() for a in axis.get_default_bbox_extra_artists() if a not in axis.spines.values()]
    box = Bbox.union([inner, along_x or inner, along_y or inner, *(b for b in others if b is not None and b.width > 0)])
    pad = axis.figure.dpi / 72
    below = inner.y0 - (along_x or inner).y0 + axis.xaxis.labelpad * pad
    left = inner.x0 - (along_y or inner).x0 + axis.yaxis.labelpad * pad
    lowest = inner.y0 - below - (axis.xaxis.label.get_window_extent().height if axis.get_xlabel() else 0.0)
    leftmost = inner.x0 - left - (axis.yaxis.label.get_window_extent().width if axis.get_ylabel() else 0.0)
    ceiling = (along_y or inner).y1 if axis.yaxis.get_offset_text().get_text() else inner.y1
    highest = ceiling + _title_reach(axis)
    # Axes of equal scales are smaller than their place; what stands around them stands around what is drawn.
    margins = (
        inner.x0 - min(box.x0, leftmost),
        inner.y0 - min(box.y0, lowest),
        box.x1 - inner.x1,
        max(box.y1, highest) - inner.y1,
    )
    return _Surroundings(margins=margins, below=below, left=left)


def _numbers(side: Any) -> Bbox | None:
    """Extent of the numbers along one side of axes; ``None`` where there are none."""
    shown = side.label.get_visible()
    side.label.set_visible(False)
    side.set_label_coords(0.5, 0.5)  # a place given: matplotlib looks for none
    box: Bbox | None = side.get_tightbbox()
    side.label.set_visible(shown)
    return box


def _title_reach(axis: Any) -> float:
    """Pixels from what the title stands on to its top."""
    if not axis.get_title():
        return 0.0
    stand: float = axis.transAxes.transform(axis.title.get_position())[1]
    return float(axis.title.get_window_extent().y1) - stand


def _fix_labels(axis: Any, found: _Surroundings) -> None:
    """Fix the labels of axes beside their numbers, so that drawing does not look for a place again."""
    to_inches = axis.figure.dpi_scale_trans
    below, left = found.below / axis.figure.dpi, found.left / axis.figure.dpi
    axis.xaxis.set_label_coords(0.5, 0.0, axis.transAxes + ScaledTranslation(0.0, -below, to_inches))
    axis.yaxis.set_label_coords(0.0, 0.5, axis.transAxes + ScaledTranslation(-left, 0.0, to_inches))
    if axis.get_title() and not axis.yaxis.get_offset_text().get_text():
        axis.set_title(axis.get_title(), y=1.0, fontsize=axis.title.get_fontsize())


def _largest(values: Float, place: Index, count: int) -> Float:
    found = np.full(count, _PAD)
    np.maximum.at(found, place, values)
    return found


def _title_height(figure: Figure) -> float:
    """Inches of the title at the top, which is placed there."""
    for text in figure.texts:
        text.set_position((0.5, 1 - _PAD / figure.get_figheight()))
    heights = [text.get_window_extent().height for text in figure.texts]
    return max(heights) / figure.dpi + 2 * _PAD if heights else 0.0


def _legend_height(figure: Figure) -> float:
    """Inches of the legend below the panels."""
    heights = [legend.get_window_extent().height for legend in figure.legends]
    return max(heights) / figure.dpi + 2 * _PAD if heights else 0.0


def picture_of(figure: Figure, file_format: str = "png", dpi: float = 200.0) -> bytes:
    """A figure as a file. The figure is for throwing away afterwards: its labels no longer move with its axes."""
    stream = BytesIO()
    if file_format != "png":
        figure.savefig(stream, format=file_format, dpi=dpi)
        return stream.getvalue()
    from PIL import Image

    figure.set_dpi(dpi)
    canvas = FigureCanvasAgg(figure)
    engine = figure.get_layout_engine()
    if isinstance(engine, PanelLayout):
        engine.execute(figure)
        figure.set_layout_engine("none")
    canvas.draw()
    image = Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")  # opaque: an eighth smaller
    image.save(stream, "png", compress_level=_COMPRESSION, dpi=(dpi, dpi))
    return stream.getvalue()
