"""MAT recordings of versions 4 to 7.3: arrays at the top level, or structs as analysers export them.

Every real vector of enough samples is a channel; a matrix is one a column (or row). What names it and gives its rate is
looked for beside it and above: a text ``name`` (also in a ``function_record``), ``fs`` or ``increment`` (also in
``x_values``), a vector of times, a header whose name differs by ``Header`` for ``Data``.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from rotorfit.base.file_reading import check_hdf5, check_mat
from rotorfit.lab.io.matlab import refuse_bare_responses
from rotorfit.lab.io.sampling import FEWEST, rate_of, rate_of_times, time_factor
from rotorfit.lab.recordings.formats.raw_file import RawArray, RawChannel, RawFile, plain, spooled, unit_said

_NAME_KEYS = ("name", "label", "title", "channelname", "signalname", "channel", "channel_name", "signal_name")
_LIST_KEYS = ("names", "labels", "channels", "channel_names", "channelnames", "titles")
_RECORDS = ("function_record", "x_values", "y_values", "info", "header", "properties")
_EMPTY_NAMES = {"data", "values", "y_values", "y", "signal"}


def open_file(path: Path) -> RawFile:
    """Content of a MAT file."""
    with path.open("rb") as file:
        modern = b"MATLAB 7.3" in file.read(128)
    if modern:
        import h5py

        check_hdf5(path)
        with h5py.File(path, "r") as stored:
            tree = {key: _node(path, stored, item) for key, item in stored.items() if not key.startswith("#")}
    else:
        from scipy.io import loadmat, whosmat

        check_mat(path)
        names = [name for name, _, _ in whosmat(path)]  # a variable at a time
        tree = {name: held(loadmat(path, variable_names=[name], simplify_cells=True)[name]) for name in names}
    content = file_of(path.name, tree)
    signals = content.channels.values()
    if (sizes := [*_responses(tree)]) and all(size % signal.size == 0 for size in sizes for signal in signals):
        refuse_bare_responses(path)
    return content


def _responses(tree: Mapping[str, Any]) -> Iterator[int]:
    """Sizes of what is complex, which no signal is."""
    for value in tree.values():
        if isinstance(value, dict):
            yield from _responses(value)
        elif isinstance(value, np.ndarray) and value.dtype.kind == "c":
            yield value.size


def file_of(name: str, tree: Mapping[str, Any]) -> RawFile:
    """Content of a tree of structs."""
    attributes = plain({name: value for name, value in tree.items() if not isinstance(value, RawArray | dict | list)})
    channels: dict[str, RawChannel] = {}
    for channel in _channels(name, tree, "", None):
        own, number = channel.name, 2
        while own in channels:
            own, number = f"{channel.name}_{number}", number + 1
        channels[own] = replace(channel, name=own)
    return RawFile(name=name, channels=channels, attributes=attributes, sample_rate=rate_of(attributes))


def _channels(
    source: str, tree: Mapping[str, Any], above: str, rate: float | None, names: Sequence[Any] = ()
) -> Iterator[RawChannel]:
    """Channels of a struct and of the structs in it."""
    near: dict[str, Any] = {key: value for key, value in tree.items() if isinstance(value, str | int | float)}
    for key, value in tree.items():
        if key.lower() in _RECORDS and isinstance(value, dict):
            near = {**{k: v for k, v in value.items() if isinstance(v, str | int | float)}, **near}
    rate = rate_of(near) or _rate_of_time_vector(source, tree) or rate
    given = next((near[key] for key in near if key.lower() in _NAME_KEYS and isinstance(near[key], str)), "")
    names = next((v for k, v in tree.items() if k.lower() in _LIST_KEYS and isinstance(v, list)), names)
    beside_data = next((v for k, v in tree.items() if k.lower() == _RECORDS[0] and isinstance(v, dict)), {})
    names = next((v for k, v in beside_data.items() if k.lower() in _NAME_KEYS and isinstance(v, list)), names)
    for key, value in tree.items():
        if isinstance(value, RawArray) and value.size >= FEWEST and time_factor(key) is None:
            head = tree.get(re.sub(r"(?i)data$", "Header", key))
            beside = plain(head) if isinstance(head, dict) else {}
            own = next((str(v) for k, v in beside.items() if k.lower() in _NAME_KEYS), given)
            base = own or (key if key.lower() not in _EMPTY_NAMES else above or key)
            listed: list[Any] = [base] if value.count == 1 else [f"{base}_{i + 1}" for i in range(value.count)]
            if len(names) == value.count:
                both = zip(names, listed, strict=True)
                listed = [name if isinstance(name, str) and name else one for name, one in both]
            unit = unit_said(beside) or unit_said(near)
            yield from value.channels(listed, sample_rate=rate_of(beside) or rate, unit=unit)
        elif isinstance(value, dict) and not (key == "X" and "Y" in tree):  # dSPACE: X holds the times of all Y
            record = key.lower() in _RECORDS
            yield from _channels(source, value, (given or above) if record else key, rate, names if record else ())
        elif isinstance(value, list):
            for part in value:
                if isinstance(part, dict):
                    yield from _channels(source, part, key, rate)


def _rate_of_time_vector(source: str, tree: Mapping[str, Any]) -> float | None:
    for key, value in tree.items():
        times = value
        if isinstance(value, dict):
            times = value.get("Data") if key == "X" else None
        if isinstance(times, RawArray) and times.size >= FEWEST and times.count == 1:
            factor = 1.0 if isinstance(value, dict) else time_factor(key)
            if factor is not None:
                whole = np.asarray(times.read(()), dtype=float).reshape(-1)
                return rate_of_times(whole * factor, f"{source}, {key}")
    return None


def held(value: Any) -> Any:
    """A value of SciPy or NumPy with its arrays on disk."""
    if isinstance(value, dict):
        return {key: held(part) for key, part in value.items()}
    if isinstance(value, np.ndarray) and value.dtype.kind in "iuf" and 1 <= value.ndim <= 2:
        if value.size < FEWEST:
            return value.item() if value.size == 1 else value.tolist()
        flat = spooled([value.reshape(-1)], value.size, value.dtype).reshape(value.shape)
        return RawArray.of(flat)
    if isinstance(value, list) or (isinstance(value, np.ndarray) and value.dtype == object):
        return [held(part) for part in value]
    if isinstance(value, np.ndarray) and value.dtype.kind == "U":
        return [str(part).strip() for part in value.reshape(-1)]
    return value.item() if isinstance(value, np.generic) else value


def _node(path: Path, file: Any, item: Any) -> Any:
    """A variable of a file of version 7.3, as :func:`held` gives it."""
    import h5py

    if isinstance(item, h5py.Group):
        fields: Any = {key: _node(path, file, part) for key, part in item.items()}
        sizes = {len(value) if isinstance(value, list) else 0 for value in fields.values()}
        if len(sizes) == 1 and 0 not in sizes:  # an array of structs, which HDF5 holds as a struct of arrays
            fields = [dict(zip(fields, values, strict=True)) for values in zip(*fields.values(), strict=True)]
        return fields
    kind = item.attrs.get("MATLAB_class", b"")
    if item.dtype == h5py.ref_dtype:
        return [_node(path, file, file[reference]) for reference in np.asarray(item).reshape(-1)]
    if kind == b"char":
        return "".join(map(chr, np.asarray(item).T.reshape(-1))).strip() if item.ndim == 2 else ""
    if item.dtype.kind not in "iuf" or item.attrs.get("MATLAB_empty", 0):
        return np.broadcast_to(np.complex128(0), item.shape) if item.dtype.names == ("real", "imag") else None
    if item.size < FEWEST:
        values = np.asarray(item).reshape(-1)
        return values[0].item() if values.size == 1 else values.tolist()
    return RawArray.in_hdf5(path, item)
