"""Posteriors against independent samplers and a quadrature: the same means and standard deviations."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from rotorfit.estimators.inference.ensemble_sampler import IndependenceMove, best_proposal, sample
from rotorfit.estimators.inference.log_posterior import LogPosterior
from rotorfit.estimators.minimisation.least_squares import minimise
from rotorfit.estimators.misfit.priors import Prior, log_priors


@pytest.fixture(scope="module", autouse=True)
def _benchmarks_on_the_path():
    sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))
    yield
    sys.path.remove(str(Path(__file__).parents[2] / "benchmarks"))


@pytest.mark.slow
def test_dynesty_finds_the_same_posterior():
    """One mode, priors ten standard errors to either side, against nested sampling on a density written out here."""
    dynesty = pytest.importorskip("dynesty")
    from rigs import FORCE, RIGS, true_vector, with_noise

    rig = replace(RIGS["one-mode"], speeds=(100.0,))
    problem = with_noise(rig.problem(20, 0.02), np.random.default_rng(1))
    truth, (block,) = rig.truth, problem.blocks
    x = minimise(problem, true_vector(problem, truth)).x
    error = np.sqrt(np.diag(np.linalg.inv(problem.gauss_newton(x)[2])))
    laws = [stats.uniform(m - 10 * e, 20 * e) for m, e in zip(x, error, strict=True)]
    problem = replace(problem, priors=tuple(Prior(i, law) for i, law in enumerate(laws)))
    names, w = problem.space.names, block.frequency[block.line]

    def log_likelihood(v):
        p = {**truth, **dict(zip(names, v, strict=True))}
        u = w - p["lam"] * 100.0
        kappa = p["K"] + p["K0"] - p["M"] * w**2 - p["Mf"] * u**2 + 1j * (p["Ds"] * w + p["D"] * u)
        return -0.5 * float(np.sum(np.abs(FORCE / kappa - block.measured) ** 2 / block.sigma**2))

    low = x - 10 * error
    sampler = dynesty.NestedSampler(
        log_likelihood, lambda q: low + 20 * error * q, x.size, nlive=250, bound="single", sample="unif",
        rstate=np.random.default_rng(2),
    )  # fmt: skip
    sampler.run_nested(print_progress=False, dlogz=0.1)
    weight = sampler.results.importance_weights()
    points = sampler.results.samples
    mean = weight @ points
    sd = np.sqrt(weight @ (points - mean) ** 2)
    size = 1 / (weight @ weight)

    target = LogPosterior(problem, "fixed")
    chain = sample(target, *target.laplace(x), walkers=64, ess=4000, max_steps=5000, seed=1)
    draws = chain.draws.reshape(-1, x.size)
    assert chain.converged
    # Nested sampling's weights carry the noise of the shrinkage too: its runs scatter about as if a third of the
    # points counted. Four standard errors of the difference.
    error_of_mean = np.sqrt(3 / size + 1 / chain.ess)
    np.testing.assert_array_less(np.abs(draws.mean(axis=0) - mean) / sd, 4 * error_of_mean)
    np.testing.assert_array_less(np.abs(draws.std(axis=0) / sd - 1), 4 * error_of_mean / np.sqrt(2))
    assert error_of_mean < 0.05


def test_importance_sampling_finds_the_same_posterior():
    """WhirlWhip with ten free parameters, against importance sampling of a density written in NumPy."""
    from fit_speed import make_case
    from posterior_speed import reference, rotorfit_run

    case = make_case(60)
    target = LogPosterior(case.problem, "fixed", accelerate=False)
    truth = reference(case, *target.laplace(case.optimum), draws=20_000)
    chains, _ = rotorfit_run(case, 128, 10_000, 3)
    draws = chains.reshape(-1, truth.mean.size)
    error = np.sqrt(1 / truth.ess + 1 / 10_000)
    assert error < 0.02
    np.testing.assert_array_less(np.abs(draws.mean(axis=0) - truth.mean) / truth.sd, 4 * error)
    np.testing.assert_array_less(np.abs(draws.std(axis=0) / truth.sd - 1), 4 * error)


@pytest.mark.slow
def test_curved_posterior_needs_the_mixture():
    """D and lam along a hyperbola against a quadrature: the mixture is right, independent proposals alone are not."""
    from curved_posterior import make_problem, measure

    mixture, alone = measure(*make_problem())
    assert mixture.converged
    assert mixture.mean_off < 4 / np.sqrt(mixture.ess)
    assert mixture.sd_off < 4 / np.sqrt(mixture.ess)
    assert not alone.converged
    assert alone.sd_off > 0.1


@pytest.mark.parametrize(("df", "chosen"), [(3.0, 5.0), (12.0, 12.0), (np.inf, 50.0)])
def test_tails_of_the_proposals_suit_the_posterior(df, chosen):
    """Student's t of several degrees of freedom as posterior, scaled and correlated."""
    centre, size, shape = np.array([5e3, 0.48]), np.array([2e3, 1e-4]), np.array([[1.0, 0.6], [0.6, 1.0]])
    law = stats.multivariate_t(np.zeros(2), shape, df=df)
    move, efficiency = best_proposal(lambda x: law.logpdf((x - centre) / size), centre, shape * np.outer(size, size))
    assert move.df == chosen
    # Of 512 draws with weights of relative variance 1/e - 1; and the exact one by quadrature over the radius:
    r2 = np.linspace(0, 4000, 400_001)
    p, q = (np.where(np.isinf(d), np.exp(-r2 / 2), (1 + r2 / (1 if np.isinf(d) else d)) ** (-(d + 2) / 2))
            for d in (df, chosen))  # fmt: skip
    exact = p.sum() ** 2 / (q.sum() * np.where(p > 0, p**2 / q, 0.0).sum())
    assert abs(efficiency - exact) < 4 * np.sqrt((1 / exact - 1 + 0.1) / 512)


def test_independent_proposals_leave_a_posterior_of_any_scale_unchanged():
    """One step from exact draws of a correlated normal with a variance of zero across gives exact draws again."""
    mix = np.array([[2e3, 0.0], [1e-5, 3e-5], [1e3, 0.0]])  # the third entry follows the first
    centre = np.array([5e3, 0.48, -2e3])
    random = np.random.RandomState(3)
    start = random.standard_normal((40_000, 2))
    move = IndependenceMove(centre, mix @ mix.T, 5.0)
    proposed, factor = move.draw(centre + start @ mix.T, random)
    white = np.linalg.lstsq(mix, (proposed - centre).T, rcond=None)[0].T
    np.testing.assert_allclose(centre + white @ mix.T, proposed, rtol=1e-9)
    accepted = np.log(random.uniform(size=len(start))) < 0.5 * ((start**2).sum(1) - (white**2).sum(1)) + factor
    after = np.where(accepted[:, None], white, start)
    for x in after.T:
        assert stats.kstest(x, "norm").pvalue > 1e-4
    assert 0.6 < accepted.mean() < 0.95


def test_priors_together_are_priors_one_by_one():
    rng = np.random.default_rng(0)
    laws = [
        stats.norm(1.0, 2.0), stats.norm(loc=0.5, scale=0.3), stats.norm(0.0, 1.0), stats.lognorm(0.3, scale=2.0),
        stats.lognorm(0.5, scale=1.0), stats.truncnorm(-1, 1, 0.5, 0.4), stats.uniform(0, 1),
    ]  # fmt: skip
    x = rng.uniform(0.1, 0.9, size=(7, len(laws)))
    x[3, 6] = 1.5  # outside
    priors = [Prior(i, law) for i, law in enumerate(laws)]
    expected = sum(law.logpdf(x[:, i]) for i, law in enumerate(laws))
    np.testing.assert_allclose(log_priors(priors)(x), expected, rtol=1e-13)
    assert np.isneginf(expected[3])
