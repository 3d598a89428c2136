"""Reading files of unknown origin: one boundary for what packages raise over damaged ones, limits, and seals.

What a file declares is checked before memory is taken, so that a small file stays small. ``docs/files.md`` states the
limits; the environment variable ``ROTORFIT_FILE_LIMITS=10`` multiplies all of them.
"""

from __future__ import annotations

import hashlib
import mmap
import os
import re
import struct
import subprocess
import sys
import tomllib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from rotorfit.base.atomic_file import note_input
from rotorfit.base.digits import significant
from rotorfit.base.faults import of_program

_HEAP = b"GCOL\x01\0\0\0"
"""How a heap of an HDF5 file begins."""


def _factor() -> float:
    given = os.environ.get("ROTORFIT_FILE_LIMITS", "1")
    try:
        factor = float(given)
    except ValueError:
        factor = np.nan
    if not factor > 0:
        raise ValueError(f"the environment variable ROTORFIT_FILE_LIMITS is a positive factor, not {given!r}")
    return factor


def allowed_bytes(size: int) -> int:
    """Bytes that a file, or text, of this many bytes may unpack to."""
    always_allowed = 1 << 26  # bytes that any file may unpack to
    packing_ratio = 100  # bytes that a byte of a larger file may unpack to; signals are packed to a tenth or so
    return int(_factor() * max(always_allowed, packing_ratio * size))


def check_unpacked(name: str, declared: float, size: int) -> None:
    """Refuse a file of ``size`` bytes that declares more content than it may."""
    if declared > allowed_bytes(size):
        raise ValueError(
            f"{name} has {size} bytes and declares content of {significant(declared, 2)}, more than the "
            f"{significant(allowed_bytes(size), 2)} "
            "that are allowed; if the file is right, set the environment variable ROTORFIT_FILE_LIMITS to 10"
        )


def decompressed(name: str, packed: bytes | memoryview, size: int) -> bytes:
    """Content that zlib packed, of a file of ``size`` bytes; one that unpacks to too much is refused before it does."""
    import zlib

    most = allowed_bytes(size)
    unpacking = zlib.decompressobj()
    content = unpacking.decompress(packed, most)
    if unpacking.unconsumed_tail:
        check_unpacked(name, most + 1.0, size)
    if not unpacking.eof:
        raise ValueError(f"{name}: packed content is cut short")
    return content


def check_text(name: str, cells: Sequence[str]) -> None:
    """Refuse a column of text with a cell too long: an array takes the room of its longest cell for every row."""
    longest = max(map(len, set(cells)), default=0)
    longest_cell = 32767  # characters of a cell, as many as Excel allows
    if longest > _factor() * longest_cell:
        raise ValueError(f"{name}: a cell of {longest} characters; up to {_factor() * longest_cell:.0f} are allowed")
    room = 4 * len(cells) * longest
    if room > allowed_bytes(0) and room > allowed_bytes(sum(map(len, cells))):
        raise ValueError(
            f"{name}: a cell of {longest} characters in a column of {len(cells)} rows, of which each would take as "
            "much room; shorten it, or leave the column out"
        )


def check_archive(path: Path) -> None:
    """Refuse a ZIP archive, which a workbook is, that unpacks to more than it may."""
    from zipfile import ZipFile

    with ZipFile(path) as archive:
        check_unpacked(path.name, sum(part.file_size for part in archive.infolist()), path.stat().st_size)


def check_sheets(path: Path) -> None:
    """Refuse a workbook of more sheets than anybody keeps, each of which would be looked at, by what lists them."""
    from zipfile import ZipFile

    most = 256 * _factor()
    with ZipFile(path) as archive:
        types = archive.read("[Content_Types].xml").decode(errors="replace")
        lists = {f[1] for f in re.finditer(r"<[^>]*PartName=[\"']/([^\"']+)[^>]*>", types) if "main+xml" in f[0]}
        held = [name for name in archive.namelist() if name in {*lists, "xl/workbook.xml"}]
        sheets = sum(len(re.findall(rb"<(?:\w+:)?sheet\s", archive.read(name))) for name in held)
    if sheets > most:
        raise ValueError(f"{path.name} has {sheets} sheets; up to {most:.0f} are read; save the one that is a test")


def beginning(path: Path, size: int) -> bytes:
    """The first bytes of a file, which may be of any length."""
    with path.open("rb") as stream:
        return stream.read(size)


def end_of(path: Path, size: int) -> bytes:
    """The last bytes of a file, which may be of any length."""
    with path.open("rb") as stream:
        stream.seek(max(path.stat().st_size - size, 0))
        return stream.read(size)


def check_whole(path: Path, what: str) -> None:
    """Refuse a text that would be read as a whole and is longer than any test."""
    most = _factor() * (1 << 28)
    if (size := path.stat().st_size) > most:
        raise ValueError(
            f"{path.name} has {size} bytes; up to {most:.0f} are read of {what}; if it is right, set the "
            "environment variable ROTORFIT_FILE_LIMITS to 10"
        )


# ---- HDF5 --------------------------------------------------------------------------------------


_OPEN = """
import sys, time, h5py
try:
    from resource import RLIMIT_CPU, setrlimit
    setrlimit(RLIMIT_CPU, 2 * (int(time.process_time()) + 2,))  # one second or two, whatever else the machine does
except ImportError:
    pass
with h5py.File(sys.argv[1], "r") as file:
    file.id.links.visit(lambda name: None)
    file.visititems(lambda name, item: item[()] if isinstance(item, h5py.Dataset) and item.nbytes < 1e6 else None)
"""


def refuse_deadly(path: Path) -> None:
    """Refuse a damaged HDF5 file over which the library ends the process: another process opens it first."""
    words = [sys.executable, "-c", _OPEN, str(path)]
    minute = 60.0  # where processor time has no limit
    try:
        ended = subprocess.run(words, capture_output=True, timeout=minute, check=False)
    except subprocess.TimeoutExpired:
        raise ValueError(f"{path.name} is not a readable HDF5 file: the library finds no end of it") from None
    if ended.returncode < 0:
        raise ValueError(f"{path.name} is not a readable HDF5 file: it is damaged so that the library fails")
    if ended.returncode:  # asked again, over the same bytes, it may end the process
        raise OSError(ended.stderr.decode(errors="replace").strip().rpartition("\n")[2].partition(": ")[2])


def check_hdf5(path: Path) -> None:
    """Refuse an HDF5 file that declares too much, reads from other files, or has damaged heaps. The library loops for
    ever over some of these, and takes external storage from wherever the file says."""
    import h5py

    _check_heaps(path)
    foreign: list[str] = []
    declared: list[float] = []
    untold: list[bytes] = []

    def look_at_link(name: bytes, info: h5py.h5l.LinkInfo) -> None:
        try:
            name.decode()
        except UnicodeDecodeError:  # h5py hands it on as bytes
            untold.append(name)
        if info.type == h5py.h5l.TYPE_EXTERNAL:
            foreign.append(name.decode(errors="replace"))

    def look_at(name: str, item: h5py.Group | h5py.Dataset) -> None:
        if isinstance(item, h5py.Dataset):
            declared.append(float(np.prod(item.shape or (0,), dtype=float)) * item.dtype.itemsize)
            if item.external or item.is_virtual:
                foreign.append(name)

    with h5py.File(path, "r") as file:
        _refuse_nested(path.name, file)
        file.id.links.visit(look_at_link, info=True)
        if untold:
            raise ValueError(f"{path.name}: the name {untold[0]!a} in it is no text in UTF-8; rename it")
        file.visititems(look_at)
    if foreign:
        raise ValueError(f"{path.name}: {foreign[0]} is kept in another file, which is not read; copy it into this one")
    check_unpacked(path.name, sum(declared), path.stat().st_size)


def _refuse_nested(name: str, file: Any) -> None:
    """Refuse groups in groups without end: the library goes into each from within the one before, and ends the process.
    A group that several others hold is looked into once."""
    from h5py import h5g, h5l, h5o

    deepest, most = 100, 16384  # groups in one another, and entries of all together
    todo, seen, count = [(file["/"].id, 0)], set(), 0
    while todo:
        group, depth = todo.pop()
        if depth > deepest:
            raise ValueError(f"{name}: groups stand in one another more than {deepest} deep; no test is kept so")
        count += len(group)
        if count > most:
            raise ValueError(f"{name} holds more than {most} groups and data sets; no test is kept so")
        for link in group:
            if group.links.get_info(link).type == h5l.TYPE_HARD:
                item = h5o.get_info(group, link)
                if item.type == h5o.TYPE_GROUP and item.addr not in seen:
                    seen.add(item.addr)
                    todo.append((h5g.open(group, link), depth + 1))


def _check_heaps(path: Path) -> None:
    """Refuse a free piece of no length, over which the library would loop."""
    scanned = 1 << 28  # bytes at the beginning of an HDF5 file in which its heaps of text are looked at
    with path.open("rb") as stream:
        if not path.stat().st_size:
            return
        with mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as content:
            at = content.find(_HEAP, 0, scanned)
            while at >= 0:
                (size,) = struct.unpack_from("<Q", content[at : at + 16].ljust(16, b"\0"), 8)
                piece, end = at + 16, min(at + size, len(content))
                while piece + 16 <= end:
                    number, _, length = struct.unpack_from("<HHxxxxQ", content, piece)
                    step = 16 + -(-length // 8) * 8 if number else length
                    if step < 1 or piece + step > end:
                        raise ValueError(f"{path.name} is not a readable HDF5 file: a heap of its text is damaged")
                    piece += step
                at = content.find(_HEAP, at + 1, scanned)


# ---- MAT ---------------------------------------------------------------------------------------

_DIMENSIONS, _MATRIX, _COMPRESSED = (5, 6), 14, 15  # SciPy takes dimensions with and without a sign
_ELEMENTS = 1 << 20
"""Elements of a MAT file, or of one of its arrays, beyond which no test is kept so."""


def check_mat(path: Path) -> None:
    """Refuse a MAT file of versions 4 to 7 whose variables declare more than the file holds or may unpack to."""
    from scipy.io.matlab import matfile_version

    with path.open("rb") as stream:
        major, _ = matfile_version(stream)
    content = np.memmap(path, dtype=np.uint8, mode="r").data
    widths = (8, 4, 4, 2, 2, 1)  # bytes of a number of version 4, by its type
    if major == 0:
        order = "<" if 0 <= struct.unpack_from("<i", content)[0] < 5000 else ">"
        at = number = 0
        while at + 20 <= len(content):
            _count_element(path.name, number := number + 1)
            kind, rows, columns, is_complex, letters = struct.unpack_from(f"{order}5i", content, at)
            length = rows * columns * widths[min(kind // 10 % 10, 5)] * (2 if is_complex else 1)
            at += 20 + letters + length
            if min(rows, columns, letters) < 0 or at > len(content):
                raise ValueError(f"{path.name} is not a readable MAT file: a variable is longer than the file")
    elif major == 1:
        order = "<" if bytes(content[126:128]) == b"IM" else ">"
        _check_elements(path.name, content[128:], order, len(content), inside=False)


def _count_element(name: str, number: int) -> None:
    if number > _factor() * _ELEMENTS:
        raise ValueError(f"{name} holds more than {_factor() * _ELEMENTS:.0f} elements; no test is kept so")


def _check_elements(name: str, content: memoryview, order: str, size: int, *, inside: bool) -> None:
    """Elements one after the other, of a file of version 5 or inside one of its arrays."""
    at = number = 0
    pointer = 16  # bytes of memory that an element of an array takes at most before its content is read
    while at + 8 <= len(content):
        _count_element(name, number)
        kind, length = struct.unpack_from(f"{order}II", content, at)
        if not kind:
            raise ValueError(f"{name} is not a readable MAT file: an element of it is of no type")
        short = kind >> 16
        begin, length, kind = (at + 4, short, kind & 0xFFFF) if short else (at + 8, length, kind)
        if begin + length > len(content):
            raise ValueError(f"{name} is not a readable MAT file: an element of {length} bytes is longer than the file")
        part = content[begin : begin + length]
        at = at + 8 if short else begin + (length if kind == _COMPRESSED else -(-length // 8) * 8)
        if kind == _COMPRESSED:
            _check_elements(name, memoryview(decompressed(name, part, size)), order, size, inside=False)
        elif kind == _MATRIX:
            _check_elements(name, part, order, size, inside=True)
        elif inside and number == 1 and kind in _DIMENSIONS:
            if len(part) < 8:  # SciPy ends the process over text without dimensions
                raise ValueError(f"{name} is not a readable MAT file: a variable has fewer than two dimensions")
            shape = struct.unpack_from(f"{order}{len(part) // 4}i", part)
            check_unpacked(name, abs(float(np.prod(shape, dtype=float))) * pointer, size + len(content))
        number += 1


_WORDS = 160
"""Characters of a package's own message that are passed on."""
_LONG = re.compile(r"(\S{300})\S+")
"""A cell or name too long for a sentence."""
_PYTHON = re.compile(r"<(?:class ')?([\w.]+)(?:'| object at 0x[0-9a-f]+)>")
"""A type, or an object without a name of its own, as Python writes it."""

_STEERING = re.compile("[\x00-\x1f\x7f-\x9f\u2028-\u202e\u2066-\u2069\ud800-\udfff]")
"""Characters that steer a terminal, begin a line or turn the direction of writing, and halves of characters."""

_SEAL = b"rotorfit sha256 "
"""First bytes of a checksum at the end of a file."""


def shown(name: str) -> str:
    """A name that a file gives, as it is shown and written: on one line, and unable to steer what shows it."""
    return _STEERING.sub(lambda found: found[0].encode("unicode_escape").decode(), name)


def shown_lines(text: str) -> str:
    """The same of text that has lines and columns of its own."""
    return "\n".join("\t".join(map(shown, line.split("\t"))) for line in text.split("\n"))


@contextmanager
def reading(name: str, kind: str, *, decoded: bool = False) -> Iterator[None]:
    """Turn what a library raises over a file, ``kind`` being what it should be, into one :class:`ValueError` of one
    line that names it. Sentences that name the file pass, and so do what the system says of a path, a missing package
    and errors of the program; of ``decoded`` content, entries that are missing or of another kind are the file's. A
    name that is no text of one line is refused: it goes into figures, tables and stores.
    """
    if shown(name) != name:
        raise ValueError(
            f"{name!a}: names of files and folders must be text in UTF-8 without control characters; rename it"
        )
    try:
        yield
    except MemoryError as problem:
        raise ValueError(
            f"{name} takes more memory than there is, as a damaged {kind} may that declares what it does not hold"
        ) from problem
    except RecursionError as problem:
        raise ValueError(f"{name} is not a readable {kind}: its content is nested too deeply") from problem
    except Exception as problem:
        of_content = decoded and isinstance(problem, (LookupError, TypeError, ValueError, AttributeError))
        if isinstance(problem, ImportError) or (of_program(problem) and not of_content):
            raise
        words = _PYTHON.sub(r"\1", _LONG.sub(r"\1...", " ".join(str(problem).split())))
        of_a_path = isinstance(problem, OSError) and problem.filename is not None
        sentence = isinstance(problem, ValueError) and name in words
        if of_a_path or (sentence and words == str(problem)):
            raise
        if sentence:
            raise ValueError(words) from problem
        readable = isinstance(problem, (ValueError, OSError, RuntimeError)) and words.isprintable()
        why = f": {words[:_WORDS]}" if words and readable else ""
        raise ValueError(
            f"{name} is not a readable {kind} (cut short, damaged, or of another format){why}"
        ) from problem


def read_toml(path: Path, name: str) -> dict[str, Any]:
    """Content of a TOML file."""
    note_input(path)
    check_whole(path, "TOML")
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as problem:
        raise ValueError(
            f"{name}: a TOML file is UTF-8 text, byte {problem.start} is not; save it as UTF-8"
        ) from problem
    most_parts = 64 * _factor()  # of a key: reading takes their square of memory
    if any(piece.count(".") > most_parts for piece in re.split(r"[=,{}\[\]\n]", text)):
        raise ValueError(f"{name}: a key of more than {most_parts:.0f} parts")
    content: dict[str, Any] = shown_within(tomllib.loads(text))
    return content


def shown_within(value: Any) -> Any:
    """Values that a file gives with all texts in them as they are shown."""
    if isinstance(value, dict):
        return {shown_within(key): shown_within(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return type(value)(map(shown_within, value))
    return shown(value) if isinstance(value, str) else value


def seal(path: Path) -> None:
    """Put a checksum of all bytes behind a file whose format ends before; an HDF5 file loses it where it is changed."""
    with path.open("rb+") as file:
        digest = hashlib.file_digest(file, "sha256").digest()
        file.write(_SEAL + digest)


def is_sealed(path: Path) -> bool | None:
    """True if a file is as it was sealed; None if it has no seal, as those of earlier versions and of others."""
    size = path.stat().st_size - 48
    with path.open("rb") as stream:
        stream.seek(max(size, 0))
        mark, digest = stream.read(16), stream.read(32)
        if mark != _SEAL:
            return None
        stream.seek(0)
        found = hashlib.sha256()
        piece = 1 << 20
        for at in range(0, size, piece):
            found.update(stream.read(min(piece, size - at)))
    return found.digest() == digest


def check_seal(path: Path, name: str) -> None:
    """Refuse a file that is not as it was sealed."""
    if is_sealed(path) is False:
        raise ValueError(f"{name} is damaged: its bytes are not those that were written (the checksum does not agree)")
