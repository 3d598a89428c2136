"""JSON of records as a table: a list of objects with the columns of a row, or an object of columns.

A list may stand inside an object as its only list of objects (``{"meta": ..., "data": [...]}``), the columns may be
apart from the rows, as pandas splits them (``{"columns": [...], "data": [[...], ...]}``), and a file may hold an object
a line.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rotorfit.base.digits import significant
from rotorfit.base.file_reading import allowed_bytes, check_unpacked, check_whole
from rotorfit.lab.io.tables.cells import check_columns

if TYPE_CHECKING:
    from pandas import DataFrame

SUFFIXES = (".json", ".jsonl", ".ndjson")
_LINES = re.compile(r"\s*\{[^\n]*\}\s*\n\s*\{")
"""How a file begins that holds an object a line."""
_FORM = (
    'readings are a list of objects, [{"run": "a", "speed_rpm": 1500, ...}, ...], with the names of the columns of a '
    "CSV; or save them as CSV"
)


def json_frame(path: Path) -> tuple[DataFrame, list[str]]:
    """The rows of a file, blank where an object lacks a column, and the keys beside them, which are not read."""
    from pandas import DataFrame

    check_whole(path, "JSON")
    try:
        text = path.read_text(encoding="utf-8-sig")
        _check_memory(path.name, text)
        lines = filter(str.strip, text.split("\n"))
        content = [json.loads(line) for line in lines] if _LINES.match(text) else json.loads(text)
    except UnicodeDecodeError as problem:
        raise ValueError(f"{path.name} is not JSON: byte {problem.start} is no UTF-8") from problem
    except json.JSONDecodeError as problem:
        raise ValueError(f"{path.name} is not JSON: {problem}") from problem
    rows, beside = _records(path.name, content)
    columns = list(dict.fromkeys(key for row in rows for key in row))
    check_columns(path.name, len(columns))
    check_unpacked(path.name, 8.0 * len(rows) * len(columns), path.stat().st_size)
    for number, row in enumerate(rows, 1):
        for key, value in row.items():
            if isinstance(value, dict | list):
                raise ValueError(f"{path.name}: record {number}, {key!r} holds several values; {_FORM}")
    return DataFrame({key: [_cell(row.get(key)) for row in rows] for key in columns}, dtype=object), beside


def _check_memory(name: str, text: str) -> None:
    """Refuse what would take gigabytes as objects: Python takes so many bytes for each object and each value."""
    of_object, of_value, most = 300, 40, 8 * allowed_bytes(0)
    needed = of_object * text.count("{") + of_value * text.count(",")
    if needed > most:
        raise ValueError(
            f"{name} would take {significant(needed, 2)} bytes of memory; up to {most} are taken for JSON: save the "
            "readings as CSV"
        )


def _records(name: str, content: Any) -> tuple[list[dict[str, Any]], list[str]]:
    """Rows in whatever of the known forms, and the keys beside them."""
    beside: list[str] = []
    if isinstance(content, dict) and isinstance(content.get("columns"), list) and isinstance(content.get("data"), list):
        names, rows = [str(each) for each in content["columns"]], content["data"]
        if len(set(names)) == len(names) and all(isinstance(row, list) and len(row) == len(names) for row in rows):
            known = {"columns", "data", "index"}  # pandas numbers the rows too
            return [dict(zip(names, row, strict=True)) for row in rows], [key for key in content if key not in known]
    if isinstance(content, dict):
        lists = {key: each for key, each in content.items() if isinstance(each, list)}
        objects = [key for key, each in lists.items() if each and all(isinstance(row, dict) for row in each)]
        if len(objects) == 1:
            beside = [key for key in content if key != objects[0]]
            content = lists[objects[0]]
        elif len(lists) == len(content) and len({len(each) for each in lists.values()}) == 1:
            return [dict(zip(content, row, strict=True)) for row in zip(*lists.values(), strict=True)], []
    if isinstance(content, list) and content and all(isinstance(row, dict) for row in content):
        return content, beside
    raise ValueError(f"{name} holds no records: {_FORM}")


def _cell(value: Any) -> str:
    """A value as the cell of a table."""
    if value is None:
        return ""
    return repr(value) if isinstance(value, float) else str(value)
