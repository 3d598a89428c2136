"""Samples of formats that cannot be read in pieces, kept in an unnamed file on disk rather than in memory."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Iterable
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

Samples = Callable[[int, int], NDArray[Any]]


def spooled(pieces: Iterable[NDArray[Any]], size: int, dtype: Any) -> NDArray[Any]:
    """An array on disk, filled piece by piece; it takes no memory that the system cannot have back."""
    length = max(size, 1) * np.dtype(dtype).itemsize
    with tempfile.TemporaryFile() as file:  # deleted when the last map of it is gone
        try:
            _allocate(file, length)
        except OSError as problem:
            where = f"{tempfile.gettempdir()} (the folder for temporary files, TMPDIR, needs {length} bytes)"
            raise OSError(problem.errno, problem.strerror, where) from problem
        whole: NDArray[Any] = np.memmap(file, dtype=dtype, mode="r+", shape=(max(size, 1),))
    begin = 0
    for piece in pieces:
        whole[begin : begin + piece.size] = piece
        begin += piece.size
    return whole[:begin]


def _allocate(file: IO[bytes], length: int) -> None:
    """Take room on disk: writing to a map of a file that has none ends the process."""
    if hasattr(os, "posix_fallocate"):
        os.posix_fallocate(file.fileno(), 0, length)
    else:
        for begin in range(0, length, 1 << 24):
            file.write(bytes(min(1 << 24, length - begin)))
        file.flush()


def once(load: Callable[[], NDArray[Any]]) -> Samples:
    """Reader of pieces of an array that is loaded when the first piece is asked for."""
    held: list[NDArray[Any]] = []

    def read(start: int, stop: int) -> NDArray[Any]:
        if not held:
            held.append(load())
        return np.asarray(held[0][start:stop])

    return read
