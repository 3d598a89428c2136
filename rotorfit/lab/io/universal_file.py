"""Records of universal files, functions at nodal DOF (dataset 58) as other programs write them.

Binary records, and data sets of other kinds, are read by pyuff. Those in ASCII are read here, because programs depart
from the columns that the format prescribes: entity names longer than ten characters shift what follows, exponents have
three digits or a D, the last line is filled up with zeros beyond the number of points. Records have pyuff's keys.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from rotorfit.base.array_types import Float
from rotorfit.base.file_reading import beginning, end_of, shown

_MARK = re.compile(rb"(?m)^    -1[ \t]*\r?$\n?")
_ASCII = re.compile(rb"\s*58[ \t]*\r?\n")
_NUMBER = re.compile(rb"[+-]?(?:\d+\.?\d*|\.\d+)(?:[EeDd][+-]?\d+|[+-]\d{3})?")
_SHORT = re.compile(rb"(\d)([+-]\d{3})$")
"""An exponent of three digits, for which Fortran leaves the E out."""
_HEADER_LINES = 11
_NAMED = re.compile(
    r"\s*(\d+)\s+(-?\d+)\s+(-?\d+)\s+(-?\d+)\s+(\S.*?)\s+(-?\d+)\s+([+-]?[0-6])\s+(\S.*?)\s+(-?\d+)\s+([+-]?[0-6])\s*"
)
"""Record 6 of fields that are parted by blanks."""
_PLACES = (
    "func_type", "func_id", "ver_num", "load_case_id", "rsp_ent_name", "rsp_node", "rsp_dir", "ref_ent_name",
    "ref_node", "ref_dir",
)  # fmt: skip
_FROM_TO = ((0, 5), (5, 15), (15, 20), (20, 30), (30, 41), (41, 51), (51, 55), (55, 66), (66, 76), (76, 80))
"""Fields of record 6, and the characters in which the format has them."""
_AXES = ("abscissa", "ordinate", "orddenom", "z_axis")
_VALUES = {2: 1, 4: 1, 5: 2, 6: 2}
"""Numbers of a value by its type: real or complex, of single or double precision."""


def universal_records(path: Path, *, header_only: bool = False, only: int | None = None) -> list[dict[str, Any]]:
    """All data sets of a file, or one by its place; with ``header_only`` without the numbers of functions."""
    import pyuff

    margin = 1 << 20  # bytes in which the first data set begins, and the last one ends
    if not _MARK.search(beginning(path, margin)):
        raise ValueError(f"{path.name} is not a universal file: no line of it is '    -1', between which data sets are")
    if not _MARK.search(end_of(path, margin)):  # of a file of any length, before it is read
        raise ValueError(f"{path.name} is not a whole universal file: its last data set has no end; copy it again")
    content = path.read_bytes()
    marks = [(match.start(), match.end()) for match in _MARK.finditer(content)]
    binary = re.search(rb"(?m)^    58[bB]", content) is not None
    if len(marks) % 2 and not binary:
        raise ValueError(f"{path.name} is not a whole universal file: its last data set has no end; copy it again")
    file = pyuff.UFF(str(path))
    count = file.get_n_sets()
    blocks: list[memoryview | None] = [None] * count
    if not binary and len(marks) == 2 * count:
        pairs = zip(marks[::2], marks[1::2], strict=True)
        blocks = [memoryview(content)[begin:end] for (_, begin), (end, _) in pairs]
    records = []
    for number, block in enumerate(blocks):
        if only is not None and number != only:
            continue
        if block is not None and _ASCII.match(block):
            record = _function(block, f"{path.name}, data set {number + 1}", header_only=header_only)
        else:
            record = _cut(file.read_sets(number, header_only=header_only), f"{path.name}, data set {number + 1}")
        records.append({key: shown(value) if isinstance(value, str) else value for key, value in record.items()})
    return records


def _cut(record: dict[str, Any], where: str) -> dict[str, Any]:
    """A function that pyuff read, without what fills it up beyond its number of points."""
    if record.get("type") != 58 or record.get("data") is None:
        return record
    points = int(record["num_pts"])
    if len(record["data"]) < points:
        raise ValueError(f"{where} has {len(record['data'])} of its {points} points; copy the file again")
    return record | {key: np.asarray(record[key])[:points] for key in ("x", "data")}


def _function(block: memoryview, where: str, *, header_only: bool) -> dict[str, Any]:
    """A function in ASCII."""
    lines: list[str] = []
    begin, content = 0, bytes(block)
    for _ in range(_HEADER_LINES + 1):  # that of the type is the first
        end = content.find(b"\n", begin)
        if end < 0:
            raise ValueError(f"{where} has no whole heading: {len(lines)} of {_HEADER_LINES + 1} lines")
        lines.append(content[begin:end].decode("utf-8", errors="replace").rstrip("\r"))
        begin = end + 1
    record: dict[str, Any] = {"type": 58, "binary": 0}
    record |= {f"id{i}": lines[i][:80].strip() for i in range(1, 6)}
    record |= _places(lines[6], where)
    record |= _form(lines[7], where)
    for axis, line in zip(_AXES, lines[8:], strict=True):
        kind = line[:10].strip() if line[:10].strip().lstrip("+-").isdigit() else (line.split() or ["0"])[0]
        if not kind.lstrip("+-").isdigit():
            raise ValueError(f"{where}: the axis {line.strip()[:60]!r} does not begin with its type")
        record[f"{axis}_spec_data_type"] = int(kind)
        record[f"{axis}_axis_lab"], record[f"{axis}_axis_units_lab"] = line[25:46].strip(), line[46:67].strip()
    if header_only:
        return record | {"x": None, "data": None}
    return record | _numbers(content[begin:], record, where)


def _places(line: str, where: str) -> dict[str, Any]:
    """Record 6: kind of the function, and where response and reference are."""
    fixed = [line[first:last].strip() for first, last in _FROM_TO]
    whole = all(_is_whole(cell) for place, cell in enumerate(fixed) if place not in (4, 7))
    if len(line.rstrip()) > 80 or not whole or not fixed[-1]:  # something is longer or shorter than its field
        match = _NAMED.fullmatch(line)
        if match is None and (not whole or len(line.rstrip()) > 80):
            raise ValueError(
                f"{where}: record 6 is not of the fields that the format has, {line.strip()[:90]!r}: an entity name "
                "longer than 10 characters shifts the others; export with shorter names"
            )
        fixed = list(match.groups()) if match else fixed
    return {key: cell if key.endswith("name") else int(cell or 0) for key, cell in zip(_PLACES, fixed, strict=True)}


def _is_whole(cell: str) -> bool:
    return not cell or (cell.lstrip("+-").isdigit() and cell.isascii())


def _form(line: str, where: str) -> dict[str, Any]:
    """Record 7: type and number of the values, and their abscissa."""
    cells = line.split()
    if len(cells) != 6:
        cells = [
            line[first:last].strip() for first, last in ((0, 10), (10, 20), (20, 30), (30, 43), (43, 56), (56, 69))
        ]
    keys = ("ord_data_type", "num_pts", "abscissa_spacing", "abscissa_min", "abscissa_inc", "z_axis_value")
    try:
        found = [int(cell) for cell in cells[:3]] + [_number(cell or "0") for cell in cells[3:]]
    except ValueError as problem:
        raise ValueError(f"{where}: record 7 does not say the form of the values: {line.strip()[:80]!r}") from problem
    if found[0] not in _VALUES or found[1] < 0 or not np.isfinite(found[3:]).all():
        raise ValueError(f"{where}: record 7 has no type (2, 4, 5, 6), number or step of values: {line.strip()[:80]!r}")
    return dict(zip(keys, found, strict=True))


def _number(cell: str) -> float:
    return float(_SHORT.sub(rb"\1E\2", cell.encode()).decode().replace("D", "E").replace("d", "e"))


def _numbers(body: bytes, record: dict[str, Any], where: str) -> dict[str, Any]:
    """Abscissa and values, as many as the record says: the last line may be filled up."""
    values = np.concatenate([np.zeros(0), *_found(body, where)])
    parts, points, even = _VALUES[record["ord_data_type"]], record["num_pts"], record["abscissa_spacing"] == 1
    width = parts + (not even)
    if values.size < points * width:
        raise ValueError(f"{where} has {values.size // width} of its {points} points; copy the file again")
    rows = values[: points * width].reshape(points, width)
    x = record["abscissa_min"] + np.arange(points) * record["abscissa_inc"] if even else rows[:, 0].copy()
    own = rows[:, -parts:]
    return {"x": x, "data": own[:, 0] + 1j * own[:, 1] if parts == 2 else own[:, 0].copy()}


def _found(body: bytes, where: str) -> Iterator[Float]:
    """Numbers in a text, some lines at a time."""
    begin, at_once = 0, 1 << 22
    while begin < len(body):
        end = body.find(b"\n", begin + at_once) + 1 or len(body)
        part, begin = body[begin:end], end
        if left := _NUMBER.sub(b" ", part).split():
            raise ValueError(f"{where} holds what is not a number: {left[0][:40].decode(errors='replace')!r}")
        cells = _NUMBER.findall(part)
        try:
            yield np.array(cells, dtype=np.float64)
        except ValueError:
            yield np.array([_number(cell.decode()) for cell in cells])


def copies(records: Sequence[dict[str, Any]]) -> Iterator[int | None]:
    """Of each function the place of one before it that is the same to the last digit."""
    seen: dict[tuple[Any, ...], int] = {}
    for place, record in enumerate(records):
        names = ("rsp_node", "rsp_dir", "ref_node", "ref_dir", "z_axis_value", "id1", "id2")
        values = [np.asarray(record[key]).tobytes() for key in ("x", "data")]
        first = seen.setdefault((*(record[key] for key in names), *values), place)
        yield None if first == place else first
