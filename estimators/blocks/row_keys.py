"""Rows of a table distinguished by the numbers in their columns."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from rotorfit.base.array_types import Index


def numbers(column: NDArray[Any]) -> Index:
    """Number of each entry among the distinct ones: of numbers in ascending order, of others in the order of the rows.
    Equal entries that follow one another in long stretches, as names of runs do, are compared with their neighbours
    only."""
    heads, lengths = _stretches(column)
    return _spread(_first_places(heads)[1] if column.dtype.kind in "UO" else _ranks(heads), lengths)


def words(column: NDArray[Any]) -> tuple[list[Any], Index]:
    """Distinct entries in the order of the rows, and the number of each row's entry among them."""
    if column.dtype.kind not in "UO":
        first, number = in_order(numbers(column))
        return column[first].tolist(), number
    heads, lengths = _stretches(column)
    names, number = _first_places(heads)
    return names, _spread(number, lengths)


def _stretches(column: NDArray[Any]) -> tuple[NDArray[Any], Index | None]:
    """First entries of the stretches of equal ones, and how long these are; the column itself where most are short."""
    if column.size and column.strides[0] == 0:  # one entry, shown in every row
        return column[:1], np.array([column.size])
    if column.dtype.kind == "O":  # tuples, which NumPy would compare as arrays
        return column, None
    changes = np.flatnonzero(column[1:] != column[:-1])  # rows that the next one differs from
    if 2 * changes.size + 2 > column.size:
        return column, None
    edges = np.concatenate([[0], changes + 1, [column.size]])
    return column[edges[:-1]], edges[1:] - edges[:-1]


def _spread(number: Index, lengths: Index | None) -> Index:
    """Numbers of stretches, for each of their rows."""
    if lengths is None:
        return number
    return np.zeros(int(lengths[0]), dtype=np.intp) if number.size == 1 else np.repeat(number, lengths)


def _first_places(column: NDArray[Any]) -> tuple[list[Any], Index]:
    """Distinct words or records in the order of the rows, and the number of each row's."""
    if column.dtype.kind == "U" and column.size > 1000:
        names, number = _few(column)
        if names:
            return names, number
    place: dict[Any, int] = {}
    number = np.array([place.setdefault(word, len(place)) for word in column.tolist()], dtype=np.intp)
    return list(place), number


def _few(column: NDArray[Any]) -> tuple[list[Any], Index]:
    """The same of many rows with up to eight words, as of planes and directions; none of more words."""
    names: list[Any] = []
    number, left = np.zeros(column.size, dtype=np.intp), np.ones(column.size, dtype=bool)
    while left[at := int(left.argmax())]:
        if len(names) == 8:
            return [], number
        same = column == column[at]
        number[same] = len(names)
        names.append(column[at].item())
        left &= ~same
    return names, number


def _ranks(column: NDArray[Any]) -> Index:
    """Rank of each number among the distinct ones, NaN being one and the last."""
    return np.asarray(np.unique(column, return_inverse=True)[1].reshape(-1), dtype=np.intp)


def distinguished(*columns: NDArray[Any]) -> tuple[Index, Index]:
    """First row of each distinct combination of entries, in the order of the rows, and the number of each row's."""
    return in_order(combined(*map(numbers, columns)))


def in_order(keys: Index) -> tuple[Index, Index]:
    """First occurrence of each distinct key, in the order of the rows, and the number of each row's key among them."""
    if not keys.size:
        return keys, keys
    most = int(keys.max())
    if most == 0:
        return np.zeros(1, dtype=np.intp), np.zeros(keys.size, dtype=np.intp)
    keys_a_row = 4  # keys up to this many times the rows are counted instead of sorted
    if most >= keys_a_row * keys.size:
        keys = _ranks(keys)
        most = int(keys.max())
    first = np.full(most + 1, keys.size, dtype=np.intp)
    first[keys[::-1]] = np.arange(keys.size - 1, -1, -1)  # the first one is written last
    rank = np.empty(most + 1, dtype=np.intp)
    rank[np.argsort(first, kind="stable")] = np.arange(most + 1)
    return np.sort(first[first < keys.size]), rank[keys]


def rows_by(key: Index, *within: NDArray[Any]) -> list[Index]:
    """Rows of each distinct key, ascending, in the order of other columns, the last of which counts most."""
    order = np.lexsort([*within, key])
    return np.split(order, np.flatnonzero(np.diff(key[order])) + 1) if order.size else []


def occurrence(key: Index) -> Index:
    """How often each row's key came before."""
    order = np.argsort(key, kind="stable")
    first = np.flatnonzero(np.diff(key[order], prepend=-1))
    found = np.empty(key.size, dtype=np.intp)
    found[order] = np.arange(key.size) - np.repeat(first, np.diff(np.append(first, key.size)))
    return found


def combined(*columns: Index) -> Index:
    """One number for each row that is equal where all columns are."""
    key, most = columns[0], int(np.iinfo(np.intp).max) // 2
    for column in columns[1:]:
        width = int(column.max(initial=0)) + 1
        if int(key.max(initial=0)) >= most // width:  # too many digits: number what there is so far
            key = _ranks(key)
        key = key * width + column
    return key
