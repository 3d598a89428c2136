"""Tidy CSV files of static loads, impulses, ring-down records and tables of coefficients: their columns.

``run`` may be left out everywhere: one run. A plane left out is the journal.
"""

from __future__ import annotations

from collections.abc import Callable
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
from rotorfit.io.tables.wanted_columns import Columns, columns_for, optional, quantity, words
from rotorfit.models.array_types import Float, Text
from rotorfit.units import RPM_PER_RAD_S, UNITS, si_factor

if TYPE_CHECKING:
    from rotorfit.io.tables.table import Table

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
_COEFFICIENTS = {"kxx": "N_m", "kxy": "N_m", "cxx": "N_s_m", "cxy": "N_s_m", "mxx": "kg"}
"""Unit by coefficient."""
_SPEED = quantity("speed", "rpm", UNITS["frequency"])


def _groups(columns: Columns, run: Text, tolerance: float) -> Float:
    return group_speeds(columns.number("speed"), run, tolerance)


def _positive(columns: Columns, name: str) -> Float:
    """Noise column, NaN where it is blank or missing."""
    values = columns.number(name, blank=True)
    columns.refuse(values <= 0, name, "is no noise: positive, or blank where it is not known")
    return values


def _eccentricity(columns: Columns, *, blank: bool = False) -> Float:
    values = columns.number("eccentricity", blank=blank)
    columns.refuse(
        (values < 0) | (values >= 1),
        "eccentricity",
        "is no eccentricity: |displacement| / clearance, from 0 to below 1",
    )
    return values


def _static_test(table: Table, speed_tolerance: float) -> StaticTest:
    """Build a static test; columns: :data:`STATIC_COLUMNS`."""
    columns = columns_for(
        table,
        (
            words("run", needed=False),
            words("plane", needed=False),
            words("load_plane", needed=False),
            _SPEED,
            quantity("load", "N", UNITS["force"]),
            quantity("load", "deg", _ANGLES, name="angle"),
            quantity("x", "um", UNITS["length"]),
            quantity("y", "um", UNITS["length"]),
            optional("sigma", UNITS["length"]),
        ),
        STATIC_COLUMNS,
    )
    run, plane = columns.words("run", "static"), columns.words("plane", "journal")
    return StaticTest(
        run=run,
        speed=_groups(columns, run, speed_tolerance),
        load_plane=columns.words("load_plane") if columns.has("load_plane") else plane,
        load=columns.number("load") * np.exp(1j * columns.number("angle")),
        plane=plane,
        displacement=columns.number("x") + 1j * columns.number("y"),
        sigma=_positive(columns, "sigma"),
        attributes=columns.attributes,
        source=table.source,
    )


def _impulse_test(table: Table, speed_tolerance: float) -> ImpulseTest:
    """Build an impulse test; columns: :data:`IMPULSE_COLUMNS`."""
    by_ratio = bool(table.find("eccentricity", _PURE))
    position = (quantity("x", "um", UNITS["length"]), quantity("y", "um", UNITS["length"]))
    columns = columns_for(
        table,
        (
            words("run", needed=False),
            optional("eccentricity", _PURE),
            _SPEED,
            quantity("frequency", "rpm", UNITS["frequency"]),
            quantity("damping", "ratio", _PURE),
            *(() if by_ratio else position),
            optional("sigma", UNITS["frequency"]),
        ),
        IMPULSE_COLUMNS,
    )
    run, damping_ratio = columns.words("run", "impulse"), columns.number("damping")
    columns.refuse(
        np.abs(damping_ratio) >= 1, "damping", "is no damping ratio of a mode that vibrates, between -1 and 1"
    )
    nowhere = np.full(run.size, complex(np.nan))
    return ImpulseTest(
        run=run,
        speed=_groups(columns, run, speed_tolerance),
        frequency=columns.number("frequency"),
        damping_ratio=damping_ratio,
        eccentricity=_eccentricity(columns),
        position=nowhere if by_ratio else columns.number("x") + 1j * columns.number("y"),
        sigma=_positive(columns, "sigma"),
        attributes=columns.attributes,
        source=table.source,
    )


def _ring_down_test(table: Table, speed_tolerance: float) -> RingDownTest:
    """Build ring-down records; columns: :data:`RING_DOWN_COLUMNS`."""
    columns = columns_for(
        table,
        (
            words("run", needed=False),
            _SPEED,
            quantity("time", "s", _TIMES),
            quantity("x", "um", UNITS["length"]),
            quantity("y", "um", UNITS["length"]),
            optional("eccentricity", _PURE),
        ),
        RING_DOWN_COLUMNS,
    )
    run = columns.words("run", "ring-down")
    return RingDownTest(
        run=run,
        speed=_groups(columns, run, speed_tolerance),
        time=columns.number("time"),
        x=columns.number("x"),
        y=columns.number("y"),
        eccentricity=_eccentricity(columns, blank=True),
        attributes=columns.attributes,
        source=table.source,
    )


def _coefficient_table(table: Table, speed_tolerance: float) -> CoefficientTable:
    """Build a table of coefficients; columns: :data:`COEFFICIENT_COLUMNS`. Without runs, each speed is one."""
    columns = columns_for(
        table,
        (
            _SPEED,
            quantity("eccentricity", "ratio", _PURE),
            *(quantity(name, unit, {unit.lower(): 1.0}) for name, unit in _COEFFICIENTS.items()),
            optional("sigma", _PURE),
            words("run", needed=False),
        ),
        COEFFICIENT_COLUMNS,
    )
    run = columns.words("run")
    coefficients: dict[str, Any] = {name: columns.number(name) for name in _COEFFICIENTS}
    eccentricity = _eccentricity(columns)
    speed = _groups(columns, run, speed_tolerance)
    if not run.any():
        run = np.array([f"{value:.6g} rpm" for value in (speed * RPM_PER_RAD_S).tolist()])
    return CoefficientTable(
        run=run,
        speed=speed,
        eccentricity=eccentricity,
        sigma=_positive(columns, "sigma"),
        attributes=columns.attributes,
        source=table.source,
        **coefficients,
    )


BUILDERS: tuple[tuple[str, Callable[[Table, float], Experiment]], ...] = (
    ("time_", _ring_down_test),
    ("damping_ratio", _impulse_test),
    ("load_", _static_test),
    ("kxx_", _coefficient_table),
)
"""Beginning of a column name that tells an experiment, in files without force_plane and direction."""


def columns_of(test: Experiment) -> dict[str, NDArray[Any]]:
    """Columns of a CSV file by name, in rpm, um, N, degrees and s."""
    rpm = si_factor("frequency", "rpm")
    head: dict[str, NDArray[Any]] = {"run": test.run, "speed_rpm": test.speed / rpm}
    match test:
        case StaticTest():
            head |= {
                "load_plane": test.load_plane,
                "load_N": np.abs(test.load),
                "load_deg": np.degrees(np.angle(test.load)),
                "plane": test.plane,
                "x_um": test.displacement.real * 1e6,
                "y_um": test.displacement.imag * 1e6,
                "sigma_um": test.sigma * 1e6,
            }
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
            head |= {f"{name}_{unit}": getattr(test, name) for name, unit in _COEFFICIENTS.items()}
            head["sigma_ratio"] = test.sigma
        case _:
            raise TypeError(f"{type(test).__name__} is not one of the experiments of this module")
    optional = ("sigma_um", "sigma_rpm", "sigma_ratio", "eccentricity_ratio")
    return {name: v for name, v in head.items() if name not in optional or np.isfinite(v).any()}
