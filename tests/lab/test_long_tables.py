"""Tables of more rows than are turned into columns at once: what stands far down counts as what stands on top."""

from __future__ import annotations

import tracemalloc
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from sentences import refuses, warns

import rotorfit as rf
from rotorfit.lab.data.experiments import PerturbationTest
from rotorfit.lab.data.rows import Experiment

HEADER = ("run", "speed_rpm", "frequency_rpm", "force_plane", "force_N", "force_phase_deg", "plane", "direction",
          "amplitude_um", "phase_deg", "valve")  # fmt: skip
ROWS, FAR = 1500, 1201
AMPLITUDE, VALVE = HEADER.index("amplitude_um"), HEADER.index("valve")


def rows(count: int = ROWS) -> list[list[str]]:
    """Cells of a sweep, whose amplitudes in um are the numbers of the rows."""
    return [
        ["007", "3000", str(300 + row / 4), "disk", "2.5", "0", "disk", "xy"[row % 2], f"{row + 1}.25", "-90", "12"]
        for row in range(count)
    ]


def written(path: Path, cells: Sequence[Sequence[str]], separator: str = ",", header: Sequence[str] = HEADER) -> Path:
    path.write_text("\n".join(separator.join(row) for row in [header, *cells]) + "\n", encoding="utf-8")
    return path


def read(path: Path) -> PerturbationTest:
    test: Experiment = rf.read(path, difference=False)
    assert isinstance(test, PerturbationTest)
    return test


def amplitudes(test: PerturbationTest) -> np.ndarray:
    return np.round(np.abs(test.response) * 1e6, 9)


EXPECTED = np.arange(ROWS) + 1.25


def test_numbers_commas_and_lines_of_a_long_table(tmp_path: Path) -> None:
    plain = read(written(tmp_path / "a.csv", rows()))
    np.testing.assert_array_equal(amplitudes(plain), EXPECTED)
    assert plain.runs == ("007",)
    np.testing.assert_array_equal(plain.attributes["valve"], np.full(ROWS, 12.0))
    commas = read(written(tmp_path / "b.csv", [[cell.replace(".", ",") for cell in row] for row in rows()], ";"))
    np.testing.assert_array_equal(commas.response, plain.response)
    assert commas.attributes["valve"].dtype == float

    text = (tmp_path / "a.csv").read_text(encoding="utf-8").splitlines()
    text[700:700] = ["# stopped for lunch", "", "  # and again"]
    (tmp_path / "c.csv").write_text("\r\n".join(text), encoding="cp1252")
    lines: list[np.ndarray] = []
    shares: list[float] = []
    again = rf.read(tmp_path / "c.csv", on_lines=lines.append, progress=shares.append)
    assert isinstance(again, PerturbationTest)
    np.testing.assert_array_equal(again.response, plain.response)
    assert lines[0].tolist() == [*range(2, 701), *range(704, ROWS + 5)]
    assert shares == sorted(shares)
    assert shares[-1] == 1.0


def test_text_far_down_leaves_the_cells_above_as_they_were_written(tmp_path: Path) -> None:
    cells = rows()
    for row in cells:
        row[VALVE] = "012"
    cells[FAR][VALVE] = "open"
    test = read(written(tmp_path / "a.csv", cells))
    assert test.attributes["valve"][[0, FAR]].tolist() == ["012", "open"]
    cells[FAR][VALVE] = "n/a"
    test = read(written(tmp_path / "b.csv", cells))
    assert np.isnan(test.attributes["valve"]).tolist() == [row == FAR for row in range(ROWS)]


@pytest.mark.parametrize("blank", ["", "n/a"])
def test_a_reading_that_was_not_taken_far_down_is_skipped(tmp_path: Path, blank: str) -> None:
    cells = rows()
    cells[FAR][AMPLITUDE] = blank
    with warns(UserWarning):
        test = read(written(tmp_path / "a.csv", cells))
    np.testing.assert_array_equal(amplitudes(test), np.delete(EXPECTED, FAR))


@pytest.mark.parametrize(
    ("column", "cell"),
    [
        ("amplitude_um", "1202,25"),
        ("amplitude_um", "abc"),
        ("amplitude_um", "-5"),
        ("amplitude_um", "1e999"),
        ("frequency_rpm", ""),
        ("force_N", "2,500"),
        ("direction", "u"),
        ("plane", ""),
        ("valve", "1;2"),
    ],
)
def test_what_is_wrong_far_down_is_refused_with_its_line(tmp_path: Path, column: str, cell: str) -> None:
    cells = rows()
    cells[FAR][HEADER.index(column)] = cell
    if column == "force_N":
        for row in cells:
            row[HEADER.index(column)] = cell if row is cells[FAR] else "2500"
    path = written(tmp_path / "a.csv", cells, ";")
    with refuses(ValueError):
        read(path)


def test_memory_of_a_table_is_that_of_its_numbers(tmp_path: Path) -> None:
    """Cells as text took 1500 bytes a row; what is read takes up to 150, its making as much again, a block 2 MB."""
    path = written(tmp_path / "a.csv", rows(12_000))
    read(written(tmp_path / "small.csv", rows(10)))  # imports take their memory once
    tracemalloc.start()
    try:
        test = rf.read(path, difference=False)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert (peak - 2e6) / len(test) < 300


def of_two_planes(cells: list[list[str]]) -> list[list[str]]:
    """The same numbers at lines that all four probes read, in eight runs; the rotor is anisotropic."""
    places = [(plane, axis) for plane in ("disk", "journal") for axis in "xy"]
    return [
        [f"{row * 8 // len(cells)}", "3000", f"{300 + row // 4}", places[row * 8 // len(cells) // 2 % 4][0], "2.5", "0",
         *places[row % 4], cell[AMPLITUDE], "-90" if row % 2 == 0 else "-180", "12"]
        for row, cell in enumerate(cells)
    ]  # fmt: skip


@pytest.mark.filterwarnings("ignore::rotorfit.lab.data.findings.DataWarning")
def test_memory_of_a_check_is_some_hundred_bytes_a_reading(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Lines of a test take 60 bytes a reading, its orbits 90, the windows of a sweep up to 200, and the check makes one
    more array at a time. In all 472 with NumPy 2.4; others may take a tenth more. Filters that were tried at every
    reading took 1500."""
    monkeypatch.setattr("rotorfit.identify.diagnosis.orbits._ENOUGH_READINGS", 500)
    test = read(written(tmp_path / "a.csv", of_two_planes(rows(24_000))))
    rf.check(test.select(np.arange(2400)))
    tracemalloc.start()
    try:
        rf.check(test)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak / len(test) < 520
