"""Errors from leaving out runs, against fits without them and against the truth where runs differ."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from plain import summary_words
from scipy import stats
from sentences import refuses

import rotorfit as rf

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))
from honest_errors import WORLDS, World, simulate, threshold

FLUID = {"K": 8000.0, "Ds": 8.0}
OIL = WORLDS["oil 1 % from run to run"]


def fitted(world: World, seed: int) -> tuple[rf.PerturbationTest, rf.FitResult]:
    test = simulate(world, np.random.default_rng(seed))
    return test, rf.fit(rf.models.OneMode(), test, known=FLUID, causes=None)


def test_one_step_is_a_fit_without_the_run() -> None:
    """White noise of given sigma: every fit weighs alike; curvature is of second order in changes of a few errors."""
    test, fit = fitted(World(constant=0.005, sigma_given=True), 1)
    found = fit.jackknife()
    for run, change in zip(found.runs, found.changes, strict=True):
        without = rf.fit(rf.models.OneMode(), test.select(test.run != run), known=FLUID, causes=None)
        np.testing.assert_allclose((without.x - fit.x - change) / np.sqrt(np.diag(fit.covar)), 0, atol=0.1)


def test_intervals_hold_the_truth_where_runs_differ() -> None:
    """With N draws and a true coverage of 90 %, fewer than the 0.1 % point of the binomial is no chance.

    Errors from the noise within runs alone hold D in 12 % of such tests.
    """
    draws, held = 25, np.zeros(3)
    for seed in range(draws):
        found = fitted(OIL, seed)[1].jackknife()
        truth = [OIL.truth["D"], OIL.truth["lam"], threshold(OIL.truth)]
        pairs = [q.interval() for q in (found.parameter("D"), found.parameter("lam"), found.threshold_speed())]
        held += [low <= value <= high for (low, high), value in zip(pairs, truth, strict=True)]
    assert np.all(held >= stats.binom.ppf(0.001, draws, 0.90)), held


def test_what_one_run_alone_determines_has_no_error() -> None:
    """One run at the higher speed, with a damping of its own: without this run nothing tells it."""
    test, _ = fitted(World(constant=0.005, sigma_given=True), 2)
    fast = test.speed == test.speed.max()
    kept = test.select(~fast | (test.frequency > 0))
    fit = rf.fit(rf.models.OneMode(), kept, known=FLUID, per={"D": "speed_rpm"}, causes=None)
    slow, alone = sorted((n for n in fit.params if n.startswith("D[")), key=lambda n: float(n[:-1].split("=")[1]))
    found = fit.jackknife()
    assert np.isinf(found.parameter(alone).stderr)
    assert np.isfinite(found.parameter(slow).stderr)
    assert str(found).count("rests on one run") == 1


def test_the_summary_shows_it_beside_the_random_effect() -> None:
    _, fit = fitted(OIL, 1)
    error = fit.jackknife().parameter("D").stderr
    assert "leaving out runs one by one" in summary_words(fit)
    assert f"D {error:.2g}" in summary_words(fit)


def test_two_runs_are_refused() -> None:
    _, fit = fitted(WORLDS["force 1 %, two runs"], 1)
    assert fit.noise.run_count == 2
    with refuses(ValueError):
        fit.jackknife()
