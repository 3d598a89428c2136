"""What makes two tests the same, and two settings: hashes of readings as they are meant, not of bytes."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rotorfit.data.experiments import Experiment
from rotorfit.fitting.json_values import encode
from rotorfit.models.array_types import Index
from rotorfit.options.kinds import is_set
from rotorfit.options.table import StudyOptions
from rotorfit.studies.study import Study

_STEPS = 2.0**30
"""Parts of a column's largest value by which its values are the same: far below any reading's error, far above what
conversion of units and file formats rounds."""
_PIECE = 1 << 20
"""Bytes of a file that are read at once."""
_MISSING = np.iinfo(np.int64).min
"""Stands for a value that is not known."""


def content_hash(experiments: Iterable[Experiment]) -> str:
    """Hash of tests by their kind, columns and attributes in SI units.

    Neither names of files, formats and units count, nor the order of files, rows and columns: a test that was saved
    again is the same test. A reading, condition or run that differs makes another.
    """
    return _sha256("".join(sorted(map(_hash, experiments))))


def settings_key(study: Study) -> tuple[str, str]:
    """Hash of the settings of a study, and the settings as JSON; files and folders do not count."""
    given = {f.name: _sorted(encode(getattr(study, f.name))) for f in fields(StudyOptions) if _says(study, f.name)}
    if study.structure:  # what the file holds counts, not where it is
        shaft = Path(study.structure)
        files = sorted(shaft.iterdir()) if shaft.is_dir() else [shaft]
        given["structure"] = _sha256("".join(digest_of(file)[1] for file in files if file.is_file()))
    text = json.dumps({"model": study.model, **given}, sort_keys=True, allow_nan=False)
    return _sha256(text), text


def _says(study: Study, name: str) -> bool:
    value = getattr(study, name)
    default = next(f for f in fields(StudyOptions) if f.name == name).default
    return is_set(value) and value != default


def _sorted(value: Any) -> Any:
    """JSON of which no order of keys counts."""
    if isinstance(value, Mapping):
        return {
            key: sorted(map(_sorted, item), key=json.dumps) if key == "mapping" else _sorted(item)
            for key, item in value.items()
        }
    return [_sorted(item) for item in value] if isinstance(value, list) else value


def _sha256(text: str) -> str:
    return hashlib.sha256(text.encode("utf-8")).hexdigest()


def digest_of(path: Path, length: int | None = None) -> tuple[int, str]:
    """Size and SHA-256 of a file, or of so many bytes at its beginning."""
    digest, size = hashlib.sha256(), 0
    with path.open("rb") as stream:
        while piece := stream.read(_PIECE if length is None else min(_PIECE, length - size)):
            digest.update(piece)
            size += len(piece)
    return size, digest.hexdigest()


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
    if values.dtype.kind == "c":
        size = float(np.abs(values[np.isfinite(values)]).max(initial=0.0))
        return [(_steps(values.real, size), []), (_steps(values.imag, size), [])]
    if values.dtype.kind in "fiub":
        real = values.astype(float)
        return [(_steps(real, float(np.abs(real[np.isfinite(real)]).max(initial=0.0))), [])]
    words = values.astype(str) if values.dtype.kind == "U" else np.array([_text(item) for item in values.tolist()])
    if not words.size:
        return [(np.zeros(0, dtype=np.int64), [])]
    distinct, number = np.unique(words, return_inverse=True)
    return [(np.asarray(number, dtype=np.int64), distinct.tolist())]


def _steps(values: NDArray[np.floating[Any]], size: float) -> Index:
    # The power of two that begins above 1.2345 of the largest value: round numbers do not lie where it changes.
    step = 2.0 ** np.ceil(np.log2(1.2345 * size)) / _STEPS if size else 1.0
    known = np.isfinite(values)
    whole = np.round(np.where(known, values, 0.0) / step).astype(np.int64)
    return np.asarray(np.where(known, whole, _MISSING))


def _text(item: Any) -> str:
    """A record of a row, numbers with nine digits."""
    return json.dumps(_rounded(encode(item)), sort_keys=True)


def _rounded(value: Any) -> Any:
    if isinstance(value, float):
        return f"{value:.9g}"
    if isinstance(value, list):
        return [_rounded(item) for item in value]
    return {key: _rounded(item) for key, item in value.items()} if isinstance(value, dict) else value
