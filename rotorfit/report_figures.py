"""Sections of the report that are figures, with the tables that belong to them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from rotorfit import plots
from rotorfit.estimators.observations import Responses
from rotorfit.markup import Html, element, paragraph, picture, table
from rotorfit.report_numbers import RPM, with_error
from rotorfit.report_sections import groups_of, section

if TYPE_CHECKING:
    from rotorfit.report import PosteriorLike, ReportInput
    from rotorfit.results import FitResult

_CORNER = 12
"""Parameters a corner plot can show on a page."""


def figure_sections(material: ReportInput) -> Iterator[Html]:
    """Dynamic stiffness, responses, residuals, stability, posterior."""
    fit = material.fit
    if any(isinstance(block, Responses) for block in fit.problem.blocks):
        caption = "Points: measured, with one standard deviation. Lines: fit, with its 95 % band."
        yield section("Dynamic stiffness", picture(plots.plot_dynamic_stiffness(fit), caption), figure=True)
        caption = "Responses to a unit force. Points: measured. Lines: fit."
        yield section("Bode plots", picture(plots.plot_bode(fit), caption), figure=True)
        yield section("Polar plots", picture(plots.plot_polar(fit), caption), figure=True)
        yield section("Residuals and quality of fit", *_residuals(fit))
    yield section("Stability", *_stability(fit))
    if material.posterior is not None:
        yield section("Posterior", *_posterior(material.posterior, fit))


def _residuals(fit: FitResult) -> Iterator[Html]:
    caption = "Residuals over their noise; noise alone would leave 95 % of them in the grey band."
    yield picture(plots.plot_residuals(fit), caption)
    rows = [[r.name, str(r.count), f"{100 * r.nrmse:.3g} %", f"{r.frac:.6f}", f"{r.redchi:.3g}"] for r in fit.responses]
    yield table(["response", "readings", "NRMSE", "FRAC", "redchi"], rows, numeric=(1, 2, 3, 4))
    note = (
        "NRMSE: rms residual over rms response. FRAC: frequency response assurance criterion, 1 for equal shape. "
        "redchi: mean squared residual over the noise's variance, 1 for noise alone."
    )
    yield element("p", note, class_="note")


def _stability(fit: FitResult) -> Iterator[Html]:
    for label, group in groups_of(fit):
        caption = "Eigenvalues of the fitted rotor against its speed" + (f", {label}." if label else ".")
        yield picture(plots.plot_stability(fit, group=group), caption)
    rows = [row for label, group in groups_of(fit) for row in _mode_rows(fit, label, group)]
    head = ["group", "rotative speed, rpm", "damped frequency, rpm", "±", "damping ratio", "±"]
    if rows and not rows[0][0]:
        head, rows = head[1:], [row[1:] for row in rows]
    yield table(head, rows, numeric=range(len(head) - 5, len(head)))


def _mode_rows(fit: FitResult, label: str, group: int) -> Iterator[list[str]]:
    at = dict(part.split("=", 1) for part in label.split(", ")) if label else None
    speeds = fit.speeds if fit.model.speed_dependent else np.zeros(1)
    for speed in speeds.tolist():
        for frequency, damping in fit.natural_frequencies(speed, at):
            shown = f"{speed * RPM:.0f}" if fit.model.speed_dependent else "any"
            yield [
                label, shown, *with_error(frequency.value * RPM, frequency.stderr * RPM),
                *with_error(damping.value, damping.stderr),
            ]  # fmt: skip


def _posterior(posterior: PosteriorLike, fit: FitResult) -> Iterator[Html]:
    names = list(posterior.names)
    units = {name: p.unit for name, p in fit.params.items() if p.unit != "1"}
    labels = [f"{name}, {units[name]}" if name in units else name for name in names]
    shown = labels[:_CORNER]
    marks = {label: fit.params[name].value for label, name in zip(labels, names, strict=True) if name in fit.params}
    caption = "Posterior: margins and pairs, contours of 68 and 95 %; lines: the optimum." + (
        f" The first {_CORNER} of {len(names)} parameters." if len(names) > _CORNER else ""
    )
    yield picture(plots.plot_corner(np.asarray(posterior.samples)[:, : len(shown)], shown, marks), caption)
    summary = getattr(posterior, "summary", None)
    if callable(summary):
        yield element("h3", "Health of the chains")
        yield element("pre", str(summary()))
    chain = getattr(posterior, "chain", None)
    if chain is None:
        yield paragraph("These samples come without their chains, so mixing cannot be shown.")
    else:
        yield picture(plots.plot_traces(np.asarray(chain), names), "Walkers against the step.")
