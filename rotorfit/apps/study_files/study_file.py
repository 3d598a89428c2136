"""Studies as TOML files: every key checked, relative paths relative to the file.

::

    files = ["rig.csv", {path = "other.csv", probe_angles_deg = {journal = [45, 135]}}]
    model = "whirl-whip"
    out = "results"
    refine = true
    known = {K3 = 6000.0}
    bounds = {lam = [0.0, 0.6]}
    priors = {sigma = {norm = [1.0, 0.01]}}
    per = {D = "speed_rpm"}
    sample = true
    seed = 1
    profile = ["lam", "threshold_speed"]

Recordings are a table in ``files`` too, ``{recordings = ["a.h5", "b.h5"], setup = "rig.toml"}``; ``skip`` of a table
leaves out readings by number.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from rotorfit.apps.study_files.data_files import DataFile, RecordingFiles
from rotorfit.apps.study_files.study import Study
from rotorfit.base.atomic_file import joined
from rotorfit.base.file_reading import read_toml, reading
from rotorfit.base.names import unknown_name
from rotorfit.base.units import RAD_S_PER_RPM
from rotorfit.identify.options.kinds import Parser, count, flag, number, pair, table, text
from rotorfit.identify.options.table import FIT
from rotorfit.models import KnownStructure

T = TypeVar("T")


def read_keys(path: str | Path, make: Callable[[Mapping[str, Any], Path], T]) -> T:
    """What the keys of a TOML file say; ``make`` takes them and the folder of the file."""
    path = Path(path)
    with reading(str(path), "TOML file"):
        content = read_toml(path, str(path))
        try:
            return make(content, path.parent)
        except ValueError as reason:
            raise ValueError(f"{path}: {reason}") from reason


def read_study(path: str | Path, *, of_a_store: bool = False) -> Study:
    """Read a study from a TOML file; its keys are the attributes of
    :class:`~rotorfit.apps.study_files.study.Study`. That of a store may leave ``files`` out, see :func:`study_of`."""
    return read_keys(path, partial(study_of, of_a_store=of_a_store))


def study_of(content: Mapping[str, Any], base: Path = Path(), *, of_a_store: bool = False) -> Study:
    """The study that TOML keys describe, with paths relative to a folder. In that of a store ``files`` are patterns of
    names (``"*.csv"``): which files are taken, and how they are read."""
    content = known_keys(content, _KEYS)
    for key in ("model",) if of_a_store else ("files", "model"):
        if key not in content:
            raise ValueError(f"the key {key!r} is missing")
    settings = {"files": (), **{key: _KEYS[key](key, value) for key, value in content.items()}}
    settings["files"] = tuple(_in_folder(file, base) for file in settings["files"])
    if "out" in settings:
        settings["out"] = joined(base, settings["out"])
    for key in ("structure", "baseline"):
        if key in settings:
            settings[key] = str(joined(base, settings[key]))
    return Study(**settings)


def _in_folder(file: DataFile | RecordingFiles, base: Path) -> DataFile | RecordingFiles:
    if isinstance(file, DataFile):
        return replace(file, path=joined(base, file.path))
    paths = tuple(joined(base, path) for path in file.paths)
    return replace(file, paths=paths, setup=None if file.setup is None else joined(base, file.setup))


def refuse_unknown(given: Iterable[str], allowed: Iterable[str], what: str = "key") -> None:
    """Refuse a key that there is not."""
    for key in given:
        if key not in allowed:
            raise ValueError(unknown_name(what, key, allowed))


def known_keys(content: Mapping[str, Any], allowed: Iterable[str]) -> Mapping[str, Any]:
    """Keys of a whole file, none of them unknown; a shaft from a file makes the model."""
    refuse_unknown(content, allowed)
    return {"model": KnownStructure.name, **content} if "structure" in content else content


# ---- read options -----------------------------------------------------------------------------


def _polar(key: str, value: Any) -> complex:
    size, degrees = pair(key, value)
    return cmath.rect(size, math.radians(degrees))


def _channels(of: Parser) -> Parser:
    """A table by channel, ``"journal x"``."""

    def parse(key: str, value: Any) -> dict[tuple[str, str], Any]:
        result = {}
        for name, item in table(of)(key, value).items():
            plane, _, direction = name.rpartition(" ")
            if not plane:
                raise ValueError(f'{key}: a channel is a plane and a direction, "journal x", got {name!r}')
            result[plane, direction] = item
        return result

    return parse


def _selection(key: str, value: Any) -> dict[str, Any]:
    """Values by attribute: one, a list of them, or a range ``{from = 40, to = 60}`` with either end left out."""
    found: dict[str, Any] = {}
    if not isinstance(value, dict):
        raise ValueError(f'{key} must be a table such as {{run = ["a", "b"], oil_C = {{from = 40, to = 60}}}}')
    for name, item in value.items():
        if isinstance(item, dict):
            refuse_unknown(item, ("from", "to"))
            low, high = (
                number(f"{key}.{name}.{end}", item.get(end, far)) if end in item else far
                for end, far in (("from", -math.inf), ("to", math.inf))
            )
            found[name] = (low, high)
        elif isinstance(item, list) and item and all(isinstance(one, str | int | float) for one in item):
            found[name] = list(item)
        elif isinstance(item, str | int | float) and not isinstance(item, bool):
            found[name] = item
        else:
            raise ValueError(f"{key}.{name} must be a value, a list of values or a range {{from, to}}, got {item!r}")
    return found


def _constants(key: str, value: Any) -> dict[str, str | float]:
    if not isinstance(value, dict) or not all(isinstance(one, str | int | float) for one in value.values()):
        raise ValueError(f'{key} must be a table such as {{force_plane = "journal", speed_rpm = 1500}}, got {value!r}')
    return dict(value)


def _numbers(key: str, value: Any) -> tuple[int, ...]:
    """Numbers of readings, from 1."""
    if not isinstance(value, list):
        raise ValueError(f"{key} must be a list of numbers of readings, counted from 1; got {value!r}")
    return tuple(count(key, item) for item in value)


_READ_KEYS: dict[str, tuple[str, Parser]] = {
    "gains": ("gains", _channels(_polar)),
    "delays_s": ("delays", _channels(number)),
    "slow_roll_um_deg": ("slow_roll", _channels(lambda key, value: _polar(key, value) * 1e-6)),
    "slow_roll_below_rpm": ("slow_roll_below_rpm", number),
    "probe_angles_deg": ("probe_angles", table(pair)),
    "difference": ("difference", flag),
    "speed_rpm": ("speed", lambda key, value: number(key, value) * RAD_S_PER_RPM),
    "speed_tolerance": ("speed_tolerance", number),
    "sheet": ("sheet", text),
    "columns": ("columns", table(text)),
    "constants": ("constants", _constants),
    "axes": ("axes", text),
    "where": ("where", _selection),
    "exclude": ("exclude", _selection),
    "drop_near_1x": ("drop_near_1x", number),
    "casing": ("casing", table(text)),
    "stator": ("stator", table(number)),
    "skip": ("skip", _numbers),
}
"""Keys beside ``path`` in a file's table: option of :func:`rotorfit.read`, and what its value must be."""


def _several(of: Parser) -> Parser:
    """A list of files, at least one."""

    def parse(key: str, value: Any) -> tuple[Any, ...]:
        if not isinstance(value, list) or not value:
            raise ValueError(f"{key} must be a list of at least one file, got {value!r}")
        return tuple(of(key, item) for item in value)

    return parse


def _path(key: str, value: Any) -> Path:
    return Path(text(key, value))


_RECORDED_KEYS: dict[str, tuple[str, Parser]] = {
    "recordings": ("paths", _several(_path)),
    "setup": ("setup", _path),
    "windows": ("windows", count),
    "where": ("where", _selection),
    "exclude": ("exclude", _selection),
    "casing": ("casing", table(text)),
    "stator": ("stator", table(number)),
    "skip": ("skip", _numbers),
}
"""Keys of a table of recordings: field of :class:`RecordingFiles`, and what its value must be."""


def _file(key: str, value: Any) -> DataFile | RecordingFiles:
    if isinstance(value, str):
        return DataFile(_path(key, value))
    if isinstance(value, dict) and "recordings" in value:
        return RecordingFiles(**_by_keys(key, value, _RECORDED_KEYS))
    if not isinstance(value, dict) or "path" not in value:
        raise ValueError(
            f"{key} must be paths, tables with a path and read options, or tables with recordings; got {value!r}"
        )
    options = {name: item for name, item in value.items() if name != "path"}
    return DataFile(_path(f"{key}.path", value["path"]), _by_keys(key, options, _READ_KEYS))


def _by_keys(key: str, value: Mapping[str, Any], keys: Mapping[str, tuple[str, Parser]]) -> dict[str, Any]:
    """Options by the names that a file's table has for them."""
    refuse_unknown(value, keys)
    return {keys[name][0]: keys[name][1](f"{key}.{name}", item) for name, item in value.items()}


_KEYS: dict[str, Parser] = {
    "files": _several(_file),
    "model": text,
    "out": text,
    **{name: option.kind.toml for name, option in FIT.items()},
}
"""Keys of a study and what their values must be."""
