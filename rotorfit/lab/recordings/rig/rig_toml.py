"""The file ``rig.toml``: keys with their units, read into a :class:`~rotorfit.lab.recordings.rig.setup.RigSetup`.

Keys of the top level are also those that a recording may carry as attributes; attributes that are none of them are kept
as test attributes, a key of ``rig.toml`` that is none of them is refused.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

from rotorfit.base.file_reading import read_toml, reading
from rotorfit.base.names import unknown_name
from rotorfit.lab.recordings.rig.setup import (
    ForceSetup,
    ImpulseSetup,
    LoadSetup,
    Probe,
    Reader,
    Reference,
    RigSetup,
    Scale,
    SlowRollSetup,
    Twist,
    positive,
    word,
)


def _keys(kind: type[Any], name: str) -> dict[str, tuple[str, Reader]]:
    """Field and reader by key, of a record's own table (``keys``) or of the top level (``flat``)."""
    return {key: (f.name, reader) for f in fields(kind) for key, reader in f.metadata.get(name, {}).items()}


_RECORDS: dict[str, type[Any]] = {"shaft": Reference, "perturbator": Reference, "force": ForceSetup, "load": LoadSetup}
_RECORDS |= {"impulse": ImpulseSetup, "twist": Twist, "slow_roll": SlowRollSetup}
"""Records of a setup that are a table each."""
_TOP = _keys(RigSetup, "flat")
_FLAT = {name: _keys(kind, "flat") for name, kind in _RECORDS.items() if _keys(kind, "flat")}
"""Keys of the top level: of the setup itself, and of its records."""
_TABLES = ("shaft", "perturbator", "probe", *list(_RECORDS)[2:], "clearance_um", "channel", "attributes", "run")


def read_setup(path: str | Path) -> RigSetup:
    """Read ``rig.toml``."""
    source = Path(path).name
    with reading(source, "TOML file"):
        return setup_of(read_toml(Path(path), source), source)


def setup_of(content: Mapping[str, Any], source: str) -> RigSetup:
    """The setup that a TOML document describes."""
    known = [*_TOP, *(key for keys in _FLAT.values() for key in keys), *_TABLES]
    for key in content:
        if key not in known:
            raise ValueError(f"{source}: {unknown_name('key', key, known)}")
    setup = flat_setup({key: value for key, value in content.items() if key not in _TABLES}, source)
    said: dict[str, Any] = {}
    for name, kind in _RECORDS.items():
        if (table := _table(content, name, source)) is not None:
            keys = {key: to for key, to in _keys(kind, "keys").items() if (name, key) != ("shaft", "steady")}
            said[name] = kind(**_fields(keys, table, f"{source}, [{name}]"))
    if "force" in said and setup.force is not None:
        raise ValueError(f"{source}: the force is described by a table [force] and by keys of the top level; keep one")
    clearance = (_table(content, "clearance_um", source) or {}).items()
    attributes = dict(_table(content, "attributes", source) or {})
    for key, value in attributes.items():
        if isinstance(value, bool) or not isinstance(value, int | float | str):
            raise ValueError(f"{source}, [attributes]: {key} must be a number or text, got {value!r}")
    return replace(
        setup,
        **said,
        probes=_probes(content, source),
        clearance={plane: positive(f"{source}, [clearance_um]: {plane}", value) * 1e-6 for plane, value in clearance},
        scales=_scales(content, source),
        attributes=attributes,
        runs=_runs(content, source),
        source=source,
    )


def flat_setup(values: Mapping[str, Any], source: str) -> RigSetup:
    """The setup that attributes of a recording describe; those that are none of ours become test attributes."""
    said = _fields(_TOP, {key: value for key, value in values.items() if key in _TOP}, source)
    used = set(_TOP)
    for name, keys in _FLAT.items():
        if own := {key: value for key, value in values.items() if key in keys}:
            said[name] = _RECORDS[name](**_fields(keys, own, source))
            used |= set(own)
    plain = {k: v for k, v in values.items() if k not in used and isinstance(v, int | float | str)}
    return RigSetup(**said, attributes=plain)


def _table(content: Mapping[str, Any], name: str, source: str) -> Mapping[str, Any] | None:
    value = content.get(name)
    if value is not None and not isinstance(value, Mapping):
        raise ValueError(f"{source}: {name} is a table, [{name}]; got {value!r}")
    return value


def _tables(content: Mapping[str, Any], name: str, source: str) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """The tables of a list, each with where it stands."""
    value = content.get(name, [])
    if not isinstance(value, list) or not all(isinstance(each, Mapping) for each in value):
        raise ValueError(f"{source}: {name} is a list of tables, each begins with [[{name}]]")
    return ((f"{source}, [[{name}]] {number}", table) for number, table in enumerate(value, 1))


def _fields(known: Mapping[str, tuple[str, Reader]], table: Mapping[str, Any], where: str) -> dict[str, Any]:
    said: dict[str, Any] = {}
    named: dict[str, str] = {}
    for key, value in table.items():
        if key not in known:
            raise ValueError(f"{where}: {unknown_name('key', key, known)}")
        field, reader = known[key]
        if field in said:
            raise ValueError(f"{where}: {named[field]} and {key} say the same thing; keep one of them")
        said[field], named[field] = reader(f"{where}: {key}", value), key
    return said


def _probes(content: Mapping[str, Any], source: str) -> tuple[Probe, ...] | None:
    probes = []
    for where, table in _tables(content, "probe", source):
        for key in ("plane", "channel"):
            if key not in table:
                raise ValueError(f"{where} has no {key}; every probe needs plane, channel and angle_deg")
        probes.append(Probe(**_fields(_keys(Probe, "keys"), table, where)))
    return tuple(probes) or None


def _scales(content: Mapping[str, Any], source: str) -> dict[str, Scale]:
    scales = {}
    for where, table in _tables(content, "channel", source):
        name = word(f"{where}: name", table.get("name"))
        if sum(key in table for key in ("volts_per_count", "full_scale_V", "unit")) != 1:
            raise ValueError(
                f"{where}: give one of volts_per_count, full_scale_V (volts of the largest count) and unit (of what is "
                "scaled already)"
            )
        own = {key: value for key, value in table.items() if key != "name"}
        scales[name] = Scale(**_fields(_keys(Scale, "keys"), own, where))
    return scales


def _runs(content: Mapping[str, Any], source: str) -> dict[str, RigSetup]:
    runs: dict[str, RigSetup] = {}
    for where, table in _tables(content, "run", source):
        name = word(f"{where}: file", table.get("file"))
        if name in runs:
            raise ValueError(f"{where}: the file {name} has a [[run]] already")
        if "run" in table:
            raise ValueError(f"{where}: a run has no runs of its own")
        runs[name] = setup_of({key: value for key, value in table.items() if key != "file"}, where)
    return runs
