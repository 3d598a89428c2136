"""What an identified rotor is asked on the page: how stable it is, whether it may run, how it would move."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
import panel as pn

from rotorfit.apps.app import parts
from rotorfit.apps.app.forms import number_in, text_field
from rotorfit.apps.app.words import on_the_page
from rotorfit.apps.study_files.wording import sentence
from rotorfit.base.units import RAD_S_PER_RPM, RPM_PER_RAD_S
from rotorfit.identify.options.kinds import number_word, pairs
from rotorfit.lab.io.tables.result_tables import frame_csv
from rotorfit.show.plots.style import picture_of
from rotorfit.show.report.html import element

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from rotorfit.identify.fitting.result import FitResult


def question_parts(fit: FitResult) -> list[tuple[str, Any]]:
    """A panel for each question, with its name."""
    if not fit.success:
        return []
    asked = [("Judge", _judged(fit)), ("Prediction", _predicted(fit))]
    return [("Stability", _stability(fit)), *asked] if fit.model.speed_dependent else asked


def picture(figure: Figure) -> Any:
    """A figure of the report."""
    return pn.pane.PNG(picture_of(figure), sizing_mode="scale_width", max_width=900)


def _stability(fit: FitResult) -> Any:
    return _answered("Draw how damping changes with speed", [], lambda: [picture(fit.plot.stability())])


def _judged(fit: FitResult) -> Any:
    top = max((float(np.abs(test.set_speed).max()) for test in fit.experiments), default=0.0) * RPM_PER_RAD_S
    highest = text_field("highest running speed, rpm", f"{top:.6g}")
    lowest = text_field("lowest running speed, rpm", None, placeholder="the highest")
    least = text_field("least log. decrement", "0.1")
    unbalance = text_field("unbalance, g mm, by plane", None, placeholder=f"{fit.model.planes[0]}=30")
    largest = text_field("largest amplitude, µm 0-peak", None, placeholder="none")

    def answer() -> list[Any]:
        given = {"max_speed_rpm": highest, "min_speed_rpm": lowest, "min_decrement": least, "max_amplitude_um": largest}
        numbers = {name: number_in(field) for name, field in given.items() if parts.shown_in(field)}
        words = parts.shown_in(unbalance)
        weights = {"unbalance_g_mm": pairs(unbalance.name, [words], number_word)} if words else {}
        found = fit.stability_report(**numbers, **weights)  # type: ignore[arg-type]
        return [parts.markup(element("pre", on_the_page(str(found)), class_="table")), picture(found.plot())]

    return _answered("Judge", [highest, lowest, least, unbalance, largest], answer)


def _predicted(fit: FitResult) -> Any:
    planes = list(fit.model.planes)
    top = max((float(np.abs(test.set_speed).max()) for test in fit.experiments), default=0.0) * RPM_PER_RAD_S
    low, high = text_field("from, rpm", f"{top / 4:.4g}"), text_field("to, rpm", f"{top:.6g}")
    size = text_field("unbalance, g mm", "10")
    at = pn.widgets.Select(name="of a weight at", options=planes, **parts.WIDE)
    seen = pn.widgets.Select(name="motion at", options=planes, **parts.WIDE)

    def answer() -> list[Any]:
        points = 200  # along a run-up, more than a figure of this width resolves
        speeds = np.linspace(number_in(low), number_in(high), points) * RAD_S_PER_RPM
        mr = number_in(size) * 1e-6
        found = fit.predict(None, speeds, force_plane=at.value, mr=mr, plane=seen.value)
        notes = [parts.message(note, "warning") for note in found.notes]
        table = parts.download("prediction.csv", lambda: frame_csv(found.to_dataframe()))
        return [*notes, picture(found.plot()), table]

    return _answered("Predict", [low, high, size, at, seen], answer)


def _answered(label: str, fields: list[Any], answer: Callable[[], list[Any]]) -> Any:
    """Fields, a button, and below it what it gives or why it gives nothing."""
    shown = pn.Column(**parts.WIDE)

    def ask() -> None:
        shown.objects = [parts.message("working it out ...")]
        try:
            shown.objects = answer()
        except (ValueError, ArithmeticError) as problem:
            shown.objects = [parts.message(sentence(problem), "error")]

    return pn.Column(parts.side_by_side(fields, least=200), parts.button(label, ask, main=True), shown, **parts.WIDE)
