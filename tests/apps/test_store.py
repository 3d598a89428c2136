"""The store: every test once, every fit once, whoever writes and whatever is killed; damage is one sentence."""

from __future__ import annotations

import multiprocessing
import os
import random
import re
import shutil
import signal
import sqlite3
import time
import zlib
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sentences import hear, refuses, warns
from stored import STUDY, day, days
from unreliable import Unreliable

import rotorfit as rf
from rotorfit.apps.store.database import Database
from rotorfit.base.executors import process_pool

FORK = multiprocessing.get_context("fork")
"""Processes that need not import everything again."""
Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def store(tmp_path: Path) -> rf.Store:
    return rf.Store(tmp_path / "machine.db")


def test_a_test_is_the_same_whatever_file_holds_it(store: rf.Store, tmp_path: Path) -> None:
    """Another format, order of rows, name of the file: one test. One reading changed by 1e-6: another."""
    test = day(0)
    rf.write(test, tmp_path / "a.csv")
    rf.write(test, tmp_path / "b.nc")
    rf.write(test.select(np.random.default_rng(1).permutation(len(test))), tmp_path / "c.mat")
    rf.to_dataframe(test).iloc[:, ::-1].to_csv(tmp_path / "d.csv", index=False)
    added = store.add([tmp_path / name for name in ("a.csv", "b.nc", "c.mat", "d.csv")], STUDY)
    assert [one.test for one in added] == [1, 1, 1, 1]
    assert [one.new_fit for one in added] == [True, False, False, False]
    assert len(store.tests[0].sources) == 4
    response = test.response.copy()
    response[3] *= 1 + 1e-6
    rf.write(replace(test, response=response), tmp_path / "a.csv")
    assert store.add([tmp_path / "a.csv"])[0].test == 2


def test_the_fit_in_the_store_is_that_of_the_test(store: rf.Store, tmp_path: Path) -> None:
    [file] = days(tmp_path, 1)
    [added] = store.add([file], STUDY)
    own = rf.fit(rf.models.OneMode(), rf.read(file), known=STUDY["known"])
    fit = store.fits[0]
    assert {name: p.value for name, p in fit.params.items() if name != "threshold_speed"} == {
        name: p.value for name, p in own.params.items() if p.vary
    }
    assert fit.params["threshold_speed"].stderr == own.threshold_speed().stderr
    assert np.array_equal(store.result(added.fit or 0).covar, own.covar)
    assert store.tests[0].date == "2026-03-01"
    assert store.problems() == ()


def test_what_tests_of_a_machine_have_in_common_is_no_scatter(store: rf.Store, tmp_path: Path) -> None:
    """Gains on trust are the same in every test: trends and alarms weigh a value by the rest of its error."""
    [file] = days(tmp_path, 1)
    store.add([file], STUDY)
    [fit] = store.fits
    own = rf.fit(rf.models.OneMode(), rf.read(file), known=STUDY["known"])
    for name, p in own.params.items():
        if p.vary:
            assert fit.params[name].scatter == pytest.approx(np.hypot(p.noise, p.bounded), rel=1e-6), name
    onset = own.threshold_speed().error
    assert onset is not None
    assert fit.params["threshold_speed"].scatter == pytest.approx(np.hypot(onset.noise, onset.bounded), rel=1e-3)
    assert fit.params["D"].scatter < 0.5 * fit.params["D"].stderr


def test_settings_are_the_same_in_any_order(store: rf.Store, tmp_path: Path) -> None:
    [file] = days(tmp_path, 1)
    (tmp_path / "study.toml").write_text(
        'known = {K = 8000, Ds = 8}\nmodel = "one-mode"\nout = "x"\nmax_iterations = 200'
    )
    store.add([file], STUDY)
    assert not store.add([file], tmp_path / "study.toml")[0].new_fit
    assert store.add([file], {**STUDY, "known": {"Ds": 8.1, "K": 8000.0}})[0].new_fit
    with refuses(ValueError):
        store.trend()
    assert len(store.history(study=STUDY)) == 1


def test_a_file_that_is_completed_takes_the_place_of_its_part(store: rf.Store, tmp_path: Path) -> None:
    """A copy that was cut at a line's end reads well; the same name with other data is another test."""
    whole, file = tmp_path / "whole.csv", tmp_path / "latest.csv"
    rf.write(day(0), whole)
    text = whole.read_text().splitlines(keepends=True)
    for lines in (60, None):
        file.write_text("".join(text[:lines]))
        store.add([file], STUDY)
    assert [test.superseded for test in store.tests] == [2, None]
    rf.write(day(1), file)
    store.add([file], STUDY)
    assert [test.superseded for test in store.tests] == [2, None, None]
    assert [fit.test for _, fit in store.history()] == [2, 3]


def test_one_bad_file_does_not_keep_the_others_out(run: Run, tmp_path: Path) -> None:
    files = days(tmp_path, 2)
    files[0].write_text("run,speed_rpm\n1,")
    (tmp_path / "study.toml").write_text('model = "one-mode"\nknown = {Ds = 8.0, K = 8000.0}\n')
    code, out, err = run(
        "store", "add", tmp_path / "m.db", *files, tmp_path / "gone.csv", "--study", tmp_path / "study.toml"
    )
    assert code == 2
    assert "day1.csv: test 1; fit 1: " in out
    assert "day0.csv" in err
    assert "gone.csv" in err
    assert "Traceback" not in err
    assert run("store", "list", tmp_path / "m.db")[1].count("fit 1: ") == 1


def test_data_that_cannot_be_fitted_are_said_once(store: rf.Store, tmp_path: Path) -> None:
    [file] = days(tmp_path, 1)
    study = {"model": "overhung"}
    assert store.add([file], study)[0].new_fit
    assert not store.add([file], study)[0].new_fit
    hear(store.fits[0].message)
    assert not store.fits[0].good
    with refuses(ValueError):
        store.trend()


# ---- several processes, and kills ----------------------------------------------------------------------------------


def add_all(path: Path, files: list[Path]) -> None:
    rf.Store(path).add(files, STUDY)


def test_writers_side_by_side_fit_each_test_once(tmp_path: Path) -> None:
    files = days(tmp_path, 4)
    path = tmp_path / "machine.db"
    writers = [FORK.Process(target=add_all, args=(path, random.Random(i).sample(files, 4))) for i in range(4)]
    for writer in writers:
        writer.start()
    for writer in writers:
        writer.join()
    assert [writer.exitcode for writer in writers] == [0] * 4
    store = rf.Store(path)
    assert len(store.tests) == len(store.fits) == 4
    with sqlite3.connect(path) as connection:  # a fit that was made again would have taken another number
        assert dict(connection.execute("SELECT * FROM sqlite_sequence")) == {"tests": 4, "fits": 4}
        assert connection.execute("SELECT count(*) FROM claims").fetchone() == (0,)


def test_killed_at_any_instant_loses_nothing_and_leaves_nothing_half(tmp_path: Path) -> None:
    """Pairs of writers are killed at random moments again and again; what one has reported is there ever after."""
    files = days(tmp_path, 6)
    path, chance = tmp_path / "machine.db", random.Random(3)
    seen: set[str] = set()
    for _ in range(6):
        writers = [FORK.Process(target=add_all, args=(path, chance.sample(files, 6))) for _ in range(2)]
        for writer in writers:
            writer.start()
        time.sleep(chance.uniform(0.0, 0.25))
        for writer in writers:
            os.kill(writer.pid or 0, signal.SIGKILL)
            writer.join()
        store = rf.Store(path)
        assert store.problems() == ()
        now = {test.content for test in store.tests}
        assert seen <= now
        seen = now
    add_all(path, files)
    store = rf.Store(path)
    assert store.problems() == ()
    assert len(store.tests) == len(store.fits) == 6
    quiet = rf.Store(tmp_path / "quiet.db")
    quiet.add(files, STUDY)
    values = [{t.content: f.params["D"].value for t, f in one.history()} for one in (store, quiet)]
    assert values[0] == values[1]


# ---- files that are no store, or none that may be written -----------------------------------------------------------


def damaged(path: Path, files: list[Path]) -> None:
    rf.Store(path).add(files, STUDY)
    content = bytearray(path.read_bytes())
    for place in range(5000, len(content) - 200, 4096):
        content[place : place + 64] = bytes(64)
    path.write_bytes(content)


def test_fits_that_are_made_elsewhere_are_those_made_here(run: Run, tmp_path: Path) -> None:
    """Workers change no digit, a test that comes twice is fitted once, and what a lost worker had is fitted here."""
    files = days(tmp_path, 3)
    shutil.copy(files[0], tmp_path / "again.csv")
    here, there, lost = (rf.Store(tmp_path / f"{name}.db") for name in ("here", "there", "lost"))
    here.add([*files, tmp_path / "again.csv"], STUDY)
    with process_pool(1) as pool:
        added = there.add([*files, tmp_path / "again.csv"], STUDY, executor=pool)
    assert [one.test for one in added] == [1, 2, 3, 1]
    assert sum(one.new_fit for one in added) == 3
    with warns(UserWarning):
        lost.add(files, STUDY, executor=Unreliable(1000))
    expected = {fit.test: (fit.params, fit.errors, fit.warnings) for fit in here.fits}
    assert {fit.test: (fit.params, fit.errors, fit.warnings) for fit in there.fits} == expected
    assert {fit.test: (fit.params, fit.errors, fit.warnings) for fit in lost.fits} == expected
    assert not there.problems()
    code, _, stderr = run("store", "add", tmp_path / "m.db", *files, "--cluster", "host:8786")
    assert (code, "--cluster takes local:N" in stderr) == (2, True)


def test_what_a_study_asks_of_the_uncertainty_is_kept(run: Run, tmp_path: Path) -> None:
    """Posterior, profiles and simulated tests come from a worker into the store, and out of it as files."""
    [file] = days(tmp_path, 1)
    asked = {**STUDY, "sample": True, "ess": 40, "seed": 3, "profile": ["lam"], "bootstrap": 4}
    store = rf.Store(tmp_path / "machine.db")
    with ThreadPoolExecutor(1) as pool:
        store.add([file], asked, executor=pool)
    fit = rf.fit(rf.models.OneMode(), rf.read(file), known=STUDY["known"])
    np.testing.assert_array_equal(store.posterior(1).chain, fit.sample(seed=3, ess=40).chain)
    code, _, stderr = run("store", "get", store.path, "1", "--out", tmp_path / "out")
    assert (code, stderr) == (0, "")
    assert {"fit.json", "posterior.nc", "profiles.csv", "bootstrap.csv"} <= {
        p.name for p in (tmp_path / "out").iterdir()
    }
    assert rf.load_posterior(tmp_path / "out" / "posterior.nc", store.result(1)).names == fit.var_names
    store.add([file], STUDY)
    with refuses(KeyError):
        store.posterior(2)


def newer(path: Path, _: list[Path]) -> None:
    rf.Store(path)
    with sqlite3.connect(path) as connection:
        connection.execute("PRAGMA user_version = 99")


def foreign(path: Path, _: list[Path]) -> None:
    with sqlite3.connect(path) as connection:
        connection.execute("CREATE TABLE tests (number INTEGER)")


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda path, files: path.write_text("run,speed_rpm\n" * 100), "is not a store of tests, or is damaged"),
        (lambda path, files: path.mkdir(), "is a folder; a store is one file"),
        (newer, "written by a newer rotorfit"),
        (foreign, "database of another program"),
        (damaged, "damaged|malformed|not those that were added"),
    ],
    ids=["text", "folder", "newer", "foreign", "damaged"],
)
def test_what_is_no_store_is_one_sentence(make: Callable[..., Any], said: str, run: Run, tmp_path: Path) -> None:
    files = days(tmp_path, 1)
    make(tmp_path / "m.db", files)
    for words in (["add", tmp_path / "m.db", *files], ["list", tmp_path / "m.db"], ["check", tmp_path / "m.db"]):
        code, out, err = run("store", *words)
        if make is not damaged or words[0] == "check":
            assert code == 2
            assert re.search(said, out + err), out + err
        assert "Traceback" not in err


@pytest.mark.parametrize(
    ("field", "value", "words"),
    [
        ("tests.findings", "{}x", "list"),
        ("tests.findings", "[[1]]", "add {} {file} --study {study}"),
        ("tests.machine", b"\xff", "list"),
        ("sources.path", b"\xff", "list"),
        ("tests.conditions", "[1]", "trend"),
        ("tests.data", zlib.compress(b'[{"a": 1}]')[:-2], "check"),
        ("fits.findings", '{"errors": [1], "warnings": []}', "list"),
        ("fits.redchi", "x", "trend"),
        ("fits.result", zlib.compress(b'{"format": "rotorfit fit"}'), "get {} 1 --out {out}"),
        ("fits.result", zlib.compress(bytes(1 << 27)), "get {} 1 --out {out}"),
        ("parameters.value", "x", "list"),
    ],
)
def test_fields_of_another_kind_and_bombs_are_one_sentence(
    field: str, value: str | bytes, words: str, run: Run, tmp_path: Path
) -> None:
    """What SQLite takes in any column, and what is packed to a thousandth."""
    path, study, [file] = tmp_path / "m.db", tmp_path / "study.toml", days(tmp_path, 1)
    rf.Store(path).add([file], STUDY if "--study" not in words else None)
    study.write_text('model = "one-mode"\nknown = {Ds = 8.0, K = 8000.0}\n', encoding="utf-8")
    table, _, column = field.partition(".")
    with sqlite3.connect(path) as connection:
        connection.execute(f"UPDATE {table} SET {column} = ?", (value,))
    given = (words if "{}" in words else f"{words} {{}}").format(path, file=file, study=study, out=tmp_path / "out")
    code, out, err = run("store", *given.split())
    assert (code, path.name in out + err) == (2, True)
    assert err.count("\n") == (words != "check")
    assert not (tmp_path / "out").exists()


def test_an_output_that_is_an_input_is_refused(run: Run, tmp_path: Path) -> None:
    [file] = days(tmp_path, 1)
    before = file.read_bytes()
    assert run("store", "add", file, file)[0] == 2
    assert file.read_bytes() == before


@pytest.mark.skipif(os.name != "posix" or os.geteuid() == 0, reason="root may write everywhere")
def test_a_store_in_a_read_only_folder_is_read(run: Run, tmp_path: Path) -> None:
    files = days(tmp_path, 1)
    folder = tmp_path / "archive"
    folder.mkdir()
    rf.Store(folder / "m.db").add(files, STUDY)
    folder.chmod(0o555)
    try:
        assert run("store", "list", folder / "m.db")[0] == 0
        code, _, err = run("store", "add", folder / "m.db", *files)
        assert (code, "read-only" in err) == (2, True)
        code, _, err = run("store", "add", folder / "new.db", *files)
        assert (code, "read-only" in err) == (2, True)
    finally:
        folder.chmod(0o755)


def test_a_test_that_is_too_long_for_a_store_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """SQLite holds a billion bytes in one place; here it is made to hold ten thousand."""
    opened = Database._open

    def short(self: Database) -> sqlite3.Connection:
        connection = opened(self)
        connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, 10_000)
        return connection

    store = rf.Store(tmp_path / "a.db")
    monkeypatch.setattr(Database, "_open", short)
    [added] = store.add([rf.datasets.path("rig_lumped.csv")])
    assert "a.db: a test is too long for a store" in added.refusal
    assert not store.tests
