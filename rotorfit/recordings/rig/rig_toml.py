"""The file ``rig.toml``: keys with their units, read into a :class:`~rotorfit.recordings.rig.setup.RigSetup`.

Keys of the top level are also those that a recording may carry as attributes; attributes that are none of them are kept
as test attributes, a key of ``rig.toml`` that is none of them is refused.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from rotorfit.estimators.file_reading import read_toml, reading
from rotorfit.models.parameters import unknown_name
from rotorfit.recordings.rig.channel_units import ALLOWED, channel_unit
from rotorfit.recordings.rig.setup import (
    VECTOR_ORDERS,
    WAVEFORM_ORDERS,
    ForceSetup,
    ImpulseSetup,
    LoadSetup,
    Probe,
    Reference,
    RigSetup,
    Scale,
    SlowRollSetup,
    Twist,
)
from rotorfit.units import RAD_S_PER_RPM, UNITS

SENSITIVITIES = {
    "V_per_m": 1.0,
    "V_per_mm": 1e3,
    "V_per_um": 1e6,
    "V_per_mil": 1 / 25.4e-6,
    "mV_per_um": 1e3,
    "mV_per_mm": 1.0,
    "mV_per_mil": 1e-3 / 25.4e-6,
}
"""Factor to V/m by unit of a probe's sensitivity."""
_FORCE_SENSITIVITIES = {"V_per_N": 1.0, "mV_per_N": 1e-3, "V_per_lbf": 1 / 4.4482216152605}
_EDGES = ("falling", "rising")
_WHIRL = {"forward": 1, "fwd": 1, "backward": -1, "bwd": -1}
_ROTATION = {"ccw": 1, "cw": -1}

Reader = Callable[[str, Any], Any]


def _number(where: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ValueError(f"{where} must be a finite number, got {value!r}")
    return float(value)


def _positive(where: str, value: Any) -> float:
    if _number(where, value) <= 0:
        raise ValueError(f"{where} must be above zero, got {value!r}")
    return float(value)


def _sensitivity(where: str, value: Any) -> float:
    if _number(where, value) == 0:
        raise ValueError(f"{where} must not be zero")
    return float(value)


def _word(where: str, value: Any) -> str:
    if not isinstance(value, str) or not value.strip():
        raise ValueError(f"{where} must be a name in quotation marks, got {value!r}")
    return value.strip()


def _unit(where: str, value: Any) -> str:
    if channel_unit(_word(where, value)) is None:
        raise ValueError(f"{where} must be one of {ALLOWED}; got {value!r}")
    return str(value)


def _choice(allowed: Mapping[str, Any]) -> Reader:
    def read(where: str, value: Any) -> Any:
        if not isinstance(value, str) or value.lower() not in allowed:
            raise ValueError(f"{where} must be one of {', '.join(allowed)}; got {value!r}")
        return allowed[value.lower()]

    return read


def _scaled(reader: Reader, factor: float) -> Reader:
    return lambda where, value: reader(where, value) * factor


def _in_units(stem: str, field: str, units: Mapping[str, float], reader: Reader) -> dict[str, tuple[str, Reader]]:
    return {f"{stem}_{unit}": (field, _scaled(reader, factor)) for unit, factor in units.items()}


def _range(where: str, value: Any) -> tuple[float, float]:
    if not isinstance(value, list) or len(value) != 2:
        raise ValueError(f"{where} needs two voltages, [-18.0, -2.0]; got {value!r}")
    low, high = sorted(_number(where, each) for each in value)
    return low, high


def _count(where: str, value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or value < 1:
        raise ValueError(f"{where} must be a whole number of at least 1, got {value!r}")
    return value


def _ppm(where: str, value: Any) -> float:
    found, most = _number(where, value), 1000.0  # quartz is right to a hundred
    if abs(found) > most:
        raise ValueError(f"{where} is at most {most:g} either way, got {found:g}")
    return found


def _truth(where: str, value: Any) -> bool:
    if not isinstance(value, bool):
        raise ValueError(f"{where} must be true or false, got {value!r}")
    return value


def _size(where: str, value: Any) -> float:
    if _number(where, value) < 0:
        raise ValueError(f"{where} must not be negative, got {value!r}; a direction is another key")
    return float(value)


_DEGREE = math.pi / 180
_PROBE: dict[str, tuple[str, Reader]] = {
    "plane": ("plane", _word),
    "channel": ("channel", _word),
    "angle_deg": ("angle", _scaled(_number, _DEGREE)),
    "linear_range_V": ("linear_range", _range),
    "centre_V": ("centre", _number),
    "unit": ("unit", _unit),
    **_in_units("delay", "delay", {"s": 1.0, "ms": 1e-3, "us": 1e-6}, _number),
    **_in_units("sensitivity", "sensitivity", SENSITIVITIES, _sensitivity),
}
_REFERENCE: dict[str, tuple[str, Reader]] = {
    "channel": ("channel", _word),
    "edge": ("edge", _choice({edge: edge for edge in _EDGES})),
    "level_V": ("level", _number),
    "pulses_per_turn": ("pulses_per_turn", _count),
    "clock_ppm": ("clock", _scaled(_ppm, 1e-6)),
}
_PERTURBATOR: dict[str, tuple[str, Reader]] = {**_REFERENCE, "steady": ("steady", _truth)}
_FORCE: dict[str, tuple[str, Reader]] = {
    "plane": ("plane", _word),
    **_in_units("mr", "mr", UNITS["unbalance"], _size),
    "angle_deg": ("angle", _scaled(_number, _DEGREE)),
    "hole_angle_deg": ("hole_angle", _scaled(_number, _DEGREE)),
    "whirl": ("whirl", _choice(_WHIRL)),
    "channel_x": ("channel_x", _word),
    "channel_y": ("channel_y", _word),
    "unit": ("unit", _unit),
    **_in_units("sensitivity", "sensitivity", _FORCE_SENSITIVITIES, _sensitivity),
}
_LOAD: dict[str, tuple[str, Reader]] = {
    "plane": ("plane", _word),
    "N": ("size", _size),
    "lbf": ("size", _scaled(_size, UNITS["force"]["lbf"])),
    "angle_deg": ("angle", _scaled(_number, _DEGREE)),
}
_IMPULSE: dict[str, tuple[str, Reader]] = {
    "plane": ("plane", _word),
    "highest_hz": ("highest", _scaled(_positive, 2 * math.pi)),
}
_SLOW_ROLL: dict[str, tuple[str, Reader]] = {
    "below_rpm": ("below", _scaled(_positive, RAD_S_PER_RPM)),
    "file": ("file", _word),
    "as": ("orders", _choice({"vector": VECTOR_ORDERS, "waveform": WAVEFORM_ORDERS})),
}
_TWIST: dict[str, tuple[str, Reader]] = {
    "channel": ("channel", _word),
    "sensitivity_V_per_rad": ("sensitivity", _sensitivity),
    "even_wheel": ("even_wheel", _word),
    "wheel": ("wheel", _word),
    "teeth": ("teeth", _count),
}
_TOP: dict[str, tuple[str, Reader]] = {
    "rotation": ("rotation", _choice(_ROTATION)),
    "sample_rate_hz": ("sample_rate", _positive),
    **_in_units("speed", "speed", {"rpm": RAD_S_PER_RPM, "hz": 2 * math.pi, "rad_s": 1.0}, _number),
    **_in_units("sensitivity", "sensitivity", SENSITIVITIES, _sensitivity),
}
_FLAT_FORCE: dict[str, tuple[str, Reader]] = {
    "force_plane": ("plane", _word),
    "weight_plane": ("plane", _word),
    **_in_units("mr", "mr", UNITS["unbalance"], _size),
    "heavy_spot_deg_ahead_of_mark": ("angle", _scaled(_number, _DEGREE)),
    "weight_angle_deg": ("hole_angle", _scaled(_number, _DEGREE)),
    "whirl": ("whirl", _choice(_WHIRL)),
}
_FLAT_LOAD: dict[str, tuple[str, Reader]] = {
    "load_plane": ("plane", _word),
    "load_N": ("size", _size),
    "load_deg": ("angle", _scaled(_number, _DEGREE)),
}
_FLAT_IMPULSE: dict[str, tuple[str, Reader]] = {"impulse_plane": ("plane", _word)}
_TABLES = (
    "shaft",
    "perturbator",
    "probe",
    "force",
    "load",
    "impulse",
    "twist",
    "slow_roll",
    "clearance_um",
    "channel",
    "attributes",
    "run",
)
_CHANNEL: dict[str, tuple[str, Reader]] = {
    "volts_per_count": ("volts_per_count", _sensitivity),
    "full_scale_V": ("full_scale", _positive),
    "offset_V": ("offset", _number),
    "unit": ("unit", _unit),
}


def read_setup(path: str | Path) -> RigSetup:
    """Read ``rig.toml``."""
    source = Path(path).name
    with reading(source, "TOML file"):
        return setup_of(read_toml(Path(path), source), source)


def setup_of(content: Mapping[str, Any], source: str) -> RigSetup:
    """The setup that a TOML document describes."""
    known = [*_TOP, *_FLAT_FORCE, *_FLAT_LOAD, *_FLAT_IMPULSE, *_TABLES]
    for key in content:
        if key not in known:
            raise ValueError(f"{source}: {unknown_name('key', key, known)}")
    flat = {key: value for key, value in content.items() if key not in _TABLES}
    setup = flat_setup(flat, source)
    force = _record(ForceSetup, _FORCE, _table(content, "force", source), f"{source}, [force]")
    if force is not None and setup.force is not None:
        raise ValueError(f"{source}: the force is described by a table [force] and by keys of the top level; keep one")
    load = _record(LoadSetup, _LOAD, _table(content, "load", source), f"{source}, [load]")
    impulse = _record(ImpulseSetup, _IMPULSE, _table(content, "impulse", source), f"{source}, [impulse]")
    return RigSetup(
        rotation=setup.rotation,
        sample_rate=setup.sample_rate,
        speed=setup.speed,
        sensitivity=setup.sensitivity,
        shaft=_record(Reference, _REFERENCE, _table(content, "shaft", source), f"{source}, [shaft]"),
        perturbator=_record(
            Reference, _PERTURBATOR, _table(content, "perturbator", source), f"{source}, [perturbator]"
        ),
        probes=_probes(content, source),
        force=force or setup.force,
        load=load or setup.load,
        impulse=impulse or setup.impulse,
        twist=_record(Twist, _TWIST, _table(content, "twist", source), f"{source}, [twist]"),
        slow_roll=_record(SlowRollSetup, _SLOW_ROLL, _table(content, "slow_roll", source), f"{source}, [slow_roll]"),
        clearance={
            plane: _positive(f"{source}, [clearance_um]: {plane}", value) * 1e-6
            for plane, value in (_table(content, "clearance_um", source) or {}).items()
        },
        scales=_scales(content, source),
        attributes=_attributes(_table(content, "attributes", source) or {}, source),
        runs=_runs(content, source),
        source=source,
    )


def flat_setup(values: Mapping[str, Any], source: str) -> RigSetup:
    """The setup that attributes of a recording describe; those that are none of ours become test attributes."""
    top = {key: value for key, value in values.items() if key in _TOP}
    force, load, impulse = (
        {key: value for key, value in values.items() if key in flat} or None
        for flat in (_FLAT_FORCE, _FLAT_LOAD, _FLAT_IMPULSE)
    )
    used = {*top, *(force or ()), *(load or ()), *(impulse or ())}
    plain = {k: v for k, v in values.items() if k not in used and isinstance(v, int | float | str)}
    return RigSetup(
        **_fields(_TOP, top, source),
        force=_record(ForceSetup, _FLAT_FORCE, force, source),
        load=_record(LoadSetup, _FLAT_LOAD, load, source),
        impulse=_record(ImpulseSetup, _FLAT_IMPULSE, impulse, source),
        attributes=plain,
    )


def _table(content: Mapping[str, Any], name: str, source: str) -> Mapping[str, Any] | None:
    value = content.get(name)
    if value is not None and not isinstance(value, Mapping):
        raise ValueError(f"{source}: {name} is a table, [{name}]; got {value!r}")
    return value


def _tables(content: Mapping[str, Any], name: str, source: str) -> list[Mapping[str, Any]]:
    value = content.get(name, [])
    if not isinstance(value, list) or not all(isinstance(each, Mapping) for each in value):
        raise ValueError(f"{source}: {name} is a list of tables, each begins with [[{name}]]")
    return value


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


def _record(
    kind: type[Any], known: Mapping[str, tuple[str, Reader]], table: Mapping[str, Any] | None, where: str
) -> Any:
    return None if table is None else kind(**_fields(known, table, where))


def _probes(content: Mapping[str, Any], source: str) -> tuple[Probe, ...] | None:
    probes = []
    for number, table in enumerate(_tables(content, "probe", source), 1):
        where = f"{source}, [[probe]] {number}"
        for key in ("plane", "channel"):
            if key not in table:
                raise ValueError(f"{where} has no {key}; every probe needs plane, channel and angle_deg")
        probes.append(Probe(**_fields(_PROBE, table, where)))
    return tuple(probes) or None


def _scales(content: Mapping[str, Any], source: str) -> dict[str, Scale]:
    scales = {}
    for number, table in enumerate(_tables(content, "channel", source), 1):
        where = f"{source}, [[channel]] {number}"
        name = _word(f"{where}: name", table.get("name"))
        if sum(key in table for key in ("volts_per_count", "full_scale_V", "unit")) != 1:
            raise ValueError(
                f"{where}: give one of volts_per_count, full_scale_V (volts of the largest count) and unit (of what is "
                "scaled already)"
            )
        scales[name] = Scale(**_fields(_CHANNEL, {k: v for k, v in table.items() if k != "name"}, where))
    return scales


def _attributes(table: Mapping[str, Any], source: str) -> dict[str, float | str]:
    for key, value in table.items():
        if isinstance(value, bool) or not isinstance(value, int | float | str):
            raise ValueError(f"{source}, [attributes]: {key} must be a number or text, got {value!r}")
    return dict(table)


def _runs(content: Mapping[str, Any], source: str) -> dict[str, RigSetup]:
    runs: dict[str, RigSetup] = {}
    for number, table in enumerate(_tables(content, "run", source), 1):
        where = f"{source}, [[run]] {number}"
        name = _word(f"{where}: file", table.get("file"))
        if name in runs:
            raise ValueError(f"{where}: the file {name} has a [[run]] already")
        if "run" in table:
            raise ValueError(f"{where}: a run has no runs of its own")
        runs[name] = setup_of({key: value for key, value in table.items() if key != "file"}, where)
    return runs
