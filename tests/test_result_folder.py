"""A folder for results holds one whole result, and no command writes over what it has read."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest

import rotorfit as rf
from rotorfit.cli.main import main
from rotorfit.estimators.atomic_file import protected_inputs, whole_file
from rotorfit.studies.folder import CONTENTS, complete_folder


def fill(out: Path, **files: str) -> None:
    with complete_folder(out) as folder:
        for name, text in files.items():
            (folder / name).write_text(text, encoding="utf-8")


def held(folder: Path) -> dict[str, str]:
    return {file.name: file.read_text() for file in folder.iterdir() if file.name != CONTENTS}


def test_a_result_replaces_the_one_before_as_a_whole(tmp_path: Path) -> None:
    out = tmp_path / "results"
    fill(out, fit="1", bootstrap="1")
    (out / "notes").write_text("mine")
    fill(out, fit="2")
    assert held(out) == {"fit": "2", "notes": "mine"}
    assert held(tmp_path / "results.previous") == {"fit": "1", "bootstrap": "1"}
    fill(out, fit="3")
    assert held(out) == {"fit": "3", "notes": "mine"}
    assert held(tmp_path / "results.previous") == {"fit": "2"}
    assert sorted(path.name for path in tmp_path.iterdir()) == ["results", "results.previous"]


@pytest.mark.parametrize("failing", range(2))
def test_a_rename_that_fails_leaves_the_result_that_was_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, failing: int
) -> None:
    out = tmp_path / "results"
    fill(out, fit="1", table="1")
    calls = []
    rename = os.rename

    def unreliable(source: Path, target: Path) -> None:
        calls.append(source)
        if len(calls) == failing + 1:
            raise OSError(5, "input/output error")
        rename(source, target)

    monkeypatch.setattr(os, "rename", unreliable)
    with pytest.raises(OSError, match="input/output"):
        fill(out, fit="2", table="2")
    monkeypatch.undo()
    assert held(out) == {"fit": "1", "table": "1"}
    assert [path.name for path in tmp_path.iterdir()] == ["results"]


def test_files_that_are_no_result_are_not_replaced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "fit").write_text("mine")
    with pytest.raises(FileExistsError, match="no result of rotorfit"):
        fill(tmp_path, fit="1")
    assert held(tmp_path) == {"fit": "mine"}
    out = tmp_path / "results"
    fill(out, fit="1")
    (tmp_path / "results.previous").mkdir()
    (tmp_path / "results.previous" / "mine").write_text("mine")
    with pytest.raises(FileExistsError, match="holds something else"):
        fill(out, fit="2")
    shutil.rmtree(tmp_path / "results.previous")
    monkeypatch.chdir(out)
    with pytest.raises(FileExistsError, match="in use"):
        fill(out, fit="2")


def test_a_file_that_is_replaced_keeps_its_mode_and_the_links_to_it(tmp_path: Path) -> None:
    file, link = tmp_path / "private", tmp_path / "link"
    file.write_text("1")
    file.chmod(0o600)
    link.symlink_to(file)
    with whole_file(link) as draft:
        draft.write_text("2")
    assert link.is_symlink()
    assert (file.read_text(), file.stat().st_mode & 0o777) == ("2", 0o600)


@pytest.mark.parametrize("through", ["name", "symlink", "hard link"])
def test_no_output_replaces_an_input(tmp_path: Path, through: str) -> None:
    source, out = tmp_path / "in.csv", tmp_path / "out.csv"
    shutil.copyfile(rf.datasets.path("rig_open.csv"), source)
    before = source.read_bytes()
    if through == "symlink":
        out.symlink_to(source)
    elif through == "hard link":
        out.hardlink_to(source)
    else:
        out = source
    assert main(["join", str(source), "--out", str(out)]) == 2
    assert source.read_bytes() == before
    with protected_inputs([source]), pytest.raises(FileExistsError, match="one of the files read"):
        rf.write(rf.read(rf.datasets.path("rig_open.csv")), out)


def test_commands_refuse_to_write_over_what_they_read(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    volts = tmp_path / "volts.h5"
    shutil.copyfile(rf.datasets.path("volts_journal-fwd.h5"), volts)
    responses = tmp_path / "responses.csv"
    shutil.copyfile(rf.datasets.path("rig_open.csv"), responses)
    before = volts.read_bytes(), responses.read_bytes()
    fit = ["fit", str(responses), "--model", "whirl-whip", "--known", "K3=6000", "--no-figures", "--out", str(tmp_path)]
    for command in (["vectors", str(volts), "--out", str(tmp_path / "volts.mat")], fit):
        if command[0] == "vectors":
            (tmp_path / "volts.mat").symlink_to(volts)
        assert main(command) == 2
        assert "one of the files read" in capsys.readouterr().err
        assert (volts.read_bytes(), responses.read_bytes()) == before
    assert sorted(path.name for path in tmp_path.iterdir()) == ["responses.csv", "volts.h5", "volts.mat"]
