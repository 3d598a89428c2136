"""Text tables that condition-monitoring systems export, as the table of columns that a tidy CSV is read into.

Sample tables (cells parted by ``|``) repeat two blocks: channels with their units (``CH#|Channel Name|...|Amp Unit``
and so on), and samples of each channel (``CH#|Channel Name|Sample#|...|1XAmplitude|1X Phase|...``). Bode tables have
the columns ``X-Axis Value,Y-Axis Value,Phase,Timestamp``, a channel a file. Both hold 1x vectors whose phase lags, and
no weight: that is a constant of the file, or the run is a reference run.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from rotorfit.data.findings import Finding
from rotorfit.io.tables.table import Table

BODE_HEADER = ("x-axis value", "y-axis value", "phase")

NUMBER = re.compile(r"([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(?:°|deg\b)?\s*([^\d.,+-].*|)")
"""A number, and the mark behind it."""
_VALID = ("", "v")
"""Text that may follow a valid number, in lower case; anything else marks a reading as invalid."""
SEPARATED = re.compile(r"(?P<plane>.*[^A-Za-z])(?P<axis>[XYxy])")
"""Plane and axis in the name of a channel, ``Brg 1 X``."""
_WEIGHT = ("force_", "mr_")

Row = tuple[int, Mapping[str, str]]
"""Line of the file, and its cells by column."""


def bode_table(table: Table, plane_given: bool) -> tuple[Table, list[Finding]]:
    """Readings of a Bode table, and what was left out of them."""
    usual = {"x-axis value": "speed_rpm", "phase": "phase_lag_deg"}
    columns = {usual.get(name, name): cells for name, cells in table.cells.items()}
    if "y-axis value" in columns:
        raise ValueError(
            f"{table.source} does not say the unit of its Y-Axis Value; say it (columns=, "
            '--column "Y-Axis Value=amplitude_um_pp"), with one of the '
            "units um, mil, mm, each with _pp, _pk or _rms)"
        )
    count = len(table.lines)
    if not plane_given:
        match = SEPARATED.fullmatch(Path(table.source).stem)
        if match is None or not match["plane"].strip(" _-.:"):
            raise ValueError(
                f"{table.source} is a Bode table of one channel and does not say which: give constants "
                "{'plane': 'brg1', 'direction': 'x'} (--constant plane=brg1 --constant direction=x), "
                'or name the file after the channel ("Brg 1 X.csv")'
            )
        columns |= {"plane": [match["plane"].strip(" _-.:")] * count, "direction": [match["axis"].lower()] * count}
    names = [
        next((name for name in columns if name.startswith(part)), "") for part in ("amplitude_", "phase_", "speed_")
    ]
    if "" in names:
        return replace(table, cells=columns, names={**table.names, **{name: name for name in columns}}), []
    rows: list[Row] = [
        (line, dict(zip(columns, cells, strict=True)))
        for line, cells in zip(table.lines, zip(*columns.values(), strict=True), strict=True)
    ]
    return checked(table.source, rows, names[0], names[1], names[2], [])


def checked(
    source: str, rows: Sequence[Row], amplitude: str, phase: str, speed: str, found: list[Finding]
) -> tuple[Table, list[Finding]]:
    """The table of the readings whose numbers hold, and findings on those that were left out."""
    kept: list[Row] = []
    reasons: Counter[str] = Counter()
    lines = []
    for line, row in rows:
        reason, cells = "", dict(row)
        for name, what in ((speed, "speed"), (amplitude, "amplitude"), (phase, "phase")):
            match = NUMBER.fullmatch(row[name])
            if match is None and re.search(r"\d", row[name]):
                hint = "; write decimals with a point" if "," in row[name] else ""
                raise ValueError(f"{source}: line {line}: the {what} {row[name]!r} is not a number{hint}")
            if match is None:
                reason = reason or f"no {what}"
            elif match[2].lower() not in _VALID:
                reason = reason or f"{what} marked {match[2]}"
            elif what == "speed" and float(match[1]) == 0:
                reason = "machine at rest"
            cells[name] = match[1] if match else ""
        if reason:
            reasons[reason] += 1
            lines.append(str(line))
        else:
            kept.append((line, cells))
    listed = ", ".join(f"{reason}: {count}" for reason, count in reasons.items())
    if not kept:
        raise ValueError(f"{source}: none of its {len(rows)} samples has a speed and a valid 1x vector ({listed})")
    if reasons:
        where = ", ".join(lines[:5]) + (", ..." if len(lines) > 5 else "")
        words = (
            f"{source}: {len(lines)} of {len(rows)} samples were skipped ({listed}; "
            f"line{'s' * (len(lines) > 1)} {where})"
        )
        found = [*found, Finding("note", "empty", words)]
    names = list(kept[0][1])
    columns = {name: [row[name] for _, row in kept] for name in names}
    return Table(
        source=source, cells=columns, lines=np.array([line for line, _ in kept]), names={name: name for name in names}
    ), found


def with_weight(table: Table) -> Table:
    """The table with what exports do not hold: the run, frequency = speed, and no weight where none is given."""
    cells, names, count = dict(table.cells), dict(table.names), len(table.lines)
    planes = list(dict.fromkeys(cells["plane"])) if "plane" in cells else []
    speed = next((name for name in cells if name.startswith("speed_")), "")
    added: dict[str, Sequence[str]] = {}
    if "run" not in cells:
        added["run"] = [Path(table.source).stem] * count
    if speed and not any(name.startswith("frequency_") for name in cells):
        added["frequency" + speed.removeprefix("speed")] = cells[speed]
    weighted = any(name.startswith(_WEIGHT) and not name.startswith("force_plane") for name in cells)
    if not weighted:
        added |= {"mr_g_mm": ["0"] * count, "force_phase_deg": ["0"] * count}
    elif not any(name.startswith(("force_phase_", "force_angle_")) for name in cells):
        raise ValueError(
            f"{table.source}: the angle of the weight is not given; add force_phase_deg to the constants, degrees of "
            "lead from the Keyphasor's mark"
        )
    if "force_plane" not in cells and planes:
        if weighted and len(planes) > 1:
            raise ValueError(
                f"{table.source}: the plane of the weight is not given; add force_plane to the constants, one of "
                f"{', '.join(planes)} or another plane of the rotor"
            )
        added["force_plane"] = [planes[0]] * count
    return replace(table, cells={**cells, **added}, names={**names, **{name: name for name in added}})


def without_weight_finding(table: Table) -> list[Finding]:
    """A note on a file without a weight."""
    if any(name.startswith(_WEIGHT) and not name.startswith("force_plane") for name in table.cells):
        return []
    words = (
        f"{table.source} holds no weight, so its run is a reference run; for a run with one give constants "
        "{'force_plane': ..., 'mr_g_mm': ..., 'force_phase_deg': ...} (--constant mr_g_mm=30 and so on)"
    )
    return [Finding("note", "no-weight", words)]
