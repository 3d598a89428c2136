"""Calibration budget: known sensitivities, miscalibrated data in numbers, and agreement of all measures."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from rotorfit.identify.fitting.assumptions.calibration import Calibration
from scipy import stats
from sentences import refuses
from synthetic import TYPICAL, circular_test

import rotorfit as rf
from rotorfit.identify.fitting.fit import solve_again
from rotorfit.identify.fitting.fit_file import fit_from_json, fit_to_json
from rotorfit.identify.fitting.problem_setup import build_problem
from rotorfit.models import Anisotropic, Muszynska, OneMode, WhirlWhip

RIG = TYPICAL["whirl-whip"]
W = np.r_[-np.linspace(20, 400, 20)[::-1], np.linspace(20, 400, 20)]
CALIBRATION = {"probe_gain": 0.02, "probe_phase_deg": 0.5, "mr": 0.01, "keyphasor_deg": 1.0}


def exact_test(noise=0.005, seed=0, model=None, rig=RIG, frequency=W, **options):
    model = model or WhirlWhip()
    return circular_test(
        model,
        model.vector(rig),
        speeds=(100.0, 200.0),
        frequency=frequency,
        noise=noise,
        seed=seed,
        sigma_known=True,
        **options,
    )


def test_sigma_and_the_probes_gains_are_confounded(rig_fit):
    """Gains a, b of the probes multiply the columns of kappa by 1/a, 1/b: another rotor of the same form.

    Md, Ds, K1 and K2 go with a, D, Mf and Mb with b, sigma with a/b, K0 + K3 with b, and all with the force; lam stays.
    The data cannot tell, so that with loose priors the errors grow to what the priors say.
    """
    u, mr = 0.2, 0.1
    budget = rig_fit.calibration(probe_gain=u, mr=mr)
    pair = u / np.sqrt(2)  # the mean of two probes
    value = {name: p.value for name, p in budget.fit.params.items()}
    one = np.hypot(pair, mr)
    expected = {name: one * value[name] for name in ("Md", "Ds", "K1", "K2", "D", "Mf", "Mb")}
    expected |= {"sigma": np.sqrt(2) * pair * value["sigma"], "K0": one * (value["K0"] + value["K3"]), "lam": 0.0}
    for name, systematic in expected.items():
        share = budget.share(name)
        # what the data say after all, through x and y errors of the estimate, is of the order of the random part
        assert share.systematic == pytest.approx(systematic, rel=1e-6, abs=1e-6 * share.random)
        assert share.random == pytest.approx(rig_fit.params[name].stderr, rel=1e-6)
        assert share.combined == budget.fit.params[name].stderr
        assert share.combined**2 == pytest.approx(share.random**2 + share.systematic**2)
    assert budget.share("sigma").sources["mr"] < 1e-9
    assert rig_fit.params["sigma"].stderr < 0.01 * budget.fit.params["sigma"].stderr
    # the estimates of the gains are what was assumed
    assert budget.fit.params["gain[disk]"].stderr == pytest.approx(pair, rel=1e-6)
    assert budget.fit.params["gain[disk]"].value == pytest.approx(0, abs=1e-6)
    assert budget.threshold_speed().systematic < 1e-6 * budget.threshold_speed().random
    # and redchi beyond one widens what the noise does, not the calibration
    assert rig_fit.redchi > 9
    assert budget.fit.redchi == pytest.approx(rig_fit.redchi, rel=1e-9)


def miscalibrated(model, theta, rng, noise, frequency=W):
    """Data of probes with errors of their own, each x and each y, with a wrong weight and a wrong notch."""
    test = circular_test(
        model, theta, speeds=(100.0, 200.0), frequency=frequency, noise=noise, seed=int(rng.integers(1 << 31)),
        sigma_known=True,
    )  # fmt: skip
    response, degree = test.response.copy(), np.pi / 180
    for plane in model.planes:
        for direction in "xy":
            gain = 1 + CALIBRATION["probe_gain"] * rng.normal()
            lead = CALIBRATION["probe_phase_deg"] * degree * rng.normal()
            response[(test.plane == plane) & (test.direction == direction)] *= gain * np.exp(1j * lead)
    weight = 1 + CALIBRATION["mr"] * rng.normal()
    notch = CALIBRATION["keyphasor_deg"] * degree * rng.normal()
    return replace(test, response=response * weight * np.exp(1j * notch))


def test_pulls_of_miscalibrated_data():
    """Errors over standard errors have variance one with the budget, and far more without it."""
    model, draws = WhirlWhip(), 80
    theta = model.vector(RIG)
    rng = np.random.default_rng(8)
    base = rf.fit(model, exact_test(), known={"K3": 6000.0})
    settings = replace(base.settings, calibration=Calibration(**CALIBRATION))
    names = base.problem.space.names
    truth = np.array([RIG[name] for name in names])
    pulls = {"with": [], "without": []}
    for _ in range(draws):
        test = miscalibrated(model, theta, rng, 0.01)
        for key, own in (("without", base.settings), ("with", settings)):
            fit = solve_again(replace(base, experiments=(test,), settings=own), build_problem(model, test, own))
            assert fit.success
            error = np.array([fit.params[name].stderr for name in names])
            pulls[key].append((fit.x[: truth.size] - truth) / error)
    variance = {key: np.var(rows, axis=0, ddof=1) for key, rows in pulls.items()}
    low, high = stats.chi2.ppf([0.001 / truth.size, 1 - 0.001 / truth.size], draws - 1) / (draws - 1)
    assert (variance["with"] > low).all(), dict(zip(names, variance["with"], strict=True))
    assert (variance["with"] < high).all(), dict(zip(names, variance["with"], strict=True))
    for name in ("D", "sigma", "Md", "K2"):
        assert variance["without"][names.index(name)] > 5


def test_the_random_part_is_what_more_readings_reduce():
    budgets = []
    for repeats in (1, 4):
        tests = [exact_test(seed=seed) for seed in range(repeats)]
        fit = rf.fit(WhirlWhip(), tests, known={"K3": 6000.0})
        budgets.append(fit.calibration(**CALIBRATION))
    one, four = (budget.share("D") for budget in budgets)
    assert four.random == pytest.approx(one.random / 2, rel=0.05)
    assert four.systematic == pytest.approx(one.systematic, rel=0.02)
    assert budgets[0].shares["D"] == (one.random, one.systematic)
    np.testing.assert_allclose(budgets[0].random + budgets[0].systematic, budgets[0].fit.covar)
    assert np.linalg.eigvalsh(budgets[0].random / np.outer(*2 * [np.sqrt(np.diag(budgets[0].fit.covar))])).min() > -1e-9


def test_tables_show_every_source(rig_fit):
    budget = rig_fit.calibration(**CALIBRATION)
    text = budget.summary()
    for word in ("gain[disk]", "probe_phase[journal]", "mr", "keyphasor", "random", "threshold speed", "deg"):
        assert word in text
    assert str(budget) == text
    assert "sigma" in budget.table()
    with refuses(ValueError):
        budget.share("K3")


def test_bootstrap_profile_and_file_know_of_the_calibration():
    fit = rf.fit(WhirlWhip(), exact_test(noise=0.02, seed=1), known={"K3": 6000.0}).calibration(**CALIBRATION).fit
    n = 1000
    boot = fit.bootstrap(n=n, seed=4)
    low, high = stats.chi2.ppf([0.0005 / 10, 1 - 0.0005 / 10], n - 1) / (n - 1)
    for name in fit.problem.space.names:
        assert low < (boot.stderr[name] / fit.params[name].stderr) ** 2 < high, name
    half = 1.959964 * fit.params["D"].stderr
    found = fit.profile("D")
    assert found.upper - found.lower == pytest.approx(2 * half, rel=0.01)
    loaded = fit_from_json(fit_to_json(fit))
    assert loaded.settings.calibration == fit.settings.calibration
    assert loaded.summary() == fit.summary()
    again = rf.fit(fit.model, fit.experiments, known={"K3": 6000.0}, calibration=Calibration(**CALIBRATION))
    np.testing.assert_allclose(again.x, fit.x, rtol=1e-6, atol=1e-7)


def test_a_posterior_has_the_calibration_in_it():
    model = OneMode()
    rig = TYPICAL["one-mode"]
    fit = rf.fit(model, exact_test(model=model, rig=rig), known={"K": 8000.0, "Ds": 8.0})
    budget = fit.calibration(probe_gain=0.02, mr=0.01)
    post = budget.fit.sample(seed=2, ess=2000, progress=False)
    for name in ("D", "lam", "gain[journal]"):
        error = budget.fit.params[name].stderr
        draws = post.parameter(name)
        # 2000 effective draws: the standard deviation is known to 1/sqrt(4000), here five times that
        assert draws.stderr == pytest.approx(error, rel=5 / np.sqrt(4000))


def test_probes_read_apart_have_entries_of_their_own():
    test, other = exact_test(), exact_test(seed=1)
    one_y = other.select(~((other.plane == "disk") & (other.direction == "y")))
    joint = rf.fit(WhirlWhip(), [test, one_y], known={"K3": 6000.0}).calibration(probe_gain=0.01)
    assert joint.fit.problem.space.nuisance == ("gain[journal]", "gain[disk.x]", "gain[disk.y]")
    weights = [np.unique(factors.real, axis=0).tolist() for factors in joint.fit.problem.factors]
    assert weights == [[[0.0, 0.5, 0.5], [1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]]
    single = rf.fit(WhirlWhip(), one_y, known={"K3": 6000.0}).calibration(probe_gain={"disk": 0.01, "journal.x": 0.02})
    sd = [prior.distribution.std() for prior in single.fit.problem.priors]
    assert dict(zip(single.fit.problem.space.nuisance, sd, strict=True)) == {
        "gain[disk]": 0.01,
        "gain[journal]": pytest.approx(0.01),  # half of 2 %, y being perfect
    }
    planes = rf.fit(WhirlWhip(), test, known={"K3": 6000.0}).calibration(mr={"disk": 0.01, "journal": 0.02})
    assert planes.fit.problem.space.nuisance == ("mr[disk]", "mr[journal]")
    xy = exact_test(model=Anisotropic(), rig=TYPICAL["anisotropic"])
    apart = rf.fit(Anisotropic(), xy).calibration(probe_gain=0.01)
    assert apart.fit.problem.space.nuisance == ("gain[journal.x]", "gain[journal.y]")
    assert apart.share("Kxx").systematic == pytest.approx(0.01 * apart.fit.params["Kxx"].value, rel=0.01)
    assert apart.share("Kxy").systematic == pytest.approx(abs(0.01 * apart.fit.params["Kxy"].value), rel=0.01)


def test_a_keyphasor_error_turns_forward_and_backward_apart():
    """A lead of the notch by one degree is found again, with forward and backward sweeps, as what it is."""
    test = exact_test(noise=1e-4)
    turned = replace(test, response=test.response * np.exp(1j * np.pi / 180))
    fit = rf.fit(WhirlWhip(), turned, known={"K3": 6000.0}, calibration=Calibration(keyphasor_deg=2.0))
    p = fit.params["keyphasor"]
    assert p.unit == "rad"
    assert abs(p.value - np.pi / 180) < 4 * p.stderr
    assert abs(fit.params["D"].value - RIG["D"]) < 4 * fit.params["D"].stderr
    blind = rf.fit(WhirlWhip(), turned, known={"K3": 6000.0})
    # A fit that knows nothing of it finds runs whose phase references differ, by as much.
    assert dict(blind.noise.between)["run_phase"] == pytest.approx(np.pi / 180, rel=0.1)
    assert abs(blind.params["D"].value - RIG["D"]) < 4 * blind.params["D"].stderr


def test_robust_losses_and_priors_of_parameters_count_too():
    options = {"known": {"K3": 6000.0}, "priors": {"Mf": stats.norm(0.35, 0.001)}}
    # Readings enough that the residuals, which a robust loss asks for their own scatter, tell it to a few percent.
    test = exact_test(noise=0.02, frequency=np.r_[-np.linspace(20, 400, 80)[::-1], np.linspace(20, 400, 80)])
    plain = rf.fit(WhirlWhip(), test, **options).calibration(probe_gain=0.02)
    robust = rf.fit(WhirlWhip(), test, loss="huber", **options).calibration(probe_gain=0.02)
    for name in ("D", "sigma", "Mf"):
        a, b = plain.share(name), robust.share(name)
        assert a.sources["priors"] > 0
        assert b.systematic == pytest.approx(a.systematic, rel=0.05)
        assert b.combined == pytest.approx(a.combined, rel=0.1)


def test_what_makes_no_sense_is_refused(rig_fit):
    with refuses(ValueError):
        rig_fit.calibration()
    with refuses(ValueError):
        rig_fit.calibration(probe_gain=-0.1)
    with refuses(ValueError):
        rig_fit.calibration(probe_gain={"disk": float("nan")})
    with refuses(ValueError):
        rig_fit.calibration(probe_gain={"disc": 0.01})
    with refuses(ValueError):
        rig_fit.calibration(mr={"seal": 0.01})
    closed = rf.closed_form(rig_fit.model, rig_fit.experiments, known={"K3": 6000.0})
    with refuses(ValueError):
        closed.calibration(mr=0.01)
    model = OneMode(law=Muszynska(), clearance_um=1000.0)
    with refuses(ValueError):
        build_problem(model, exact_test(model=OneMode(), rig=TYPICAL["one-mode"]), replace(
            rig_fit.settings, known={}, calibration=Calibration(mr=0.01)
        ))  # fmt: skip
