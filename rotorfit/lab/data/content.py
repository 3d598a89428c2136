"""Identity of tests: a hash of readings as they are meant, not of bytes."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rotorfit.base.array_types import Index
from rotorfit.estimators.blocks.row_keys import words
from rotorfit.lab.data.rows import Experiment

_MISSING = np.iinfo(np.int64).min
"""Stands for a value that is not known."""


def content_hash(experiments: Iterable[Experiment]) -> str:
    """Hash of tests by kind, columns and attributes in SI units, whatever file, format, unit and order they came in."""
    return hashlib.sha256("".join(sorted(map(_hash, experiments))).encode("utf-8")).hexdigest()


def _hash(experiment: Experiment) -> str:
    columns = {f.name: getattr(experiment, f.name) for f in fields(experiment)}
    arrays = {name: value for name, value in columns.items() if isinstance(value, np.ndarray)}
    arrays |= {f"attribute {name}": value for name, value in experiment.attributes.items()}
    names: list[str] = [type(experiment).__name__, f"{experiment.speed_tolerance:.9g}"]
    numbers: list[Index] = []
    for name in sorted(arrays):
        for part in _numbered(np.asarray(arrays[name])):
            names += [name, *part[1]]
            numbers.append(part[0])
    table = np.column_stack(numbers) if numbers else np.zeros((0, 0), dtype=np.int64)
    table = table[np.lexsort(table.T[::-1])] if table.size else table
    digest = hashlib.sha256(json.dumps(names).encode("utf-8"))
    digest.update(np.ascontiguousarray(table, dtype="<i8").tobytes())
    return digest.hexdigest()


def _numbered(values: NDArray[Any]) -> list[tuple[Index, list[str]]]:
    """A column as whole numbers, with the words that they stand for."""
    if values.dtype.kind in "cfiub":
        numbers = values if values.dtype.kind == "c" else values.astype(float)
        size = float(np.abs(numbers[np.isfinite(numbers)]).max(initial=0.0))
        parts = (numbers.real, numbers.imag) if values.dtype.kind == "c" else (numbers,)
        return [(_steps(part, size), []) for part in parts]
    if not values.size:
        return [(np.zeros(0, dtype=np.int64), [])]
    entries, entry = words(values)
    texts = entries if values.dtype.kind == "U" else [json.dumps(_rounded(record)) for record in entries]
    distinct, number = np.unique(np.array(texts, dtype=str), return_inverse=True)
    return [(np.asarray(number[entry], dtype=np.int64), distinct.tolist())]


def _steps(values: NDArray[np.floating[Any]], size: float) -> Index:
    # Parts of a column's largest value by which its values are the same: far below any reading's error, far above what
    # conversion of units and file formats rounds
    parts = 2.0**30
    # The power of two that begins above 1.2345 of the largest value: round numbers do not lie where it changes.
    step = 2.0 ** np.ceil(np.log2(1.2345 * size)) / parts if size else 1.0
    known = np.isfinite(values)
    whole = np.round(np.where(known, values, 0.0) / step).astype(np.int64)
    return np.asarray(np.where(known, whole, _MISSING))


def _rounded(value: Any) -> Any:
    """A record of a row, numbers with nine digits."""
    if isinstance(value, complex | float):
        return f"{value:.9g}"
    return [_rounded(item) for item in value] if isinstance(value, list | tuple) else str(value)
