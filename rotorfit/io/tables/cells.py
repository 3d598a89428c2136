"""Cells of tables as laboratories save them: text of several encodings and separators, and sheets of Excel."""

from __future__ import annotations

import codecs
import csv
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

from rotorfit.estimators.file_limits import check_archive, check_text, check_unpacked
from rotorfit.models.parameters import unknown_name

EXCEL = (".xlsx", ".xlsm")
_MARKS = (
    (codecs.BOM_UTF8, "utf-8-sig"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)
"""Bytes at the beginning of a file that tell its encoding."""
_COMMA = re.compile(r"[+-]?\d*,\d+([eE][+-]?\d+)?|[+-]?\d+,")
_POINT = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")
_THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2}[.,]\d{3}")
NOT_TAKEN = ("", "nan", "n/a", "na", "-", "--")
"""How a reading that was not taken is written."""
_FORMULA = ("=", "+", "-", "@")
"""What a text begins with that a spreadsheet takes for a formula; with an apostrophe before it is text there."""
_TITLE_ROWS = 40
"""Rows up to which a header is looked for below titles: exports of analysers have ten to twenty."""
_CELL_BYTES = 8
"""Memory that an empty cell takes; a sheet with one cell in its last row and column has 1.7e10 of them."""
_ARCHIVE, _OLD_EXCEL = b"PK\x03\x04", b"\xd0\xcf\x11\xe0"


def as_text(cell: Any) -> Any:
    """A cell to write, a name that spreadsheets would run as a formula with an apostrophe before it."""
    formula = isinstance(cell, str) and cell.startswith(_FORMULA) and not _is_number(cell)
    return f"'{cell}" if formula else cell


def _as_written(cell: str) -> str:
    """A cell as it was before :func:`as_text`."""
    return cell[1:] if cell.startswith("'") and cell[1:].startswith(_FORMULA) else cell


@dataclass(frozen=True, kw_only=True)
class Cells:
    """A table as it stands in a file."""

    header: Sequence[str]  # names of the columns
    rows: Sequence[Sequence[str]]  # cells of each row, stripped of blanks, as many as there are columns
    lines: Sequence[int]  # line of the file, or row of the sheet, of each row


def read_cells(path: Path, sheet: str | None = None) -> Cells | None:
    """Header and rows of a text file or a sheet; None where there is nothing.

    Comment lines (``#``), blank lines and empty columns at the end are left out. Numbers with decimal commas are
    written with points.
    """
    if path.suffix.lower() in EXCEL:
        found = list(_sheet(path, sheet))
    elif sheet is not None:
        raise ValueError(f"a sheet is an option of Excel files ({', '.join(EXCEL)}); {path.name} is a text file")
    else:
        found = list(_text_rows(path))
    found = _without_titles(found)
    if not found:
        return None
    (_, header), *rest = found
    width = max((i + 1 for i, name in enumerate(header) if name), default=0)
    kept = [(line, row) for line, row in rest if any(row)]
    for line, row in kept:
        if len(row) < width or any(row[width:]):
            size = max((i + 1 for i, cell in enumerate(row) if cell), default=0) if len(row) > width else len(row)
            raise ValueError(f"{path.name}: line {line} has {size} cells, the header has {width} columns")
    rows = [row[:width] for _, row in kept]
    if kept:
        _refuse_units(path.name, kept[:4])
    _refuse_thousands(path.name, header, [line for line, _ in kept], list(zip(*rows, strict=True)))
    for column, name in zip(zip(*rows, strict=True), header):  # noqa: B905 - the header may have empty names at its end
        check_text(f"{path.name}, column {name[:80]!r}", column)
    columns = [_pointed(list(column), path.name, name) for column, name in zip(zip(*rows, strict=True), header)]  # noqa: B905 - the header may have empty names at its end
    return Cells(header=header[:width], rows=list(zip(*columns, strict=True)), lines=[line for line, _ in kept])


def _without_titles(found: list[tuple[int, list[str]]]) -> list[tuple[int, list[str]]]:
    """Rows without those of a preamble, one or two cells each, above a header of three and more."""
    sizes = [sum(map(bool, row)) for _, row in found[:_TITLE_ROWS]]
    first = next((i for i, size in enumerate(sizes) if size > 2), 0)
    return found[first:]


def _refuse_units(source: str, first: Sequence[tuple[int, Sequence[str]]]) -> None:
    """Refuse a first row without a number in any of the columns that hold numbers in the rows below it."""
    (line, row), *below = first
    numeric = [i for i in range(len(row)) if below and all(_is_number(other[i]) for _, other in below)]
    told = [row[i] for i in numeric if row[i]]
    if len(told) > 1 and not any(_is_number(cell) or cell.lower() in NOT_TAKEN for cell in told):
        raise ValueError(
            f"{source}: line {line} has no numbers, but {', '.join(map(repr, told[:4]))}. If these are units, the name "
            "of each column ends with its own (amplitude_um, frequency_hz): rename the columns and remove the line"
        )


def _refuse_thousands(
    source: str, header: Sequence[str], lines: Sequence[int], columns: Sequence[Sequence[str]]
) -> None:
    """Refuse numbers such as 1,000 in a table with decimal points, and 1.000 in one with decimal commas."""
    for mark, other in ((",", "."), (".", ",")):
        found = {i: next((k for k, cell in enumerate(cells) if mark in cell), None) for i, cells in enumerate(columns)}
        doubtful = [i for i, k in found.items() if k is not None and _only_thousands(columns[i], mark)]
        if not doubtful:
            continue
        decimal = next(
            ((i, cell) for i, cells in enumerate(columns) for cell in cells if _is_decimal(cell, other)), None
        )
        if decimal:
            at, row = doubtful[0], found[doubtful[0]] or 0
            cell = columns[at][row]
            raise ValueError(
                f"{source}: line {lines[row]}, column {header[at]!r}: {cell!r} may be {cell.replace(mark, '')} or "
                f"{cell.replace(mark, '.')}; column {header[decimal[0]]!r} writes decimals as in {decimal[1]!r}. Write "
                "all numbers in one way, without marks between thousands"
            )


def _only_thousands(cells: Sequence[str], mark: str) -> bool:
    """Whether a column holds numbers, and all with the mark may be whole ones with a mark between thousands."""
    return all(
        _THOUSANDS.fullmatch(cell) if mark in cell else not cell or cell.lstrip("+-").isdigit() for cell in cells
    )


def _is_decimal(cell: str, mark: str) -> bool:
    return mark in cell and _is_number(cell) and not _THOUSANDS.fullmatch(cell)


def _is_number(cell: str) -> bool:
    return bool(_POINT.fullmatch(cell) or _COMMA.fullmatch(cell))


def marked_encoding(raw: bytes) -> str:
    """Encoding that the first bytes of a text tell; empty where they do not: UTF-8 or an older one."""
    encoding = next((name for mark, name in _MARKS if raw.startswith(mark)), "")
    if not encoding and raw[:400].count(0) > len(raw[:400]) // 4:  # UTF-16 without its mark: every other byte is zero
        encoding = "utf-16-le" if raw[1:2] == b"\0" else "utf-16-be"
    return encoding


def decoded(path: Path) -> str:
    """Text in UTF-8, UTF-16 or, as old programs save it, Windows' Western code page."""
    raw = path.read_bytes()
    if raw.startswith((_ARCHIVE, _OLD_EXCEL)):
        raise ValueError(f"{path.name} is no text but a workbook, as Excel writes them: {_workbook_advice(raw)}")
    encoding = marked_encoding(raw)
    try:
        return raw.decode(encoding or "utf-8")
    except UnicodeDecodeError as error:
        if encoding or b"\0" in raw:
            raise ValueError(f"{path.name} is not text: {error.reason} at byte {error.start}") from error
    try:
        return raw.decode("cp1252")
    except UnicodeDecodeError as error:
        raise ValueError(
            f"{path.name} is neither UTF-8 nor Windows-1252 text (byte {error.start}); save it as CSV UTF-8"
        ) from error


def _workbook_advice(raw: bytes) -> str:
    if raw.startswith(_OLD_EXCEL):
        return "it is of the old kind, .xls; save it as .xlsx, or as CSV"
    return "name it .xlsx, or save it as CSV"


def _text_rows(path: Path) -> Iterator[tuple[int, list[str]]]:
    lines = re.split(r"\r\n|\r|\n", decoded(path))
    numbered = [(i, line) for i, line in enumerate(lines, 1) if line.strip() and not line.lstrip().startswith("#")]
    delimiter = ""
    if numbered and re.fullmatch(r"sep=.", numbered[0][1].strip()):  # written by Excel
        delimiter = numbered.pop(0)[1].strip()[4]
    if not numbered:
        return
    counts = [max(map(line.count, ",;\t")) for _, line in numbered[:_TITLE_ROWS]]
    first = next((i for i, count in enumerate(counts) if count > 1), 0)  # a title has none, or a comma
    delimiter = delimiter or max(",;\t", key=numbered[first][1].count)
    try:
        rows = list(csv.reader((line for _, line in numbered), delimiter=delimiter, strict=True))
    except csv.Error as error:
        raise ValueError(f"{path.name} is not a readable CSV: {error}") from error
    for (line, text), row in zip(numbered, rows, strict=False):
        yield line, [_as_written(cell.strip()) for cell in row] if "'" in text else [cell.strip() for cell in row]


def _sheet(path: Path, sheet: str | None) -> Iterator[tuple[int, list[str]]]:
    with path.open("rb") as stream:
        book = _workbook(path, stream)
        if sheet is not None and sheet not in book.sheetnames:
            raise ValueError(f"{path.name}: {unknown_name('sheet', sheet, book.sheetnames)}")
        rows = book[sheet or book.sheetnames[0]].iter_rows(values_only=True)
        size, taken = path.stat().st_size, 0
        for line, row in enumerate(rows, 1):
            taken += _CELL_BYTES * len(row)
            check_unpacked(path.name, taken, size)
            cells = [_shown(value) for value in row]
            if any(cells) and not cells[0].startswith("#"):
                yield line, cells
        book.close()


def _workbook(path: Path, stream: BinaryIO) -> Any:
    try:
        from openpyxl import load_workbook
        from openpyxl.utils.exceptions import InvalidFileException
    except ImportError as reason:
        raise ValueError(f'{path.name}: Excel files need openpyxl: pip install "rotorfit[excel]"') from reason
    from zipfile import BadZipFile

    try:
        check_archive(path)
        return load_workbook(stream, read_only=True, data_only=True)
    except (BadZipFile, InvalidFileException, KeyError) as reason:
        head = path.read_bytes()[:4]
        advice = (
            "a part of its archive is damaged or missing"
            if head == _ARCHIVE
            else _workbook_advice(head)
            if head == _OLD_EXCEL
            else "it is no workbook; a text file is named .csv or .txt"
        )
        raise ValueError(f"{path.name} is not a readable Excel file: {advice}") from reason


def _shown(value: Any) -> str:
    """A cell of a sheet as text; a whole number that Excel holds as a float keeps no point."""
    if value is None:
        return ""
    if isinstance(value, float):
        return f"{value:.17g}"
    return str(value).strip()


def _pointed(cells: list[str], source: str, name: str) -> list[str]:
    """Cells of a column of numbers with decimal commas, with points; other columns as they are."""
    with_comma = [bool(_COMMA.fullmatch(cell)) for cell in cells]
    if not any(with_comma) or not all(
        comma or cell.lower() in NOT_TAKEN or _POINT.fullmatch(cell)
        for cell, comma in zip(cells, with_comma, strict=True)
    ):
        return cells
    if any("." in cell for cell in cells):
        raise ValueError(
            f"{source}: column {name!r} has decimal points and decimal commas "
            f"({next(c for c in cells if '.' in c)}, {cells[with_comma.index(True)]}); use one of them"
        )
    return [cell.replace(",", ".") for cell in cells]
