"""Names of columns and units as the file writes them: mega or milli, a column of another kind of test."""

from __future__ import annotations

from pathlib import Path

import pytest
from sentences import refuses

import rotorfit as rf

HEAD = "run,speed_rpm,frequency_rpm,force_plane,{force},force_phase_deg,plane,direction,amplitude_um,phase_deg"


ROW = "a,1000,300,journal,2,0,journal,x,1,0"


def read(folder: Path, head: str, row: str = ROW) -> object:
    (folder / "t.csv").write_text(f"{head}\n{row}\n", encoding="utf-8")
    return rf.read(folder / "t.csv")


@pytest.mark.parametrize(("force", "newtons"), [("force_MN", 2e6), ("force_mN", 2e-3), ("force_kN", 2e3)])
def test_a_csv_tells_mega_from_milli(tmp_path: Path, force: str, newtons: float) -> None:
    test = read(tmp_path, HEAD.format(force=force))
    assert isinstance(test, rf.PerturbationTest)
    assert abs(test.force[0]) == pytest.approx(newtons)


def test_a_csv_whose_case_leaves_it_open_is_refused(tmp_path: Path) -> None:
    with refuses(ValueError):
        read(tmp_path, HEAD.format(force="force_mn"))


def test_a_column_of_another_test_is_no_unknown_unit(tmp_path: Path) -> None:
    head, row = "speed_rpm,load_N,load_deg,x_um,y_um,force_N", "1000,1,0,1,1,5"
    with refuses(ValueError):
        read(tmp_path, head, row)


def test_one_reading_is_one_reading(tmp_path: Path) -> None:
    test = read(tmp_path, HEAD.format(force="force_N"))
    assert "1 reading in 1 run" in repr(test)


def test_missing_columns_name_the_way_to_say_them(tmp_path) -> None:
    path = tmp_path / "short.csv"
    path.write_text("frequency_rpm,force_N,amplitude,phase_deg\n1000,5,10,20\n1100,5,11,21\n")
    with pytest.raises(ValueError, match=r"missing columns: .*--column THEIRS=OURS"):
        rf.read(path)


@pytest.mark.parametrize(
    ("unit", "said"),
    [("furlong", "m, mm, um, nm, in, mil"), ("dyn", "m, mm, um, nm, in, mil"), ("db", "a level in dB")],
)
def test_an_unknown_unit_leads_to_those_of_the_quantity(tmp_path: Path, unit: str, said: str) -> None:
    """And to no other quantity, such as an angle that is spelled alike."""
    head = HEAD.format(force="force_N").replace("amplitude_um", f"amplitude_{unit}")
    with pytest.raises(ValueError, match=r"missing columns: amplitude_um") as refused:
        read(tmp_path, head)
    assert said in str(refused.value)
    assert "did you mean" not in str(refused.value)


@pytest.mark.parametrize(("column", "name"), [("averages", "averages"), ("probe_radius_mm", "probe_radius_m")])
def test_a_column_that_only_another_would_need_is_kept_as_an_attribute(tmp_path: Path, column: str, name: str) -> None:
    """Averages without a coherence, a radius without slopes: nothing that a file says is dropped without a word."""
    test = read(tmp_path, f"{HEAD.format(force='force_N')},{column}", f"{ROW},30")
    assert isinstance(test, rf.PerturbationTest)
    assert test.attributes[name][0] == pytest.approx(30 if column == "averages" else 0.03)
