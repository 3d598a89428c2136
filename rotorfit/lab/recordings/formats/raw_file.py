"""A recording as its file holds it: channels of samples that are read piece by piece, and attributes.

Samples of formats that cannot be read in pieces are kept in an unnamed file on disk rather than in memory.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Samples = Callable[[int, int], NDArray[Any]]
"""Samples of a channel from and to."""


@dataclass(frozen=True, kw_only=True, eq=False)
class RawChannel:
    """One channel of a file."""

    name: str  # as the file has it
    size: int  # samples
    samples: Samples
    volts_per_count: float | None = None  # factor to volts that the file gives; None: not given
    offset: float = 0.0  # volts at count zero
    full_count: float | None = None  # largest count the file's type can hold, for integers; None: the file holds volts
    sample_rate: float | None = None  # Hz; None: not given
    unit: str = ""  # as the file has it; empty: not given
    start: float = 0.0  # time of the first sample after that of the record, s


@dataclass(frozen=True, kw_only=True, eq=False)
class RawFile:
    """A file of raw signals."""

    name: str  # of the file, without its folder
    channels: Mapping[str, RawChannel]  # by name
    attributes: Mapping[str, float | str] = field(default_factory=dict)  # what the file says of itself
    sample_rate: float | None = None  # Hz; None: not given
    remarks: tuple[str, ...] = ()  # what was odd about the file and how it was read


def full_count(kind: np.dtype[Any]) -> float | None:
    """Largest count that an integer type holds; None for floating-point samples, which are volts."""
    return float(np.iinfo(kind).max) if kind.kind in "iu" else None


@dataclass(frozen=True, kw_only=True, eq=False)
class RawArray:
    """A numeric array of a file, not read yet: a channel, or a matrix with one in each column (row, if these are the
    longer ones)."""

    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    read: Callable[[Any], NDArray[Any]]  # the part at an index, as NumPy takes it

    @classmethod
    def of(cls, values: NDArray[Any]) -> RawArray:
        """An array in memory, or on disk."""
        return cls(shape=values.shape, dtype=values.dtype, read=values.__getitem__)

    @classmethod
    def in_hdf5(cls, path: Path, item: Any, field: str | None = None) -> RawArray:
        """A dataset of an HDF5 file, or a field of a table there, which is opened for each piece."""
        import h5py

        name = item.name

        def read(index: Any) -> NDArray[Any]:
            with h5py.File(path, "r") as file:
                piece = np.asarray(file[name][index])
                return piece if field is None else piece[field]

        return cls(shape=tuple(item.shape), dtype=item.dtype if field is None else item.dtype[field], read=read)

    @property
    def size(self) -> int:
        """Samples of a channel."""
        return max(self.shape, default=0)

    @property
    def count(self) -> int:
        """Channels."""
        return min(self.shape) if len(self.shape) == 2 else 1

    def channels(self, names: Sequence[str], **said: Any) -> Iterator[RawChannel]:
        """Its channels by their names, each with what is said of all."""
        full = full_count(self.dtype)
        for column, name in enumerate(names):
            yield RawChannel(name=name, size=self.size, samples=partial(self._piece, column), full_count=full, **said)

    def _piece(self, column: int, start: int, stop: int) -> NDArray[Any]:
        part = slice(start, stop)
        along: Any = (part, column) if self.shape[0] == self.size else (column, part)
        return np.asarray(self.read(part if len(self.shape) == 1 else along))


_UNIT_KEYS = {"unit", "units", "unitstring", "engineeringunit", "engineeringunits", "yunit", "yunits"}


def unit_said(said: Mapping[str, Any]) -> str:
    """Unit that attributes or fields give under one of its usual names; nothing without."""
    for name, value in said.items():
        if isinstance(value, str) and name.replace("_", "").replace(" ", "").lower() in _UNIT_KEYS:
            return value.strip()
    return ""


def number_or_text(text: str) -> float | str:
    """The number that a text is, else the text without its quotation marks."""
    try:
        return float(text)
    except ValueError:
        return text.strip("\"'")


def plain(values: Mapping[str, Any]) -> dict[str, float | str]:
    """Attributes as plain numbers and text; what is neither, an array for instance, is left out."""
    found: dict[str, float | str] = {}
    for name, value in values.items():
        item = value.item() if isinstance(value, np.generic | np.ndarray) and value.size == 1 else value
        if isinstance(item, bytes):
            item = item.decode("utf-8", "replace")
        if isinstance(item, str) or (isinstance(item, int | float) and np.isfinite(item)):
            found[name] = item
    return found


def spooled(pieces: Iterable[NDArray[Any]], size: int, dtype: Any) -> NDArray[Any]:
    """An array on disk, filled piece by piece; it takes no memory that the system cannot have back."""
    length = max(size, 1) * np.dtype(dtype).itemsize
    with tempfile.TemporaryFile() as file:  # deleted when the last map of it is gone
        try:
            if hasattr(os, "posix_fallocate"):  # writing to a map of a file that has no room ends the process
                os.posix_fallocate(file.fileno(), 0, length)
            else:
                for begin in range(0, length, 1 << 24):
                    file.write(bytes(min(1 << 24, length - begin)))
                file.flush()
        except OSError as problem:
            where = f"{tempfile.gettempdir()} (the folder for temporary files, TMPDIR, needs {length} bytes)"
            raise OSError(problem.errno, problem.strerror, where) from problem
        whole: NDArray[Any] = np.memmap(file, dtype=dtype, mode="r+", shape=(max(size, 1),))
    begin = 0
    for piece in pieces:
        whole[begin : begin + piece.size] = piece
        begin += piece.size
    return whole[:begin]


def once(load: Callable[[], NDArray[Any]]) -> Samples:
    """Reader of pieces of an array that is loaded when the first piece is asked for."""
    whole = cache(load)
    return lambda start, stop: np.asarray(whole()[start:stop])
