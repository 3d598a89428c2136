"""Results of a study: its outcome, parameters with intervals, findings, figures to zoom into, downloads."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import panel as pn
from bokeh.layouts import column
from bokeh.models import BoxAnnotation, ColumnDataSource, HoverTool

from rotorfit.apps.app import parts
from rotorfit.apps.app.questions import question_parts
from rotorfit.apps.app.session import Session, toml_of
from rotorfit.apps.study_files.results import status
from rotorfit.apps.study_files.wording import sentence
from rotorfit.base.digits import interval, significant
from rotorfit.base.units import RPM_PER_RAD_S
from rotorfit.identify.diagnosis.data_errors import PHASE_ZEROS
from rotorfit.identify.fitting.fit_file import fit_to_json
from rotorfit.identify.fitting.headline import headline
from rotorfit.lab.io.files import to_dataframe
from rotorfit.lab.io.tables.result_tables import frame_csv
from rotorfit.show.plots.bode import broken_phase, panel_name
from rotorfit.show.plots.sweeps import SweepCurve, curves, joined
from rotorfit.show.report.html import Html, element, join, table

if TYPE_CHECKING:
    from rotorfit.apps.study_files.study import Outcome
    from rotorfit.identify.fitting.result import FitResult
    from rotorfit.lab.data.findings import Finding


def result_parts(outcome: Outcome, session: Session, undo: Callable[[Finding], None]) -> list[Any]:
    """The parts of the page that show an outcome; what the check of the data found stands with the data."""
    fit = outcome.best
    told = {found.message for own in session.findings for found in own}
    findings: list[Any] = []
    for found in fit.findings:
        if found.message not in told and (found.severity != "note" or found.origin == "reading"):
            findings += finding_parts(found, undo)
    return [
        parts.heading("Result"),
        parts.message(verdict(outcome), "good" if explains(outcome) else "error" if outcome.failure else "warning"),
        *findings,
        parts.markup(parameter_table(fit), *_notes(fit)),
        _figures(fit),
    ]


def finding_parts(found: Finding, undo: Callable[[Finding], None], label: str = "Undo this and fit again") -> list[Any]:
    """A finding, with a button where the data can be corrected as they stand."""
    words = parts.markup(parts.finding_words(found))
    if found.correction is None and found.code != PHASE_ZEROS:
        return [words]
    return [words, parts.button(label, partial(undo, found))]


def verdict(outcome: Outcome) -> str:
    """What can be said of an outcome in a sentence or two."""
    if outcome.data_errors:
        return "The data have an error, which stands here or with the data: no number below can be relied on."
    if outcome.failure:
        return f"{outcome.failure[:1].upper()}{outcome.failure[1:]}."
    return headline(outcome.best).verdict


def explains(outcome: Outcome) -> bool:
    """True for a fit that its model does not limit, of data without an error that determine every value."""
    fit = outcome.best
    return not (outcome.failure or fit.model_limited or fit.identifiability.unresolved)


def parameter_table(fit: FitResult) -> Html:
    """Parameters with standard errors and intervals, causes included."""
    head = ["parameter", "value", "standard error", "95 % interval", "unit", "", "meaning"]
    rows = []
    for p in fit.params.values():
        shown, said = p.shown(), status(p)
        ends = f"{shown.low} to {shown.high}" if shown.low else ""
        number = shown.value if p.determined else ""
        said = "" if said == "fitted" else said
        rows.append([p.name, number, shown.error, ends, "" if p.unit == "1" else p.unit, said, p.meaning])
    return table(head, rows, numeric=(1, 2, 3), whole=(4,))


def _notes(fit: FitResult) -> list[Html]:
    words = [f"{fit.ndata} real data, {fit.nvarys} fitted values, redchi {significant(fit.redchi, 4)}."]
    if fit.success and fit.model.speed_dependent and len(fit.thetas) == 1:
        onset = fit.threshold_speed()
        if math.isfinite(onset.value) and math.isfinite(onset.stderr):
            low, high = (end * RPM_PER_RAD_S for end in onset.interval())
            words.append(
                f"Threshold speed {significant(onset.value * RPM_PER_RAD_S, 5)} rpm, 95 % interval "
                f"{interval(low, high)}."
            )
    return [Html(f"<p>{join([' '.join(words)])}</p>")]


def _figures(fit: FitResult) -> Any:
    """A tab for each kind of figure, with one for each pair of probe and force; what is not shown is not sent."""
    tabs = pn.Tabs(dynamic=True, **parts.WIDE)
    try:
        conditions, found = curves(fit)
    except ValueError:  # of tests without turning forces there is nothing over frequency
        conditions, found = (), ()
    sweeps, colours = joined(found), {condition.name: condition.colour for condition in conditions}
    pairs = sorted({(curve.coordinate, curve.force_plane) for curve in sweeps})
    for name, draw in (("Bode", bode), ("Polar", polar), ("Residuals", residuals)) if pairs else ():
        figures = []
        for probe, force in pairs:
            own = [curve for curve in sweeps if (curve.coordinate, curve.force_plane) == (probe, force)]
            unit = "µrad/N" if fit.model.coordinates[probe].axis == "r" else "µm/N"
            figures.append(draw(own, panel_name(fit.model, probe, force), unit))
        tabs.append((name, pn.Column(parts.colour_key("", colours), parts.figures_beside(figures), **parts.WIDE)))
    tabs.extend(question_parts(fit))
    return tabs


def bode(found: Sequence[SweepCurve], title: str, unit: str) -> Any:
    """Amplitude and phase of a response to a unit force: points measured, lines fitted, with their 95 % bands."""
    top = parts.framed(title, 260, "", unit, y_axis_type="log")
    bottom = parts.framed("", 200, _FREQUENCY, "phase lead, °", x_range=top.x_range)
    bottom.y_range.start, bottom.y_range.end = -190, 190
    for curve in found:
        fine, band = curve.fine * RPM_PER_RAD_S, {"color": curve.condition.colour, "alpha": 0.2}
        size, (relative, turn) = 1e6 * np.abs(curve.fitted), curve.band
        reach, angle = np.exp(np.minimum(relative, 5.0)), broken_phase(curve.fitted)
        top.varea(fine, size / reach, size * reach, **band)
        bottom.varea(fine, angle - np.degrees(turn), angle + np.degrees(turn), **band)
        points = _measured(curve)
        for plot, name, fitted in ((top, "amplitude", size), (bottom, "phase", angle)):
            plot.line(fine, fitted, color=curve.condition.colour, line_width=1.4)
            drawn = plot.scatter("rpm", name, source=points, color=curve.condition.colour, size=3.5, alpha=0.6)
            _point_at(plot, drawn, unit)
    bottom.toolbar_location = None
    return column(top, bottom, sizing_mode="stretch_width")


def polar(found: Sequence[SweepCurve], title: str, unit: str) -> Any:
    """Response to a unit force in the complex plane."""
    plot = parts.framed(title, 380, f"in phase, {unit}", f"quadrature, {unit}", match_aspect=True)
    for curve in found:
        fitted = 1e6 * curve.fitted
        plot.line(fitted.real, fitted.imag, color=curve.condition.colour, line_width=1.4)
        points = _measured(curve)
        drawn = plot.scatter("real", "imag", source=points, color=curve.condition.colour, size=3.5, alpha=0.6)
        _point_at(plot, drawn, unit)
    return plot


def residuals(found: Sequence[SweepCurve], title: str, unit: str) -> Any:
    """Residuals over their noise: dots real, crosses imaginary; noise alone leaves 95 % in the band."""
    plot = parts.framed(title, 240, _FREQUENCY, "residual / noise")
    plot.add_layout(BoxAnnotation(bottom=-2, top=2, fill_color="#d5dbe1", fill_alpha=0.5, level="underlay"))
    for curve in found:
        points = _measured(curve)
        look = {"source": points, "color": curve.condition.colour, "alpha": 0.7}
        drawn = plot.scatter("rpm", "missed_real", size=3.5, **look)
        plot.scatter("rpm", "missed_imag", marker="x", size=5, **look)
        _point_at(plot, drawn, unit)
    return plot


_FREQUENCY = "frequency, rpm (backward < 0 < forward)"


def _measured(curve: SweepCurve) -> Any:
    value = 1e6 * curve.measured
    return ColumnDataSource(
        {
            "rpm": curve.frequency * RPM_PER_RAD_S,
            "amplitude": np.abs(value),
            "phase": np.degrees(np.angle(value)),
            "real": value.real,
            "imag": value.imag,
            "missed_real": curve.whitened.real,
            "missed_imag": curve.whitened.imag,
            "condition": [curve.condition.name] * value.size,
        }
    )


def _point_at(plot: Any, drawn: Any, unit: str) -> None:
    """Text of a point under the mouse."""
    tips = [("", "@condition"), ("frequency", "@rpm{0.0} rpm"), ("amplitude", f"@amplitude{{0.0000}} {unit}"),
            ("phase lead", "@phase{0.0}°"), ("residual / noise", "@missed_real{0.0} @missed_imag{+0.0}j")]  # fmt: skip
    plot.add_tools(HoverTool(tooltips=tips, renderers=[drawn], visible=False))


class Takeaway:
    """Downloads of an outcome, and a file in the folder."""

    def __init__(self, session: Session, outcome: Outcome) -> None:
        self._session = session
        files = [
            parts.download("study.toml", partial(toml_of, session, absolute=True)),
            parts.download("fit.json", partial(fit_to_json, outcome.best)),
        ]
        for number, test in enumerate(outcome.experiments, 1):
            as_csv = partial(lambda own: frame_csv(to_dataframe(own)), test)
            name = "data.csv" if len(outcome.experiments) == 1 else f"data-{number}.csv"
            files.append(parts.download(name, as_csv))
        self._report = pn.Column(parts.message("drawing the report ..."), width=220)
        free = session.folder.free_name("study.toml")
        name = pn.widgets.TextInput(name="Or keep the study in the folder, as", value=free, width=220)
        keep, self._kept = parts.button("Keep", lambda: self._keep(name.value), width=90), pn.Column(**parts.WIDE)
        self.parts = [
            parts.heading("Take away"),
            parts.markup(element("p", "rotorfit run study.toml gives the same numbers again, to the last digit.")),
            parts.in_a_row(*files, self._report),
            parts.in_a_row(name, keep),
            self._kept,
        ]

    def add_report(self, text: str) -> None:
        """Offer the report, which is drawn after the fit."""
        self._report.objects = [parts.download("report.html", partial(str, text))]

    def _keep(self, name: str) -> None:
        try:
            self._session.folder.write_new(name, toml_of(self._session, absolute=False))
        except (ValueError, OSError) as problem:
            self._kept.objects = [parts.message(sentence(problem), "error")]
        else:
            self._kept.objects = [parts.message(f"{name} is written; rotorfit run {name} repeats the fit.", "good")]
