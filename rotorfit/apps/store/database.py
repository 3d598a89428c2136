"""The file of a store: one SQLite database, written in whole transactions by any number of processes.

SQLite and not DuckDB: a DuckDB file takes one writing process at a time, a store takes several; what is written is a
row now and then, what is read some thousand, so that columns in a row would gain nothing; and SQLite comes with Python.

The journal is SQLite's rollback journal with full synchronisation, not a write-ahead log: a log needs memory that all
processes share, which folders of a network do not give, cannot be read in a folder that is read-only, and leaves two
further files that somebody who copies the store forgets. A transaction is in the file as a whole once it is committed;
what a kill or a power failure leaves of another is rolled back by whoever opens the store next.
"""

from __future__ import annotations

import hashlib
import logging
import math
import os
import re
import socket
import sqlite3
import threading
import time
import zlib
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import Any

from rotorfit.base.file_reading import decompressed, reading, shown

SCHEMA = 2
"""Version of the tables; raised when older readers would misread them."""
_MARK = 0x726F7466
"""SQLite's application_id of a store: the letters "rotf"."""
_PATIENCE = 60.0
"""Seconds that a writer waits for others; each holds the file for some thousandths of a second. Chosen."""
KIND = "store of tests"
"""A store in the sentence that refuses a damaged one."""

_TABLES = """
CREATE TABLE tests (
    number INTEGER PRIMARY KEY AUTOINCREMENT,
    batch INTEGER NOT NULL,                   -- rises with every adding; its tests are in order of date
    content TEXT NOT NULL UNIQUE,             -- hash of the readings
    kind TEXT NOT NULL,
    readings INTEGER NOT NULL,
    machine TEXT NOT NULL,
    date TEXT NOT NULL,                       -- ISO 8601
    date_given INTEGER NOT NULL,              -- by the data; else it is the file's
    conditions TEXT NOT NULL,                 -- JSON: speed, oil temperature, ...
    findings TEXT NOT NULL,                   -- JSON, of the check of the data
    data BLOB NOT NULL,                       -- compressed JSON of the experiments
    superseded INTEGER REFERENCES tests (number), -- by a test that holds the same files, completed
    added TEXT NOT NULL,
    version TEXT NOT NULL,
    seal TEXT NOT NULL DEFAULT ''             -- checksum of the record
);
CREATE TABLE sources (
    number INTEGER PRIMARY KEY,
    path TEXT NOT NULL,                       -- file or folder
    files TEXT NOT NULL,                      -- JSON: name, size and SHA-256 of each file
    stamp TEXT NOT NULL,                      -- JSON: name, size and times of each file
    test INTEGER REFERENCES tests (number),   -- none: refused
    refusal TEXT NOT NULL,
    version TEXT NOT NULL,
    seal TEXT NOT NULL DEFAULT ''
);
CREATE INDEX sources_by_path ON sources (path);
CREATE TABLE settings (key TEXT PRIMARY KEY, model TEXT NOT NULL, text TEXT NOT NULL);
CREATE TABLE fits (
    number INTEGER PRIMARY KEY AUTOINCREMENT,
    test INTEGER NOT NULL REFERENCES tests (number),
    settings TEXT NOT NULL REFERENCES settings (key),
    success INTEGER NOT NULL,
    message TEXT NOT NULL,
    redchi REAL,
    findings TEXT NOT NULL,                   -- JSON: errors and warnings in words
    result BLOB,                              -- compressed fit.json, with covariances; none: not fitted
    added TEXT NOT NULL,
    version TEXT NOT NULL,
    results TEXT NOT NULL,                    -- version of the numbers that fits give
    seal TEXT NOT NULL DEFAULT '',            -- with its parameters and files
    UNIQUE (test, settings)
);
CREATE TABLE parameters (                     -- of a fit, SI units, for whoever asks in SQL
    fit INTEGER NOT NULL REFERENCES fits (number) ON DELETE CASCADE,
    name TEXT NOT NULL,
    value REAL, stderr REAL, systematic REAL, -- none: not determined
    unit TEXT NOT NULL,
    PRIMARY KEY (fit, name)
) WITHOUT ROWID;
CREATE TABLE uncertainty (                    -- of a fit, where its study asks for it
    fit INTEGER NOT NULL REFERENCES fits (number) ON DELETE CASCADE,
    file TEXT NOT NULL,                       -- posterior.nc, profiles.csv, bootstrap.csv
    data BLOB NOT NULL,
    PRIMARY KEY (fit, file)
) WITHOUT ROWID;
CREATE TABLE claims (key TEXT PRIMARY KEY, owner TEXT NOT NULL, until REAL NOT NULL) WITHOUT ROWID;
CREATE TABLE alarms ( -- that were reported
    fit INTEGER NOT NULL, rule TEXT NOT NULL, PRIMARY KEY (fit, rule)) WITHOUT ROWID;
CREATE TABLE pieces ( -- of work that is done in pieces
    key TEXT PRIMARY KEY, data BLOB NOT NULL) WITHOUT ROWID;
"""
_FOREIGN = """
SELECT made.name FROM sqlite_master AS made LEFT JOIN pragma_table_xinfo(made.name) AS has
WHERE made.sql NOT LIKE 'CREATE TABLE %' AND made.sql NOT LIKE 'CREATE INDEX %' OR has.hidden > 0 LIMIT 1
"""
"""Asks for what would run as a store is read or written, without end perhaps: views, triggers, virtual tables."""


class Database:
    """A store's file. A connection lives for one transaction: nothing is open while a fit is being made."""

    def __init__(self, path: Path) -> None:
        self.path = path
        if not path.parent.is_dir():
            raise FileNotFoundError(f"there is no folder {path.parent} for the store {path.name}")
        if path.is_dir():
            raise IsADirectoryError(f"{path} is a folder; a store is one file, {path / 'machine.db'} for instance")
        if path.exists() and path.stat().st_size:
            with self.look() as ask:
                ask("SELECT count(*) FROM tests")
            return
        if not os.access(path if path.exists() else path.parent, os.W_OK):
            raise PermissionError(f"cannot write the store {path}: its folder is read-only; give another place")
        with self._connected(make=True) as connection:
            connection.execute("BEGIN IMMEDIATE")
            if self._version(connection) == 0:  # nobody else made it meanwhile
                for statement in filter(str.strip, _TABLES.split(";\n")):
                    connection.execute(statement)
                connection.execute(f"PRAGMA application_id = {_MARK}")
                connection.execute(f"PRAGMA user_version = {SCHEMA}")
            connection.execute("COMMIT")

    @contextmanager
    def look(self) -> Iterator[Any]:
        """Ask questions of one state of the store: ``ask(sql, values)`` gives the rows."""
        with self._connected() as connection:
            self._check_version(connection)
            connection.execute("BEGIN")
            yield lambda sql, values=(): connection.execute(sql, values).fetchall()
            connection.execute("COMMIT")

    @contextmanager
    def change(self) -> Iterator[sqlite3.Connection]:
        """Change the store, as a whole when the block ends well and not at all otherwise."""
        self._refuse_gone()
        if not os.access(self.path, os.W_OK) or not os.access(self.path.parent, os.W_OK):
            raise PermissionError(f"the store {self.path} is read-only: it or its folder may not be written to")
        with self._connected() as connection:
            connection.execute("BEGIN IMMEDIATE")
            try:
                self._check_version(connection)
                yield connection
            except BaseException:
                if connection.in_transaction:  # SQLite ends it by itself where the disk is full
                    connection.execute("ROLLBACK")
                raise
            connection.execute("COMMIT")

    def _refuse_gone(self) -> None:
        if not self.path.exists():
            raise FileNotFoundError(f"the store {self.path} is not there any more: it was deleted, renamed or moved")

    @contextmanager
    def _connected(self, *, make: bool = False) -> Iterator[sqlite3.Connection]:
        if not make:
            self._refuse_gone()
        with self._sentences(), closing(self._open()) as connection:
            connection.execute("PRAGMA synchronous = FULL")
            connection.execute("PRAGMA foreign_keys = ON")
            connection.row_factory = sqlite3.Row
            yield connection

    def _open(self) -> sqlite3.Connection:
        return sqlite3.connect(self.path, timeout=_PATIENCE, isolation_level=None)

    @contextmanager
    def _sentences(self) -> Iterator[None]:
        """Errors of SQLite as a sentence that names the store."""
        try:
            yield
        except sqlite3.OperationalError as problem:
            words = _on_one_line(problem)
            if "locked" in words:
                raise TimeoutError(
                    f"{self.path}: other processes kept the store for {_PATIENCE:g} s, or its file system does not "
                    f"lock files ({words}); a store lies on a file system that does, see docs/howto/watch.md"
                ) from problem
            raise OSError(f"the store {self.path} cannot be used: {words}") from problem
        except sqlite3.DataError as problem:
            raise ValueError(
                f"{self.path}: a test is too long for a store, which holds at most 1e9 packed bytes of each; split it"
            ) from problem
        except OverflowError as problem:
            raise ValueError(f"{self.path} is damaged: its numbers leave no room for a further record") from problem
        except sqlite3.IntegrityError as problem:
            raise ValueError(
                f"{self.path} is damaged: what it holds does not belong together ({_on_one_line(problem)}); `rotorfit "
                "store check` says where"
            ) from problem
        except (sqlite3.DatabaseError, UnicodeDecodeError) as problem:
            if type(problem) not in (sqlite3.DatabaseError, UnicodeDecodeError):  # a mistake in a statement, no damage
                raise
            raise ValueError(
                f"{self.path} is not a store of tests, or is damaged: {_on_one_line(problem)}; `rotorfit store "
                "add` into a new file fits the tests again"
            ) from problem

    def _version(self, connection: sqlite3.Connection) -> int:
        return int(connection.execute("PRAGMA user_version").fetchone()[0])

    def _check_version(self, connection: sqlite3.Connection) -> None:
        version, mark = self._version(connection), connection.execute("PRAGMA application_id").fetchone()[0]
        if mark != _MARK:
            raise ValueError(f"{self.path} is an SQLite database of another program, not a store of tests")
        if version < SCHEMA:
            raise ValueError(
                f"the store {self.path} has version {version}, of a rotorfit before any release; `rotorfit store add` "
                "into a new file fits the tests again"
            )
        if version > SCHEMA:
            raise ValueError(
                f"the store {self.path} has version {version}, written by a newer rotorfit; this one reads version "
                f"{SCHEMA}: install a newer one"
            )
        found = connection.execute(_FOREIGN).fetchone()
        if found is not None:
            raise ValueError(
                f"the store {self.path} holds {found[0]!a}, which rotorfit did not make: a view, a trigger or a column "
                "that is worked out runs what it says; add the tests to a new store, and keep views in a database of "
                "their own, which attaches this one"
            )

    def problems(self) -> list[str]:
        """Damage of the file, in SQLite's words, and records that are not as they were written."""
        with self._connected() as connection:
            found = [str(row[0]) for row in connection.execute("PRAGMA integrity_check")]
            found = [text for text in found if text != "ok"]
            for table, row, other, _ in connection.execute("PRAGMA foreign_key_check"):
                found.append(f"{table}: record {row or ''} is of none of the {other}")
            for table in SEALED:
                for number, seal in connection.execute(f"SELECT number, seal FROM {table} ORDER BY number").fetchall():
                    if seal_of(connection, table, number) != seal:
                        found.append(f"{table}: record {number} is not as it was written (its checksum does not agree)")
            return found


SEALED: dict[str, tuple[str, ...]] = {"tests": (), "sources": (), "fits": ("parameters", "uncertainty")}
"""Tables whose records have a checksum, with those whose rows it takes in."""


def seal_of(connection: sqlite3.Connection, table: str, number: int) -> str:
    """Checksum of a record with the rows that belong to it."""
    digest = hashlib.sha256()
    asked = [f"SELECT * FROM {table} WHERE number = ?"]
    asked += [f"SELECT * FROM {part} WHERE fit = ? ORDER BY 1, 2" for part in SEALED[table]]
    for sql in asked:
        for row in connection.execute(sql, (number,)):
            for name in row.keys():  # noqa: SIM118 - iterating a row gives its values
                value = hashlib.sha256(row[name]).hexdigest() if isinstance(row[name], bytes) else row[name]
                digest.update(repr((name, value)).encode() if name != "seal" else b"")
    return digest.hexdigest()


def put_seal(connection: sqlite3.Connection, table: str, number: int) -> None:
    """Seal a record once all of it is written, and again where it changes."""
    connection.execute(f"UPDATE {table} SET seal = ? WHERE number = ?", (seal_of(connection, table, number), number))


def _on_one_line(problem: Exception) -> str:
    """What SQLite says, which may cite the definition of a table."""
    most = 160
    words = " ".join(str(problem).split())
    return words if len(words) <= most else f"{words[:most]} ..."


def packed(text: str) -> bytes:
    """A text as it is stored, with the checksum that zlib adds."""
    return zlib.compress(text.encode("utf-8"))


def unpacked(blob: bytes, name: str) -> str:
    """The text that was packed; damage is one sentence."""
    with reading(name, KIND):
        return decompressed(name, blob, len(blob)).decode("utf-8")


LEASE = 60.0
"""Seconds after which the claim of an owner that does not renew it is void: of a machine that is gone. Chosen."""
_LOG = logging.getLogger("rotorfit")


@contextmanager
def claimed(database: Database, key: str) -> Iterator[None]:
    """Hold the claim on a piece of work; waits while another process that is alive holds it, and says for which."""
    owner = f"{socket.gethostname()} {os.getpid()} {threading.get_ident()}"
    poll, silent = 0.2, 5.0  # seconds between looks at the claim of another, and of waiting without a word. Chosen
    begin = time.monotonic()
    while holder := _take(database, key, owner):
        if time.monotonic() - begin > silent:
            host, process, _ = shown(holder).rsplit(" ", 2)
            work = key.partition(" ")[0]
            _LOG.warning(f"rotorfit: {database.path}: waiting for process {process} on {host}, which is at the {work}")
            silent = math.inf
        time.sleep(poll)
    ended = threading.Event()

    def renew() -> None:
        while not ended.wait(LEASE / 4):
            with suppress(OSError, ValueError), database.change() as connection:  # what lasts is met at the end
                asked = "UPDATE claims SET until = ? WHERE key = ? AND owner = ?"
                connection.execute(asked, (time.time() + LEASE, key, owner))

    renewing = threading.Thread(target=renew, daemon=True)
    renewing.start()
    try:
        yield
    finally:
        ended.set()
        renewing.join()
        with database.change() as connection:
            connection.execute("DELETE FROM claims WHERE key = ? AND owner = ?", (key, owner))


def _take(database: Database, key: str, owner: str) -> str:
    """Take a claim, or say who holds it."""
    with database.change() as connection:
        held = connection.execute("SELECT owner, until FROM claims WHERE key = ?", (key,)).fetchone()
        if held is not None and not _is_void(*held):
            return str(held[0])
        connection.execute("REPLACE INTO claims VALUES (?, ?, ?)", (key, owner, time.time() + LEASE))
        return ""


def _is_void(owner: Any, until: Any) -> bool:
    """True if a claim has run out, is dated further ahead than clocks of machines differ by, is none that this program
    writes, or its owner was a process of this machine that has ended."""
    written = isinstance(until, float) and isinstance(owner, str) and re.fullmatch(r".* (\d{1,9}) \d+", owner)
    if not written or not 0 < until - time.time() <= 2 * LEASE:
        return True
    if owner.rsplit(" ", 2)[0] != socket.gethostname() or os.name != "posix":
        return False
    try:
        os.kill(int(written[1]), 0)
    except ProcessLookupError:
        return True
    except PermissionError:  # another user's, and alive
        return False
    return False
