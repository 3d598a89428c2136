"""Parametric bootstrap: against Laplace where the noise is small, one by one fits, and by coverage."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from batch_checks import check
from honest_errors import WORLDS, simulate
from law_data import CLEARANCE_UM, ONE_MODE, impulse, off_centre, squeeze, static, sweep
from scipy import stats
from seal_campaigns import KNOWN, seal_campaign
from sentences import refuses
from synthetic import TYPICAL, circular_test

import rotorfit as rf
from rotorfit.estimators.minimisation.batch import with_measured
from rotorfit.identify.fitting.fit import solve_again
from rotorfit.identify.fitting.problem_setup import build_problem
from rotorfit.identify.fitting.settings import FitSettings
from rotorfit.identify.uncertainty.bootstrap import _simulate
from rotorfit.models import Muszynska, OneMode, WhirlWhip

RIG = TYPICAL["one-mode"]
W = np.r_[-np.linspace(20, 250, 16)[::-1], np.linspace(20, 250, 16)]


def one_mode_fit(noise, known, seed=0, **options):
    model = OneMode()
    test = circular_test(
        model, model.vector(RIG), speeds=(100.0,), frequency=W, noise=noise, seed=seed, sigma_known=True
    )
    return rf.fit(model, test, known={name: RIG[name] for name in known}, causes=None, **options)


def assert_covariance_agrees(boot, covar, alpha=1e-3):
    """Wishart: n times the sample variance over the variance is chi-squared, in every whitened direction."""
    n = len(boot.samples) - 1
    white = (boot.samples - boot.samples.mean(axis=0)) @ np.linalg.inv(np.linalg.cholesky(covar)).T
    ratio = np.cov(white, rowvar=False)
    p = len(covar)
    low, high = stats.chi2.ppf([alpha / p / 2, 1 - alpha / p / 2], n) / n
    assert (np.diag(ratio) > low).all()
    assert (np.diag(ratio) < high).all()
    off = np.abs(ratio[np.triu_indices(p, 1)])
    assert off.max() < stats.norm.ppf(1 - alpha / off.size / 2) / np.sqrt(n)


def test_small_noise_gives_the_laplace_covariance():
    fit = rf.fit(WhirlWhip(), rf.datasets.rig_open(), known={"K3": 6000.0}, causes=None)
    boot = fit.bootstrap(n=1000, seed=3)
    assert boot.failures == 0
    assert fit.widening > 9  # the model limits this fit: noise and covariance are widened alike
    assert_covariance_agrees(boot, fit.covar)
    onset, laplace = boot.threshold_speed(), fit.threshold_speed()
    low, high = stats.chi2.ppf([5e-4, 1 - 5e-4], 999) / 999
    assert low < (onset.stderr / laplace.stderr) ** 2 < high
    assert boot.interval("lam")[0] < fit.params["lam"].value < boot.interval("lam")[1]
    assert boot.stderr["lam"] == pytest.approx(boot.parameter("lam").stderr)
    np.testing.assert_allclose(np.sqrt(np.diag(boot.covar)), list(boot.stderr.values()))
    assert "lam" in boot.summary()
    assert "0 fits failed" in str(boot)


def test_every_sample_is_the_fit_of_its_data():
    fit = one_mode_fit(0.1, ("K", "Ds"))
    boot = fit.bootstrap(n=5, seed=9)
    measured = _simulate(fit, np.tile(fit.x, (5, 1)), np.random.default_rng(9))
    for data, x in zip(measured, boot.samples, strict=True):
        alone = solve_again(fit, with_measured(fit.problem, data))
        np.testing.assert_allclose(x, alone.x, rtol=1e-6)
    # Loops of NumPy round differently where arrays lie differently in memory: 1e-16, times the condition of the fit.
    np.testing.assert_allclose(boot.samples, fit.bootstrap(n=5, seed=9).samples, rtol=1e-13)


def test_data_that_meet_a_bound_are_fitted_too():
    """Leaving out those whose optimum lies on the bound would bias what is left."""
    fit = one_mode_fit(0.1, ("K", "Ds", "M"), bounds={"lam": (0.1, 0.45)})
    assert fit.params["lam"].at_bound
    boot = fit.bootstrap(n=40, seed=1)
    assert boot.failures == 0
    measured = _simulate(fit, np.tile(fit.x, (40, 1)), np.random.default_rng(1))
    lam = boot.parameter("lam").samples
    assert 10 < np.sum(lam > 0.45 - 1e-6) < 40
    for number in np.flatnonzero(lam > 0.45 - 1e-6)[:3]:
        alone = solve_again(fit, with_measured(fit.problem, measured[number]))
        np.testing.assert_allclose(boot.samples[number], alone.x, rtol=1e-5)


def test_coverage():
    """95 % intervals of 100 noisy data sets cover 95 %, within binomial error."""
    base = one_mode_fit(0.1, ("K", "Ds", "M", "Mf"))
    truth = np.array([RIG[name] for name in base.var_names])
    block = base.problem.blocks[0]
    exact = base.problem.predict(truth)[0]
    rng = np.random.default_rng(5)
    hits, draws = dict.fromkeys(("D", "lam", "K0"), 0), 100
    for draw in range(draws):
        error = rng.normal(size=exact.size) + 1j * rng.normal(size=exact.size)
        fit = solve_again(base, with_measured(base.problem, exact + block.sigma * error))
        boot = fit.bootstrap(n=200, seed=draw)
        for name in hits:
            low, high = boot.interval(name)
            hits[name] += low <= RIG[name] <= high
    for name, count in hits.items():
        assert stats.binomtest(count, draws, 0.95).pvalue > 0.01 / 3, (name, count)


def test_a_skewed_estimate_has_a_skewed_interval():
    fit = one_mode_fit(0.3, ("K", "Ds", "M", "Mf", "K0"), seed=2)
    boot = fit.bootstrap(n=1000)
    low, high = boot.interval("D", 0.9)
    assert (high - fit.params["D"].value) > 1.1 * (fit.params["D"].value - low)


def test_what_the_data_do_not_determine_has_no_interval():
    model = WhirlWhip()
    test = circular_test(
        model,
        model.vector(TYPICAL["whirl-whip"]),
        speeds=(100.0, 200.0),
        frequency=np.r_[-np.linspace(20, 400, 30)[::-1], np.linspace(20, 400, 30)],
        noise=0.01,
        seed=2,
        force_planes=("journal",),
        sigma_known=True,
    )
    fit = rf.fit(model, test, known={"K3": 6000.0}, causes=None)
    boot = fit.bootstrap(n=20)
    assert boot.failures == 0  # minimal along a line is minimal
    assert boot.stderr["sigma"] == np.inf
    assert boot.interval("sigma") == (-np.inf, np.inf)
    with refuses(ValueError):
        boot.parameter("sigma")
    assert "not determined" in boot.summary()
    assert boot.stderr["D"] == pytest.approx(fit.params["D"].stderr, rel=0.6)


def test_tests_of_every_kind_are_simulated_together():
    """Amplitude sweeps, static loads, impulses, small off-centre motion and imposed orbits of a law of eccentricity."""
    parts = [sweep(ONE_MODE, levels=(0.7, 4.0, 6.0), lines=20), *(f(ONE_MODE) for f in (static, impulse, off_centre))]
    model = OneMode(law=Muszynska(), clearance_um=CLEARANCE_UM)
    fit = rf.fit(model, [*parts, squeeze(ONE_MODE)], known={"Ds": 8.0})
    n = 60
    boot = fit.bootstrap(n=n, seed=1)
    assert boot.failures == 0
    low, high = stats.chi2.ppf([0.0005 / 9, 1 - 0.0005 / 9], n - 1) / (n - 1)
    for name, spread in boot.stderr.items():
        assert low < (spread / fit.params[name].stderr) ** 2 < high, name


def test_what_cannot_be_bootstrapped_is_refused():
    fit = one_mode_fit(0.01, ("K", "Ds"))
    with refuses(ValueError):
        fit.bootstrap(n=1)
    with refuses(KeyError):
        fit.bootstrap(n=4).interval("lamda")
    with refuses(ValueError):
        rf.closed_form(fit.model, fit.experiments, known=fit.settings.known).bootstrap()


def test_a_fit_whose_runs_differ_is_bootstrapped_without_their_entries():
    """Forces that are off by one per cent from run to run are entries of the fit, but no parameters."""
    test = simulate(WORLDS["force 1 % from run to run"], np.random.default_rng(1))
    fit = rf.fit(OneMode(), test, known={"K": 8000.0, "Ds": 8.0})
    assert any(name.startswith("run_") for name in fit.var_names)
    found = fit.bootstrap(n=20, seed=1)
    assert set(found.stderr) == {name for name, p in fit.params.items() if p.vary}
    assert "run_" not in found.summary()
    with refuses(KeyError):
        found.parameter(next(name for name in fit.var_names if name.startswith("run_force")))


def test_a_bootstrap_of_which_no_fit_converges_says_so():
    fit = one_mode_fit(0.01, ("K", "Ds"))
    found = replace(fit.bootstrap(n=4, seed=1), samples=np.zeros((0, fit.x.size)), failures=4)
    assert all(np.isinf(list(found.stderr.values())))
    assert np.isnan(found.covar).all()
    assert found.interval("D") == (-np.inf, np.inf)
    assert "inf" in found.summary()


def test_simulated_tests_are_fitted_elsewhere_as_here():
    fit = rf.fit(OneMode(), seal_campaign(1)[0], known=KNOWN)
    with ThreadPoolExecutor(2) as pool:
        there = fit.bootstrap(n=80, seed=1, executor=pool)
    here = fit.bootstrap(n=80, seed=1)
    np.testing.assert_allclose(there.samples, here.samples, rtol=1e-6)


LINES, MEMBERS = 20, 6


@pytest.mark.parametrize("accelerate", [False, True])
def test_values_per_speed_and_phase_offsets(accelerate):
    from rigs import RIGS

    rig = RIGS["one-mode"]
    test = rig.test(LINES, 0.02, np.random.default_rng(3))
    known = {name: rig.truth[name] for name in rig.known}
    problem = build_problem(rig.model, test, FitSettings(known=known, per={"D": "speed_rpm"}, phase_offsets=True))
    space = problem.space
    x = np.concatenate([[rig.truth[base] for base in space.base], np.full(len(space.nuisance), 0.05)])
    check(problem, x * (1 + 0.02 * np.random.default_rng(2).normal(size=(MEMBERS, x.size))), accelerate)
