"""Columns of tidy tables of all experiments but perturbation tests, read and written.

Of static loads, impulses, ring-down records and tables of coefficients ``run`` may be left out: one run. A plane left
out is the journal. A row of a line test is one spectral line of one signal.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rotorfit.data.experiments import (
    CoefficientTable,
    DisplacementTest,
    Experiment,
    ImpulseTest,
    LineTest,
    RingDownTest,
    StaticTest,
)
from rotorfit.data.synchronous import group_speeds
from rotorfit.io.tables.table import Columns, columns_for, optional, phase_or_angle, quantity, words
from rotorfit.models.array_types import Float
from rotorfit.units import RAD_S_PER_RPM, RPM_PER_RAD_S, UNITS

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
DISPLACEMENT_COLUMNS = (
    "run, speed_rpm, frequency_rpm, plane, amplitude_um, phase_deg, force_x_N, force_x_phase_deg, force_y_N, "
    "force_y_phase_deg, optional sigma_N; other units by suffix, further columns are attributes"
)
LINE_COLUMNS = (
    "run, speed_rpm, frequency_rpm, force_plane, force_N, force_phase_deg, plane, direction (z or twist), line (w, "
    "2Om-w, 1x, w-Om, ...), real_um, imag_um, sigma_um of motion, real_urad, imag_urad, sigma_urad of twist; further "
    "columns are attributes"
)

_PARTS = ("real", "imag", "sigma")
_TURNS = {"urad": 1e-6, "mrad": 1e-3, "rad": 1.0}
_ANGLES = {"deg": UNITS["phase"]["deg"], "rad": 1.0}
_TIMES = {"s": 1.0, "ms": 1e-3, "us": 1e-6}
_PURE = {"ratio": 1.0}
_COEFFICIENTS = {"kxx": "N_m", "kxy": "N_m", "cxx": "N_s_m", "cxy": "N_s_m", "mxx": "kg"}
"""Unit by coefficient."""
_SPEED = quantity("speed", "rpm", UNITS["frequency"])
_POSITION = (quantity("x", "um", UNITS["length"]), quantity("y", "um", UNITS["length"]))


def _made(kind: Callable[..., Any], columns: Columns, tolerance: float, run: str = "", **own: Any) -> Any:
    """A test with the columns that all kinds have, and those of its own; ``run`` is its name without a column of it."""
    runs = columns.words("run", run)
    speed = group_speeds(columns.number("speed"), runs, tolerance)
    return kind(run=runs, speed=speed, attributes=columns.attributes, source=columns.table.source, **own)


def _sigma(columns: Columns) -> Float:
    """Noise column, NaN where it is blank or missing."""
    values = columns.number("sigma", blank=True)
    columns.refuse(values <= 0, "sigma", "is no noise: positive, or blank where it is not known")
    return values


def _eccentricity(columns: Columns, *, blank: bool = False) -> Float:
    values = columns.number("eccentricity", blank=blank)
    columns.refuse(
        (values < 0) | (values >= 1),
        "eccentricity",
        "is no eccentricity: |displacement| / clearance, from 0 to below 1",
    )
    return values


def displacement_test(table: Table, speed_tolerance: float) -> DisplacementTest:
    """Build a test of imposed orbits; columns: :data:`DISPLACEMENT_COLUMNS`."""
    forces = [
        quantity(f"force_{axis}{part}", unit, UNITS[kind])
        for axis in "xy"
        for part, unit, kind in (("", "N", "force"), ("_phase", "deg", "phase"))
    ]
    columns = columns_for(
        table,
        (
            words("run"),
            words("plane"),
            _SPEED,
            quantity("frequency", "rpm", UNITS["frequency"]),
            quantity("amplitude", "um", UNITS["displacement"]),
            quantity("phase", "deg", UNITS["phase"]),
            *forces,
            optional("sigma", UNITS["force"]),
        ),
        DISPLACEMENT_COLUMNS,
    )
    run, frequency = columns.words("run"), columns.number("frequency")
    sigma = columns.number("sigma", blank=True)
    columns.refuse(sigma <= 0, "sigma", "must be positive, or blank where the noise is not known")
    test = DisplacementTest(
        run=run,
        plane=columns.words("plane"),
        sigma=sigma,
        frequency=frequency,
        speed=columns.number("speed"),
        speed_tolerance=speed_tolerance,
        displacement=columns.phasor("amplitude", "phase"),
        force_x=columns.phasor("force_x", "force_x_phase"),
        force_y=columns.phasor("force_y", "force_y_phase"),
        attributes=columns.attributes,
        source=table.source,
    )
    finite = np.isfinite(test.displacement) & np.isfinite(test.force_x) & np.isfinite(test.force_y)
    columns.refuse(~finite, "run", "is a row whose displacement or force overflows; check its units")
    return test


def line_test(table: Table, speed_tolerance: float) -> LineTest:
    """Build a line test; columns: :data:`LINE_COLUMNS`."""
    columns = columns_for(
        table,
        (
            *(words(name) for name in ("run", "force_plane", "plane", "direction", "line")),
            _SPEED,
            quantity("frequency", "rpm", UNITS["frequency"]),
            quantity("force", "N", UNITS["force"]),
            *phase_or_angle(table),
            *(quantity(part, "um", UNITS["length"]) for part in _PARTS),
            *(optional(part, _TURNS, name=f"{part} of twist") for part in _PARTS),
        ),
        LINE_COLUMNS,
    )
    direction, frequency = columns.words("direction"), columns.number("frequency")
    for row in np.flatnonzero(~np.isin(direction, ("z", "twist"))).tolist():
        raise ValueError(f"{table.where(row, 'direction')}: {str(direction[row])!r} unknown; allowed: z, twist")
    parts = {}
    for part in _PARTS:
        twisting = direction == "twist"
        motion, twist = columns.number(part, blank=True), columns.number(f"{part} of twist", blank=True)
        parts[part] = np.where(twisting, twist, motion)
        for row in np.flatnonzero(np.isnan(parts[part])).tolist() if part != "sigma" else ():
            wanted = f"{part}_urad" if twisting[row] else f"{part}_um"
            raise ValueError(f"{table.source}: line {table.lines[row]} has no {wanted}")
    made: LineTest = _made(
        LineTest,
        columns,
        speed_tolerance,
        frequency=frequency,
        force_plane=columns.words("force_plane"),
        force=columns.number("force") * np.exp(1j * columns.force_phase(frequency)),
        plane=columns.words("plane"),
        direction=direction,
        line=columns.words("line"),
        response=parts["real"] + 1j * parts["imag"],
        sigma=parts["sigma"],
    )
    return made


def _static_test(table: Table, speed_tolerance: float) -> Experiment:
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
            *_POSITION,
            optional("sigma", UNITS["length"]),
        ),
        STATIC_COLUMNS,
    )
    plane = columns.words("plane", "journal")
    made: StaticTest = _made(
        StaticTest,
        columns,
        speed_tolerance,
        run="static",
        load_plane=columns.words("load_plane") if columns.has("load_plane") else plane,
        load=columns.phasor("load", "angle"),
        plane=plane,
        displacement=columns.number("x") + 1j * columns.number("y"),
        sigma=_sigma(columns),
    )
    return made


def _impulse_test(table: Table, speed_tolerance: float) -> ImpulseTest:
    """Build an impulse test; columns: :data:`IMPULSE_COLUMNS`."""
    by_ratio = bool(table.find("eccentricity", _PURE))
    columns = columns_for(
        table,
        (
            words("run", needed=False),
            optional("eccentricity", _PURE),
            _SPEED,
            quantity("frequency", "rpm", UNITS["frequency"]),
            quantity("damping", "ratio", _PURE),
            *(() if by_ratio else _POSITION),
            optional("sigma", UNITS["frequency"]),
        ),
        IMPULSE_COLUMNS,
    )
    damping_ratio = columns.number("damping")
    columns.refuse(
        np.abs(damping_ratio) >= 1, "damping", "is no damping ratio of a mode that vibrates, between -1 and 1"
    )
    nowhere = np.full(columns.rows, complex(np.nan))
    made: ImpulseTest = _made(
        ImpulseTest,
        columns,
        speed_tolerance,
        run="impulse",
        frequency=columns.number("frequency"),
        damping_ratio=damping_ratio,
        eccentricity=_eccentricity(columns),
        position=nowhere if by_ratio else columns.number("x") + 1j * columns.number("y"),
        sigma=_sigma(columns),
    )
    return made


def _ring_down_test(table: Table, speed_tolerance: float) -> RingDownTest:
    """Build ring-down records; columns: :data:`RING_DOWN_COLUMNS`."""
    wanted = (
        words("run", needed=False),
        _SPEED,
        quantity("time", "s", _TIMES),
        *_POSITION,
        optional("eccentricity", _PURE),
    )
    columns = columns_for(table, wanted, RING_DOWN_COLUMNS)
    made: RingDownTest = _made(
        RingDownTest,
        columns,
        speed_tolerance,
        run="ring-down",
        time=columns.number("time"),
        x=columns.number("x"),
        y=columns.number("y"),
        eccentricity=_eccentricity(columns, blank=True),
    )
    return made


def _coefficient_table(table: Table, speed_tolerance: float) -> CoefficientTable:
    """Build a table of coefficients; columns: :data:`COEFFICIENT_COLUMNS`. Without runs, each speed is one."""
    wanted = (
        _SPEED,
        quantity("eccentricity", "ratio", _PURE),
        *(quantity(name, unit, {unit.lower(): 1.0}) for name, unit in _COEFFICIENTS.items()),
        optional("sigma", _PURE),
        words("run", needed=False),
    )
    columns = columns_for(table, wanted, COEFFICIENT_COLUMNS)
    coefficients: dict[str, Any] = {name: columns.number(name) for name in _COEFFICIENTS}
    own: dict[str, Any] = {**coefficients, "eccentricity": _eccentricity(columns), "sigma": _sigma(columns)}
    made: CoefficientTable = _made(CoefficientTable, columns, speed_tolerance, **own)
    if made.run.any():
        return made
    return replace(made, run=np.array([f"{value:.6g} rpm" for value in (made.speed * RPM_PER_RAD_S).tolist()]))


BUILDERS: tuple[tuple[str, Callable[[Table, float], Experiment]], ...] = (
    ("time_", _ring_down_test),
    ("damping_ratio", _impulse_test),
    ("load_", _static_test),
    ("kxx_", _coefficient_table),
)
"""Beginning of a column name that tells an experiment, in files without force_plane and direction."""


def columns_of(
    test: DisplacementTest | LineTest | StaticTest | ImpulseTest | RingDownTest | CoefficientTable,
) -> dict[str, NDArray[Any]]:
    """Columns of a CSV file by name, in rpm, um, urad, N, degrees and s."""
    head: dict[str, NDArray[Any]] = {"run": test.run, "speed_rpm": test.speed / RAD_S_PER_RPM}
    match test:
        case DisplacementTest():
            head |= {
                "frequency_rpm": test.frequency / RAD_S_PER_RPM,
                "plane": test.plane,
                "amplitude_um": np.abs(test.displacement) * 1e6,
                "phase_deg": np.degrees(np.angle(test.displacement)),
            }
            for axis, force in (("x", test.force_x), ("y", test.force_y)):
                head |= {f"force_{axis}_N": np.abs(force), f"force_{axis}_phase_deg": np.degrees(np.angle(force))}
            head["sigma_N"] = test.sigma
        case LineTest():
            head |= {
                "frequency_rpm": test.frequency / RAD_S_PER_RPM,
                "force_plane": test.force_plane,
                "force_N": np.abs(test.force),
                "force_phase_deg": np.degrees(np.angle(test.force)),
                "plane": test.plane,
                "direction": test.direction,
                "line": test.line,
            }
            values = {"real": test.response.real, "imag": test.response.imag, "sigma": test.sigma}
            for unit, rows in (("um", test.direction != "twist"), ("urad", test.direction == "twist")):
                if rows.any():
                    head |= {f"{name}_{unit}": np.where(rows, v * 1e6, np.nan) for name, v in values.items()}
            return head
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
            head |= {"frequency_rpm": test.frequency / RAD_S_PER_RPM, "damping_ratio": test.damping_ratio}
            if 0 < np.isfinite(test.eccentricity).sum() < len(test):
                raise ValueError("a CSV holds impulses with eccentricities or with positions, not some with either")
            place = {"x_um": test.position.real * 1e6, "y_um": test.position.imag * 1e6}
            head |= place if np.isnan(test.eccentricity).all() else {"eccentricity_ratio": test.eccentricity}
            head["sigma_rpm"] = test.sigma / RAD_S_PER_RPM
        case RingDownTest():
            head |= {"time_s": test.time, "x_um": test.x * 1e6, "y_um": test.y * 1e6}
            head["eccentricity_ratio"] = test.eccentricity
        case _:
            head["eccentricity_ratio"] = test.eccentricity
            head |= {f"{name}_{unit}": getattr(test, name) for name, unit in _COEFFICIENTS.items()}
            head["sigma_ratio"] = test.sigma
    left_out = ("sigma_N", "sigma_um", "sigma_rpm", "sigma_ratio", "eccentricity_ratio")  # where nothing is said
    return {name: v for name, v in head.items() if name not in left_out or np.isfinite(v).any()}
