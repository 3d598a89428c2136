"""Universal files, dataset 58 (function at nodal DOF), through pyuff.

Written here. Readings of one channel in one run at one speed are one FRF, response over force, abscissa ``|w|`` in Hz,
``z`` axis the rotative speed in rpm (order 1 in a synchronous test). A force along an axis is the single-point
excitation of load case 0 with its reference direction; **load case 1 is a forward, 2 a backward circular force**, the s
of eq. (2). Nodes number the planes, entity names and ID lines carry their names: line 2 the run, 3 the plane, 4 the
force plane, 5 what the record holds. Response direction 1, 2 are x, y; rotations follow ``phi = theta_y - j theta_x``,
so ``rx`` = dx/ds is direction 5 and ``ry`` = dy/ds is -4; 0 is the complex amplitude (``z``, ``rz``). What an FRF
cannot hold follows as general functions with the same function number: the force, rows, exact frequencies, varying
speeds, noise, numeric attributes.

Files of others: :mod:`rotorfit.lab.io.universal_foreign`.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rotorfit.base.array_types import Float, Index
from rotorfit.base.file_reading import reading
from rotorfit.base.units import RAD_S_PER_RPM
from rotorfit.lab.data.experiments import PerturbationTest
from rotorfit.lab.data.from_arrays import perturbation_test
from rotorfit.lab.data.rows import Experiment
from rotorfit.lab.data.several_forces import refuse_several
from rotorfit.lab.io.universal_file import universal_records
from rotorfit.lab.io.universal_foreign import AXES, DataType, FunctionType, read_foreign, turned

_MARK = "rotorfit circular force test"
_CODES = {"x": 1, "y": 2, "rx": 5, "ry": -4, "z": 0, "rz": 0}


def write_uff(experiment: Experiment, path: str | Path) -> None:
    """Write a perturbation test as a universal file in ASCII, 12 digits (abscissa, by the format, 6)."""
    import pyuff

    test = experiment.perturbation
    if test is None:
        raise ValueError(f"a universal file holds perturbation tests only, not {type(experiment).__name__}; use netCDF")
    _refuse(test)
    planes = tuple(dict.fromkeys([*test.planes, *test.force_planes]))
    # one channel, run, force plane, whirl direction and, unless it is swept, speed are one FRF
    speed = [0.0] * len(test) if test.synchronous else test.set_speed.tolist()
    names = ("run", "force_plane", "force_direction", "plane", "direction")
    keys = zip(*[getattr(test, name).tolist() for name in names], test.frequency < 0, speed, strict=True)
    series: dict[Any, list[int]] = {}
    for row, key in enumerate(keys):
        series.setdefault(key, []).append(row)
    records = [
        record
        for number, rows in enumerate(series.values(), 1)
        for record in _records(test, np.array(rows), planes, number)
    ]
    pyuff.UFF(str(path)).write_sets(records, mode="overwrite")


def _refuse(test: PerturbationTest) -> None:
    if not len(test):
        raise ValueError("nothing to write: the test has no readings")
    for name in ("response", "force", "frequency", "speed"):
        if not np.isfinite(getattr(test, name)).all():
            raise ValueError(f"cannot write a universal file: {name} is not finite everywhere; remove those readings")
    refuse_several(test, "a universal file")
    if (test.force == 0).any():
        raise ValueError("cannot write FRFs: the force is zero in some readings; remove them")
    text = [name for name, values in test.attributes.items() if values.dtype.kind not in "iufb"]
    if text:
        raise ValueError(f"a universal file holds numeric attributes only; drop {', '.join(text)}, or use netCDF")
    names = [*test.runs, *test.planes, *test.force_planes, *[f"attribute {name}" for name in test.attributes]]
    longest = 80  # characters in an ID line
    for name in names:
        if not name or len(name) > longest or name != name.strip() or not name.isascii() or not name.isprintable():
            raise ValueError(
                f"cannot write the name {name!r} to a universal file: up to {longest} plain ASCII characters, without "
                "blanks at the ends"
            )


def _records(test: PerturbationTest, rows: Index, planes: Sequence[str], number: int) -> Iterator[dict[str, Any]]:
    part = test.select(rows)
    plane, force_plane, direction = str(part.plane[0]), str(part.force_plane[0]), str(part.direction[0])
    swept = bool(np.ptp(part.set_speed) > 0) or test.synchronous
    common = {
        "type": 58, "func_id": number, "id1": _MARK, "id2": str(part.run[0]), "id3": plane, "id4": force_plane,
        "load_case_id": 0 if part.linear[0] else 2 if part.frequency[0] < 0 else 1,
        "rsp_ent_name": plane[:10], "rsp_node": planes.index(plane) + 1, "rsp_dir": _CODES[direction],
        "ref_ent_name": force_plane[:10], "ref_node": planes.index(force_plane) + 1,
        "ref_dir": 2 if part.force_direction[0] == "y" else 1,
        "orddenom_spec_data_type": 0,
        "z_axis_spec_data_type": DataType.ORDER if swept else DataType.SPEED,
        "z_axis_value": 1.0 if swept else float(part.set_speed[0]) / RAD_S_PER_RPM,
    }  # fmt: skip
    hertz = np.abs(part.frequency) / (2 * np.pi)
    over_frequency = {**common, "abscissa_spec_data_type": DataType.FREQUENCY, "abscissa_axis_units_lab": "Hz"}
    frf = {"func_type": FunctionType.FRF, "id5": f"frf {direction}", "ordinate_spec_data_type": DataType.DISPLACEMENT}
    labels = {"ordinate_axis_units_lab": "rad" if direction[0] == "r" else "m", "orddenom_axis_units_lab": "N"}
    receptance = {**over_frequency, **frf, **labels, "orddenom_spec_data_type": DataType.FORCE}
    yield _function(receptance, hertz, part.response / part.force)
    force = {"func_type": FunctionType.GENERAL, "id5": "force", "ordinate_spec_data_type": DataType.FORCE}
    yield _function({**over_frequency, **force, "ordinate_axis_units_lab": "N"}, hertz, part.force)
    further = {"row": rows.astype(float), "frequency": part.frequency, "speed": part.speed, "sigma": part.sigma}
    for name, values in (further | {f"attribute {name}": v for name, v in part.attributes.items()}).items():
        present = np.isfinite(values)
        if present.any() or name.startswith("attribute"):
            index = np.flatnonzero(present)
            general = {"func_type": FunctionType.GENERAL, "id5": name, "ordinate_spec_data_type": 0}
            yield _function({**common, **general}, index.astype(float), values[present].astype(float))


def _function(record: dict[str, Any], x: Float, y: NDArray[Any]) -> dict[str, Any]:
    """A record with its data; pyuff takes the step from the first two abscissae, so a single value is evenly spaced."""
    if x.size >= 2:
        return {**record, "x": x, "data": y, "abscissa_spacing": 0}
    if not x.size:  # an attribute without a single value: one point that belongs to no row
        x, y = np.array([-1.0]), np.array([0.0])
    return {**record, "x": np.array([x[0], x[0] + 1.0]), "data": y, "abscissa_spacing": 1}


def read_uff(path: str | Path, *, speed: float | None = None, axes: str = "xy") -> PerturbationTest:
    """Read a universal file: one of ours, or FRFs of unidirectional tests with references x and y.

    Receptance, mobility and accelerance (ordinate displacement, velocity, acceleration) all become receptance. Units
    are taken from the axis labels, else from dataset 164, else SI.
    """
    source = Path(path).name
    with reading(source, "universal file"):
        records = universal_records(Path(path))
    functions = [record for record in records if record.get("type") == 58]
    if not functions:
        raise ValueError(f"{source} has no function at nodal DOF (dataset 58); nothing to read")
    if functions[0]["id1"] == _MARK:
        if axes != "xy":
            raise ValueError(f"{source} was written by rotorfit with its own x and y: leave them out (axes=, --axes)")
        return _read_own(functions, source)
    scales: dict[str, Any] = next((record for record in records if record.get("type") == 164), {})
    return read_foreign(turned(functions, axes), scales, speed, source)


def _read_own(functions: Sequence[dict[str, Any]], source: str) -> PerturbationTest:
    series: dict[int, dict[str, dict[str, Any]]] = {}
    for record in functions:
        role = "frf" if record["id5"].startswith("frf ") else record["id5"]
        series.setdefault(record["func_id"], {})[role] = record
    names = dict.fromkeys(role for roles in series.values() for role in roles if role.startswith("attribute "))
    parts = [_own_series(roles, names, f"{source}, function {number}") for number, roles in series.items()]
    columns: dict[str, Any] = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    order = np.argsort(columns.pop("row"), kind="stable")
    columns = {name: values[order] for name, values in columns.items()}
    attributes = {name.removeprefix("attribute "): columns.pop(name) for name in names}
    return perturbation_test(**columns, attributes=attributes, source=source)


def _own_series(roles: dict[str, dict[str, Any]], attributes: Iterable[str], where: str) -> dict[str, Any]:
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
    unknown = np.full(size, np.nan)
    return {
        "run": np.full(size, frf["id2"]),
        "speed": values("speed", np.full(size, frf["z_axis_value"] * RAD_S_PER_RPM)),
        "frequency": values("frequency", sign * 2 * np.pi * np.asarray(frf["x"])),
        "force_plane": np.full(size, frf["id4"]),
        "force": force,
        "force_direction": np.full(size, AXES[abs(frf["ref_dir"])] if frf["load_case_id"] == 0 else "circular"),
        "plane": np.full(size, frf["id3"]),
        "direction": np.full(size, frf["id5"][4:]),
        "response": np.asarray(frf["data"]) * force,
        "sigma": values("sigma", unknown),
        "row": values("row", np.arange(size, dtype=float)),
        **{name: values(name, unknown) for name in attributes},
    }
