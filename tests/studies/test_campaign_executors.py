"""Campaigns over executors that lose workers."""

from __future__ import annotations

import logging
import os
import pickle
import signal
import warnings
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import nullcontext
from multiprocessing import get_context

import numpy as np
import pytest
from seal_campaigns import KNOWN, same_fits, seal_campaign
from sentences import refuses
from synthetic import KNOWN as KNOWN_VALUES
from synthetic import SPEEDS, TYPICAL, circular_test

import rotorfit as rf
from rotorfit.base.executors import carry_out, cluster
from rotorfit.estimators.starting import lumped
from rotorfit.models import MODELS, OneMode
from rotorfit.studies.campaigns import runs


@pytest.fixture(scope="module")
def small():
    return seal_campaign(20)


@pytest.fixture(scope="module")
def fitted(small):
    return rf.campaign(OneMode(), small[0], known=KNOWN)


# ---- executors ----------------------------------------------------------------------------------------------------


def test_threads_and_processes(small, fitted):
    table, _ = small
    with ThreadPoolExecutor(2) as pool:
        same_fits(rf.campaign(OneMode(), table, known=KNOWN, executor=pool), fitted)
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        seen = []
        found = rf.campaign(OneMode(), table, known=KNOWN, executor=pool, progress=lambda *n: seen.append(n))
        same_fits(found, fitted)
        assert seen[-1] == (20, 20)
        known = {"K": 8000.0, "Ds": 8.0}
        here = rf.campaign(OneMode(), table, known=known, shared=["M"])
        there = rf.campaign(OneMode(), table, known=known, shared=["M"], executor=pool)
        assert there.shared["M"].value == pytest.approx(here.shared["M"].value, rel=1e-9)


@pytest.mark.parametrize("name", ["one-mode", "whirl-whip", "two-disk"])
def test_the_run_that_is_fitted_first_changes_no_digit(name):
    """Fits after the first share what it found about the model alone: a worker begins with any run."""
    model, rng = MODELS[name](), np.random.default_rng(1)
    known, speeds = {n: TYPICAL[name][n] for n in KNOWN_VALUES[name]}, SPEEDS[name]
    rotors = [{n: v if n in known else v * rng.uniform(0.9, 1.1) for n, v in TYPICAL[name].items()} for _ in range(3)]
    tests = [
        circular_test(
            model, model.vector(rotor), speeds=tuple(speed + number for speed in speeds),
            frequency=np.linspace(-300.0, 300.0, 60), noise=0.01, seed=number,
        )
        for number, rotor in enumerate(rotors)
    ]  # fmt: skip
    found = []
    for order in ([0, 1, 2], [2, 1, 0]):
        for kept in (lumped._lumped, lumped.lumped_graph):
            kept.cache_clear()
        runs = rf.campaign(model, [tests[number] for number in order], split=None, known=known).runs
        found.append([runs[order.index(number)].params for number in range(3)])
    assert found[0] == found[1]
    assert all(found[0])


def test_a_killed_process_loses_no_run(small, monkeypatch):
    """A broken process pool takes no more work: what is left is fitted here.

    Runs are thin and sent one by one, so that three of them fit into a pipe: the pool of Pythons as old as 3.11.2 waits
    for ever where its worker dies while an item is written that does not.
    """
    table, _ = small
    thin = table.select(np.isin(table.frequency, np.unique(table.frequency)[::12]))
    monkeypatch.setattr(runs, "RUNS_OF_A_BATCH", 1)
    assert 3 * len(pickle.dumps(thin.select(thin.run == thin.runs[0]))) < 2**16 - 2**13  # and the model beside each
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:

        def kill_once(done, total):
            for process in list((pool._processes or {}).values()):
                process.kill()

        with pytest.warns(UserWarning, match="of 20 pieces of work done here"):
            found = rf.campaign(OneMode(), thin, known=KNOWN, executor=pool, progress=kill_once)
    same_fits(found, rf.campaign(OneMode(), thin, known=KNOWN))


class Unreliable(Executor):
    """Loses the first attempts at every batch."""

    def __init__(self, losses):
        self.losses, self.attempts = losses, 0

    def submit(self, fn, /, *args, **kwargs):
        self.attempts += 1
        future = Future()
        if self.attempts <= self.losses:
            future.set_exception(OSError("worker lost"))
        else:
            future.set_result(fn(*args, **kwargs))
        return future


@pytest.mark.parametrize("losses", [2, 1000])
def test_lost_batches_are_sent_again_and_done_here_in_the_end(small, fitted, losses):
    pool = Unreliable(losses)
    words = "3 of 3 pieces of work done here: worker lost"
    with pytest.warns(UserWarning, match=words) if losses > 2 else nullcontext():
        same_fits(rf.campaign(OneMode(), small[0], known=KNOWN, executor=pool), fitted)
    assert pool.attempts == (3 + 2 if losses == 2 else 3 * 3)


def test_an_error_of_the_work_itself_is_shown(small):
    class Broken(OneMode):
        def __reduce__(self):
            return Broken, ()

        def equation(self, p, speed, eccentricity):
            raise RuntimeError("no such equation")

    with ThreadPoolExecutor(1) as pool, refuses(ValueError):
        rf.campaign(Broken(), small[0], known=KNOWN, executor=pool)
    with refuses(RuntimeError):
        rf.campaign(Broken(), small[0], known=KNOWN)


@pytest.mark.slow
def test_dask_cluster_that_loses_a_worker(small, fitted):
    """A real local cluster of the distributed package, one of its two worker processes killed half way."""
    table, _ = small
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the cluster itself
        from distributed import Client, LocalCluster

        options = {"n_workers": 2, "threads_per_worker": 1, "dashboard_address": None, "silence_logs": logging.CRITICAL}
        with LocalCluster(**options) as cluster, Client(cluster) as client:
            pool = client.get_executor(pure=False)
            same_fits(rf.campaign(OneMode(), table, known=KNOWN, executor=pool), fitted)
            killed = []

            def kill_one(done, total):
                if not killed:
                    killed.append(next(iter(cluster.workers.values())).pid)
                    os.kill(killed[0], signal.SIGKILL)

            found = rf.campaign(OneMode(), table, known=KNOWN, executor=pool, progress=kill_one)
            assert killed
            same_fits(found, fitted)


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
            same_fits(rf.campaign(OneMode(), table, known=KNOWN, executor=pool), plain)
            logging.getLogger("distributed").setLevel(logging.CRITICAL)
            pool._client.cluster.scale(0)
            assert carry_out(abs, [-1, -2], pool, patience=1.0) == [1, 2]
