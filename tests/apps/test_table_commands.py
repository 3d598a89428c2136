"""Files of tests given to the command line: what it says of them once, refuses and exits with."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable
from pathlib import Path

import pytest
from analyser_files import W, analyser, shaker_test, written
from sentences import refuses

import rotorfit as rf
from rotorfit.apps.cli import main as cli


def test_the_command_line_warns_once_and_in_a_sentence(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    axial = [analyser(W + k + 0j, 3, axis) for k, axis in enumerate((1, 2, 1, 2, 1))]
    path = written(tmp_path / "t.uff", [*shaker_test(), *axial])
    with warnings.catch_warnings():
        warnings.simplefilter("default")
        assert cli.main(["info", str(path)]) == 0
    told = capsys.readouterr().err.strip().splitlines()
    assert len(told) == 1
    assert told[0].startswith("rotorfit: t.uff: left out, not lateral")
    assert told[0].endswith("and 2 more")


def test_names_that_are_no_text_are_refused(tmp_path: Path) -> None:
    """They would end in figures and stores, which take none."""
    path = Path(os.fsdecode(os.fsencode(tmp_path) + b"/a\xff.csv"))
    path.write_bytes(rf.datasets.path("field_balance.csv").read_bytes())
    with refuses(ValueError):
        rf.read(path)
    [added] = rf.Store(tmp_path / "machine.db").add([path])
    assert "must be text" in added.refusal


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no pipes with names")
@pytest.mark.parametrize(
    ("command", "suffix"),
    [
        *[("info", suffix) for suffix in (".csv", ".xlsx", ".nc", ".mat", ".uff")],
        *[("look", suffix) for suffix in (".h5", ".tdms", ".wav", ".npz", ".parquet")],
        ("run", ".toml"),
        ("plan", ".toml"),
        ("judge", ".json"),
    ],
)
def test_pipes_devices_and_folders_are_no_files(
    run: Callable[..., tuple[int, str, str]], tmp_path: Path, command: str, suffix: str
) -> None:
    """A pipe was waited for without end, and a device that has no end was read until the memory was full."""
    pipe, device, folder = (tmp_path / f"{name}{suffix}" for name in ("pipe", "device", "folder"))
    os.mkfifo(pipe)
    device.symlink_to("/dev/zero")
    folder.mkdir()
    for path, words in ((pipe, "a pipe or a device"), (device, "a pipe or a device"), (folder, "Is a directory")):
        code, _, said = run(command, path)
        assert (code, said.count("\n")) == (2, 1)
        assert path.name in said
        assert words in said


def test_a_folder_is_called_a_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["info", str(tmp_path)]) == 2
    assert f"{tmp_path} is a folder; name a file in it" in capsys.readouterr().err
    assert cli.main(["info", "."]) == 2
    assert capsys.readouterr().err.startswith("rotorfit: . is a folder")
