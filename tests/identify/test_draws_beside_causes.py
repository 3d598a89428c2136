"""Posterior, profile and bootstrap of a fit with causes: the joint solve, and the interval of the fit."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from posteriors import KNOWN, one_mode_test
from scipy import stats

import rotorfit as rf
from rotorfit.estimators.inference.caused_posterior import CausedPosterior
from rotorfit.estimators.inference.linear_causes import CausesGiven, LinearCauses
from rotorfit.estimators.misfit.problem import robust_weights
from rotorfit.identify.uncertainty.target import caused_problem
from rotorfit.models import OneMode

NAMES = ("D", "lam", "threshold_speed")


@cache
def fitted(rig: str) -> rf.FitResult:
    if rig == "lumped":
        return rf.fit(rf.models.WhirlWhip(), rf.datasets.rig_lumped(), known={"K3": 6000.0})
    return rf.fit(OneMode(), one_mode_test(noise=0.005, lines=25, sigma_known=True), known=KNOWN)


def agrees(found: tuple[float, float], fit: rf.FitResult, name: str) -> None:
    """Both ends within a quarter of the half width of the interval of the fit."""
    low, high = fit.interval(name)
    np.testing.assert_allclose(found, (low, high), rtol=0, atol=0.25 * (high - low))


def linear() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(1)
    draw = lambda *shape: rng.normal(size=shape) + 1j * rng.normal(size=shape)  # noqa: E731
    return draw(1, 40), draw(40, 3), draw(40, 6) * [30.0, 10.0, 3.0, 1.0, 0.1, 1e-3]


def test_whitening_is_the_joint_solve() -> None:
    """``W = I - U (1 - 1 / sqrt(1 + d^2)) U'`` applied to residuals and Jacobian against sizes solved with values."""
    r, J, B = linear()
    real = lambda a: np.concatenate([a.real, a.imag])  # noqa: E731
    W = whitening(real(B))
    rows = np.hstack([real(J), real(B)])
    whole = np.linalg.inv(rows.T @ rows + np.diag([0.0] * 3 + [1.0] * 6))
    np.testing.assert_allclose(whole[:3, :3], np.linalg.inv(real(J).T @ W @ W @ real(J)), rtol=1e-10)
    step = np.linalg.lstsq(W @ real(J), -W @ real(r[0]), rcond=None)[0]
    np.testing.assert_allclose(step, (-whole @ rows.T @ real(r[0]))[:3], rtol=1e-10)


def whitening(rows: np.ndarray) -> np.ndarray:
    U, d, _ = np.linalg.svd(rows, full_matrices=False)
    return np.eye(len(rows)) - (U * (1 - 1 / np.sqrt(1 + d**2))) @ U.T


@pytest.mark.parametrize("accelerate", [False, True])
@pytest.mark.parametrize("loss", ["linear", "huber"])
def test_the_density_is_that_of_white_residuals(loss: str, accelerate: bool) -> None:
    """Of sizes of either sign, solved somewhere: ``-|W r|^2 / 2`` about none, at once for many vectors; with a robust
    loss the cost at the sizes by the weights of the optimum."""
    fit = fitted("one mode")
    problem = replace(fit.problem, loss=loss)
    columns = linear()[2][np.arange(problem.measured.size) % 40] / 3
    at = np.array([1.0, -0.5, 0.0, 2.0, 0.3, -1.0])
    causes = LinearCauses(columns=columns, at=at, size=np.ones(6), one_sided=np.zeros(6, dtype=bool))
    taken = np.zeros((fit.x.size, 6))
    target = CausedPosterior(problem, "fixed", causes, fit.x, taken=taken, accelerate=accelerate)
    x = fit.x * (1 + 0.01 * np.random.default_rng(2).normal(size=(4, fit.x.size)))
    real = lambda a: np.concatenate([a.real, a.imag], axis=-1)  # noqa: E731
    r = problem.residuals(x)
    if loss == "linear":
        white = real(r - at @ columns.T) @ whitening(real(columns.T).T)
        expected = -0.5 * np.sum(white**2, axis=1)
    else:
        weight = robust_weights(loss, np.abs(problem.residuals(fit.x)) ** 2)[1]
        B = real(columns.T).T
        covar = np.linalg.inv(np.eye(6) + B.T @ (np.tile(weight, 2)[:, None] * B))
        sizes = at - covar @ at - (real(r) * np.tile(weight, 2)) @ B @ covar
        left = np.abs(r + (sizes - at) @ columns.T) ** 2
        expected = -0.5 * (robust_weights(loss, left)[0].sum(axis=1) + np.sum(sizes**2, axis=1))
    np.testing.assert_allclose(target(x), expected, rtol=1e-7)


def test_signs_are_those_of_the_normal_distribution() -> None:
    """Their probability against SciPy's integral, and draws against those of it that have the signs."""
    _, _, B = linear()
    signs = np.array([True, False, True, True, False, True])
    causes = LinearCauses(columns=B / 30, at=np.zeros(6), size=np.full(6, 2.0), one_sided=signs)
    given = CausesGiven(causes=causes, weight=np.ones(40))
    middle = np.random.default_rng(3).normal(size=(20, 6)) * np.sqrt(np.diag(given.covar)) + 0.2
    own = given.covar[np.ix_(signs, signs)]
    exact = [stats.multivariate_normal(np.zeros(4), own, seed=1).cdf(row[signs]) for row in middle]
    np.testing.assert_allclose(given.log_one_sign(middle), np.log(exact), atol=0.1)
    rng = np.random.default_rng(4)
    free = rng.multivariate_normal(middle[0], given.covar, size=400_000)
    kept = 2 * free[(free[:, signs] >= 0).all(axis=1)][:4000]
    drawn = given.drawn(np.tile(middle[0], (4000, 1)), rng)
    assert (drawn[:, signs] >= 0).all()
    for mine, theirs in zip(drawn.T, kept.T, strict=True):
        assert stats.ks_2samp(mine, theirs).pvalue > 1e-4


@pytest.mark.parametrize("rig", ["lumped", "one mode"])
def test_the_normal_approximation_is_the_error_of_the_fit(rig: str) -> None:
    """To the share that derivatives change by from no causes to those that were found."""
    fit = fitted(rig)
    caused = caused_problem(fit)
    assert caused is not None
    matrix = caused.gauss_newton(caused.start)[2]
    covariance = np.linalg.inv(matrix)[: fit.x.size, : fit.x.size]
    error = np.sqrt(np.diag(fit.covar))
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)), error, rtol=0.03)
    optimum, found = caused.minimum()
    assert found
    np.testing.assert_allclose((optimum[: fit.x.size] - fit.x) / error, 0, atol=0.1)


def test_derivatives_beside_causes_are_those_of_the_cost() -> None:
    caused = caused_problem(fitted("one mode"))
    assert caused is not None
    error = np.sqrt(np.diag(np.linalg.inv(caused.gauss_newton(caused.start)[2])))
    y = caused.start + error * np.random.default_rng(2).normal(size=error.size)
    _, gradient, _ = caused.gauss_newton(y)
    for entry, step in enumerate(1e-3 * error):
        ahead, behind = (caused.cost(y + way * step * np.eye(y.size)[entry]) for way in (1, -1))
        assert (ahead - behind) / (2 * step) == pytest.approx(gradient[entry], rel=1e-4, abs=1e-5 / error[entry])


@pytest.mark.parametrize("rig", ["lumped", "one mode"])
def test_the_posterior_agrees_with_the_interval(rig: str) -> None:
    fit = fitted(rig)
    post = fit.sample(seed=1, walkers=64, ess=1000, noise="fixed")
    assert post.converged
    assert len(post.names) == len(fit.var_names)
    assert "lowest minimum" not in post.treatment
    for name in NAMES:
        found = post.threshold_speed().interval() if name == "threshold_speed" else post.interval(name)
        agrees(found, fit, name)


@pytest.mark.parametrize("rig", ["lumped", "one mode"])
def test_the_profile_agrees_with_the_interval(rig: str) -> None:
    fit = fitted(rig)
    for found in fit.profiles(NAMES, points=3):
        agrees(found.interval, fit, found.name)


@pytest.mark.parametrize("rig", ["lumped", "one mode"])
def test_the_bootstrap_agrees_with_the_interval(rig: str) -> None:
    fit = fitted(rig)
    boot = fit.bootstrap(n=400, seed=1)
    assert boot.failures == 0
    for name in NAMES:
        found = boot.threshold_speed().interval() if name == "threshold_speed" else boot.interval(name)
        agrees(found, fit, name)


def test_a_cause_of_one_sign_lengthens_one_side() -> None:
    """A damper beside the fluid's leaves lam larger than was found, not smaller."""
    fit = fitted("one mode")
    value, (low, high) = fit.params["lam"].value, fit.interval("lam")
    assert high - value > 2 * (value - low)
    found = fit.profile("lam", points=3)
    np.testing.assert_allclose(found.interval, (low, high), rtol=0, atol=0.03 * (high - low))


def test_without_causes_nothing_is_integrated_out() -> None:
    fit = rf.fit(OneMode(), one_mode_test(), known=KNOWN, causes=None)
    post = fit.sample(seed=1, walkers=16, max_steps=20)
    assert not post.settings.causes
    assert "causes" not in post.treatment
    assert fit.bootstrap(n=4).sizes is None


def test_a_posterior_beside_causes_is_read_again(tmp_path) -> None:
    fit = fitted("one mode")
    post = fit.sample(seed=1, walkers=16, max_steps=30)
    post.save(tmp_path / "posterior.nc")
    again = rf.load_posterior(tmp_path / "posterior.nc", fit)
    assert again.settings.causes
    np.testing.assert_array_equal(again.threshold_speed().samples, post.threshold_speed().samples)
