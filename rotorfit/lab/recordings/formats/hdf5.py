"""HDF5 recordings: a dataset a channel, wherever in the file; attributes of the file and of its channels.

A dataset may say ``volts_per_count`` and ``offset_V``, its ``unit``, its rate (``sample_rate_hz``, ``fs``) or step
(``dt``, ``wf_increment``); a dataset ``time`` gives it too. A group of one dataset a channel is what most loggers
write; of a matrix each column is one, called as a list of as many names beside it or among its attributes says, and of
a table each field. Single numbers and texts beside signals are attributes too.
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
    lists: dict[str, list[list[str]]] = {}  # of names, by group
    single: dict[str, Any] = {}

    def look_at_words(name: str, item: Any) -> None:
        if isinstance(item, h5py.Dataset) and item.size == 1:
            single[name.rpartition("/")[2]] = item[()]
        elif isinstance(item, h5py.Dataset) and item.ndim == 1 and item.dtype.kind in "SO":
            lists.setdefault(name.rpartition("/")[0], []).append(_words(item[()]))

    def times(name: str, values: Any, factor: float) -> None:
        rates.append(rate_of_times(np.asarray(values, dtype=float) * factor, f"{path.name}, {name}"))

    def visit(name: str, item: Any) -> None:
        group, _, base = name.rpartition("/")
        if isinstance(item, h5py.Dataset) and item.dtype.names and item.ndim == 1 and item.size >= FEWEST:
            for field in [one for one in item.dtype.names if item.dtype[one].kind in "iuf"]:
                if (factor := time_factor(field)) is not None:
                    times(f"{name}.{field}", item[field], factor)
                else:
                    found.extend((group, one) for one in RawArray.in_hdf5(path, item, field).channels([field]))
        if not (isinstance(item, h5py.Dataset) and item.dtype.kind in "iuf"):
            return
        array, factor = RawArray.in_hdf5(path, item), time_factor(base)
        if factor is not None and item.ndim == 1 and item.size >= FEWEST:
            times(name, item, factor)
        elif array.size >= FEWEST and item.ndim <= 2:
            said = plain(item.attrs)
            scale = said.get("volts_per_count")
            own = [_words(value) for value in item.attrs.values() if isinstance(value, np.ndarray)]
            names = [each for each in (*own, *lists.get(group, ())) if len(set(each)) == len(each) == array.count > 1]
            numbered = [base] if item.ndim == 1 else [f"{base}_{i + 1}" for i in range(array.count)]
            channels = array.channels(
                names[0] if names and item.ndim == 2 else numbered,
                volts_per_count=float(scale) if isinstance(scale, int | float) else None,
                offset=float(said.get("offset_V", 0.0)),
                sample_rate=rate_of(said),
                unit=unit_said(said),
            )
            found.extend((group, channel) for channel in channels)

    check_hdf5(path)
    with h5py.File(path, "r") as file:
        file.visititems(look_at_words)
        attributes = {**plain(single), **plain(file.attrs)}
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


def _words(values: Any) -> list[str]:
    """An array of texts, none of them empty; nothing for any other."""
    listed = [one.decode("utf-8", "replace") if isinstance(one, bytes) else one for one in np.ravel(values).tolist()]
    names = [one.strip() for one in listed if isinstance(one, str)]
    return names if len(names) == len(listed) and all(names) else []
