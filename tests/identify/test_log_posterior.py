"""The public log density, for samplers of one's own."""

from __future__ import annotations

import emcee
import numpy as np
import pytest
from own_nonlinear import SEAL, LaggingSeal, seal_tests
from sentences import refuses

import rotorfit as rf


@pytest.fixture(scope="module")
def fit() -> rf.FitResult:
    return rf.fit(LaggingSeal(), seal_tests())


def squares(values) -> float:
    """Sum of squared residuals over their noise, by the seal's stiffness written a second time."""
    M, K, D, tau, lam = values
    total = 0.0
    for test, speed in zip(seal_tests(), (200.0, 400.0), strict=True):
        w = test.frequency
        kappa = K - M * w**2 + 1j * D * (w - lam * speed) / (1 + 1j * tau * w)
        total += float(np.sum(np.abs((test.response - 20.0 / kappa) / 2e-8) ** 2))
    return total


def test_it_is_the_likelihood_of_the_readings() -> None:
    plain = rf.fit(LaggingSeal(), seal_tests(), causes=None)
    density, rng = plain.log_posterior(noise="fixed"), np.random.default_rng(1)
    assert density.names == tuple(SEAL)
    near = density.start + 2 * np.sqrt(np.diag(density.covariance)) * rng.normal(size=(6, 5))
    found, own = density(near), np.array([-0.5 * squares(vector) for vector in near])
    np.testing.assert_allclose(found - found[0], own - own[0], atol=1e-6)
    assert density(near[0]) == found[0]  # one vector or many
    assert density(np.array([9.0, 1.3e6, 2600.0, -1e-3, 0.44])) == -np.inf  # beyond the bound of tau
    assert density.bounds[3, 0] == 0


def test_emcee_draws_the_errors_of_the_fit(fit: rf.FitResult) -> None:
    density = fit.log_posterior()
    sampler = emcee.EnsembleSampler(32, len(density.names), density, vectorize=True)
    sampler.random_state = np.random.RandomState(3).get_state()
    sampler.run_mcmc(density.walkers(32, seed=2), 1500)
    draws = density.values(sampler.get_chain(discard=500, flat=True), seed=4)
    posterior = fit.sample(seed=1)
    for place, name in enumerate(density.names):
        assert draws[:, place].std() == pytest.approx(posterior.parameter(name).stderr, rel=0.2), name
        low, high = np.quantile(draws[:, place], [0.001, 0.999])
        assert low < SEAL[name] < high


def test_few_effective_samples_take_few_draws(fit: rf.FitResult) -> None:
    few, many = fit.sample(seed=1, ess=500), fit.sample(seed=1)
    assert few.converged
    assert 500 <= len(few.samples) < 5000 < len(many.samples)


def test_sampled_levels_are_no_values_of_the_fit(fit: rf.FitResult) -> None:
    with refuses(ValueError):
        fit.log_posterior(noise="sampled")
