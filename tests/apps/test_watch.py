"""A folder watched: what arrives is fitted once when it stands still, and an alarm is told once."""

from __future__ import annotations

import json
import multiprocessing
import os
import shutil
import signal
import sqlite3
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from stored import STUDY, day, days

import rotorfit as rf
from rotorfit.apps.store import sources
from rotorfit.apps.store.store import study_for_store
from rotorfit.apps.store.watch import FolderWatch

FORK = multiprocessing.get_context("fork")
Run = Callable[..., tuple[int, str, str]]
SETTLE = 0.05


@pytest.fixture
def inbox(tmp_path: Path) -> Path:
    (tmp_path / "inbox").mkdir()
    (tmp_path / "study.toml").write_text('model = "one-mode"\nknown = {Ds = 8.0, K = 8000.0}\n')
    return tmp_path / "inbox"


def watch_of(inbox: Path, events: list[dict[str, Any]] | None = None, **options: Any) -> FolderWatch:
    study = study_for_store(STUDY)
    assert study is not None
    store = rf.Store(inbox.parent / "machine.db")
    tell = (lambda event: None) if events is None else events.append
    return FolderWatch(folder=inbox, store=store, study=study, settle=SETTLE, tell=tell, **options)


def looked(watch: FolderWatch) -> list[Any]:
    """Two rounds, between which files stand still."""
    added = watch.look()
    time.sleep(1.5 * SETTLE)
    return [*added, *watch.look()]


def changed_machine(inbox: Path, tests: int = 10) -> None:
    """D falls by a tenth after six tests."""
    for number in range(tests):
        rf.write(day(number, D=1.0 if number < 6 else 0.9), inbox / f"day{number:02d}.csv")


def test_an_alarm_is_an_exit_code_a_line_and_a_command_once(inbox: Path, run: Run) -> None:
    days(inbox, 6)
    words = ["watch", inbox, "--study", inbox.parent / "study.toml", "--store", inbox.parent / "machine.db", "--once"]
    words += ["--settle", "0", "--json", "--on-alarm", f"tee -a {inbox.parent / 'alarms.txt'}"]
    code, out, err = run(*words)
    assert (code, err) == (0, "")
    assert [json.loads(line)["event"] for line in out.splitlines()] == ["test"] * 6
    changed_machine(inbox)
    code, out, _ = run(*words)
    events = [json.loads(line) for line in out.splitlines()]
    assert code == 3
    assert [event["rule"] for event in events if event["event"] == "alarm"] == ["D"]
    assert events[-1]["date"] in ("2026-03-08", "2026-03-09")
    code, out, _ = run(*words)
    assert (code, out) == (3, "")  # it stands, and was told
    assert len((inbox.parent / "alarms.txt").read_text().splitlines()) == 1
    page = (inbox.parent / "machine.html").read_text()
    assert "ALARM" in page
    assert "<script" not in page
    code, out, _ = run(*words[:-2], "--since", "2026-03-07")  # the machine was overhauled
    assert code == 0


def test_a_margin_that_is_not_held_is_an_alarm(inbox: Path, run: Run) -> None:
    days(inbox, 2)
    words = ["watch", inbox, "--study", inbox.parent / "study.toml", "--store", inbox.parent / "machine.db", "--once"]
    words += ["--settle", "0", "--running-speed", "2100"]
    code, out, _ = run(*words)
    assert code == 0
    assert "threshold speed below 2100 rpm, held with probability 1" in out
    code, out, _ = run(*words, "--margin", "1.6")
    assert code == 3
    assert "ALARM, threshold speed below 3360 rpm" in out


def test_a_command_that_fails_is_run_again(inbox: Path) -> None:
    events: list[dict[str, Any]] = []
    changed_machine(inbox, 9)
    watch = watch_of(inbox, events, on_alarm="false")
    looked(watch)
    watch.states()
    watch.on_alarm = "true"
    watch.states()
    watch.states()
    assert [event["event"] for event in events if event["event"] != "test"] == ["alarm", "problem", "alarm"]


# ---- files as they come ---------------------------------------------------------------------------------------------


def test_a_watch_ends_when_nobody_reads_what_it_prints(inbox: Path, run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    """As in ``rotorfit watch ... | head``: it went on for ever."""

    def closed(*_: Any, **__: Any) -> None:
        raise BrokenPipeError

    monkeypatch.setattr("rotorfit.apps.cli.watch._tell", closed)
    monkeypatch.setattr("rotorfit.apps.cli.main._close_output", lambda: None)
    days(inbox, 1)
    words = ["watch", inbox, "--study", inbox.parent / "study.toml", "--store", inbox.parent / "machine.db"]
    for more in ([], ["--once"]):
        code, _, err = run(*words, "--settle", "0", "--every", "0.1", *more)
        assert (code, err) == (0, "")
        (inbox.parent / "machine.db").unlink()


def test_a_file_is_taken_when_it_stands_still(inbox: Path, tmp_path: Path) -> None:
    [file] = days(tmp_path, 1)
    text, target = file.read_bytes(), inbox / "slow.csv"
    watch = watch_of(inbox)
    watch.settle = 0.3
    target.write_bytes(text[:2000])
    begin = time.monotonic()
    for end in (4000, 6000):
        assert watch.look() == []
        time.sleep(0.2)
        target.write_bytes(text[:end])
    assert time.monotonic() - begin > 0.3
    assert watch.look() == []
    target.write_bytes(text)
    assert watch.look() == []
    time.sleep(0.35)
    [added] = watch.look()
    assert added.new_fit
    assert watch.look() == []
    assert len(watch.store.tests) == 1


def test_truncated_duplicate_foreign_and_late_files(inbox: Path, tmp_path: Path) -> None:
    events: list[dict[str, Any]] = []
    watch = watch_of(inbox, events)
    files = days(tmp_path, 4)
    shutil.copy(files[1], inbox / "day1.csv")
    shutil.copy(files[1], inbox / "copy of day1.csv")
    (inbox / "day2.csv").write_bytes(files[2].read_bytes()[:333])
    (inbox / "day3.nc").write_bytes(b"\x89HDF\r\n\x1a\n cut")
    (inbox / "notes.docx").write_bytes(b"PK")
    (inbox / "empty.csv").touch()
    (inbox / "~$day9.xlsx").write_bytes(b"lock")
    looked(watch)
    refused = [Path(event["source"]).name for event in events if event["event"] == "refused"]
    assert sorted(refused) == ["day2.csv", "day3.nc", "empty.csv"]
    looked(watch)
    assert len(events) == 3 + 2  # said once
    shutil.copy(files[2], inbox / "day2.csv")  # completed
    shutil.copy(files[0], inbox / "day0.csv")  # older than the others
    looked(watch)
    history = watch.store.history()
    assert [test.date for test, _ in history] == ["2026-03-02", "2026-03-01", "2026-03-03"]
    assert set(watch.store.refused) == {str(inbox / "day3.nc"), str(inbox / "empty.csv")}
    assert len(watch.store.fits) == 3
    assert watch.states()[0].machine == ""


def test_a_file_replaced_under_its_name_and_time_is_a_further_test(inbox: Path, tmp_path: Path) -> None:
    """By an instrument whose clock stands still; the files have one size, too."""
    watch = watch_of(inbox)
    texts = [file.read_bytes() for file in days(tmp_path, 2)]
    size = max(map(len, texts))
    for text in texts:
        (inbox / "latest.csv").write_bytes(text + b"\n" * (size - len(text)))
        os.utime(inbox / "latest.csv", (1e9, 1e9))
        looked(watch)
    assert [test.date for test, _ in watch.store.history()] == ["2026-03-01", "2026-03-02"]


def test_tests_stay_in_order_of_arrival_where_the_clock_is_set_back(
    inbox: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    watch = watch_of(inbox)
    for number, file in enumerate(days(tmp_path, 3)):
        monkeypatch.setattr(
            "rotorfit.apps.store.adding.time.time_ns", lambda hours=number: 10**18 - hours * 36 * 10**11
        )
        shutil.copy(file, inbox)
        looked(watch)
    assert [test.date for test, _ in watch.store.history()] == ["2026-03-01", "2026-03-02", "2026-03-03"]


def test_pipes_and_links_in_a_circle_are_no_data(inbox: Path) -> None:
    [file] = days(inbox, 1)
    os.mkfifo(inbox / "pipe.csv")
    (inbox / "circle.csv").symlink_to(inbox / "circle.csv")
    (inbox / "gone.csv").symlink_to(inbox / "nowhere.csv")
    watch = watch_of(inbox)
    assert [Path(one.source) for one in looked(watch)] == [file]
    [pipe, circle] = watch.store.add([inbox / "pipe.csv", inbox / "circle.csv"])
    assert pipe.refusal == f"{inbox / 'pipe.csv'}: is no regular file"
    assert "symbolic links" in str(circle.refusal)


def test_a_locked_file_is_taken_later(inbox: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    days(inbox, 1)
    events: list[dict[str, Any]] = []
    watch = watch_of(inbox, events)

    def locked(*_: object) -> None:
        raise PermissionError(13, "the file is used by another process", str(inbox / "day0.csv"))

    with monkeypatch.context() as patch:
        patch.setattr(sources, "digest_of", locked)
        looked(watch)
        looked(watch)
    assert [event["event"] for event in events] == ["refused"]
    assert "used by another process" in events[0]["reason"]
    looked(watch)
    assert len(watch.store.fits) == 1


def test_recordings_of_a_folder_are_one_test_and_one_that_is_late_joins_it(inbox: Path) -> None:
    *first, last = map(Path, rf.datasets.volts())
    folder = inbox / "2026-03-01"
    folder.mkdir()
    for file in first:
        shutil.copy(file, folder)
    study = study_for_store({"model": "whirl-whip", "known": {"K3": 6000.0}})
    assert study is not None
    watch = watch_of(inbox)
    watch.study = study
    looked(watch)
    shutil.copy(last, folder)
    looked(watch)
    assert [test.superseded for test in watch.store.tests] == [2, None]
    [(test, fit)] = watch.store.history()
    assert (test.number, fit.good) == (2, True)


# ---- several watches, and kills -------------------------------------------------------------------------------------


def watch_once(inbox: Path) -> None:
    watch = watch_of(inbox, on_alarm=f"tee -a {inbox.parent / 'alarms.txt'}")
    looked(watch)
    watch.states()


def test_two_watches_of_a_store_fit_once_and_tell_once(inbox: Path) -> None:
    changed_machine(inbox)
    watches = [FORK.Process(target=watch_once, args=(inbox,)) for _ in range(2)]
    for watch in watches:
        watch.start()
    for watch in watches:
        watch.join()
    assert [watch.exitcode for watch in watches] == [0, 0]
    with sqlite3.connect(inbox.parent / "machine.db") as connection:
        assert dict(connection.execute("SELECT * FROM sqlite_sequence")) == {"tests": 10, "fits": 10}
    dates = [test.date for test, _ in rf.Store(inbox.parent / "machine.db").history()]
    assert dates == sorted(dates)
    assert len((inbox.parent / "alarms.txt").read_text().splitlines()) == 1


def test_a_watch_that_was_killed_goes_on(inbox: Path) -> None:
    changed_machine(inbox, 9)
    for wait in (0.1, 0.2, 0.3):
        watch = FORK.Process(target=watch_once, args=(inbox,))
        watch.start()
        time.sleep(wait)
        os.kill(watch.pid or 0, signal.SIGKILL)
        watch.join()
    watch_once(inbox)
    store = rf.Store(inbox.parent / "machine.db")
    assert store.problems() == ()
    assert len(store.history()) == 9
    assert [rule.name for rule in watch_of(inbox).states()[0].alarms] == ["D"]


# ---- what cannot work is said before anything is fitted -------------------------------------------------------------


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (["--margin", "1.2"], "give --running-speed"),
        (["--on-alarm", "no-such-program 1"], "there is no program no-such-program"),
        (["--false-alarm", "1.5"], "below 1"),
        (["--settle", "-1"], "from 0"),
        (["--since", "yesterday"], "write 2026-03-01"),
        (["--follow", "Q"], "unknown value of the fits 'Q'"),
        (["--setup", "gone.toml"], "there is no such file"),
    ],
)
def test_what_cannot_work_is_one_sentence(more: list[str], said: str, inbox: Path, run: Run) -> None:
    days(inbox, 1)
    words = ["watch", inbox, "--study", inbox.parent / "study.toml", "--store", inbox.parent / "machine.db", "--once"]
    code, _, err = run(*words, "--settle", "0", *more)
    assert (code, said in err) == (2, True), err


def test_a_study_that_names_other_files_is_said(inbox: Path, run: Run) -> None:
    days(inbox, 2)
    study = inbox.parent / "study.toml"
    study.write_text('model = "one-mode"\nknown = {Ds = 8.0, K = 8000.0}\nfiles = ["rig.csv"]\n')
    code, out, err = run("watch", inbox, "--study", study, "--store", inbox.parent / "m.db", "--once", "--settle", "0")
    assert (code, out) == (0, "no test yet\n")
    assert "none of the 2 files" in err
    assert "rig.csv" in err


def test_a_folder_or_study_that_is_not_there_is_one_sentence(inbox: Path, run: Run) -> None:
    store, study = inbox.parent / "machine.db", inbox.parent / "study.toml"
    for folder, file in ((inbox / "gone", study), (study, study), (inbox, inbox / "gone.toml")):
        code, _, err = run("watch", folder, "--study", file, "--store", store, "--once")
        assert code == 2
        assert err.count("\n") == 1
