"""Universal files, dataset 58 (function at nodal DOF), through pyuff.

Written here. Readings of one channel in one run at one speed are one FRF, response over force, abscissa ``|w|`` in Hz,
``z`` axis the rotative speed in rpm (order 1 in a synchronous test). A force along an axis is the single-point
excitation of load case 0 with its reference direction; **load case 1 is a forward, 2 a backward circular force**, the s
of eq. (2). Nodes number
the planes, entity names and ID lines carry their names: line 2 the run, 3 the plane, 4 the force plane, 5 what the
record holds. Response direction 1, 2 are x, y; rotations follow ``phi = theta_y - j theta_x``, so ``rx`` = dx/ds is
direction 5 and ``ry`` = dy/ds is -4; 0 is the complex amplitude (``z``, ``rz``). What an FRF cannot hold follows as
general functions with the same function number: the force, rows, exact frequencies, varying speeds, noise, numeric
attributes.

Read from others: FRFs of ordinary shaker or hammer tests. A circular force is the sum of two of them,
``H_x F - j H_y F`` forward and ``H_x F + j H_y F`` backward, where both references x and y are there at a node; where
one is missing, the test is one with a force along an axis.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rotorfit.data.experiments import Experiment, PerturbationTest, perturbation_test
from rotorfit.models.array_types import ComplexArray, Float
from rotorfit.units import RAD_S_PER_RPM, UNITS

_MARK = "rotorfit circular force test"
_LINE = 80  # characters in an ID line
_CODES = {"x": 1, "y": 2, "rx": 5, "ry": -4, "z": 0, "rz": 0}
_DIRECTIONS = {1: ("x", 1.0), 2: ("y", 1.0), 5: ("rx", 1.0), 4: ("ry", -1.0)}
"""Direction and sign of a positive UFF direction; a negative one turns the sign."""

_DISPLACEMENT, _VELOCITY, _ACCELERATION, _FORCE, _FREQUENCY, _SPEED, _ORDER = 8, 11, 12, 13, 18, 19, 20
_DERIVATIVES = {_DISPLACEMENT: 0, _VELOCITY: 1, _ACCELERATION: 2}
_FRF, _GENERAL = 4, 0
_AXES = {1: "x", 2: "y"}


def write_uff(experiment: Experiment, path: str | Path) -> None:
    """Write a perturbation test as a universal file in ASCII, 12 digits (abscissa, by the format, 6).

    Raises:
        ValueError: another experiment, readings that are not finite, zero force, text attributes, names too long.
    """
    import pyuff

    if not isinstance(experiment, PerturbationTest):
        raise ValueError(f"a universal file holds perturbation tests only, not {type(experiment).__name__}; use netCDF")
    _refuse(experiment)
    planes = tuple(dict.fromkeys([*experiment.planes, *experiment.force_planes]))
    file = pyuff.UFF(str(path))
    records = [
        record
        for number, rows in enumerate(_series(experiment), 1)
        for record in _records(experiment, rows, planes, number)
    ]
    file.write_sets(records, mode="overwrite")


def _refuse(test: PerturbationTest) -> None:
    if not len(test):
        raise ValueError("nothing to write: the test has no readings")
    for name in ("response", "force", "frequency", "speed"):
        if not np.isfinite(getattr(test, name)).all():
            raise ValueError(f"cannot write a universal file: {name} is not finite everywhere; remove those readings")
    if (test.force == 0).any():
        raise ValueError("cannot write FRFs: the force is zero in some readings; remove them")
    text = [name for name, values in test.attributes.items() if values.dtype.kind not in "iufb"]
    if text:
        raise ValueError(f"a universal file holds numeric attributes only; drop {', '.join(text)}, or use netCDF")
    names = [*test.runs, *test.planes, *test.force_planes, *[f"attribute {name}" for name in test.attributes]]
    for name in names:
        if not name or len(name) > _LINE or name != name.strip() or not name.isascii() or not name.isprintable():
            raise ValueError(
                f"cannot write the name {name!r} to a universal file: up to {_LINE} plain ASCII characters, without "
                "blanks at the ends"
            )


def _series(test: PerturbationTest) -> Iterator[NDArray[np.intp]]:
    """Rows of each FRF: one channel, run, force plane, whirl direction and, unless it is swept, speed."""
    speed = [0.0] * len(test) if test.synchronous else test.speed.tolist()
    columns = (test.run, test.force_plane, test.force_direction, test.plane, test.direction, test.frequency < 0)
    groups: dict[Any, list[int]] = {}
    for row, key in enumerate(zip(*[column.tolist() for column in columns], speed, strict=True)):
        groups.setdefault(key, []).append(row)
    for rows in groups.values():
        yield np.array(rows)


def _records(
    test: PerturbationTest, rows: NDArray[np.intp], planes: Sequence[str], number: int
) -> Iterator[dict[str, Any]]:
    part = test.select(rows)
    plane, force_plane, direction = str(part.plane[0]), str(part.force_plane[0]), str(part.direction[0])
    swept = bool(np.ptp(part.speed) > 0) or test.synchronous
    common = {
        "type": 58, "func_id": number, "id1": _MARK, "id2": str(part.run[0]), "id3": plane, "id4": force_plane,
        "load_case_id": 0 if part.linear[0] else 2 if part.frequency[0] < 0 else 1,
        "rsp_ent_name": plane[:10], "rsp_node": planes.index(plane) + 1, "rsp_dir": _CODES[direction],
        "ref_ent_name": force_plane[:10], "ref_node": planes.index(force_plane) + 1,
        "ref_dir": 2 if part.force_direction[0] == "y" else 1,
        "orddenom_spec_data_type": 0,
        "z_axis_spec_data_type": _ORDER if swept else _SPEED,
        "z_axis_value": 1.0 if swept else float(part.speed[0]) / RAD_S_PER_RPM,
    }  # fmt: skip
    hertz = np.abs(part.frequency) / (2 * np.pi)
    over_frequency = {**common, "abscissa_spec_data_type": _FREQUENCY, "abscissa_axis_units_lab": "Hz"}
    frf = {"func_type": _FRF, "id5": f"frf {direction}", "ordinate_spec_data_type": _DISPLACEMENT}
    labels = {"ordinate_axis_units_lab": "rad" if direction[0] == "r" else "m", "orddenom_axis_units_lab": "N"}
    yield _function(
        {**over_frequency, **frf, **labels, "orddenom_spec_data_type": _FORCE}, hertz, part.response / part.force
    )
    force = {"func_type": _GENERAL, "id5": "force", "ordinate_spec_data_type": _FORCE, "ordinate_axis_units_lab": "N"}
    yield _function({**over_frequency, **force}, hertz, part.force)
    further = {"row": rows.astype(float), "frequency": part.frequency, "speed": part.speed, "sigma": part.sigma}
    for name, values in (further | {f"attribute {name}": v for name, v in part.attributes.items()}).items():
        present = np.isfinite(values)
        if present.any() or name.startswith("attribute"):
            index = np.flatnonzero(present)
            general = {"func_type": _GENERAL, "id5": name, "ordinate_spec_data_type": 0}
            yield _function({**common, **general}, index.astype(float), values[present].astype(float))


def _function(record: dict[str, Any], x: Float, y: NDArray[Any]) -> dict[str, Any]:
    """A record with its data; pyuff takes the step from the first two abscissae, so a single value is evenly spaced."""
    if x.size >= 2:
        return {**record, "x": x, "data": y, "abscissa_spacing": 0}
    if not x.size:  # an attribute without a single value: one point that belongs to no row
        x, y = np.array([-1.0]), np.array([0.0])
    return {**record, "x": np.array([x[0], x[0] + 1.0]), "data": y, "abscissa_spacing": 1}


def read_uff(path: str | Path, *, speed: float | None = None) -> PerturbationTest:
    """Read a universal file: one of ours, or FRFs of unidirectional tests with references x and y.

    Receptance, mobility and accelerance (ordinate displacement, velocity, acceleration) all become receptance. Units
    are taken from the axis labels, else from dataset 164, else SI.

    Args:
        path: the file.
        speed: rotative speed, rad/s, where the z axis does not give it.

    Raises:
        ValueError: not a universal file, no FRF in it, or one that does not make a circular force; says what is
        missing. FileNotFoundError: no such file.
    """
    import pyuff

    source = Path(path).name
    marks = re.findall(rb"(?m)^    -1 *\r?$", Path(path).read_bytes())
    if len(marks) % 2:
        raise ValueError(f"{source} is not a whole universal file: its last data set has no end; copy it again")
    try:
        content = pyuff.UFF(str(path)).read_sets()
    except Exception as error:  # pyuff raises nothing more specific
        raise ValueError(f"{source} is not a readable universal file: {error}") from error
    records = content if isinstance(content, list) else [content]
    functions = [record for record in records if record.get("type") == 58]
    if not functions:
        raise ValueError(f"{source} has no function at nodal DOF (dataset 58); nothing to read")
    if functions[0]["id1"] == _MARK:
        return _read_own(functions, source)
    scales: dict[str, Any] = next((record for record in records if record.get("type") == 164), {})
    return _read_foreign(functions, scales, speed, source)


def _read_own(functions: Sequence[dict[str, Any]], source: str) -> PerturbationTest:
    series: dict[int, dict[str, dict[str, Any]]] = {}
    for record in functions:
        role = "frf" if record["id5"].startswith("frf ") else record["id5"]
        series.setdefault(record["func_id"], {})[role] = record
    parts = [_own_series(roles, f"{source}, function {number}") for number, roles in series.items()]
    names = dict.fromkeys(name for part in parts for name in part["attributes"])
    order = np.argsort(np.concatenate([part.pop("row") for part in parts]), kind="stable")
    attributes = [part.pop("attributes") for part in parts]
    sizes = [part["frequency"].size for part in parts]
    blank = [np.full(size, np.nan) for size in sizes]
    joined = {
        name: np.concatenate([a.get(name, b) for a, b in zip(attributes, blank, strict=True)])[order] for name in names
    }
    columns: dict[str, Any] = {name: np.concatenate([part[name] for part in parts])[order] for name in parts[0]}
    return perturbation_test(**columns, attributes=joined, source=source)


def _own_series(roles: dict[str, dict[str, Any]], where: str) -> dict[str, Any]:
    """Columns of the readings of one FRF."""
    if "frf" not in roles or "force" not in roles:
        raise ValueError(f"{where}: the FRF or its force is missing, there are only {', '.join(roles)}; write it again")
    frf, force = roles["frf"], np.asarray(roles["force"]["data"], dtype=complex)
    size = len(frf["data"])
    if force.shape != (size,):
        raise ValueError(f"{where}: {size} values of the FRF but {force.size} of the force; write it again")

    def values(role: str, default: Float) -> Float:
        if role not in roles:
            return default
        at = np.round(roles[role]["x"]).astype(int)
        inside = (at >= 0) & (at < size)
        filled = np.full(size, np.nan)
        filled[at[inside]] = np.real(roles[role]["data"])[: at.size][inside]
        return filled

    sign = -1.0 if frf["load_case_id"] == 2 else 1.0
    frequency = values("frequency", sign * 2 * np.pi * np.asarray(frf["x"]))
    return {
        "run": np.full(size, frf["id2"]),
        "speed": values("speed", np.full(size, frf["z_axis_value"] * RAD_S_PER_RPM)),
        "frequency": frequency,
        "force_plane": np.full(size, frf["id4"]),
        "force": force,
        "force_direction": np.full(size, _AXES[abs(frf["ref_dir"])] if frf["load_case_id"] == 0 else "circular"),
        "plane": np.full(size, frf["id3"]),
        "direction": np.full(size, frf["id5"][4:]),
        "response": np.asarray(frf["data"]) * force,
        "sigma": values("sigma", np.full(size, np.nan)),
        "row": values("row", np.arange(size, dtype=float)),
        "attributes": {role[10:]: values(role, frequency) for role in roles if role.startswith("attribute ")},
    }


@dataclass(frozen=True)
class _Receptance:
    """One FRF of a unidirectional test in SI units: response at a channel to a force along x or y."""

    run: str
    speed: float
    plane: str
    direction: str
    force_plane: str
    force_axis: str
    frequency: Float
    values: ComplexArray


def _read_foreign(
    functions: Sequence[dict[str, Any]], scales: dict[str, Any], speed: float | None, source: str
) -> PerturbationTest:
    frfs = [record for record in functions if record["func_type"] == _FRF]
    if not frfs:
        kinds = sorted({record["func_type"] for record in functions})
        raise ValueError(f"{source} has functions of type {kinds} but no frequency response (type 4); nothing to read")
    names = _plane_names(frfs)
    receptances = [frf for frf in (_receptance(r, names, scales, speed, source) for r in frfs) if frf is not None]
    by_run = _by_channel(receptances)
    if _lonely(by_run):  # the second ID line may be a remark that differs between the two directions of force
        by_run = _by_channel([replace(frf, run="") for frf in receptances])
    if not by_run:
        raise ValueError(f"{source} has no FRF to a force along x or y, and none is lateral; nothing to read")
    alone = _lonely(by_run)  # planes without one of the two references: their force does not turn
    parts = [pair for key, (x, y) in by_run.items() if key[2] not in alone for pair in zip(x, y, strict=True)]
    rows = list(_circular(parts, source)) + list(_linear(frf for frf in receptances if frf.force_plane in alone))
    joined: dict[str, Any] = {
        name: np.concatenate(cells) for name, cells in zip(_COLUMNS, zip(*rows, strict=True), strict=True)
    }
    if not joined["frequency"].size:
        raise ValueError(f"{source}: no readings at frequencies above zero")
    return perturbation_test(**joined, force=1.0, source=source)


def _by_channel(frfs: Sequence[_Receptance]) -> dict[tuple[Any, ...], tuple[list[_Receptance], list[_Receptance]]]:
    """FRFs to forces along x and along y of each channel in each run; repeats in order of appearance."""
    found: dict[tuple[Any, ...], tuple[list[_Receptance], list[_Receptance]]] = {}
    for frf in frfs:
        key = (frf.run, frf.speed, frf.force_plane, frf.plane, frf.direction)
        found.setdefault(key, ([], []))["xy".index(frf.force_axis)].append(frf)
    return found


def _lonely(channels: dict[tuple[Any, ...], tuple[list[_Receptance], list[_Receptance]]]) -> set[str]:
    """Planes of forces whose partner along the other axis is missing."""
    return {key[2] for key, (x, y) in channels.items() if len(x) != len(y)}


def _plane_names(records: Sequence[dict[str, Any]]) -> dict[int, str]:
    """Entity names as names of planes where they tell the nodes apart, else the node numbers."""
    pairs = {(r[f"{end}_node"], r[f"{end}_ent_name"].strip()) for r in records for end in ("rsp", "ref")}
    names = dict(pairs)
    distinct = len(pairs) == len(names) == len(set(names.values()))
    usable = distinct and not {"", "NONE"} & {name.upper() for name in names.values()}
    return names if usable else {node: str(node) for node in names}


def _receptance(
    record: dict[str, Any], names: dict[int, str], scales: dict[str, Any], speed: float | None, source: str
) -> _Receptance | None:
    """One FRF in SI units, None for directions along the shaft and torsion."""
    what = f"{source}, FRF {record['rsp_node']}:{record['rsp_dir']} over {record['ref_node']}:{record['ref_dir']}"
    if abs(record["rsp_dir"]) not in _DIRECTIONS or abs(record["ref_dir"]) not in (1, 2):
        warnings.warn(f"{what} left out: not lateral (the shaft is taken along z)", stacklevel=2)
        return None
    if record["abscissa_spec_data_type"] not in (0, 1, _FREQUENCY, _SPEED):
        kind = record["abscissa_spec_data_type"]
        raise ValueError(f"{what}: the abscissa is of type {kind}; needed is frequency (18)")
    w = _rate(record, "abscissa") * np.asarray(record["x"], dtype=float)
    kind = record["ordinate_spec_data_type"]
    if kind not in _DERIVATIVES or record["orddenom_spec_data_type"] not in (0, _FORCE):
        raise ValueError(
            f"{what}: the ordinate is of type {kind} over {record['orddenom_spec_data_type']}; needed is displacement "
            "(8), velocity (11) or acceleration (12) over force (13)"
        )
    direction, sign = _DIRECTIONS[abs(record["rsp_dir"])]
    sign *= np.sign(record["rsp_dir"]) * np.sign(record["ref_dir"])
    angular = direction[0] == "r"
    length = 1.0 if angular else _scale(record, "ordinate", _LENGTHS, 1 / scales.get("length", 1.0), what)
    force = _scale(record, "orddenom", _FORCES, 1 / scales.get("force", 1.0), what)
    keep = (w > 0) & np.isfinite(record["data"])  # velocity and acceleration say nothing at zero frequency
    values = np.asarray(record["data"], dtype=complex)[keep] / (1j * w[keep]) ** _DERIVATIVES[kind]
    return _Receptance(
        run="" if record["id2"].upper() == "NONE" else record["id2"],
        speed=_speed(record, speed, what),
        plane=names[record["rsp_node"]],
        direction=direction,
        force_plane=names[record["ref_node"]],
        force_axis=_AXES[abs(record["ref_dir"])],
        frequency=w[keep],
        values=values * (sign * length / force),
    )


_LENGTHS = {"m": 1.0, "mm": 1e-3, "um": 1e-6, "in": 0.0254, "mil": 25.4e-6, "g": 9.80665, "gn": 9.80665}
_FORCES = {"n": 1.0, "kn": 1e3, "mn": 1e-3, "lbf": 4.4482216152605, "lb": 4.4482216152605}


def _scale(record: dict[str, Any], axis: str, units: dict[str, float], default: float, what: str) -> float:
    """Factor to SI from the label of an axis; ``mm/s^2`` counts as its length, time is always in seconds."""
    label = str(record.get(f"{axis}_axis_units_lab", "")).strip()
    word = label.strip("()[] ").split("/")[0].strip("()[] ").lower().replace("\u00b5", "u")
    if word in ("", "none"):
        return default
    if word not in units:
        warnings.warn(f"{what}: unit {label!r} is not known, taken as {default:g} SI units", stacklevel=2)
        return default
    return units[word]


def _rate(record: dict[str, Any], axis: str) -> float:
    """Factor to rad/s of an axis from its label, else from its type: rpm (19), anything else Hz."""
    label = str(record.get(f"{axis}_axis_units_lab", "")).strip("()[] ").lower().replace("/", "_")
    kind = "rpm" if record[f"{axis}_spec_data_type"] == _SPEED else "hz"
    return UNITS["frequency"].get(label, UNITS["frequency"][kind])


def _speed(record: dict[str, Any], speed: float | None, what: str) -> float:
    if speed is not None:
        return speed
    kind = record["z_axis_spec_data_type"]
    label = str(record.get("z_axis_axis_units_lab", "")).strip("()[] ").lower().replace("/", "_")
    if kind not in (_FREQUENCY, _SPEED) and label not in UNITS["frequency"]:
        raise ValueError(
            f"{what}: no rotative speed on the z axis (type {kind}); give it, read(path, speed=...) in rad/s"
        )
    return float(record["z_axis_value"] * _rate(record, "z_axis"))


def _circular(pairs: Sequence[tuple[_Receptance, _Receptance]], source: str) -> Iterator[_Cells]:
    """Responses to a circular force of 1 N, eq. (2): ``Fx = 1``, ``Fy = -j`` forward and ``+j`` backward."""
    for x, y in pairs:
        same = x.frequency.shape == y.frequency.shape and np.allclose(x.frequency, y.frequency, rtol=1e-5, atol=0)
        if not same:
            raise ValueError(
                f"{source}: the FRFs of {x.plane} {x.direction} to forces along x and y at {x.force_plane} have "
                "different frequency lines; measure or export them on the same lines"
            )
        for sign, name in ((1.0, "fwd"), (-1.0, "bwd")):
            yield _cells(x, name, "circular", sign * x.frequency, x.values - sign * 1j * y.values)


def _linear(frfs: Iterable[_Receptance]) -> Iterator[_Cells]:
    """Responses to a force of 1 N along an axis."""
    for frf in frfs:
        yield _cells(frf, frf.force_axis, frf.force_axis, frf.frequency, frf.values)


_COLUMNS = ("run", "speed", "frequency", "force_plane", "force_direction", "plane", "direction", "response")
_Cells = list[NDArray[Any]]


def _cells(frf: _Receptance, name: str, along: str, frequency: Float, response: ComplexArray) -> _Cells:
    run = f"{frf.run or 'frf'}-{frf.force_plane}-{name}"
    row = (run, frf.speed, frequency, frf.force_plane, along, frf.plane, frf.direction, response)
    return [np.broadcast_to(np.asarray(values), frequency.shape) for values in row]
