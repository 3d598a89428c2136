"""Tidy CSV files of static loads, impulses, ring-down records and tables of coefficients: their columns.

``run`` may be left out everywhere: one run. A plane left out is the journal.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rotorfit.data.experiments import (
    CoefficientTable,
    Experiment,
    ImpulseTest,
    RingDownTest,
    StaticTest,
)
from rotorfit.data.synchronous import group_speeds
from rotorfit.models.array_types import Float, Text
from rotorfit.units import RPM_PER_RAD_S, UNITS, si_factor

if TYPE_CHECKING:
    from rotorfit.io.csv_table import Table

STATIC_COLUMNS = (
    "speed_rpm, load_N, load_deg, x_um, y_um, optional run, plane and load_plane (by default journal), sigma_um; "
    "other units by suffix, further columns are attributes"
)
IMPULSE_COLUMNS = (
    "speed_rpm, frequency_rpm, damping_ratio, eccentricity_ratio (or x_um, y_um), optional run, sigma_rpm; other "
    "units by suffix, further columns are attributes"
)
RING_DOWN_COLUMNS = (
    "speed_rpm, time_s, x_um, y_um, optional run, eccentricity_ratio; other units by suffix, further columns are "
    "attributes"
)
COEFFICIENT_COLUMNS = (
    "speed_rpm, eccentricity_ratio, kxx_N_m, kxy_N_m, cxx_N_s_m, cxy_N_s_m, mxx_kg, optional run, sigma_ratio; "
    "further columns are attributes"
)

_ANGLES = {"deg": UNITS["phase"]["deg"], "rad": 1.0}
_TIMES = {"s": 1.0, "ms": 1e-3, "us": 1e-6}
_PURE = {"ratio": 1.0}
_COEFFICIENTS = {
    "kxx": {"n_m": 1.0}, "kxy": {"n_m": 1.0}, "cxx": {"n_s_m": 1.0}, "cxy": {"n_s_m": 1.0}, "mxx": {"kg": 1.0},
}  # fmt: skip
_WRITTEN = {"kxx": "kxx_N_m", "kxy": "kxy_N_m", "cxx": "cxx_N_s_m", "cxy": "cxy_N_s_m", "mxx": "mxx_kg"}


def _name(table: Table, column: str, otherwise: str) -> Text:
    if column in table.cells:
        return table.words(table.text(column))
    return np.full(len(table.lines), otherwise)


def _numbers(table: Table, columns: Mapping[str, tuple[str, float] | None], known: str) -> dict[str, Float]:
    """Required columns as numbers, after the check that all are there."""
    table.check_columns(known)
    return {name: table.number(column) for name, column in columns.items() if column is not None}


def _positive(table: Table, column: tuple[str, float] | None) -> Float:
    """Noise column, NaN where it is blank or missing."""
    if column is None:
        return np.full(len(table.lines), np.nan)
    values = table.number(column, blank=True)
    if (values <= 0).any():
        row = int(np.flatnonzero(values <= 0)[0])
        raise ValueError(f"{table.where(row, column[0])}: must be positive, or blank where the noise is not known")
    return values


def _eccentricity(table: Table, column: tuple[str, float], *, blank: bool = False) -> Float:
    values = table.number(column, blank=blank)
    bad = (values < 0) | (values >= 1)
    if bad.any():
        row = int(np.flatnonzero(bad)[0])
        raise ValueError(
            f"{table.where(row, column[0])}: {values[row]:g}; an eccentricity is |displacement| / clearance, from 0 "
            f"to below 1"
        )
    return values


def static_test(table: Table, speed_tolerance: float) -> StaticTest:
    """Build a static test; columns: :data:`STATIC_COLUMNS`.

    Raises:
        ValueError: what is wrong, in which line and column, and what is allowed.
    """
    run = _name(table, "run", "static")
    plane = _name(table, "plane", "journal")
    load_plane = _name(table, "load_plane", "journal") if "load_plane" in table.cells else plane
    columns = {
        "speed": table.one("speed", UNITS["frequency"], "speed_rpm"),
        "load": table.one("load", UNITS["force"], "load_N"),
        "angle": table.one("load", _ANGLES, "load_deg"),
        "x": table.one("x", UNITS["length"], "x_um"),
        "y": table.one("y", UNITS["length"], "y_um"),
    }
    sigma = table.one("sigma", UNITS["length"])
    v = _numbers(table, columns, STATIC_COLUMNS)
    return StaticTest(
        run=run, speed=group_speeds(v["speed"], np.zeros(run.size), run, speed_tolerance), load_plane=load_plane,
        load=v["load"] * np.exp(1j * v["angle"]), plane=plane, displacement=v["x"] + 1j * v["y"],
        sigma=_positive(table, sigma), attributes=table.attributes(), source=table.source,
    )  # fmt: skip


def impulse_test(table: Table, speed_tolerance: float) -> ImpulseTest:
    """Build an impulse test; columns: :data:`IMPULSE_COLUMNS`.

    Raises:
        ValueError: what is wrong, in which line and column, and what is allowed.
    """
    run = _name(table, "run", "impulse")
    ratio = table.one("eccentricity", _PURE)
    columns = {
        "speed": table.one("speed", UNITS["frequency"], "speed_rpm"),
        "frequency": table.one("frequency", UNITS["frequency"], "frequency_rpm"),
        "damping_ratio": table.one("damping", _PURE, "damping_ratio"),
    }
    if ratio is None:
        columns |= {axis: table.one(axis, UNITS["length"], f"{axis}_um") for axis in "xy"}
    sigma = table.one("sigma", UNITS["frequency"])
    v = _numbers(table, columns, IMPULSE_COLUMNS)
    if (np.abs(v["damping_ratio"]) >= 1).any():
        row = int(np.flatnonzero(np.abs(v["damping_ratio"]) >= 1)[0])
        raise ValueError(
            f"{table.where(row, 'damping_ratio')}: {v['damping_ratio'][row]:g}; a mode that vibrates has a damping "
            f"ratio between -1 and 1"
        )
    gap = np.full(run.size, np.nan)
    return ImpulseTest(
        run=run, speed=group_speeds(v["speed"], np.zeros(run.size), run, speed_tolerance), frequency=v["frequency"],
        damping_ratio=v["damping_ratio"], eccentricity=gap if ratio is None else _eccentricity(table, ratio),
        position=v["x"] + 1j * v["y"] if ratio is None else gap.astype(complex), sigma=_positive(table, sigma),
        attributes=table.attributes(), source=table.source,
    )  # fmt: skip


def ring_down_test(table: Table, speed_tolerance: float) -> RingDownTest:
    """Build ring-down records; columns: :data:`RING_DOWN_COLUMNS`.

    Raises:
        ValueError: what is wrong, in which line and column, and what is allowed.
    """
    run = _name(table, "run", "ring-down")
    columns = {
        "speed": table.one("speed", UNITS["frequency"], "speed_rpm"),
        "time": table.one("time", _TIMES, "time_s"),
        "x": table.one("x", UNITS["length"], "x_um"),
        "y": table.one("y", UNITS["length"], "y_um"),
    }
    ratio = table.one("eccentricity", _PURE)
    v = _numbers(table, columns, RING_DOWN_COLUMNS)
    return RingDownTest(
        run=run, speed=group_speeds(v["speed"], np.zeros(run.size), run, speed_tolerance), time=v["time"], x=v["x"],
        y=v["y"], eccentricity=np.full(run.size, np.nan) if ratio is None else _eccentricity(table, ratio, blank=True),
        attributes=table.attributes(), source=table.source,
    )  # fmt: skip


def coefficient_table(table: Table, speed_tolerance: float) -> CoefficientTable:
    """Build a table of coefficients; columns: :data:`COEFFICIENT_COLUMNS`. Without runs, each speed is one.

    Raises:
        ValueError: what is wrong, in which line and column, and what is allowed.
    """
    columns = {
        "speed": table.one("speed", UNITS["frequency"], "speed_rpm"),
        "eccentricity": table.one("eccentricity", _PURE, "eccentricity_ratio"),
        **{name: table.one(name, units, _WRITTEN[name]) for name, units in _COEFFICIENTS.items()},
    }
    sigma = table.one("sigma", _PURE)
    run = _name(table, "run", "")
    v = _numbers(table, columns, COEFFICIENT_COLUMNS)
    if columns["eccentricity"] is not None:
        _eccentricity(table, columns["eccentricity"])
    speed = group_speeds(v.pop("speed"), np.zeros(run.size), run, speed_tolerance)
    if not run.any():
        run = np.array([f"{value:.6g} rpm" for value in (speed * RPM_PER_RAD_S).tolist()])
    return CoefficientTable(
        run=run, speed=speed, sigma=_positive(table, sigma), attributes=table.attributes(), source=table.source, **v
    )


BUILDERS: tuple[tuple[str, Callable[[Table, float], Experiment]], ...] = (
    ("time_", ring_down_test),
    ("damping_ratio", impulse_test),
    ("load_", static_test),
    ("kxx_", coefficient_table),
)
"""Beginning of a column name that tells an experiment, in files without force_plane and direction."""


def columns_of(test: Experiment) -> dict[str, NDArray[Any]]:
    """Columns of a CSV file by name, in rpm, um, N, degrees and s.

    Raises:
        TypeError: an experiment of another kind.
    """
    rpm = si_factor("frequency", "rpm")
    head: dict[str, NDArray[Any]] = {"run": test.run, "speed_rpm": test.speed / rpm}
    match test:
        case StaticTest():
            head |= {
                "load_plane": test.load_plane, "load_N": np.abs(test.load),
                "load_deg": np.degrees(np.angle(test.load)), "plane": test.plane,
                "x_um": test.displacement.real * 1e6, "y_um": test.displacement.imag * 1e6,
                "sigma_um": test.sigma * 1e6,
            }  # fmt: skip
        case ImpulseTest():
            head |= {"frequency_rpm": test.frequency / rpm, "damping_ratio": test.damping_ratio}
            if np.isfinite(test.eccentricity).all():
                head["eccentricity_ratio"] = test.eccentricity
            elif np.isnan(test.eccentricity).all():
                head |= {"x_um": test.position.real * 1e6, "y_um": test.position.imag * 1e6}
            else:
                raise ValueError("a CSV holds impulses with eccentricities or with positions, not some with either")
            head["sigma_rpm"] = test.sigma / rpm
        case RingDownTest():
            head |= {"time_s": test.time, "x_um": test.x * 1e6, "y_um": test.y * 1e6}
            head["eccentricity_ratio"] = test.eccentricity
        case CoefficientTable():
            head["eccentricity_ratio"] = test.eccentricity
            head |= {column: getattr(test, name) for name, column in _WRITTEN.items()}
            head["sigma_ratio"] = test.sigma
        case _:
            raise TypeError(f"{type(test).__name__} is not one of the experiments of this module")
    optional = ("sigma_um", "sigma_rpm", "sigma_ratio", "eccentricity_ratio")
    return {name: v for name, v in head.items() if name not in optional or np.isfinite(v).any()}
