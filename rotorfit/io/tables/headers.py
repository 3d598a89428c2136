"""Names of columns as people and spreadsheets write them, ``Disk X Amp (mil pp)``, under the names of this program.

Only what is left in no doubt is taken: a quantity or a probe that is named, in a unit that is named. Columns of probes
that are in doubt are refused, not kept as attributes: a reading would be missing without a word.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from rotorfit.io.tables.cells import NOT_TAKEN, lacking, taken
from rotorfit.io.tables.table import MOTION, Table, floats
from rotorfit.io.tables.wanted_columns import PREFIXES
from rotorfit.io.tables.wide import NOT_PLANES, is_probe, is_wide
from rotorfit.units import UNITS

_BRACKETS = re.compile(r"[(\[{]([^()\[\]{}]*)[)\]}]")
_GLUED = re.compile(r"(um|mm|nm|mil|mils|in)(pp|pk|rms)", re.IGNORECASE)
_SIGNS = (
    ("µ", "u"), ("μ", "u"), ("²", "2"), ("s^2", "s2"), ("°", " deg "), ("pk-pk", "pp"), ("p-p", "pp"), ("0-pk", "pk"),
    ("0-p", "pk"),
)  # fmt: skip
_SAME: Mapping[str, str] = {
    **dict.fromkeys(("micron", "microns"), "um"),
    **dict.fromkeys(("degree", "degrees"), "deg"),
    **dict.fromkeys(("amp", "ampl", "mag", "magnitude"), "amplitude"),
    "mils": "mil",
    "pkpk": "pp",
    "peak": "pk",
    "freq": "frequency",
    **dict.fromkeys(("acc", "accel"), "acceleration"),
    **dict.fromkeys(("vel",), "velocity"),
    "coh": "coherence",
    "unbalance": "mr",
    "imbalance": "mr",
    "re": "real",
    "im": "imag",
    "imaginary": "imag",
    **dict.fromkeys(("ph", "phs"), "phase"),
}
"""Words as this program writes them, by how others do, in lower case."""
_PARTS = ("amplitude", "phase", "real", "imag")
_DROPPED = ("1x", "lead")  # the order of the vibration that forces make; a phase leads unless it says lag
_OTHER_ORDER = re.compile(r"(\d+|n)x|0?\.?5x")  # 1x is dropped before
_TEXT = ("run", "plane", "direction", "force_plane", "force_direction", "load_plane", "line", "coherence")
_DIRECTIONS = ("x", "y", "z", "rx", "ry")
_OTHER_DIRECTIONS = ("h", "v", "horizontal", "vertical", "left", "right")
_NO_MOTION = ("v", "mv", "volt", "volts", "vdc", "mm_s", "in_s", "g", "n", "c", "f", "bar", "kpa", "psi")
"""Units of what stands in columns that are named after a probe, but is no reading of its vibration."""


def understood(table: Table) -> Table:
    """The table with columns under the names of this program where their own leave no doubt."""
    known = {key: quantity_meant(spelled) for key, spelled in table.names.items()}
    tidy = {"plane", "direction"} & {*table.names, *known.values()}
    new: dict[str, str] = {}
    for key, spelled in table.names.items():
        name = known[key] or ("" if tidy or is_probe(key) else _probe(spelled))
        if name and name.lower() not in (*table.names, *(taken.lower() for taken in new.values())):
            new[key] = name
    return table.renamed(new) if new else table


def with_given_names(table: Table, columns: Mapping[str, str]) -> Table:
    """The table with columns under the names that are given for them, in messages too."""
    spelled = {name.lower(): name for name in table.names.values()} | {name: name for name in table.names.values()}
    by_key = {spelling: key for key, spelling in table.names.items()}
    new = {}
    for first, second in columns.items():
        # Either way round: what the file has is its own name.
        turned = first.lower() not in spelled and second.lower() in spelled
        given, name = (second, first) if turned else (first, second)
        if given not in by_key and given.lower() not in spelled:
            raise ValueError(
                f"{table.source} has no column {given!r} to call {name!r} (THEIRS=OURS); it has "
                f"{', '.join(table.names.values())}"
            )
        new[by_key[spelled.get(given, spelled.get(given.lower(), given))]] = name
    found = table.renamed(new)
    if len(found.cells) < len(table.cells):
        raise ValueError(f"{table.source}: two columns would have the same name after renaming: {', '.join(columns)}")
    return replace(found, written={})


def is_text(spelled: str, columns: Mapping[str, str]) -> bool:
    """True if a column is text by its name, or by that which ``columns`` gives it: ``run`` may be called 007."""
    names = [spelled, *(other for pair in columns.items() for other in pair if spelled in pair)]
    return any(name.lower() in _TEXT or quantity_meant(name) in _TEXT for name in names)


def is_unit(text: str) -> bool:
    """True if a cell names a unit, as in a line of units below a header."""
    spelled = "_".join(_words(text.strip("()[]{} "))).lower()
    return any(spelled == unit.lower() for units in UNITS.values() for unit in units)


def refuse_doubtful(table: Table) -> None:
    """Refuse a table with a column a probe where some look like readings, but are not understood."""
    told_in_rows = {"plane", "direction"} & set(table.cells)
    if told_in_rows or not (is_wide(table) or table.find("frequency", PREFIXES["frequency"])):
        return
    if not (doubtful := [name for name in table.cells if _is_doubtful(table, name)]):
        return
    listed = ", ".join(repr(table.spelled(name)) for name in doubtful)
    first = table.spelled(doubtful[0])
    verb = "looks like a reading" if len(doubtful) == 1 else "look like readings"
    raise ValueError(
        f"{table.source}: {listed} {verb}, but not of which plane, direction (x, y, z, rx, ry) and unit; say that by "
        f"columns, {{{first!r}: 'journal_x_um_pp'}} (a phase: 'journal_x_lag_deg' or '_deg'), on the command line "
        f'--column "{first}=journal_x_um_pp"; a condition of the test gets another name in the same way'
    )


def _words(text: str) -> list[str]:
    """Words of a text as this program writes them; the case of all others stays."""
    for sign, meaning in _SIGNS:
        text = re.sub(re.escape(sign), meaning, text, flags=re.IGNORECASE)
    text = re.sub(r"(peak|pk)[ -]to[ -](peak|pk)|pk pk", "pp", text, flags=re.IGNORECASE)
    words = [part for word in re.findall(r"[A-Za-z0-9]+", text) for part in _GLUED.sub(r"\1 \2", word).split()]
    return [_SAME.get(word.lower(), word) for word in words]


def _apart(spelled: str) -> tuple[list[str], list[str]]:
    """Words of a name, and of the unit that stands in brackets."""
    found = _BRACKETS.findall(spelled)
    return _words(_BRACKETS.sub(" ", spelled)), [word for text in found for word in _words(text)]


def quantity_meant(spelled: str) -> str:
    """Name of a quantity or a column of text that a name in words means; empty where it is none."""
    if not spelled[:1].isalnum():
        return ""
    words, unit = _apart(spelled)
    base = [word.lower() for word in words]
    if not unit and "_".join(base) in _TEXT:
        return "_".join(base)
    name = "_".join([*(words if not unit else base), *unit])
    for prefix, units in PREFIXES.items():
        rest = name[len(prefix) + 1 :]
        if name.lower().startswith(f"{prefix}_") and rest.lower() in {unit.lower() for unit in units}:
            return f"{prefix}_{rest}"
    return ""


def _probe(spelled: str) -> str:
    """Name of the column of a probe that a name in words means, ``disk_x_phase_lag_deg``; empty where it is none."""
    words, unit = _apart(spelled.lower())
    words = [word for word in words if word not in _DROPPED]
    parts = [word for word in words if word in _PARTS]
    base = [word for word in words if word not in (*_PARTS, "lag")]
    places = [i for i, word in enumerate(base) if word in _DIRECTIONS]
    if len(places) != 1 or len(parts) > 1 or any(_OTHER_ORDER.fullmatch(word) for word in base):
        return ""
    plane, rest = base[: places[0]], base[places[0] + 1 :]
    if unit:  # what else stands in the name is the plane's, before the direction or behind it
        if plane and rest:
            return ""
        plane, rest = plane or rest, unit
    lag = ["lag"] if "lag" in (*words, *unit) else []
    name = "_".join([*plane, base[places[0]], *parts, *lag, *(word for word in rest if word != "lag")])
    return name if plane and is_probe(name) else ""


def _is_doubtful(table: Table, name: str) -> bool:
    """True if a column that is no probe's holds numbers under the name of a reading."""
    words, unit = _apart(table.spelled(name).lower())
    if is_probe(name) or quantity_meant(name) or words[:1] == [] or words[0] in NOT_PLANES:
        return False
    given = np.flatnonzero(~lacking(table.cells[name], NOT_TAKEN))
    if not given.size or floats(taken(table.cells[name], given)) is None:
        return False
    said = "_".join(unit)
    part = any(word in (*_PARTS, "lag") for word in words)
    places = [i for i, word in enumerate(words) if word in _DIRECTIONS]
    if places and (places[0] or part):
        return (said or "_".join(words[places[-1] + 1 :])) not in _NO_MOTION
    motion = said in (*MOTION, *UNITS["phase"])
    return part + motion + ("1x" in words) + any(word in _OTHER_DIRECTIONS for word in words) > 1
