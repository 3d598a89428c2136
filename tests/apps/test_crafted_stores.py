"""Stores that somebody made by hand: nothing is written outside of a folder, nothing that differs is overlooked."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import pytest
from stored import STUDY, days

import rotorfit as rf

Run = Callable[..., tuple[int, str, str]]


def change(path: Path, statement: str, *values: object) -> None:
    """Change a store as any program may."""
    with closing(sqlite3.connect(path)) as connection:
        connection.execute(statement, values)
        connection.commit()


@pytest.fixture
def store(tmp_path: Path) -> rf.Store:
    """A store of three tests with their fits."""
    made = rf.Store(tmp_path / "machine.db")
    made.add(days(tmp_path, 3), STUDY)
    return made


@pytest.mark.parametrize(
    "name",
    [
        "../victim/.bashrc", "victim/.bashrc", "/etc/cron.d/x", "..", ".", "", "fit.json", "x\0y", "../out", "link",
        ".rotorfit-result", "a\nb", "test1.nc", "posterior.nc/", 7, None, b"posterior.nc",
    ],
)  # fmt: skip
def test_a_file_that_no_fit_has_is_refused_and_nothing_is_written(
    name: object, store: rf.Store, run: Run, tmp_path: Path
) -> None:
    victim = tmp_path / "victim" / ".bashrc"
    victim.parent.mkdir()
    victim.write_text("alias ll=ls\n", encoding="utf-8")
    before = sorted(tmp_path.rglob("*"))
    if name is None:
        change(store.path, "INSERT INTO uncertainty VALUES (1, 'posterior.nc', ?)", "no bytes")
    else:
        change(store.path, "INSERT INTO uncertainty VALUES (1, ?, ?)", name, b"code of somebody else\n")
    code, out, err = run("store", "get", store.path, "1", "--out", tmp_path / "out")
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert err.startswith(f"rotorfit: fit 1 of {store.path}")
    code, out, _ = run("store", "check", store.path)
    assert (code, out.count("\n")) == (2, 1)
    assert victim.read_text(encoding="utf-8") == "alias ll=ls\n"
    assert sorted(tmp_path.rglob("*")) == before
