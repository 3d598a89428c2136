"""Tests at one speed: what they cannot tell must not move what they can."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from fe_rigs import K3, TYPICAL, Rig
from plain import plain_fit

import rotorfit as rf
from rotorfit.identify.fitting.structure.refine import _notices
from rotorfit.models import WhirlWhip

SPEEDS = np.array([100.0])
SEEDS = range(3)


@pytest.fixture(scope="module")
def refinements():
    found = []
    for seed in SEEDS:
        rig = Rig(**TYPICAL | {"noise": 0.005, "K0": 1e4 * (0.5 + 0.5 * seed), "D": 300.0 + 100 * seed})
        plain = plain_fit(WhirlWhip(), rig.campaign(SPEEDS, seed, lines=50), known={"K3": K3})
        found.append((rig, rf.refine(plain)))
    return found


@pytest.mark.slow
def test_lam_and_threshold_hold_where_gyroscopic_effects_look_like_the_fluids_inertia(refinements):
    """At one speed w Om g22 is 2 Mf lam w Om; without a gyroscopic block others took its place, lam off by 3 s.e."""
    pulls = []
    for rig, refinement in refinements:
        lam, onset = refinement.best.params["lam"], refinement.best.threshold_speed()
        assert "gyroscopic" in refinement.best.model.blocks
        pulls.append([(lam.value - TYPICAL["lam"]) / lam.stderr, (onset.value - rig.threshold()) / onset.stderr])
    # sum of squares of three normal numbers: 16.3 is exceeded once in a thousand
    assert (np.sum(np.square(pulls), axis=0) < 16.3).all(), pulls


def test_what_was_taken_to_be_zero_is_said_and_in_the_errors(refinements):
    for _, refinement in refinements:
        best = refinement.best
        prior = best.settings.priors["g22"]
        assert best.params["g22"].stderr == pytest.approx(prior.std(), rel=0.1)
        assert any("cannot separate g22" in words for words in best.warnings)
        onset = next(e for e in best.settings.onsets)
        # the onset lies above the tested speed, where w Om g22 is larger than it was in the tests
        assert best.threshold_speed().stderr > onset.difference


@pytest.mark.parametrize(("speeds", "said"), [((100.0,), True), ((100.0, 180.0), False)])
def test_one_speed_is_blamed_where_there_is_one(speeds: tuple[float, ...], said: bool) -> None:
    prior = SimpleNamespace(std=lambda: 1e-3)
    plain = SimpleNamespace(settings=SimpleNamespace(priors={}), noise=None)
    chosen = SimpleNamespace(settings=SimpleNamespace(priors={"g22": prior}), speeds=np.array(speeds), noise=None)
    (words,) = (one.message for one in _notices(plain, chosen))  # type: ignore[arg-type]
    assert ("as those at one speed" in words) == said
    assert ("tests at another speed would" in words) == said
