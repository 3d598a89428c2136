"""Tables of one probe each, whose point stands above the header, ``Point: Brg 1 X``; in a workbook one a sheet, which
may have its name.

Their columns are speed, amplitude and phase of the 1x vector, without plane and direction. The name of the point ends
with the axis of the probe.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from rotorfit.lab.io.tables.cells import EXCEL, Numbers, first_rows
from rotorfit.lab.io.tables.headers import is_text, is_unit, quantity_meant, understood, with_given_names
from rotorfit.lab.io.tables.table import Table, read_table

if TYPE_CHECKING:
    from pandas import DataFrame

_TITLE = re.compile(r"(?i)^(?:measurement )?(?:point|channel|probe|location|sensor)(?: name)?\s*[:=]?\s*(.*)$")
_POINT = re.compile(r"(?P<plane>.*[^A-Za-z])(?P<axis>[XYxy])")
_SAID = {"amplitude", "phase", "speed"}
"""Quantities of the columns."""

Points = Mapping[str | None, tuple[str, str]]
"""Plane and direction of a probe by sheet; of a text file by None."""


def points_above(path: str | Path | DataFrame, sheet: str | None) -> tuple[Points, list[str]]:
    """The points of a file whose sheets, or which itself, are tables of one probe, nothing for others; and sheets of
    tables beside the first or these."""
    if not isinstance(path, str | Path) or Path(path).suffix.lower() not in (*EXCEL, ".csv", ".txt", ".tsv"):
        return {}, []
    file = Path(path)
    heads = first_rows(file, sheet)
    titles = {name: above for name, rows in heads.items() if (above := _titles(rows)) is not None}
    several = len(titles) > 1
    points = {name: _point(above, (name or "") if several else "") for name, above in titles.items()}
    unnamed = [repr(name) for name, place in points.items() if place is None]
    if several and unnamed:
        raise ValueError(
            f"{file.name}: nothing says of which probe speed, amplitude and phase in sheet{'s' * (len(unnamed) > 1)} "
            f"{', '.join(unnamed)} are: write a line such as 'Point: DE X', its plane and x or y, above the header of "
            "each, or call the sheet so"
        )
    found = {name: place for name, place in points.items() if place is not None}
    beside = {name: rows for name, rows in heads.items() if name not in (found or [*heads][:1])}
    return found, [str(name) for name, rows in beside.items() if any(map(_is_header, rows))]


def _is_header(row: Sequence[str]) -> bool:
    few = 3  # names of quantities
    return sum(bool(quantity_meant(cell.strip())) for cell in row) >= few


def _titles(rows: Sequence[Sequence[str]]) -> list[list[str]] | None:
    """Rows above the header of a table of one probe; None above other tables."""
    for number, row in enumerate(rows):
        cells = [cell.strip() for cell in row if cell.strip()]
        named = {quantity_meant(cell).partition("_")[0] for cell in cells}
        if len(cells) > 2:  # the header
            below = rows[number + 1 : number + 2]
            if not named >= _SAID and below and all(map(is_unit, filter(None, below[0]))):
                units = zip(row, below[0], strict=False)
                named = {quantity_meant(f"{cell} ({unit})").partition("_")[0] for cell, unit in units}
            if not named >= _SAID or {"plane", "direction"} & named:
                return None
            return [[cell.strip() for cell in above if cell.strip()] for above in rows[:number]]
    return None


def _point(titles: Sequence[Sequence[str]], sheet: str) -> tuple[str, str] | None:
    """Plane and direction that the titles say, or the name of the sheet."""
    matches = [(title, match) for title in titles if title and (match := _TITLE.match(title[0]))]
    names = [match[1].strip() or (title[1] if len(title) > 1 else "") for title, match in matches]
    for name in (*names, sheet):
        place = _POINT.fullmatch(name)
        if place and place["plane"].strip(" _-.:"):
            return place["plane"].strip(" _-.:"), place["axis"].lower()
    return None


def point_table(path: str | Path | DataFrame, points: Points, columns: Mapping[str, str]) -> Table:
    """The tables of all points as one."""
    tables = []
    for sheet, (plane, direction) in points.items():
        table = read_table(path, sheet, lambda spelled: is_text(spelled, columns), is_unit, lambda share: None)
        table = understood(with_given_names(table, columns) if columns else table)
        count = len(table.lines)
        tables.append(table.with_columns({"plane": [plane] * count, "direction": [direction] * count}))
    first = tables[0]
    for sheet, table in zip(points, tables, strict=True):
        if set(table.cells) != set(first.cells):
            other = ", ".join(table.names[name] for name in table.cells if name not in first.cells) or "fewer"
            raise ValueError(f"{first.source}: sheet {sheet!r} has other columns than the first: {other}")
    cells = {name: _joined([table.cells[name] for table in tables]) for name in first.cells}
    return replace(first, cells=cells, lines=np.concatenate([table.lines for table in tables]))


def _joined(parts: Sequence[Sequence[str]]) -> Sequence[str]:
    if all(isinstance(part, Numbers) for part in parts):
        return Numbers(np.concatenate([part.values for part in parts if isinstance(part, Numbers)]))
    return [cell for part in parts for cell in part]
