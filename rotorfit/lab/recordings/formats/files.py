"""Open a recording in whatever format; the suffix of the file tells it."""

from __future__ import annotations

from dataclasses import replace
from importlib import import_module
from pathlib import Path

import numpy as np

from rotorfit.base.atomic_file import note_input
from rotorfit.base.file_reading import check_unpacked, reading, shown
from rotorfit.lab.io.other_formats import unread_suffix
from rotorfit.lab.recordings.formats.raw_file import RawFile

KINDS = {
    "hdf5": ("HDF5 file", (".h5", ".hdf5", ".hdf")),
    "tdms": ("TDMS file", (".tdms",)),
    "matlab": ("MAT file", (".mat",)),
    "npz": ("npz file", (".npz",)),
    "wav": ("WAV file", (".wav",)),
    "universal": ("universal file", (".uff", ".unv", ".uf58")),
    "text": ("text file", (".csv", ".txt", ".tsv")),
    "labview": ("LabVIEW measurement file", (".lvm",)),
    "parquet": ("Parquet file", (".parquet",)),
}
"""Name in messages and suffixes by module of the format."""
FORMATS = {suffix: kind for kind, (_, suffixes) in KINDS.items() for suffix in suffixes}
"""Module by suffix."""
FASTEST = 1e9
"""Sampling rate, Hz, above which it is no rate: vibration is sampled at some 1e5 Hz at most."""

ALWAYS_RAW = (".h5", ".hdf5", ".hdf", ".tdms", ".wav", ".parquet", ".npz", ".lvm")
"""Suffixes of files that hold raw signals whether a setup is given or not."""


def open_raw(path: str | Path) -> RawFile:
    """Content of a file of raw signals; samples are read later."""
    file = Path(path)
    suffix = file.suffix.lower()
    if suffix not in FORMATS:
        raise ValueError(f"{file.name}: {unread_suffix('suffix of a recording', suffix, [*FORMATS])}")
    if not file.exists():
        raise FileNotFoundError(2, "there is no such file", str(file))
    note_input(file)
    file.open("rb").close()  # a folder is reported by its own exception
    module = import_module(f"rotorfit.lab.recordings.formats.{FORMATS[suffix]}")
    kind = KINDS[FORMATS[suffix]][0]
    with reading(file.name, kind):
        raw: RawFile = module.open_file(file)
    channels = {shown(name): replace(channel, name=shown(channel.name)) for name, channel in raw.channels.items()}
    if not channels:
        raise ValueError(f"{file.name} holds no signals: no channel with enough samples to be a recording")
    check_unpacked(file.name, 8.0 * sum(channel.size for channel in channels.values()), file.stat().st_size)
    for channel in channels.values():
        for rate in (raw.sample_rate, channel.sample_rate):
            if rate is not None and not 0 < rate <= FASTEST:
                whose = f"{file.name}: {channel.name} has a sampling rate of {rate:.6g} Hz"
                raise ValueError(f"{whose}; allowed is more than 0, up to {FASTEST:g} Hz")
        if not (np.isfinite(channel.offset) and np.isfinite(channel.volts_per_count or 1.0)):
            raise ValueError(f"{file.name}: the scale of {channel.name} is not a finite number")
    said = {shown(name): shown(value) if isinstance(value, str) else value for name, value in raw.attributes.items()}
    guarded = {  # samples name the file where they cannot be read
        name: replace(channel, samples=reading(f"{file.name}, {name}", kind)(channel.samples))
        for name, channel in channels.items()
    }
    return replace(raw, channels=guarded, attributes=said)
