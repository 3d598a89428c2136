"""A threshold that the tested band cannot show is never called absent."""

from __future__ import annotations

import numpy as np
import pytest
from fe_rigs import K3, TYPICAL, Rig
from plain import plain_fit, summary_words

import rotorfit as rf
from rotorfit.base.digits import interval
from rotorfit.models import WhirlWhip
from rotorfit.models.structure import BLOCKS

RPM = np.pi / 30
SPEEDS = RPM * np.array([900.0, 1800.0])


@pytest.fixture(scope="module")
def short():
    """A campaign whose band ends a tenth below the whirl at onset (some 127 rad/s)."""
    rig = Rig(**TYPICAL)
    return rig, rig.campaign(SPEEDS, 4, top=114.0)


@pytest.fixture(scope="module")
def refinement(short):
    return rf.refine(plain_fit(WhirlWhip(), short[1], known={"K3": K3}))


def test_a_band_that_ends_below_the_onset_does_not_say_stable(short):
    """With the w^4 block only roots in the tested band count: none unstable there says nothing of the rotor."""
    fit = plain_fit(WhirlWhip(blocks=BLOCKS), short[1], known={"K3": K3})
    onset = fit.threshold_speed()
    assert np.isnan(onset.value)
    assert np.isinf(onset.stderr)
    assert "stable at every" not in summary_words(fit)
    assert "outside the tested band of frequencies, which was not searched" in summary_words(fit)


def test_a_refinement_lends_its_threshold_to_the_candidate_that_cannot_tell(short, refinement):
    """The candidates of second order hold beyond the band; how far they differ is part of the error."""
    rig, _ = short
    assert len(refinement.steps) >= 1 + len(BLOCKS)
    high = next(s for s in refinement.steps if s.model.order > 2 and not s.identifiability.unresolved)
    top = rf.refine(high).best  # no candidate of second order: nothing to lend
    assert np.isinf(top.threshold_speed().stderr)
    onset = refinement.best.threshold_speed()
    assert onset.stderr >= refinement.best.settings.onsets[0].difference
    assert abs(onset.value - rig.threshold()) < 3 * onset.stderr
    assert "above the tested frequencies" in summary_words(refinement.best)


def test_a_plain_fit_says_that_its_onset_is_extrapolated_in_frequency(short):
    fit = plain_fit(WhirlWhip(), short[1], known={"K3": K3})
    assert "refine (--refine) would show" in summary_words(fit)


def test_an_onset_far_above_the_tested_speeds_has_the_difference_between_candidates_as_an_error():
    """Tested to 500 rpm, unstable near 2650: what grows with speed was hardly seen."""
    rig = Rig(**TYPICAL)
    refinement = rf.refine(plain_fit(WhirlWhip(), rig.campaign(RPM * np.array([300.0, 500.0]), 4), known={"K3": K3}))
    onset = refinement.best.threshold_speed()
    assert onset.stderr >= refinement.best.settings.onsets[0].difference
    assert abs(onset.value - rig.threshold()) < 2.5 * onset.stderr
    assert "times above the highest tested speed" in summary_words(refinement.best)


def test_the_difference_of_candidates_is_counted_once_in_an_extrapolated_threshold():
    """The covariance holds the uncertainty of the choice among candidates already: the larger of the two, not both."""
    rig = Rig(**TYPICAL)
    best = rf.refine(plain_fit(WhirlWhip(), rig.campaign(RPM * np.array([300.0, 500.0]), 4), known={"K3": K3})).best
    space, beyond = best.problem.space, best.settings.onsets[0].difference
    by_theta = np.asarray(best.onset(0).gradient)
    slope = np.array([by_theta[best.model.parameter_names.index(name)] for name in space.names])
    choice, whole = (
        float(slope @ matrix[: slope.size, : slope.size] @ slope) for matrix in (best.model_uncertainty, best.covar)
    )
    assert choice > 1e-3 * beyond**2  # so that counting it twice shows
    assert best.threshold_speed().stderr == pytest.approx(np.sqrt(whole - choice + max(choice, beyond**2)), rel=1e-6)


def test_draws_of_a_threshold_follow_the_rules_of_the_fit(short, refinement):
    """Not stable where the band was not searched, and as uncertain as the candidates differ."""
    top = plain_fit(WhirlWhip(blocks=BLOCKS), short[1], known={"K3": K3})
    onset = top.bootstrap(n=4).threshold_speed()
    assert np.isnan(onset.samples).all()
    assert "outside the tested band" in onset.note
    assert interval(*onset.interval()) == "not determined"

    best = refinement.best
    onset, delta = best.bootstrap(n=60).threshold_speed(), best.threshold_speed()
    # The standard deviation of 60 normal draws is within 3 / sqrt(120) of the spread; draws found in the band at its
    # very edge scatter by the candidates' difference alone.
    assert onset.stderr > (1 - 3 / np.sqrt(120)) * best.settings.onsets[0].difference
    assert abs(onset.value - short[0].threshold()) < 3 * delta.stderr
    assert "difference between the candidate models" in str(onset)
