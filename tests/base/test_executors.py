"""Work sent elsewhere: a lost cluster is not waited for, what was done is kept, workers end with their parent."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from concurrent.futures import Executor, Future
from pathlib import Path
from types import SimpleNamespace

import pytest
from sentences import warns

from rotorfit.base.executors import carry_out


class Silent(Executor):
    """Answers some items and then nothing: a cluster scaled to zero."""

    def __init__(self, answers):
        self.answers, self.sent = answers, 0

    def submit(self, fn, /, *args, **kwargs):
        future = Future()
        self.sent += 1
        if self.sent <= self.answers:
            future.set_result(fn(*args, **kwargs))
        return future


class Closed(Executor):
    """Takes nothing: a client that was closed."""

    def submit(self, fn, /, *args, **kwargs):
        raise AssertionError("tried to send a message over a closed comm")


class GivenUp(Silent):
    """Answers nothing: of a Dask client that could not reach its scheduler any more."""

    _client = SimpleNamespace(status="closed")


@pytest.mark.parametrize(
    ("pool", "patience", "said"),
    [
        (Silent(3), 0.2, "no worker has answered for 0.2 s"),
        (Closed(), 0.2, "closed comm"),
        (GivenUp(0), 300.0, "the cluster was lost"),
    ],
)
def test_a_cluster_that_is_lost_is_not_waited_for(pool, patience, said):
    done = []
    with warns(UserWarning):
        found = carry_out(lambda n: n * n, range(10), pool, lambda n, square: done.append(n), patience=patience)
    assert found == [n * n for n in range(10)]
    assert sorted(done) == list(range(10))


def test_no_machine_holds_all_items():
    """Items are sent as others are answered."""
    pool = Silent(0)
    with warns(UserWarning):
        carry_out(lambda n: n, range(2000), pool, patience=0.1)
    assert pool.sent == 256


PARENT = """
import time
from rotorfit.base.executors import process_pool
if __name__ == "__main__":
    with process_pool(2) as pool:
        for work in [pool.submit(time.sleep, 0.5) for _ in range(2)]:
            work.result()
        for _ in range(2):
            pool.submit(time.sleep, 600)
        print(*pool._processes, flush=True)
        time.sleep(600)
"""


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
@pytest.mark.parametrize("end", [signal.SIGTERM, signal.SIGKILL])
def test_processes_end_with_the_one_that_started_them(end, tmp_path):
    (tmp_path / "parent.py").write_text(PARENT)
    with subprocess.Popen([sys.executable, tmp_path / "parent.py"], stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        workers = [int(word) for word in parent.stdout.readline().split()]
        assert len(workers) == 2
        parent.send_signal(end)
    until = time.monotonic() + 10
    while any(Path(f"/proc/{worker}").exists() and running(worker) for worker in workers):
        assert time.monotonic() < until, "the workers go on"
        time.sleep(0.05)


def running(process: int) -> bool:
    """False for one that has ended and was not asked for its exit code."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False
