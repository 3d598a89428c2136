"""Room for titles, labels and legends around the panels of a figure, and drawing a figure once.

Most of the time of a figure goes into the sizes of its labels. Matplotlib's constrained layout measures every label
eight times and ``savefig`` draws the figure twice. Here each is measured once.
"""

from __future__ import annotations

from io import BytesIO
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.transforms import Bbox, ScaledTranslation
from numpy.typing import NDArray

_PAD = 0.04167
"""Room around everything, inches: that of matplotlib's constrained layout."""
_COMPRESSION = 3
"""Of PNG files: half the time of the default, one file in thirty larger."""


class PanelLayout(ConstrainedLayoutEngine):
    """Panels of equal size in a grid, as constrained layout has them, every label measured once.

    Figures with more than that, such as colour bars, are left to constrained layout.
    """

    def execute(self, fig: Figure) -> None:
        """Place the axes of a figure.

        Args:
            fig: the figure.
        """
        self.place(fig, last=False)

    def place(self, fig: Figure, *, last: bool) -> None:
        """Place the axes of a figure.

        Args:
            fig: the figure.
            last: the figure is drawn once more and no more: the labels of its axes stay where they were measured.
        """
        panels: list[Any] = list(fig.axes)
        if not panels or any(_cell(axis) is None for axis in panels):
            super().execute(fig)
            return
        grid = panels[0].get_subplotspec().get_gridspec()
        margins = np.array([_decorations(axis) for axis in panels]) / fig.dpi + _PAD
        offsets = {axis: _label_offsets(axis) for axis in panels} if last else {}
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
        for axis, row, column in zip(panels, rows.tolist(), columns.tolist(), strict=True):
            x = left[: column + 1].sum() + right[:column].sum() + column * width
            y = size[1] - above - top[: row + 1].sum() - bottom[:row].sum() - (row + 1) * height
            axis.set_position(Bbox.from_bounds(x / size[0], y / size[1], width / size[0], height / size[1]))
            axis.set_in_layout(True)  # which placing by hand ends
            if last:
                _fix_labels(axis, *offsets[axis])


def _cell(axis: Any) -> tuple[int, int] | None:
    """Row and column of axes that fill one cell of a grid."""
    spec = axis.get_subplotspec()
    if spec is None or len(spec.rowspan) > 1 or len(spec.colspan) > 1:
        return None
    return spec.rowspan.start, spec.colspan.start


def _decorations(axis: Any) -> tuple[float, float, float, float]:
    """Pixels that labels and titles reach beyond the axes: left, below, right, above."""
    box = axis.get_tightbbox(for_layout_only=True)
    if box is None:  # axes that are not shown
        return 0.0, 0.0, 0.0, 0.0
    inner = axis.get_position(original=True).transformed(axis.get_figure().transFigure)
    return inner.x0 - box.x0, inner.y0 - box.y0, box.x1 - inner.x1, box.y1 - inner.y1


def _label_offsets(axis: Any) -> tuple[float, float]:
    """Inches from the axes, as just measured, to the label of x below and to that of y on the left."""
    below = axis.bbox.y0 - axis.xaxis.label.get_position()[1]
    left = axis.bbox.x0 - axis.yaxis.label.get_position()[0]
    return below / axis.figure.dpi, left / axis.figure.dpi


def _fix_labels(axis: Any, below: float, left: float) -> None:
    """Fix the labels of axes there, so that drawing does not look for a place again."""
    to_inches = axis.figure.dpi_scale_trans
    axis.xaxis.set_label_coords(0.5, 0.0, axis.transAxes + ScaledTranslation(0.0, -below, to_inches))
    axis.yaxis.set_label_coords(0.0, 0.5, axis.transAxes + ScaledTranslation(-left, 0.0, to_inches))
    if axis.get_title() and not axis.yaxis.get_offset_text().get_text():
        axis.set_title(axis.get_title(), y=axis.title.get_position()[1], fontsize=axis.title.get_fontsize())


def _largest(values: NDArray[np.float64], place: NDArray[np.intp], count: int) -> NDArray[np.float64]:
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
    """A figure as a file. The figure is for throwing away afterwards: its labels no longer move with its axes.

    Args:
        figure: what to draw.
        file_format: one that matplotlib writes.
        dpi: resolution of a PNG file.
    """
    stream = BytesIO()
    if file_format != "png":
        figure.savefig(stream, format=file_format, dpi=dpi)
        return stream.getvalue()
    from PIL import Image

    figure.set_dpi(dpi)
    canvas = FigureCanvasAgg(figure)
    engine = figure.get_layout_engine()
    if isinstance(engine, PanelLayout):
        engine.place(figure, last=True)
        figure.set_layout_engine("none")
    canvas.draw()
    image = Image.fromarray(np.asarray(canvas.buffer_rgba()))
    image.save(stream, "png", compress_level=_COMPRESSION, dpi=(dpi, dpi))
    return stream.getvalue()
