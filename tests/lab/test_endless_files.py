"""What is no test, nested, junk or too wide, is refused soon and in little memory."""

from __future__ import annotations

import json
import os
import re
import resource
import struct
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from zipfile import ZipFile

import h5py
import numpy as np
import pytest

import rotorfit as rf


@contextmanager
def soon() -> Iterator[None]:
    """The ten seconds of processor time that are promised, and a fifth of a gigabyte."""
    begin, before = time.process_time(), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    yield
    assert time.process_time() - begin < 10
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 2e5  # kB


@pytest.mark.parametrize("read", [rf.read, rf.read_recording])
@pytest.mark.parametrize(
    ("text", "said"),
    [
        (lambda: f"{','.join(f'c{i}' for i in range(300000))}\n{','.join('1' * 300000)}\n", "has 300000 columns"),
        (lambda: "1,2;" * (1 << 23), "is no table: its first line is longer than 16777216 bytes"),
    ],
)
def test_tables_that_are_none(
    read: Callable[[Path], object], text: Callable[[], str], said: str, tmp_path: Path
) -> None:
    path = tmp_path / "a.csv"
    path.write_text(text(), encoding="utf-8")
    with soon(), pytest.raises(ValueError, match=rf"^a\.csv {said}"):
        read(path)


@pytest.mark.parametrize("read", [rf.read, rf.read_recording])
@pytest.mark.parametrize("tail", ["zero bytes", "a line"])
def test_what_is_a_table_at_its_beginning_alone(read: Callable[[Path], object], tail: str, tmp_path: Path) -> None:
    """4 GB that are not on the disk behind two megabytes of lines, and 34 MB without an end of line."""
    path = tmp_path / "a.csv"
    path.write_text(
        "a,b,c\n" + "1,2,3\n" * (1 << 18) + ("4," * (1 << 24) if tail == "a line" else ""), encoding="utf-8"
    )
    if tail == "zero bytes":
        os.truncate(path, 1 << 32)
    said = "is no table: a line is longer than 16777216 bytes" if tail == "a line" else "is not text: it has zero bytes"
    with soon(), pytest.raises(ValueError, match=rf"^a\.csv {said}"):
        read(path)


def test_a_table_longer_than_any_test_is_refused_before_it_is_read(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    with path.open("wb") as file:
        file.write(b"a,b,c\n")
        for _ in range(43):
            file.write(b"1,2,3\n" * (1 << 20))
    with soon(), pytest.raises(ValueError, match=r"^a\.csv has \d+ bytes; up to 268435456 are read of a table"):
        rf.read(path)


def test_workbooks_and_files_of_thousands_of_parts(tmp_path: Path) -> None:
    """Sheets were each looked at anew; entries of an HDF5 file took a fifth of a millisecond."""
    from openpyxl import Workbook

    book = Workbook()
    for number in range(300):
        book.create_sheet(f"sheet {number}").append(["a", 1])
    book.save(tmp_path / "a.xlsx")
    with h5py.File(tmp_path / "a.h5", "w") as file:
        for number in range(17000):
            file.create_group(f"g{number}")
    with soon(), pytest.raises(ValueError, match=r"^a\.xlsx has 301 sheets; up to 256 are read"):
        rf.read(tmp_path / "a.xlsx")
    with soon(), pytest.raises(ValueError, match=r"^a\.h5 holds more than 16384 groups and data sets"):
        rf.read_recording(tmp_path / "a.h5")


def test_records_of_hundred_thousands_of_keys(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    path.write_text(json.dumps([{f"k{i}": 1 for i in range(200_000)}] * 2), encoding="utf-8")
    with soon(), pytest.raises(ValueError, match=r"^a\.json has 200000 columns; up to 16384 are read"):
        rf.read(path)


def test_millions_of_records_of_nothing(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    path.write_text("[" + ",".join(['{"a":1}'] * 2_000_000) + "]", encoding="utf-8")
    with soon(), pytest.raises(ValueError, match=r"^a\.json would take .* bytes of memory"):
        rf.read(path)


def test_sheets_that_share_a_part(tmp_path: Path) -> None:
    """One sheet named thousands of times in the list, wherever the parts of the workbook stand."""
    from openpyxl import Workbook

    book = Workbook()
    book.active.append(["a", 1])
    book.save(tmp_path / "whole.xlsx")
    with ZipFile(tmp_path / "whole.xlsx") as whole, ZipFile(tmp_path / "a.xlsx", "w") as made:
        for name in whole.namelist():
            text = whole.read(name).decode().replace("/xl/workbook.xml", "/xl/wb.xml")
            text = re.sub("<sheet [^>]*>", lambda one: one[0] * 9000, text)
            made.writestr(name.replace("workbook.xml", "wb.xml"), text)
    with soon(), pytest.raises(ValueError, match=r"^a\.xlsx has 9000 sheets; up to 256 are read"):
        rf.read(tmp_path / "a.xlsx")
    with ZipFile(tmp_path / "b.xlsx", "w") as made:
        made.writestr("xl/workbook.xml", "")
    with pytest.raises(ValueError, match=r"b\.xlsx is not a readable"):
        rf.read(tmp_path / "b.xlsx")


@pytest.mark.parametrize("suffix", ["csv", "uff", "nc", "mat", "json", "xlsx", "lvm", "txt"])
@pytest.mark.parametrize("read", [rf.read, rf.load_fit])
def test_gigabytes_of_junk(read: Callable[[Path], object], suffix: str, tmp_path: Path) -> None:
    """Of zeros, or with a beginning that is none: the rest is not read."""
    path = tmp_path / f"a.{suffix}"
    for begin in (b"", b"lorem ipsum dolor\n", b"\xff\xd8\xff\xe0 JFIF"):
        path.write_bytes(begin)
        os.truncate(path, 2 << 30)
        with soon(), pytest.raises(ValueError, match=r"a\."):
            read(path)


_WAV = b"RIFF\xff\xff\xff\xffWAVEfmt " + struct.pack("<IHHIIHH", 16, 1, 2, 4096, 16384, 4, 16)
_MAT = b"MATLAB 5.0 MAT-file".ljust(124) + b"\0\1IM"


@pytest.mark.parametrize(
    ("suffix", "begin", "repeated", "said"),
    [
        ("wav", _WAV, b"\0" * 8, "it has no samples in its first 4096 parts"),
        ("wav", _WAV, b"JUNK\0\0\0\0", "it has no samples in its first 4096 parts"),
        ("uff", b"    -1\n    58\n", b"\0" * 8, "its last data set has no end"),
        ("mat", _MAT, b"\0" * 8, "an element of it is of no type"),
        ("mat", _MAT, struct.pack("<II", 1, 0), "holds more than 10486 elements"),
        ("mat", _MAT + struct.pack("<II", 14, 1 << 31), struct.pack("<II", 1, 0), "more than 10486 elements"),
        ("mat", struct.pack("<5i", 1000, 1, 1, 0, 2) + b"a\0" + b"\0" * 8, b"", "more than 10486 elements"),
    ],
)
def test_parts_without_end_behind_a_right_beginning(
    suffix: str, begin: bytes, repeated: bytes, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ROTORFIT_FILE_LIMITS", "0.01")
    path = tmp_path / f"a.{suffix}"
    with path.open("wb") as file:
        file.write(begin)
        file.write((repeated or begin) * 11000)
    os.truncate(path, 3 << 30)
    with soon(), pytest.raises(ValueError, match=rf"a\.{suffix}.*{said}"):
        rf.read_recording(path)


def test_groups_in_groups_without_end(tmp_path: Path) -> None:
    """Over 20,000 of them the library ends the process; groups that hold each other have an end."""
    with h5py.File(tmp_path / "a.h5", "w") as file:
        group = file
        for _ in range(5000):
            group = group.create_group("g")
    with soon(), pytest.raises(ValueError, match=r"^a\.h5: groups stand in one another more than 100 deep"):
        rf.read_recording(tmp_path / "a.h5")
    with h5py.File(tmp_path / "b.h5", "w") as file:
        before = file.create_group("g0")
        for number in range(1, 60):  # 2 to the power of 59 ways to the first
            group = file.create_group(f"g{number}")
            group["left"] = group["right"] = before
            before = group
        before["again"] = file["/"]
        file["disk_X"] = np.zeros(4)
    with soon(), pytest.raises(ValueError, match=r"b\.h5"):
        rf.read_recording(tmp_path / "b.h5")
