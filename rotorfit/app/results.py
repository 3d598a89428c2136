"""Results of a study: its outcome, parameters with intervals, findings, figures."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import panel as pn

from rotorfit.app.fit_figures import bode, colours_of_conditions, fit_figures, polar, residuals
from rotorfit.app.parts import WIDE, button, colour_key, figures_beside, finding_words, heading, markup, message
from rotorfit.diagnosis.trials.data_errors import PHASE_ZEROS
from rotorfit.fitting.quantities import THRESHOLD, FittedParameter
from rotorfit.models.digits import interval, significant, with_error
from rotorfit.report.html import Html, join, table
from rotorfit.studies.results import status
from rotorfit.units import RPM_PER_RAD_S

if TYPE_CHECKING:
    from rotorfit.data.findings import Finding
    from rotorfit.fitting.result import FitResult
    from rotorfit.studies.study import Outcome

_FIGURES = (("Bode", bode), ("Polar", polar), ("Residuals", residuals))


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
    for name, draw in _FIGURES:
        figures = fit_figures(fit, draw)
        if figures:
            tabs.append((name, pn.Column(colour_key("", colours), figures_beside(figures), **WIDE)))
    return tabs
