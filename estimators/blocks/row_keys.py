"""Rows of a table told apart by the numbers in their columns."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from rotorfit.models.array_types import Index


def unique_rows(codes: NDArray[Any]) -> tuple[Index, Index]:
    """First occurrence of each distinct row, in sorted order, and the number of each row among them."""
    if codes.dtype.kind == "i" and codes.size:
        width = codes.max(axis=0) + 1
        if np.prod(width, dtype=float) < np.iinfo(np.intp).max:  # numbers in one column sort ten times faster
            codes = np.ravel_multi_index(tuple(codes.T), tuple(width))
    _, first, number = np.unique(codes, axis=0, return_index=True, return_inverse=True)
    return first, number.reshape(-1)


_SPARSE = 4
"""Keys up to this many times the rows are counted instead of sorted."""


def numbers(column: NDArray[Any]) -> Index:
    """Number of each entry among the distinct ones, which follow no order; equal entries that follow one another in
    long stretches, as names of runs do, are compared with their neighbours only.

    Args:
        column: numbers, none of them NaN, or text.
    """
    if not column.size:
        return np.zeros(0, dtype=np.intp)
    begins = np.flatnonzero(np.concatenate([[True], column[1:] != column[:-1]]))
    if begins.size == 1:
        return np.zeros(column.size, dtype=np.intp)
    if 2 * begins.size > column.size:
        return _distinct(column)
    return np.repeat(_distinct(column[begins]), np.diff(begins, append=column.size))


def _distinct(column: NDArray[Any]) -> Index:
    if column.dtype.kind != "U":
        return np.unique(column, return_inverse=True)[1].reshape(-1)
    place: dict[str, int] = {}
    return np.array([place.setdefault(word, len(place)) for word in column.tolist()], dtype=np.intp)


def in_order(keys: Index) -> tuple[Index, Index]:
    """First occurrence of each distinct key, in the order of the rows, and the number of each row's key among them.

    Args:
        keys: a number for each row.
    """
    if not keys.size:
        return keys, keys
    most = int(keys.max())
    if most >= _SPARSE * keys.size:
        _, keys = np.unique(keys, return_inverse=True)
        keys = keys.reshape(-1)
        most = int(keys.max())
    first = np.full(most + 1, keys.size, dtype=np.intp)
    first[keys[::-1]] = np.arange(keys.size - 1, -1, -1)  # the first one is written last
    rank = np.empty(most + 1, dtype=np.intp)
    rank[np.argsort(first, kind="stable")] = np.arange(most + 1)
    return np.sort(first[first < keys.size]), rank[keys]


def combined(*columns: Index) -> Index:
    """One number for each row that is equal where all columns are.

    Args:
        columns: numbers of each row, from zero on.
    """
    key: Index = np.zeros(columns[0].shape, dtype=np.intp)
    width = 1
    for column in columns:
        own = int(column.max(initial=0)) + 1
        if width * own >= np.iinfo(np.intp).max // 2:  # too many digits: number what there is so far
            key = np.unique(key, return_inverse=True)[1].reshape(-1)
            width = int(key.max(initial=0)) + 1
        if own > 1:
            key = key * own + column
            width *= own
    return key
