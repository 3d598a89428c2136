"""LabVIEW's own text files (.lvm): a heading of the file, then segments with a heading and rows of numbers each.

The heading says separator and decimal mark. Times are in no column (then ``Delta_X`` is the step), in one, or in one
before each channel; a last column holds comments. A channel may be empty or end before the others. Segments in which
one goes on where the one before ended are one recording; others are refused.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from io import StringIO
from itertools import islice, pairwise
from pathlib import Path
from string import ascii_letters, digits

import numpy as np
from numpy.typing import NDArray

from rotorfit.base.array_types import Float
from rotorfit.base.file_reading import check_unpacked
from rotorfit.lab.io.sampling import FEWEST, rate_of_times
from rotorfit.lab.io.tables.cells import encoding_of
from rotorfit.lab.recordings.formats.raw_file import RawArray, RawChannel, RawFile, spooled

FIRST_LINE = "LabVIEW Measurement"
_END, _TIME = "***End_of_Header***", "X_Value"
_LETTERS = f"{ascii_letters}{digits}_ "
"""Characters of a key."""
_ROWS = 1 << 17
"""Rows turned into numbers at once."""

_Heading = Mapping[str, Sequence[str]]
"""Cells behind each key of a heading."""


@dataclass(frozen=True, kw_only=True)
class _Segment:
    """Rows of numbers under a heading of their own."""

    heading: _Heading
    names: tuple[str, ...]  # of the columns, as they stand above the numbers
    begin: int  # line of the first row, from zero
    rows: int

    @property
    def times(self) -> list[int]:
        """Columns of times."""
        return [i for i, name in enumerate(self.names) if name == _TIME]

    @property
    def channels(self) -> list[int]:
        """Columns of channels."""
        return [i for i, name in enumerate(self.names) if name != _TIME]


def open_file(path: Path) -> RawFile:
    """Content of a LabVIEW measurement file."""
    encoding = encoding_of(path)
    heading, segments = _outline(path, encoding)
    if not segments:
        raise ValueError(f"{path.name} holds no signals: no numbers stand below a second {_END}")
    first = segments[0]
    if odd := next((one for one in segments if one.names != first.names), None):
        raise ValueError(
            f"{path.name}: the segment from line {odd.begin + 1} on has the columns {', '.join(odd.names)}, the first "
            f"has {', '.join(first.names)}; export each segment into a file of its own"
        )
    rows, width = sum(one.rows for one in segments), len(first.names)
    check_unpacked(path.name, 8.0 * rows * width, path.stat().st_size)
    numbers = _numbers(path, encoding, heading, segments)
    columns = spooled(numbers, rows * width, np.float64).reshape(-1, width).T
    empty = [i for i in first.channels if not np.isfinite(columns[i]).any()]
    steps = [_number(cell) for cell in _of_channels(first, "Delta_X", first.channels)]
    rates = [_rate(path.name, columns, first, i, step) for i, step in zip(first.channels, steps, strict=True)]
    if not any(np.isfinite(columns[i]).any() for i in first.times):
        _check_joined(path.name, segments, steps[0])
    units = _of_channels(first, "Y_Unit_Label", first.channels)
    names = _names(first)
    channels: dict[str, RawChannel] = {}
    for name, i, rate, unit in zip(names, first.channels, rates, units, strict=True):
        taken = np.flatnonzero(np.isfinite(columns[i]))
        if i in empty or taken[-1] + 1 < FEWEST:
            continue
        whole = RawArray.of(columns[i][: taken[-1] + 1])
        channels |= {each.name: each for each in whole.channels([name], sample_rate=rate, unit=unit)}
    left_out = [name for name, i in zip(names, first.channels, strict=True) if i in empty]
    remarks = (f"{path.name}: channels without a number were left out: {', '.join(left_out)}",) if left_out else ()
    return RawFile(name=path.name, channels=channels, attributes=_date(heading, first), remarks=remarks)


def _outline(path: Path, encoding: str) -> tuple[_Heading, list[_Segment]]:
    """The heading of the file, and where its segments stand."""
    whole: dict[str, Sequence[str]] = {}
    own: dict[str, Sequence[str]] = {}
    segments: list[_Segment] = []
    separator, place, special = "\t", "file", False
    longest = 10_000  # lines before the numbers
    with path.open(encoding=encoding) as file:
        for number, line in enumerate(file):
            text = line.rstrip("\r\n")
            if number >= longest and not segments:
                raise ValueError(f"{path.name} holds no signals: no numbers stand in its first {longest} lines")
            if special or text.startswith("***Start_Special"):  # notes of other programs between the headings
                special = not text.startswith("***End_Special")
            elif place == "rows" and text.strip() and not text.startswith(f"Channels{separator}"):
                segments[-1] = replace(segments[-1], rows=segments[-1].rows + 1)
            elif text.startswith(_END):
                place = "names" if place == "segment" else "segment"
                separator = _separator(whole)
                own = {} if place == "segment" else own
            elif place == "names" and text.strip():
                cells = [cell.strip() for cell in text.split(separator)]
                names = tuple(cells[: cells.index("Comment")] if "Comment" in cells else cells)
                segments.append(_Segment(heading=dict(own), names=names, begin=number + 1, rows=0))
                place = "rows"
            elif place == "rows" and text.startswith(f"Channels{separator}"):  # of a further segment
                place, own = "segment", {}
            if place in ("file", "segment") and text.strip() and not text.startswith("***"):
                # the heading of the file says the separator, by standing behind its keys
                between = separator if place == "segment" else text.lstrip(_LETTERS)[:1] or separator
                key, *values = (cell.strip() for cell in text.split(between))
                (whole if place == "file" else own)[key] = values or [""]
    return whole, [_without_blanks(path.name, one) for one in segments if one.rows]


def _separator(heading: _Heading) -> str:
    """What stands between cells below the heading of the file."""
    return {"comma": ",", "semicolon": ";"}.get(heading.get("Separator", [""])[0].lower(), "\t")


def _without_blanks(source: str, segment: _Segment) -> _Segment:
    """A segment without the columns behind its last channel; one that names a channel twice is as LabVIEW made it."""
    width = max((i + 1 for i, name in enumerate(segment.names) if name), default=0)
    if width - (segment.names[:width].count(_TIME) if width else 0) < 1:
        raise ValueError(f"{source}: line {segment.begin} names no channel")
    return replace(segment, names=segment.names[:width])


def _names(segment: _Segment) -> list[str]:
    """Names of channels, each its own; one without a name is called by its place."""
    found: list[str] = []
    for number, i in enumerate(segment.channels, 1):
        name = segment.names[i] or f"channel_{number}"
        found.append(name if name not in found else f"{name} ({number})")
    return found


def _of_channels(segment: _Segment, key: str, channels: Sequence[int]) -> list[str]:
    """What a heading says of each channel; it leaves a cell out for every further column of times."""
    cells = list(segment.heading.get(key, ()))
    if len(segment.times) > 1:
        cells = cells[::2]
    return [*cells, *[""] * len(channels)][: len(channels)]


def _number(cell: str) -> float:
    pointed = cell.replace(",", ".")
    return float(pointed) if _is_number(pointed) else float("nan")


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _rate(name: str, columns: Float, segment: _Segment, channel: int, step: float) -> float | None:
    """Sampling rate, Hz, by the step that the heading says where the column of times agrees, else by that column."""
    times = [columns[i] for i in segment.times if i < channel][-1:]
    given = np.isfinite(times[0]) if times else np.zeros(0, dtype=bool)
    if not given.any():
        return 1 / step if step > 0 else None
    t = np.asarray(times[0][: np.flatnonzero(given)[-1] + 1])
    if step > 0 and np.abs(t - t[0] - step * np.arange(t.size)).max() < 0.5 * step:
        return 1 / step  # the times may be written with few digits
    return rate_of_times(t, f"{name}, {_TIME}")


def _check_joined(name: str, segments: Sequence[_Segment], step: float) -> None:
    """Refuse segments without columns of times of which one does not go on where the one before ended."""
    for one, other in pairwise(segments):
        begins = [_begin(segment) for segment in (one, other)]
        if not (step > 0 and abs(begins[1] - begins[0] - one.rows * step) < 0.5 * step):
            raise ValueError(
                f"{name}: the segment from line {other.begin + 1} on does not go on where the one before ended, by "
                "its X0, Date and Time; export the recording as one segment, or each into a file of its own"
            )


def _begin(segment: _Segment) -> float:
    """When a segment begins, s: its time of day or date, and what it says beyond that."""
    x0 = _number(_of_channels(segment, "X0", segment.channels[:1])[0])
    said = [_of_channels(segment, key, segment.channels[:1])[0] for key in ("Date", "Time")]
    day, time = said[0], re.fullmatch(r"(\d+):(\d+):(\d+)(?:[.,](\d+))?", said[1])
    begin = 0.0 if np.isnan(x0) else x0
    if time is None:
        return begin
    seconds = timedelta(hours=int(time[1]), minutes=int(time[2]), seconds=int(time[3])).total_seconds()
    whole = datetime.fromisoformat(day.replace("/", "-")).toordinal() * 86400.0 if _iso(day) else 0.0
    return whole + seconds + float(f"0.{time[4] or 0}") + begin


def _iso(day: str) -> str:
    """A date as ISO 8601; empty for what is none."""
    match = re.fullmatch(r"(\d{4})[/-](\d{2})[/-](\d{2})", day)
    try:
        return datetime.fromisoformat("-".join(match.groups())).date().isoformat() if match else ""
    except ValueError:
        return ""


def _date(heading: _Heading, segment: _Segment) -> dict[str, float | str]:
    said = [heading.get("Date", [""])[0], *segment.heading.get("Date", [""])[:1]]
    day = next((found for found in map(_iso, reversed(said)) if found), "")
    return {"date": day} if day else {}


def _numbers(
    path: Path, encoding: str, heading: _Heading, segments: Sequence[_Segment]
) -> Iterator[NDArray[np.float64]]:
    """Numbers of all segments, row by row, in pieces; what a row does not have is NaN."""
    separator = _separator(heading)
    decimal = heading.get("Decimal_Separator", ["."])[0][:1]
    with path.open(encoding=encoding) as file:
        at = 0
        for segment in segments:
            for _ in islice(file, segment.begin - at):
                pass
            at, left = segment.begin, segment.rows
            while left:
                lines = list(islice(file, min(left, _ROWS)))
                yield _block(path.name, at, lines, len(segment.names), separator, decimal)
                at, left = at + len(lines), left - len(lines)


def _block(source: str, at: int, lines: list[str], width: int, separator: str, decimal: str) -> NDArray[np.float64]:
    """Numbers of some lines from one on."""
    from pandas import read_csv

    if decimal == "," and separator != ",":
        lines = [line.replace(",", ".") for line in lines]
    kept = [separator.join(line.rstrip("\r\n").split(separator)[:width]) for line in lines]  # without comments
    try:
        found = read_csv(
            StringIO("\n".join(kept)), sep=separator, header=None, names=range(width), dtype=np.float64,
            skip_blank_lines=False, quoting=3, index_col=False, na_values=[" "],
        )  # fmt: skip
    except ValueError as problem:
        for number, line in enumerate(kept, at + 1):
            for cell in line.split(separator):
                if cell.strip() and not _is_number(cell):
                    raise ValueError(f"{source}: line {number} holds what is not a number: {cell[:80]!r}") from problem
        raise ValueError(f"{source}: after line {at}: {problem}") from problem
    return np.asarray(found.to_numpy().reshape(-1))
