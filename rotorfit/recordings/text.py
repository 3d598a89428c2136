"""Recordings as text: a header, a column a channel in volts, and a column of times or ``# sample_rate_hz = 6400``.

Comment lines ``# name = value`` before the header are attributes of the recording. Text is slow and large; it is gone
through once and kept on disk in binary.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from io import TextIOBase
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rotorfit.io.cells import marked_encoding
from rotorfit.io.sampling import rate_of, rate_of_times, time_factor
from rotorfit.recordings.raw_file import RawChannel, RawFile
from rotorfit.recordings.spool import spooled

_ROWS = 1 << 17
"""Rows turned into numbers at once."""


@dataclass(frozen=True, kw_only=True)
class _Head:
    attributes: dict[str, float | str]
    names: tuple[str, ...]
    delimiter: str | None
    comma: bool  # whether numbers have a decimal comma
    encoding: str
    lines: int  # before the first row of numbers


def open_file(path: Path) -> RawFile:
    """What a text file of raw signals holds.

    Args:
        path: the file.

    Raises:
        ValueError: not text, rows of unequal length, cells that are not numbers, or uneven times; says where.
    """
    try:
        head = _head(path)
        columns = _columns(path, head)
    except UnicodeError as problem:
        raise ValueError(f"{path.name} is not text; save it as CSV UTF-8") from problem
    rate = rate_of(head.attributes)
    channels: dict[str, RawChannel] = {}
    for name, values in zip(head.names, columns.T if columns.size else (), strict=False):
        factor = time_factor(name)
        if factor is not None:
            rate = rate_of_times(np.asarray(values) * factor, f"{path.name}, column {name}")
        else:
            channels[name] = RawChannel(name=name, size=values.size, samples=partial(_piece, values))
    return RawFile(name=path.name, channels=channels, attributes=head.attributes, sample_rate=rate)


def _head(path: Path) -> _Head:
    """What stands above the numbers: attributes in comments, names, and perhaps a row of units."""
    attributes: dict[str, float | str] = {}
    header: list[str] = []
    delimiter: str | None = None
    encoding = _encoding(path)
    with path.open(encoding=encoding) as file:
        for number, line in enumerate(file):
            text = line.strip()
            if text.startswith("#"):
                key, equals, value = (part.strip() for part in text.lstrip("# ").partition("="))
                if equals and key.replace("_", "").isalnum():
                    attributes[key] = _plain(value)
                continue
            if re.fullmatch(r"sep=.", text):  # written by Excel
                delimiter = text[4]
                continue
            if not text:
                continue
            delimiter = delimiter or next((mark for mark in (";", "\t", ",") if mark in text), None)
            cells = [cell.strip().strip('"') for cell in text.split(delimiter)]
            comma = delimiter != "," and "," in text
            numbers = [isinstance(_plain(cell.replace(",", ".") if comma else cell), float) for cell in cells if cell]
            if numbers and all(numbers):
                names = tuple(header) or tuple(f"channel_{i + 1}" for i in range(len(cells)))
                return _Head(
                    attributes=attributes,
                    names=names,
                    delimiter=delimiter,
                    comma=comma,
                    encoding=encoding,
                    lines=number,
                )
            if header and any(numbers):
                raise ValueError(f"{path.name}: line {number + 1} holds what is not a number: {text[:80]}")
            if not header and (len(set(cells)) < len(cells) or "" in cells):
                raise ValueError(f"{path.name}: every column needs a name of its own, the header is {text[:120]}")
            header = header or cells
    if header:
        raise ValueError(f"{path.name} holds no signals: there are no numbers below its header")
    raise ValueError(f"{path.name} is empty")


def _encoding(path: Path) -> str:
    """UTF-8, UTF-16 or, as old programs save it, Windows' Western code page."""
    with path.open("rb") as file:
        begin = file.read(1 << 20)
    marked = marked_encoding(begin)
    if marked:
        return marked
    try:
        begin[: begin.rfind(b"\n") + 1].decode("utf-8")
    except UnicodeDecodeError:
        return "cp1252"
    return "utf-8"


def _plain(text: str) -> float | str:
    try:
        return float(text)
    except ValueError:
        return text.strip("\"'")


def _columns(path: Path, head: _Head) -> NDArray[Any]:
    """All cells, shape ``(rows, columns)``, on disk."""
    with path.open("rb") as binary:
        lines = sum(block.count(b"\n") for block in iter(lambda: binary.read(1 << 24), b"")) + 1
    with path.open(encoding=head.encoding) as file:
        for _ in range(head.lines):
            file.readline()
        flat = spooled(_rows(path, file, head), lines * len(head.names), np.float64)
    return flat.reshape(-1, len(head.names))


def _rows(path: Path, file: TextIOBase, head: _Head) -> Iterator[NDArray[Any]]:
    begin = head.lines
    while lines := list(islice(file, _ROWS)):
        if head.comma:
            lines = [line.replace(",", ".") for line in lines]
        try:
            with warnings.catch_warnings():
                warnings.filterwarnings("ignore", message=".*input contained no data", category=UserWarning)
                rows = np.loadtxt(lines, delimiter=head.delimiter, ndmin=2, comments="#")
        except ValueError as problem:
            raise ValueError(f"{path.name}: after line {begin}: {str(problem).split('; use')[0]}") from problem
        if rows.size and rows.shape[1] != len(head.names):
            raise ValueError(f"{path.name}: rows of {rows.shape[1]} cells under a header of {len(head.names)} columns")
        begin += len(lines)
        yield rows.reshape(-1)


def _piece(values: NDArray[Any], start: int, stop: int) -> NDArray[Any]:
    return np.array(values[start:stop])
