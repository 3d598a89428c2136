"""The tidy CSV: one row is one probe reading in one run at one frequency.

``run, speed_rpm, frequency_rpm, force_plane, force_N, force_phase_deg, plane, direction, amplitude_um, phase_deg`` with
comment lines ``#`` anywhere; the end of a name is the unit (:data:`rotorfit.units.UNITS`). In place of ``force_N`` an
unbalance ``mr_g_mm`` (force m r w^2), in place of amplitude and phase ``real_um, imag_um``; ``sigma_um``,
``probe_radius_mm`` and ``force_direction`` (``circular``, or ``x``, ``y``: along an axis) are optional. Slopes
(direction ``rx`` = dx/ds, ``ry`` = dy/ds) have columns of their own, ``amplitude_urad`` and so on, or are readings of
an axial probe at ``probe_radius_mm``, positive when a positive slope gives a positive reading. Columns that are none of
these become test attributes. Left out, ``run`` is one for each forced plane and speed, ``plane`` the journal,
``force_plane`` the only plane; empty readings are skipped. Wide tables, a column a probe: :mod:`rotorfit.io.wide`.
Columns of the other experiments: :mod:`rotorfit.io.csv_kinds`. Exports of condition-monitoring systems:
:mod:`rotorfit.io.machine_tables`.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from rotorfit.data.experiments import (
    DIRECTIONS,
    FORCE_DIRECTIONS,
    DisplacementTest,
    Experiment,
    LineTest,
    PerturbationTest,
    plane_groups,
)
from rotorfit.data.findings import Finding
from rotorfit.data.synchronous import SPEED_TOLERANCE, group_speeds
from rotorfit.io.csv_kinds import BUILDERS, columns_of
from rotorfit.io.csv_table import MOTION, PERTURBATION_COLUMNS, Table, read_table
from rotorfit.io.left_out import completed, without_empty
from rotorfit.io.line_csv import line_columns, line_test
from rotorfit.io.machine_samples import is_sample_table, sample_table
from rotorfit.io.machine_tables import BODE_HEADER, bode_table, with_weight, without_weight_finding
from rotorfit.io.wide import is_wide, renamed, tidy, with_constants
from rotorfit.models.array_types import Bool, ComplexArray, Float, Text
from rotorfit.models.parameters import unknown_name
from rotorfit.units import UNITS, si_factor, units_of

DISPLACEMENT_COLUMNS = (
    "run, speed_rpm, frequency_rpm, plane, amplitude_um, phase_deg, force_x_N, force_x_phase_deg, force_y_N, "
    "force_y_phase_deg, optional sigma_N; other units by suffix, further columns are attributes"
)


def read_csv(
    path: str | Path,
    *,
    speed_tolerance: float = SPEED_TOLERANCE,
    sheet: str | None = None,
    columns: Mapping[str, str] | None = None,
    constants: Mapping[str, str | float] | None = None,
    on_finding: Callable[[Finding], None] | None = None,
) -> Experiment:
    """Read a tidy or wide CSV, or a sheet of an Excel file; the columns tell which experiment it is.

    Args:
        path: the file.
        speed_tolerance: see :func:`group_speeds`.
        sheet, columns, constants: see :func:`rotorfit.read`.
        on_finding: called with what was left out.

    Raises:
        ValueError: what is wrong, in which line and column, and what is allowed.
        FileNotFoundError: no such file.
    """
    table, found = _opened(path, sheet, columns or {}, constants or {})
    for finding in found:
        (on_finding or _warn)(finding)
    return experiment_of(table, speed_tolerance, on_finding)


def experiment_of(
    table: Table, speed_tolerance: float, on_finding: Callable[[Finding], None] | None = None
) -> Experiment:
    """The experiment that a table holds; its columns tell which.

    Args:
        table: columns of text.
        speed_tolerance: see :func:`group_speeds`.
        on_finding: called with what was left out.

    Raises:
        ValueError: what is wrong, in which line and column, and what is allowed.
    """
    # A perturbation test may have attributes named like the marks of the others.
    if {"line", "force_plane", "direction"} <= set(table.cells):
        return line_test(table, speed_tolerance)
    kinds = _KINDS if {"force_plane", "direction"} & set(table.cells) else (*_KINDS, *BUILDERS)
    build = next((b for mark, b in kinds if any(name.startswith(mark) for name in table.cells)), _perturbation)
    if build in (_perturbation, _displacement):
        table, found = without_empty(table)
        for finding in found:
            (on_finding or _warn)(finding)
        if "direction" in table.cells or build is _displacement:
            table = completed(table, forced=build is _perturbation)
    with np.errstate(over="ignore", invalid="ignore"):  # what overflows is refused below, by name
        return build(table, speed_tolerance)


def lines_of(
    path: str | Path,
    *,
    sheet: str | None = None,
    columns: Mapping[str, str] | None = None,
    constants: Mapping[str, str | float] | None = None,
) -> list[int]:
    """Line of the file, or row of the sheet, of each reading that :func:`read_csv` finds there.

    Args:
        path, sheet, columns, constants: as there.
    """
    table, _ = _opened(path, sheet, columns or {}, constants or {})
    return list(without_empty(table)[0].lines)


def _opened(
    path: str | Path, sheet: str | None, columns: Mapping[str, str], constants: Mapping[str, str | float]
) -> tuple[Table, list[Finding]]:
    """The tidy table of a file, whatever its layout, and what was left out of it."""
    found: list[Finding] = []
    samples = sheet is None and is_sample_table(Path(path))
    bode = False
    if samples:
        table, found = sample_table(Path(path), columns)
    else:
        table = read_table(path, sheet)
        bode = set(BODE_HEADER) <= set(table.cells)
        table = renamed(table, columns) if columns else table
    if bode:
        table, found = bode_table(table, {"plane", "direction"} <= set(constants))
    table = with_constants(table, constants) if constants else table
    if samples or bode:
        return with_weight(table), found + without_weight_finding(table)
    return (tidy(table) if is_wide(table) else table), found


def _warn(finding: Finding) -> None:
    warnings.warn(finding.message, stacklevel=4)


def _perturbation(table: Table, speed_tolerance: float) -> PerturbationTest:
    text = [table.text(name) for name in ("run", "force_plane", "plane", "direction")]
    along = table.text("force_direction") if "force_direction" in table.cells else None
    speed = table.one("speed", UNITS["frequency"], "speed_rpm")
    frequency = table.one("frequency", UNITS["frequency"], "frequency_rpm")
    unbalance = table.one("mr", UNITS["unbalance"])
    force = table.one("force", UNITS["force"], "" if unbalance else "force_N")
    force_phase = table.one("force_phase", UNITS["phase"], "force_phase_deg")
    polar = not (table.find("real", MOTION) or table.find("imag", MOTION))
    motion = [table.find(p, MOTION, f"{p}_um") for p in (("amplitude",) if polar else ("real", "imag"))]
    phase = table.one("phase", UNITS["phase"], "phase_deg") if polar else None
    sigma = table.find("sigma", MOTION)
    radius = table.one("probe_radius", UNITS["length"])
    table.check_columns(PERTURBATION_COLUMNS)
    if unbalance and force:
        given = f"{table.names[force[0]]} and {table.names[unbalance[0]]}"
        raise ValueError(f"{table.source}: both {given} are given; keep one of them")

    run, force_plane, plane, direction = (table.words(name) for name in text)
    direction = _directions(table, direction)
    w = table.number(_there(frequency))
    force_direction = _force_directions(table, along, w, direction)
    size = table.number(_there(unbalance)) * w**2 if unbalance else table.number(_there(force))
    parts = [_motion(table, columns, direction, radius) for columns in motion]
    response = _polar(table, motion[0], parts[0], table.number(_there(phase))) if polar else parts[0] + 1j * parts[1]
    noise = _motion(table, sigma, direction, radius, blank=True) if sigma else np.full(run.shape, np.nan)
    _refuse(table, noise <= 0, next(iter(sigma), ""), "must be positive, or blank where the noise is not known")
    angle = table.number(_there(force_phase))
    omega = group_speeds(table.number(_there(speed)), w, run, speed_tolerance)
    columns = {"force": size * np.exp(1j * angle), "response": response, "frequency": w, "speed": omega}
    for name, values in columns.items():
        _refuse(table, ~np.isfinite(values), "run", f"is a row whose {name} overflows; check its units")
    test = PerturbationTest(
        run=run, force_plane=force_plane, plane=plane, direction=direction, sigma=noise,
        speed=omega, frequency=w, force=columns["force"], response=response, force_direction=force_direction,
        attributes=table.attributes(), source=table.source,
    )  # fmt: skip
    if len(groups := plane_groups(test)) > 1 and max(map(len, groups)) > 1:
        listed = "; ".join(", ".join(group) for group in groups)
        raise ValueError(
            f"{test.source}: no run connects these groups of planes: {listed}. If they are two rigs, put them in two "
            f"files; if a plane goes by two names, use one"
        )
    return test


def _displacement(table: Table, speed_tolerance: float) -> DisplacementTest:
    text = [table.text(name) for name in ("run", "plane")]
    needed = {
        "speed": table.one("speed", UNITS["frequency"], "speed_rpm"),
        "frequency": table.one("frequency", UNITS["frequency"], "frequency_rpm"),
        "amplitude": table.one("amplitude", UNITS["displacement"], "amplitude_um"),
        "phase": table.one("phase", UNITS["phase"], "phase_deg"),
        **{
            f"force_{axis}{part}": table.one(f"force_{axis}{part}", UNITS[kind], f"force_{axis}{part}_{unit}")
            for axis in "xy"
            for part, kind, unit in (("", "force", "N"), ("_phase", "phase", "deg"))
        },
    }
    sigma = table.one("sigma", UNITS["force"])
    table.check_columns(DISPLACEMENT_COLUMNS)

    run, plane = (table.words(name) for name in text)
    v = {name: table.number(_there(column)) for name, column in needed.items()}
    noise = table.number(sigma, blank=True) if sigma else np.full(run.shape, np.nan)
    _refuse(
        table,
        noise <= 0,
        sigma[0] if sigma else "",
        "must be positive, or blank where the noise is not known",
    )
    test = DisplacementTest(
        run=run, plane=plane, sigma=noise, frequency=v["frequency"],
        speed=group_speeds(v["speed"], v["frequency"], run, speed_tolerance),
        displacement=v["amplitude"] * np.exp(1j * v["phase"]),
        force_x=v["force_x"] * np.exp(1j * v["force_x_phase"]),
        force_y=v["force_y"] * np.exp(1j * v["force_y_phase"]),
        attributes=table.attributes(), source=table.source,
    )  # fmt: skip
    finite = np.isfinite(test.displacement) & np.isfinite(test.force_x) & np.isfinite(test.force_y)
    _refuse(table, ~finite, "run", "is a row whose displacement or force overflows; check its units")
    return test


_KINDS: tuple[tuple[str, Callable[[Table, float], Experiment]], ...] = (
    ("force_x_", _displacement),
    ("force_y_", _displacement),
)
"""Beginning of a column name that tells an experiment, and what builds it; a perturbation test if none is there."""


def _there(column: tuple[str, float] | None) -> tuple[str, float]:
    if column is None:  # check_columns has refused the table before
        raise ValueError("a required column is missing")
    return column


def _directions(table: Table, cells: Text) -> Text:
    direction: Text = np.char.lower(cells)
    unknown = ~np.isin(direction, DIRECTIONS)
    if unknown.any():
        row = int(np.flatnonzero(unknown)[0])
        raise ValueError(f"{table.where(row, 'direction')}: {unknown_name('direction', str(cells[row]), DIRECTIONS)}")
    return direction


def _force_directions(table: Table, name: str | None, w: Float, direction: Text) -> Text:
    """Whether each force turns or acts along an axis; a blank cell is a circular force, as is a missing column."""
    if name is None:
        return np.full(w.shape, "circular")
    cells = np.array([cell.lower() or "circular" for cell in table.cells[name]])
    unknown = ~np.isin(cells, FORCE_DIRECTIONS)
    if unknown.any():
        row = int(np.flatnonzero(unknown)[0])
        raise ValueError(
            f"{table.where(row, name)}: {unknown_name('force_direction', table.cells[name][row], FORCE_DIRECTIONS)}"
        )
    backward = (cells != "circular") & (w < 0) & ~np.char.endswith(direction, "z")
    _refuse(table, backward, name, "is a force that does not turn; its frequency has to be positive")
    return cells


def _refuse(table: Table, bad: Bool, name: str, why: str) -> None:
    if bad.any():
        row = int(np.flatnonzero(bad)[0])
        raise ValueError(f"{table.where(row, name)}: {table.cells[name][row]} {why}")


def _polar(table: Table, columns: Iterable[str], amplitude: Float, phase: Float) -> ComplexArray:
    # a negative amplitude is a real part, a level in dB or a sign slip, never an amplitude
    for name in columns:
        values = table.number((name, 1.0), blank=True)
        _refuse(table, values < 0, name, "is negative; amplitudes are not, real parts go to real_um, imag_um")
    return np.asarray(amplitude * np.exp(1j * phase))


def _motion(
    table: Table,
    columns: Mapping[str, float],
    direction: Text,
    radius: tuple[str, float] | None,
    *,
    blank: bool = False,
) -> Float:
    """Each row's value from the column of its kind; a slope is an angle, or a length over the probe's radius."""
    tilt = np.char.startswith(direction, "r")
    angles = units_of("tilt")
    by_kind: dict[bool, list[str]] = {
        kind: [c for c in columns if (c.split("_", 1)[1] in angles) == kind] for kind in (False, True)
    }
    for names in by_kind.values():
        if len(names) > 1:
            raise ValueError(f"{table.source}: given twice, as {' and '.join(names)}; keep one of them")
    value = np.full(direction.shape, np.nan)
    for name in by_kind[False]:
        length = table.number((name, columns[name]), blank=True)
        value = np.where(tilt, np.nan, length)
        if radius:
            r = table.number(radius, blank=True)
            value = np.where(tilt, np.divide(length, r, out=np.full_like(length, np.nan), where=r != 0), length)
            if name.startswith("sigma"):
                value = np.abs(value)
    for name in by_kind[True]:
        angle = table.number((name, columns[name]), blank=True)
        value = np.where(tilt & np.isfinite(angle), angle, value)
    lacking = np.isnan(value) & (not blank)
    if lacking.any():
        row = int(np.flatnonzero(lacking)[0])
        what = (
            f"{next(iter(columns)).split('_')[0]}_urad, or a length with probe_radius_mm," if tilt[row] else "a length"
        )
        raise ValueError(
            f"{table.source}: line {table.lines[row]}, direction {direction[row]}: {what} is needed, "
            f"columns {', '.join(columns)} give none"
        )
    return value


def _cell(value: Any) -> str:
    if not isinstance(value, str):
        return "" if value != value else f"{value:.15g}"  # noqa: PLR0124 - NaN
    if any(c in value for c in "\r\n") or value != value.strip():
        raise ValueError(f"cannot write the name {value!r} to a CSV: no line breaks and no blanks at its ends")
    return '"' + value.replace('"', '""') + '"' if any(c in value for c in ',;"#\t') else value


def _perturbation_columns(test: PerturbationTest) -> dict[str, Any]:
    tilt = np.char.startswith(test.direction, "r")
    columns: dict[str, Any] = {
        "run": test.run,
        "speed_rpm": test.speed / si_factor("frequency", "rpm"),
        "frequency_rpm": test.frequency / si_factor("frequency", "rpm"),
        "force_plane": test.force_plane,
        "force_N": np.abs(test.force),
        "force_phase_deg": np.degrees(np.angle(test.force)),
        "plane": test.plane,
        "direction": test.direction,
    }
    if test.linear.any():
        columns["force_direction"] = test.force_direction
    values = {"amplitude": np.abs(test.response)}
    if np.isfinite(test.sigma).any():
        values["sigma"] = test.sigma
    for name, value in values.items():
        if not tilt.all():
            columns[f"{name}_um"] = np.where(tilt, np.nan, value * 1e6)
        if tilt.any():
            columns[f"{name}_urad"] = np.where(tilt, value * 1e6, np.nan)
    columns["phase_deg"] = np.degrees(np.angle(test.response))
    return columns


def _displacement_columns(test: DisplacementTest) -> dict[str, Any]:
    columns: dict[str, Any] = {
        "run": test.run,
        "speed_rpm": test.speed / si_factor("frequency", "rpm"),
        "frequency_rpm": test.frequency / si_factor("frequency", "rpm"),
        "plane": test.plane,
        "amplitude_um": np.abs(test.displacement) * 1e6,
        "phase_deg": np.degrees(np.angle(test.displacement)),
    }
    for axis, force in (("x", test.force_x), ("y", test.force_y)):
        columns[f"force_{axis}_N"] = np.abs(force)
        columns[f"force_{axis}_phase_deg"] = np.degrees(np.angle(force))
    return columns | ({"sigma_N": test.sigma} if np.isfinite(test.sigma).any() else {})


def write_csv(experiment: Experiment, path: str | Path) -> None:
    """Write a tidy CSV in rpm, um (urad for slopes), N and degrees, 15 significant digits.

    Raises:
        ValueError: a name that a CSV cell cannot hold, or an attribute named like a column.
    """
    if isinstance(experiment, PerturbationTest):
        columns = _perturbation_columns(experiment)
    elif isinstance(experiment, DisplacementTest):
        columns = _displacement_columns(experiment)
    elif isinstance(experiment, LineTest):
        columns = line_columns(experiment)
    else:
        columns = columns_of(experiment)
    taken = set(columns) & set(experiment.attributes)
    if taken:
        raise ValueError(f"attributes {', '.join(sorted(taken))} have the name of a column; rename them")
    columns |= experiment.attributes
    rows = zip(*[np.asarray(values).tolist() for values in columns.values()], strict=True)
    lines = [",".join(map(_cell, row)) for row in [tuple(columns), *rows]]
    Path(path).write_text("\n".join(["# amplitudes 0-peak; phases lead", *lines, ""]), encoding="utf-8")
