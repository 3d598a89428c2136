"""Noise estimates from data alone: unbiased within their own scatter, and blind to what is not noise."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from plain import plain_fit
from scipy.stats import bartlett
from synthetic import TYPICAL, circular_test, covering_frequencies

import rotorfit as rf
from rotorfit.estimators.noise.sweep_noise import (
    NOISE_FLOOR,
    _agree,
    deviations_of_repeats,
    noise_from_samples,
    noise_from_smoothness,
)
from rotorfit.identify.fitting.problem_setup import group_rows
from rotorfit.lab.observing.circular import observe
from rotorfit.models import OneMode


def complex_normal(rng, *shape):
    return rng.normal(size=shape) + 1j * rng.normal(size=shape)


def resonance(count):
    w = np.linspace(1, 100, count)
    return w, 2500 / (50**2 - w**2 + 2j * 0.05 * 50 * w)


@pytest.mark.parametrize("count", [40, 100, 200])
@pytest.mark.parametrize("level", [1e-3, 1e-2, 1e-1])
def test_smoothness_finds_the_noise_under_a_resonance(count, level):
    rng = np.random.default_rng(0)
    w, y = resonance(count)
    ratio = [noise_from_smoothness(w, y + level * complex_normal(rng, count)) / level for _ in range(60)]
    # Mean of 60 estimates; the local fits take up a few per cent of the noise.
    assert np.mean(ratio) == pytest.approx(1.0, abs=0.06)


def test_exact_data_get_the_floor():
    _, y = resonance(60)
    rms = np.sqrt(np.mean(np.abs(y) ** 2))
    np.testing.assert_allclose(noise_from_samples(np.zeros(60, complex), y), NOISE_FLOOR * rms)


def test_shape_of_the_noise_is_recognised():
    rng = np.random.default_rng(1)
    _, y = resonance(200)
    constant = noise_from_samples(0.01 * complex_normal(rng, 200), y)
    assert np.ptp(constant) == 0
    assert constant[0] == pytest.approx(0.01, rel=0.2)  # 400 degrees of freedom: 3.5 % each sd
    proportional = noise_from_samples(0.01 * np.abs(y) * complex_normal(rng, 200), y)
    np.testing.assert_allclose(proportional, 0.01 * np.abs(y), rtol=0.2)


def test_outliers_do_not_inflate_the_noise():
    rng = np.random.default_rng(2)
    _, y = resonance(200)
    noise = 0.01 * complex_normal(rng, 200)
    noise[::40] *= 100
    assert noise_from_samples(noise, y)[0] == pytest.approx(0.01, rel=0.25)


def test_repeats_are_unbiased():
    rng = np.random.default_rng(3)
    deviations = [deviations_of_repeats(5 + 0.2 * complex_normal(rng, 3, 50)) for _ in range(50)]
    estimates = [np.sqrt(np.mean(np.abs(part) ** 2) / 2) for part in deviations]
    # 200 degrees of freedom each: mean of 50 has a relative sd of 0.7 %.
    assert np.mean(estimates) == pytest.approx(0.2, rel=0.03)


def observed(test, model):
    return observe(model, test, group_rows([test], {})[1][0])


def test_source_of_the_noise():
    """Repeated sweeps come before the wrong direction; given sigma before all; anisotropy is not taken for noise."""
    model = OneMode()
    theta = model.vector(TYPICAL["one-mode"])
    w = covering_frequencies(model, theta, (100.0,), 100)
    first = circular_test(model, theta, speeds=(100.0,), frequency=w, noise=0.01, seed=1)
    told = circular_test(model, theta, speeds=(100.0,), frequency=w, noise=0.01, seed=1, sigma_known=True)
    level = observed(told, model).sigma[0]
    found = observed(first, model).sigma
    assert found[0] == pytest.approx(level, rel=0.25)
    # A smooth component in the wrong direction is the rig's anisotropy: ten times the noise here.
    from dataclasses import replace

    leak = np.where(first.direction == "x", 1.2, 0.8)
    skewed = observed(replace(first, response=first.response * leak), model).sigma
    assert skewed[0] == pytest.approx(level, rel=0.4)


def test_repeated_readings_of_one_run_stand_on_lines_of_their_own():
    model = OneMode()
    theta = model.vector(TYPICAL["one-mode"])
    w = covering_frequencies(model, theta, (100.0,), 40)
    test = circular_test(model, theta, speeds=(100.0,), frequency=w, noise=0.01, sigma_known=True)
    twice = test.select(np.r_[np.arange(len(test)), np.arange(len(test))])
    block = observed(twice, model)
    assert block.speed.size == 2 * observed(test, model).speed.size


def test_variances_of_two_sweeps_are_compared_as_scipy_does():
    """Bartlett's test on samples with these variances, SciPy's counting one degree of freedom less than readings."""
    rng = np.random.default_rng(4)
    for size, factor in ((9, 1.0), (9, 3.0), (41, 1.4), (200, 1.15), (200, 1.3)):
        one, other = rng.standard_normal(size), factor * rng.standard_normal(size)
        powers = [float(np.var(sample, ddof=1)) for sample in (one, other)]
        assert _agree(powers, [size - 1, size - 1]) == (bartlett(one, other).pvalue > 0.01)


def test_sweeps_of_the_same_variance_but_for_round_off_share_it():
    for power in np.random.default_rng(0).uniform(1e-12, 1, 500).tolist():
        assert _agree([power, np.nextafter(power, 1)], [200, 200])


def test_a_stepped_sine_that_starts_anew_at_each_line_says_the_same():
    """Its phase is any at each line: readings and residuals follow one another only relative to the force."""
    rig = rf.datasets.rig_open()
    rig = dataclasses.replace(rig, sigma=np.full(len(rig), np.nan))  # a chain of two masses misses its shaft
    lines, line = np.unique(rig.frequency, return_inverse=True)
    turn = np.exp(2j * np.pi * np.random.default_rng(0).random(lines.size))[line]
    anew = dataclasses.replace(rig, force=rig.force * turn, response=rig.response * turn)
    as_one, apart = (plain_fit(rf.models.WhirlWhip(), test, known={"K3": 6000.0}) for test in (rig, anew))
    assert as_one.noise is not None
    assert apart.noise is not None
    assert apart.noise.verdict == as_one.noise.verdict == "misfit"
    assert apart.redchi == pytest.approx(as_one.redchi, rel=1e-9)
    for name, value in as_one.params.items():
        assert apart.params[name].value == pytest.approx(value.value, rel=1e-6, abs=1e-9)
        assert apart.params[name].stderr == pytest.approx(value.stderr, rel=1e-6, abs=1e-9)


@pytest.mark.parametrize(("lines", "said"), [(12, True), (120, False)])
def test_lines_too_few_to_show_their_noise_are_said(lines: int, said: bool) -> None:
    """Between six lines the response itself looks like noise, a hundred times as large; errors follow the residuals."""
    model = OneMode()
    theta = model.vector(TYPICAL["one-mode"])
    w = covering_frequencies(model, theta, (100.0, 180.0), lines)
    test = circular_test(model, theta, speeds=(100.0, 180.0), frequency=w, noise=0.001, seed=3)
    one_probe = test.select(test.direction == "x")  # of two, the wrong direction shows the noise
    fit = rf.fit(model, one_probe, known={"K": TYPICAL["one-mode"]["K"], "Ds": TYPICAL["one-mode"]["Ds"]})
    assert any("the lines are too few to tell noise" in words for words in fit.warnings) is said
    assert abs(fit.params["D"].value - TYPICAL["one-mode"]["D"]) < 4 * fit.params["D"].stderr
