"""Campaigns over a store: what was done before a process or a worker was killed is kept."""

from __future__ import annotations

import multiprocessing
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from seal_campaigns import KNOWN, same_fits, seal_campaign

import rotorfit as rf
from rotorfit.models import OneMode

FORK = multiprocessing.get_context("fork")


def kept_campaign(path, table, stop=None):
    """A campaign over a store, killed by itself after so many runs."""

    def progress(done, total):
        if stop is not None and done >= stop:
            os.kill(os.getpid(), signal.SIGKILL)

    return rf.campaign(OneMode(), table, known=KNOWN, store=rf.Store(path), progress=progress)


def test_a_campaign_that_was_killed_takes_up_where_it_stopped(tmp_path):
    table, _ = seal_campaign(20)
    process = FORK.Process(target=kept_campaign, args=(tmp_path / "m.db", table, 10))
    process.start()
    process.join()
    assert process.exitcode == -signal.SIGKILL
    seen = []
    store = rf.Store(tmp_path / "m.db")
    found = rf.campaign(OneMode(), table, known=KNOWN, store=store, progress=lambda *n: seen.append(n))
    assert seen[0][0] > 16  # two batches of eight were kept
    plain = rf.campaign(OneMode(), table, known=KNOWN)
    same_fits(found, plain)
    again = rf.campaign(OneMode(), table, known=KNOWN, store=store)
    assert again.to_csv() == found.to_csv()  # what is kept is exact
    seen.clear()
    rf.campaign(OneMode(), table, known=KNOWN | {"Ds": 8.5}, store=store, progress=lambda *n: seen.append(n))
    assert seen[0][0] == 8  # other settings are other fits


KILLED = """
import os, signal, sys
sys.path.insert(0, sys.argv[1])
import rotorfit as rf
from seal_campaigns import KNOWN, seal_campaign
from rotorfit.base.executors import cluster

def kill(done, total):
    workers = [worker.pid for worker in pool._client.cluster.workers.values() if worker.pid]  # None while one starts
    print(done, *workers, flush=True)
    for victim in [os.getpid()] if done > 16 else workers[:1]:
        os.kill(victim, signal.SIGKILL)

if __name__ == "__main__":
    with cluster("local:2") as pool:
        table, store = seal_campaign(40, lines=40)[0], rf.Store(sys.argv[2])
        rf.campaign(rf.models.OneMode(), table, known=KNOWN, executor=pool, store=store, progress=kill)
"""


def test_killed_workers_and_a_killed_sender_change_no_digit(tmp_path):
    """A worker dies after the first batches, the sender after the third; begun again, the table is that of a loop."""
    pytest.importorskip("distributed")
    store, tests = tmp_path / "runs.db", Path(__file__).parents[1] / "rigs"
    (tmp_path / "killed.py").write_text(KILLED, encoding="utf-8")
    ended = subprocess.run(
        [sys.executable, tmp_path / "killed.py", tests, store],
        check=False,
        capture_output=True,
        text=True,
        timeout=100,
    )
    assert ended.returncode == -signal.SIGKILL, ended.stderr
    first, *_, last = [[int(word) for word in line.split()] for line in ended.stdout.splitlines()]
    assert (first[0], last[0]) == (8, 24)
    table, _ = seal_campaign(40, lines=40)
    counts: list[int] = []
    again = rf.campaign(
        OneMode(), table, known=KNOWN, store=rf.Store(store), progress=lambda done, _: counts.append(done)
    )
    assert counts[0] == 24 + 8  # the next batch after the three that were kept
    assert again.to_csv() == rf.campaign(OneMode(), table, known=KNOWN).to_csv()
    assert all(map(_has_ended, last[1:]))


def _has_ended(pid):
    """True once a process is gone, which may take a while."""
    end = time.monotonic() + 20.0
    while time.monotonic() < end:
        try:
            os.kill(pid, 0)
        except ProcessLookupError:
            return True
        time.sleep(0.1)
    return False
