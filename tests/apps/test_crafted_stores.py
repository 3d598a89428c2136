"""Stores that somebody made by hand: nothing is written outside of a folder, nothing that differs is overlooked."""

from __future__ import annotations

import os
import shutil
import socket
import sqlite3
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import pytest
from hostile_names import STEERS
from stored import STUDY, day, days

import rotorfit as rf
from rotorfit.apps.store import adding, records
from rotorfit.apps.store.database import SEALED, put_seal

Run = Callable[..., tuple[int, str, str]]


def change(path: Path, statement: str, *values: object) -> None:
    """Change a store as any program may."""
    with closing(sqlite3.connect(path)) as connection:
        if values:
            connection.execute(statement, values)
        else:
            connection.executescript(statement)
        connection.commit()


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A store of three tests with their fits, and a fourth test."""
    folder = tmp_path_factory.mktemp("made")
    rf.Store(folder / "machine.db").add(days(folder, 4)[:3], STUDY)
    return folder


@pytest.fixture
def store(made: Path, tmp_path: Path) -> rf.Store:
    """A copy of it."""
    for file in made.iterdir():
        shutil.copy2(file, tmp_path)
    return rf.Store(tmp_path / "machine.db")


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
    assert (code, out.count("\n")) == (2, 2)  # the fit's checksum, and the file
    assert victim.read_text(encoding="utf-8") == "alias ll=ls\n"
    assert sorted(tmp_path.rglob("*")) == before


_MOVED = "UPDATE fits SET test = 1 WHERE number = 3"
CRAFTED = [
    ("UPDATE parameters SET stderr = stderr / 10 WHERE fit = 2", "fit 2: M, K0, D, lam, Mf, threshold_speed differ"),
    ("UPDATE parameters SET stderr = NULL WHERE fit = 2 AND name = 'lam'", "fit 2: lam differ"),
    (
        "UPDATE parameters SET systematic = 0 WHERE fit = 1 AND name = 'threshold_speed'",
        "fit 1: threshold_speed differ",
    ),
    ("UPDATE parameters SET value = value * 1.01 WHERE fit = 1 AND name = 'threshold_speed'", "threshold_speed differ"),
    ("UPDATE parameters SET value = value * 1.01 WHERE fit = 1 AND name = 'D'", "fit 1: D differ"),
    ("UPDATE parameters SET unit = 'N' WHERE fit = 1 AND name = 'D'", "fit 1: D differ"),
    ("DELETE FROM parameters WHERE fit = 3 AND name = 'lam'", "fit 3: lam differ"),
    ("UPDATE fits SET success = 0 WHERE number = 3", "fit 3: success differ"),
    ("UPDATE fits SET redchi = NULL WHERE number = 3", "fit 3: redchi differ"),
    ("UPDATE fits SET message = 'x' WHERE number = 3", "fit 3: message differ"),
    ("UPDATE fits SET result = NULL WHERE number = 3", "fit 3: success, D, K0, M, Mf, lam"),
    ("UPDATE fits SET result = (SELECT result FROM fits WHERE number = 1) WHERE number = 3", "fit 3: redchi"),
    ("UPDATE tests SET date = '2026-04-01' WHERE number = 2", "test 2: date are not"),
    ("UPDATE tests SET date = 'yesterday' WHERE number = 2", "test 2: the date 'yesterday' cannot be read"),
    ("UPDATE tests SET date = '0001-01-01T00:00+23:59' WHERE number = 2", "+23:59' cannot be read"),
    ("UPDATE tests SET machine = 'other', conditions = '{}' WHERE number = 2", "test 2: conditions are not"),
    ("UPDATE tests SET date_given = 0 WHERE number = 2", "test 2: date_given are not"),
    ("UPDATE tests SET readings = 7 WHERE number = 2", "test 2: readings are not"),
    (
        "UPDATE tests SET data = (SELECT data FROM tests WHERE number = 1) WHERE number = 3",
        "its readings are not those",
    ),
    ("INSERT INTO alarms VALUES (40, 'lam')", "alarms: one was told of fit 40"),
    ("UPDATE settings SET text = replace(text, '8000', '9000')", "settings: "),
    ("UPDATE sources SET test = 99 WHERE number = 2", "sources: record 2 is of none of the tests"),
    ("UPDATE fits SET settings = 'x' WHERE number = 2", "fits: record 2 is of none of the settings"),
    (
        f"UPDATE fits SET test = 9 WHERE number = 1; {_MOVED}; UPDATE fits SET test = 3 WHERE test = 9",
        "fit 1: it is of",
    ),
    ("UPDATE tests SET superseded = 1 WHERE number = 3", "test 3: it counts no longer"),
    ("UPDATE tests SET superseded = 2 WHERE number = 2", "test 2: it counts no longer"),
    ("UPDATE tests SET batch = 0 WHERE number = 3", "not in the order of their arrival"),
    ("DELETE FROM sources WHERE test = 2", "nothing says where test 2 came from"),
]
"""What somebody changes who seals the records again, and a part of what the check says."""
SILENT = [
    "UPDATE tests SET machine = 'other' WHERE number = 2",
    'UPDATE tests SET findings = \'[[["error", "x", "x", "x"]]]\' WHERE number = 2',
    'UPDATE fits SET findings = \'{"errors": ["x"], "warnings": []}\' WHERE number = 2',
    "UPDATE fits SET version = '9' WHERE number = 2",
    "UPDATE fits SET results = '0' WHERE number = 2",
    "UPDATE sources SET stamp = '[]' WHERE number = 2",
    "UPDATE sources SET test = NULL, refusal = 'x' WHERE number = 2",
    "UPDATE tests SET seal = '' WHERE number = 1",
]
"""Damage that only the checksums show."""


@pytest.mark.parametrize(("statement", "said"), [*CRAFTED, *((one, "is not as it was written") for one in SILENT)])
def test_what_differs_is_found_and_no_command_fails_over_it(
    statement: str, said: str, store: rf.Store, run: Run, tmp_path: Path
) -> None:
    change(store.path, statement)
    if (statement, said) in CRAFTED:
        with closing(sqlite3.connect(store.path)) as connection:
            connection.row_factory = sqlite3.Row
            for table in SEALED:
                for (number,) in connection.execute(f"SELECT number FROM {table}").fetchall():
                    put_seal(connection, table, number)
            connection.commit()
    found = store.problems()
    assert any(said in one for one in found), found
    commands = [
        "list",
        "trend",
        "check",
        f"get 3 --out {tmp_path / 'out'}",
        f"get 2 --out {tmp_path / 'out'}",
        f"add {tmp_path / 'day1.csv'}",
    ]
    commands += [f"add {tmp_path / 'day3.csv'} --machine m"]
    for words in commands:
        action, *more = words.split()
        code, _, err = run("store", action, store.path, *more)
        assert code in (0, 1, 2)
        assert all(line.startswith("rotorfit: ") for line in err.splitlines()), err


_ON = "WITH RECURSIVE c(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM c) SELECT"
RUNS = [
    f"ALTER TABLE tests RENAME TO kept; CREATE VIEW tests AS {_ON} * FROM kept, c",
    f"CREATE TRIGGER x AFTER INSERT ON claims BEGIN INSERT INTO alarms SELECT x, 'x' FROM ({_ON} x FROM c); END",
    "CREATE TRIGGER x AFTER INSERT ON sources BEGIN DELETE FROM fits; END",
    "DROP TABLE pieces; CREATE VIRTUAL TABLE pieces USING fts5(key, data)",
    "ALTER TABLE tests ADD COLUMN x AS (hex(zeroblob(400000000)))",
]
"""What SQLite would run as a store is read or written: without end, with great memory, or against what is kept."""


@pytest.mark.parametrize("script", RUNS)
def test_a_store_that_runs_what_somebody_wrote_is_refused(
    script: str, store: rf.Store, run: Run, tmp_path: Path
) -> None:
    for statement in script.split("; ") if "BEGIN" not in script else [script]:
        change(store.path, statement)
    for words in (
        ("list",),
        ("check",),
        ("trend",),
        ("add", tmp_path / "day3.csv"),
        ("get", 1, "--out", tmp_path / "x"),
    ):
        code, out, err = run("store", words[0], store.path, *map(str, words[1:]))
        assert (code, out, err.count("\n")) == (2, "", 1)
        assert "which rotorfit did not make" in err


def test_names_in_a_store_stay_on_their_lines(store: rf.Store, run: Run) -> None:
    """As those in files do, which are escaped where they are read."""
    for table, column in (("tests", "machine"), ("fits", "message"), ("parameters", "name"), ("sources", "path")):
        change(store.path, f"UPDATE {table} SET {column} = {column} || ?", "\x1b[31m\nrotorfit: all is well\u202e")
    change(store.path, 'CREATE TABLE "\x1b\nrotorfit: all" (x REFERENCES tests (number))')
    change(store.path, 'INSERT INTO "\x1b\nrotorfit: all" VALUES (77)')
    for action in ("list", "trend", "check"):
        _, out, err = run("store", action, store.path)
        assert not STEERS.search(out + err)


def test_junk_of_gigabytes_is_not_read_to_its_end(store: rf.Store, tmp_path: Path) -> None:
    """Neither where it is new, nor where it has taken the place of a test."""
    begin = time.process_time()
    for name in ("junk.csv", "day0.csv"):
        (tmp_path / name).write_bytes(b"")
        os.truncate(tmp_path / name, 64 << 30)
        [added] = store.add([tmp_path / name], STUDY)
        assert "is not text: it has zero bytes" in added.refusal
    assert time.process_time() - begin < 10  # the checksum of these bytes takes minutes


def test_a_record_of_files_that_is_none_supersedes_nothing(store: rf.Store, tmp_path: Path) -> None:
    for number, text in enumerate(("7", "[]", '[[[1, "x", null]]]', '[[["day0.csv", 1e400, "x"]]]', "["), start=1):
        change(store.path, "UPDATE sources SET files = ?", text)
        rf.write(day(10 + number), tmp_path / "day0.csv")
        [added] = store.add([tmp_path / "day0.csv"])
        assert added.new_test, added.refusal
    assert [test.superseded for test in store.tests] == [None] * 8


@pytest.mark.parametrize("number", [str(2**63 - 1), "'x'", "1e300"])
def test_numbers_that_leave_no_room_end_in_a_sentence(number: str, store: rf.Store, run: Run, tmp_path: Path) -> None:
    change(store.path, f"UPDATE tests SET batch = {number} WHERE number = 3")
    code, _, err = run("store", "add", store.path, tmp_path / "day3.csv")
    assert (code, err.count("\n")) == (2, 1)
    assert "machine.db" in err


@pytest.mark.parametrize("linked", [True, False])
def test_a_page_that_is_somebody_elses_stays(linked: bool, store: rf.Store, run: Run, tmp_path: Path) -> None:
    """A watch writes one beside its store."""
    page, other = tmp_path / "stores" / "machine.html", tmp_path / "victim.html"
    page.parent.mkdir()
    shutil.move(store.path, page.with_suffix(".db"))
    other.write_text("my own page", encoding="utf-8")
    page.symlink_to(other) if linked else shutil.copy(other, page)
    (tmp_path / "study.toml").write_text('model = "one-mode"\n', encoding="utf-8")
    words = ("--study", tmp_path / "study.toml", "--store", page.with_suffix(".db"), "--once", "--settle", "0")
    code, _, err = run("watch", tmp_path, *words)
    assert (code, err.count("\n")) == (2, 1)
    assert {page.read_text(encoding="utf-8"), other.read_text(encoding="utf-8")} == {"my own page"}


def test_a_source_of_a_test_that_is_gone_is_added_again(store: rf.Store, tmp_path: Path) -> None:
    change(store.path, "UPDATE sources SET test = 99 WHERE number = 2")
    [added] = store.add([tmp_path / "day1.csv"], STUDY)
    assert (added.test, added.new_test, added.fit, added.new_fit) == (2, False, 2, False)


def test_fits_of_earlier_numbers_are_marked_and_made_anew_when_asked(
    store: rf.Store, run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for module in (adding, records):
        monkeypatch.setattr(module, "RESULTS", "of another day")
    assert [fit.outdated for fit in store.fits] == [True] * 3
    assert store.problems() == ()
    assert "(of an earlier rotorfit)" in run("store", "list", store.path)[1]
    assert "3 fits are of an earlier rotorfit" in run("store", "trend", store.path, "--follow", "lam")[2]
    (tmp_path / "inbox").mkdir()
    (tmp_path / "study.toml").write_text('model = "one-mode"\nknown = {Ds = 8.0, K = 8000.0}\n', encoding="utf-8")
    words = ["watch", tmp_path / "inbox", "--study", tmp_path / "study.toml", "--store", store.path, "--once"]
    assert "3 fits are of an earlier rotorfit" in run(*words, "--settle", "0")[2]
    assert "fitted by an earlier rotorfit" in store.path.with_suffix(".html").read_text(encoding="utf-8")
    assert not store.add([tmp_path / "day0.csv"], STUDY)[0].new_fit
    assert store.refit(STUDY) == 3
    assert [(fit.test, fit.outdated) for fit in store.fits] == [(1, False), (2, False), (3, False)]
    assert store.refit(STUDY) == 0
    assert store.problems() == ()


# ---- claims -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("owner", "until"),
    [("otherhost 12 34", 3e6), ("otherhost 12 34", -1.0), ("none", 30.0), ("x y z", 30.0), (f"h {10**30} 1", 30.0),
     (7, 30.0), (b"\xff", 30.0), ("otherhost 12 34", None)],
)  # fmt: skip
def test_a_claim_that_is_none_stops_nobody(owner: object, until: float | None, store: rf.Store, tmp_path: Path) -> None:
    """Of a clock that is ahead by a month, run out, or nothing that this program writes."""
    when = "soon" if until is None else time.time() + until
    change(store.path, "REPLACE INTO claims VALUES ('tests', ?, ?)", owner, when)
    begin = time.monotonic()
    store.add([tmp_path / "day0.csv"])
    assert time.monotonic() - begin < 5


def test_who_holds_a_claim_is_said(store: rf.Store, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """After 5 s; and a lease that is not renewed runs out."""
    own = f"{socket.gethostname()} {os.getpid()} 1"
    change(store.path, "REPLACE INTO claims VALUES ('tests', ?, ?)", own, time.time() + 7)
    begin = time.monotonic()
    store.add([tmp_path / "day0.csv"])
    assert 6 < time.monotonic() - begin < 12
    [said] = [record.getMessage() for record in caplog.records]
    assert (
        said
        == f"rotorfit: {store.path}: waiting for process {os.getpid()} on {socket.gethostname()}, which is at the tests"
    )


def test_a_store_that_is_deleted_under_an_open_one_is_a_sentence(store: rf.Store, tmp_path: Path) -> None:
    store.path.unlink()
    for work in (lambda: store.tests, lambda: store.add([tmp_path / "day0.csv"], STUDY), store.problems, store.trend):
        with pytest.raises(FileNotFoundError, match=r"machine.db is not there any more"):
            work()
    assert not store.path.exists()
