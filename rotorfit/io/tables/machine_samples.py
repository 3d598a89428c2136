"""Sample tables that condition-monitoring systems export: blocks of channels and of their samples, repeated."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from rotorfit.data.findings import Finding
from rotorfit.io.tables.cells import EXCEL, encoding_of, marked_encoding
from rotorfit.io.tables.machine_tables import NUMBER, SEPARATED, Row, checked
from rotorfit.io.tables.table import Table
from rotorfit.units import UNITS, find_unit

CHANNEL_HEADER = ("CH#", "Channel Name", "Amp Unit")
"""Columns that a block of channels has to have; further ones are used where they are there."""
SAMPLE_HEADER = ("CH#", "Channel Name", "Speed(P)", "1XAmplitude", "1X Phase")
"""The same for a block of samples."""

_JOINED = re.compile(r"(?P<plane>.*[A-Za-z])(?P<axis>[XY])")
_MONTHS = ("jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec")


@dataclass(frozen=True, kw_only=True)
class _Channel:
    """A channel of a sample table, with its units as the file writes them, and where its probe sits."""

    number: str
    name: str
    machine: str
    amplitude: str
    phase: str
    speed: str
    angle: str
    side: str


def is_sample_table(path: Path) -> bool:
    """True if a text file has, near its beginning, the header of a block of channels or samples."""
    if path.suffix.lower() in EXCEL:
        return False
    with path.open("rb") as file:
        head = file.read(20_000)
    text = head.decode(marked_encoding(head) or "utf-8", errors="replace")
    return re.search(r"(?im)^\s*ch#\s*\|\s*channel name\s*\|", text) is not None


def sample_table(path: Path, channels: Mapping[str, str]) -> tuple[Table, list[Finding]]:
    """Readings of a sample table, and what was left out of them."""
    source = path.name
    readings = list(_samples(source, path.read_text(encoding=encoding_of(path))))
    if not readings:
        raise ValueError(f"{source} has no samples: no row follows a header {'|'.join(SAMPLE_HEADER)}")
    if len({channel.machine for channel, _ in readings if _length(source, channel) is not None}) > 1:
        readings = [(replace(one, name=f"{one.machine} {one.name}".strip()), row) for one, row in readings]
    named = {channel.name: channel for channel, _ in readings}
    twice = next((one for one, _ in readings if one.number != named[one.name].number), None)
    if twice is not None:
        raise ValueError(
            f"{source}: channels {twice.number} and {named[twice.name].number} are both called {twice.name!r}; give "
            "them different names"
        )
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
    rows: list[Row] = []
    for channel, (line, cells) in readings:
        if channel.name in places:
            rows.append((line, _reading(source, channel, cells, *places[channel.name])))
    day = next((day for _, row in rows if (day := _day(row["timestamp"]))), "")
    rows = [(line, {**row, "date": day} if day else row) for line, row in rows]
    return checked(source, rows, "amplitude_um", "phase_lag_deg", "speed_rpm", found)


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
                number=row["CH#"],
                name=row["Channel Name"],
                machine=row.get("Machine Name", ""),
                amplitude=row["Amp Unit"],
                phase=row.get("Phase Unit", "deg"),
                speed=row.get("Speed Units(P)", "rpm"),
                angle=row.get("Angle", ""),
                side=row.get("Direction", ""),
            )
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
    match = NUMBER.fullmatch(cell)
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
    """Plane and direction of each channel."""
    found: dict[str, tuple[str, str]] = {}
    stems = {(m["plane"], m["axis"]) for name in names if (m := _JOINED.fullmatch(name))}
    for name in names:
        match = SEPARATED.fullmatch(given.get(name, name))
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


def _askew(source: str, probes: Mapping[tuple[str, str], _Channel]) -> Iterator[Finding]:
    """Notes on pairs of probes that do not sit at right angles, as their angles right and left of the top say."""
    for plane in dict.fromkeys(plane for plane, _ in probes):
        pair = [probes[plane, axis] for axis in "xy" if (plane, axis) in probes]
        sides = [{"right": 1.0, "left": -1.0}.get(probe.side.lower()) for probe in pair]
        matches = [NUMBER.fullmatch(probe.angle) for probe in pair]
        angles = [side * float(m[1]) for side, m in zip(sides, matches, strict=True) if side is not None and m]
        if len(angles) < 2:
            continue
        apart = abs((angles[1] - angles[0] + 180) % 360 - 180)
        if abs(apart - 90) > 1:
            where = " and ".join(f"{probe.angle} {probe.side}" for probe in pair)
            words = (
                f"{source}: the probes x and y of {plane} sit at {where}, {apart:g} degrees apart and not 90; unless "
                f'you have, give their angles (probe_angles=, --probe-angles "{plane}=0:{apart:g}"), which puts X '
                "along the x probe"
            )
            yield Finding("note", "probe-angles", words)


def _day(stamp: str) -> str:
    """Day of a time stamp as ISO 8601; empty where it is ambiguous, such as 03/04/2025."""
    if match := re.match(r"(\d{4})-(\d{2})-(\d{2})\b", stamp):
        return match[0]
    match = re.match(r"(\d{1,2})[ -]?([A-Za-z]{3})[ -]?(\d{4})\b", stamp)
    if match is None or match[2].lower() not in _MONTHS:
        return ""
    return f"{match[3]}-{_MONTHS.index(match[2].lower()) + 1:02d}-{int(match[1]):02d}"
