"""Processor time of the demo's report, and of the same axes by plain matplotlib: same panels, lines, points and bands.

python benchmarks/report_time.py

What plain matplotlib draws has no words but titles and labels, one opacity, and no table; the report has them all.
"""

from __future__ import annotations

import io
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.collections import PathCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

sys.path.insert(0, str(Path(__file__).parent))
from reporting import RESULTS, environment, table

import rotorfit as rf
from rotorfit.show.plots import style

RUNS = 5


def plain(figure: Figure, layout: str | None) -> None:
    """The axes of a figure drawn anew and saved as matplotlib does."""
    whole = plt.figure(figsize=figure.get_size_inches(), layout=layout)
    for axis in figure.axes:
        place: Any = axis.get_subplotspec()
        grid = place.get_gridspec()
        own = whole.add_subplot(grid.nrows, grid.ncols, place.num1 + 1)
        for line in axis.lines:
            own.plot(*line.get_data(), color=line.get_color(), marker=line.get_marker(), ls=line.get_linestyle())
        for drawn in axis.collections:
            if isinstance(drawn, PathCollection):
                x, y = np.asarray(drawn.get_offsets()).T
                own.scatter(x, y, s=8)
            elif isinstance(drawn, PolyCollection):
                for path in drawn.get_paths():
                    own.fill(*path.vertices.T, alpha=0.25)
        for bar in axis.patches:
            if isinstance(bar, Rectangle):
                own.barh(bar.get_y(), bar.get_width(), bar.get_height(), left=bar.get_x())
        if axis.get_yscale() == "log":
            own.set_yscale("log")
        own.set(xlim=axis.get_xlim(), ylim=axis.get_ylim(), xlabel=axis.get_xlabel(), ylabel=axis.get_ylabel())
        own.set_title(axis.get_title(loc="left"), loc="left")
        own.grid(visible=True)
    whole.savefig(io.BytesIO(), dpi=200)
    plt.close(whole)


def main() -> None:
    """Measure in turn, and write the table of medians."""
    fit = rf.fit(rf.models.WhirlWhip(), rf.datasets.rig_lumped(), known={"K3": 6000.0})
    figures: list[Figure] = []
    picture_of = style.picture_of
    style.picture_of = lambda figure, *rest: (figures.append(figure), picture_of(figure, *rest))[1]
    with tempfile.TemporaryDirectory() as folder:
        page = Path(folder) / "report.html"
        rf.write_report(fit, page)
        style.picture_of = picture_of
        spent: dict[str, list[float]] = {}
        for _ in range(RUNS):
            for name, layout in (("plain axes", None), ("plain axes, constrained layout", "constrained")):
                begin = time.process_time()
                for figure in figures:
                    plain(figure, layout)
                spent.setdefault(name, []).append(time.process_time() - begin)
            begin = time.process_time()
            rf.write_report(fit, page)
            spent.setdefault("the whole report", []).append(time.process_time() - begin)
    rows = [[name, f"{np.median(each):.1f}"] for name, each in spent.items()]
    text = [
        "# Processor time of the demo's report", "",
        f"Made by `python benchmarks/report_time.py` on {environment('numpy', 'matplotlib')}.", "",
        "The whole report with its tables, and its figures' panels, lines, points and bands drawn by plain matplotlib.",
        "", *table(["", "s, median"], rows),
    ]  # fmt: skip
    print("\n".join(text[6:]))
    (RESULTS / "report_time.md").write_text("\n".join(text) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
