"""Posteriors: against exact ones, honest about convergence."""

from __future__ import annotations

from dataclasses import replace

import emcee
import numpy as np
import pytest
from posteriors import KNOWN, SIGNIFICANT, TRUTH, imposed_orbit, one_mode_test, quick, whitened_design
from scipy import integrate, stats
from sentences import refuses

import rotorfit as rf
from rotorfit.estimators.inference.ensemble_sampler import IndependenceMove
from rotorfit.estimators.inference.ensemble_sampler import sample as run_emcee
from rotorfit.estimators.inference.log_posterior import LogPosterior
from rotorfit.models import OneMode


@pytest.fixture(scope="module")
def linear():
    design, test = imposed_orbit()
    known = {**KNOWN, "lam": TRUTH["lam"]}
    fit = rf.fit(OneMode(), test, known=known, causes=None)
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
    mean, sd = fit.params["D"].value + 2 * fit.params["D"].stderr, 0.5 * fit.params["D"].stderr
    informed = rf.fit(OneMode(), test, known=known, priors={"D": stats.norm(mean, sd)}, causes=None)
    place = fit.var_names.index("D")
    precision, pull = X.T @ X, X.T @ X @ fit.x
    precision[place, place] += 1 / sd**2
    pull[place] += mean / sd**2
    distance = mahalanobis(independent(quick(informed, noise="fixed")), np.linalg.solve(precision, pull), precision)
    assert stats.kstest(distance, stats.chi2(4).cdf).pvalue > SIGNIFICANT


@pytest.mark.slow
def test_bounds_cut_the_posterior(linear):
    """A bound through the optimum leaves the free posterior's draws on its side."""
    fit, _, test, known = linear
    cut = fit.params["D"].value
    bounded = rf.fit(OneMode(), test, known=known, bounds={"D": (0.0, cut)}, causes=None)
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
    half = rf.fit(OneMode(), test, known=known, priors={"D": stats.uniform(low, width)}, causes=None)
    drawn = quick(half, max_steps=150).parameter("D").samples
    assert drawn.min() >= low
    assert drawn.max() <= low + width


@pytest.mark.parametrize("accelerate", [False, True])
def test_marginal_noise_against_quadrature(accelerate):
    """Channels whose noise is misjudged: the level integrated out numerically, and the posterior of one parameter."""
    test = one_mode_test(sigma_known=True)
    wrong = np.where(test.run == test.runs[0], 3.0, 0.5)
    test = replace(test, sigma=test.sigma * wrong)
    fit = rf.fit(OneMode(), test, known={k: v for k, v in TRUTH.items() if k != "D"}, causes=None)
    target = LogPosterior(fit.problem, "marginal", accelerate=accelerate)
    assert target.batch.compiled is accelerate
    assert len(fit.problem.channel_counts) == 4
    spread = fit.params["D"].stderr
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


@pytest.mark.slow
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
    post = quick(rf.fit(OneMode(), one_mode_test(), known=KNOWN, causes=None), max_steps=60)
    assert not post.converged
    assert [f.code for f in post.findings if f not in post.fit.findings] == ["sampling"]
    assert "not converged" in post.message
    assert post.summary().startswith("NOT CONVERGED")
    assert post.settings.steps == 60
    assert post.chain.shape[0] + post.burn_in == 60


def test_robust_loss_keeps_outliers_out():
    test = one_mode_test(lines=80, sigma_known=True)
    rng = np.random.default_rng(0)
    hit = rng.random(len(test)) < 0.08
    test = replace(test, response=test.response + hit * 40 * test.sigma * np.exp(2j * np.pi * rng.random(len(test))))
    plain = rf.fit(OneMode(), test, known=KNOWN, causes=None)
    robust = rf.fit(OneMode(), test, known=KNOWN, loss="soft_l1", causes=None)
    post = quick(robust)
    assert post.settings.noise == "fixed"
    assert "soft_l1" in post.treatment
    for name in ("K0", "D", "lam"):
        low, high = post.interval(name, 0.99)
        assert low < TRUTH[name] < high
        assert high - low < 0.5 * np.diff(quick(plain).interval(name, 0.99))[0]
    with refuses(ValueError):
        robust.sample(noise="marginal")


def test_a_parameter_for_each_speed():
    fit = rf.fit(OneMode(), one_mode_test(), known=KNOWN, per={"D": "speed_rpm"}, causes=None)
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
    with refuses(ValueError):
        post.threshold_speed()


def test_phase_offsets_are_sampled():
    test = one_mode_test()
    run = test.runs[1]
    shifted = replace(test, response=test.response * np.where(test.run == run, np.exp(0.08j), 1.0))
    fit = rf.fit(OneMode(), shifted, known=KNOWN, phase_offsets=True, causes=None)
    post = quick(fit)
    name = f"phase[{run}]"
    low, high = post.interval(name, 0.99)
    assert low < 0.08 < high
    assert post.unit(name) == "rad"
    assert post.parameter(name).stderr == pytest.approx(fit.params[name].stderr, rel=0.25)


def test_what_cannot_be_sampled_is_refused():
    test = one_mode_test()
    with refuses(ValueError):
        rf.closed_form(OneMode(), test, known=KNOWN).sample()
    fit = rf.fit(OneMode(), test, known=KNOWN, causes=None)
    with refuses(ValueError):
        fit.sample(noise="flat")
    with refuses(ValueError):
        fit.sample(walkers=8)
    failed = replace(fit, success=False, message="stopped")
    with refuses(ValueError):
        failed.sample()
    with refuses(ValueError):
        rf.fit(OneMode(), test, known={"Ds": TRUTH["Ds"]}, causes=None).sample()
    # Mixtures of two flat directions may meet bounds although one of them meets none.
    with refuses(ValueError):
        rf.fit(OneMode(), one_mode_test(speeds=(100.0,)), causes=None).sample()


def test_a_fit_that_is_not_the_lowest_minimum_is_told_by_the_draws():
    fit = rf.fit(OneMode(), one_mode_test(sigma_known=True), known=KNOWN, causes=None)
    assert "lowest minimum" not in quick(fit, noise="fixed").treatment
    elsewhere = fit.x + 3 * np.sqrt(np.diag(fit.covar)) * (np.array(fit.var_names) == "lam")
    assert "not end in the lowest minimum" in quick(replace(fit, x=elsewhere), noise="fixed").treatment


def test_inflated_noise_moves_the_optimum_towards_the_priors():
    """Walkers start where the density is largest, which is not the optimum of the fit when its noise is widened."""
    fit = rf.fit(OneMode(), one_mode_test(), known=KNOWN, priors={"D": stats.norm(440.0, 3.0)}, causes=None)
    target = LogPosterior(fit.problem, "fixed", inflation=30.0)
    centre, covariance = target.laplace(fit.x)
    step = 0.1 * np.sqrt(np.diag(covariance)) * np.eye(centre.size)
    assert (target(centre + np.concatenate([step, -step])) < target(centre[None])).all()
    assert target(fit.x[None]) < target(centre[None]) - 0.1


@pytest.mark.parametrize("ess", [float("nan"), float("inf"), 0.0, -5.0, "many"])
def test_a_number_of_effective_samples_that_is_none_is_refused(linear, ess):
    with refuses(ValueError):
        rf.sample(linear[0], ess=ess, max_steps=60, seed=1)


def test_a_corner_plot_shows_chosen_parameters_and_marks_truths(rig_fit: rf.FitResult) -> None:
    posterior = rig_fit.sample(seed=1, walkers=32, ess=20)
    figure = posterior.plot.corner(var_names=["lam", "D"], truths={"lam": 0.475})
    assert len(figure.axes) == 4
    titles = [axis.get_title(loc="center").split("\n") for axis in figure.axes if axis.get_title(loc="center")]
    for name, (title, numbers) in zip(("lam", "D"), titles, strict=True):
        drawn = posterior.samples[:, posterior.names.index(name)]
        assert title == name
        assert float(numbers.split(" ± ")[0]) == pytest.approx(drawn.mean(), abs=drawn.std() / 20)
    together = np.corrcoef(posterior.samples[:, [posterior.names.index(name) for name in ("lam", "D")]].T)[0, 1]
    assert [text.get_text() for text in figure.axes[1].texts] == [f"{together:+.2f}".replace("-", "−")]
    assert len(posterior.plot.corner().axes) == 16  # of ten those of the fluid
    marked = [line.get_xdata()[0] for axis in figure.axes for line in axis.lines if line.get_xdata()[0] == 0.475]
    assert marked
    with refuses(KeyError):
        posterior.plot.corner(var_names=["lamb"])
