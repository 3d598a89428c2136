"""HDF5 recordings: a dataset a channel, wherever in the file; attributes of the file and of its channels.

A dataset may say ``volts_per_count`` and ``offset_V``, its ``unit``, its rate (``sample_rate_hz``, ``fs``) or step
(``dt``, ``wf_increment``); a dataset ``time`` gives it too. A group of one dataset a channel is what most loggers
write; of a matrix each column is one.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from rotorfit.estimators.file_limits import check_hdf5
from rotorfit.io.sampling import FEWEST, rate_of, rate_of_times, time_factor
from rotorfit.recordings.formats.raw_file import RawChannel, RawFile, full_count, plain, unit_said


def open_file(path: Path) -> RawFile:
    """Content of an HDF5 file; its samples are read later, piece by piece."""
    found: list[tuple[str, RawChannel]] = []
    rates: list[float] = []

    def visit(name: str, item: Any) -> None:
        if not (isinstance(item, h5py.Dataset) and item.dtype.kind in "iuf"):
            return
        factor = time_factor(name.rpartition("/")[2])
        if factor is not None and item.ndim == 1 and item.size >= FEWEST:
            rates.append(rate_of_times(np.asarray(item, dtype=float) * factor, f"{path.name}, {name}"))
        else:
            found.extend((name.rpartition("/")[0], channel) for channel in _channels(path, name, item))

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


def _channels(path: Path, name: str, item: h5py.Dataset) -> list[RawChannel]:
    shape = tuple(item.shape)
    long = max(shape, default=0)
    if long < FEWEST or len(shape) > 2:
        return []
    said = plain(item.attrs)
    scale = said.get("volts_per_count")
    common: dict[str, Any] = {
        "size": long,
        "volts_per_count": float(scale) if isinstance(scale, int | float) else None,
        "offset": float(said.get("offset_V", 0.0)),
        "full_count": full_count(item.dtype),
        "sample_rate": rate_of(said),
        "unit": unit_said(said),
    }
    short = min(shape) if len(shape) == 2 else 1
    base = name.rpartition("/")[2]
    if len(shape) == 1:
        return [RawChannel(name=base, samples=partial(_read, path, name, None, False), **common)]
    along = shape[0] == long
    return [
        RawChannel(name=f"{base}_{i + 1}", samples=partial(_read, path, name, i, along), **common) for i in range(short)
    ]


def _read(path: Path, name: str, column: int | None, along: bool, start: int, stop: int) -> NDArray[Any]:
    with h5py.File(path, "r") as file:
        data = file[name]
        if column is None:
            return np.asarray(data[start:stop])
        return np.asarray(data[start:stop, column] if along else data[column, start:stop])
