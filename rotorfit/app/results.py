"""Results of a study: its outcome, parameters with intervals, findings, figures to zoom into, downloads."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import panel as pn

from rotorfit.app.parts import (
    WIDE,
    button,
    colour_key,
    download,
    figures_beside,
    finding_words,
    framed,
    heading,
    in_a_row,
    markup,
    message,
)
from rotorfit.app.session import Session, toml_of
from rotorfit.diagnosis.trials.data_errors import PHASE_ZEROS
from rotorfit.fitting.fit_file import fit_to_json
from rotorfit.fitting.quantities import THRESHOLD, FittedParameter
from rotorfit.io.files import to_dataframe
from rotorfit.io.tables.result_tables import frame_csv
from rotorfit.models.digits import interval, significant, with_error
from rotorfit.plots.bode import broken_phase, panel_name
from rotorfit.plots.sweeps import SweepCurve, curves, joined
from rotorfit.report.html import Html, element, join, table
from rotorfit.studies.results import status
from rotorfit.studies.wording import sentence
from rotorfit.units import RPM_PER_RAD_S

if TYPE_CHECKING:
    from rotorfit.data.experiments import Experiment
    from rotorfit.data.findings import Finding
    from rotorfit.fitting.result import FitResult
    from rotorfit.studies.study import Outcome


def result_parts(outcome: Outcome, undo: Callable[[Finding], None]) -> list[Any]:
    """The parts of the page that show an outcome."""
    fit = outcome.best
    went = (
        message(outcome.failure, "error")
        if outcome.failure
        else message(f"Fit: {fit.message}.", "warning" if fit.identifiability.unresolved else "good")
    )
    return [
        heading("Result"),
        went,
        markup(parameter_table(fit), *_notes(fit)),
        *[part for found in fit.findings for part in _finding(found, undo)],
        *[message(text, "warning") for text in fit.warnings],
        _figures(fit),
    ]


def _finding(found: Finding, undo: Callable[[Finding], None]) -> list[Any]:
    """A finding, and a button where the data can be corrected as they stand."""
    if found.correction is None and found.code != PHASE_ZEROS:
        return [markup(finding_words(found))]
    return [markup(finding_words(found)), button("Undo this and fit again", lambda: undo(found))]


def parameter_table(fit: FitResult) -> Html:
    """Parameters with standard errors and intervals that hold the systematic share too."""
    head = ["parameter", "value", "standard error", "95 % interval", "unit", "", "meaning"]
    return table(head, [_row(p) for p in fit.params.values()], numeric=(1, 2, 3), whole=(4,))


def _row(p: FittedParameter) -> Sequence[str]:
    unit = "" if p.unit == "1" else p.unit
    if not p.vary or not p.resolved or p.moved_by:
        shown = f"{p.value:.10g}" if not p.vary else ""
        return [p.name, shown, "", "", unit, status(p), p.meaning]
    value, error = with_error(p.value, math.hypot(p.stderr, p.systematic))
    return [p.name, value, error, interval(*p.interval()), unit, "" if status(p) == "fitted" else status(p), p.meaning]


def _notes(fit: FitResult) -> list[Html]:
    words = [f"{fit.ndata} real data, {fit.nvarys} fitted values, redchi {significant(fit.redchi, 4)}."]
    if fit.success and fit.model.speed_dependent and len(fit.thetas) == 1:
        onset = fit.threshold_speed()
        if fit.moved_by(THRESHOLD):
            words.append(f"Threshold speed not determined: {fit.moved_by(THRESHOLD)}.")
        elif math.isfinite(onset.value) and math.isfinite(onset.stderr):
            low, high = (end * RPM_PER_RAD_S for end in onset.interval())
            words.append(
                f"Threshold speed {significant(onset.value * RPM_PER_RAD_S, 5)} rpm, 95 % interval "
                f"{interval(low, high)}."
            )
    return [Html(f"<p>{join([' '.join(words)])}</p>")]


def _figures(fit: FitResult) -> Any:
    """A tab for each kind of figure; what is not shown is not sent."""
    tabs = pn.Tabs(dynamic=True, **WIDE)
    colours = colours_of_conditions(fit)
    for name, draw in (("Bode", bode), ("Polar", polar), ("Residuals", residuals)):
        figures = fit_figures(fit, draw)
        if figures:
            tabs.append((name, pn.Column(colour_key("", colours), figures_beside(figures), **WIDE)))
    return tabs


Draw = Callable[[Sequence[SweepCurve], str, str], Any]


def fit_figures(fit: FitResult, draw: Draw) -> list[Any]:
    """A figure of one kind for each pair of probe and force; none of a fit without turning forces."""
    try:
        _, found = curves(fit)
    except ValueError:  # of other tests there is nothing over frequency
        return []
    pairs = dict.fromkeys((curve.coordinate, curve.force_plane) for curve in joined(found))
    figures = []
    for probe, force in sorted(pairs):
        own = [curve for curve in joined(found) if (curve.coordinate, curve.force_plane) == (probe, force)]
        unit = "µrad/N" if fit.model.coordinates[probe].axis == "r" else "µm/N"
        figures.append(draw(own, panel_name(fit, probe, force), unit))
    return figures


def colours_of_conditions(fit: FitResult) -> dict[str, str]:
    """Colour of each condition of the rotor that the figures tell apart."""
    try:
        return {condition.name: condition.colour for condition in curves(fit)[0]}
    except ValueError:  # as above
        return {}


def bode(found: Sequence[SweepCurve], title: str, unit: str) -> Any:
    """Amplitude and phase of a response to a unit force: points measured, lines fitted, with their 95 % bands."""
    from bokeh.layouts import column

    top = framed(title, 260, "", unit, y_axis_type="log")
    bottom = framed("", 200, _FREQUENCY, "phase lead, °", x_range=top.x_range)
    bottom.y_range.start, bottom.y_range.end = -190, 190
    for curve in found:
        x, fine = curve.frequency * RPM_PER_RAD_S, curve.fine * RPM_PER_RAD_S
        size, (relative, turn) = 1e6 * np.abs(curve.fitted), curve.band
        reach, angle = np.exp(np.minimum(relative, 5.0)), broken_phase(curve.fitted)
        _band(top, fine, size / reach, size * reach, curve.condition.colour)
        _band(bottom, fine, angle - np.degrees(turn), angle + np.degrees(turn), curve.condition.colour)
        points = _measured(curve, x)
        for plot, name, fitted in ((top, "amplitude", size), (bottom, "phase", angle)):
            plot.line(fine, fitted, color=curve.condition.colour, line_width=1.4)
            drawn = plot.scatter("rpm", name, source=points, color=curve.condition.colour, size=3.5, alpha=0.6)
            _point_at(plot, drawn, unit)
    bottom.toolbar_location = None
    return column(top, bottom, sizing_mode="stretch_width")


def polar(found: Sequence[SweepCurve], title: str, unit: str) -> Any:
    """Response to a unit force in the complex plane."""
    plot = framed(title, 380, f"in phase, {unit}", f"quadrature, {unit}", match_aspect=True)
    for curve in found:
        fitted = 1e6 * curve.fitted
        plot.line(fitted.real, fitted.imag, color=curve.condition.colour, line_width=1.4)
        points = _measured(curve, curve.frequency * RPM_PER_RAD_S)
        drawn = plot.scatter("real", "imag", source=points, color=curve.condition.colour, size=3.5, alpha=0.6)
        _point_at(plot, drawn, unit)
    return plot


def residuals(found: Sequence[SweepCurve], title: str, unit: str) -> Any:
    """Residuals over their noise: dots real, crosses imaginary; noise alone leaves 95 % in the band."""
    from bokeh.models import BoxAnnotation

    plot = framed(title, 240, _FREQUENCY, "residual / noise")
    plot.add_layout(BoxAnnotation(bottom=-2, top=2, fill_color="#d5dbe1", fill_alpha=0.5, level="underlay"))
    for curve in found:
        points = _measured(curve, curve.frequency * RPM_PER_RAD_S)
        look = {"source": points, "color": curve.condition.colour, "alpha": 0.7}
        drawn = plot.scatter("rpm", "missed_real", size=3.5, **look)
        plot.scatter("rpm", "missed_imag", marker="x", size=5, **look)
        _point_at(plot, drawn, unit)
    return plot


_FREQUENCY = "frequency, rpm (backward < 0 < forward)"


def _measured(curve: SweepCurve, rpm: Any) -> Any:
    from bokeh.models import ColumnDataSource

    value = 1e6 * curve.measured
    return ColumnDataSource(
        {
            "rpm": rpm,
            "amplitude": np.abs(value),
            "phase": np.degrees(np.angle(value)),
            "real": value.real,
            "imag": value.imag,
            "missed_real": curve.whitened.real,
            "missed_imag": curve.whitened.imag,
            "condition": [curve.condition.name] * rpm.size,
        }
    )


def _point_at(plot: Any, drawn: Any, unit: str) -> None:
    """Text of a point under the mouse."""
    from bokeh.models import HoverTool

    tips = [("", "@condition"), ("frequency", "@rpm{0.0} rpm"), ("amplitude", f"@amplitude{{0.0000}} {unit}"),
            ("phase lead", "@phase{0.0}°"), ("residual / noise", "@missed_real{0.0} @missed_imag{+0.0}j")]  # fmt: skip
    plot.add_tools(HoverTool(tooltips=tips, renderers=[drawn], visible=False))


def _band(plot: Any, x: Any, low: Any, high: Any, colour: str) -> None:
    plot.varea(x, low, high, color=colour, alpha=0.2)


class Takeaway:
    """Downloads of an outcome, and a file in the folder."""

    def __init__(self, session: Session, outcome: Outcome) -> None:
        self._session = session
        files = [
            download("study.toml", partial(toml_of, session, absolute=True)),
            download("fit.json", partial(fit_to_json, outcome.best)),
        ]
        for number, test in enumerate(outcome.experiments, 1):
            name = "data.csv" if len(outcome.experiments) == 1 else f"data-{number}.csv"
            files.append(download(name, partial(_as_csv, test)))
        self._report = pn.Column(message("drawing the report ..."), width=220)
        free = session.folder.free_name("study.toml")
        name = pn.widgets.TextInput(name="Or keep the study in the folder, as", value=free, width=220)
        keep, self._kept = button("Keep", lambda: self._keep(name.value), width=90), pn.Column(**WIDE)
        self.parts = [
            heading("Take away"),
            markup(element("p", "rotorfit run study.toml gives the same numbers again, to the last digit.")),
            in_a_row(*files, self._report),
            in_a_row(name, keep),
            self._kept,
        ]

    def add_report(self, text: str) -> None:
        """Offer the report, which is drawn after the fit."""
        self._report.objects = [download("report.html", partial(str, text))]

    def _keep(self, name: str) -> None:
        try:
            self._session.folder.write_new(name, toml_of(self._session, absolute=False))
        except (ValueError, OSError) as problem:
            self._kept.objects = [message(sentence(problem), "error")]
        else:
            self._kept.objects = [message(f"{name} is written; rotorfit run {name} repeats the fit.", "good")]


def _as_csv(test: Experiment) -> str:
    return frame_csv(to_dataframe(test))
