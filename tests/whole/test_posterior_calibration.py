"""A small simulation-based calibration: ranks of the truth are uniform, and a wrong posterior is found out."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

BINS = 4
DRAWS = 6 * BINS
"""Six a bin: chi-squared holds from five."""


@pytest.fixture(scope="module")
def sbc():
    sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))
    import simulation_based_calibration

    yield simulation_based_calibration
    sys.path.remove(str(Path(__file__).parents[2] / "benchmarks"))


@pytest.mark.parametrize("bins", [2, pytest.param(BINS, marks=pytest.mark.slow)])
def test_ranks_are_uniform(sbc, bins):
    study = sbc.make_study("one-mode", lines=12)
    ranks = sbc.run("one-mode", study, 6 * bins, seed=4, ess=300.0)
    assert ranks.unconverged == 0
    assert ranks.quantities[-1] == "threshold speed"
    assert not sbc.misses(sbc.judge(ranks, bins))


@pytest.mark.slow
def test_overconfidence_is_found_out(sbc):
    """Data noisier than the sampler believes, half of them by more than 1.5 times: outer ranks fill up."""
    study = sbc.make_study("one-mode", lines=12, noise="marginal")
    ranks = sbc.run("one-mode", study, DRAWS, seed=4, ess=300.0, assumed="fixed")
    rows = sbc.judge(ranks, BINS)
    assert sbc.misses(rows)
    outer = np.array([[int(c) for c in row.histogram.split()] for row in rows])[:, [0, -1]].sum(axis=1)
    assert np.mean(outer) > 2 * DRAWS / BINS


def test_a_channel_of_noise_alone_leaves_a_start(sbc):
    """A draw in which the closed form's passes diverge until their equations are singular: earlier passes serve."""
    from rotorfit.estimators.starting.starts import find_start

    study = sbc.make_study("two-disk")
    seeds = np.random.SeedSequence(1).spawn(205)[204]
    _, problem = study.simulate(np.random.default_rng(seeds))
    start = find_start(problem, {}).x
    assert np.isfinite(start).all()
    assert np.isfinite(problem.cost(np.clip(start, 1e-9, None)))
