"""What a figure shows, read off its artists, and whether its texts can be read."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PathCollection
from matplotlib.figure import Figure
from matplotlib.text import Annotation, Text

from rotorfit.base.array_types import Float


def points_of(axis: Any) -> Float:
    """Places of all points of a panel, in the order in which they were drawn, shape ``(n, 2)``."""
    drawn = [np.asarray(c.get_offsets()) for c in axis.collections if isinstance(c, PathCollection)]
    return np.concatenate([np.zeros((0, 2)), *drawn])


def title_of(axis: Any) -> str:
    """The title of a panel, which stands at its left."""
    return str(axis.get_title(loc="left"))


def heading_of(figure: Figure) -> str:
    """The title of a figure."""
    return figure.get_suptitle().strip()


def conditions_of(figure: Figure) -> list[str]:
    """Names of conditions, beside the title or in the legend."""
    beside = [(text.get_position()[0], text.get_text()) for text in figure.texts if text.get_fontweight() == "bold"]
    named = [words for _, words in sorted(beside) if words != figure.get_suptitle()]
    return named or [text.get_text() for legend in figure.legends for text in legend.get_texts()]


def texts_of(figure: Figure) -> list[tuple[Text, Any]]:
    """All texts that are seen, with their boxes on the canvas; labels of ticks beyond the axes are not."""
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    renderer = canvas.get_renderer()
    found = []
    for text in figure.findobj(Text):
        if not (text.get_visible() and text.get_text().strip()) or not _is_seen(figure, text):
            continue
        box = Text.get_window_extent(text, renderer)  # of an annotation without its arrow
        lines = text.get_text().rstrip("\n").count("\n") - text.get_text().count("\n")
        if lines and text is figure._suptitle:  # type: ignore[attr-defined]  # lines that keep room for others
            box = box.from_extents(box.x0, box.y1 - box.height / (1 - lines), box.x1, box.y1)
        found.append((text, box))
    return found


def _is_seen(figure: Figure, text: Text) -> bool:
    for axis in figure.axes:
        for one in (axis.xaxis, axis.yaxis):
            low, high = sorted(one.get_view_interval())
            for tick in one.get_major_ticks() + one.get_minor_ticks():
                if text in (tick.label1, tick.label2):
                    shown = one.get_tick_params(which="major").get("labelbottom", True) or one is axis.yaxis
                    return bool(axis.get_visible() and shown and low <= tick.get_loc() <= high)
    return True


def _full_markers(figure: Figure) -> Float:
    """Places on the canvas of points that are not paler for what is not known of them, shape ``(n, 2)``."""
    found = [np.zeros((0, 2))]
    full = 0.8  # opacity
    for axis in figure.axes:
        for drawn in axis.collections:
            if isinstance(drawn, PathCollection) and axis.get_visible():
                places = np.asarray(drawn.get_offset_transform().transform(np.ma.getdata(drawn.get_offsets())))
                shade = np.broadcast_to(drawn.get_facecolor(), (len(places), 4)) if len(drawn.get_facecolor()) else ()
                found += [places[shade[:, 3] >= full]] if len(shade) else []  # type: ignore[call-overload]
    return np.concatenate(found)


def faults_of(figure: Figure) -> list[str]:
    """Texts that overlap, lie on points, or leave the canvas by more than a pixel."""
    texts = texts_of(figure)
    width, height = figure.canvas.get_width_height()
    slack = 1.0
    said = [
        f"leaves the canvas: {text.get_text()!r}"
        for text, box in texts
        if box.x0 < -slack or box.y0 < -slack or box.x1 > width + slack or box.y1 > height + slack
    ]
    points = _full_markers(figure)
    for text, box in texts:
        hidden = int(((points > (box.x0, box.y0)) & (points < (box.x1, box.y1))).all(axis=1).sum())
        said += [f"lies on {hidden} points: {text.get_text()!r}"] if hidden else []
    for (one, a), (other, b) in itertools.combinations(texts, 2):
        across = min(a.x1, b.x1) - max(a.x0, b.x0)
        along = min(a.y1, b.y1) - max(a.y0, b.y0)
        if across > slack and along > slack:
            said.append(f"overlap: {one.get_text()!r} and {other.get_text()!r}")
    return said


def annotations_of(axis: Any) -> list[str]:
    """Words within and about a panel."""
    return [text.get_text() for text in axis.texts if isinstance(text, Annotation | Text)]
