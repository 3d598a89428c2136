"""Posteriors averaged over structures: weights, mixing, and truths that the single best model misses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fe_rigs import K3, random_rig
from plain import plain_fit
from scipy import stats
from sentences import refuses

import rotorfit as rf
from rotorfit.identify.uncertainty.model_average import NEGLIGIBLE_WEIGHT
from rotorfit.models import WhirlWhip

OPTIONS = {"seed": 1, "walkers": 64, "ess": 2000}


@pytest.fixture(scope="module")
def close_call():
    """A stiff, noisy rotor of the family whose gyroscopic block BIC just fails to ask for."""
    rng = np.random.default_rng(11)
    for _ in range(16):
        truth, rig, speeds, threshold = random_rig(rng)
    fit = plain_fit(WhirlWhip(), rig.campaign(speeds, 15), known={"K3": K3})
    return truth, threshold, rf.refine(fit).steps


@pytest.fixture(scope="module")
def average(close_call):
    return rf.sample_models(close_call[2], **OPTIONS)


@pytest.mark.slow
def test_averaging_admits_what_one_model_excludes(close_call, average):
    truth, threshold, steps = close_call
    assert 0 < steps[2].bic - steps[1].bic < 6  # a near tie
    single = average.posteriors[0]
    low, high = single.threshold_speed().interval(0.99)
    assert not low < threshold < high
    low, high = average.threshold_speed().interval(0.99)
    assert low < threshold < high
    low, high = average.interval("Mf", 0.99)
    assert low < truth["Mf"] < high


@pytest.mark.slow
def test_weights_are_those_of_bic(close_call, average):
    _, _, steps = close_call
    ranked = sorted(steps, key=lambda step: step.bic)
    weight = np.exp(-(np.array([step.bic for step in ranked]) - ranked[0].bic) / 2)
    counted = weight / weight.sum() >= NEGLIGIBLE_WEIGHT  # the printed model, thousands behind, is not sampled
    assert 2 <= counted.sum() < len(steps)
    np.testing.assert_allclose(average.weights, weight[counted] / weight[counted].sum(), rtol=1e-6)
    assert [p.fit for p in average.posteriors] == ranked[: counted.sum()]


@pytest.mark.slow
def test_quantities_are_mixtures(average):
    """Distribution function of a mixture: the weighted sum of the models' own."""
    for quantity in (
        lambda p: p.parameter("lam"),
        lambda p: p.threshold_speed(),
        lambda p: p.whirl_ratio(),
        lambda p: p.lam_speed(100.0),
    ):
        mixed, parts = quantity(average), [quantity(p) for p in average.posteriors]
        for at in mixed.interval(0.5):
            share = sum(w * np.mean(d.samples <= at) for w, d in zip(average.weights, parts, strict=True))
            assert np.mean(mixed.samples <= at) == pytest.approx(share, abs=0.02)
    assert average.lam_speed(100.0).interval() == pytest.approx([100 * v for v in average.interval("lam")], rel=1e-3)
    bands = average.dynamic_stiffness([50.0, 100.0], 100.0)
    inner = [p.dynamic_stiffness([50.0, 100.0], 100.0).direct.value for p in average.posteriors]
    assert (bands.direct.value >= np.min(inner, axis=0)).all()
    assert (bands.direct.value <= np.max(inner, axis=0)).all()
    assert "g11" not in average.names
    with refuses(KeyError):
        average.parameter("g11")


def test_equal_models_average_to_themselves(close_call):
    step = replace(close_call[2][1], bic=100.0)
    both = rf.sample_models([step, replace(step, bic=100.0)], **OPTIONS)
    assert both.weights == pytest.approx((0.5, 0.5))
    single = both.posteriors[0].parameter("D").samples
    assert stats.ks_2samp(both.parameter("D").samples[::7], single[::7]).pvalue > 0.5


def test_summary_names_models_and_their_health(close_call, average):
    text = str(average)
    assert average.converged
    for word in ("+ coupling mass + gyroscopic", "weight", *average.names):
        assert word in text
    short = rf.sample_models([close_call[2][1]], seed=1, max_steps=40)
    assert not short.converged
    assert "NOT CONVERGED" in short.summary()


def test_what_cannot_be_averaged_is_refused(close_call):
    steps = close_call[2]
    with refuses(ValueError):
        rf.sample_models([])
    with refuses(ValueError):
        rf.sample_models(steps, refine=True)
    other = plain_fit(WhirlWhip(), rf.datasets.rig_open(), known={"K3": K3})
    with refuses(ValueError):
        rf.sample_models([steps[0], other])
    robust = plain_fit(WhirlWhip(), steps[0].experiments, known={"K3": K3}, loss="huber")
    with refuses(ValueError):
        rf.sample_models([steps[0], robust])


def test_reports_are_of_one_model(average, tmp_path):
    best = average.posteriors[0]
    with refuses(TypeError):
        rf.write_report(best.fit, tmp_path / "report.html", posterior=average)
