"""Rows of a test that belong together: by label, or by equality."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rotorfit.models.array_types import ComplexArray, Index


def numbered_labels(names: list[str]) -> tuple[Index, tuple[str, ...]]:
    """Number of each row's label, and the distinct labels."""
    labels = tuple(dict.fromkeys(names))
    number = {name: i for i, name in enumerate(labels)}
    return np.array([number[name] for name in names], dtype=np.intp), labels


def same_rows(*columns: NDArray[np.generic]) -> Index:
    """Number rows by equality in all columns."""
    codes = np.column_stack([np.unique(column, return_inverse=True)[1].reshape(-1) for column in columns])
    return np.unique(codes, axis=0, return_inverse=True)[1].reshape(-1).astype(np.intp)


def spread_of_repeats(values: ComplexArray, same: Index) -> float | None:
    """Standard deviation of each part from values measured several times, None where none was."""
    free, total = 0, 0.0
    for key in np.unique(same):
        part = values[same == key]
        free += part.size - 1
        total += float(np.sum(np.abs(part - part.mean()) ** 2))
    return float(np.sqrt(total / (2 * free))) if free and total > 0 else None
