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
