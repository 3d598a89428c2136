"""Names that steer a terminal, begin a line or turn the writing: in a file they are shown as escapes."""

from __future__ import annotations

import tomllib
from pathlib import Path

import h5py
import numpy as np
import pytest
from hostile_names import HOSTILE, STEERS, named

import rotorfit as rf
from rotorfit.base.file_reading import shown, shown_lines
from rotorfit.lab.data.experiments import PerturbationTest
from rotorfit.lab.recordings.formats.files import open_raw
from rotorfit.lab.recordings.rig.template import template


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
