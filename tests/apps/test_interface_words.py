"""Small words of the interface: each was wrong once."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from sentences import refuses

import rotorfit as rf
from rotorfit.apps.cli import main as cli

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


def test_a_folder_is_called_a_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["info", str(tmp_path)]) == 2
    assert f"{tmp_path} is a folder; name a file in it" in capsys.readouterr().err
    assert cli.main(["info", "."]) == 2
    assert capsys.readouterr().err.startswith("rotorfit: . is a folder")


def test_one_reading_is_one_reading(tmp_path: Path) -> None:
    test = read(tmp_path, HEAD.format(force="force_N"))
    assert "1 reading in 1 run" in repr(test)


def test_an_attribute_keeps_its_last_digit() -> None:
    from dataclasses import replace

    from rotorfit.studies.campaigns.runs import conditions

    test = rf.datasets.rig_open()
    told = replace(test, attributes={"oil_C": np.full(len(test), 16.49)})
    assert conditions(told)["oil_C"] == 16.49


def test_a_pure_number_at_its_bound_has_no_unit() -> None:
    test = rf.datasets.rig_open()
    fit = rf.fit(rf.models.WhirlWhip(), test, known={"K3": 6000.0}, bounds={"lam": (0.2, 0.4)}, max_iterations=30)
    assert any(w.endswith("lam rests on its bound at 0.4") for w in fit.warnings)
