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
"""

from __future__ import annotations

import cmath
import math
import tomllib
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from rotorfit.models.parameters import unknown_name
from rotorfit.studies.study import DataFile, Study, frozen_prior

Parser = Callable[[str, Any], Any]


def read_study(path: str | Path) -> Study:
    """Read a study from a TOML file; its keys are the attributes of :class:`rotorfit.studies.study.Study`.

    Raises:
        OSError: the file cannot be read.
        ValueError: not TOML, unknown keys (the nearest is named), or values of the wrong kind.
    """
    path = Path(path)
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as reason:
        raise ValueError(f"{path}: not a TOML file: {reason}") from reason
    try:
        _refuse_unknown(table, _KEYS)
        for key in ("files", "model"):
            if key not in table:
                raise ValueError(f"the key {key!r} is missing")
        settings = {key: _KEYS[key](key, value) for key, value in table.items()}
    except ValueError as reason:
        raise ValueError(f"{path}: {reason}") from reason
    base = path.parent
    settings["files"] = tuple(DataFile(base / file.path, file.options) for file in settings["files"])
    if "out" in settings:
        settings["out"] = base / settings["out"]
    return Study(**settings)


def _refuse_unknown(given: Iterable[str], allowed: Iterable[str]) -> None:
    for key in given:
        if key not in allowed:
            raise ValueError(unknown_name("key", key, allowed))


# ---- kinds of values --------------------------------------------------------------------------


def _text(key: str, value: Any) -> str:
    if not isinstance(value, str) or not value:
        raise ValueError(f"{key} must be a text, got {value!r}")
    return value


def _flag(key: str, value: Any) -> bool:
    if not isinstance(value, bool):
        raise ValueError(f"{key} must be true or false, got {value!r}")
    return value


def _number(key: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError(f"{key} must be a number, got {value!r}")
    return float(value)


def _positive(key: str, value: Any) -> float:
    if not _number(key, value) > 0:
        raise ValueError(f"{key} must be above zero, got {value!r}")
    return float(value)


def _whole(key: str, value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or value < 0:
        raise ValueError(f"{key} must be a whole number, not below zero; got {value!r}")
    return value


def _count(key: str, value: Any) -> int:
    if _whole(key, value) == 0:
        raise ValueError(f"{key} must be at least 1, got {value!r}")
    return int(value)


def _number_or_free(key: str, value: Any) -> float | None:
    if value == "free":
        return None
    if isinstance(value, str):
        raise ValueError(f'{key} must be a number, or "free" to fit it, got {value!r}')
    return _number(key, value)


def _pair(key: str, value: Any) -> tuple[float, float]:
    if not isinstance(value, list) or len(value) != 2:
        raise ValueError(f"{key} must be two numbers in brackets, got {value!r}")
    return _number(key, value[0]), _number(key, value[1])


def _texts(key: str, value: Any) -> tuple[str, ...]:
    if not isinstance(value, list):
        raise ValueError(f"{key} must be a list of texts, got {value!r}")
    return tuple(_text(key, item) for item in value)


def _table(of: Parser) -> Parser:
    def parse(key: str, value: Any) -> dict[str, Any]:
        if not isinstance(value, dict):
            raise ValueError(f"{key} must be a table, got {value!r}")
        return {name: of(f"{key}.{name}", item) for name, item in value.items()}

    return parse


def _uncertainty(key: str, value: Any) -> Any:
    """A number for all probes or planes, or one by plane."""
    if isinstance(value, dict):
        return {place: _number(f"{key}.{place}", number) for place, number in value.items()}
    return _number(key, value)


def _prior(key: str, value: Any) -> Any:
    if not isinstance(value, dict) or len(value) != 1:
        raise ValueError(f"{key} must be one distribution with its numbers, {{norm = [1.0, 0.01]}}; got {value!r}")
    name, numbers = next(iter(value.items()))
    if not isinstance(numbers, list):
        raise ValueError(f"{key}: {name} needs a list of numbers, got {numbers!r}")
    return frozen_prior(key, name, [_number(key, number) for number in numbers])


def _polar(key: str, value: Any) -> complex:
    size, degrees = _pair(key, value)
    return cmath.rect(size, math.radians(degrees))


def _channels(of: Parser) -> Parser:
    """A table by channel, ``"journal x"``."""

    def parse(key: str, value: Any) -> dict[tuple[str, str], Any]:
        result = {}
        for name, item in _table(of)(key, value).items():
            plane, _, direction = name.rpartition(" ")
            if not plane:
                raise ValueError(f'{key}: a channel is a plane and a direction, "journal x", got {name!r}')
            result[plane, direction] = item
        return result

    return parse


def _slow_roll(key: str, value: Any) -> Mapping[tuple[str, str], complex]:
    return {channel: phasor * 1e-6 for channel, phasor in _channels(_polar)(key, value).items()}


def _speed(key: str, value: Any) -> float:
    return _number(key, value) * math.pi / 30


_READ_KEYS: dict[str, tuple[str, Parser]] = {
    "gains": ("gains", _channels(_polar)),
    "delays_s": ("delays", _channels(_number)),
    "slow_roll_um_deg": ("slow_roll", _slow_roll),
    "slow_roll_below_rpm": ("slow_roll_below_rpm", _number),
    "probe_angles_deg": ("probe_angles", _table(_pair)),
    "difference": ("difference", _flag),
    "speed_rpm": ("speed", _speed),
    "speed_tolerance": ("speed_tolerance", _number),
}
"""Keys beside ``path`` in a file's table: option of :func:`rotorfit.read`, and what its value must be."""


def _file(key: str, value: Any) -> DataFile:
    if isinstance(value, str):
        return DataFile(Path(_text(key, value)))
    if not isinstance(value, dict) or "path" not in value:
        raise ValueError(f"{key} must be paths, or tables with a path and read options; got {value!r}")
    options = {name: item for name, item in value.items() if name != "path"}
    _refuse_unknown(options, _READ_KEYS)
    return DataFile(
        Path(_text(f"{key}.path", value["path"])),
        {_READ_KEYS[name][0]: _READ_KEYS[name][1](f"{key}.{name}", item) for name, item in options.items()},
    )


def _files(key: str, value: Any) -> tuple[DataFile, ...]:
    if not isinstance(value, list) or not value:
        raise ValueError(f"{key} must be a list of at least one file, got {value!r}")
    return tuple(_file(key, item) for item in value)


_KEYS: dict[str, Parser] = {
    "files": _files,
    "model": _text,
    "out": _text,
    "planes": _texts,
    "blocks": _texts,
    "two_lam": _flag,
    "law": _text,
    "clearance_um": _positive,
    "known": _table(_number_or_free),
    "bounds": _table(_pair),
    "priors": _table(_prior),
    "per": _table(_text),
    "start": _table(_number),
    "loss": _text,
    "phase_offsets": _flag,
    "calibration": _table(_uncertainty),
    "refine": _flag,
    "sample": _flag,
    "seed": _whole,
    "ess": _positive,
    "max_steps": _count,
    "profile": _texts,
    "bootstrap": _count,
}
"""Keys of a study and what their values must be."""
