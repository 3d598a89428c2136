"""Samples of formats that cannot be read in pieces, kept in an unnamed file on disk rather than in memory."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

Samples = Callable[[int, int], NDArray[Any]]


def spooled(pieces: Iterable[NDArray[Any]], size: int, dtype: Any) -> NDArray[Any]:
    """An array on disk, filled piece by piece; it takes no memory that the system cannot have back."""
    with tempfile.TemporaryFile() as file:  # deleted when the last map of it is gone
        whole: NDArray[Any] = np.memmap(file, dtype=dtype, mode="w+", shape=(max(size, 1),))
    begin = 0
    for piece in pieces:
        whole[begin : begin + piece.size] = piece
        begin += piece.size
    return whole[:begin]


def once(load: Callable[[], NDArray[Any]]) -> Samples:
    """Reader of pieces of an array that is loaded when the first piece is asked for."""
    held: list[NDArray[Any]] = []

    def read(start: int, stop: int) -> NDArray[Any]:
        if not held:
            held.append(load())
        return np.asarray(held[0][start:stop])

    return read
