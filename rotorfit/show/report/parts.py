"""Pieces that several sections of the report share."""

from __future__ import annotations

import re

from rotorfit.base.units import RPM_PER_RAD_S
from rotorfit.identify.fitting.quantities import Quantity
from rotorfit.identify.fitting.result import FitResult
from rotorfit.identify.uncertainty.bootstrap import Bootstrap
from rotorfit.identify.uncertainty.posterior import Posterior
from rotorfit.models import RotorModel
from rotorfit.models.motion.equation_text import symbol_mathml
from rotorfit.show.plots.journal import group_label, groups_in_order
from rotorfit.show.report.html import Html, element, join
from rotorfit.show.report.numbers import interval, superscript


def section(title: str, *content: str, figure: bool = False, folded: bool = False) -> Html:
    """A section with its heading, which a click unfolds where it is folded."""
    attributes = {"id": re.sub(r"\W+", "-", title.lower()).strip("-")} | ({"class_": "figure"} if figure else {})
    heading = element("h2", title)
    inner = [element("details", element("summary", heading), *content)] if folded else [heading, *content]
    return element("section", *inner, **attributes)


def capital(text: str) -> str:
    """Text with a capital at its beginning."""
    return text[:1].upper() + text[1:]


def sentence(text: str) -> str:
    """Text with a capital at its beginning and a full stop at its end."""
    return capital(text) + ("" if text.endswith((".", "?", "!")) else ".")


def note(*words: str) -> Html:
    """A remark in small type."""
    return element("p", " ".join(words), class_="note")


def symbol(name: str, model: RotorModel) -> Html:
    """A parameter as a formula writes it, then as code does; what is not of the model as code only."""
    stem, code = name.partition("[")[0], element("code", name)
    if stem not in model.parameter_names:
        return code
    return join([element("math", Html(symbol_mathml(stem))), code], " ")


def unit_shown(unit: str) -> str:
    """A unit as people write it, nothing for pure numbers."""
    return "" if unit == "1" else re.sub(r"\^(\d+)", lambda found: superscript(int(found[1])), unit)


def groups_of(fit: FitResult) -> list[tuple[str, int]]:
    """Parameter groups in order: what tells each apart, empty for a single one, and its number."""
    return [(group_label(fit, group), group) for group in groups_in_order(fit)]


def at_of(fit: FitResult, group: int) -> dict[str, str] | None:
    """Argument of :meth:`FitResult.group` for a group."""
    parts = (label.partition("=") for label in fit.problem.space.labels[group])
    return {attribute: value for attribute, _, value in parts} or None


def onset_interval(fit: FitResult, onset: Quantity) -> tuple[float, float]:
    """95 % interval of a threshold speed, rad/s, its systematic share included."""
    return onset.interval(0.95)


def threshold_interval(draws: Posterior | Bootstrap | None, at: dict[str, str] | None) -> str:
    """Central 95 % of the threshold speed in words, rpm, empty without draws."""
    if draws is None:
        return ""
    low, high = draws.threshold_speed(at).interval(0.95)
    return interval(float(low) * RPM_PER_RAD_S, float(high) * RPM_PER_RAD_S)
