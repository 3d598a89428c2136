"""``--where`` on every command that reads tests or recordings."""

from __future__ import annotations

import re
import shutil
from html import unescape
from pathlib import Path

import pytest
from shaken_stator import SETUP, shaken

import rotorfit as rf
from rotorfit.apps.cli.main import main
from rotorfit.apps.study_files.data_files import RecordingFiles
from rotorfit.apps.study_files.study_file import read_study

HZ = "frequency_hz=80:120"


def span(path: Path) -> tuple[float, float]:
    """Lowest and highest frequency of a test, Hz."""
    hz = rf.read(path).to_dataframe()["frequency_rpm"].abs() / 60
    return hz.min(), hz.max()


@pytest.fixture(scope="module")
def reduced(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with recordings, their vectors, and those between two frequencies."""
    folder = tmp_path_factory.mktemp("reduced")
    (folder / "rig.toml").write_text(SETUP)
    paths = [str(path) for path in shaken(folder, rpm=3000.0, band_hz=(40.0, 200.0), duration=4.0)]
    for name, more in (("kept.csv", ["--where", HZ]), ("full.csv", [])):
        words = ["vectors", *paths, "--setup", str(folder / "rig.toml"), "--out", str(folder / name), "--quiet"]
        assert main([*words, *more]) == 0
    return folder


@pytest.mark.parametrize(
    ("command", "more"),
    [("info", []), ("join", ["--out", "some.csv"]), ("fit", ["--model", "anisotropic", "--planes", "stator"])],
)
def test_vectors_are_chosen(
    tmp_path: Path,
    reduced: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    command: str,
    more: list[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    for file in reduced.iterdir():
        shutil.copy2(file, tmp_path)
    volts = ["wet-3000-shaken-x.h5", "wet-3000-shaken-y.h5", "--setup", "rig.toml"]
    low, high = span(Path("kept.csv"))
    assert 80 <= low < high <= 120
    capsys.readouterr()
    said = []
    for files in (["full.csv", "--where", HZ], ["kept.csv"]):
        assert main([command, *files, *more]) == 0
        said.append(re.sub(r"\b(full|kept)\b", "", capsys.readouterr().out))
    assert said[0] == said[1]
    if command != "join":
        assert main([command, *volts, "--where", HZ, *more]) == 0
        assert " readings in 2 runs" in capsys.readouterr().out
    if command == "fit":
        words = ["fit", "full.csv", "--where", HZ, *more, "--out", "chosen", "--no-figures"]
        assert main(words) == 0
        report = unescape(Path("chosen/report.html").read_text(encoding="utf-8"))
        assert f"rotorfit {' '.join(words)}" in report
        assert "rf.read('full.csv', where={'frequency_hz': (80.0, 120.0)})" in report


def test_a_study_chooses_of_recordings(tmp_path: Path) -> None:
    (tmp_path / "study.toml").write_text(
        'model = "anisotropic"\nfiles = [{recordings = ["a.h5"], where = {frequency_hz = {from = 80, to = 120}}}]\n'
    )
    (files,) = read_study(tmp_path / "study.toml").files
    assert isinstance(files, RecordingFiles)
    assert files.where == {"frequency_hz": (80.0, 120.0)}
