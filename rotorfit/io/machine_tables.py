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
from dataclasses import dataclass, replace
from pathlib import Path

from rotorfit.data.findings import Finding
from rotorfit.io.cells import EXCEL, decoded, marked_encoding
from rotorfit.io.csv_table import Table
from rotorfit.units import UNITS, find_unit

CHANNEL_HEADER = ("CH#", "Channel Name", "Amp Unit")
"""Columns that a block of channels has to have; further ones are used where they are there."""
SAMPLE_HEADER = ("CH#", "Channel Name", "Speed(P)", "1XAmplitude", "1X Phase")
"""The same for a block of samples."""
BODE_HEADER = ("x-axis value", "y-axis value", "phase")

_NUMBER = re.compile(r"([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(?:°|deg\b)?\s*([^\d.,+-].*|)")
_VALID = ("", "v")
"""What may follow a number that holds, in lower case; anything else marks a reading as one not to be relied on."""
_SEPARATED = re.compile(r"(?P<plane>.*[^A-Za-z])(?P<axis>[XYxy])")
_JOINED = re.compile(r"(?P<plane>.*[A-Za-z])(?P<axis>[XY])")
_WEIGHT = ("force_", "mr_")
_MONTHS = ("jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec")

Row = tuple[int, Mapping[str, str]]
"""Line of the file, and its cells by column."""


@dataclass(frozen=True, kw_only=True)
class _Channel:
    """A channel of a sample table, with its units as the file writes them, and where its probe sits."""

    name: str
    machine: str
    amplitude: str
    phase: str
    speed: str
    angle: str
    side: str


def is_sample_table(path: Path) -> bool:
    """Whether a text file has, near its beginning, the header of a block of channels or samples.

    Args:
        path: the file.
    """
    if path.suffix.lower() in EXCEL:
        return False
    with path.open("rb") as file:
        head = file.read(20_000)
    text = head.decode(marked_encoding(head) or "utf-8", errors="replace")
    return re.search(r"(?im)^\s*ch#\s*\|\s*channel name\s*\|", text) is not None


def sample_table(path: Path, channels: Mapping[str, str]) -> tuple[Table, list[Finding]]:
    """Readings of a sample table, and what was left out of them.

    Args:
        path: the file.
        channels: ``plane_x`` or ``plane_y`` by channel name, for names that do not tell.

    Raises:
        ValueError: a block lacks a column, a unit is unknown, or a name of a channel does not tell plane and direction.
    """
    source = path.name
    readings = list(_samples(source, decoded(path)))
    if not readings:
        raise ValueError(f"{source} has no samples: no row follows a header {'|'.join(SAMPLE_HEADER)}")
    named = {channel.name: channel for channel, _ in readings}
    unknown = [name for name in channels if name not in named]
    if unknown:
        raise ValueError(f"{source} has no channel {unknown[0]!r}; its channels are {', '.join(named)}")
    moving = [name for name, channel in named.items() if _length(source, channel) is not None]
    others = [f"{name} ({named[name].amplitude or 'no unit'})" for name in named if name not in moving]
    if not moving:
        raise ValueError(f"{source} has no channel that measures a displacement: {', '.join(others)}")
    found = []
    if others:
        words = f"{source}: channels that measure no displacement were left out: {', '.join(others)}"
        found.append(Finding("note", "channels", words))
    places = _places(source, moving, channels)
    found += _askew(source, {place: named[name] for name, place in places.items()})
    several = len({named[name].machine for name in moving}) > 1
    rows: list[Row] = []
    for channel, (line, cells) in readings:
        if channel.name in places:
            plane, axis = places[channel.name]
            rows.append(
                (line, _reading(source, channel, cells, f"{channel.machine} {plane}" if several else plane, axis))
            )
    day = next((day for _, row in rows if (day := _day(row["timestamp"]))), "")
    rows = [(line, {**row, "date": day} if day else row) for line, row in rows]
    return _checked(source, rows, "amplitude_um", "phase_lag_deg", "speed_rpm", found)


def _samples(source: str, text: str) -> Iterator[tuple[_Channel, Row]]:
    """Rows of all blocks of samples, each with its channel as the block before it describes it."""
    channels: dict[tuple[str, str], _Channel] = {}
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
            channels[key] = _Channel(
                name=row["Channel Name"], machine=row.get("Machine Name", ""), amplitude=row["Amp Unit"],
                phase=row.get("Phase Unit", "deg"), speed=row.get("Speed Units(P)", "rpm"),
                angle=row.get("Angle", ""), side=row.get("Direction", ""),
            )  # fmt: skip
        elif key in channels:
            yield channels[key], (line, row)
        else:
            raise ValueError(
                f"{source}: line {line}: no block of channels ({'|'.join(CHANNEL_HEADER)}) describes channel "
                f"{key[0]} {key[1]!r} before its samples, so its unit is not known; export it with the channels"
            )


def _reading(source: str, channel: _Channel, cells: Mapping[str, str], plane: str, axis: str) -> dict[str, str]:
    """A sample as a row of a tidy table; marks stay behind their numbers."""
    to_um = (_length(source, channel) or 0.0) * 1e6
    to_deg = _factor(source, channel, "phase", f"lag_{_unit(channel.phase)}") / UNITS["phase"]["lag_deg"]
    to_rpm = _factor(source, channel, "frequency", _unit(channel.speed)) / UNITS["frequency"]["rpm"]
    return {
        "plane": plane,
        "direction": axis,
        "speed_rpm": _scaled(cells["Speed(P)"], to_rpm),
        "amplitude_um": _scaled(cells["1XAmplitude"], to_um),
        "phase_lag_deg": _scaled(cells["1X Phase"], to_deg),
        "sample": cells["Sample#"],
        "sample_cause": cells.get("Sample Cause", ""),
        "timestamp": cells.get("Date", ""),
        "avg_gap": cells.get("Avg Gap", ""),
    }


def _scaled(cell: str, factor: float) -> str:
    match = _NUMBER.fullmatch(cell)
    return f"{float(match[1]) * factor!r} {match[2]}".strip() if match else cell


def _unit(cell: str) -> str:
    """A unit as column names write it: ``mil_pp`` for ``Mils Pk-Pk``."""
    words = cell.replace("µ", "u").replace("μ", "u").replace("°", "deg").lower().split()
    same = {
        "mils": "mil", "micron": "um", "microns": "um", "p-p": "pp", "pk-pk": "pp", "0-pk": "pk", "0-p": "pk",
        "degree": "deg", "degrees": "deg",
    }  # fmt: skip
    return "_".join(same.get(word, word) for word in words if word != "lag")


def _length(source: str, channel: _Channel) -> float | None:
    """Factor to m, 0-peak; None for a channel that measures something else."""
    unit = _unit(channel.amplitude)
    if unit in UNITS["length"]:
        raise ValueError(
            f"{source}: channel {channel.name}: the Amp Unit {channel.amplitude!r} does not say whether amplitudes are "
            f"peak to peak; write {channel.amplitude} pp, {channel.amplitude} pk or {channel.amplitude} rms there"
        )
    return find_unit(unit, UNITS["displacement"])


def _factor(source: str, channel: _Channel, quantity: str, unit: str) -> float:
    factor = find_unit(unit, UNITS[quantity])
    if factor is None:
        given, known = (channel.phase, "deg, rad") if quantity == "phase" else (channel.speed, "rpm, cpm, Hz")
        raise ValueError(f"{source}: channel {channel.name}: unknown unit {given!r}; known: {known}")
    return factor


def _places(source: str, names: Sequence[str], given: Mapping[str, str]) -> dict[str, tuple[str, str]]:
    """Plane and direction of each channel.

    Raises:
        ValueError: names that do not tell, or two that tell the same.
    """
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
            f"{', '.join(names)}); say them by columns, {{{lost[0]!r}: 'brg1_x'}}, on the command line --column "
            f'"{lost[0]}=brg1_x"'
        )
    taken = Counter(found.values())
    twice = [name for name in found if taken[found[name]] > 1]
    if twice:
        raise ValueError(
            f"{source}: channels {', '.join(twice)} are all of plane {found[twice[0]][0]}, direction "
            f"{found[twice[0]][1]}; name them apart by columns, {{{twice[0]!r}: 'brg1_x'}}"
        )
    return found


def _askew(source: str, probes: Mapping[tuple[str, str], _Channel]) -> Iterator[Finding]:
    """Notes on pairs of probes that do not sit at right angles, as their angles right and left of the top say."""
    for plane in dict.fromkeys(plane for plane, _ in probes):
        pair = [probes[plane, axis] for axis in "xy" if (plane, axis) in probes]
        sides = [{"right": 1.0, "left": -1.0}.get(probe.side.lower()) for probe in pair]
        matches = [_NUMBER.fullmatch(probe.angle) for probe in pair]
        angles = [side * float(m[1]) for side, m in zip(sides, matches, strict=True) if side is not None and m]
        if len(angles) < 2:
            continue
        apart = abs((angles[1] - angles[0] + 180) % 360 - 180)
        if abs(apart - 90) > 1:
            where = " and ".join(f"{probe.angle} {probe.side}" for probe in pair)
            words = (
                f"{source}: the probes x and y of {plane} sit at {where}, {apart:g} degrees apart and not 90; unless "
                f'you have, give --probe-angles "{plane}=0:{apart:g}" (probe_angles), which puts X along the x probe'
            )
            yield Finding("note", "probe-angles", words)


def bode_table(table: Table, plane_given: bool) -> tuple[Table, list[Finding]]:
    """Readings of a Bode table, and what was left out of them.

    Args:
        table: as it is read, its columns renamed as the user wants.
        plane_given: whether constants say plane and direction; else the name of the file has to.

    Raises:
        ValueError: the unit of the amplitude, or plane and direction, are not told.
    """
    usual = {"x-axis value": "speed_rpm", "phase": "phase_lag_deg"}
    columns = {usual.get(name, name): cells for name, cells in table.cells.items()}
    if "y-axis value" in columns:
        raise ValueError(
            f"{table.source} does not say the unit of its Y-Axis Value; say it by columns, "
            "{'Y-Axis Value': 'amplitude_um_pp'}, on the command line --column \"Y-Axis Value=amplitude_um_pp\" "
            "(units um, mil, mm, each with _pp, _pk or _rms)"
        )
    count = len(table.lines)
    if not plane_given:
        match = _SEPARATED.fullmatch(Path(table.source).stem)
        if match is None or not match["plane"].strip(" _-.:"):
            raise ValueError(
                f"{table.source} is a Bode table of one channel and does not say which: give constants "
                "{'plane': 'brg1', 'direction': 'x'} (--constant plane=brg1 --constant direction=x), "
                'or name the file after the channel ("Brg 1 X.csv")'
            )
        columns |= {"plane": [match["plane"].strip(" _-.:")] * count, "direction": [match["axis"].lower()] * count}
    names = [
        next((name for name in columns if name.startswith(part)), "") for part in ("amplitude_", "phase_", "speed_")
    ]
    if "" in names:
        return replace(table, cells=columns, names={**table.names, **{name: name for name in columns}}), []
    rows: list[Row] = [
        (line, dict(zip(columns, cells, strict=True)))
        for line, cells in zip(table.lines, zip(*columns.values(), strict=True), strict=True)
    ]
    return _checked(table.source, rows, names[0], names[1], names[2], [])


def _checked(
    source: str, rows: Sequence[Row], amplitude: str, phase: str, speed: str, found: list[Finding]
) -> tuple[Table, list[Finding]]:
    """The table of the readings whose numbers hold, and findings on those that were left out."""
    kept: list[Row] = []
    reasons: Counter[str] = Counter()
    lines = []
    for line, row in rows:
        reason, cells = "", dict(row)
        for name, what in ((speed, "speed"), (amplitude, "amplitude"), (phase, "phase")):
            match = _NUMBER.fullmatch(row[name])
            if match is None and re.search(r"\d", row[name]):
                hint = "; write decimals with a point" if "," in row[name] else ""
                raise ValueError(f"{source}: line {line}: the {what} {row[name]!r} is not a number{hint}")
            if match is None:
                reason = reason or f"no {what}"
            elif match[2].lower() not in _VALID:
                reason = reason or f"{what} marked {match[2]}"
            elif what == "speed" and float(match[1]) == 0:
                reason = "machine at rest"
            cells[name] = match[1] if match else ""
        if reason:
            reasons[reason] += 1
            lines.append(str(line))
        else:
            kept.append((line, cells))
    listed = ", ".join(f"{reason}: {count}" for reason, count in reasons.items())
    if not kept:
        raise ValueError(f"{source}: none of its {len(rows)} samples has a speed and a valid 1x vector ({listed})")
    if reasons:
        where = ", ".join(lines[:5]) + (", ..." if len(lines) > 5 else "")
        words = (
            f"{source}: {len(lines)} of {len(rows)} samples were skipped ({listed}; "
            f"line{'s' * (len(lines) > 1)} {where})"
        )
        found = [*found, Finding("note", "empty", words)]
    names = list(kept[0][1])
    columns = {name: [row[name] for _, row in kept] for name in names}
    return Table(source, columns, [line for line, _ in kept], {name: name for name in names}), found


def with_weight(table: Table) -> Table:
    """The table with what exports do not hold: the run, frequency = speed, and no weight where none is given.

    Args:
        table: readings with the constants that the user gives.

    Raises:
        ValueError: a weight without its angle, or without its plane where there are several.
    """
    cells, names, count = dict(table.cells), dict(table.names), len(table.lines)
    planes = list(dict.fromkeys(cells["plane"])) if "plane" in cells else []
    speed = next((name for name in cells if name.startswith("speed_")), "")
    added: dict[str, Sequence[str]] = {}
    if "run" not in cells:
        added["run"] = [Path(table.source).stem] * count
    if speed and not any(name.startswith("frequency_") for name in cells):
        added["frequency" + speed.removeprefix("speed")] = cells[speed]
    weighted = any(name.startswith(_WEIGHT) and not name.startswith("force_plane") for name in cells)
    if not weighted:
        added |= {"mr_g_mm": ["0"] * count, "force_phase_deg": ["0"] * count}
    elif not any(name.startswith("force_phase_") for name in cells):
        raise ValueError(
            f"{table.source}: the angle of the weight is not told; add force_phase_deg to the constants, degrees of "
            "lead from the Keyphasor's mark"
        )
    if "force_plane" not in cells and planes:
        if weighted and len(planes) > 1:
            raise ValueError(
                f"{table.source}: the plane of the weight is not told; add force_plane to the constants, one of "
                f"{', '.join(planes)} or another plane of the rotor"
            )
        added["force_plane"] = [planes[0]] * count
    return replace(table, cells={**cells, **added}, names={**names, **{name: name for name in added}})


def without_weight_finding(table: Table) -> list[Finding]:
    """A note on a file without a weight.

    Args:
        table: readings with the constants that the user gives.
    """
    if any(name.startswith(_WEIGHT) and not name.startswith("force_plane") for name in table.cells):
        return []
    words = (
        f"{table.source} holds no weight, so its run is a reference run; for a run with one give constants "
        "{'force_plane': ..., 'mr_g_mm': ..., 'force_phase_deg': ...} (--constant mr_g_mm=30 and so on)"
    )
    return [Finding("note", "no-weight", words)]


def _day(stamp: str) -> str:
    """Day of a time stamp as ISO 8601; empty where it cannot be told, such as 03/04/2025."""
    if match := re.match(r"(\d{4})-(\d{2})-(\d{2})\b", stamp):
        return match[0]
    match = re.match(r"(\d{1,2})[ -]?([A-Za-z]{3})[ -]?(\d{4})\b", stamp)
    if match is None or match[2].lower() not in _MONTHS:
        return ""
    return f"{match[3]}-{_MONTHS.index(match[2].lower()) + 1:02d}-{int(match[1]):02d}"
