"""Profile likelihood: against Laplace where that is exact, a dense grid, other parametrisations, and by coverage."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats
from seal_campaigns import KNOWN, seal_campaign
from sentences import refuses
from synthetic import TYPICAL, circular_test

import rotorfit as rf
from rotorfit.estimators.inference.constrained_minima import Minima
from rotorfit.estimators.inference.profile_curve import Curve, find_ends
from rotorfit.estimators.minimisation.batch import with_measured
from rotorfit.identify.fitting.fit import solve_again
from rotorfit.models import OneMode, WhirlWhip

Q95 = stats.chi2.ppf(0.95, 1)
RIG = TYPICAL["one-mode"]
W = np.r_[-np.linspace(20, 250, 12)[::-1], np.linspace(20, 250, 12)]


def one_mode_test(noise=0.01, seed=0, w=W, speeds=(100.0,), rig=RIG):
    model = OneMode()
    return circular_test(model, model.vector(rig), speeds=speeds, frequency=w, noise=noise, seed=seed, sigma_known=True)


def test_a_linear_problem_has_laplace_intervals():
    """Forces under an imposed orbit are linear in K0, D and Mf when lam is known."""
    model = OneMode()
    w = np.linspace(-300, 300, 40)
    kappa = model.dynamic_stiffness(model.vector(RIG), w, np.full(w.size, 150.0))[:, 0, 0]
    rng = np.random.default_rng(3)
    force = 1e-5 * np.where(w < 0, kappa.conj(), kappa)
    noise = [2e-3 * (rng.normal(size=w.size) + 1j * rng.normal(size=w.size)) for _ in "xy"]
    test = rf.DisplacementTest(
        run=np.full(w.size, "sweep"),
        speed=np.full(w.size, 150.0),
        frequency=w,
        plane=np.full(w.size, "journal"),
        displacement=np.full(w.size, 1e-5 + 0j),
        force_x=force + noise[0],
        force_y=-1j * np.sign(w) * force + noise[1],
        sigma=np.full(w.size, 1e-3),  # half the true noise: redchi is near 4 and widens both intervals alike
        attributes={},
    )
    fit = rf.fit(model, test, known={"M": 1.2, "K": 8000.0, "Ds": 8.0, "lam": 0.46}, causes=None)
    assert fit.redchi > 3
    for name in ("K0", "D", "Mf"):
        p, half = fit.params[name], np.sqrt(Q95) * fit.params[name].stderr
        found = fit.profile(name)
        np.testing.assert_allclose(found.interval, (p.value - half, p.value + half), rtol=0, atol=1e-6 * half)
        # and the curve is the parabola
        np.testing.assert_allclose(found.rise, ((found.values - p.value) / p.stderr) ** 2, rtol=1e-6, atol=1e-6)
        assert found.message == ""
        narrow = fit.profile(name, level=0.6827)
        np.testing.assert_allclose(narrow.upper - p.value, stats.norm.ppf(0.84135) * p.stderr, rtol=1e-6)


def test_a_curved_problem_agrees_with_a_dense_grid():
    known = {name: RIG[name] for name in ("M", "K", "Ds", "K0", "Mf")}
    fit = rf.fit(OneMode(), one_mode_test(noise=1.0, seed=2), known=known, causes=None)
    block = fit.problem.blocks[0]
    w, F = block.frequency[block.line], block.force[block.line, 0]
    lam = np.linspace(-0.2, 1.2, 1401)
    D = np.linspace(100.0, 1300.0, 1201)
    # eq. (13) written out
    K, M, Mf, Ds = RIG["K"] + RIG["K0"], RIG["M"], RIG["Mf"], RIG["Ds"]
    chisqr = np.zeros((lam.size, D.size))
    for k in range(w.size):
        v = w[k] - lam[:, None] * 100.0
        A = F[k] / (K - M * w[k] ** 2 - Mf * v**2 + 1j * (Ds * w[k] + D[None, :] * v))
        chisqr += np.abs((A - block.measured[k]) / block.sigma[k]) ** 2
    goal = Q95 * fit.widening
    for name, values, table in (("lam", lam, chisqr), ("D", D, chisqr.T)):
        best = table.min(axis=1)
        inside = values[best - fit.chisqr <= goal]
        found, step = fit.profile(name), values[1] - values[0]
        np.testing.assert_allclose(found.interval, (inside[0], inside[-1]), rtol=0, atol=1.5 * step)
        p = fit.params[name]
        laplace = p.value + np.array([-1, 1]) * np.sqrt(Q95) * p.stderr
        assert np.abs(found.interval - laplace).max() > 10 * step  # the case is curved enough to tell
        on_grid = np.interp(found.values, values, best - fit.chisqr) / fit.widening
        np.testing.assert_allclose(found.rise, on_grid, rtol=0.01, atol=0.01)


def test_the_threshold_speed_has_the_interval_of_the_parameter_it_is_a_function_of():
    """Without external damping the threshold is sqrt((K + K0)/M)/lam: with these known, one to one with lam."""
    rig = {**RIG, "Ds": 0.0}
    known = {name: rig[name] for name in ("M", "K", "Ds", "K0")}
    fit = rf.fit(OneMode(), one_mode_test(noise=0.2, seed=4, rig=rig), known=known, causes=None)
    lam, speed = fit.profile("lam"), fit.profile("threshold_speed")
    w = np.sqrt((rig["K"] + rig["K0"]) / rig["M"])
    np.testing.assert_allclose(speed.interval, (w / lam.upper, w / lam.lower), rtol=1e-6)
    assert speed.unit == "rad/s"
    p = fit.params["lam"]
    assert abs(lam.upper - p.value - np.sqrt(Q95) * p.stderr) > 1e-3 * p.stderr


def test_the_threshold_speed_is_followed_along_a_bound():
    """As above, Mf pressed against a bound all the way."""
    rig = {**RIG, "Ds": 0.0}
    known = {name: rig[name] for name in ("M", "K", "Ds", "K0")}
    fit = rf.fit(
        OneMode(), one_mode_test(noise=0.2, seed=4, rig=rig), known=known, bounds={"Mf": (0.6, 2.0)}, causes=None
    )
    assert fit.params["Mf"].at_bound
    lam, speed = fit.profile("lam"), fit.profile("threshold_speed")
    w = np.sqrt((rig["K"] + rig["K0"]) / rig["M"])
    np.testing.assert_allclose(speed.interval, (w / lam.upper, w / lam.lower), rtol=1e-6)
    assert speed.message == ""


def test_coverage():
    """Of 100 draws, noise a third of the responses, 95 % intervals cover as often, within binomial error."""
    known = {name: RIG[name] for name in ("K", "Ds", "M", "Mf")}
    base = rf.fit(OneMode(), one_mode_test(noise=0.3), known=known, causes=None)
    truth = np.array([RIG[name] for name in base.var_names])
    block = base.problem.blocks[0]
    exact = base.problem.predict(truth)[0]
    rng = np.random.default_rng(11)
    hits, draws = {"D": 0}, 100
    for _ in range(draws):
        error = rng.normal(size=exact.size) + 1j * rng.normal(size=exact.size)
        fit = solve_again(base, with_measured(base.problem, exact + block.sigma * error))
        for name in hits:
            low, high = fit.profile(name, points=3).interval
            hits[name] += low <= RIG[name] <= high
    for count in hits.values():
        assert stats.binomtest(count, draws, 0.95).pvalue > 0.01


def test_open_ends_are_said_plainly():
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
    fit = rf.fit(model, test, known={"K3": 6000.0})
    assert "sigma" in fit.identifiability.unresolved
    found = fit.profile("sigma")
    assert found.upper == np.inf
    assert "open above" in found.message
    assert "open above" in str(found)
    determined = fit.profile("D")
    assert np.isfinite(determined.interval).all()
    assert determined.message == ""


def test_a_bound_that_ends_the_curve_is_named():
    known = {name: RIG[name] for name in ("K", "Ds")}
    fit = rf.fit(OneMode(), one_mode_test(noise=0.5, seed=3), known=known, bounds={"Mf": (0.2, 0.6)})
    found = fit.profile("Mf")
    assert found.interval == (-np.inf, np.inf)
    assert "up to its bound 0.2 kg" in found.message
    assert "up to its bound 0.6 kg" in found.message
    assert found.values.min() >= 0.2
    prior = rf.fit(OneMode(), one_mode_test(noise=0.5, seed=3), known=known, priors={"Mf": stats.uniform(0.2, 0.4)})
    assert prior.profile("Mf").interval == (-np.inf, np.inf)


def test_a_normal_prior_counts_in_full_when_the_noise_is_widened():
    """With a prior far tighter than the data the interval is the prior's, whatever redchi is."""
    test = one_mode_test(noise=0.05, seed=6)
    doubtful = replace(test, sigma=test.sigma / 4)
    fit = rf.fit(OneMode(), doubtful, known={"K": 8000.0, "Ds": 8.0}, priors={"Mf": stats.norm(0.4, 1e-4)})
    assert fit.redchi > 8
    np.testing.assert_allclose(fit.profile("Mf").interval, 0.4 + 1.96e-4 * np.array([-1, 1]), rtol=0, atol=3e-6)


def test_a_robust_loss_agrees_with_its_standard_error():
    test = one_mode_test(noise=0.003, seed=7, w=np.r_[-np.linspace(20, 250, 80), np.linspace(20, 250, 80)])
    fit = rf.fit(OneMode(), test, known={"K": 8000.0, "Ds": 8.0}, loss="soft_l1", causes=None)
    for name in fit.var_names:
        p, found = fit.params[name], fit.profile(name)
        np.testing.assert_allclose(found.upper - found.lower, 2 * np.sqrt(Q95) * p.stderr, rtol=5e-3)


def test_curves_of_a_robust_loss_are_followed_where_full_steps_contract_slowly():
    """With a redescending loss on noisy data Gauss-Newton steps need help, from where they have led."""
    w = np.r_[-np.linspace(20, 300, 14)[::-1], np.linspace(20, 300, 14)]
    test = one_mode_test(noise=0.1, seed=3, w=w, speeds=(100.0, 180.0))
    fit = rf.fit(OneMode(), test, known={"K": 8000.0, "Ds": 8.0}, loss="cauchy")
    for found in fit.profiles(points=9):
        assert found.message == ""
        assert (np.diff(np.sign(np.diff(found.rise))) >= 0).all()  # falls to the estimate and rises beyond


def test_the_curve_holds_the_others_at_their_best():
    fit = rf.fit(WhirlWhip(), rf.datasets.rig_open(), known={"K3": 6000.0}, causes=None)
    found = fit.profile("lam", points=5)
    assert found.rise.min() == 0
    for value, rise in zip(found.values, found.rise, strict=True):
        refit = rf.fit(fit.model, fit.experiments, known={"K3": 6000.0, "lam": float(value)}, causes=None)
        np.testing.assert_allclose((refit.chisqr - fit.chisqr) / fit.redchi, rise, rtol=1e-6, atol=1e-6)


def test_profiles_found_together_are_those_found_one_by_one():
    fit = rf.fit(WhirlWhip(), rf.datasets.rig_open(), known={"K3": 6000.0})
    names = (*fit.var_names[::3], "threshold_speed")
    together = fit.profiles(names)
    assert [found.name for found in fit.profiles(points=3)] == list(fit.var_names)
    for name, found in zip(names, together, strict=True):
        alone = fit.profile(name)
        np.testing.assert_allclose(found.interval, alone.interval, rtol=0, atol=1e-8 * alone.stderr)
        np.testing.assert_allclose(found.rise, alone.rise, rtol=0, atol=1e-7)
        assert str(found) == str(alone)


def test_the_figure_shows_curve_level_and_ends(tmp_path):
    known = {name: RIG[name] for name in ("M", "K", "Ds", "K0", "Mf")}
    fit = rf.fit(OneMode(), one_mode_test(noise=0.5, seed=2), known=known, causes=None)
    found = fit.profile("D")
    figure = found.plot()
    figure.savefig(tmp_path / "profile.png", dpi=50)
    curve, parabola, level, low, high = figure.axes[0].lines
    np.testing.assert_array_equal(curve.get_xdata(), found.values)
    np.testing.assert_array_equal(curve.get_ydata(), found.rise)
    x, y = (np.asarray(data) for data in (parabola.get_xdata(), parabola.get_ydata()))
    np.testing.assert_allclose(np.sqrt(y), np.abs(x - found.value) / fit.params["D"].stderr)
    assert level.get_ydata()[0] == pytest.approx(3.8415, abs=1e-4)
    assert (low.get_xdata()[0], high.get_xdata()[0]) == found.interval
    assert figure.axes[0].get_xlabel() == "D, N s/m"
    speed = fit.profile("threshold_speed", points=5).plot().axes[0]
    assert speed.get_xlabel() == "threshold speed, rpm"
    assert speed.lines[0].get_xdata()[2] == pytest.approx(fit.threshold_speed().value * 30 / np.pi)


def test_what_cannot_be_profiled_is_refused():
    test = one_mode_test()
    fit = rf.fit(OneMode(), test, known={"K": 8000.0, "Ds": 8.0})
    with refuses(KeyError):
        fit.profile("lamda")
    with refuses(ValueError):
        fit.profile("K")
    with refuses(ValueError):
        fit.profile("lam", level=95)
    with refuses(ValueError):
        rf.closed_form(OneMode(), test, known={"K": 8000.0, "Ds": 8.0}).profile("lam")


class ParabolaWithAnEnd:
    """A minimum over everything else that is found up to a value only."""

    def __init__(self, end):
        self.end = end

    def together(self, entries, values, starts, contraction):
        nothing = np.zeros_like(starts)
        found = np.zeros(values.size, dtype=bool)
        return Minima(cost=np.zeros(values.size), x=nothing, slope=nothing, found=found, contraction=contraction)

    def alone(self, entry, value, start):
        return (value**2 / 2, np.array([value]), True) if value < self.end else (np.inf, start, False)


@pytest.mark.parametrize(("end", "met"), [(1.5, False), (1.9, False), (2.5, True)])
def test_a_curve_that_ends_short_of_the_level_has_no_end_there(end, met):
    """The rise is the square of the value; the level of 3.84 is met at 1.96."""
    curve = Curve(ParabolaWithAnEnd(end), 0.0, np.zeros(1), 0.0, np.ones(1))
    (found,) = find_ends([curve], [(curve.search(1, Q95, 1.0, 100.0, False),)])[0]
    if met:
        assert found.exact
        assert found.value == pytest.approx(np.sqrt(Q95), rel=1e-8)
    else:
        assert not found.exact
        assert found.value == np.inf
        assert found.limit == pytest.approx(end, rel=1e-6)
        assert found.rise == pytest.approx(end**2, rel=1e-6)


@pytest.mark.slow
def test_the_threshold_of_responses_that_noise_hides_is_said_to_be_open():
    """Noise of 80 % of the response: on the way up no rotor is found that would be unstable at that speed only."""
    model, rig = WhirlWhip(), TYPICAL["whirl-whip"]
    w = np.r_[-np.linspace(20, 500, 20)[::-1], np.linspace(20, 500, 20)]
    said = []
    for seed in (0, 1):  # the threshold of one draw is open below, that of the other is not
        test = circular_test(model, model.vector(rig), speeds=(150.0,), frequency=w, noise=0.8, seed=seed)
        fit = rf.fit(model, test, known={"K3": rig["K3"]})
        if fit.success and np.isfinite(fit.threshold_speed().stderr):
            profile = fit.profile("threshold_speed", points=3)
            said.append(profile.message)
            for side, word in ((profile.lower, "below"), (profile.upper, "above")):
                assert np.isinf(side) == (f"open {word}" in profile.message)
    assert any("no minimum was found" in message for message in said)


def test_profiles_are_found_elsewhere_as_here():
    fit = rf.fit(OneMode(), seal_campaign(1)[0], known=KNOWN, causes=None)
    with ThreadPoolExecutor(2) as pool:
        there = fit.profiles(["K0", "lam"], points=5, executor=pool)
    for one, other in zip(there, fit.profiles(["K0", "lam"], points=5), strict=True):
        assert (one.name, one.interval, one.message) == (other.name, other.interval, other.message)
        np.testing.assert_array_equal(one.rise, other.rise)
