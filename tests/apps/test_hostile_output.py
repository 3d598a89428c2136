"""Names that steer a terminal, begin a line or turn the writing: no output of a command holds them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from hostile_names import HOSTILE, STEERS, named

import rotorfit as rf
from rotorfit.base.file_reading import shown

Run = Callable[..., tuple[int, str, str]]


def test_nothing_that_is_written_steers(run: Run, tmp_path: Path) -> None:
    name = "".join(HOSTILE)
    rf.write(named(name), tmp_path / "a.nc")
    given = ("--model", "whirl-whip", "--planes", f"disk,{shown(name)}", "--known", "K3=6000", "--bootstrap", "5")
    code, out, err = run("fit", tmp_path / "a.nc", *given, "--out", tmp_path / "fit")
    assert (code, err) == (0, "")
    written = [path.read_text(encoding="utf-8") for path in tmp_path.glob("fit/*") if path.suffix != ".png"]
    assert len(written) > 5
    assert not any(map(STEERS.search, (out, *written)))


@pytest.mark.parametrize("name", HOSTILE)
@pytest.mark.parametrize("command", ["info", "look", "template", "run", "judge", "plan", "store list"])
def test_files_with_such_names_are_refused_in_a_sentence(run: Run, tmp_path: Path, name: str, command: str) -> None:
    for suffix in (".csv", ".h5"):
        path = tmp_path / f"{name}{suffix}"
        path.write_bytes(rf.datasets.path("rig_lumped.csv").read_bytes())
        code, out, err = run(*command.split(), path)
        assert (code, out, err.count("\n")) == (2, "", 1)
        assert err.startswith("rotorfit: ")
        assert not STEERS.search(err)
