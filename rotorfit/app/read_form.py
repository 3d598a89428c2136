"""The form that corrects how a test file is read; what is entered goes into the study's TOML."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import panel as pn

from rotorfit.app.parts import LONG_LABEL, WIDE, button, folded, side_by_side
from rotorfit.app.session import entry_table, with_read_option
from rotorfit.options.kinds import number_word, pairs, two_numbers
from rotorfit.recordings.formats.files import FORMATS

if TYPE_CHECKING:
    from rotorfit.app.front import Front


@dataclass(frozen=True, kw_only=True)
class _Field:
    """An option of reading as a field."""

    label: str
    example: str  # what could stand there
    parse: Callable[[str], Any]  # from what is written to the value in the TOML file
    shown: Callable[[Any], str]  # and back


def _paired(value: Callable[[str], Any]) -> Callable[[str], Any]:
    return lambda word: pairs("this field", [word], value)


def _as_pairs(values: dict[str, Any]) -> str:
    return ", ".join(f"{name}={':'.join(map(str, v)) if isinstance(v, list) else v}" for name, v in values.items())


_FIELDS = {
    "columns": _Field(
        label="columns under the names that rotorfit knows",
        example="amplitude_um=Ampl. 1X",
        parse=_paired(str),
        shown=_as_pairs,
    ),
    "constants": _Field(
        label="columns that the table does not have",
        example="force_plane=disk, mr_g_mm=30",
        parse=_paired(str),
        shown=_as_pairs,
    ),
    "probe_angles_deg": _Field(
        label="where the probes x and y sit, degrees from X towards Y",
        example="journal=45:135",
        parse=_paired(lambda word: list(two_numbers(word))),
        shown=_as_pairs,
    ),
    "slow_roll_below_rpm": _Field(
        label="run-out from readings below, rpm", example="300", parse=number_word, shown=str
    ),
    "drop_near_1x": _Field(label="leave out within this share of 1x", example="0.02", parse=number_word, shown=str),
    "speed_rpm": _Field(label="speed of a universal file, rpm", example="1500", parse=number_word, shown=str),
    "axes": _Field(label="directions of a universal file that are x and y", example="yz", parse=str, shown=str),
    "sheet": _Field(label="sheet of an Excel file", example="the first", parse=str, shown=str),
}
"""Options of reading by their key in the TOML file."""


def read_form(page: Front, entry: int) -> Any:
    """Fields of one test file, which is read again when one is left; or it is a recording, if it cannot be read."""
    table = entry_table(page.session.content["files"][entry])
    fields = [_field(page, entry, key, table.get(key)) for key in _FIELDS]
    title = f"Correct how {table['path']} is read"
    unread, parts = page.session.data is None, [side_by_side(fields, least=300)]
    if unread and Path(table["path"]).suffix.lower() in FORMATS:
        words = "It holds raw signals: say which channel is what"
        parts.append(button(words, lambda: page.change(page.session.as_recordings)))
    return folded(title, *parts, shown=unread)


def _field(page: Front, entry: int, key: str, value: Any) -> Any:
    known = _FIELDS[key]
    shown = "" if value is None else known.shown(value)
    field = pn.widgets.TextInput(
        name=known.label, value=shown, placeholder=known.example, stylesheets=[LONG_LABEL], **WIDE
    )

    def left(event: Any) -> None:
        word = event.new.strip()
        try:
            entered = known.parse(word) if word else None
        except ValueError as problem:
            page.say(f"{known.label}: {problem}")
            return
        page.change(lambda: with_read_option(page.session, entry, key, entered))

    field.param.watch(left, "value")
    return field
