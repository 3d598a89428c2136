"""Names that steer a terminal, begin a line or turn the writing: in a file they are shown as escapes."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

import rotorfit as rf
from rotorfit.base.file_reading import shown, shown_lines
from rotorfit.lab.data.experiments import PerturbationTest
from rotorfit.lab.recordings.formats.files import open_raw
from rotorfit.lab.recordings.rig.template import template

HOSTILE = ("\x1b[31mred", "all\rwell", "a\nrotorfit: all is well", "gnp\u202e", "\x9b2J\u2028\t\x07")
STEERS = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u2028-\u202e\u2066-\u2069]|^rotorfit: all", re.MULTILINE)

Run = Callable[..., tuple[int, str, str]]


def named(name: str) -> PerturbationTest:
    """The bundled rig with its journal, one of its runs and an attribute called otherwise."""
    rig = rf.datasets.rig_lumped()
    rig = rig.select(np.arange(len(rig)) % 40 < 4)  # one frequency in ten

    def called(column: np.ndarray, old: str) -> np.ndarray:
        return np.array([name if word == old else word for word in column.tolist()])

    return replace(
        rig,
        run=called(rig.run, rig.runs[0]),
        plane=called(rig.plane, "journal"),
        force_plane=called(rig.force_plane, "journal"),
        attributes={f"oil {name}": np.array([name] * len(rig))},
    )


def write_table(test: PerturbationTest, path: Path) -> None:
    """Write a table as other programs do, with every cell in quotation marks."""
    frame = rf.to_dataframe(test)
    rows = [frame.columns.tolist(), *frame.to_numpy().tolist()]
    path.write_text("\n".join(",".join(f'"{cell}"' for cell in row) for row in rows), encoding="utf-8", newline="")


@pytest.mark.parametrize("name", HOSTILE)
def test_names_in_files_are_shown_on_one_line(tmp_path: Path, name: str) -> None:
    for suffix, write in ((".csv", write_table), (".nc", rf.write), (".mat", rf.write)):
        path = tmp_path / f"a{suffix}"
        write(named(name), path)
        test = rf.read(path)
        assert isinstance(test, PerturbationTest)
        names = (*test.runs, *test.planes, *test.force_planes, *test.attributes)
        names += tuple(test.attribute(next(iter(test.attributes))).tolist())
        assert not any(STEERS.search(word) or "\n" in word or "\t" in word for word in names)
        assert shown(name.strip().replace("\r", "\n" if suffix == ".csv" else "\r")) in test.planes


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


def test_a_setup_made_of_a_recording_is_toml_whatever_its_channels_are_called(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        for name in ('disk "1"\\new_X', "disk\x1b[31m\n[force]_Y"):
            file[name] = np.zeros(100)
        file.attrs["sample_rate_hz"] = 3200.0
    text = template(tmp_path / "a.h5")
    channels = [probe["channel"] for probe in tomllib.loads(text)["probe"]]
    assert channels == list(open_raw(tmp_path / "a.h5").channels)
    assert not STEERS.search(text)


def test_halves_of_characters_can_be_written() -> None:
    assert shown("a\ud800b").encode() == b"a\\ud800b"
    assert shown_lines("a\tb\n\x1b\r") == "a\tb\n\\x1b\\r"
    assert shown("Wellenlager links, \u00f8 50 µm") == "Wellenlager links, \u00f8 50 µm"
