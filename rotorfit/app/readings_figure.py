"""Readings of tests over frequency, to look at and to brush."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence, Set
from typing import Any

import numpy as np

from rotorfit.app.frames import TOOLS, framed
from rotorfit.data.experiments import Experiment, PerturbationTest
from rotorfit.plots.style import colour_of
from rotorfit.units import RPM_PER_RAD_S

_BRUSHED = "#b34700"
"""Colour of readings that are brushed."""


def readings_figures(test: Experiment, skipped: Set[int], on_brush: Callable[[set[int]], None]) -> list[Any]:
    """A figure of amplitude and phase for each channel of a perturbation test, brushed together.

    Rows that are left out are crosses; ``on_brush`` is called with the rows that are brushed.
    """
    if not isinstance(test, PerturbationTest):
        return []
    brushed: dict[str, Sequence[int]] = {}
    found = []
    for channel, rows in _channels(test):
        source = _source(test, rows, skipped)

        def brush(_: str, __: Any, indices: list[int], channel: str = channel, rows: Any = rows) -> None:
            brushed[channel] = rows[indices].tolist()
            on_brush({row for own in brushed.values() for row in own})

        source.selected.on_change("indices", brush)
        found.append(_pair(channel, source, test))
    return found


def colours_of_runs(test: Experiment) -> dict[str, str]:
    """Colour of each run of a perturbation test."""
    runs = list(dict.fromkeys(test.run.tolist())) if isinstance(test, PerturbationTest) else []
    return {run: colour_of(number, len(runs)) for number, run in enumerate(runs)}


def _channels(test: PerturbationTest) -> Iterator[tuple[str, Any]]:
    names = np.char.add(np.char.add(test.plane, " "), test.direction)
    for name in dict.fromkeys(names.tolist()):
        yield name, np.flatnonzero(names == name)


def _source(test: PerturbationTest, rows: Any, skipped: Set[int]) -> Any:
    from bokeh.models import ColumnDataSource

    colours = colours_of_runs(test)
    unit = 1e6  # micrometres, or microradians
    return ColumnDataSource(
        {
            "rpm": test.frequency[rows] * RPM_PER_RAD_S,
            "speed": test.speed[rows] * RPM_PER_RAD_S,
            "amplitude": np.abs(test.response[rows]) * unit,
            "phase": np.degrees(np.angle(test.response[rows])),
            "run": test.run[rows],
            "force": test.force_plane[rows],
            "number": rows + 1,
            "marker": ["x" if row in skipped else "circle" for row in rows.tolist()],
            "colour": [colours[run] for run in test.run[rows].tolist()],
        }
    )


def _pair(channel: str, source: Any, test: PerturbationTest) -> Any:
    from bokeh.layouts import column
    from bokeh.models import HoverTool

    unit = "µrad" if channel.rpartition(" ")[2].startswith("r") else "µm"
    tips = [
        ("reading", "@number"),
        ("run", "@run"),
        ("force at", "@force"),
        ("frequency", "@rpm{0.0} rpm"),
        ("speed", "@speed{0.0} rpm"),
        ("amplitude", f"@amplitude{{0.000}} {unit}"),
        ("phase lead", "@phase{0.0}°"),
    ]
    across = "speed, rpm" if test.synchronous else "frequency, rpm (backward < 0 < forward)"
    common: dict[str, Any] = {
        "tools": f"box_select,lasso_select,{TOOLS}",
        "active_drag": "box_select",
    }
    top = framed(channel, 220, "", f"{unit} 0-peak", y_axis_type="log", **common)
    bottom = framed("", 190, across, "phase lead, °", x_range=top.x_range, **common)
    bottom.y_range.start, bottom.y_range.end = -190, 190
    for plot, values in ((top, "amplitude"), (bottom, "phase")):
        look = {"color": "colour", "nonselection_alpha": 0.25, "selection_color": _BRUSHED}
        plot.scatter("rpm", values, source=source, marker="marker", size=5, **look)
        plot.add_tools(HoverTool(tooltips=tips))
    bottom.toolbar_location = None
    return column(top, bottom, sizing_mode="stretch_width")
