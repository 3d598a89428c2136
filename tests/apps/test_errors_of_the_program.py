"""An error of the program is never the user's: one of each kind of failure, in Python and on the command line."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from failing_lines import LINES, of_rotorfit
from sentences import refuses
from synthetic import MODELS, SPEEDS, TYPICAL, circular_test, covering_frequencies, known_of

import rotorfit as rf
from rotorfit.apps.cli.answer import ExitCode
from rotorfit.apps.cli.main import main
from rotorfit.base.faults import of_program
from rotorfit.lab.io.tables import tidy_csv


class Own(rf.models.OneMode):
    """A model of the user's own."""


class Failing(Own):
    """The same with an equation that fails."""

    def equation(self, p: Any, speed: Any, eccentricity: Any) -> Any:
        """Division by zero, as a user may write it."""
        return 1 / 0


@pytest.mark.parametrize("line", LINES.values(), ids=LINES)
def test_errors_of_the_program_have_a_traceback_and_an_exit_code(
    line: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(tidy_csv, "read_csv", of_rotorfit(line))
    assert main(["info", str(rf.datasets.path("rig_open.csv"))]) == ExitCode.ERROR_OF_THE_PROGRAM
    said = capsys.readouterr().err
    assert "Traceback" in said
    assert "in work" in said
    assert "please report it" in said.splitlines()[-1]


def test_what_we_refuse_is_no_error_of_the_program(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "rig.csv"
    path.write_text("run,speed_rpm\na,1000\n")
    with refuses(ValueError) as caught:
        rf.read(path)
    assert not of_program(caught.value)
    assert main(["info", str(path)]) == ExitCode.BAD_INPUT
    assert "Traceback" not in capsys.readouterr().err


def test_what_a_library_raises_over_a_file_is_told_of_the_file(tmp_path: Path) -> None:
    """HDF5 of one that is cut short."""
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["x"] = np.zeros(1000)
    whole = (tmp_path / "a.h5").read_bytes()
    (tmp_path / "a.h5").write_bytes(whole[: len(whole) // 2])
    with refuses(ValueError) as caught:
        rf.read_recording(tmp_path / "a.h5")
    assert not of_program(caught.value)


def test_an_equation_of_the_users_own_fails_by_its_own_words(tmp_path: Path) -> None:
    """Not as an error of ours, and not as damage of the file that it is read with."""
    plain = MODELS["one-mode"]()
    theta = plain.vector(TYPICAL["one-mode"])
    w = covering_frequencies(plain, theta, SPEEDS["one-mode"], 30)
    test = circular_test(plain, theta, speeds=SPEEDS["one-mode"], frequency=w, noise=0.01)
    known = known_of("one-mode", TYPICAL["one-mode"])
    with pytest.raises(ZeroDivisionError) as caught:
        rf.fit(Failing(), test, known=known)
    assert not of_program(caught.value)
    rf.fit(Own(), test, known=known).save(tmp_path / "fit.json")
    with pytest.raises(ZeroDivisionError):
        rf.load_fit(tmp_path / "fit.json", model=Failing())


@pytest.mark.parametrize(
    ("package", "file", "said"),
    [
        ("openpyxl", "a.xlsx", 'openpyxl: pip install "rotorfit[excel]"'),
        ("pyarrow", "a.parquet", "pyarrow; pip install 'rotorfit[parquet]'"),
        ("nptdms", "a.tdms", "npTDMS; pip install 'rotorfit[tdms]'"),
        ("pyuff", "a.uff", "pyuff"),
    ],
)
def test_a_package_that_is_missing_is_named(
    package: str, file: str, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    """With the extra that installs it; of one that is always needed, its name."""
    (tmp_path / file).write_bytes(b"PK\x03\x04")
    for name in [name for name in sys.modules if name.partition(".")[0] == package]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, package, None)
    assert main(["look" if file in ("a.parquet", "a.tdms") else "info", str(tmp_path / file)]) == ExitCode.BAD_INPUT
    last = capsys.readouterr().err.splitlines()[-1]
    assert said in last
    assert "damaged (" not in last
