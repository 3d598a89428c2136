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


def text_field(name: str, value: Any, left: Callable[[str], object] | None = None, **look: Any) -> Any:
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


def number_in(field: Any) -> float:
    """The number that stands in a field."""
    return _number(field.name, shown_in(field))


# ---- how a test file is read ------------------------------------------------------------------------------------


def _pairs(word: str, value: Callable[[str], Any] = str) -> Any:
    return pairs("this field", [word], value)


_FIELDS: Mapping[str, tuple[str, str, Callable[[str], Any]]] = {
    "columns": ("names of columns, theirs=ours", "Ampl. 1X=amplitude_um", _pairs),
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
        fields.append(text_field(label, value, partial(left, key), placeholder=example, stylesheets=[LONG_LABEL]))
    title = f"Correct how {table['path']} is read"
    unread, parts_shown = page.session.data is None, [side_by_side(fields, least=300)]
    if unread and Path(table["path"]).suffix.lower() in FORMATS:
        words = "It holds raw signals: say which channel is what"
        parts_shown.append(button(words, lambda: page.change(page.session.as_recordings)))
    return folded(title, *parts_shown, shown=unread)


# ---- which channel of a recording is what -----------------------------------------------------------------------


_MARKS = {"mark of the shaft": "shaft", "mark of the perturbator": "perturbator"}
_AXES = {"force along x": "channel_x", "force along y": "channel_y"}
_ROLES = ("not used", *_MARKS, "probe", *_AXES)
_PROBE_UNITS = {
    **{
        unit.replace("_per_", "/"): f"sensitivity_{unit}"
        for unit in ("V_per_mm", "mV_per_um", "V_per_mil", "mV_per_mil")
    },
    "mV/g": "sensitivity_mV_per_g",
    "mV/(mm/s)": "sensitivity_mV_per_mm_s",
    "mV/(in/s)": "sensitivity_mV_per_in_s",
}
"""Keys of a sensor's sensitivity by its unit."""
_FORCE_UNITS = {"mV/N": "sensitivity_mV_per_N", "V/N": "sensitivity_V_per_N", "mV/lbf": "sensitivity_mV_per_lbf"}
_UNBALANCES = {"g mm": "mr_g_mm", "g in": "mr_g_in", "oz in": "mr_oz_in", "kg m": "mr_kg_m"}


class _Measure:
    """A number with a choice of its unit, which is a key of the setup."""

    def __init__(self, label: str, table: Mapping[str, Any], units: Mapping[str, str], width: int = 110) -> None:
        self._label, self._units = label, units
        known = next((key for key in units.values() if key in table), next(iter(units.values())))
        self.field = text_field(label, table.get(known), width=width)
        self.unit = pn.widgets.Select(name="in", options=dict(units), value=known, width=95)
        self.parts = [self.field, self.unit]

    def add_to(self, table: dict[str, Any]) -> None:
        """Put it into a table of the setup, in place of what it says in another unit."""
        for key in self._units.values():
            table.pop(key, None)
        if word := self.field.value.strip():
            table[self.unit.value] = _number(self._label, word)


class _ForceForm:
    """What drives the rotor: in all recordings, or in one of them."""

    def __init__(self, table: Mapping[str, Any], title: str = "") -> None:
        self._table = table
        self._plane = text_field("plane of the force", table.get("plane"), width=130)
        self._unbalance = _Measure("unbalance", table, _UNBALANCES)
        self._angle = text_field("heavy spot ahead of the mark, °", table.get("angle_deg"), width=200)
        turning = {"": "", "with the shaft": "forward", "against it": "backward"}
        self._whirl = pn.widgets.Select(name="it turns", options=turning, value=table.get("whirl", ""), width=130)
        head = [markup(element("p", title), sizing_mode=None, width=200)] if title else []
        self.view = in_a_row(*head, self._plane, *self._unbalance.parts, self._angle, self._whirl)

    def content(self) -> dict[str, Any]:
        """The table of the setup."""
        found = {key: value for key, value in self._table.items() if key not in ("plane", "angle_deg", "whirl")}
        self._unbalance.add_to(found)
        for key, field in (("plane", self._plane), ("whirl", self._whirl)):
            if field.value.strip():
                found[key] = field.value.strip()
        if self._angle.value.strip():
            found["angle_deg"] = _number(self._angle.name, self._angle.value)
        return found


class SetupForm:
    """Fields for the channels of a recording, filled in from its setup, else from what the recording says."""

    def __init__(self, page: Front, paths: Sequence[Path]) -> None:
        self._page, self._paths, path = page, paths, paths[0]
        given: Sequence[str] = [entry["setup"] for entry in page.session.content["files"] if "setup" in entry]
        text = page.session.folder.path(given[0]).read_text(encoding="utf-8") if given else template(path)
        self._base: Mapping[str, Any] = tomllib.loads(text)
        channels = open_raw(path).channels
        self._rows = {name: _ChannelRow(name, self._base) for name in channels}
        self._force = _ForceForm(self._base.get("force", {}))
        self._runs = {run["file"]: run for run in self._base.get("run", ())}
        several = paths if len(paths) > 1 else ()
        own = {one.name: self._runs.get(one.name, self._runs.get(one.stem, {})).get("force", {}) for one in several}
        self._forces = {name: _ForceForm(table, name) for name, table in own.items()}
        self._counting = [
            name for name, one in channels.items() if one.full_count is not None and one.volts_per_count is None
        ]
        scales = {one["name"]: one.get("full_scale_V") for one in self._base.get("channel", ()) if "name" in one}
        full = next((scales[name] for name in self._counting if scales.get(name)), None)
        self._full = text_field("V of the largest count (full scale)", full, visible=bool(self._counting))
        self._rotation = pn.widgets.Select(
            name="rotation of the shaft", value=self._base.get("rotation", "ccw"), **WIDE,
            options={"from x towards y": "ccw", "from y towards x": "cw"},
        )  # fmt: skip
        self._rate = text_field("samples a second, Hz", self._base.get("sample_rate_hz"))
        self._name = text_field("Write it into the folder as", page.session.folder.free_name("rig.toml"), width=220)
        self._said = pn.Column(**WIDE)
        write = button("Write and open", self._write, main=True)
        words = (
            "What is left empty is as the recording says. Sensitivities are positive where the signal rises when the "
            "shaft nears."
        )
        apart = [markup(element("p", "The force of one recording, where it is another:"))] if self._forces else []
        self.card = folded(
            "Correct which channel is what: rig.toml",
            markup(element("p", words, class_="faint")),
            side_by_side([self._rotation, self._rate, *([self._full] if self._counting else [])], least=250),
            *[row.view for row in self._rows.values()],
            markup(element("p", "What drives the rotor, unless its force is measured:")),
            self._force.view,
            *apart,
            *[one.view for one in self._forces.values()],
            in_a_row(self._name, write),
            self._said,
            shown=not page.session.records,
        )

    def content(self) -> dict[str, Any]:
        """Keys and values of the setup."""
        told = ("shaft", "perturbator", "probe", "force", "channel", "run")
        found = {key: value for key, value in self._base.items() if key not in told}
        found["rotation"] = self._rotation.value
        if self._rate.value.strip():
            found["sample_rate_hz"] = _number("samples a second", self._rate.value)
        found["force"] = self._force.content()
        for row in self._rows.values():
            row.add_to(found)
        if not found["force"]:
            del found["force"]
        if scales := self._scales():
            found["channel"] = scales
        if runs := self._own_runs():
            found["run"] = runs
        return found

    def _scales(self) -> list[dict[str, Any]]:
        others = [one for one in self._base.get("channel", ()) if one.get("name") not in self._counting]
        word = self._full.value.strip()
        full = _number(self._full.name, word) if word else None
        return [*others, *({"name": name, "full_scale_V": full} for name in self._counting if full is not None)]

    def _own_runs(self) -> list[dict[str, Any]]:
        runs = {name: {key: value for key, value in run.items() if key != "force"} for name, run in self._runs.items()}
        for name, form in self._forces.items():
            key = name if name in runs or Path(name).stem not in runs else Path(name).stem
            if own := form.content():
                runs[key] = {**runs.get(key, {"file": name}), "force": own}
        return [run for run in runs.values() if len(run) > 1]

    def _write(self) -> None:
        import tomli_w

        name = self._name.value.strip()
        try:
            content = self.content()
            for path in self._paths:
                read_recording(path, setup_of(content, name))  # refuses what is wrong and what is missing
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
        force = base.get("force", {})
        mark = next((label for label, key in _MARKS.items() if base.get(key, {}).get("channel") == name), None)
        axis = next((label for label, key in _AXES.items() if force.get(key) == name), None)
        self._mark = {} if mark is None else base[_MARKS[mark]]
        role = mark or axis or ("probe" if self._known else "not used")
        self._role = pn.widgets.Select(name=f"channel {name}", options=list(_ROLES), value=role, width=210)
        self._plane = text_field("plane", self._known.get("plane"), width=110)
        angle = self._mark.get("angle_deg") if mark else self._known.get("angle_deg")
        self._angle = text_field("angle from x, °", angle, width=110)
        self._probe = _Measure("sensitivity", self._known, _PROBE_UNITS)
        self._cell = _Measure("sensitivity", force if axis else {}, _FORCE_UNITS)
        self._parts = {
            "probe": [self._plane, self._angle, *self._probe.parts],
            **{mark: [self._angle] for mark in _MARKS},
            **dict.fromkeys(_AXES, self._cell.parts),
        }
        self._fields = in_a_row(*self._parts.get(role, ()))
        self._role.param.watch(self._show, "value")
        self.view = in_a_row(self._role, self._fields)

    def _show(self, event: Any) -> None:
        self._fields.objects = list(self._parts.get(event.new, ()))

    def add_to(self, content: dict[str, Any]) -> None:
        """Add the channel to a setup."""
        role, angle = self._role.value, self._angle.value.strip()
        label = f"{self._angle.name} of {self._name}"
        if role in _MARKS:
            at = {"angle_deg": _number(label, angle)} if angle else {}
            content[_MARKS[role]] = {**self._mark, "channel": self._name, **at}
        elif role in _AXES:
            content["force"][_AXES[role]] = self._name
            if self._cell.field.value.strip():
                self._cell.add_to(content["force"])
        elif role == "probe":
            probe = {**self._known, "channel": self._name, "plane": self._plane.value.strip()}
            if angle:
                probe["angle_deg"] = _number(label, angle)
            self._probe.add_to(probe)
            content.setdefault("probe", []).append(probe)


# ---- the model --------------------------------------------------------------------------------------------------


_CHOICES = {
    "law": ("law of eccentricity", ["", *LAWS]),
    "loss": ("loss", ["", *LOSSES]),
    "phase_offsets": ("zero of the phases", {"known": "", "one for every run but the first": True, "common": "common"}),
}
"""Options with a few values: label and choices."""
_WORDS = {
    "planes": "planes, in the model's order: A,B",
    "clearance_um": "clearance, µm",
    "modes": "modes (modal)",
    "per": "values by condition: Kxx=speed_rpm+P_bar,...",
    "stator_mass_kg": "mass of a floating stator, kg",
}
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

    usual = not set(content) & {*_CHOICES, *_WORDS, "refine", "baseline"}
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
        value = known.get(p.name)
        shown = "+-".join(f"{one:.10g}" for one in value) if isinstance(value, list) else value
        fields[p.name] = text_field(label, shown, partial(_know, page, p.name), **look)
    words = "Values that are known; what is left empty is fitted, but for those whose usual value stands in grey."
    return pn.Column(markup(element("p", words, class_="faint")), side_by_side([*fields.values()], least=250), **WIDE)


def _know(page: Front, name: str, word: str) -> bool:
    known = {key: value for key, value in page.session.content.get("known", {}).items() if key != name}
    if word:
        try:
            value = pairs(name, [f"{name}={word}"], FIT["known"].kind.word or str)[name]
        except (ValueError, ArgumentTypeError):
            page.say(f"{name}: {word!r} is not a number, nor one with its error, 6000+-30")
            return False
        known[name] = "free" if value is None else list(value) if isinstance(value, tuple) else value
    page.say("")
    page.session = page.session.with_option("known", known)
    return True


def _options(page: Front) -> Any:
    content = page.session.content

    def put(name: str, value: Any) -> None:
        page.change_model(lambda: page.session.with_option(name, value))

    def put_word(name: str, word: str) -> None:  # as behind that option on the command line
        kind = FIT[name].kind
        try:
            own = kind.word or str
            value = None if not word else pairs(name, [word], own) if kind.paired else own(word)
        except (ValueError, ArgumentTypeError) as problem:
            page.say(f"{_WORDS[name]}: {problem}")
            return
        put(name, list(value) if isinstance(value, tuple) else value)

    fields: dict[str, Any] = {}
    for name, (label, choices) in _CHOICES.items():
        fields[name] = pn.widgets.Select(name=label, options=choices, value=content.get(name, ""), **WIDE)
    dry = ["", *page.session.folder.data_files()]
    fields["baseline"] = pn.widgets.Select(
        name="dry run of a seal or bearing rig, taken out", options=dry, value=content.get("baseline", ""), **WIDE
    )
    fields["refine"] = pn.widgets.Checkbox(name=FIT["refine"].help, value=bool(content.get("refine")), **WIDE)
    for name, field in fields.items():
        field.param.watch(lambda event, name=name: put(name, event.new), "value")
    refine = fields.pop("refine")
    for name, label in _WORDS.items():
        value = content.get(name)
        written = [f"{key}={own}" for key, own in value.items()] if isinstance(value, dict) else value
        shown = ",".join(written) if isinstance(written, list) else written
        fields[name] = text_field(label, shown, partial(put_word, name))
    return side_by_side([*fields.values(), refine], least=250)
