"""Recordings as text: a header, a column a channel in volts, and a column of times or ``# sample_rate_hz = 6400``.

Comment lines ``# name = value`` before the header are attributes of the recording. Text is slow and large; it is gone
through once and kept on disk in binary.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from io import TextIOBase
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rotorfit.base.file_reading import check_unpacked
from rotorfit.lab.io.sampling import is_stamp, rate_of, rate_of_times, seconds_of, time_factor
from rotorfit.lab.io.tables.cells import check_columns, encoding_of
from rotorfit.lab.recordings.formats import labview
from rotorfit.lab.recordings.formats.raw_file import RawArray, RawChannel, RawFile, number_or_text, spooled

_ROWS = 1 << 17
"""Rows turned into numbers at once."""


@dataclass(frozen=True, kw_only=True)
class _Head:
    attributes: dict[str, float | str]
    names: tuple[str, ...]
    units: tuple[str, ...]  # of a row below the names; empty where there is none
    delimiter: str | None
    comma: bool  # whether numbers have a decimal comma
    trailing: bool  # whether every row ends with a delimiter
    lines: int  # before the first row of numbers
    stamps: tuple[int, ...]  # columns of times of day, with or without a date


@dataclass(frozen=True, kw_only=True)
class _Line:
    """A line above or among the numbers."""

    number: int  # in the file, from zero
    text: str
    delimiter: str | None
    cells: tuple[str, ...]

    @property
    def numeric(self) -> tuple[bool, ...]:
        """Which of its cells that are not empty are numbers, or times of day."""
        comma = self.delimiter != "," and "," in self.text
        return tuple(
            isinstance(number_or_text(c.replace(",", ".") if comma else c), float) or is_stamp(c)
            for c in self.cells
            if c
        )


def open_file(path: Path) -> RawFile:
    """Content of a text file of raw signals; LabVIEW's own may have another suffix."""
    encoding = encoding_of(path)
    with path.open(encoding=encoding) as file:
        if file.readline(len(labview.FIRST_LINE) + 2).lstrip("\ufeff").startswith(labview.FIRST_LINE):
            return labview.open_file(path)
    head = _head(path, encoding)
    with path.open("rb") as binary:
        lines = sum(block.count(b"\n") for block in iter(lambda: binary.read(1 << 24), b"")) + 1
    width = len(head.names)
    check_unpacked(path.name, 8.0 * lines * width, path.stat().st_size)
    with path.open(encoding=encoding) as file:  # all cells go to the disk
        columns = spooled(_rows(path, file, head), lines * width, np.float64).reshape(-1, width)
    rate = rate_of(head.attributes)
    channels: dict[str, RawChannel] = {}
    for name, unit, values in zip(head.names, head.units, columns.T if columns.size else (), strict=False):
        factor = 1.0 if head.names.index(name) in head.stamps else time_factor(name)
        if factor is not None:
            rate = rate_of_times(np.asarray(values) * factor, f"{path.name}, column {name}")
        else:
            channels |= {channel.name: channel for channel in RawArray.of(values).channels([name], unit=unit)}
    return RawFile(name=path.name, channels=channels, attributes=head.attributes, sample_rate=rate)


def _head(path: Path, encoding: str) -> _Head:
    """Lines above the numbers: attributes, notes of the instrument, names, perhaps a row of units."""
    attributes, lines = _first_lines(path, encoding)
    first = _first_numbers(path, lines)
    numbers, above = lines[first:], lines[:first]
    width = len(numbers[0].cells)
    trailing = width > 1 and all(not line.cells[-1] for line in numbers)
    width -= trailing
    for line in above:
        # the sampling rate, where an instrument says it in a line of its heading: ``Sample rate;3200 Hz``
        name, value = line.cells[:2] if len([cell for cell in line.cells if cell]) == 2 else ("", "")
        match = re.fullmatch(r"([0-9.eE+]+) *(k?)(?:Hz|S/s|Sa/s)?", value)
        number = number_or_text(match[1]) if match and rate_of({name: 1.0}) is not None else ""
        if match and isinstance(number, float):
            attributes[name] = number * (1e3 if match[2] else 1.0)
    fitting = [line.cells[:width] for line in above if len(line.cells) in (width, width + trailing)]
    names = next((cells for cells in fitting if "" not in cells and len(set(cells)) == width), None)
    below = fitting[fitting.index(names) + 1 :] if names in fitting else []
    if names is None and above:
        raise ValueError(
            f"{path.name}: every column needs a name of its own: line {numbers[0].number + 1} has {width} numbers, and "
            f"above it stands {above[-1].text[:120]}"
        )
    return _Head(
        attributes=attributes,
        names=names or tuple(f"channel_{i + 1}" for i in range(width)),
        units=next((tuple(cell.strip("[]() ") for cell in cells) for cells in below), ("",) * width),
        delimiter=numbers[0].delimiter,
        comma=numbers[0].delimiter != "," and any("," in line.text for line in numbers),
        trailing=trailing,
        lines=numbers[0].number,
        stamps=tuple(i for i, cell in enumerate(numbers[0].cells[:width]) if is_stamp(cell)),
    )


def _first_lines(path: Path, encoding: str) -> tuple[dict[str, float | str], list[_Line]]:
    """Attributes in comments, and the first lines that are neither comments nor empty."""
    attributes: dict[str, float | str] = {}
    lines: list[_Line] = []
    fixed: str | None = None
    looked_at = 400  # lines in which the first row of numbers is looked for
    with path.open(encoding=encoding) as file:
        for number, line in enumerate(islice(file, looked_at)):
            text = line.strip(" \r\n\ufeff")
            check_columns(path.name, 1 + max(map(text.count, ",;\t")))
            if text.startswith("#"):
                key, equals, value = (part.strip() for part in text.lstrip("# ").partition("="))
                if equals and key.replace("_", "").isalnum():
                    attributes[key] = number_or_text(value)
            elif re.fullmatch(r"sep=.", text):  # written by Excel
                fixed = text[4]
            elif text.strip():
                delimiter = fixed or next((mark for mark in (";", "\t", ",") if mark in text), None)
                cells = tuple(cell.strip().strip('"') for cell in text.split(delimiter))
                lines.append(_Line(number=number, text=text.strip(), delimiter=delimiter, cells=cells))
    return attributes, lines


def _first_numbers(path: Path, lines: list[_Line]) -> int:
    """Place of the first of some rows of numbers of the same length."""
    if not lines:
        raise ValueError(f"{path.name} is empty")
    for first in range(len(lines)):
        in_a_row = 3  # rows of numbers of the same length that are data, not part of a heading
        rows = lines[first : first + in_a_row]
        alike = len({len(row.cells) for row in rows}) == 1
        if alike and all(row.numeric and all(row.numeric) for row in rows):
            return first
    mixed = [line for line in lines if any(line.numeric) and len(line.cells) == len(lines[-1].cells) > 1]
    header = {cell.strip().lower() for cell in lines[0].cells}
    if {"plane", "direction"} <= header or {"force_plane", "speed_rpm"} <= header:
        raise ValueError(
            f"{path.name} is a table of vectors, not of raw signals: rf.read, `rotorfit info` "
            "and `rotorfit fit` read it"
        )
    if mixed:
        raise ValueError(f"{path.name}: line {mixed[0].number + 1} holds what is not a number: {mixed[0].text[:80]}")
    raise ValueError(f"{path.name} holds no signals: there are no numbers in columns in it")


def _rows(path: Path, file: TextIOBase, head: _Head) -> Iterator[NDArray[Any]]:
    begin = head.lines
    converters: dict[int | str, Any] = dict.fromkeys(head.stamps, seconds_of)
    for _ in range(begin):
        file.readline()
    while lines := list(islice(file, _ROWS)):
        if head.comma:
            lines = [line.replace(",", ".") for line in lines]
        try:
            with warnings.catch_warnings():
                warnings.filterwarnings("ignore", message=".*input contained no data", category=UserWarning)
                kept = range(len(head.names)) if head.trailing else None
                rows = np.loadtxt(
                    lines,
                    delimiter=head.delimiter,
                    ndmin=2,
                    comments="#",
                    usecols=kept,
                    converters=converters or None,
                    quotechar='"',
                )
        except ValueError as problem:
            raise ValueError(f"{path.name}: after line {begin}: {str(problem).split('; use')[0]}") from problem
        if rows.size and rows.shape[1] != len(head.names):
            raise ValueError(f"{path.name}: rows of {rows.shape[1]} cells under a header of {len(head.names)} columns")
        begin += len(lines)
        yield rows.reshape(-1)
