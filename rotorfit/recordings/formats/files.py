"""Open a recording in whatever format; the suffix of the file tells it."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

from rotorfit.estimators.atomic_file import note_input
from rotorfit.models.parameters import unknown_name
from rotorfit.recordings.formats.raw_file import RawFile

FORMATS = {
    ".h5": "hdf5",
    ".hdf5": "hdf5",
    ".hdf": "hdf5",
    ".tdms": "tdms",
    ".mat": "matlab",
    ".wav": "wav",
    ".uff": "universal",
    ".unv": "universal",
    ".uf58": "universal",
    ".csv": "text",
    ".txt": "text",
    ".tsv": "text",
    ".parquet": "parquet",
}
"""Module by suffix."""

ALWAYS_RAW = (".h5", ".hdf5", ".hdf", ".tdms", ".wav", ".parquet")
"""Suffixes of files that hold raw signals whether a setup is given or not."""


def open_raw(path: str | Path) -> RawFile:
    """What a file of raw signals holds; samples are read later."""
    file = Path(path)
    suffix = file.suffix.lower()
    if suffix not in FORMATS:
        raise ValueError(f"{file.name}: {unknown_name('suffix of a recording', suffix, FORMATS)}")
    if not file.is_file():
        raise FileNotFoundError(2, "there is no such file", str(file))
    note_input(file)
    raw: RawFile = import_module(f"rotorfit.recordings.formats.{FORMATS[suffix]}").open_file(file)
    if not raw.channels:
        raise ValueError(f"{file.name} holds no signals: no channel with enough samples to be a recording")
    return raw
