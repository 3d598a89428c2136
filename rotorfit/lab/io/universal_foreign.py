"""Universal files that others wrote: FRFs of ordinary shaker or hammer tests.

A circular force is the sum of two of them, ``H_x F - j H_y F`` forward and ``H_x F + j H_y F`` backward, where both
references x and y are there at a node; where one is missing, the test is one with a force along an axis.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from enum import IntEnum
from typing import Any

import numpy as np

from rotorfit.base.units import UNITS, find_unit
from rotorfit.lab.data.experiments import DERIVATIVES, MEASURED, PerturbationTest
from rotorfit.lab.data.findings import level_of_caller
from rotorfit.lab.data.from_arrays import perturbation_test
from rotorfit.lab.io.universal_file import copies

DIRECTIONS = {1: ("x", 1.0), 2: ("y", 1.0), 5: ("rx", 1.0), 4: ("ry", -1.0)}
"""Direction and sign of a positive UFF direction; a negative one turns the sign."""


class DataType(IntEnum):
    """Quantity of an axis of a function, by the format's own numbers."""

    DISPLACEMENT = 8
    VELOCITY = 11
    ACCELERATION = 12
    FORCE = 13
    FREQUENCY = 18
    SPEED = 19
    ORDER = 20


class FunctionType(IntEnum):
    """Kind of a function, by the format's own numbers."""

    GENERAL = 0
    FRF = 4


_ORDINATES = (DataType.DISPLACEMENT, DataType.VELOCITY, DataType.ACCELERATION)
AXES = {1: "x", 2: "y"}


_Row = dict[str, Any]
"""Columns of one FRF of a unidirectional test in SI units, single values standing for all its lines: the response at a
channel to a force of 1 N along ``force_direction``, x or y."""


def turned(functions: Sequence[dict[str, Any]], axes: str) -> list[dict[str, Any]]:
    """Functions with their directions as if the shaft stood along z."""
    if len(axes) != 2 or len(set(axes.lower()) & set("xyz")) != 2:
        raise ValueError(f"axes are the two directions of the file that are x and y, such as 'yz'; got {axes!r}")
    first, second = ("xyz".index(axis) + 1 for axis in axes.lower())
    third = 6 - first - second
    new = {first: 1, second: 2, third: 3}
    new |= {old + 3: place + 3 for old, place in new.items()}
    keys = ("rsp_dir", "ref_dir")
    return [
        {**f, **{key: int(np.sign(f[key])) * new.get(abs(f[key]), abs(f[key])) for key in keys if key in f}}
        for f in functions
    ]


def read_foreign(
    functions: Sequence[dict[str, Any]], scales: dict[str, Any], speed: float | None, source: str
) -> PerturbationTest:
    """The test that FRFs of another program make."""
    frfs = [record for record in functions if record["func_type"] == FunctionType.FRF]
    if not frfs:
        types = sorted({record["func_type"] for record in functions})
        raise ValueError(f"{source} has functions of type {types} but no frequency response (type 4); nothing to read")
    # entity names are those of planes where they tell the nodes apart, else the node numbers
    pairs = {(r[f"{end}_node"], r[f"{end}_ent_name"].strip()) for r in frfs for end in ("rsp", "ref")}
    names = dict(pairs)
    distinct = len(pairs) == len(names) == len(set(names.values()))
    if not distinct or {"", "NONE"} & {name.upper() for name in names.values()}:
        names = {node: str(node) for node in names}
    notes: list[str] = []
    copied = {place: first for place, first in enumerate(copies(frfs)) if first is not None}
    if copied:
        listed = ", ".join(f"{place + 1} is {first + 1}" for place, first in list(copied.items())[:3])
        notes.append(f"FRFs that are there twice, to the last digit, were taken once: {listed}")
    frfs = [record for place, record in enumerate(frfs) if place not in copied]
    found = [_receptance(record, names, scales, speed, source, notes) for record in frfs]
    rows = [frf for frf in found if frf is not None]
    if conjugated := [frf for frf in rows if _looks_conjugated(frf)]:
        words = (
            "the rotor gives energy to the force that drives it: are the FRFs conjugated (Sxf in place of Sfx, or of "
            "exp(-jwt))? At the drive point"
        )
        notes += [f"{words}: {frf['plane']} {frf['direction']}" for frf in conjugated]
    kinds: dict[str, list[str]] = {}  # of notes, with the functions concerned
    for note in notes:
        what, _, where = note.rpartition(": ")
        kinds.setdefault(what, []).append(where)
    for what, places in kinds.items():
        more = f" and {len(places) - 3} more" if len(places) > 3 else ""
        warnings.warn(f"{source}: {what}: {', '.join(places[:3])}{more}", stacklevel=level_of_caller())
    by_run = _by_channel(rows)
    if _lonely(by_run):  # the second ID line may be a remark that differs between the two directions of force
        by_run = _by_channel([{**frf, "run": ""} for frf in rows])
    if not by_run:
        raise ValueError(
            f"{source} has no FRF to a force along x or y that is lateral; nothing to read. Where the shaft is not "
            "along z, say which directions are x and y (axes=, --axes yz)"
        )
    alone = _lonely(by_run)  # planes without one of the two references: their force does not turn
    along = [_named(frf, frf["force_direction"]) for frf in rows if frf["force_plane"] in alone]
    pairs_of_axes = [pair for key, xy in by_run.items() if key[2] not in alone for pair in zip(*xy, strict=True)]
    whole = [row for x, y in pairs_of_axes for row in _circular(x, y, source)] + along
    joined: dict[str, Any] = {
        name: np.concatenate([np.broadcast_to(row[name], row["frequency"].shape) for row in whole]) for name in whole[0]
    }
    if not joined["frequency"].size:
        raise ValueError(f"{source}: no readings at frequencies above zero")
    measured = joined.pop(MEASURED)
    attributes = {MEASURED: measured} if (measured != DERIVATIVES[0]).any() else {}
    return perturbation_test(**joined, force=1.0, attributes=attributes, source=source)


def _by_channel(frfs: Sequence[_Row]) -> dict[tuple[Any, ...], tuple[list[_Row], list[_Row]]]:
    """FRFs to forces along x and along y of each channel in each run; repeats in order of appearance."""
    found: dict[tuple[Any, ...], tuple[list[_Row], list[_Row]]] = {}
    for frf in frfs:
        key = tuple(frf[name] for name in ("run", "speed", "force_plane", "plane", "direction"))
        found.setdefault(key, ([], []))["xy".index(frf["force_direction"])].append(frf)
    return found


def _lonely(channels: dict[tuple[Any, ...], tuple[list[_Row], list[_Row]]]) -> set[str]:
    """Planes of forces whose partner along the other axis is missing."""
    return {key[2] for key, (x, y) in channels.items() if len(x) != len(y)}


def _receptance(
    record: dict[str, Any],
    names: dict[int, str],
    scales: dict[str, Any],
    speed: float | None,
    source: str,
    notes: list[str],
) -> _Row | None:
    """One FRF in SI units, None for directions along the shaft and torsion; what is worth a word goes to ``notes``."""
    what = f"{source}, FRF {record['rsp_node']}:{record['rsp_dir']} over {record['ref_node']}:{record['ref_dir']}"
    if abs(record["rsp_dir"]) not in DIRECTIONS or abs(record["ref_dir"]) not in (1, 2):
        words = "left out, not lateral (where the shaft is not along z: axes=, --axes)"
        notes.append(f"{words}: {what.partition(', ')[2]}")
        return None
    if record["abscissa_spec_data_type"] not in (0, 1, DataType.FREQUENCY, DataType.SPEED):
        kind = record["abscissa_spec_data_type"]
        raise ValueError(f"{what}: the abscissa is of type {kind}; needed is frequency (18)")
    w = _rate(record, "abscissa") * np.asarray(record["x"], dtype=float)
    kind = record["ordinate_spec_data_type"]
    if kind not in _ORDINATES or record["orddenom_spec_data_type"] not in (0, DataType.FORCE):
        raise ValueError(
            f"{what}: the ordinate is of type {kind} over {record['orddenom_spec_data_type']}; needed is displacement "
            "(8), velocity (11) or acceleration (12) over force (13)"
        )
    direction, sign = DIRECTIONS[abs(record["rsp_dir"])]
    sign *= np.sign(record["rsp_dir"]) * np.sign(record["ref_dir"])
    angular = direction[0] == "r"
    length = 1.0 if angular else _scale(record, "ordinate", _LENGTHS, scales.get("length"), what, notes)
    force = _scale(record, "orddenom", _FORCES, scales.get("force"), what, notes)
    keep = (w > 0) & np.isfinite(record["data"])  # velocity and acceleration say nothing at zero frequency
    values = np.asarray(record["data"], dtype=complex)[keep] / (1j * w[keep]) ** _ORDINATES.index(kind)
    return {
        "run": "" if record["id2"].upper() == "NONE" else record["id2"],
        "speed": _speed(record, speed, what),
        "frequency": w[keep],
        "force_plane": names[record["ref_node"]],
        "force_direction": AXES[abs(record["ref_dir"])],
        "plane": names[record["rsp_node"]],
        "direction": direction,
        "response": values * (sign * length / force),
        MEASURED: DERIVATIVES[_ORDINATES.index(kind)],
    }


def _looks_conjugated(frf: _Row) -> bool:
    """True if a drive point gives energy to its force on the whole, though it is a spring at the lowest lines and a
    mass at the highest, as it would not be with the force's sign turned. Below lam Om a rotor may give some."""
    if frf["plane"] != frf["force_plane"] or frf["direction"] != frf["force_direction"] or not len(frf["response"]):
        return False
    values = frf["response"][np.argsort(frf["frequency"])]
    quarter = len(values) // 4 + 1
    resonant = np.median(values[:quarter].real) > 0 > np.median(values[-quarter:].real)
    return bool(resonant and values.imag.sum() > 0.5 * np.abs(values.imag).sum())


_LENGTHS = {"m": 1.0, "mm": 1e-3, "um": 1e-6, "in": 0.0254, "mil": 25.4e-6, "g": 9.80665, "gn": 9.80665}
_FORCES = {**UNITS["force"], "lb": 4.4482216152605}


def _scale(
    record: dict[str, Any], axis: str, units: dict[str, float], per_si: float | None, what: str, notes: list[str]
) -> float:
    """Factor to SI from the label of an axis, else from the units of one SI unit that data set 164 says; ``mm/s^2``
    counts as its length, time is always in seconds."""
    said, default = per_si is not None, 1 / (per_si or 1.0)
    label = str(record.get(f"{axis}_axis_units_lab", "")).strip()
    word = label.strip("()[] ").split("/")[0].strip("()[] ")
    if word.lower() in ("", "none"):
        if not said:
            words = "no unit is said, neither by the axis nor by data set 164, and SI units (m, N) were taken"
            notes.append(f"{words}: {what.partition(', ')[2]}")
        return default
    try:
        factor = find_unit(word, units)
    except ValueError as reason:
        raise ValueError(f"{what}: {reason}") from reason
    if factor is None:
        notes.append(f"unit {label!r} is not known, taken as {default:g} SI units: {what.partition(', ')[2]}")
        return default
    return factor


def _rate(record: dict[str, Any], axis: str) -> float:
    """Factor to rad/s of an axis from its label, else from its type: rpm (19), anything else Hz."""
    label = str(record.get(f"{axis}_axis_units_lab", "")).strip("()[] ").lower().replace("/", "_")
    kind = "rpm" if record[f"{axis}_spec_data_type"] == DataType.SPEED else "hz"
    return UNITS["frequency"].get(label, UNITS["frequency"][kind])


def _speed(record: dict[str, Any], speed: float | None, what: str) -> float:
    if speed is not None:
        return speed
    kind = record["z_axis_spec_data_type"]
    label = str(record.get("z_axis_axis_units_lab", "")).strip("()[] ").lower().replace("/", "_")
    if kind not in (DataType.FREQUENCY, DataType.SPEED) and label not in UNITS["frequency"]:
        raise ValueError(
            f"{what}: no rotative speed on the z axis (type {kind}); give it (speed=, rad/s; --speed, rpm)"
        )
    return float(record["z_axis_value"] * _rate(record, "z_axis"))


def _circular(x: _Row, y: _Row, source: str) -> Iterator[_Row]:
    """Responses to a circular force of 1 N, eq. (2): ``Fx = 1``, ``Fy = -j`` forward and ``+j`` backward."""
    w = x["frequency"]
    if w.shape != y["frequency"].shape or not np.allclose(w, y["frequency"], rtol=1e-5, atol=0):
        raise ValueError(
            f"{source}: the FRFs of {x['plane']} {x['direction']} to forces along x and y at {x['force_plane']} have "
            "different frequency lines; measure or export them on the same lines"
        )
    for sign, name in ((1.0, "fwd"), (-1.0, "bwd")):
        response = x["response"] - sign * 1j * y["response"]
        yield {**_named(x, name), "frequency": sign * w, "force_direction": "circular", "response": response}


def _named(frf: _Row, way: str) -> _Row:
    """An FRF with the name of its run: that of the file, the plane and the way of the force."""
    return {**frf, "run": f"{frf['run'] or 'frf'}-{frf['force_plane']}-{way}"}
