"""MAT recordings of versions 4 to 7.3: arrays at the top level, or structs as analysers export them.

Every real vector of enough samples is a channel; a matrix is one a column (or row). What names it and gives its rate is
looked for beside it and above: a text ``name`` (also in a ``function_record``), ``fs`` or ``increment`` (also in
``x_values``), a vector of times, a header whose name differs by ``Header`` for ``Data``.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rotorfit.estimators.file_limits import check_hdf5, check_mat
from rotorfit.io.sampling import FEWEST, rate_of, rate_of_times, time_factor
from rotorfit.recordings.formats.raw_file import RawChannel, RawFile, full_count, plain, unit_said
from rotorfit.recordings.formats.spool import Samples, spooled

_NAME_KEYS = ("name", "label", "title", "channelname", "signalname", "channel", "channel_name", "signal_name")
_LIST_KEYS = ("names", "labels", "channels", "channel_names", "channelnames", "titles")
_RECORDS = ("function_record", "x_values", "y_values", "info", "header", "properties")
_EMPTY_NAMES = {"data", "values", "y_values", "y", "signal"}


@dataclass(frozen=True, kw_only=True, eq=False)
class _Array:
    """A numeric array of the file, not read yet."""

    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    read: Any  # (start, stop, column or None) -> array, along the longer axis

    @property
    def size(self) -> int:
        return max(self.shape, default=0)

    @property
    def count(self) -> int:
        return min(self.shape) if len(self.shape) == 2 else 1


def open_file(path: Path) -> RawFile:
    """Content of a MAT file."""
    with path.open("rb") as file:
        modern = b"MATLAB 7.3" in file.read(128)
    return file_of(path.name, _modern(path) if modern else _classic(path))


def file_of(name: str, tree: Mapping[str, Any]) -> RawFile:
    """Content of a tree of structs."""
    attributes = plain({name: value for name, value in tree.items() if not isinstance(value, _Array | dict | list)})
    channels: dict[str, RawChannel] = {}
    for channel in _channels(name, tree, "", None):
        own, number = channel.name, 2
        while own in channels:
            own, number = f"{channel.name}_{number}", number + 1
        channels[own] = RawChannel(**{**vars(channel), "name": own})
    return RawFile(name=name, channels=channels, attributes=attributes, sample_rate=rate_of(attributes))


def _channels(
    source: str, tree: Mapping[str, Any], above: str, rate: float | None, names: Sequence[Any] = ()
) -> Iterator[RawChannel]:
    """Channels of a struct and of the structs in it."""
    near = _near(tree)
    rate = rate_of(near) or _rate_of_time_vector(source, tree) or rate
    given = next((near[key] for key in near if key.lower() in _NAME_KEYS and isinstance(near[key], str)), "")
    names = next((v for k, v in tree.items() if k.lower() in _LIST_KEYS and isinstance(v, list)), names)
    names = next((v for k, v in _record(tree).items() if k.lower() in _NAME_KEYS and isinstance(v, list)), names)
    for key, value in tree.items():
        if isinstance(value, _Array) and value.size >= FEWEST and time_factor(key) is None:
            head = tree.get(re.sub(r"(?i)data$", "Header", key))
            beside = plain(head) if isinstance(head, dict) else {}
            own = next((str(v) for k, v in beside.items() if k.lower() in _NAME_KEYS), given)
            base = own or (key if key.lower() not in _EMPTY_NAMES else above or key)
            yield from _of_array(value, base, names, rate_of(beside) or rate, unit_said(beside) or unit_said(near))
        elif isinstance(value, dict) and not (key == "X" and "Y" in tree):  # dSPACE: X holds the times of all Y
            record = key.lower() in _RECORDS
            yield from _channels(source, value, (given or above) if record else key, rate, names if record else ())
        elif isinstance(value, list):
            for part in value:
                if isinstance(part, dict):
                    yield from _channels(source, part, key, rate)


def _record(tree: Mapping[str, Any]) -> Mapping[str, Any]:
    """The record of an analyser beside its data, which may name each column of them."""
    return next((v for k, v in tree.items() if k.lower() == _RECORDS[0] and isinstance(v, dict)), {})


def _near(tree: Mapping[str, Any]) -> dict[str, Any]:
    """Numbers and text of a struct and of the records in it that describe its data."""
    said = {key: value for key, value in tree.items() if isinstance(value, str | int | float)}
    for key, value in tree.items():
        if key.lower() in _RECORDS and isinstance(value, dict):
            said = {**{k: v for k, v in value.items() if isinstance(v, str | int | float)}, **said}
    return said


def _rate_of_time_vector(source: str, tree: Mapping[str, Any]) -> float | None:
    for key, value in tree.items():
        times = value
        if isinstance(value, dict):
            times = value.get("Data") if key == "X" else None
        if isinstance(times, _Array) and times.size >= FEWEST and times.count == 1:
            factor = 1.0 if isinstance(value, dict) else time_factor(key)
            if factor is not None:
                return rate_of_times(
                    np.asarray(times.read(0, times.size, None), dtype=float) * factor, f"{source}, {key}"
                )
    return None


def _of_array(array: _Array, base: str, names: Sequence[Any], rate: float | None, unit: str) -> Iterator[RawChannel]:
    for column in range(array.count):
        named = names[column] if len(names) == array.count and isinstance(names[column], str) else None
        name = named or (base if array.count == 1 else f"{base}_{column + 1}")
        samples: Samples = partial(_piece, array, column if array.count > 1 else None)
        yield RawChannel(
            name=name,
            size=array.size,
            samples=samples,
            full_count=full_count(array.dtype),
            sample_rate=rate,
            unit=unit,
        )


def _piece(array: _Array, column: int | None, start: int, stop: int) -> NDArray[Any]:
    return np.asarray(array.read(start, stop, column))


# ---- versions 4 to 7: SciPy reads a variable at a time ------------------------------------------


def _classic(path: Path) -> dict[str, Any]:
    from scipy.io import loadmat, whosmat

    check_mat(path)
    tree: dict[str, Any] = {}
    for name, _, _ in whosmat(path):
        tree[name] = held(loadmat(path, variable_names=[name], simplify_cells=True)[name])
    return tree


def held(value: Any) -> Any:
    """A value of SciPy or NumPy with its arrays on disk."""
    if isinstance(value, dict):
        return {key: held(part) for key, part in value.items()}
    if isinstance(value, np.ndarray) and value.dtype.kind in "iuf" and 1 <= value.ndim <= 2:
        if value.size < FEWEST:
            return value.item() if value.size == 1 else value.tolist()
        flat = spooled([value.reshape(-1)], value.size, value.dtype).reshape(value.shape)
        return _Array(shape=value.shape, dtype=value.dtype, read=partial(_from_array, flat))
    if isinstance(value, list) or (isinstance(value, np.ndarray) and value.dtype == object):
        return [held(part) for part in value]
    if isinstance(value, np.ndarray) and value.dtype.kind == "U":
        return [str(part).strip() for part in value.reshape(-1)]
    return value.item() if isinstance(value, np.generic) else value


def _from_array(flat: NDArray[Any], start: int, stop: int, column: int | None) -> NDArray[Any]:
    if flat.ndim == 1:
        return np.array(flat[start:stop])
    long = flat if flat.shape[0] == max(flat.shape) else flat.T
    return np.array(long[start:stop, column or 0])


# ---- version 7.3: HDF5 ------------------------------------------------------------------------


def _modern(path: Path) -> dict[str, Any]:
    import h5py

    check_hdf5(path)
    with h5py.File(path, "r") as file:
        return {key: _node(path, file, item) for key, item in file.items() if not key.startswith("#")}


def _node(path: Path, file: Any, item: Any) -> Any:
    import h5py

    if isinstance(item, h5py.Group):
        return _transposed({key: _node(path, file, part) for key, part in item.items()})
    kind = item.attrs.get("MATLAB_class", b"")
    if item.dtype == h5py.ref_dtype:
        return [_node(path, file, file[reference]) for reference in np.asarray(item).reshape(-1)]
    if kind == b"char":
        return "".join(map(chr, np.asarray(item).T.reshape(-1))).strip() if item.ndim == 2 else ""
    if item.dtype.kind not in "iuf" or item.attrs.get("MATLAB_empty", 0):
        return None
    if item.size < FEWEST:
        values = np.asarray(item).reshape(-1)
        return values[0].item() if values.size == 1 else values.tolist()
    return _Array(shape=tuple(item.shape), dtype=item.dtype, read=partial(_from_file, path, item.name))


def _transposed(fields: dict[str, Any]) -> Any:
    """An array of structs, which HDF5 holds as a struct of arrays."""
    sizes = {len(value) if isinstance(value, list) else 0 for value in fields.values()}
    if len(sizes) != 1 or 0 in sizes:
        return fields
    return [dict(zip(fields, values, strict=True)) for values in zip(*fields.values(), strict=True)]


def _from_file(path: Path, name: str, start: int, stop: int, column: int | None) -> NDArray[Any]:
    import h5py

    with h5py.File(path, "r") as file:
        data = file[name]
        if data.ndim == 1:
            return np.asarray(data[start:stop])
        along = data.shape[0] == max(data.shape)
        return np.asarray(data[start:stop, column or 0] if along else data[column or 0, start:stop])
