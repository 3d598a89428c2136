"""Work that one of several processes does: a claim in the store, renewed meanwhile, void when its owner dies."""

from __future__ import annotations

import os
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

from rotorfit.store.database import Database

LEASE = 60.0
"""Seconds after which the claim of an owner that does not renew it is void: of a machine that is gone. Chosen."""


@contextmanager
def claimed(database: Database, key: str) -> Iterator[None]:
    """Hold the claim on a piece of work; waits while another process that is alive holds it."""
    owner = f"{socket.gethostname()} {os.getpid()} {threading.get_ident()}"
    while not _take(database, key, owner):
        poll = 0.2  # seconds between looks at the claim of another. Chosen
        time.sleep(poll)
    ended = threading.Event()
    renewing = threading.Thread(target=_renew, args=(database, key, owner, ended), daemon=True)
    renewing.start()
    try:
        yield
    finally:
        ended.set()
        renewing.join()
        with database.change() as connection:
            connection.execute("DELETE FROM claims WHERE key = ? AND owner = ?", (key, owner))


def _take(database: Database, key: str, owner: str) -> bool:
    with database.change() as connection:
        held = connection.execute("SELECT owner, until FROM claims WHERE key = ?", (key,)).fetchone()
        if held is not None and held[1] > time.time() and not _is_dead(held[0]):
            return False
        connection.execute("REPLACE INTO claims VALUES (?, ?, ?)", (key, owner, time.time() + LEASE))
        return True


def _renew(database: Database, key: str, owner: str, ended: threading.Event) -> None:
    while not ended.wait(LEASE / 4):
        with database.change() as connection:
            connection.execute(
                "UPDATE claims SET until = ? WHERE key = ? AND owner = ?", (time.time() + LEASE, key, owner)
            )


def _is_dead(owner: str) -> bool:
    """True if the owner was a process of this machine that has ended."""
    host, process, _ = owner.rsplit(" ", 2)
    if host != socket.gethostname() or os.name != "posix":
        return False
    try:
        os.kill(int(process), 0)
    except ProcessLookupError:
        return True
    except PermissionError:  # another user's, and alive
        return False
    return False
