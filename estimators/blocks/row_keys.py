"""Rows of a table told apart by the numbers in their columns."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from rotorfit.models.array_types import Index

_MOST = int(np.iinfo(np.intp).max) // 2
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
    bounds = _changes(column) + 1  # where another stretch begins
    if not bounds.size:
        return np.zeros(column.size, dtype=np.intp)
    if 2 * bounds.size + 2 > column.size:
        return _distinct(column)
    edges = np.concatenate([[0], bounds, [column.size]])
    return np.repeat(_distinct(column[edges[:-1]]), edges[1:] - edges[:-1])


def _changes(column: NDArray[Any]) -> Index:
    """Rows that the next one differs from."""
    if column.dtype.kind != "U" or not column.flags.c_contiguous:
        return np.flatnonzero(column[1:] != column[:-1])
    letters, width = column.view(np.uint32), column.dtype.itemsize // 4  # as numbers they compare three times faster
    differs = np.zeros(column.size, dtype=bool)
    differs[np.flatnonzero(letters[width:] != letters[:-width]) // width] = True
    return np.flatnonzero(differs)


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
    if most == 0:
        return np.zeros(1, dtype=np.intp), np.zeros(keys.size, dtype=np.intp)
    if most >= _SPARSE * keys.size:
        _, keys = np.unique(keys, return_inverse=True)
        keys = keys.reshape(-1)
        most = int(keys.max())
    first = np.full(most + 1, keys.size, dtype=np.intp)
    first[keys[::-1]] = np.arange(keys.size - 1, -1, -1)  # the first one is written last
    rank = np.empty(most + 1, dtype=np.intp)
    rank[np.argsort(first, kind="stable")] = np.arange(most + 1)
    return np.sort(first[first < keys.size]), rank[keys]


def words(column: NDArray[Any]) -> tuple[list[Any], Index]:
    """Distinct entries in the order of the rows, and the number of each row's entry among them.

    Args:
        column: text, or numbers, none of them NaN.
    """
    first, number = in_order(numbers(column))
    return column[first].tolist(), number


def combined(*columns: Index) -> Index:
    """One number for each row that is equal where all columns are.

    Args:
        columns: numbers of each row, from zero on.
    """
    key: Index = np.zeros(columns[0].shape, dtype=np.intp)
    width = 1
    for column in columns:
        own = int(column.max()) + 1 if column.size else 1
        if width * own >= _MOST:  # too many digits: number what there is so far
            key = np.unique(key, return_inverse=True)[1].reshape(-1)
            width = int(key.max(initial=0)) + 1
        if own > 1:
            key = key * own + column
            width *= own
    return key
