"""Text tables that condition-monitoring systems export, as the table of columns that a tidy CSV is read into.

Sample tables (cells parted by ``|``) repeat two blocks: channels with their units (``CH#|Channel Name|...|Amp Unit``
and so on), and samples of each channel (``CH#|Channel Name|Sample#|...|1XAmplitude|1X Phase|...``). Bode tables have
the columns ``X-Axis Value,Y-Axis Value,Phase,Timestamp``, a channel a file. Both hold 1x vectors whose phase lags, and
no weight: that is a constant of the file, or the run is a reference run.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from rotorfit.base.units import UNITS, find_unit
from rotorfit.lab.io.tables.cells import EXCEL, encoding_of, marked_encoding
from rotorfit.lab.io.tables.headers import words_of
from rotorfit.lab.io.tables.table import Table

CHANNEL_HEADER = ("CH#", "Channel Name", "Amp Unit")
"""Columns that a block of channels has to have; further ones are used where they are there."""
SAMPLE_HEADER = ("CH#", "Channel Name", "Speed(P)", "1XAmplitude", "1X Phase")
"""The same for a block of samples."""
BODE_HEADER = ("x-axis value", "y-axis value", "phase")

_NUMBER = re.compile(r"([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(?:°|deg\b)?\s*([^\d.,+-].*|)")
"""A number, and the mark behind it."""
_VALID = ("", "v")
"""Text that may follow a valid number, in lower case; anything else marks a reading as invalid."""
_SEPARATED = re.compile(r"(?P<plane>.*[^A-Za-z])(?P<axis>[XYxy])")
"""Plane and axis in the name of a channel, ``Brg 1 X``."""
_JOINED = re.compile(r"(?P<plane>.*[A-Za-z])(?P<axis>[XY])")
_MONTHS = ("jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec")

_Cells = Mapping[str, str]
"""A row of a block by the block's header: a sample, or a channel with its units as the file writes them."""


def bode_table(table: Table, plane_given: bool) -> Table:
    """Readings of a Bode table."""
    if "y-axis value" in table.cells:
        raise ValueError(
            f"{table.source} does not say the unit of its Y-Axis Value; say it (columns=, "
            '--column "Y-Axis Value=amplitude_um_pp"), with one of the '
            "units um, mil, mm, each with _pp, _pk or _rms)"
        )
    table = replace(table.renamed({"x-axis value": "speed_rpm", "phase": "phase_lag_deg"}), written={})
    if not plane_given:
        match = _SEPARATED.fullmatch(Path(table.source).stem)
        if match is None or not match["plane"].strip(" _-.:"):
            raise ValueError(
                f"{table.source} is a Bode table of one channel and does not say which: give constants "
                "{'plane': 'brg1', 'direction': 'x'} (--constant plane=brg1 --constant direction=x), "
                'or name the file after the channel ("Brg 1 X.csv")'
            )
        place = {"plane": match["plane"].strip(" _-.:"), "direction": match["axis"].lower()}
        table = table.with_columns({name: [word] * len(table.lines) for name, word in place.items()})
    found = [next((name for name in table.cells if name.startswith(f"{part}_")), "") for part in _QUANTITIES]
    if "" in found:
        return table
    table = _checked(table, found)
    return replace(table, names={name: name for name in table.cells})


_QUANTITIES = ("speed", "amplitude", "phase")


def _checked(table: Table, names: Sequence[str]) -> Table:
    """The readings whose numbers hold, by the columns of their :data:`_QUANTITIES`, and a note on the others."""
    numbers: dict[str, list[str]] = {name: [] for name in names}
    left_out: dict[int, str] = {}  # by row, why
    count = len(table.lines)
    for row in range(count):
        for name, what in zip(names, _QUANTITIES, strict=True):
            cell, reason = table.cells[name][row], ""
            match = _NUMBER.fullmatch(cell)
            if match is None and re.search(r"\d", cell):
                hint = "; write decimals with a point" if "," in cell else ""
                raise ValueError(f"{table.source}: line {table.lines[row]}: the {what} {cell!r} is not a number{hint}")
            if match is None:
                reason = f"no {what}"
            elif match[2].lower() not in _VALID:
                reason = f"{what} marked {match[2]}"
            elif what == "speed" and float(match[1]) == 0:
                reason = "machine at rest"
            numbers[name].append(match[1] if match else "")
            if reason:
                left_out.setdefault(row, reason)
    listed = ", ".join(f"{reason}: {times}" for reason, times in Counter(left_out.values()).items())
    if len(left_out) == count:
        raise ValueError(f"{table.source}: none of its {count} samples has a speed and a valid 1x vector ({listed})")
    table = table.with_columns(numbers)
    if not left_out:
        return table
    where = table.lines_of(np.array([*left_out]))
    words = f"{table.source}: {len(left_out)} of {count} samples were skipped ({listed}; {where})"
    return table.rows(np.array([row for row in range(count) if row not in left_out])).noted("empty", words)


def with_weight(table: Table) -> Table:
    """The table with what exports do not hold: the run, frequency = speed, and no weight where none is given, which a
    note says."""
    cells, count = table.cells, len(table.lines)
    planes = list(dict.fromkeys(cells.get("plane", ())))
    speed = next((name for name in cells if name.startswith("speed_")), "")
    weighted = any(name.startswith(("force_", "mr_")) and not name.startswith("force_plane") for name in cells)
    added: dict[str, Sequence[str]] = {}
    if "run" not in cells:
        added["run"] = [Path(table.source).stem] * count
    if speed and not any(name.startswith("frequency_") for name in cells):
        added["frequency" + speed.removeprefix("speed")] = cells[speed]
    if not weighted:
        added |= {"mr_g_mm": ["0"] * count, "force_phase_deg": ["0"] * count}
    elif not any(name.startswith(("force_phase_", "force_angle_")) for name in cells):
        raise ValueError(
            f"{table.source}: the angle of the weight is not given; add force_phase_deg to the constants, degrees of "
            "lead from the Keyphasor's mark"
        )
    if "force_plane" not in cells and planes:
        if weighted and len(planes) > 1:
            raise ValueError(
                f"{table.source}: the plane of the weight is not given; add force_plane to the constants, one of "
                f"{', '.join(planes)} or another plane of the rotor"
            )
        added["force_plane"] = [planes[0]] * count
    table = table.with_columns(added)
    words = (
        f"{table.source} holds no weight, so its run is a reference run; for a run with one give constants "
        "{'force_plane': ..., 'mr_g_mm': ..., 'force_phase_deg': ...} (--constant mr_g_mm=30 and so on)"
    )
    return table if weighted else table.noted("no-weight", words)


# ---- sample tables ----------------------------------------------------------------------------------------------


def is_sample_table(path: Path) -> bool:
    """True if a text file has, near its beginning, the header of a block of channels or samples."""
    if path.suffix.lower() in EXCEL:
        return False
    with path.open("rb") as file:
        head = file.read(20_000)
    text = head.decode(marked_encoding(head) or "utf-8", errors="replace")
    return re.search(r"(?im)^\s*ch#\s*\|\s*channel name\s*\|", text) is not None


def sample_table(path: Path, channels: Mapping[str, str]) -> Table:
    """Readings of a sample table."""
    source = path.name
    readings = list(_samples(source, path.read_text(encoding=encoding_of(path))))
    if not readings:
        raise ValueError(f"{source} has no samples: no row follows a header {'|'.join(SAMPLE_HEADER)}")
    if len({channel.get("Machine Name") for channel, _, _ in readings if _length(source, channel) is not None}) > 1:
        readings = [
            ({**one, "Channel Name": f"{one.get('Machine Name', '')} {one['Channel Name']}".strip()}, line, row)
            for one, line, row in readings
        ]
    named = {channel["Channel Name"]: channel for channel, _, _ in readings}
    for one, _, _ in readings:
        name, number = one["Channel Name"], one["CH#"]
        if number != named[name]["CH#"]:
            raise ValueError(
                f"{source}: channels {number} and {named[name]['CH#']} are both called {name!r}; give them different "
                "names"
            )
    unknown = [name for name in channels if name not in named]
    if unknown:
        raise ValueError(f"{source} has no channel {unknown[0]!r}; its channels are {', '.join(named)}")
    moving = [name for name, channel in named.items() if _length(source, channel) is not None]
    others = [f"{name} ({named[name]['Amp Unit'] or 'no unit'})" for name in named if name not in moving]
    if not moving:
        raise ValueError(f"{source} has no channel that measures a displacement: {', '.join(others)}")
    places = _places(source, moving, channels)
    kept = [reading for reading in readings if reading[0]["Channel Name"] in places]
    rows = [_reading(source, one, cells, *places[one["Channel Name"]]) for one, _, cells in kept]
    cells = {name: [row[name] for row in rows] for name in rows[0]}
    if day := next(filter(None, map(_day, cells["timestamp"])), ""):
        cells["date"] = [day] * len(rows)
    lines = np.array([line for _, line, _ in kept])
    table = Table(source=source, cells=cells, lines=lines, names={name: name for name in cells})
    if others:
        words = f"{source}: channels that measure no displacement were left out: {', '.join(others)}"
        table = table.noted("channels", words)
    for words in _askew(source, {place: named[name] for name, place in places.items()}):
        table = table.noted("probe-angles", words)
    return _checked(table, ("speed_rpm", "amplitude_um", "phase_lag_deg"))


def _samples(source: str, text: str) -> Iterator[tuple[_Cells, int, _Cells]]:
    """Rows of all blocks of samples with their lines, each with its channel as the block before it describes it."""
    channels: dict[tuple[str, str], _Cells] = {}
    header: list[str] = []
    for line, content in enumerate(re.split(r"\r\n|\r|\n", text), 1):
        cells = [cell.strip() for cell in content.split("|")]
        if len(cells) < len(CHANNEL_HEADER) or not any(cells):
            continue
        if cells[0].lower() == "ch#":
            header = cells
            wanted = SAMPLE_HEADER if "Sample#" in header else CHANNEL_HEADER
            missing = [name for name in wanted if name not in header]
            if missing:
                raise ValueError(f"{source}: line {line}: the header has no column {', '.join(missing)}")
            continue
        if not header:
            continue
        if len(cells) != len(header) or (cells[-1] and not header[-1]):
            raise ValueError(f"{source}: line {line} has {len(cells)} cells, its header has {len(header)} columns")
        row = dict(zip(header, cells, strict=False))
        key = (row["CH#"], row["Channel Name"])
        if "Sample#" not in header:
            channels[key] = row
        elif key in channels:
            yield channels[key], line, row
        else:
            raise ValueError(
                f"{source}: line {line}: no block of channels ({'|'.join(CHANNEL_HEADER)}) describes channel "
                f"{key[0]} {key[1]!r} before its samples, so its unit is not known; export it with the channels"
            )


def _reading(source: str, channel: _Cells, cells: _Cells, plane: str, axis: str) -> dict[str, str]:
    """A sample as a row of a tidy table; marks stay behind their numbers."""

    def scaled(cell: str, factor: float) -> str:
        match = _NUMBER.fullmatch(cell)
        return f"{float(match[1]) * factor!r} {match[2]}".strip() if match else cell

    def factor(quantity: str, given: str, prefix: str, usual: str, known: str) -> float:
        found = find_unit(prefix + _unit(given), UNITS[quantity])
        if found is None:
            name = channel["Channel Name"]
            raise ValueError(f"{source}: channel {name}: unknown unit {given!r}; known: {known}")
        return found / UNITS[quantity][usual]

    to_deg = factor("phase", channel.get("Phase Unit", "deg"), "lag_", "lag_deg", "deg, rad")
    to_rpm = factor("frequency", channel.get("Speed Units(P)", "rpm"), "", "rpm", "rpm, cpm, Hz")
    return {
        "plane": plane,
        "direction": axis,
        "speed_rpm": scaled(cells["Speed(P)"], to_rpm),
        "amplitude_um": scaled(cells["1XAmplitude"], (_length(source, channel) or 0.0) * 1e6),
        "phase_lag_deg": scaled(cells["1X Phase"], to_deg),
        "sample": cells["Sample#"],
        "sample_cause": cells.get("Sample Cause", ""),
        "timestamp": cells.get("Date", ""),
        "avg_gap": cells.get("Avg Gap", ""),
    }


def _unit(cell: str) -> str:
    """A unit as column names write it: ``mil_pp`` for ``Mils Pk-Pk``."""
    return "_".join(word for word in words_of(cell.lower()) if word != "lag")


def _length(source: str, channel: _Cells) -> float | None:
    """Factor to m, 0-peak; None for a channel that measures something else."""
    said = channel["Amp Unit"]
    unit = _unit(said)
    if unit in UNITS["length"]:
        raise ValueError(
            f"{source}: channel {channel['Channel Name']}: the Amp Unit {said!r} does not say whether amplitudes are "
            f"peak to peak; write {said} pp, {said} pk or {said} rms there"
        )
    return find_unit(unit, UNITS["displacement"])


def _places(source: str, names: Sequence[str], given: Mapping[str, str]) -> dict[str, tuple[str, str]]:
    """Plane and direction of each channel."""
    found: dict[str, tuple[str, str]] = {}
    stems = {(m["plane"], m["axis"]) for name in names if (m := _JOINED.fullmatch(name))}
    for name in names:
        match = _SEPARATED.fullmatch(given.get(name, name))
        joined = _JOINED.fullmatch(name)
        if match is None and joined and {(joined["plane"], axis) for axis in "XY"} <= stems:
            match = joined
        plane = match["plane"].strip(" _-.:") if match else ""
        if match and plane:
            found[name] = (plane, match["axis"].lower())
    lost = [name for name in names if name not in found]
    if lost:
        raise ValueError(
            f"{source}: the names of these channels do not tell plane and direction: {', '.join(lost)} (of "
            f"{', '.join(names)}); say them (columns=, --column "
            f'"{lost[0]}=brg1_x")'
        )
    taken = Counter(found.values())
    twice = [name for name in found if taken[found[name]] > 1]
    if twice:
        raise ValueError(
            f"{source}: channels {', '.join(twice)} are all of plane {found[twice[0]][0]}, direction "
            f'{found[twice[0]][1]}; name them apart (columns=, --column "{twice[0]}=brg1_x")'
        )
    return found


def _askew(source: str, probes: Mapping[tuple[str, str], _Cells]) -> Iterator[str]:
    """Sentences on pairs of probes that do not sit at right angles, as their angles right and left of the top say."""
    for plane in dict.fromkeys(plane for plane, _ in probes):
        pair = [probes[plane, axis] for axis in "xy" if (plane, axis) in probes]
        sides = [{"right": 1.0, "left": -1.0}.get(probe.get("Direction", "").lower()) for probe in pair]
        matches = [_NUMBER.fullmatch(probe.get("Angle", "")) for probe in pair]
        angles = [side * float(m[1]) for side, m in zip(sides, matches, strict=True) if side is not None and m]
        if len(angles) < 2:
            continue
        apart = abs((angles[1] - angles[0] + 180) % 360 - 180)
        if abs(apart - 90) > 1:
            where = " and ".join(f"{probe['Angle']} {probe['Direction']}" for probe in pair)
            yield (
                f"{source}: the probes x and y of {plane} sit at {where}, {apart:g} degrees apart and not 90; unless "
                f'you have, give their angles (probe_angles=, --probe-angles "{plane}=0:{apart:g}"), which puts X '
                "along the x probe"
            )


def _day(stamp: str) -> str:
    """Day of a time stamp as ISO 8601; empty where it is ambiguous, such as 03/04/2025."""
    if match := re.match(r"(\d{4})-(\d{2})-(\d{2})\b", stamp):
        return match[0]
    match = re.match(r"(\d{1,2})[ -]?([A-Za-z]{3})[ -]?(\d{4})\b", stamp)
    if match is None or match[2].lower() not in _MONTHS:
        return ""
    return f"{match[3]}-{_MONTHS.index(match[2].lower()) + 1:02d}-{int(match[1]):02d}"
