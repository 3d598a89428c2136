"""The form of ``rig.toml``: which channel is what, and the force; it writes a new file into the folder."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import panel as pn

from rotorfit.app.parts import WIDE, button, folded, in_a_row, markup, message, side_by_side
from rotorfit.recordings.formats.files import open_raw
from rotorfit.recordings.recording import read_recording
from rotorfit.recordings.rig.rig_toml import setup_of
from rotorfit.recordings.rig.template import template
from rotorfit.report.html import element
from rotorfit.studies.wording import sentence

if TYPE_CHECKING:
    from rotorfit.app.front import Front

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
        self._base = _known_setup(page, path)
        self._rows = {name: _ChannelRow(name, self._base) for name in open_raw(path).channels}
        force = self._base.get("force", {})
        self._force = {
            key: pn.widgets.TextInput(name=f"{label}", value=_word(force.get(key)), **WIDE)
            for key, label in _FORCE.items()
        }
        self._whirl = pn.widgets.Select(
            name="turning of the force", options=["", "forward", "backward"], value=force.get("whirl", ""), **WIDE
        )
        self._rotation = pn.widgets.Select(
            name="rotation of the shaft", value=self._base.get("rotation", "ccw"), **WIDE,
            options={"from x towards y": "ccw", "from y towards x": "cw"},
        )  # fmt: skip
        self._rate = pn.widgets.TextInput(
            name="samples a second, Hz", value=_word(self._base.get("sample_rate_hz")), **WIDE
        )
        free = page.session.folder.free_name("rig.toml")
        self._name = pn.widgets.TextInput(name="Write it into the folder as", value=free, width=220)
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
        self._plane = pn.widgets.TextInput(name="plane", value=_word(self._known.get("plane")), width=110)
        self._angle = pn.widgets.TextInput(name="angle from x, °", value=_word(self._known.get("angle_deg")), width=110)
        self._scale = pn.widgets.TextInput(
            name="V per mm", value=_word(self._known.get("sensitivity_V_per_mm")), width=110
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


def _known_setup(page: Front, path: Path) -> Mapping[str, Any]:
    """Keys of the setup that the recording was opened with, else those of a template for it."""
    given: Sequence[str] = [entry["setup"] for entry in page.session.content["files"] if "setup" in entry]
    text = page.session.folder.path(given[0]).read_text(encoding="utf-8") if given else template(path)
    return tomllib.loads(text)


def _word(value: Any) -> str:
    return "" if value is None else str(value)


def _number(label: str, word: str) -> float:
    try:
        return float(word)
    except ValueError:
        raise ValueError(f"{label}: {word!r} is not a number") from None
