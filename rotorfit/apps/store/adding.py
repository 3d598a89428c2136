"""Tests and fits on their way into a store."""

from __future__ import annotations

import time
from collections.abc import Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from rotorfit.apps.store.database import KIND, Database, claimed, put_seal
from rotorfit.apps.store.records import Added, fit_row, insert, stored_findings, test_row, values_of
from rotorfit.apps.store.sources import Source, continues, settings_key
from rotorfit.apps.study_files.data_files import StudyProgress, no_progress
from rotorfit.apps.study_files.results import write_uncertainty
from rotorfit.apps.study_files.run import identify
from rotorfit.apps.study_files.study import Study
from rotorfit.apps.study_files.wording import sentence
from rotorfit.base.executors import carry_out
from rotorfit.base.file_reading import reading
from rotorfit.base.version import RESULTS, __version__
from rotorfit.lab.data.findings import Finding
from rotorfit.lab.data.rows import Experiment

if TYPE_CHECKING:
    from rotorfit.apps.store.store import Store


def add_sources(
    store: Store, sources: Sequence[Source], machine: str, executor: Executor | None, progress: StudyProgress
) -> tuple[Added, ...]:
    """Add all tests, then their fits; tests that arrive together are in order of date."""
    with claimed(store.database, "tests"):  # two that find the same files would mix the order of what arrives
        added = _add_tests(store.database, sources, machine, progress)
    if executor is None:
        return tuple(_with_fit(store, *pair, progress) for pair in zip(sources, added, strict=True))
    in_flight = 32  # fits that are waited for at a time, each with its claim
    threads = ThreadPoolExecutor(in_flight)
    try:
        found = []
        fits = partial(_with_fit, store, progress=no_progress, executor=executor)
        for one in threads.map(fits, sources, added):
            found.append(one)
            progress(f"{len(found)} of {len(sources)} fits", len(found) / len(sources))
        return tuple(found)
    finally:
        threads.shutdown(cancel_futures=True)


_THERE = "(test IS NULL OR test IN (SELECT number FROM tests))"
"""Condition of a source whose test the store does hold."""


def is_known(store: Store, source: Source) -> bool:
    """True if nothing has changed since the source was last added, with its study, or refused."""
    with store.database.look() as ask:
        found = ask(
            f"SELECT test, version FROM sources WHERE path = ? AND stamp = ? AND {_THERE} ORDER BY number DESC LIMIT 1",
            (source.name, source.stamp()),
        )
        if not found:
            return False
        test, version = found[0]
        if test is None:
            return bool(version == __version__)
        key = "" if source.study is None else settings_key(source.study)[0]
        return not key or bool(ask("SELECT 1 FROM fits WHERE test = ? AND settings = ?", (test, key)))


def _add_tests(database: Database, sources: Sequence[Source], machine: str, progress: StudyProgress) -> list[Added]:
    """Add the tests of sources; what cannot be read is refused."""
    with database.look() as ask, reading(str(database.path), KIND, decoded=True):
        # the time, or where a clock was set back the next number: in order of arrival
        batch = max(time.time_ns(), int(ask("SELECT coalesce(max(batch), 0) FROM tests")[0][0]) + 1)
    found = []
    for source in sources:
        name = str(source.path)
        try:
            test, is_new = _test_of(database, source, batch, machine, progress)
            found.append(Added(source=name, test=test, new_test=is_new))
        except OSError as problem:  # a file that is locked, or a network that is down, may be there the next time
            words = f"{problem.filename or source.path}: {problem.strerror or problem}"
            found.append(Added(source=name, refusal=words))
        except (ValueError, KeyError) as problem:
            _refuse(database, source, sentence(problem))
            found.append(Added(source=name, refusal=sentence(problem)))
    return found


def _refuse(database: Database, source: Source, reason: str) -> None:
    try:
        stamp = source.stamp()
    except OSError:  # it is gone meanwhile, and looked at again when it is there again
        return
    with database.change() as connection:
        row = {"path": source.name, "files": "[]", "stamp": stamp, "test": None, "refusal": reason}
        put_seal(connection, "sources", insert(connection, "sources", {**row, "version": __version__}))


def _test_of(database: Database, source: Source, batch: int, machine: str, progress: StudyProgress) -> tuple[int, bool]:
    """Number of the test, and whether it is new."""
    stamp = source.stamp()
    with database.look() as ask:
        asked = f"SELECT files, test FROM sources WHERE path = ? AND test NOT NULL AND {_THERE}"
        kept = [(files, test) for files, test in ask(asked, (source.name,)) if source.may_be(files)]
    identity = source.identity() if kept else ""  # of what is read in any case afterwards: junk of gigabytes is refused
    known = [test for files, test in kept if files == identity]
    row = None
    if not known:
        row = {"batch": batch, **test_row(source, machine, progress)}
        identity = identity or source.identity()
        if source.stamp() != stamp:
            raise ValueError(f"{source.path} changed while it was read; it is read again when it stands still")
    with database.change() as connection:
        test = known[0] if known else None
        is_new = False
        if row is not None:
            held = connection.execute("SELECT number FROM tests WHERE content = ?", (row["content"],)).fetchone()
            is_new = held is None
            test = insert(connection, "tests", row) if is_new else held[0]
        changed = [int(test or 0)]
        connection.execute("UPDATE tests SET superseded = NULL WHERE number = ?", (test,))
        # tests of earlier states of the source that it continues count no longer
        asked = "SELECT DISTINCT test, files FROM sources WHERE path = ? AND test NOT NULL AND test != ?"
        for other, earlier in connection.execute(asked, (source.name, test)).fetchall():
            if continues(source, earlier):
                connection.execute("UPDATE tests SET superseded = ? WHERE number = ?", (test, other))
                changed.append(other)
        for number in changed:
            put_seal(connection, "tests", number)
        row = {"path": source.name, "files": identity, "stamp": stamp, "test": test, "refusal": ""}
        put_seal(connection, "sources", insert(connection, "sources", {**row, "version": __version__}))
    return int(test or 0), is_new


def _with_fit(
    store: Store, source: Source, added: Added, progress: StudyProgress, executor: Executor | None = None
) -> Added:
    """What was added with the fit by its study, which is made where the store does not have it."""
    if source.study is None or added.test is None:
        return added
    number, is_new = _fit_of(store, source.study, added.test, progress, executor)
    return replace(added, fit=number, new_fit=is_new)


def refit(store: Store, study: Study, executor: Executor | None, progress: StudyProgress) -> int:
    """Fit again what has fits by a study of another version of results; returns how many."""
    key, _ = settings_key(study)
    asked = "SELECT test FROM fits WHERE settings = ? AND results != ? ORDER BY test"
    with store.database.look() as ask:
        tests = [int(row[0]) for row in ask(asked, (key, RESULTS))]
    for count, test in enumerate(tests):
        progress(f"fit of test {test}", count / len(tests))
        _fit_of(store, study, test, no_progress, executor, again=True)
    return len(tests)


def _fit_of(
    store: Store, study: Study, test: int, progress: StudyProgress, executor: Executor | None, *, again: bool = False
) -> tuple[int, bool]:
    """Number of the fit of a test by a study, and whether it was made now; ``again``, where it is of other results."""
    key, text = settings_key(study)
    found = _fit_number(store.database, test, key, again)
    if found is not None:
        return found, False
    with claimed(store.database, f"fit {test} {key}"):
        found = _fit_number(store.database, test, key, again)  # another process may have made it while this one waited
        if found is not None:
            return found, False
        with store.database.look() as ask:
            findings = ask("SELECT findings FROM tests WHERE number = ?", (test,))[0][0]
        with reading(str(store.path), KIND, decoded=True):
            looked_over = stored_findings(findings)
        work = partial(_fitted, progress=progress) if executor is None else _fitted
        [(row, values, files)] = carry_out(work, [(study, store.experiments(test), looked_over)], executor)
        with store.database.change() as connection:
            connection.execute("INSERT OR IGNORE INTO settings VALUES (?, ?, ?)", (key, study.model, text))
            connection.execute("DELETE FROM fits WHERE test = ? AND settings = ?", (test, key))
            number = insert(connection, "fits", {**row, "test": test, "settings": key})
            rows = [(number, *value) for value in values]
            connection.executemany("INSERT INTO parameters VALUES (?, ?, ?, ?, ?, ?)", rows)
            kept = [(number, *one) for one in files.items()]
            connection.executemany("INSERT INTO uncertainty VALUES (?, ?, ?)", kept)
            put_seal(connection, "fits", number)
        return number, True


def _fit_number(database: Database, test: int, key: str, again: bool) -> int | None:
    """Number of a fit; what could not be fitted is tried again by another version."""
    kept = "(version = ? AND results = ?)" if again else "(result NOT NULL OR (version = ? AND results = ?))"
    with database.look() as ask:
        rows = ask(
            f"SELECT number FROM fits WHERE test = ? AND settings = ? AND {kept}", (test, key, __version__, RESULTS)
        )
    return int(rows[0][0]) if rows else None


def _fitted(
    item: tuple[Study, tuple[Experiment, ...], tuple[tuple[Finding, ...], ...]], progress: StudyProgress = no_progress
) -> tuple[dict[str, Any], Sequence[Any], dict[str, bytes]]:
    """The fit of a test as a row, its values, and files of their uncertainty; here or on a worker."""
    try:
        outcome = identify(*item, progress)
    except (ValueError, KeyError) as problem:
        return fit_row(sentence(problem)), (), {}
    with TemporaryDirectory() as folder:
        write_uncertainty(outcome, Path(folder))
        files = {path.name: path.read_bytes() for path in Path(folder).iterdir()}
    return fit_row(outcome), values_of(outcome.best), files
