"""Published dynamic stiffness as a test: the forces along x and y that circular orbits would take.

Columns are ``Re_Hxx_MN_m``, ``Im_Hxx_MN_m``, ... over frequency: real and imaginary part of the four elements of a
matrix of force over displacement, or of xx and xy alone where yx = -xy and yy = xx. The letter is H, K, Z, D, F.
A row becomes two runs with an orbit of one micrometre, forward and backward, whose noise is independent. A column
``sigma_MN_m`` is the noise of each real and imaginary part; without it, it is what cubic curves over frequency leave.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from rotorfit.base.array_types import ComplexArray, Float
from rotorfit.base.digits import significant
from rotorfit.base.units import UNITS, find_unit
from rotorfit.lab.io.tables.cells import Numbers

if TYPE_CHECKING:
    from rotorfit.lab.io.tables.table import Table

_NAME = re.compile(
    r"(re|real|im|imag)[ _(]*(?:dynamic[ _]*stiffness|[hkzdf])?[ _]*(xx|xy|yx|yy)[ _\[()]*(.*?)[ _\])]*", re.I
)
_PER_LENGTH = re.compile(r"(\w+?)[ _]*(?:/|_per_|[ _])[ _]*(m|mm|um|in|mil)", re.I)
_SIGMA = re.compile(r"sigma[ _]*[hkzdf]?[ _\[(]*(.*?)[ _\])]*", re.I)
_FORCE, _LENGTH = r"(?:[kmM]?N|lbf?|kgf)", r"(?:in|inch|mils?|[mu\u00b5\u03bcn]?m)"
_OVER = r"(?:[ _]*/[ _]*|[ _]per[ _]{})"
_STIFFNESS = re.compile(rf"(?:.*[ _(\[,])?{_FORCE}{_OVER.format('|[ _]')}{_LENGTH}[ )\]]*|.*(?:stiffness|kdyn).*", re.I)
_RESPONSE = re.compile(rf"(?:.*[ _(\[,])?(?:{_LENGTH}.*|g){_OVER.format('')}{_FORCE}[ )\]]*", re.I)
_TURNING = re.compile(r".*(?:torque|moment).*", re.I)
_ONE_NEWTON = (
    "as the response to one newton, with force_N = 1, force_phase_deg = 0, run, force_plane, plane, direction and"
)
_ORBIT = 1e-6
"""Orbit that a matrix is taken for, m."""


def is_stiffness(table: Table) -> bool:
    """True if the columns of a table are parts of a matrix of dynamic stiffness."""
    found = [match for name in table.cells if (match := _NAME.fullmatch(table.names[name]))]
    return len(found) >= 4 and not {"direction", "force_plane"} & set(table.cells)


def is_ratio(spelled: str) -> bool:
    """True if a name says force over motion or motion over force, which is no reading of a vibration."""
    return not _TURNING.fullmatch(spelled) and bool(_STIFFNESS.fullmatch(spelled) or _RESPONSE.fullmatch(spelled))


def refuse_ratios(table: Table, names: Sequence[str]) -> None:
    """Refuse a table that lacks readings where some of its columns are ratios of force and motion, with the way in."""
    ratios = [table.spelled(name) for name in names if is_ratio(table.spelled(name))]
    if not ratios:
        return
    listed = f"{table.source}: {', '.join(map(repr, ratios))}: "
    if not any(_STIFFNESS.fullmatch(spelled) for spelled in ratios):
        raise ValueError(
            f"{listed}motion over force is entered {_ONE_NEWTON} its real and imaginary part in the unit of the "
            "motion: real_um and imag_um of um/N, real_m and imag_m of m/N"
        )
    raise ValueError(
        f"{listed}force over motion is read as a matrix alone, of Re_Hxx_N_m, Im_Hxx_N_m and the same of xy (and of yx "
        f"and yy where yx = -xy and yy = xx do not hold) over frequency_hz. A single one is entered {_ONE_NEWTON} "
        "amplitude_m = 1 / |Re + j Im| and phase_deg = -angle(Re + j Im), Re and Im in N/m; coefficients of a seal are "
        "kxx_N_m, kxy_N_m, cxx_N_s_m, cxy_N_s_m and mxx_kg"
    )


def stiffness_table(table: Table) -> Table:
    """The same as readings of an imposed orbit; of the journal, unless a column says another plane."""
    planes = table.cells.get("plane", ())
    if len(set(planes)) > 1:
        raise ValueError(f"{table.source}: a matrix of dynamic stiffness is of one plane; give a file for each")
    plane = next(iter(planes), "journal")
    parts: dict[tuple[str, str], tuple[str, float]] = {}
    for name in table.cells:
        match = _NAME.fullmatch(table.names[name])
        if match is None:
            continue
        key = (match[2].lower(), match[1].lower()[:2])
        if key in parts:
            raise ValueError(
                f"{table.source}: {table.spelled(name)!r} and {table.spelled(parts[key][0])!r} are the same"
            )
        parts[key] = name, _unit(table, name, match[3])
    found = {element for element, _ in parts}
    half = [(element, part) for element in sorted(found) for part in ("re", "im") if (element, part) not in parts]
    if half or found not in ({"xx", "xy"}, {"xx", "xy", "yx", "yy"}):
        lacking = ", ".join(f"{part} of {element}" for element, part in half) or "xy, or yx and yy"
        raise ValueError(
            f"{table.source}: of the matrix of dynamic stiffness {lacking} is missing; give Re and Im of xx, xy, "
            "yx and yy (or of xx and xy alone, where yx = -xy and yy = xx)"
        )
    matrix: dict[str, ComplexArray] = {
        element: table.number(parts[element, "re"]) + 1j * table.number(parts[element, "im"]) for element in found
    }
    matrix = {"yx": -matrix["xy"], "yy": matrix["xx"]} | matrix
    rows, count = len(table.lines), 4
    own = {name for name, _ in parts.values()}
    given, sigma = _noise(table, matrix)
    repeated = table.rows(np.repeat(np.arange(rows), count), without=own | given)
    runs = repeated.cells.get("run", [""] * (rows * count))
    ways = ["forward", "forward", "backward", "backward"] * rows
    cells: dict[str, Sequence[str]] = {
        "run": [f"{run} {way}".strip() for run, way in zip(runs, ways, strict=True)],
        "plane": [plane] * (rows * count),
        "direction": ["x", "y"] * (2 * rows),
        "amplitude_um": Numbers(np.full(rows * count, 1e6 * _ORBIT)),
        "phase_deg": Numbers(np.tile([0.0, -90.0, 0.0, 90.0], rows)),
        "force_sigma_N": Numbers(np.repeat(np.sqrt(2) * sigma * _ORBIT, count)),
    }
    for axis in "xy":
        turning = [matrix[f"{axis}x"] + way * matrix[f"{axis}y"] for way in (-1j, -1j, 1j, 1j)]  # y is -jx, then jx
        newton = _ORBIT * np.column_stack(turning).ravel()
        cells[f"force_{axis}_N"] = Numbers(np.abs(newton))
        cells[f"force_{axis}_phase_deg"] = Numbers(np.degrees(np.angle(newton)))
    words = (
        f"{table.source}: a matrix of dynamic stiffness was read as the forces that circular orbits of "
        f"{1e6 * _ORBIT:g} um at {plane} take, forward and backward"
    )
    if not given:
        words += f"; its noise, {significant(float(sigma[0]), 2)} N/m, is what cubic curves over frequency leave over"
    return repeated.with_columns(cells).noted("dynamic-stiffness", words)


def _noise(table: Table, matrix: Mapping[str, ComplexArray]) -> tuple[set[str], Float]:
    """Column of the noise, if there is one, and standard deviation of real and of imaginary part of each row, N/m."""
    for name in table.cells:
        if match := _SIGMA.fullmatch(table.names[name]):
            return {name}, table.number((name, _unit(table, name, match[1])))
    columns = table.find("frequency", UNITS["frequency"])
    w = table.number(next(iter(columns.items()))) if columns else np.zeros(0)
    degree, fewest = 3, 8
    if len(columns) != 1 or np.unique(w).size < fewest:
        raise ValueError(
            f"{table.source}: the noise of a dynamic stiffness is needed, as a column sigma_MN_m, or a frequency_hz of "
            f"{fewest} values or more that tell it"
        )
    speeds = [table.number(column) for column in table.find("speed", UNITS["frequency"]).items()]
    groups = np.unique(np.column_stack([*speeds, np.zeros(w.size)]), axis=0, return_inverse=True)[1].ravel()
    left = freedom = 0.0
    for group in range(int(groups.max()) + 1):
        own = groups == group
        basis = np.vander(w[own] / np.abs(w).max(), degree + 1)
        for values in matrix.values():
            for part in (values.real[own], values.imag[own]):
                left += float(np.sum((part - basis @ np.linalg.lstsq(basis, part, rcond=None)[0]) ** 2))
                freedom += max(int(own.sum()) - degree - 1, 0)
    largest = max(float(np.abs(values).max()) for values in matrix.values())
    return set(), np.full(w.size, max(np.sqrt(left / max(freedom, 1.0)), 1e-6 * largest))


def _unit(table: Table, name: str, unit: str) -> float:
    """Factor to N/m of a column."""
    match = _PER_LENGTH.fullmatch(unit.strip())
    force = None if match is None else find_unit(match[1], UNITS["force"])
    if match is None or force is None:
        raise ValueError(
            f"{table.source}: column {table.spelled(name)!r}: a dynamic stiffness has a unit of force over one of "
            "length behind its name, as Re_Hxx_MN_m, Re_Hxx_N_um or Re_Hxx (lbf/in)"
        )
    return force / UNITS["length"][match[2].lower()]
