"""Files name the version of the package and that of its numbers; what was kept under other numbers is known."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import h5py
import pytest
from seal_campaigns import KNOWN, seal_campaign
from stored import STUDY, day

import rotorfit as rf
from rotorfit.base.version import VERSIONS
from rotorfit.studies.campaigns import runs

Run = Callable[..., tuple[int, str, str]]


def test_every_file_that_is_written_names_both(tmp_path: Path, run: Run) -> None:
    fit = rf.fit(rf.models.OneMode(), day(0), known=STUDY["known"])
    fit.save(tmp_path / "fit.json")
    assert json.loads((tmp_path / "fit.json").read_text(encoding="utf-8"))["rotorfit"] == VERSIONS
    fit.sample(seed=1, walkers=16, max_steps=40).save(tmp_path / "posterior.nc")
    with h5py.File(tmp_path / "posterior.nc") as file:
        assert file["posterior"].attrs["created_by"] == f"rotorfit {VERSIONS}"
    page = rf.write_report(fit, tmp_path / "report.html", figure_format="none").read_text(encoding="utf-8")
    assert page.count(f"rotorfit {VERSIONS}") == 2  # in its head, and where it says how to make the numbers again
    assert run("--version")[:2] == (0, f"rotorfit {VERSIONS}\n")


def test_kept_runs_of_other_numbers_are_fitted_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    table, _ = seal_campaign(10)
    store = rf.Store(tmp_path / "runs.db")
    counts: list[int] = []

    def fitted() -> list[int]:
        counts.clear()
        rf.campaign(rf.models.OneMode(), table, known=KNOWN, store=store, progress=lambda done, _: counts.append(done))
        return counts[:]

    assert fitted() == [8, 10]
    assert fitted() == []
    monkeypatch.setattr(runs, "RESULTS", "0a1b2c3d")
    assert fitted() == [8, 10]
