"""The tidy CSV: one row is one probe reading in one run at one frequency.

``run, speed_rpm, frequency_rpm, force_plane, force_N, force_phase_deg, plane, direction, amplitude_um, phase_deg`` with
comment lines ``#`` anywhere; the end of a name is the unit (:data:`rotorfit.base.units.UNITS`). In place of ``force_N``
an unbalance ``mr_g_mm`` (force m r w^2), in place of amplitude and phase ``real_um, imag_um``; ``sigma_um``,
``probe_radius_mm`` and ``force_direction`` (``circular``, or ``x``, ``y``: along an axis) are optional. Slopes
(direction ``rx`` = dx/ds, ``ry`` = dy/ds) have columns of their own, ``amplitude_urad`` and so on, or are readings of
an axial probe at ``probe_radius_mm``, positive when a positive slope gives a positive reading. Columns that are none of
these become test attributes. Left out, ``run`` is one for each forced plane and speed, ``plane`` the journal,
``force_plane`` the only plane; empty readings are skipped. Wide tables, a column a probe:
:mod:`rotorfit.lab.io.tables.headers`. Columns of the other experiments: :mod:`rotorfit.lab.io.tables.kinds`. Exports of
condition-monitoring systems: :mod:`rotorfit.lab.io.tables.machine_tables`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rotorfit.base.array_types import Float, Index, Text
from rotorfit.base.names import unknown_name
from rotorfit.base.units import UNITS
from rotorfit.estimators.blocks.row_keys import words as distinct
from rotorfit.estimators.blocks.set_speeds import SPEED_TOLERANCE
from rotorfit.lab.data.experiments import (
    DERIVATIVES,
    DIRECTIONS,
    FORCE_DIRECTIONS,
    FORCE_SIGMA,
    MEASURED,
    PerturbationTest,
    plane_groups,
)
from rotorfit.lab.data.joined import check_planes_spelt
from rotorfit.lab.data.rows import Experiment
from rotorfit.lab.data.several_forces import gathered
from rotorfit.lab.io.tables.cells import as_text
from rotorfit.lab.io.tables.headers import (
    is_text,
    is_unit,
    is_wide,
    quantity_meant,
    refuse_doubtful,
    tidy,
    understood,
    with_force_rows,
    with_given_names,
    with_orders,
)
from rotorfit.lab.io.tables.kinds import kind_of, line_test, read_kind
from rotorfit.lab.io.tables.machine_tables import BODE_HEADER, bode_table, is_sample_table, sample_table, with_weight
from rotorfit.lab.io.tables.motion import noise, response, with_amplitudes
from rotorfit.lab.io.tables.point_tables import point_table, points_above
from rotorfit.lab.io.tables.skipped_rows import (
    completed,
    with_reference_rows,
    without_empty,
    without_incoherent,
    without_standstill,
)
from rotorfit.lab.io.tables.stiffness_tables import is_stiffness, stiffness_table
from rotorfit.lab.io.tables.table import (
    PERTURBATION_COLUMNS,
    READING,
    Columns,
    Table,
    columns_for,
    phase_or_angle,
    quantity,
    read_table,
    words,
)
from rotorfit.lab.kinds.displacement_test import DisplacementTest

if TYPE_CHECKING:
    from pandas import DataFrame


def read_csv(
    path: str | Path | DataFrame,
    *,
    speed_tolerance: float = SPEED_TOLERANCE,
    sheet: str | None = None,
    columns: Mapping[str, str] | None = None,
    constants: Mapping[str, str | float] | None = None,
    on_lines: Callable[[Index], None] | None = None,
    progress: Callable[[float], None] | None = None,
) -> Experiment:
    """Read a tidy or wide CSV, or a sheet of an Excel file; the columns tell which experiment it is."""
    columns, constants = columns or {}, constants or {}
    if exported := sheet is None and isinstance(path, str | Path) and is_sample_table(Path(path)):
        table = sample_table(Path(path), columns)
    own = exported or bool({"plane", "direction"} & set(constants))
    points, beside = ({}, []) if own else points_above(path, sheet)
    if points:
        table = point_table(path, points, columns)
    elif not exported:
        table = read_table(
            path, sheet, lambda spelled: is_text(spelled, columns), is_unit, progress or (lambda share: None)
        )
        exported = set(BODE_HEADER) <= set(table.cells)
        table = with_given_names(table, columns) if columns else table
        table = (
            bode_table(table, {"plane", "direction"} <= set(constants)) if exported else with_orders(understood(table))
        )
    if taken := [name for name in constants if name.lower() in table.cells]:
        raise ValueError(f"{table.source} has a column {taken[0]!r} of its own; no constant may take its place")
    table = table.with_columns({name: [str(value)] * len(table.lines) for name, value in constants.items()})
    if beside:
        words = f"{table.source}: tables in other sheets are not read: {', '.join(beside)} (sheet=, --sheet)"
        table = table.noted("sheets", words)
    if exported:
        table = with_weight(table)
    else:
        refuse_doubtful(table)
        table = stiffness_table(table) if is_stiffness(table) else table
        table = tidy(table) if is_wide(table) else table
    return experiment_of(table, speed_tolerance, on_lines)


def experiment_of(
    table: Table,
    speed_tolerance: float,
    on_lines: Callable[[Index], None] | None = None,
) -> Experiment:
    """The experiment that a table holds; its columns tell which."""
    if {"line", "force_plane", "direction"} <= set(table.cells):
        return line_test(table, speed_tolerance)
    if "direction" in table.cells:
        table = with_force_rows(table)
    kind = kind_of(table)
    if kind is None:
        table = _start_up(with_reference_rows(with_amplitudes(table)))
    if kind in (None, DisplacementTest):
        table = without_standstill(without_incoherent(without_empty(table)))
        if kind is not None or "direction" in table.cells:
            table = completed(table, forced=kind is None)
    if on_lines is not None:
        on_lines(table.lines)
    with np.errstate(over="ignore", invalid="ignore"):  # what overflows is refused below, by name
        test = _perturbation(table, speed_tolerance) if kind is None else read_kind(kind, table, speed_tolerance)
    return replace(test, findings=table.found)


def _start_up(table: Table) -> Table:
    """A table over speed alone with its speed as frequency too, as a weight that the shaft turns, or the residual
    unbalance of a run without one, excites it; and a note where no weight is given."""
    speeds = [name for name in table.cells if name.startswith("speed_")]
    forced = any(name.startswith(("force_", "mr_")) and not name.startswith(_OF_WEIGHTS) for name in table.cells)
    weighted = any(name.startswith("mr_") for name in table.cells)
    if len(speeds) != 1 or any(name.startswith("frequency") for name in table.cells) or (forced and not weighted):
        return table
    if "direction" not in table.cells:
        return table
    places = [table.cells[name] for name in ("run", "plane", "direction") if name in table.cells]
    rows = list(zip(*places, table.cells[speeds[0]], strict=True))
    once_a_speed = len(set(rows)) == len(rows) > len(set(zip(*places, strict=True)))  # of several
    if not weighted and not once_a_speed:
        return table
    of_weights = [key for key in table.cells if key.startswith((*_OF_WEIGHTS, "mr_"))]
    if weighted and "run" not in table.cells:  # one for each weight
        runs = [" ".join(filter(None, row)) for row in zip(*(table.cells[key] for key in of_weights), strict=True)]
        table = table.with_columns({"run": runs})
    return with_weight(table)


_OF_WEIGHTS = ("force_plane", "force_phase", "force_angle")


def _perturbation(table: Table, speed_tolerance: float) -> PerturbationTest:
    columns = _perturbation_columns(table)
    run, force_plane, plane = (columns.words(name) for name in ("run", "force_plane", "plane"))
    direction = _among(columns, "direction", columns.words("direction"), DIRECTIONS)
    w = columns.number("frequency")
    force_direction = _force_directions(columns, w, direction)
    size = columns.number("mr") * w**2 if columns.has("mr") else columns.number("force")
    reading, order = response(columns, direction, w)
    sigma = noise(columns, direction, w, reading)
    force = size * np.exp(1j * columns.force_phase(w))
    if columns.has("force_angle"):
        still = force_direction != "circular"
        columns.refuse(still, "force_angle", "is the angle of a force along an axis; give its phase, force_phase_deg")
    said: dict[str, NDArray[Any]] = {MEASURED: np.array(list(DERIVATIVES))[order]} if order.any() else {}
    if columns.has("force_sigma"):
        said[FORCE_SIGMA] = columns.number("force_sigma")
        columns.refuse(said[FORCE_SIGMA] < 0, "force_sigma", "must not be negative; zero where the force is known")
    if columns.has("coherence") and not columns.has("averages"):
        said["coherence"] = columns.number("coherence", blank=True)
    if columns.has("averages") and not columns.has("coherence"):  # what nothing asks for is of the test
        said["averages"] = columns.number("averages", blank=True)
    if columns.has("probe_radius") and not np.char.startswith(direction, "r").any():
        said["probe_radius_m"] = columns.number("probe_radius", blank=True)
    omega = columns.number("speed")
    for name, values in {"force": force, "response": reading, "frequency": w, "speed": omega}.items():
        columns.refuse(~np.isfinite(values), "run", f"is a row whose {name} overflows; check its units")
    for values in (run, force_plane, plane, direction, w, omega, force, reading):
        values.flags.writeable = False  # so that the test holds them, and no copies
    written = PerturbationTest(
        run=run,
        force_plane=force_plane,
        plane=plane,
        direction=direction,
        sigma=sigma,
        speed=omega,
        frequency=w,
        force=force,
        response=reading,
        force_direction=force_direction,
        attributes=columns.attributes | said,
        speed_tolerance=speed_tolerance,
        source=table.source,
    )
    check_planes_spelt([written])
    if len(groups := plane_groups(written)) > 1 and max(map(len, groups)) > 1:
        listed = "; ".join(", ".join(group) for group in groups)
        raise ValueError(
            f"{table.source}: no run connects these groups of planes: {listed}. If they are two rigs, put them in two "
            f"files; if a plane goes by two names, use one"
        )
    return gathered(written, lambda row: f"{table.source}: line {table.lines[row]}")


def _perturbation_columns(table: Table) -> Columns:
    """The columns of a perturbation test: its force by force or unbalance, its motion by amplitude or real part."""
    unbalance = table.find("mr", UNITS["unbalance"])
    force = table.find("force", UNITS["force"])
    polar = not (table.find("real", READING) or table.find("imag", READING))
    columns = columns_for(
        table,
        (
            *(words(name) for name in ("run", "force_plane", "plane", "direction")),
            *(words(name, needed=False) for name in ("force_direction", "coherence", "averages")),
            quantity("speed", UNITS["frequency"], "rpm"),
            quantity("frequency", UNITS["frequency"], "rpm"),
            quantity("mr", UNITS["unbalance"]),
            quantity("force", UNITS["force"], "" if unbalance else "N"),
            *phase_or_angle(table),
            *(quantity(p, READING, "um", several=True) for p in (("amplitude",) if polar else ("real", "imag"))),
            *((quantity("phase", UNITS["phase"], "deg"),) if polar else ()),
            quantity("sigma", READING, several=True),
            quantity("force_sigma", UNITS["force"]),
            quantity("probe_radius", UNITS["length"]),
        ),
        PERTURBATION_COLUMNS,
    )
    if unbalance and force:
        given = " and ".join(table.names[next(iter(found))] for found in (force, unbalance))
        raise ValueError(f"{table.source}: both {given} are given; keep one of them")
    return columns


def _among(columns: Columns, name: str, cells: Text, allowed: Sequence[str], blank: str = "") -> Text:
    """Cells of a column that has to name some of few words, in lower case."""
    written, number = distinct(cells)
    for place, word in enumerate(written):
        if (word or blank).lower() not in allowed:
            row = int(np.argmax(number == place))
            raise ValueError(f"{columns.where(row, name)}: {unknown_name(name, word, allowed)}")
    return np.array([(word or blank).lower() for word in written])[number]


def _force_directions(columns: Columns, w: Float, direction: Text) -> Text:
    """Kind of each force, turning or along an axis; a blank cell is a circular force, as is a missing column."""
    if not columns.has("force_direction"):
        return np.broadcast_to("circular", w.shape)
    written = np.array(columns.table.cells["force_direction"], dtype=str)
    cells = _among(columns, "force_direction", written, FORCE_DIRECTIONS, "circular")
    backward = (cells != "circular") & (w < 0) & ~np.char.endswith(direction, "z")
    columns.refuse(backward, "force_direction", "is a force that does not turn; its frequency has to be positive")
    return cells


def _cell(value: Any) -> str:
    if not isinstance(value, str):
        return "" if value != value else f"{value:.15g}"  # noqa: PLR0124 - NaN
    if any(c in value for c in "\r\n") or value != value.strip():
        raise ValueError(f"cannot write the name {value!r} to a CSV: no line breaks and no blanks at its ends")
    text = str(as_text(value))
    return '"' + text.replace('"', '""') + '"' if any(c in text for c in ',;"#\t') else text


def written_columns(experiment: Experiment) -> dict[str, NDArray[Any]]:
    """Columns of a tidy CSV by name, in rpm, um (urad for slopes), N and degrees, attributes last."""
    experiment = experiment.stored_rows()
    columns = experiment.table_columns()
    own = (FORCE_SIGMA, "coherence")  # columns that are kept as attributes
    meant = {name for name in experiment.attributes if name not in own and quantity_meant(name)}
    taken = {*columns, *meant} & set(experiment.attributes)
    if taken:
        raise ValueError(f"attributes {', '.join(sorted(taken))} have the name of a column; rename them")
    return {name: np.asarray(values) for name, values in {**columns, **experiment.attributes}.items()}


def write_csv(experiment: Experiment, path: str | Path) -> None:
    """Write a tidy CSV, 15 significant digits."""
    columns = written_columns(experiment)
    rows = zip(*[values.tolist() for values in columns.values()], strict=True)
    lines = [",".join(map(_cell, row)) for row in [tuple(columns), *rows]]
    Path(path).write_text("\n".join(["# amplitudes 0-peak; phases lead", *lines, ""]), encoding="utf-8")
