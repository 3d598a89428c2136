"""Cells of tables as laboratories save them: text of several encodings and separators, and sheets of Excel."""

from __future__ import annotations

import codecs
import csv
import math
import re
from bisect import bisect_left
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from functools import lru_cache, partial
from itertools import chain, islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, TextIO

import numpy as np

from rotorfit.base.array_types import Bool, Float, Index
from rotorfit.base.file_reading import beginning, check_archive, check_sheets, check_text, check_unpacked, shown
from rotorfit.base.names import unknown_name

if TYPE_CHECKING:
    from pandas import DataFrame

EXCEL = (".xlsx", ".xlsm")
_MARKS = ((codecs.BOM_UTF8, "utf-8-sig"), (codecs.BOM_UTF16_LE, "utf-16"), (codecs.BOM_UTF16_BE, "utf-16"))
"""Bytes at the beginning of a file that tell its encoding."""
_COMMA = re.compile(r"[+-]?\d*,\d+([eE][+-]?\d+)?|[+-]?\d+,")
_POINT = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")
_THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2}[.,]\d{3}")
NOT_TAKEN = frozenset((
    "", "nan", "-nan", "n/a", "na", "n.a.", "-", "--", "---", "----", "-----", "*", "**", "***", "****", "*****", "?",
    "#n/a", "#value!", "#div/0!", "#num!", "#ref!", "#null!", "#name?", "#nan",
    "1.#qnan", "-1.#qnan", "1.#snan", "1.#ind", "-1.#ind", "1.#inf", "-1.#inf", "nan(ind)", "-nan(ind)",
    "ol", "o.l", "o.l.", "ovl", "ovld", "ovf", "ovrng", "overload", "overrange", "over range", "overflow", "underrange",
    "invalid", "not valid", "bad", "bad input", "error", "err", "err.", "fault", "failed", "no data", "nodata",
    "missing", "null", "none", "no reading", "not taken",
))  # fmt: skip
"""How a reading that was not taken is written, by people, spreadsheets, compilers and instruments, in lower case."""
_SHEET_ERROR = re.compile(r"#(N/A|VALUE!|DIV/0!|NUM!|REF!|NULL!|NAME\?)", re.IGNORECASE)
"""What a spreadsheet writes in a cell, which begins as a comment does."""
_FORMULA = ("=", "+", "-", "@")
"""First characters of a text that a spreadsheet takes for a formula; an apostrophe before them keeps it text."""
_TITLE_ROWS = 40
"""Rows up to which a header is looked for below titles: exports of analysers have ten to twenty."""
_ARCHIVE, _OLD_EXCEL = b"PK\x03\x04", b"\xd0\xcf\x11\xe0"


_Row = tuple[int, Sequence[str]]
"""Line of the file, or row of the sheet, and its cells."""


def as_text(cell: Any) -> Any:
    """A cell to write, a name that spreadsheets would run as a formula with an apostrophe before it."""
    if not isinstance(cell, str):
        return cell
    formula = cell.startswith(_FORMULA) and not _is_number(cell)
    return f"'{shown(cell)}" if formula else shown(cell)


def _as_written(cell: str) -> str:
    """A cell as it was before :func:`as_text`."""
    return cell[1:] if cell.startswith("'") and cell[1:].startswith(_FORMULA) else cell


class Numbers(Sequence[str]):
    """Cells that are numbers, kept as such and NaN where blank; one that is looked at is written anew."""

    def __init__(self, values: Float) -> None:
        self.values = values

    def __len__(self) -> int:
        return self.values.size

    def __getitem__(self, at: Any) -> Any:  # one cell; nobody asks for several
        value = float(self.values[at])
        return "" if math.isnan(value) else repr(value).removesuffix(".0")


def taken(cells: Sequence[str], rows: Sequence[int] | Index) -> Sequence[str]:
    """Cells of some rows."""
    if isinstance(cells, Numbers):
        return Numbers(cells.values[rows])
    return [cells[row] for row in rows]


def lacking(cells: Sequence[str], words: Collection[str] = ("",)) -> Bool:
    """Rows whose cell is blank, or one of these words whatever its case, shape ``(R,)``."""
    if isinstance(cells, Numbers):
        return np.isnan(cells.values)
    blank = {cell for cell in set(cells) if cell.lower() in words}
    return np.array([cell in blank for cell in cells], dtype=bool)


Cells = tuple[Sequence[str], Sequence[Sequence[str]], Index]
"""A table as it stands in a file: names of the columns, cells of each, stripped of blanks, and the line of the file, or
row of the sheet, of each row."""


_BATCH = 512
"""Rows that are taken at a time, which the processor's cache holds. Chosen."""
_DIGIT, _LETTER = re.compile(r"\d"), re.compile(r"[^\W\d]")


class _Text(dict[str, str]):
    """Cells of a column of text as they are meant, each kept once."""

    def __missing__(self, cell: str) -> str:
        self[cell] = shown(_as_written(cell.strip()))
        return self[cell]


class _Column:
    """A column while its rows arrive: numbers for as long as all cells are, with points or with commas."""

    def __init__(self, name: str, is_text: bool) -> None:
        self.name, self.is_text, self.lost = name, is_text, False
        self._named_text = is_text
        self._numbers: list[Float] = []
        self._text: list[str] = []
        self._meant = _Text()
        self._rows = 0
        self._mark = ""  # before the decimals of numbers
        self._first = (0, "")  # row and cell where it stands first
        self._thousands = True  # whether it may always stand between thousands
        self._decimal = ""  # a number where it does not

    def add(self, cells: Sequence[str]) -> None:
        """Take the cells of further rows."""
        count, alike = len(cells), cells[:1] if cells.count(cells[0]) == len(cells) else cells
        values = None if self.is_text or self.lost else self._converted(alike)
        if values is not None:
            self._numbers.append(values if alike is cells else np.repeat(values, count))
        elif self._numbers:
            self.lost = True  # the cells above are needed as they were written
        else:
            self.is_text = True
            self._text += list(map(self._meant.__getitem__, alike)) * (count // len(alike))
        self._rows += count

    def _converted(self, cells: Sequence[str]) -> Float | None:
        """Cells as numbers, blank ones NaN; None where one is something else, or the mark is not that of the others."""
        joined = "".join(cells)
        mark = next((mark for mark in ".," if mark in joined), self._mark)
        if mark != (self._mark or mark) or "_" in joined:
            return None
        try:
            pointed = [cell.replace(",", ".") for cell in cells] if mark == "," else cells
            values = np.array([float(cell) if cell else np.nan for cell in pointed])
        except ValueError:
            return None
        if np.isfinite(values).sum() != len(cells) - cells.count(""):
            return None
        if mark and not self._mark:
            row = next(row for row, cell in enumerate(cells) if mark in cell)
            self._mark, self._first = mark, (self._rows + row, cells[row].strip())
        if mark and not self._decimal:
            words = [cell.strip() for cell in cells]
            self._thousands = self._thousands and _only_thousands(words, mark)
            self._decimal = next((cell for cell in words if _is_decimal(cell, mark)), "")
        return values

    def finished(self, source: str) -> Sequence[str]:
        """All cells; those of a column of text with decimal commas, beside n/a and its like, with points."""
        if not self.is_text:
            return Numbers(np.concatenate(self._numbers or [np.zeros(0)]))
        check_text(f"{source}, column {self.name[:80]!r}", self._text)
        meant = list(self._meant.values())
        pointed = _pointed(meant, source, self.name) or meant
        taken = {cell: cell for cell in pointed if cell.lower() not in NOT_TAKEN}
        if not self._named_text and taken and all(map(_is_number, taken)):  # all others are gaps
            numbers = dict(zip(meant, (float(taken.get(cell, "nan")) for cell in pointed), strict=True))
            return Numbers(np.array([numbers[cell] for cell in self._text]))
        if pointed is meant:
            return self._text
        return list(map(dict(zip(meant, pointed, strict=True)).__getitem__, self._text))

    def of_thousands(self, mark: str) -> tuple[int, str] | None:
        """First row and cell with a mark, where all that are may stand between thousands."""
        if not self.is_text:
            return self._first if self._mark == mark and self._thousands else None
        if not any(mark in cell for cell in self._meant.values()) or not _only_thousands(self._meant.values(), mark):
            return None
        return next((row, cell) for row, cell in enumerate(self._text) if mark in cell)

    def decimal(self, mark: str) -> str:
        """A number with the mark before its decimals; empty without."""
        if not self.is_text:
            return self._decimal if self._mark == mark else ""
        return next((cell for cell in self._meant.values() if _is_decimal(cell, mark)), "")


def check_columns(name: str, width: int) -> None:
    """Refuse a table that is wider than any is."""
    most = 16384  # columns, as many as Excel has
    if width > most:
        raise ValueError(f"{name} has {width} columns; up to {most} are read")


def read_cells(
    path: Path,
    sheet: str | None,
    is_text: Callable[[str], bool],
    is_unit: Callable[[str], bool],
    progress: Callable[[float], None],
) -> Cells | None:
    """Header and columns of a text file or a sheet; None where there is nothing.

    Comment lines (``#``), blank lines and empty columns at the end are left out; units in a line below the header go
    into the names, in brackets. Columns in which all cells are numbers become numbers as the rows arrive; others, and
    those that are text by their names, stay as they are written.
    """
    if sheet is not None and path.suffix.lower() not in EXCEL:
        raise ValueError(f"a sheet is an option of Excel files ({', '.join(EXCEL)}); {path.name} is a text file")
    rows = _sheet(path, sheet) if path.suffix.lower() in EXCEL else _text_rows(path, progress)
    first = _without_titles(list(islice(rows, _TITLE_ROWS)))
    if not first:
        return None
    header = [shown(_as_written(cell.strip())) for cell in first[0][1]]
    width = max((i + 1 for i, name in enumerate(header) if name), default=0)
    check_columns(path.name, width)
    if header and not any(map(_LETTER.search, header)):
        said = ", ".join(header[:4])
        raise ValueError(
            f"{path.name} has no header: its first line is {said[:80]}; write the names of the columns there"
        )
    if units := _units_below(path.name, [row for row in first[1:] if any(row[1])][:4], width, is_unit):
        header = [f"{name} ({unit})" if unit else name for name, unit in zip(header, units, strict=False)]
        del first[: 1 + next(i for i, row in enumerate(first[1:]) if any(row[1]))]
    columns = [_Column(name, is_text=is_text(name)) for name in header[:width]]
    lines: list[Index] = []
    rest = chain(first[1:], rows)
    while batch := list(islice(rest, _BATCH)):
        numbers, cells = _even(path.name, batch, width)
        if not lines and len(batch) == _BATCH and not any(map(_DIGIT.search, map("".join, cells))):
            raise ValueError(f"{path.name} is no table of readings: its first {_BATCH} rows hold no number")
        lines.append(np.array(numbers, dtype=np.intp))
        for column, own in zip(columns, zip(*cells, strict=True), strict=bool(cells)):
            column.add(own)
    if lost := [column.name for column in columns if column.lost]:
        return read_cells(path, sheet, lambda name: name in lost or is_text(name), is_unit, progress)
    numbered = np.concatenate(lines) if lines else np.zeros(0, dtype=np.intp)
    _refuse_thousands(path.name, columns, numbered)
    return header[:width], [column.finished(path.name) for column in columns], numbered


def first_rows(path: Path, sheet: str | None) -> dict[str | None, list[Sequence[str]]]:
    """Rows at the beginning of a text file, or of a sheet or all sheets by name, titles among them."""
    if path.suffix.lower() not in EXCEL:
        rows = islice(_text_rows(path, lambda share: None), _TITLE_ROWS)
        return {sheet: [_no_wider(path.name, cells) for _, cells in rows]}
    with path.open("rb") as stream:
        book = _workbook(path, stream)
        names = list(_sheets(path, book)) if sheet is None else [sheet]
        found: dict[str | None, list[Sequence[str]]] = {
            name: [cells for _, cells in islice(_sheet_rows(path, book, name), _TITLE_ROWS)] for name in names
        }
        book.close()
    return found


def _no_wider(name: str, cells: Sequence[str]) -> Sequence[str]:
    check_columns(name, len(cells))
    return cells


def frame_cells(frame: DataFrame, is_text: Callable[[str], bool], source: str = "DataFrame") -> Cells:
    """Columns of a table in memory, whose rows have the numbers that they would have below a header."""
    columns = [_Column(name, is_text=is_text(name)) for name in map(shown, map(str, frame.columns))]
    for at, column in enumerate(columns):
        values = frame.iloc[:, at]
        if len(frame):
            column.add(tuple(values.where(values.notna(), "").astype(str)))
    lines = np.arange(2, len(frame) + 2)
    _refuse_thousands(source, columns, lines)
    return [column.name.strip() for column in columns], [column.finished(source) for column in columns], lines


def _even(source: str, batch: Sequence[_Row], width: int) -> tuple[Sequence[int], Sequence[Sequence[str]]]:
    """Lines and cells of rows that are not blank, as many in each as there are columns."""
    lines, cells = zip(*batch, strict=True)
    if set(map(len, cells)) == {width} and all(map(any, cells)):
        return lines, cells
    kept = [(line, row) for line, row in batch if any(map(str.strip, row))]
    for line, row in kept:
        size = max((i + 1 for i, cell in enumerate(row) if cell.strip()), default=0)
        if len(row) < width or size > width:
            size = size if len(row) > width else len(row)
            raise ValueError(f"{source}: line {line} has {size} cells, the header has {width} columns")
    return [line for line, _ in kept], [row[:width] for _, row in kept]


def _without_titles(found: list[_Row]) -> list[_Row]:
    """Rows without those of a preamble: fewer than three cells, or fewer than a later row of words has."""
    sizes = [sum(bool(cell.strip()) for cell in row) for _, row in found]
    first = next((i for i, size in enumerate(sizes) if size > 2), 0)
    words = [
        size if not any(map(_is_number, map(str.strip, row))) else 0
        for size, (_, row) in zip(sizes, found, strict=True)
    ]
    widest = max(range(len(words)), key=lambda i: words[i], default=0)
    return found[widest if first < widest and words[widest] == max(sizes) > sizes[first] else first :]


def _units_below(source: str, found: Sequence[_Row], width: int, is_unit: Callable[[str], bool]) -> list[str]:
    """Units in the first row below a header, as far as it holds columns of numbers; empty where it is none of units."""
    rows = [[cell.strip() for cell in (*cells, *[""] * width)][:width] for _, cells in found]
    row, below = (rows or [[]])[0], rows[1:]
    words = [row[i] for i in range(len(row)) if row[i] and below and all(_is_number(other[i]) for other in below)]
    if len(words) < 2 or any(_is_number(cell) or cell.lower() in NOT_TAKEN for cell in words):
        return []
    if not all(map(is_unit, filter(None, row))):
        raise ValueError(
            f"{source}: line {found[0][0]} has no numbers, but {', '.join(map(repr, words[:4]))}. If these are units, "
            "the name of each column ends with its own (amplitude_um, frequency_hz): rename them and remove the line"
        )
    return row


def _refuse_thousands(source: str, columns: Sequence[_Column], lines: Index) -> None:
    """Refuse numbers such as 1,000 in a table with decimal points, and 1.000 in one with decimal commas."""
    for mark, other in ((",", "."), (".", ",")):
        doubtful = next(((column, at) for column in columns if (at := column.of_thousands(mark))), None)
        decimal = next(((column, cell) for column in columns if (cell := column.decimal(other))), None)
        if doubtful and decimal:
            column, (row, cell) = doubtful
            raise ValueError(
                f"{source}: line {lines[row]}, column {column.name!r}: {cell!r} may be {cell.replace(mark, '')} or "
                f"{cell.replace(mark, '.')}; column {decimal[0].name!r} writes decimals as in {decimal[1]!r}. Write "
                "all numbers in one way, without marks between thousands"
            )


def _only_thousands(cells: Iterable[str], mark: str) -> bool:
    """True if a column holds numbers, and all with the mark may be whole ones with a mark between thousands."""
    return all(
        _THOUSANDS.fullmatch(cell) if mark in cell else not cell or cell.lstrip("+-").isdigit() for cell in cells
    )


def _is_decimal(cell: str, mark: str) -> bool:
    return mark in cell and _is_number(cell) and not _THOUSANDS.fullmatch(cell)


def _is_number(cell: str) -> bool:
    return bool(_POINT.fullmatch(cell) or _COMMA.fullmatch(cell))


_BLOCK = 1 << 20  # bytes of a file that are decoded at a time


def marked_encoding(raw: bytes) -> str:
    """Encoding that the first bytes of a text tell; empty where they do not: UTF-8 or an older one."""
    encoding = next((name for mark, name in _MARKS if raw.startswith(mark)), "")
    if not encoding and raw[:400].count(0) > len(raw[:400]) // 4:  # UTF-16 without its mark: every other byte is zero
        encoding = "utf-16-le" if raw[1:2] == b"\0" else "utf-16-be"
    return encoding


def encoding_of(path: Path) -> str:
    """Encoding of a text file: UTF-8, UTF-16 or, as old programs save it, Windows' Western code page."""
    state = path.stat()
    return _encoding(path, state.st_size, state.st_mtime_ns)


@lru_cache(maxsize=16)
def _encoding(path: Path, _size: int, _time: int) -> str:
    """The same of a file as it is now: all of it is looked through, once for all who ask."""
    with path.open("rb") as stream:
        head = stream.read(400)
        if head.startswith((_ARCHIVE, _OLD_EXCEL)):
            raise ValueError(f"{path.name} is no text but a workbook, as Excel writes them: {_workbook_advice(head)}")
        stream.seek(0)
        marked, reason = marked_encoding(head), ""
        if problem := _no_lines(stream, b"\0" * 4 if marked else b"\0"):
            raise ValueError(f"{path.name} {problem}")
        for encoding in (marked,) if marked else ("utf-8", "cp1252"):
            reason = _undecodable(stream, encoding)
            if not reason:
                return encoding
            if marked:
                raise ValueError(f"{path.name} is not text: {reason}")
    raise ValueError(f"{path.name} is neither UTF-8 nor Windows-1252 text ({reason}); save it as CSV UTF-8")


def _no_lines(stream: BinaryIO, zeros: bytes) -> str:
    """Why a stream is no text of lines, told by its bytes; empty where it may be."""
    longest = 1 << 24  # bytes of a line
    since, seen = 0, False
    for block in iter(partial(stream.read, _BLOCK), b""):
        ends = [at for at in (block.find(b"\n"), block.find(b"\r")) if at >= 0]
        if since + min(ends, default=len(block)) >= longest:
            return f"is no table: {'a' if seen else 'its first'} line is longer than {longest} bytes"
        if zeros in block:
            return "is not text: it has zero bytes"
        since = len(block) - 1 - max(block.rfind(b"\n"), block.rfind(b"\r")) if ends else since + len(block)
        seen = seen or bool(ends)
    return ""


def _undecodable(stream: BinaryIO, encoding: str) -> str:
    """Why a stream is not in an encoding, empty where it is; block by block, as recordings may not fit memory."""
    stream.seek(0)
    decoder, before, block = codecs.getincrementaldecoder(encoding)(), 0, b"-"
    while block:
        block = stream.read(_BLOCK)
        kept = len(decoder.getstate()[0])  # bytes of a character that the last block cut
        try:
            decoder.decode(block, final=not block)
        except UnicodeDecodeError as problem:
            return f"{problem.reason} at byte {before - kept + problem.start}"
        before += len(block)
    return ""


def _workbook_advice(raw: bytes) -> str:
    if raw.startswith(_OLD_EXCEL):
        return "it is of the old kind, .xls; save it as .xlsx, or as CSV"
    return "name it .xlsx, or save it as CSV"


def _text_rows(path: Path, progress: Callable[[float], None]) -> Iterator[_Row]:
    with path.open(encoding=encoding_of(path)) as stream:
        skipped: list[int] = []
        lines = chain.from_iterable(_content(stream, skipped, path.stat().st_size, progress))
        head = list(islice(lines, _TITLE_ROWS))
        delimiter = ""
        if head and re.fullmatch(r"sep=.", head[0].strip()):  # written by Excel
            delimiter = head.pop(0).strip()[4]
            skipped.insert(0, 0)
        if not head:
            return
        counts = [max(map(line.count, ",;\t")) for line in head]
        first = next((i for i, count in enumerate(counts) if count > 1), 0)  # a title has none, or a comma
        reader = csv.reader(chain(head, lines), delimiter=delimiter or max(",;\t", key=head[first].count), strict=True)
        try:
            for row in reader:
                yield reader.line_num + bisect_left(skipped, reader.line_num), row
        except csv.Error as error:
            raise ValueError(f"{path.name} is not a readable CSV: {error}") from error


def _content(stream: TextIO, skipped: list[int], size: int, progress: Callable[[float], None]) -> Iterator[list[str]]:
    """Lines that are not blank and no comments, many at a time; of others, how many of these stand above is noted."""
    count = 0
    while lines := stream.readlines(1 << 16):
        if "#" in "".join(lines) or not all(map(str.strip, lines)):
            kept = []
            for line in lines:
                if line.strip() and not _is_comment(line.lstrip()):
                    kept.append(line)
                else:
                    skipped.append(count + len(kept))
            lines = kept
        count += len(lines)
        progress(min(1.0, stream.buffer.tell() / size))
        yield lines


def _is_comment(text: str) -> bool:
    return text.startswith("#") and not _SHEET_ERROR.match(text)


def _sheet(path: Path, sheet: str | None) -> Iterator[_Row]:
    with path.open("rb") as stream:
        book = _workbook(path, stream)
        yield from _sheet_rows(path, book, sheet or next(iter(_sheets(path, book))))
        book.close()


def _sheet_rows(path: Path, book: Any, sheet: str) -> Iterator[_Row]:
    sheets = _sheets(path, book)
    if sheet not in sheets:
        raise ValueError(f"{path.name}: {unknown_name('sheet', sheet, sheets)}")
    size, taken = path.stat().st_size, 0
    for line, row in enumerate(sheets[sheet].iter_rows(values_only=True), 1):
        # Memory that an empty cell takes; a sheet with one cell in its last row and column has 1.7e10 of them
        cell_bytes = 8
        taken += cell_bytes * len(row)
        check_unpacked(path.name, taken, size)
        # a whole number that Excel holds as a float keeps no point
        cells = ["" if c is None else f"{c:.17g}" if isinstance(c, float) else str(c).strip() for c in row]
        if any(cells) and not _is_comment(cells[0]):
            yield line, cells


def _sheets(path: Path, book: Any) -> dict[str, Any]:
    """Sheets of cells by name, at least one; a chart that has a sheet of its own is none."""
    sheets = {sheet.title: sheet for sheet in book.worksheets}
    if not sheets:
        raise ValueError(f"{path.name}: the workbook has no sheet with cells")
    return sheets


def _workbook(path: Path, stream: BinaryIO) -> Any:
    try:
        from openpyxl import load_workbook
        from openpyxl.utils.exceptions import InvalidFileException
    except ImportError as reason:
        raise ValueError(f'{path.name}: Excel files need openpyxl: pip install "rotorfit[excel]"') from reason
    from zipfile import BadZipFile

    try:
        check_archive(path)
        check_sheets(path)
        return load_workbook(stream, read_only=True, data_only=True)
    except (BadZipFile, InvalidFileException, KeyError) as reason:
        head = beginning(path, 4)
        advice = (
            "a part of its archive is damaged or missing"
            if head == _ARCHIVE
            else _workbook_advice(head)
            if head == _OLD_EXCEL
            else "it is no workbook; a text file is named .csv or .txt"
        )
        raise ValueError(f"{path.name} is not a readable Excel file: {advice}") from reason


def _pointed(cells: Sequence[str], source: str, name: str) -> Sequence[str] | None:
    """Cells of a column of numbers with decimal commas, with points; None for other columns."""
    with_comma = [bool(_COMMA.fullmatch(cell)) for cell in cells]
    if not any(with_comma) or not all(
        comma or cell.lower() in NOT_TAKEN or _POINT.fullmatch(cell)
        for cell, comma in zip(cells, with_comma, strict=True)
    ):
        return None
    if points := [cell for cell in cells if "." in cell and cell.lower() not in NOT_TAKEN]:
        raise ValueError(
            f"{source}: column {name!r} has decimal points and decimal commas "
            f"({points[0]}, {cells[with_comma.index(True)]}); use one of them"
        )
    return [cell.replace(",", ".") for cell in cells]
