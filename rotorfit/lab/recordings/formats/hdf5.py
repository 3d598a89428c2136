"""HDF5 recordings: a dataset a channel, wherever in the file; attributes of the file and of its channels.

A dataset may say ``volts_per_count`` and ``offset_V``, its ``unit``, its rate (``sample_rate_hz``, ``fs``) or step
(``dt``, ``wf_increment``); a dataset ``time`` gives it too. A group of one dataset a channel is what most loggers
write; of a matrix each column is one.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from rotorfit.base.file_reading import check_hdf5
from rotorfit.lab.io.sampling import FEWEST, rate_of, rate_of_times, time_factor
from rotorfit.lab.recordings.formats.raw_file import RawArray, RawChannel, RawFile, plain, unit_said


def open_file(path: Path) -> RawFile:
    """Content of an HDF5 file; its samples are read later, piece by piece."""
    found: list[tuple[str, RawChannel]] = []
    rates: list[float] = []

    def visit(name: str, item: Any) -> None:
        if not (isinstance(item, h5py.Dataset) and item.dtype.kind in "iuf"):
            return
        group, _, base = name.rpartition("/")
        array, factor = RawArray.in_hdf5(path, item), time_factor(base)
        if factor is not None and item.ndim == 1 and item.size >= FEWEST:
            rates.append(rate_of_times(np.asarray(item, dtype=float) * factor, f"{path.name}, {name}"))
        elif array.size >= FEWEST and item.ndim <= 2:
            said = plain(item.attrs)
            scale = said.get("volts_per_count")
            channels = array.channels(
                [base] if item.ndim == 1 else [f"{base}_{i + 1}" for i in range(array.count)],
                volts_per_count=float(scale) if isinstance(scale, int | float) else None,
                offset=float(said.get("offset_V", 0.0)),
                sample_rate=rate_of(said),
                unit=unit_said(said),
            )
            found.extend((group, channel) for channel in channels)

    check_hdf5(path)
    with h5py.File(path, "r") as file:
        attributes = plain(file.attrs)
        for group in file.values():
            if isinstance(group, h5py.Group):
                attributes = {**plain(group.attrs), **attributes}
        file.visititems(visit)
    names = [channel.name for _, channel in found]
    channels = {
        name: replace(channel, name=name)
        for group, channel in found  # groups may use the same names
        for name in [channel.name if names.count(channel.name) == 1 else f"{group}/{channel.name}"]
    }
    rate = rate_of(attributes) or (rates[0] if rates else None)
    return RawFile(name=path.name, channels=channels, attributes=attributes, sample_rate=rate)
