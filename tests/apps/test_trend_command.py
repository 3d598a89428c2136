"""Trends by the command line: a table, a figure and words from files of one machine; refusals."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from sentences import hear
from trend_detection import history

import rotorfit as rf
from rotorfit.apps.cli.main import main
from rotorfit.apps.study_files.folder import CONTENTS


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    folder = tmp_path_factory.mktemp("starts")
    tests, _ = history(np.random.default_rng(3), loss=0.05)
    for i, test in enumerate(tests[15:35]):
        rf.write(test, folder / f"start-{i:02d}.csv")
    return [str(file) for file in sorted(folder.glob("*.csv"))]


def test_files_of_one_machine_become_a_table_a_figure_and_words(files, tmp_path, capsys) -> None:
    assert main(["trend", *files, "--out", str(tmp_path / "out")]) == 0
    out = capsys.readouterr().out
    assert "K alone" in out
    assert sorted(file.name for file in (tmp_path / "out").iterdir()) == [
        CONTENTS,
        "summary.txt",
        "trend.csv",
        "trend.png",
    ]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--speed-range", "1000"], "--speed-range 1000: give two numbers with a colon between"),
        (["--speed-range", "9000:9900"], "has no reading under a known weight at these speeds"),
    ],
)
def test_bad_words_are_one_sentence(files, words, said, capsys) -> None:
    assert main(["trend", *files, *words]) == 2
    assert said in capsys.readouterr().err


def test_a_test_that_is_not_synchronous_is_refused(tmp_path: Path, capsys) -> None:
    assert main(["trend", str(rf.datasets.path("rig_open.csv"))]) == 2
    hear(capsys.readouterr().err)
