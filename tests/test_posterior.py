"""Posteriors: against exact ones, honest about convergence, complete in what follows from them, safe on disk."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from dataclasses import fields, replace
from pathlib import Path

import emcee
import numpy as np
import pytest
from scipy import integrate, stats
from synthetic import TYPICAL, circular_test, covering_frequencies

import rotorfit as rf
from rotorfit.data.experiments import DisplacementTest
from rotorfit.estimators.inference.ensemble_sampler import sample as run_emcee
from rotorfit.estimators.inference.log_posterior import LogPosterior
from rotorfit.estimators.inference.proposals import IndependenceMove
from rotorfit.models import OneMode, WhirlWhip, threshold_speed
from rotorfit.models.stability import threshold_speeds
from rotorfit.uncertainty.arviz_loader import load_arviz
from rotorfit.uncertainty.derived import Derived

TRUTH = TYPICAL["one-mode"]
KNOWN = {name: TRUTH[name] for name in ("K", "Ds")}
SIGNIFICANT = 1e-4
"""p value below which a comparison of draws with an exact distribution fails; seeds are fixed."""


def one_mode_test(noise=0.02, lines=40, seed=0, speeds=(100.0, 180.0), **options):
    model = OneMode()
    theta = model.vector(TRUTH)
    frequency = covering_frequencies(model, theta, speeds, lines)
    return circular_test(model, theta, speeds=speeds, frequency=frequency, noise=noise, seed=seed, **options)


def quick(fit, **options):
    """A posterior of fewer effective samples than users get."""
    return fit.sample(**{"seed": 1, "walkers": 32, "ess": 1000, **options})


def imposed_orbit(lines=6, noise=0.02):
    """Force under an imposed orbit: linear in K0, D, Mf, M once lam is known. Its design matrix, and the test."""
    w = np.linspace(20.0, 250.0, lines)
    speed, orbit, lam = 120.0, 20e-6, TRUTH["lam"]
    slip = w - lam * speed
    design = orbit * np.column_stack([-(w**2), np.ones(lines), 1j * slip, -(slip**2)])  # by M, K0, D, Mf
    exact = design @ [TRUTH[name] for name in ("M", "K0", "D", "Mf")] + orbit * (TRUTH["K"] + 1j * w * TRUTH["Ds"])
    sigma = noise * float(np.sqrt(np.mean(np.abs(exact) ** 2)))
    rng = np.random.default_rng(4)
    force = exact + sigma * (rng.normal(size=lines) + 1j * rng.normal(size=lines))
    test = DisplacementTest(
        run=np.full(lines, "sweep"), speed=np.full(lines, speed), frequency=w, plane=np.full(lines, "journal"),
        displacement=np.full(lines, orbit + 0j), force_x=force, force_y=-1j * force,
        sigma=np.full(lines, sigma * np.sqrt(2)),  # of each probe; x and y together leave sigma
    )  # fmt: skip
    return design, test


def whitened_design(fit, design):
    """Real design matrix over the noise that the fit works with, columns in the order of the fit."""
    (block,) = fit.problem.blocks
    columns = [("M", "K0", "D", "Mf").index(name) for name in fit.var_names]
    rows = (design / block.sigma[:, None])[:, columns]
    return np.concatenate([rows.real, rows.imag])


@pytest.fixture(scope="module")
def linear():
    design, test = imposed_orbit()
    known = {**KNOWN, "lam": TRUTH["lam"]}
    fit = rf.fit(OneMode(), test, known=known)
    assert set(fit.var_names) == {"M", "K0", "D", "Mf"}
    return fit, whitened_design(fit, design), test, known


def independent(post):
    """Every autocorrelation time's last draw of each walker, so that plain tests apply, shape (N, p)."""
    return post.chain[:: int(np.ceil(2 * post.tau.max()))].reshape(-1, len(post.names))


def mahalanobis(draws, mean, precision):
    return np.einsum("ni,ij,nj->n", draws - mean, precision, draws - mean)


# ---- exact posteriors -----------------------------------------------------------------------------------------------


def test_fixed_noise_gives_the_exact_normal(linear):
    fit, X, _, _ = linear
    post = quick(fit, noise="fixed")
    draws, precision = independent(post), X.T @ X
    distance = mahalanobis(draws, fit.x, precision)
    assert stats.kstest(distance, stats.chi2(4).cdf).pvalue > SIGNIFICANT
    white = (draws - fit.x) @ np.linalg.cholesky(precision)
    for i in range(4):
        assert stats.kstest(white[:, i], "norm").pvalue > SIGNIFICANT
    assert post.converged
    assert post.treatment == "noise as given with the data"


@pytest.mark.parametrize("noise", ["marginal", "sampled"])
def test_unknown_noise_gives_the_exact_student_t(linear, noise):
    """With n data and one datum's worth of belief in the noise given: t with n + 1 - p degrees of freedom."""
    fit, X, _, _ = linear
    post = quick(fit, noise=noise, ess=4000)
    n, p = X.shape
    nu = n + 1 - p
    distance = mahalanobis(independent(post)[:, :p], fit.x, X.T @ X * nu / (fit.chisqr + 1)) / p
    assert stats.kstest(distance, stats.f(p, nu).cdf).pvalue > SIGNIFICANT
    assert stats.kstest(distance * p, stats.chi2(p).cdf).pvalue < SIGNIFICANT  # the test can tell them apart
    assert post.names[p:] == (() if noise == "marginal" else ("log_s[sweep / force at journal]",))


def test_normal_prior_adds_its_precision(linear):
    fit, X, test, known = linear
    mean, sd = fit.params["D"].value + 2 * fit.params["D"].stderr_noise, 0.5 * fit.params["D"].stderr_noise
    informed = rf.fit(OneMode(), test, known=known, priors={"D": stats.norm(mean, sd)})
    place = fit.var_names.index("D")
    precision, pull = X.T @ X, X.T @ X @ fit.x
    precision[place, place] += 1 / sd**2
    pull[place] += mean / sd**2
    distance = mahalanobis(independent(quick(informed, noise="fixed")), np.linalg.solve(precision, pull), precision)
    assert stats.kstest(distance, stats.chi2(4).cdf).pvalue > SIGNIFICANT


def test_bounds_cut_the_posterior(linear):
    """A bound through the optimum leaves the free posterior's draws on its side."""
    fit, _, test, known = linear
    cut = fit.params["D"].value
    bounded = rf.fit(OneMode(), test, known=known, bounds={"D": (0.0, cut)})
    free = independent(quick(fit, noise="fixed", seed=2))
    post = quick(bounded, noise="fixed")
    assert post.samples[:, post.names.index("D")].max() <= cut
    kept = free[free[:, fit.var_names.index("D")] <= cut]
    draws = independent(post)
    for i in range(4):
        assert stats.ks_2samp(kept[:, i], draws[:, i]).pvalue > SIGNIFICANT


def test_a_prior_without_density_is_a_bound(linear):
    fit, _, test, known = linear
    low, width = fit.params["D"].value, 3 * fit.params["D"].stderr
    half = rf.fit(OneMode(), test, known=known, priors={"D": stats.uniform(low, width)})
    drawn = quick(half, max_steps=150).parameter("D").samples
    assert drawn.min() >= low
    assert drawn.max() <= low + width


@pytest.mark.parametrize("accelerate", [False, True])
def test_marginal_noise_against_quadrature(accelerate):
    """Channels whose noise is misjudged: the level integrated out numerically, and the posterior of one parameter."""
    test = one_mode_test(sigma_known=True)
    wrong = np.where(test.run == test.runs[0], 3.0, 0.5)
    test = replace(test, sigma=test.sigma * wrong)
    fit = rf.fit(OneMode(), test, known={k: v for k, v in TRUTH.items() if k != "D"})
    target = LogPosterior(fit.problem, "marginal", accelerate=accelerate)
    assert target.batch.compiled is accelerate
    assert len(target.batch.channel_counts) == 4
    spread = fit.params["D"].stderr_noise
    grid = fit.x[0] + spread * np.linspace(-8, 8, 161)

    def log_density(D):
        (block,), x = fit.problem.blocks, np.array([D])
        miss = np.abs((fit.problem.predict(x)[0] - block.measured) / block.sigma) ** 2
        total = 0.0
        for label in range(len(block.labels)):
            S, n = float(miss[block.label == label].sum()), 2 * int((block.label == label).sum())
            mode = -0.5 * n * np.log((S + 1) / n)  # brings the integrand to the size of one
            integrand = lambda s, S=S, n=n, mode=mode: np.exp(  # noqa: E731
                -n * np.log(s) - (S + 1) / (2 * s**2) - 2 * np.log(s) - mode + n / 2
            )  # n data, one believed datum, Jeffreys' 1/s
            centre = np.sqrt((S + 1) / n)
            total += np.log(integrate.quad(integrand, 0.3 * centre, 5 * centre, epsabs=0, epsrel=1e-10)[0]) + mode
        return total

    exact = np.array([log_density(D) for D in grid])
    ours = target(grid[:, None])
    np.testing.assert_allclose(ours - ours.max(), exact - exact.max(), atol=1e-6)
    density = np.exp(exact - exact.max())
    cumulative = integrate.cumulative_simpson(density, x=grid, initial=0.0)
    post = quick(fit, accelerate=accelerate)
    cdf = lambda D: np.interp(D, grid, cumulative / cumulative[-1])  # noqa: E731
    assert stats.kstest(independent(post)[:, 0], cdf).pvalue > SIGNIFICANT


# ---- shapes that are not normal -------------------------------------------------------------------------------------


class Banana:
    """``x ~ N(0, a^2)``, ``y | x ~ N(b (x^2 - a^2), 1)``, and what the optimum sees of it."""

    size, a, b = 2, 2.0, 0.8
    names = ("x", "y")
    centre = np.array([0.0, -b * a**2])
    covariance = np.diag([a**2, 1.0])
    mean_y, variance_y = 0.0, 1.0 + 2.0 * b**2 * a**4

    def __call__(self, v):
        x, y = v.T
        return -0.5 * (x / self.a) ** 2 - 0.5 * (y - self.b * (x**2 - self.a**2)) ** 2


def test_curved_posterior_needs_the_mixture():
    banana = Banana()
    options = {"walkers": 32, "ess": 1000, "seed": 4}
    start = banana.centre, banana.covariance
    mixed = run_emcee(banana, *start, max_steps=20_000, **options)
    assert mixed.converged
    x, y = mixed.draws.reshape(-1, 2).T
    # Standard errors of means and variances from as many independent draws as claimed; y has heavy tails, kurtosis
    # 3 + 48 b^4 a^8 / var^2.
    kurtosis = 3 + 48 * banana.b**4 * banana.a**8 / banana.variance_y**2
    assert abs(x.mean()) < 5 * banana.a / np.sqrt(mixed.ess)
    assert abs(y.mean() - banana.mean_y) < 5 * np.sqrt(banana.variance_y / mixed.ess)
    assert abs(x.var() / banana.a**2 - 1) < 5 * np.sqrt(2 / mixed.ess)
    assert abs(y.var() / banana.variance_y - 1) < 5 * np.sqrt((kurtosis - 1) / mixed.ess)
    # The independence proposal alone, given as many steps, misses the arms, and says that it has not converged.
    alone = run_emcee(banana, *start, max_steps=mixed.steps, moves=[(IndependenceMove(*start), 1.0)], **options)
    assert not alone.converged
    assert alone.draws[..., 1].var() < 0.8 * banana.variance_y


class KilledError(Exception):
    pass


def test_a_run_resumes_with_what_its_proposals_had_learned(tmp_path):
    banana, path = Banana(), tmp_path / "run.h5"
    options = {"walkers": 16, "ess": 1e12, "max_steps": 1700, "seed": 5, "checkpoint": path}

    def stop(state):
        if state.steps > 1000:
            raise KilledError

    with pytest.raises(KilledError):
        run_emcee(banana, banana.centre, banana.covariance, report=stop, **options)
    resumed = run_emcee(banana, banana.centre, banana.covariance, **options)
    straight = run_emcee(banana, banana.centre, banana.covariance, **{**options, "checkpoint": None})
    assert straight.burn_in == 500  # learned there
    np.testing.assert_array_equal(resumed.draws, straight.draws)


class Two:
    """Two narrow peaks, far apart."""

    size = 1
    names = ("x",)

    def __call__(self, v):
        return np.logaddexp(-0.5 * (v[:, 0] - 10) ** 2, -0.5 * (v[:, 0] + 10) ** 2)


def test_walkers_stuck_on_two_peaks_are_not_converged():
    """Each walker by itself looks well mixed."""
    chain = run_emcee(
        Two(), np.zeros(1), np.eye(1) * 100, walkers=64, ess=1000, max_steps=1500, seed=1,
        moves=[(emcee.moves.GaussianMove(1.0), 1.0)],
    )  # fmt: skip
    own = emcee.autocorr.integrated_time(chain.draws, has_walkers=True, tol=0)[0]
    assert len(chain.draws) > 100 * own
    assert not chain.converged
    assert "not resolved" in chain.message


# ---- options of the fit ---------------------------------------------------------------------------------------------


def test_a_run_cut_short_says_so():
    post = quick(rf.fit(OneMode(), one_mode_test(), known=KNOWN), max_steps=60)
    assert not post.converged
    assert "not converged" in post.message
    assert post.summary().startswith("NOT CONVERGED")
    assert post.settings.steps == 60
    assert post.chain.shape[0] + post.burn_in == 60


def test_robust_loss_keeps_outliers_out():
    test = one_mode_test(lines=80, sigma_known=True)
    rng = np.random.default_rng(0)
    hit = rng.random(len(test)) < 0.08
    test = replace(test, response=test.response + hit * 40 * test.sigma * np.exp(2j * np.pi * rng.random(len(test))))
    plain = rf.fit(OneMode(), test, known=KNOWN)
    robust = rf.fit(OneMode(), test, known=KNOWN, loss="soft_l1")
    post = quick(robust)
    assert post.settings.noise == "fixed"
    assert "soft_l1" in post.treatment
    for name in ("K0", "D", "lam"):
        low, high = post.interval(name, 0.99)
        assert low < TRUTH[name] < high
        assert high - low < 0.5 * np.diff(quick(plain).interval(name, 0.99))[0]
    with pytest.raises(ValueError, match="fixed scale: noise must be 'fixed', not 'marginal'"):
        robust.sample(noise="marginal")


def test_a_parameter_for_each_speed():
    fit = rf.fit(OneMode(), one_mode_test(), known=KNOWN, per={"D": "speed_rpm"})
    post = quick(fit)
    names = [name for name in post.names if name.startswith("D[")]
    assert len(names) == 2
    slow = {"speed_rpm": float(names[0].partition("=")[2][:-1])}
    place = OneMode().parameter_names.index("D")
    np.testing.assert_array_equal(
        post.thetas(slow, draws=len(post.samples))[:, place], post.parameter(names[0]).samples
    )
    onset = post.threshold_speed(slow)
    assert abs(onset.value - fit.threshold_speed(slow).value) < fit.threshold_speed(slow).stderr
    with pytest.raises(ValueError, match="say which with at="):
        post.threshold_speed()


def test_phase_offsets_are_sampled():
    test = one_mode_test()
    run = test.runs[1]
    shifted = replace(test, response=test.response * np.where(test.run == run, np.exp(0.08j), 1.0))
    fit = rf.fit(OneMode(), shifted, known=KNOWN, phase_offsets=True)
    post = quick(fit)
    name = f"phase[{run}]"
    low, high = post.interval(name, 0.99)
    assert low < 0.08 < high
    assert post.unit(name) == "rad"
    assert post.parameter(name).stderr == pytest.approx(fit.params[name].stderr, rel=0.25)


def test_what_cannot_be_sampled_is_refused():
    test = one_mode_test()
    with pytest.raises(ValueError, match="this is a closed form"):
        rf.closed_form(OneMode(), test, known=KNOWN).sample()
    fit = rf.fit(OneMode(), test, known=KNOWN)
    with pytest.raises(ValueError, match="noise is 'flat'; allowed: marginal, fixed, sampled"):
        fit.sample(noise="flat")
    with pytest.raises(ValueError, match="5 entries need an even number of at least 10"):
        fit.sample(walkers=8)
    failed = replace(fit, success=False, message="stopped")
    with pytest.raises(ValueError, match=r"did not converge \(stopped\)"):
        failed.sample()
    with pytest.raises(ValueError, match="flat along"):
        rf.fit(OneMode(), test, known={"Ds": TRUTH["Ds"]}).sample()
    # Mixtures of two flat directions may meet bounds although one of them meets none.
    with pytest.raises(ValueError, match="flat along K, K0, without bounds"):
        rf.fit(OneMode(), one_mode_test(speeds=(100.0,))).sample()


def test_a_fit_that_is_not_the_lowest_minimum_is_told_by_the_draws():
    fit = rf.fit(OneMode(), one_mode_test(sigma_known=True), known=KNOWN)
    assert "lowest minimum" not in quick(fit, noise="fixed").treatment
    elsewhere = fit.x + 3 * np.sqrt(np.diag(fit.covar)) * (np.array(fit.var_names) == "lam")
    assert "not end in the lowest minimum" in quick(replace(fit, x=elsewhere), noise="fixed").treatment


def test_inflated_noise_moves_the_optimum_towards_the_priors():
    """Walkers start where the density is largest, which is not the optimum of the fit when its noise is widened."""
    fit = rf.fit(OneMode(), one_mode_test(), known=KNOWN, priors={"D": stats.norm(440.0, 3.0)})
    target = LogPosterior(fit.problem, "fixed", inflation=30.0)
    centre, covariance = target.laplace(fit.x)
    step = 0.1 * np.sqrt(np.diag(covariance)) * np.eye(centre.size)
    assert (target(centre + np.concatenate([step, -step])) < target(centre[None])).all()
    assert target(fit.x[None]) < target(centre[None]) - 0.1


# ---- the finite-element rig -----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def rig_fit():
    return rf.fit(WhirlWhip(), rf.datasets.rig_open(), known={"K3": 6000.0})


@pytest.fixture(scope="module")
def rig(rig_fit):
    return rig_fit.sample(seed=1, refine=True)


def test_refined_intervals_contain_the_truth(rig):
    assert rig.converged
    assert "structure chosen by AIC: + coupling mass" in rig.treatment
    rpm = 30 / np.pi
    low, high = rig.threshold_speed().interval(0.99)
    assert low * rpm < 2656.7 < high * rpm
    assert (high - low) * rpm < 10
    for name, truth in {"D": 450.0, "lam": 0.475, "Mf": 0.35}.items():
        low, high = rig.interval(name, 0.99)
        assert low < truth < high


def test_posterior_agrees_with_the_normal_approximation(rig):
    """1600 lines leave it close to normal: medians within a fifth of a standard error, widths of the noise alone."""
    levels = LogPosterior(rig.fit.problem, "marginal", work=0).laplace(rig.fit.x)
    assert rig.names == rig.fit.var_names
    width = np.sqrt(np.diag(levels[1]))
    np.testing.assert_allclose(np.median(rig.samples, axis=0), levels[0], atol=0.2 * width.max(), rtol=0.01)
    np.testing.assert_allclose(rig.samples.std(axis=0), width, rtol=0.1)


def test_channels_of_the_same_name_keep_levels_of_their_own(tmp_path):
    """Two files that both call their run a sweep."""
    tests = [one_mode_test(seed=s, speeds=(v,), sigma_known=True) for s, v in ((1, 100.0), (2, 180.0))]
    fit = rf.fit(OneMode(), [replace(t, run=np.full(len(t), "sweep")) for t in tests], known=KNOWN)
    post = quick(fit, noise="sampled", max_steps=100)
    assert post.names[-2:] == ("log_s[sweep / journal]", "log_s[sweep / journal #2]")
    post.save(tmp_path / "posterior.nc")
    np.testing.assert_array_equal(rf.load_posterior(tmp_path / "posterior.nc", fit).chain, post.chain)


def test_noise_levels_are_told_against_the_noise_of_the_data(rig):
    """A refined fit has levels of its own, which are no part of the noise given with the data."""
    levels = rig.fit.settings.levels.values()
    told = re.search(r"at the optimum (\S+) to (\S+) times the noise given", rig.treatment)
    assert told is not None
    assert [float(level) for level in told.groups()] == pytest.approx([min(levels), max(levels)], rel=0.02)
    fixed = quick(rig.fit, noise="fixed", walkers=64, max_steps=100)
    assert fixed.treatment == (
        "noise of each response at the level of the residuals of the refined fit. The doubt between the rungs of the "
        "ladder, which standard errors hold, is not in these draws of one model"
    )


def test_model_limits_are_told(rig_fit):
    plain = quick(rig_fit, max_steps=50)
    assert "the model, not the noise, limits the fit" in plain.treatment
    assert "refine=True" in plain.treatment
    fixed = quick(rig_fit, noise="fixed")
    assert fixed.settings.inflation == rig_fit.redchi
    assert f"widened by {np.sqrt(rig_fit.redchi):.3g}" in fixed.treatment
    width = [rig_fit.params[name].stderr for name in fixed.names]
    np.testing.assert_allclose(fixed.samples.std(axis=0), width, rtol=0.1)


def test_summary_is_complete(rig):
    az = load_arviz()

    text = rig.summary()
    assert text == str(rig)
    assert text.startswith("converged")
    for word in ("R-hat", "bulk ESS", "tail ESS", "acceptance", "seed 1", *rig.names):
        assert word in text
    table = az.summary(rig.to_arviz(), round_to="none")
    assert (table["r_hat"].astype(float) < 1.015).all()
    row = next(line for line in text.splitlines() if line.startswith("lam ")).split()
    assert float(row[7]) == pytest.approx(float(table.loc["lam", "ess_bulk"]), abs=1)
    # The tails of ArviZ's own table depend on its version: here those of the 90 % interval are shown.
    lam = rig.chain[:, :, rig.names.index("lam")].T
    tail = min(float(az.ess(lam, method="quantile", prob=q)) for q in (0.05, 0.95))
    assert float(row[8]) == pytest.approx(tail, abs=1)


# ---- derived quantities ---------------------------------------------------------------------------------------------


def test_many_thresholds_are_those_of_one_at_a_time(rig):
    model, band, theta = rig.fit.model, rig.fit.stability_band, rig.thetas(draws=25)
    speed, whirl = threshold_speeds(model, theta, band=band)
    for i, vector in enumerate(theta):
        one = threshold_speed(model, vector, band=band)
        assert speed[i] == pytest.approx(one.speed, rel=1e-9)
        assert whirl[i] == pytest.approx(one.whirl_frequency, rel=1e-9)


def test_draws_without_a_threshold():
    """lam near zero on either side: half of the rotors are never unstable forward; a dry one always."""
    model = OneMode()
    theta = np.tile(model.vector(TRUTH), (6, 1))
    theta[::2, model.parameter_names.index("D")] = 0.0  # no cross stiffness, no instability
    theta[::2, model.parameter_names.index("Mf")] = 0.0
    speed, whirl = threshold_speeds(model, theta)
    assert np.isinf(speed[::2]).all()
    assert np.isnan(whirl[::2]).all()
    np.testing.assert_allclose(speed[1::2], threshold_speed(model, theta[1]).speed, rtol=1e-9)
    unstable = theta[:3].copy()
    unstable[:, model.parameter_names.index("Ds")] = -2000.0
    np.testing.assert_array_equal(threshold_speeds(model, unstable)[0], 0.0)
    onset = Derived("threshold speed", "rad/s", speed)
    assert onset.missing == 0.5
    assert onset.interval(0.95)[0] == speed[1]
    assert onset.interval(0.95)[1] == np.inf
    ratio = Derived("whirl ratio", "1", whirl)
    assert np.isfinite([ratio.value, *ratio.interval()]).all()
    assert np.isnan(Derived("none", "1", np.full(3, np.nan)).value)
    with pytest.raises(ValueError, match="lies between 0 and 1"):
        onset.interval(95)


def test_derived_quantities_follow_the_draws(rig):
    fit, model = rig.fit, rig.fit.model
    assert rig.whirl_ratio().value == pytest.approx(fit.whirl_ratio(), rel=1e-3)
    onset, delta = rig.threshold_speed(), fit.threshold_speed()
    assert onset.stderr == pytest.approx(delta.stderr, rel=0.25)
    assert abs(onset.value - delta.value) < 0.5 * delta.stderr
    for (frequency, damping), (w, zeta) in zip(
        rig.natural_frequencies(200.0), fit.natural_frequencies(200.0), strict=True
    ):
        assert abs(frequency.value - w.value) < 3 * w.stderr
        assert abs(damping.value - zeta.value) < 3 * zeta.stderr
    low, high = rig.lam_speed(200.0).interval()
    assert (low, high) == pytest.approx([200 * v for v in rig.interval("lam")])
    with pytest.raises(KeyError, match="lam_D"):
        rig.lam_speed(200.0, name="lam_D")
    w = np.array([-150.0, 60.0])
    bands = rig.dynamic_stiffness(w, 200.0)
    one = model.dynamic_stiffness(rig.thetas()[7], w, 200.0)
    np.testing.assert_allclose(bands.direct.samples[7] + 1j * bands.quadrature.samples[7], one, rtol=1e-12)
    low, high = bands.quadrature.interval(0.9)
    assert low.shape == (2, 2, 2)
    assert ((low <= bands.quadrature.value) & (bands.quadrature.value <= high)).all()


def test_mode_shapes_solve_the_equation_of_motion(rig):
    model, theta = rig.fit.model, rig.thetas()
    for mode in rig.modal_parameters(200.0):
        shape = mode.amplitude.samples * np.exp(1j * mode.phase.samples)
        s = -mode.decay_rate.samples + 1j * mode.frequency.samples
        np.testing.assert_allclose(mode.damping_ratio.samples, mode.decay_rate.samples / np.abs(s))
        for n in (0, 500, 1999):
            coefficients = model.motion(theta[n], 200.0)
            kappa = np.einsum("k,kij->ij", s[n] ** np.arange(len(coefficients)), coefficients)
            assert np.abs(kappa @ shape[n]).max() < 1e-6 * np.abs(kappa).max()
        assert np.abs(shape).max() == pytest.approx(1.0)


def test_figures_are_drawn():
    post = quick(rf.fit(OneMode(), one_mode_test(), known=KNOWN), max_steps=60)
    assert len(post.plot_traces().axes) == len(post.names)
    assert post.plot_corner().axes


# ---- ArviZ and files ------------------------------------------------------------------------------------------------


def test_arviz_holds_every_draw(rig, monkeypatch):
    az = load_arviz()
    import xarray as xr

    tree = rig.to_arviz()
    old = int(az.__version__.partition(".")[0]) < 1
    assert isinstance(tree, az.InferenceData if old else xr.DataTree)
    for i, name in enumerate(rig.names):
        np.testing.assert_array_equal(tree["posterior"][name].values, rig.chain[:, :, i].T)
    np.testing.assert_array_equal(tree["sample_stats"]["lp"].values, rig.log_density.T)
    monkeypatch.setattr(az, "__version__", "1.0.0")
    later = rig.to_arviz()
    assert isinstance(later, xr.DataTree)
    np.testing.assert_array_equal(later["posterior"]["D"].values, rig.chain[:, :, rig.names.index("D")].T)


def test_files_read_back_the_same(tmp_path, rig):
    az = load_arviz()

    path = tmp_path / "posterior.nc"
    rig.save(path)
    assert [p.name for p in tmp_path.iterdir()] == ["posterior.nc"]
    again = rf.load_posterior(path, rig.fit)
    for field in fields(rig):
        ours, theirs = getattr(rig, field.name), getattr(again, field.name)
        if isinstance(ours, np.ndarray):
            np.testing.assert_array_equal(ours, theirs)
        else:
            assert ours == theirs
    np.testing.assert_array_equal(
        az.from_netcdf(str(path))["posterior"]["lam"].values, again.to_arviz()["posterior"]["lam"]
    )


def test_names_with_a_slash_are_kept(tmp_path):
    test = one_mode_test()
    test = replace(test, run=np.char.replace(test.run, " ", "/"))
    post = quick(rf.fit(OneMode(), test, known=KNOWN, phase_offsets=True), ess=100, max_steps=100)
    assert any("/" in name for name in post.names)
    post.save(tmp_path / "p.nc")
    assert rf.load_posterior(tmp_path / "p.nc", post.fit).names == post.names


def test_files_of_something_else_are_refused(tmp_path, rig, rig_fit):
    path = tmp_path / "p.nc"
    fit = rf.fit(OneMode(), one_mode_test(), known=KNOWN)
    quick(fit, max_steps=40).save(path)
    with pytest.raises(ValueError, match="but this fit is of"):
        rf.load_posterior(path, rig_fit)
    other = rf.fit(OneMode(), one_mode_test(seed=9), known=KNOWN)
    with pytest.raises(ValueError, match="posterior of another fit"):
        rf.load_posterior(path, other)
    rf.write(one_mode_test(), tmp_path / "test.nc")
    with pytest.raises(ValueError, match="holds no posterior"):
        rf.load_posterior(tmp_path / "test.nc", fit)
    (tmp_path / "text.nc").write_text("not netCDF")
    with pytest.raises(ValueError, match="holds no posterior"):
        rf.load_posterior(tmp_path / "text.nc", fit)
    with pytest.raises(FileNotFoundError):
        rf.load_posterior(tmp_path / "missing.nc", fit)


# ---- reproducibility, progress, checkpoints -------------------------------------------------------------------------


def test_seed_and_compilation_do_not_matter_for_the_answer():
    fit = rf.fit(OneMode(), one_mode_test(), known=KNOWN)
    first, again = (quick(fit, max_steps=50, accelerate=False) for _ in range(2))
    np.testing.assert_array_equal(first.chain, again.chain)
    compiled = quick(fit, max_steps=50, accelerate=True)
    np.testing.assert_allclose(compiled.chain, first.chain, rtol=1e-9)
    free = fit.sample(walkers=16, max_steps=20)
    np.testing.assert_array_equal(fit.sample(walkers=16, max_steps=20, seed=free.seed).chain, free.chain)


def test_progress_is_reported(capsys):
    fit = rf.fit(OneMode(), one_mode_test(), known=KNOWN)
    seen = []
    post = quick(fit, progress=seen.append)
    assert [state.steps for state in seen] == sorted({state.steps for state in seen})
    assert seen[-1].steps == post.settings.steps
    assert seen[-1].ess > 1000
    quick(fit, progress=True)
    assert f"{post.settings.steps} steps" in capsys.readouterr().err


CHILD = """
import sys
import numpy as np
sys.path.insert(0, sys.argv[2])
from test_posterior import interrupted
interrupted(sys.argv[1], lambda state: print(state.steps, flush=True))
"""


def interrupted(path, progress=False):
    """A run that never has enough and ends by its limit of steps."""
    fit = rf.fit(OneMode(), one_mode_test(), known=KNOWN)
    return fit.sample(seed=7, walkers=16, ess=1e12, max_steps=900, checkpoint=path, progress=progress, accelerate=False)


def test_a_killed_run_resumes_where_it_was(tmp_path):
    path = tmp_path / "run.h5"
    child = subprocess.Popen(
        [sys.executable, "-c", CHILD, str(path), str(Path(__file__).parent)],
        stdout=subprocess.PIPE,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p)},
    )
    told = [int(child.stdout.readline()) for _ in range(3)]
    os.kill(child.pid, signal.SIGKILL)
    child.stdout.close()
    assert child.wait() == -signal.SIGKILL
    kept = emcee.backends.HDFBackend(str(path), read_only=True).iteration
    # Killed while it worked on the next stretch: that much, and no more, is lost.
    assert kept >= told[-1] == 300
    assert kept < 900
    resumed = []
    post = interrupted(path, lambda state: resumed.append(state.steps))
    assert resumed[0] > kept
    straight = interrupted(tmp_path / "straight.h5")
    np.testing.assert_array_equal(post.chain, straight.chain)
    np.testing.assert_array_equal(post.log_density, straight.log_density)
    np.testing.assert_array_equal(post.acceptance, straight.acceptance)
    assert post.message == straight.message
    # Asked again, there is nothing left to do.
    np.testing.assert_array_equal(interrupted(path).chain, straight.chain)


def test_checkpoints_of_something_else_are_refused(tmp_path):
    fit = rf.fit(OneMode(), one_mode_test(), known=KNOWN)
    path = tmp_path / "run.h5"
    options = {"walkers": 16, "checkpoint": path, "max_steps": 50}
    fit.sample(seed=1, **options)
    with pytest.raises(ValueError, match="begun with seed 1, not 2"):
        fit.sample(seed=2, **options)
    with pytest.raises(ValueError, match="holds 16 walkers of 5 entries, here are 18 of 5"):
        fit.sample(**{**options, "walkers": 18})
    with pytest.raises(ValueError, match="another posterior"):
        rf.fit(OneMode(), one_mode_test(seed=3), known=KNOWN).sample(**options)
    with pytest.raises(ValueError, match="another posterior"):
        fit.sample(**options, noise="fixed")
    path.write_bytes(b"not HDF5")
    with pytest.raises(ValueError, match="is no checkpoint"):
        fit.sample(**options)


def test_a_checkpoint_without_a_seed_keeps_the_one_drawn(tmp_path):
    fit = rf.fit(OneMode(), one_mode_test(), known=KNOWN)
    path = tmp_path / "run.h5"
    first = fit.sample(walkers=16, checkpoint=path, max_steps=50)
    longer = fit.sample(walkers=16, checkpoint=path, max_steps=120)
    assert longer.seed == first.seed
    np.testing.assert_array_equal(
        longer.chain, fit.sample(walkers=16, seed=first.seed, checkpoint=tmp_path / "two.h5", max_steps=120).chain
    )
