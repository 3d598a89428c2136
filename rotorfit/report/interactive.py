"""Section of the report to point at: every response with its fit as Plotly draws them, the script inside the page."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from html import escape
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

import numpy as np

from rotorfit.data.experiments import Experiment, PerturbationTest
from rotorfit.estimators.blocks.nonlinear import responses_of
from rotorfit.estimators.blocks.observations import Responses
from rotorfit.fitting.result import FitResult
from rotorfit.io.tables.tidy_csv import columns_without_attributes
from rotorfit.models.digits import significant
from rotorfit.report.html import Html, element
from rotorfit.report.parts import note, section
from rotorfit.units import RPM_PER_RAD_S

if TYPE_CHECKING:
    from rotorfit.plots.sweeps import SweepCurve

_WORDS = (
    "Points: measured; lines: fit. Drag to zoom all panels, double-click to return; the legend hides and shows "
    "conditions; a click on a point writes its rows of the data below the figure."
)
_SHOW_ROWS = """
const plot = document.getElementById('responses');
plot.on('plotly_click', event => {
  document.getElementById('rows').textContent = plot.layout.meta[event.points[0].customdata];
});
"""
"""Script that writes what the data hold at a clicked point."""


def check_interactive() -> None:
    """Refuse interactive figures where Plotly is missing."""
    if find_spec("plotly") is None:
        raise ValueError('interactive figures need plotly: pip install "rotorfit[interactive]"')


def interactive_section(fit: FitResult) -> Html:
    """Amplitude and phase of every response to a circular force."""
    from plotly.io import to_html

    from rotorfit.plots.sweeps import curves, joined

    config = {"displaylogo": False, "responsive": True}
    try:
        _, found = curves(fit)
    except ValueError as reason:
        return section("Interactive Bode plots", note(f"There are none: {reason}."))
    figure = _figure(fit, joined(found))
    drawn = to_html(figure, config=config, full_html=False, div_id="responses", post_script=_SHOW_ROWS)
    return section(
        "Interactive Bode plots", note(_WORDS), Html(drawn), element("pre", "No point was clicked.", id="rows")
    )


def _figure(fit: FitResult, found: Sequence[SweepCurve]) -> dict[str, Any]:
    """Two panels for each probe and force, all above one another on one axis of frequency."""
    from rotorfit.plots.bode import frequency_label, panel_name, response_unit
    from rotorfit.plots.style import PHASE_LABEL

    pairs = sorted({(c.coordinate, c.force_plane) for c in found})
    columns = min(len({force for _, force in pairs}), 2)
    count, pixels = 2 * -(-len(pairs) // columns), 250  # panels above one another; height of one
    layout: dict[str, Any] = {"height": count * pixels + 150, "template": "none", "hovermode": "closest"}
    layout["legend"] = {"orientation": "h", "y": 1.01, "yanchor": "bottom"}
    readings = {
        number: _readings(fit.experiments[number], base)
        for number, base in enumerate(map(responses_of, fit.problem.blocks))
        if base is not None and any((curve.block == number).any() for curve in found)
    }
    traces: list[dict[str, Any]] = []
    rows: list[str] = []
    for place, pair in enumerate(pairs):
        row, column = divmod(place, columns)
        factor, unit = response_unit(fit, pair[0])
        phase = "phase lead of the force, deg" if unit.startswith("N/") else PHASE_LABEL
        kinds: tuple[dict[str, Any], ...] = (
            {"type": "log", "title": unit if unit.startswith("N/") else f"amplitude, {unit}"},
            {"dtick": 90, "range": [-190, 190], "title": phase},
        )
        for k, kind in enumerate(kinds):
            axis, top = 2 * place + k + 1, 1 - (2 * row + k) / count
            low, left = top - 0.75 / count, column / columns
            layout[f"yaxis{axis}"] = {"domain": [low, top], "anchor": f"x{axis}", **kind}
            layout[f"xaxis{axis}"] = {"domain": [left, left + 0.9 / columns], "anchor": f"y{axis}", "matches": "x"}
        layout[f"xaxis{2 * place + 1}"]["title"] = {"text": escape(panel_name(fit, *pair), quote=False), "standoff": 0}
        layout[f"xaxis{2 * place + 2}"]["title"] = {"text": frequency_label(found), "standoff": 0}
        for curve in found:
            if (curve.coordinate, curve.force_plane) == pair:
                words = [readings[b][r] for b, r in zip(curve.block.tolist(), curve.reading.tolist(), strict=True)]
                traces += _traces(curve, factor, 2 * place + 1, [hover for hover, _ in words], len(rows))
                rows += [text for _, text in words]
    layout["xaxis1"].pop("matches")
    layout["meta"] = rows
    named: set[str] = set()
    for trace in traces:  # a condition stands once in the legend
        trace["showlegend"] = trace["name"] not in named
        named.add(trace["name"])
    return {"data": traces, "layout": layout}


def _traces(
    curve: SweepCurve, factor: float, panel: int, hover: Sequence[str], first_row: int
) -> Iterator[dict[str, Any]]:
    """Points and line of one response in its panels of amplitude and phase."""
    from rotorfit.plots.bode import broken_phase, degrees

    name, colour = _plain(curve.condition.name), curve.condition.colour
    points = (factor * np.abs(curve.measured), degrees(curve.seen))
    lines = (factor * np.abs(curve.fitted), broken_phase(curve.line_seen))
    for axis, measured, fitted in zip((panel, panel + 1), points, lines, strict=True):
        common = {"name": name, "legendgroup": name, "xaxis": f"x{axis}", "yaxis": f"y{axis}"}
        yield common | {
            "mode": "markers",
            "marker": {"color": colour, "size": 5},
            "x": curve.frequency * RPM_PER_RAD_S,
            "y": measured,
            "text": hover,
            "customdata": np.arange(first_row, first_row + len(hover)),
            "hovertemplate": "%{significant(y, 4)}<br>%{text}<extra></extra>",
        }
        x = curve.fine * RPM_PER_RAD_S
        yield common | {"mode": "lines", "line": {"color": colour}, "x": x, "y": fitted, "hoverinfo": "skip"}


def _readings(experiment: Experiment, base: Responses) -> list[tuple[str, str]]:
    """Of each reading: what is shown beside the pointer, and the rows of the data that it was made from."""
    columns = {**experiment.attributes, **columns_without_attributes(experiment)}
    rows = list(zip(*(values.tolist() for values in columns.values()), strict=True))
    line = experiment.lines.apart()[0] if isinstance(experiment, PerturbationTest) else np.arange(len(rows))
    of_line: dict[tuple[int, str], list[str]] = {}
    for number, (at, plane, row) in enumerate(zip(line.tolist(), columns["plane"].tolist(), rows, strict=True)):
        cells = ", ".join(
            f"{name} {value:.6g}" if isinstance(value, float) else f"{name} {value}"
            for name, value in zip(columns, row, strict=True)
        )
        of_line.setdefault((at, plane), []).append(f"{experiment.source or 'data'}, reading {number + 1}: {cells}")
    found = []
    for at, place, run in zip(base.line.tolist(), base.coordinate.tolist(), base.run.tolist(), strict=True):
        w, speed = (values[at] * RPM_PER_RAD_S for values in (base.frequency, base.speed))
        own = of_line.get((at, base.model.coordinates[place].plane), [])
        found.append(
            (
                f"{significant(w, 5)} rpm, rotor at {significant(speed, 5)} rpm<br>run {escape(run, quote=False)}",
                "\n".join(own),
            )
        )
    return found


def _plain(text: str) -> str:
    """Words made for matplotlib, as Plotly takes them literally."""
    return escape(text.replace(r"\$", "$"), quote=False)
