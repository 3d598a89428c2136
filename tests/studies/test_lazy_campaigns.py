"""Campaigns over parts of the data that are read where their runs are fitted."""

from __future__ import annotations

import gc
import pickle
import tracemalloc
import weakref
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import pandas as pd
import pytest
from seal_campaigns import KNOWN, same_fits, seal_campaign, written_parts
from sentences import warns

import rotorfit as rf
from rotorfit.base.executors import process_pool
from rotorfit.models import OneMode


@pytest.fixture(scope="module")
def parts(tmp_path_factory):
    return written_parts(tmp_path_factory.mktemp("parts"))


@pytest.fixture(scope="module")
def whole(parts):
    return rf.campaign(OneMode(), [rf.read(file) for file in parts], known=KNOWN)


def of_parquet(path):
    """A part from a format that rotorfit does not read as a table."""
    return rf.read(pd.read_parquet(path))


def test_parts_give_what_tables_in_hand_give(parts, whole, tmp_path):
    lazy = rf.campaign(OneMode(), parts, known=KNOWN)
    same_fits(lazy, whole)
    assert lazy.condition_remarks("pressure_psi") == whole.condition_remarks("pressure_psi")
    assert lazy.fit("r07").params == whole.fit("r07").params
    with process_pool(1) as pool:
        same_fits(rf.campaign(OneMode(), [partial(rf.read, file) for file in parts], known=KNOWN, executor=pool), whole)
    pd.read_csv(parts[1], comment="#").to_parquet(tmp_path / "b.parquet")
    same_fits(
        rf.campaign(OneMode(), [parts[0], partial(of_parquet, tmp_path / "b.parquet"), parts[2]], known=KNOWN), whole
    )
    known = {"K": 8000.0, "Ds": 8.0}
    there = rf.campaign(OneMode(), parts, known=known, shared=["M"])
    here = rf.campaign(OneMode(), [rf.read(file) for file in parts], known=known, shared=["M"])
    assert there.shared == here.shared
    same_fits(there, here)


def test_what_a_run_of_a_part_gives_holds_no_readings(parts, whole):
    """It is small whatever the readings, and its parameters know how they vary together."""
    lazy = rf.campaign(OneMode(), parts, known=KNOWN)
    own, full = lazy.runs[5], whole.runs[5]
    assert len(pickle.dumps(own)) < 4096
    one, other = (run.params["lam"] * run.params["D"] for run in (own, full))
    assert (one.value, one.unit) == (other.value, other.unit)
    assert one.stderr == pytest.approx(other.stderr, rel=1e-12)
    assert own.params["D"].stderr == full.params["D"].stderr


def test_ten_thousand_kept_results_are_ten_megabytes(tmp_path):
    """As they come back from a worker, 64 at once: the process that sends keeps the results of all runs."""
    table, _ = seal_campaign(64, lines=20)
    runs = rf.campaign(OneMode(), table, known=KNOWN, store=rf.Store(tmp_path / "runs.db")).runs
    batch = pickle.dumps(runs)
    tracemalloc.start()
    try:
        kept = [pickle.loads(batch) for _ in range(20)]
        size = tracemalloc.get_traced_memory()[0]
    finally:
        tracemalloc.stop()
    assert [run.params for run in kept[-1]] == [run.params for run in runs]
    assert kept[-1][3].params["lam"].fit is kept[-1][3]
    assert size < 1600 * 64 * 20  # of it numbers 0.5 kB, names of conditions and texts the rest


ALIVE: list[weakref.ref[object]] = []
MOST: list[int] = []


def counted(path):
    """Read a part, and note how many there are in memory."""
    found = rf.read(path)
    gc.collect()
    ALIVE.append(weakref.ref(found))
    MOST.append(sum(one() is not None for one in ALIVE))
    return found


def test_one_part_is_held_at_a_time(parts, tmp_path):
    ALIVE.clear(), MOST.clear()
    store = rf.Store(tmp_path / "runs.db")
    rf.campaign(OneMode(), [partial(counted, file) for file in parts], known=KNOWN, store=store)
    assert max(MOST) <= 2  # the next is read before the last is forgotten
    assert len(MOST) <= 6  # once to look, once to fit


def test_a_store_knows_runs_of_parts_again(parts, whole, tmp_path):
    """What was fitted in hand is found again in parts: the readings count, not where they come from."""
    store, seen = rf.Store(tmp_path / "runs.db"), []
    rf.campaign(OneMode(), [rf.read(parts[0]), rf.read(parts[1])], known=KNOWN, store=store)
    with ThreadPoolExecutor(1) as pool:
        found = rf.campaign(
            OneMode(), parts, known=KNOWN, store=store, executor=pool, progress=lambda *n: seen.append(n)
        )
    assert seen == [(12, 12)]  # the four of the last part were left
    same_fits(found, whole)


def test_what_is_no_part_is_named(parts):
    for wrong, said in [
        ([lambda: 1], "give its path"),
        ([partial(int)], "a table such as rf.read returns, not int"),
        ([rf.read(parts[0]), parts[1]], "not some of each"),
    ]:
        with pytest.raises((TypeError, ValueError), match=said):
            rf.campaign(OneMode(), wrong, known=KNOWN)
    with pytest.raises(FileNotFoundError):
        rf.campaign(OneMode(), "none.nc", known=KNOWN)


def test_errors_in_a_part_are_warned_of(parts, tmp_path):
    table = pd.read_csv(parts[1], comment="#")
    inverted = table["direction"] == "y"
    table.assign(phase_deg=table["phase_deg"] + 180.0 * inverted).to_csv(tmp_path / "y.csv", index=False)
    with warns(rf.DataWarning):
        rf.campaign(OneMode(), [tmp_path / "y.csv"], known=KNOWN)
