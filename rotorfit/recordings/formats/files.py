"""Open a recording in whatever format; the suffix of the file tells it."""

from __future__ import annotations

from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rotorfit.estimators.atomic_file import note_input
from rotorfit.estimators.file_limits import check_unpacked
from rotorfit.estimators.file_reading import reading, shown
from rotorfit.models.parameters import unknown_name
from rotorfit.recordings.formats.raw_file import RawChannel, RawFile

FORMATS = {
    ".h5": "hdf5",
    ".hdf5": "hdf5",
    ".hdf": "hdf5",
    ".tdms": "tdms",
    ".mat": "matlab",
    ".npz": "npz",
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
KINDS = {
    "hdf5": "HDF5 file",
    "tdms": "TDMS file",
    "matlab": "MAT file",
    "npz": "npz file",
    "wav": "WAV file",
    "universal": "universal file",
    "text": "text file",
    "parquet": "Parquet file",
}
"""Names of the formats in messages, by module."""
FASTEST = 1e9
"""Sampling rate, Hz, above which it is no rate: vibration is sampled at some 1e5 Hz at most."""

ALWAYS_RAW = (".h5", ".hdf5", ".hdf", ".tdms", ".wav", ".parquet", ".npz")
"""Suffixes of files that hold raw signals whether a setup is given or not."""


def open_raw(path: str | Path) -> RawFile:
    """Content of a file of raw signals; samples are read later."""
    file = Path(path)
    suffix = file.suffix.lower()
    if suffix not in FORMATS:
        raise ValueError(f"{file.name}: {unknown_name('suffix of a recording', suffix, FORMATS)}")
    if not file.exists():
        raise FileNotFoundError(2, "there is no such file", str(file))
    note_input(file)
    file.open("rb").close()  # a folder is reported by its own exception
    kind = FORMATS[suffix]
    with reading(file.name, KINDS[kind]):
        raw: RawFile = import_module(f"rotorfit.recordings.formats.{kind}").open_file(file)
    raw = _with_shown_names(raw)
    if not raw.channels:
        raise ValueError(f"{file.name} holds no signals: no channel with enough samples to be a recording")
    check_unpacked(file.name, 8.0 * sum(channel.size for channel in raw.channels.values()), file.stat().st_size)
    for channel in raw.channels.values():
        for said in (raw.sample_rate, channel.sample_rate):
            if said is not None and not 0 < said <= FASTEST:
                raise ValueError(
                    f"{file.name}: {channel.name} has a sampling rate of {said:.6g} Hz; allowed is {FASTEST:g}"
                )
        if not (np.isfinite(channel.offset) and np.isfinite(channel.volts_per_count or 1.0)):
            raise ValueError(f"{file.name}: the scale of {channel.name} is not a finite number")
    return replace(raw, channels={name: _guarded(file.name, KINDS[kind], c) for name, c in raw.channels.items()})


def _with_shown_names(raw: RawFile) -> RawFile:
    """A file whose channels and attributes have names that can be shown."""
    channels = {shown(name): replace(channel, name=shown(channel.name)) for name, channel in raw.channels.items()}
    said = {shown(name): shown(value) if isinstance(value, str) else value for name, value in raw.attributes.items()}
    return replace(raw, channels=channels, attributes=said)


def _guarded(source: str, kind: str, channel: RawChannel) -> RawChannel:
    """A channel whose samples name the file where they cannot be read."""

    def samples(start: int, stop: int) -> NDArray[Any]:
        with reading(f"{source}, {channel.name}", kind):
            return channel.samples(start, stop)

    return replace(channel, samples=samples)
