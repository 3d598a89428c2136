"""Names of columns as people and spreadsheets write them, ``Disk X Amp (mil pp)``, under the names of this program.

Only what is left in no doubt is taken: a quantity or a probe that is named, in a unit that is named. Columns of probes
that are in doubt are refused, not kept as attributes: a reading would be missing without a word.

Columns of a probe, ``<plane>_<x|y>_<unit>`` (amplitude) with ``<plane>_<x|y>_lag_deg`` or ``_deg``, or
``<plane>_<x|y>_real_<unit>`` and ``_imag_<unit>``, become the rows of a tidy table; z (already combined), rx and ry as
well. Accelerometers have ``<plane>_<x|y>_acceleration_g``, sensors of velocity ``_velocity_mm_s``, and each probe may
have its ``_coherence``. All other columns are repeated for each probe. A row with ``force_x_N, force_x_phase_deg,
force_y_N, force_y_phase_deg`` is one reading under two forces that are measured at once (two shakers, a magnetic
bearing, cross-talk of the other shaker), which the tidy table has as two rows that differ in force and
``force_direction``.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from rotorfit.base.array_types import Float
from rotorfit.base.units import UNITS, si_factor, units_of
from rotorfit.lab.io.tables.cells import NOT_TAKEN, Numbers, lacking, taken
from rotorfit.lab.io.tables.stiffness_tables import is_ratio
from rotorfit.lab.io.tables.table import MOTION, PREFIXES, Table, floats, quantity

_CHANNEL = re.compile(r"(?P<plane>.+)_(?P<direction>rx|ry|x|y|z)_(?P<rest>.+)")
NOT_PLANES = ("force", "load", "sigma")
"""Beginnings of names that are no plane's."""


class _Column(NamedTuple):
    """A column of one probe."""

    name: str  # in the table
    tidy: str  # that it becomes
    factor: float  # to the unit of that


def is_wide(table: Table) -> bool:
    """True if the readings stand in a column a probe."""
    return not {"plane", "direction"} & set(table.cells) and bool(_channels(table))


def is_probe(name: str) -> bool:
    """True if a column is one of a probe."""
    return _parts(name) is not None


def tidy(table: Table) -> Table:
    """The same readings, one a row."""
    channels = _channels(table)
    for (plane, direction), columns in channels.items():
        kinds = sorted(column.tidy.split("_")[0] for column in columns if column.tidy != "coherence")
        if kinds not in (["amplitude", "phase"], ["imag", "real"]):
            have = ", ".join(table.spelled(column.name) for column in columns)
            raise ValueError(
                f"{table.source}: probe {plane} {direction} has {have}; it needs an amplitude and a phase "
                f"({plane}_{direction}_um and {plane}_{direction}_lag_deg or _deg), or _real_um and _imag_um"
            )
    rows, count = len(table.lines), len(channels)
    values: dict[str, Float] = {}
    for k, columns in enumerate(channels.values()):
        for column in columns:
            target = values.setdefault(column.tidy, np.full(rows * count, np.nan))
            target[k::count] = table.number((column.name, column.factor), blank=True)
    own = {column.name for columns in channels.values() for column in columns}
    places = {"plane": [plane for plane, _ in channels] * rows, "direction": [at for _, at in channels] * rows}
    repeated = table.rows(np.repeat(np.arange(rows), count), without=own).with_columns(places)
    return repeated.with_columns({name: Numbers(found) for name, found in values.items()})


def _channels(table: Table) -> dict[tuple[str, str], list[_Column]]:
    """Columns by plane and direction of the probe."""

    def plain(plane: str) -> str:  # in one spelling, whatever its case and what parts its words
        return re.sub(r"[\W_]+", "_", plane.lower())

    found: dict[tuple[str, str], list[_Column]] = {}
    # The plane as the column of forced planes spells it, or else its first column.
    spelled = {plain(cell): cell for cell in dict.fromkeys(table.cells.get("force_plane", ()))}
    for name in table.cells:
        if (parts := _parts(name)) is not None:
            size, direction, column = parts
            plane = table.names[name][:size]
            found.setdefault((spelled.setdefault(plain(plane), plane), direction), []).append(column)
    return {key: columns for key, columns in found.items() if any(not c.tidy.startswith("phase") for c in columns)}


def _parts(name: str) -> tuple[int, str, _Column] | None:
    """Length of the plane's name, direction and meaning of the column of a probe; ``None`` for any other."""
    match = _CHANNEL.fullmatch(name)
    if match is None or match["plane"].split("_")[0] in NOT_PLANES:
        return None
    meaning = _meaning(match["rest"], tilt=match["direction"].startswith("r"))
    return None if meaning is None else (len(match["plane"]), match["direction"], _Column(name, *meaning))


def _meaning(rest: str, *, tilt: bool) -> tuple[str, float] | None:
    """Tidy column, and factor to its unit, that the end of the name of a probe's column means."""
    units = MOTION if tilt else units_of("displacement")  # degrees beside a length are those of its phase
    for part in ("real", "imag", "amplitude"):
        unit = rest.removeprefix(f"{part}_")
        if unit in units and (unit != rest or part == "amplitude"):
            return f"{part}_{'urad' if tilt else 'um'}", units[unit] * 1e6
    if rest == "coherence":
        return rest, 1.0
    for kind, usual in () if tilt else (("velocity", "m_s"), ("acceleration", "m_s2")):  # in SI units
        for prefix, part in ((kind, "amplitude"), ("real", "real"), ("imag", "imag")):
            unit = rest.removeprefix(f"{prefix}_")
            if unit != rest and unit in UNITS[kind]:
                return f"{part}_{usual}", UNITS[kind][unit]
    unit = rest.removeprefix("phase_")
    return ("phase_deg", UNITS["phase"][unit] / si_factor("phase", "deg")) if unit in UNITS["phase"] else None


# ---- forces along x and along y ---------------------------------------------------------------------------------


def with_force_rows(table: Table) -> Table:
    """The table with a row for each force in place of columns for each axis; as it is without such columns."""
    given = {axis: found for axis in "xy" if (found := _force_columns(table, axis)) is not None}
    if not given:
        return table
    own = {name for force, phase in given.values() for name, _ in (force, phase)}
    usual = ("force", UNITS["force"]), ("mr", UNITS["unbalance"]), ("force_phase", UNITS["phase"])
    beside = [name for prefix, units in (*usual, ("force_angle", UNITS["angle"])) for name in table.find(prefix, units)]
    beside += [name for name in ("force_direction",) if name in table.cells]
    if beside:
        both = " and ".join(table.spelled(name) for name in (beside[0], sorted(own)[0]))
        raise ValueError(
            f"{table.source}: {both} are both given. Forces along x and y are in columns of their own; leave "
            f"{', '.join(table.spelled(name) for name in beside)} out"
        )
    axes = list(given)
    size, phase = (np.stack([table.number(found[k]) for found in given.values()], axis=1) for k in (0, 1))
    # first that of the shaker that drives the run, then its cross-talk
    runs = table.cells.get("run", [""] * len(table.lines))
    unit = np.nanmax(np.abs(size), initial=0.0) or 1.0  # squares of what is refused later would overflow
    power: dict[str, Float] = {}
    for run, row in zip(runs, size, strict=True):
        power[run] = power.get(run, 0.0) + (row / unit) ** 2
    order = {run: np.argsort(-own, kind="stable") for run, own in power.items()}
    place = np.array([order[run] for run in runs])
    new = {
        "force_direction": [axes[k] for k in place.ravel().tolist()],
        "force_N": Numbers(np.take_along_axis(size, place, axis=1).ravel()),
        "force_phase_deg": Numbers(np.take_along_axis(phase, place, axis=1).ravel() / si_factor("phase", "deg")),
    }
    rows = table.rows(np.repeat(np.arange(len(size)), len(axes)), without=own).with_columns(new)
    return replace(
        rows, written={**table.written, **dict.fromkeys(("force_n", "force_direction"), "force_x_N, force_y_N")}
    )


def _force_columns(table: Table, axis: str) -> tuple[tuple[str, float], tuple[str, float]] | None:
    """Columns of the force along an axis and of its phase, with their factors to SI."""
    wanted = quantity(f"force_{axis}", UNITS["force"]), quantity(f"force_{axis}_phase", UNITS["phase"])
    size, phase = ([*one.columns(table).items()] for one in wanted)
    if bool(size) != bool(phase):
        lacking = f"force_{axis}_phase_deg" if size else f"force_{axis}_N"
        raise ValueError(f"{table.source}: missing columns: {lacking}. A force along {axis} has a size and a phase")
    return (size[0], phase[0]) if size else None


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
_BESIDE = ("direct", "overall", "gap", "bias")
"""Words for what monitors give beside the 1x vector of a probe: attributes of the test."""
_ORDERS = ("frequency_order", "order_x", "frequency_orders", "frequency_x", "frequency_ratio", "order", "orders")
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


def with_orders(table: Table) -> Table:
    """The table with frequencies in place of orders of the speed, negative for backward ones."""
    named = {
        "_".join([*words, *unit]).lower(): key for key in table.cells for words, unit in [_apart(table.names[key])]
    }
    orders = [named[name] for name in _ORDERS if name in named]
    speeds = table.find("speed", UNITS["frequency"])
    if not orders or len(speeds) != 1:
        return table
    if frequencies := table.find("frequency", UNITS["frequency"]):
        return _with_order_beside(table, orders[0], speeds, frequencies)
    if len(orders) > 1:
        both = " and ".join(map(table.spelled, orders))
        raise ValueError(f"{table.source}: frequencies are given twice, as {both}; keep one of them")
    speed = next(iter(speeds))
    values = table.number((orders[0], 1.0)) * np.abs(table.number((speed, 1.0)))
    if still := np.flatnonzero((table.number((speed, 1.0)) == 0) & (table.number((orders[0], 1.0)) != 0)).tolist():
        raise ValueError(
            f"{table.source}: line {table.lines[still[0]]}: an order of a rotor at rest is no frequency; give a column "
            "frequency_hz"
        )
    kept = table.rows(np.arange(len(table.lines)), without={orders[0]})
    unit = table.names[speed][len("speed_") :]
    return kept.with_columns({f"frequency_{unit}": Numbers(values)})


def _with_order_beside(
    table: Table, order: str, speeds: Mapping[str, float], frequencies: Mapping[str, float]
) -> Table:
    """The table with frequencies and a column called order, and a note where that is something else."""
    said = floats(table.cells[order])
    if said is None:
        return table
    speed, frequency = (np.abs(table.number(next(iter(found.items())), blank=True)) for found in (speeds, frequencies))
    rounded = 0.05  # two digits of an order
    odd = np.flatnonzero(np.abs(np.abs(said) * speed - frequency) > rounded * speed)
    if not odd.size:
        return table
    where = f"line {table.lines[odd[0]]}: {table.cells[order][odd[0]]}"
    words = (
        f"{table.source}: {table.spelled(order)!r} is not the frequency over the speed ({where}): frequencies are as "
        "given, and it is kept as an attribute"
    )
    return table.noted("order", words)


def with_given_names(table: Table, columns: Mapping[str, str]) -> Table:
    """The table with columns under the names that are given for them, in messages too."""
    spelled = {name.lower(): name for name in table.names.values()} | {name: name for name in table.names.values()}
    by_key = {spelling: key for key, spelling in table.names.items()}
    new = {}
    for given, name in columns.items():
        if given not in by_key and given.lower() not in spelled:
            turned = f", in this order: {name}={given}" if name.lower() in spelled else ""
            raise ValueError(
                f"{table.source} has no column {given!r} to call {name!r} (THEIRS=OURS{turned}); it has "
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
    spelled = "_".join(words_of(text.strip("()[]{} "))).lower()
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
    said = "_".join(_apart(first.lower())[1])
    name = f"journal_x_{said if said in MOTION else 'UNIT' if said else 'um_pp'}"
    verb = "looks like a reading" if len(doubtful) == 1 else "look like readings"
    raise ValueError(
        f"{table.source}: {listed} {verb}, but not of which plane, direction (x, y, z, rx, ry) and unit; say that by "
        f"columns, {{{first!r}: {name!r}}} (a phase: 'journal_x_lag_deg' or '_deg'), on the command line "
        f'--column "{first}={name}"; a condition of the test gets another name in the same way'
    )


def words_of(text: str) -> list[str]:
    """Words of a text as this program writes them; the case of all others stays."""
    for sign, meaning in _SIGNS:
        text = re.sub(re.escape(sign), meaning, text, flags=re.IGNORECASE)
    text = re.sub(r"(peak|pk)[ -]to[ -](peak|pk)|pk pk", "pp", text, flags=re.IGNORECASE)
    words = [part for word in re.findall(r"[A-Za-z0-9]+", text) for part in _GLUED.sub(r"\1 \2", word).split()]
    return [_SAME.get(word.lower(), word) for word in words]


def _apart(spelled: str) -> tuple[list[str], list[str]]:
    """Words of a name, and of the unit that stands in brackets."""
    found = _BRACKETS.findall(spelled)
    return words_of(_BRACKETS.sub(" ", spelled)), [word for text in found for word in words_of(text)]


def quantity_meant(spelled: str) -> str:
    """Name of a quantity or a column of text that a name in words means; empty where it is none."""
    if not spelled[:1].isalnum():
        return ""
    words, unit = _apart(spelled)
    if words[:1] == ["1X"] or words[:1] == ["1x"]:  # the order of the vibration that a weight makes
        words = words[1:]
    base = [word.lower() for word in words]
    if not unit and "_".join(base) in _TEXT:
        return "_".join(base)
    lags = [word for word in unit if word.lower() == "lag"]  # which stands before the unit
    name = "_".join([*(words if not unit else base), *lags, *(word for word in unit if word.lower() != "lag")])
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
    if any(word in _BESIDE for word in words) or is_ratio(table.spelled(name)):
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
