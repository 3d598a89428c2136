"""The form of the model: which one, what is known of its parameters, and the options that change most."""

from __future__ import annotations

import inspect
from argparse import ArgumentTypeError
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import panel as pn

from rotorfit.app.parts import LONG_LABEL, WIDE, folded, markup, message, shown_in, side_by_side
from rotorfit.estimators.misfit.losses import LOSSES
from rotorfit.models import LAWS, MODELS
from rotorfit.options.table import FIT
from rotorfit.report.html import element
from rotorfit.studies.wording import sentence

if TYPE_CHECKING:
    from rotorfit.app.front import Front
    from rotorfit.models.parameters import Parameter

_CHOICES = {
    "law": ("law of eccentricity", ["", *LAWS]),
    "loss": ("loss", ["", *LOSSES]),
    "phase_offsets": ("zero of the phases", {"known": "", "one for every run but the first": True, "common": "common"}),
}
"""Options with a few values: label and choices."""
_WORDS = {"planes": "planes, in the model's order: A,B", "clearance_um": "clearance, µm", "modes": "modes (modal)"}
"""Options that are written: label."""


def model_form(page: Front) -> tuple[list[Any], Callable[[], bool]]:
    """Fields for the model, which change the study when they are left; and what takes them in, if they are right."""
    content = page.session.content
    labels = {f"{name}: {(inspect.getdoc(kind) or '').splitlines()[0]}": name for name, kind in MODELS.items()}
    model = pn.widgets.Select(name="Model", options=labels, value=content["model"], **WIDE)
    model.param.watch(lambda event: page.change_model(lambda: page.session.with_model(event.new)), "value")
    fields: dict[str, Any] = {}

    def take_in() -> bool:
        return all(_know(page, name, shown_in(field)) for name, field in fields.items())

    usual = not set(content) & {*_CHOICES, *_WORDS, "refine"}
    more = folded("More options", _options(page), shown=not usual)
    return [model, _known(page, fields), more], take_in


def _known(page: Front, fields: dict[str, Any]) -> Any:
    """A field for each parameter: a number where it is known; fields are added by name."""
    try:
        parameters = page.session.model.parameters
    except (ValueError, KeyError) as problem:
        return message(sentence(problem), "error")
    fields.update({p.name: _field(page, p) for p in parameters})
    words = "Values that are known; what is left empty is fitted, but for those whose usual value stands in grey."
    return pn.Column(
        markup(element("p", words, class_="faint")),
        side_by_side(list(fields.values()), least=250),
        **WIDE,
    )


def _field(page: Front, p: Parameter) -> Any:
    known = page.session.content.get("known", {})
    field = pn.widgets.TextInput(
        name=f"{p.name}{'' if p.unit == '1' else f', {p.unit}'}: {p.meaning}",
        value=str(known.get(p.name, "")),
        placeholder="fitted" if p.default is None else f"{p.default:g}; write free to fit it",
        stylesheets=[LONG_LABEL],
        **WIDE,
    )
    field.param.watch(lambda event: _know(page, p.name, event.new.strip()), "value")
    return field


def _know(page: Front, name: str, word: str) -> bool:
    known = {key: value for key, value in page.session.content.get("known", {}).items() if key != name}
    if word:
        try:
            known[name] = "free" if word == "free" else float(word)
        except ValueError:
            page.say(f"{name}: {word!r} is not a number")
            return False
    page.say("")
    page.session = page.session.with_option("known", known)
    return True


def _options(page: Front) -> Any:
    fields: list[Any] = []
    for name, (label, choices) in _CHOICES.items():
        field = pn.widgets.Select(name=label, options=choices, value=page.session.content.get(name, ""), **WIDE)
        field.param.watch(lambda event, name=name: _set(page, name, event.new), "value")
        fields.append(field)
    for name, label in _WORDS.items():
        value = page.session.content.get(name, "")
        shown = ",".join(value) if isinstance(value, list) else str(value)
        field = pn.widgets.TextInput(name=label, value=shown, **WIDE)
        field.param.watch(lambda event, name=name: _write(page, name, event.new.strip()), "value")
        fields.append(field)
    refine = pn.widgets.Checkbox(name=FIT["refine"].help, value=bool(page.session.content.get("refine")), **WIDE)
    refine.param.watch(lambda event: _set(page, "refine", event.new), "value")
    return side_by_side([*fields, refine], least=250)


def _write(page: Front, name: str, word: str) -> None:
    """Set an option by a word as behind that option on the command line."""
    parse = FIT[name].kind.word
    try:
        value = parse(word) if word and parse is not None else None
    except (ValueError, ArgumentTypeError) as problem:
        page.say(f"{_WORDS[name]}: {problem}")
        return
    _set(page, name, list(value) if isinstance(value, tuple) else value)


def _set(page: Front, name: str, value: Any) -> None:
    page.change_model(lambda: page.session.with_option(name, value))
