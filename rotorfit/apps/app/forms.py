"""Forms of the page: how test files are read, which channel of a recording is what, and the model.

What is entered goes into the study's TOML, or into a new rig.toml in the folder.
"""

from __future__ import annotations

import inspect
import tomllib
from argparse import ArgumentTypeError
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import panel as pn

from rotorfit.apps.app.parts import LONG_LABEL, WIDE, button, folded, in_a_row, markup, message, shown_in, side_by_side
from rotorfit.apps.app.session import entry_table, with_read_option
from rotorfit.apps.study_files.wording import sentence
from rotorfit.estimators.misfit.problem import LOSSES
from rotorfit.identify.options.kinds import number_word, pairs, two_numbers
from rotorfit.identify.options.table import FIT
from rotorfit.lab.recordings.formats.files import FORMATS, open_raw
from rotorfit.lab.recordings.recording import read_recording
from rotorfit.lab.recordings.rig.rig_toml import setup_of
from rotorfit.lab.recordings.rig.template import template
from rotorfit.models import LAWS, MODELS
from rotorfit.show.report.html import element

if TYPE_CHECKING:
    from rotorfit.apps.app.session import Front


def _text(name: str, value: Any, left: Callable[[str], object] | None = None, **look: Any) -> Any:
    """A field of text, empty for None, and what is done with its words when it is left."""
    shown = "" if value is None else str(value)
    field = pn.widgets.TextInput(name=name, value=shown, **(look if "width" in look else {**look, **WIDE}))
    if left is not None:
        field.param.watch(lambda event: left(event.new.strip()), "value")
    return field


def _number(label: str, word: str) -> float:
    try:
        return float(word)
    except ValueError:
        raise ValueError(f"{label}: {word!r} is not a number") from None


# ---- how a test file is read ------------------------------------------------------------------------------------


def _pairs(word: str, value: Callable[[str], Any] = str) -> Any:
    return pairs("this field", [word], value)


_FIELDS: Mapping[str, tuple[str, str, Callable[[str], Any]]] = {
    "columns": ("columns under the names that rotorfit knows", "amplitude_um=Ampl. 1X", _pairs),
    "constants": ("columns that the table does not have", "force_plane=disk, mr_g_mm=30", _pairs),
    "probe_angles_deg": (
        "where the probes x and y sit, degrees from X towards Y",
        "journal=45:135",
        partial(_pairs, value=lambda word: list(two_numbers(word))),
    ),
    "slow_roll_below_rpm": ("run-out from readings below, rpm", "300", number_word),
    "drop_near_1x": ("leave out within this share of 1x", "0.02", number_word),
    "speed_rpm": ("speed of a universal file, rpm", "1500", number_word),
    "axes": ("directions of a universal file that are x and y", "yz", str),
    "sheet": ("sheet of an Excel file", "the first", str),
}
"""Options of reading by their key in the TOML file: label, example, and what makes a value of what is written."""


def read_form(page: Front, entry: int) -> Any:
    """Fields of one test file, which is read again when one is left; or it is a recording, if it cannot be read."""
    table = entry_table(page.session.content["files"][entry])

    def left(key: str, word: str) -> None:
        label, _, parse = _FIELDS[key]
        try:
            entered = parse(word) if word else None
        except ValueError as problem:
            page.say(f"{label}: {problem}")
            return
        page.change(lambda: with_read_option(page.session, entry, key, entered))

    fields = []
    for key, (label, example, _) in _FIELDS.items():
        value = table.get(key)
        if isinstance(value, dict):
            parts = {name: ":".join(map(str, v)) if isinstance(v, list) else v for name, v in value.items()}
            value = ", ".join(f"{name}={part}" for name, part in parts.items())
        fields.append(_text(label, value, partial(left, key), placeholder=example, stylesheets=[LONG_LABEL]))
    title = f"Correct how {table['path']} is read"
    unread, parts_shown = page.session.data is None, [side_by_side(fields, least=300)]
    if unread and Path(table["path"]).suffix.lower() in FORMATS:
        words = "It holds raw signals: say which channel is what"
        parts_shown.append(button(words, lambda: page.change(page.session.as_recordings)))
    return folded(title, *parts_shown, shown=unread)


# ---- which channel of a recording is what -----------------------------------------------------------------------


_MARKS = {"mark of the shaft": "shaft", "mark of the perturbator": "perturbator"}
_ROLES = ("not used", *_MARKS, "probe")
_FORCE = {
    "plane": "plane of the force",
    "mr_kg_m": "unbalance of the perturbator, kg m",
    "angle_deg": "heavy spot ahead of the mark, °",
}


class SetupForm:
    """Fields for the channels of a recording, filled in from its setup, else from what the recording says."""

    def __init__(self, page: Front, path: Path) -> None:
        self._page = page
        self._path = path
        given: Sequence[str] = [entry["setup"] for entry in page.session.content["files"] if "setup" in entry]
        text = page.session.folder.path(given[0]).read_text(encoding="utf-8") if given else template(path)
        self._base: Mapping[str, Any] = tomllib.loads(text)
        self._rows = {name: _ChannelRow(name, self._base) for name in open_raw(path).channels}
        force = self._base.get("force", {})
        self._force = {key: _text(label, force.get(key)) for key, label in _FORCE.items()}
        self._whirl = pn.widgets.Select(
            name="turning of the force", options=["", "forward", "backward"], value=force.get("whirl", ""), **WIDE
        )
        self._rotation = pn.widgets.Select(
            name="rotation of the shaft", value=self._base.get("rotation", "ccw"), **WIDE,
            options={"from x towards y": "ccw", "from y towards x": "cw"},
        )  # fmt: skip
        self._rate = _text("samples a second, Hz", self._base.get("sample_rate_hz"))
        self._name = _text("Write it into the folder as", page.session.folder.free_name("rig.toml"), width=220)
        self._said = pn.Column(**WIDE)
        write = button("Write and open", self._write, main=True)
        words = (
            "What is left empty is as the recording says. V per mm: positive where the signal rises as the shaft nears."
        )
        self.card = folded(
            "Correct which channel is what: rig.toml",
            markup(element("p", words, class_="faint")),
            side_by_side([self._rotation, self._rate, self._whirl, *self._force.values()], least=250),
            *[row.view for row in self._rows.values()],
            in_a_row(self._name, write),
            self._said,
            shown=not page.session.records,
        )

    def content(self) -> dict[str, Any]:
        """Keys and values of the setup."""
        found = {
            key: value for key, value in self._base.items() if key not in ("shaft", "perturbator", "probe", "force")
        }
        found["rotation"] = self._rotation.value
        if self._rate.value.strip():
            found["sample_rate_hz"] = _number("samples a second", self._rate.value)
        for row in self._rows.values():
            row.add_to(found)
        force = {key: field.value.strip() for key, field in self._force.items() if field.value.strip()}
        numbers = {key: _number(_FORCE[key], word) for key, word in force.items() if key != "plane"}
        whirl = {"whirl": self._whirl.value} if self._whirl.value else {}
        if force or whirl:
            found["force"] = {**self._base.get("force", {}), **force, **numbers, **whirl}
        return found

    def _write(self) -> None:
        import tomli_w

        name = self._name.value.strip()
        try:
            content = self.content()
            read_recording(self._path, setup_of(content, name))  # refuses what is wrong and what is missing
            self._page.session.folder.write_new(name, tomli_w.dumps(content))
        except (ValueError, OSError) as problem:
            self._said.objects = [message(sentence(problem), "error")]
            return
        self._page.opened_with(name)


class _ChannelRow:
    """Role of one channel."""

    def __init__(self, name: str, base: Mapping[str, Any]) -> None:
        self._name = name
        self._known: Mapping[str, Any] = next(
            (probe for probe in base.get("probe", ()) if probe.get("channel") == name), {}
        )
        mark = next((label for label, key in _MARKS.items() if base.get(key, {}).get("channel") == name), None)
        self._mark = {} if mark is None else base[_MARKS[mark]]
        role = mark or ("probe" if self._known else "not used")
        self._role = pn.widgets.Select(name=f"channel {name}", options=list(_ROLES), value=role, width=210)
        labels = {"plane": "plane", "angle_deg": "angle from x, °", "sensitivity_V_per_mm": "V per mm"}
        self._plane, self._angle, self._scale = (
            _text(label, self._known.get(key), width=110) for key, label in labels.items()
        )
        self.view = in_a_row(self._role, self._plane, self._angle, self._scale)

    def add_to(self, content: dict[str, Any]) -> None:
        """Add the channel to a setup."""
        if self._role.value in _MARKS:
            content[_MARKS[self._role.value]] = {**self._mark, "channel": self._name}
        elif self._role.value == "probe":
            probe = {**self._known, "channel": self._name, "plane": self._plane.value.strip()}
            for key, field in (("angle_deg", self._angle), ("sensitivity_V_per_mm", self._scale)):
                if field.value.strip():
                    probe[key] = _number(f"{field.name} of {self._name}", field.value)
            content.setdefault("probe", []).append(probe)


# ---- the model --------------------------------------------------------------------------------------------------


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
    known = page.session.content.get("known", {})
    for p in parameters:
        label = f"{p.name}{'' if p.unit == '1' else f', {p.unit}'}: {p.meaning}"
        usual = "fitted" if p.default is None else f"{p.default:g}; write free to fit it"
        look = {"placeholder": usual, "stylesheets": [LONG_LABEL]}
        fields[p.name] = _text(label, known.get(p.name), partial(_know, page, p.name), **look)
    words = "Values that are known; what is left empty is fitted, but for those whose usual value stands in grey."
    return pn.Column(markup(element("p", words, class_="faint")), side_by_side([*fields.values()], least=250), **WIDE)


def _know(page: Front, name: str, word: str) -> bool:
    known = {key: value for key, value in page.session.content.get("known", {}).items() if key != name}
    if word:
        try:
            known[name] = "free" if word == "free" else _number(name, word)
        except ValueError as problem:
            page.say(str(problem))
            return False
    page.say("")
    page.session = page.session.with_option("known", known)
    return True


def _options(page: Front) -> Any:
    content = page.session.content

    def put(name: str, value: Any) -> None:
        page.change_model(lambda: page.session.with_option(name, value))

    def put_word(name: str, word: str) -> None:  # as behind that option on the command line
        parse = FIT[name].kind.word
        try:
            value = parse(word) if word and parse is not None else None
        except (ValueError, ArgumentTypeError) as problem:
            page.say(f"{_WORDS[name]}: {problem}")
            return
        put(name, list(value) if isinstance(value, tuple) else value)

    fields: dict[str, Any] = {}
    for name, (label, choices) in _CHOICES.items():
        fields[name] = pn.widgets.Select(name=label, options=choices, value=content.get(name, ""), **WIDE)
    fields["refine"] = pn.widgets.Checkbox(name=FIT["refine"].help, value=bool(content.get("refine")), **WIDE)
    for name, field in fields.items():
        field.param.watch(lambda event, name=name: put(name, event.new), "value")
    refine = fields.pop("refine")
    for name, label in _WORDS.items():
        value = content.get(name)
        shown = ",".join(value) if isinstance(value, list) else value
        fields[name] = _text(label, shown, partial(put_word, name))
    return side_by_side([*fields.values(), refine], least=250)
