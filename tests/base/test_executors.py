"""Work sent elsewhere: a lost cluster is not waited for, what was done is kept, workers end with their parent."""

from __future__ import annotations

import logging
import multiprocessing
import os
import pickle
import signal
import subprocess
import sys
import time
import warnings
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from seal_campaigns import KNOWN, same_fits, seal_campaign
from sentences import warns

import rotorfit as rf
from rotorfit.apps.cli.main import main
from rotorfit.base.executors import carry_out, cluster
from rotorfit.models import OneMode

FORK = multiprocessing.get_context("fork")


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


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--cluster", "host:8786"], "--cluster takes local:N or the address of a scheduler"),
        (["--cluster", "local:0"], "from 1"),
        (["--cluster", "local:2", "--jobs", "2"], "give one of them"),
    ],
)
def test_an_address_that_is_none_is_one_sentence(words, said, capsys, tmp_path):
    table, _ = seal_campaign(2)
    rf.write(table, tmp_path / "seal.csv")
    file = str(tmp_path / "seal.csv")
    commands = ["campaign", file, "--model", "one-mode"], ["fit", file, "--model", "one-mode"]
    for command in (*commands, ["vectors", file, "--out", str(tmp_path / "out.csv")]):
        assert main([*command, *words]) == 2
        assert said in capsys.readouterr().err


def test_simulated_tests_are_fitted_elsewhere_as_here():
    fit = rf.fit(OneMode(), seal_campaign(1)[0], known=KNOWN)
    with ThreadPoolExecutor(2) as pool:
        there = fit.bootstrap(n=80, seed=1, executor=pool)
    here = fit.bootstrap(n=80, seed=1)
    np.testing.assert_allclose(there.samples, here.samples, rtol=1e-6)


def test_profiles_are_found_elsewhere_as_here():
    fit = rf.fit(OneMode(), seal_campaign(1)[0], known=KNOWN)
    with ThreadPoolExecutor(2) as pool:
        there = fit.profiles(["K0", "lam"], points=5, executor=pool)
    for one, other in zip(there, fit.profiles(["K0", "lam"], points=5), strict=True):
        assert (one.name, one.interval, one.message) == (other.name, other.interval, other.message)
        np.testing.assert_array_equal(one.rise, other.rise)


def test_a_fit_and_a_plan_can_be_sent():
    fit = rf.fit(OneMode(), seal_campaign(1)[0], known=KNOWN)
    sent = pickle.loads(pickle.dumps(fit))
    np.testing.assert_array_equal(sent.sample(seed=1, ess=20).chain, fit.sample(seed=1, ess=20).chain)
    design = rf.Design(speed_rpm=[500, 900], frequency_rpm=range(200, 2001, 200), force_N=5.0)
    plan = rf.plan(OneMode(), fit, design, noise_um=0.5, quantity="lam")
    assert str(pickle.loads(pickle.dumps(plan))) == str(plan)


def test_netcdf_files_are_written_beside_a_dask_client(tmp_path):
    """xarray then locks by the cluster, which takes files only; posteriors are drawn on workers."""
    distributed = pytest.importorskip("distributed")
    table, _ = seal_campaign(1)
    here = {"dashboard": False, "dashboard_address": "127.0.0.1:0"}
    options = {"processes": False, "protocol": "tcp", "threads_per_worker": 1, "scheduler_kwargs": here}
    with distributed.LocalCluster(1, **options) as workers, distributed.Client(workers):
        rf.write(table, tmp_path / "a.nc")
    assert len(rf.read(tmp_path / "a.nc")) == len(table)


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
    store, tests = tmp_path / "runs.db", Path(__file__).parent
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


@pytest.mark.slow
def test_a_dask_cluster_and_one_scaled_to_zero():
    """A real cluster of one process: it works, and when it is taken away the rest is done here."""
    pytest.importorskip("distributed")
    table, _ = seal_campaign(16)
    plain = rf.campaign(OneMode(), table, known=KNOWN)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the cluster itself
        with cluster("local:1") as pool:
            same_fits(rf.campaign(OneMode(), table, known=KNOWN, executor=pool), plain)
            same_fits(rf.campaign(OneMode(), table, known=KNOWN, client=pool._client), plain)
            logging.getLogger("distributed").setLevel(logging.CRITICAL)
            pool._client.cluster.scale(0)
            assert carry_out(abs, [-1, -2], pool, patience=1.0) == [1, 2]
