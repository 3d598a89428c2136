"""Section of the report to point at: every response with its fit as Bokeh draws them, the script inside the page."""

from __future__ import annotations

import json
from collections.abc import Sequence
from importlib.resources import files
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

import numpy as np

from rotorfit.base.digits import significant
from rotorfit.base.units import RPM_PER_RAD_S
from rotorfit.estimators.blocks.observations import Responses
from rotorfit.identify.fitting.result import FitResult
from rotorfit.lab.data.rows import Experiment
from rotorfit.show.report.html import Html, element
from rotorfit.show.report.parts import note, section

if TYPE_CHECKING:
    from rotorfit.show.plots.sweeps import SweepCurve

_WORDS = (
    "Points: measured; lines: fit. Drag to zoom all panels, double-click to return; the legend hides and shows "
    "conditions; a click on a point writes its rows of the data below the figure."
)
_BEGIN = """
const [sources, plots] = %s;
const begin = () => {
  const found = window.Bokeh && Bokeh.documents.find(one => one.get_model_by_id(plots[0]));
  if (!found) { setTimeout(begin, 50); return; }
  for (const points of sources.map(id => found.get_model_by_id(id)))
    points.selected.change.connect(() => {
      const [at] = points.selected.indices;
      if (at !== undefined) document.getElementById('rows').textContent = points.data.rows[at];
    });
  document.getElementById('responses').addEventListener('dblclick', () => {
    for (const id of plots) found.get_model_by_id(id).reset.emit();
  });
};
begin();
"""
"""Script that writes what the data hold at a clicked point, and shows the whole range again after a double click."""


def check_interactive() -> None:
    """Refuse interactive figures where Bokeh is missing."""
    if find_spec("bokeh") is None:
        raise ValueError('interactive figures need bokeh: pip install "rotorfit[interactive]"')


def interactive_section(fit: FitResult) -> Html:
    """Amplitude and phase of every response to a circular force."""
    from bokeh.embed import components
    from bokeh.layouts import gridplot

    from rotorfit.show.plots.sweeps import curves, joined

    try:
        _, found = curves(fit)
    except ValueError as reason:
        return section("Interactive Bode plots", note(f"There are none: {reason}."))
    panels, sources = _panels(fit, joined(found))
    columns = _columns(found)
    rows = [part for k in range(0, len(panels), columns) for part in zip(*panels[k : k + columns], strict=True)]
    layout = gridplot([list(row) for row in rows], sizing_mode="stretch_width", toolbar_options={"logo": None})
    script, drawn = components(layout)
    ids = [source.id for source in sources], [plot.id for row in rows for plot in row]
    library = (files("bokeh") / "server" / "static" / "js" / "bokeh.min.js").read_text(encoding="utf-8")
    return section(
        "Interactive Bode plots",
        note(_WORDS),
        element("div", Html(drawn), id="responses"),
        element("pre", "No point was clicked.", id="rows"),
        Html(f"<script>{library}</script>{script}<script>{_BEGIN % json.dumps(ids)}</script>"),
    )


def _columns(found: Sequence[SweepCurve]) -> int:
    """Panels side by side."""
    return min(len({curve.force_plane for curve in found}), 2)


def _panels(fit: FitResult, found: Sequence[SweepCurve]) -> tuple[list[tuple[Any, Any]], list[Any]]:
    """Amplitude and phase of each probe and force on one axis of frequency, and the sources of their points."""
    from bokeh.models import ColumnDataSource, HoverTool, Legend, LegendItem, PlainText
    from bokeh.plotting import figure

    from rotorfit.show.plots.bode import broken_phase, degrees, frequency_label, panel_name, response_unit
    from rotorfit.show.plots.style import PHASE_LABEL, PLAIN

    readings = {
        number: _readings(fit.experiments[number], base)
        for number, base in enumerate(block.responses for block in fit.problem.blocks)
        if base is not None and any((curve.block == number).any() for curve in found)
    }
    panels: list[tuple[Any, Any]] = []
    sources: list[Any] = []
    conditions: dict[str, list[Any]] = {}
    for pair in sorted({(c.coordinate, c.force_plane) for c in found}):
        factor, unit = response_unit(PLAIN, fit.model, pair[0], found)
        imposed = unit.startswith("N/")
        look: dict[str, Any] = {"tools": "box_zoom,wheel_zoom,tap,reset,save", "active_drag": "box_zoom"}
        look |= {"height": 250, **({"x_range": panels[0][0].x_range} if panels else {})}
        top = figure(y_axis_type="log", y_axis_label=unit if imposed else f"amplitude, {unit}", **look)
        top.title.text = PlainText(text=panel_name(fit.model, *pair))
        phase = "phase lead of the force, deg" if imposed else PHASE_LABEL
        low = figure(y_range=(-190, 190), y_axis_label=phase, **{**look, "x_range": top.x_range})
        low.xaxis.axis_label = frequency_label(PLAIN, found)
        low.yaxis.ticker = [-180, -90, 0, 90, 180]
        panels.append((top, low))
        for curve in (c for c in found if (c.coordinate, c.force_plane) == pair):
            words = [readings[b][r] for b, r in zip(curve.block.tolist(), curve.reading.tolist(), strict=True)]
            points: dict[str, Any] = {name: [w[k] for w in words] for k, name in enumerate(("where", "run", "rows"))}
            points |= {"rpm": curve.frequency * RPM_PER_RAD_S, "phase": degrees(curve.seen)}
            sources.append(ColumnDataSource({**points, "amplitude": factor * np.abs(curve.measured)}))
            drawn = conditions.setdefault(curve.condition.name.replace(r"\$", "$"), [])
            lines = factor * np.abs(curve.fitted), broken_phase(curve.line_seen)
            for plot, name, line in zip((top, low), ("amplitude", "phase"), lines, strict=True):
                shown = plot.scatter("rpm", name, source=sources[-1], color=curve.condition.colour, size=4)
                drawn += [shown, plot.line(curve.fine * RPM_PER_RAD_S, line, color=curve.condition.colour)]
                tips = [("", f"@{name}{{%.4g}}"), ("", "@where"), ("", "@run")]
                form = {f"@{name}": "printf"}
                plot.add_tools(HoverTool(tooltips=tips, formatters=form, renderers=[shown], visible=False))
    across = 4  # conditions in a row of the legend
    for top, _ in panels[: _columns(found)]:  # one above each, so that panels side by side are of one height
        items = [LegendItem(label={"value": name}, renderers=drawn) for name, drawn in conditions.items()]
        top.add_layout(Legend(items=items, click_policy="hide", orientation="horizontal", ncols=across), "above")
    return panels, sources


def _readings(experiment: Experiment, base: Responses) -> list[tuple[str, str, str]]:
    """Of each reading: its frequency and speed, its run, and the rows of the data that it was made from."""
    columns = {**experiment.attributes, **experiment.table_columns()}
    rows = list(zip(*(values.tolist() for values in columns.values()), strict=True))
    line = experiment.line_of_rows
    of_line: dict[tuple[int, str], list[str]] = {}
    for number, (at, plane, row) in enumerate(zip(line.tolist(), columns["plane"].tolist(), rows, strict=True)):
        cells = ", ".join(
            f"{name} {value:.6g}" if isinstance(value, float) else f"{name} {value}"
            for name, value in zip(columns, row, strict=True)
        )
        of_line.setdefault((at, plane), []).append(f"{experiment.source or 'data'}, reading {number + 1}: {cells}")
    found = []
    for at, place, run in zip(base.line.tolist(), base.coordinate.tolist(), base.run.tolist(), strict=True):
        w, speed = (significant(values[at] * RPM_PER_RAD_S, 5) for values in (base.frequency, base.speed))
        own = of_line.get((at, base.model.coordinates[place].plane), [])
        found.append((f"{w} rpm, rotor at {speed} rpm", f"run {run}", "\n".join(own)))
    return found
