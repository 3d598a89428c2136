"""Campaigns over parts by the command line: the numbers of whole tables, and what cannot be read in a sentence."""

from __future__ import annotations

from pathlib import Path

import pytest
from command_words import toml_file
from seal_campaigns import KNOWN, written_parts


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    return toml_file(tmp_path_factory.mktemp("study") / "study.toml", model="one-mode", known=KNOWN)


@pytest.fixture(scope="module")
def parts(tmp_path_factory):
    return written_parts(tmp_path_factory.mktemp("parts"))


def test_the_command_reads_parts(parts, study, tmp_path, run):
    for name, words in [("whole", []), ("lazy", ["--lazy"])]:
        code, _, stderr = run("campaign", study, *parts, "--quiet", "--out", tmp_path / name, *words)
        assert (code, stderr) == (0, "")
    assert (tmp_path / "whole" / "runs.csv").read_bytes() == (tmp_path / "lazy" / "runs.csv").read_bytes()
    assert (tmp_path / "whole" / "summary.txt").read_text() == (tmp_path / "lazy" / "summary.txt").read_text()


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("cut.nc", b"\x89HDF\r\n\x1a\n", "cut.nc"),
        ("empty.csv", b"", "empty.csv"),
        ("other.csv", b"speed_rpm,amplitude_um\n1000,1\n", "other.csv"),
        ("volts.h5", b"", "volts.h5 is a recording"),
        ("rest.txt", b"\xff\xfe\x00", "rest.txt"),
    ],
)
def test_a_part_that_cannot_be_read_is_one_sentence(name, text, said, parts, study, tmp_path, run):
    (tmp_path / name).write_bytes(text)
    code, _, stderr = run("campaign", study, parts[0], tmp_path / name, "--quiet", "--lazy")
    assert code == 2
    assert said in stderr
    assert len(stderr.strip().splitlines()) == 1


def test_a_copy_in_another_part_is_named(parts, study, tmp_path, run):
    (tmp_path / "again.nc").write_bytes(Path(parts[0]).read_bytes())
    said = [run("campaign", study, parts[0], tmp_path / "again.nc", *lazy)[1] for lazy in ([], ["--lazy"])]
    assert "Copies of runs, to the last digit: r00 repeats r00 of a.nc" in said[0]
    assert "Copies of runs, to the last digit: r00 repeats r00 of a.nc" in said[1]
