"""What a fit promises beyond its numbers: joint data, groups, priors, bounds, error bars, honest failures."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from own_model import Disk
from plain import plain_fit, summary_words, table_row
from scipy import stats
from sentences import refuses
from slow_cases import slow_but
from synthetic import MODELS, SPEEDS, TYPICAL, circular_test, covering_frequencies, known_of

import rotorfit as rf
from rotorfit.estimators.misfit.problem import LOSSES, robust_weights
from rotorfit.estimators.starting.closed_form import ClosedFormError
from rotorfit.identify.fitting.fit import fitted
from rotorfit.identify.fitting.settings import FitSettings
from rotorfit.lab.data.from_arrays import perturbation_test
from rotorfit.lab.kinds.displacement_test import DisplacementTest
from rotorfit.models import (
    Anisotropic,
    Chain,
    OneMode,
    TwoDisk,
    WhirlWhip,
)

FLUID = {name: TYPICAL["one-mode"][name] for name in ("K", "Ds")}


def one_mode_test(noise=0.01, seed=0, speeds=(100.0, 180.0), lines=80, truth=TYPICAL["one-mode"], **options):
    model = OneMode()
    theta = model.vector(truth)
    frequency = covering_frequencies(model, theta, speeds, lines)
    return circular_test(model, theta, speeds=speeds, frequency=frequency, noise=noise, seed=seed, **options)


PULLED = ("K0", "D", "lam")


# ---- sensitivities --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("loss", LOSSES)
def test_gradient_and_hessian_against_differences(name, loss):
    model, truth = MODELS[name](), TYPICAL[name]
    theta = model.vector(truth)
    test = circular_test(
        model, theta, speeds=SPEEDS[name], frequency=covering_frequencies(model, theta, SPEEDS[name], 20), noise=0.05
    )
    test = replace(test, sigma=np.full(len(test), 0.02 * float(np.abs(test.response).max())))
    fit = plain_fit(model, test, known=known_of(name, truth), loss=loss, phase_offsets=True)
    x = fit.x * 1.01 + np.where(fit.x == 0, 0.01, 0)
    cost, gradient, gauss_newton = fit.problem.gauss_newton(x)
    assert cost == pytest.approx(fit.problem.cost(x))
    h = 1e-6 * np.abs(x)
    for i in range(x.size):
        d = np.zeros(x.size)
        d[i] = h[i]
        slope = (fit.problem.cost(x + d) - fit.problem.cost(x - d)) / (2 * h[i])
        # Truncation h^2 relative, round-off eps cost / h.
        noise = 1e-14 * cost / h[i] + 1e-9 * abs(gradient * x).max() / abs(x[i])
        assert slope == pytest.approx(gradient[i], rel=1e-5, abs=noise)
    if loss == "linear":
        # On exact data the Gauss-Newton matrix is the Hessian.
        w = covering_frequencies(model, theta, SPEEDS[name], 20)
        exact = circular_test(model, theta, speeds=SPEEDS[name], frequency=w)
        exact = replace(exact, sigma=np.full(len(exact), 0.01 * float(np.abs(exact.response).max())))
        fit = plain_fit(model, exact, known=known_of(name, truth))
        gauss_newton = fit.problem.gauss_newton(fit.x)[2]
        scale = np.sqrt(np.diag(gauss_newton))
        hessian = fit.problem.hessian(fit.x)
        np.testing.assert_allclose(hessian / np.outer(scale, scale), gauss_newton / np.outer(scale, scale), atol=1e-6)


@pytest.mark.parametrize("loss", LOSSES)
def test_robust_losses_against_their_definition(loss):
    from scipy.optimize import least_squares

    r = np.array([0.01, 0.5, 2.0, 9.0, 120.0])
    rho, weight = robust_weights(loss, r**2)
    reference = least_squares(lambda x: r * x[0], [1.0], loss=loss, f_scale=2.0, max_nfev=1).cost
    assert rho.sum() / 2 == pytest.approx(reference)
    h = 1e-6 * r**2
    np.testing.assert_allclose(weight, (robust_weights(loss, r**2 + h)[0] - rho) / h, rtol=1e-4)


# ---- error bars that cover ------------------------------------------------------------------------------------------


@cache
def fits_of_draws(name, draws=80):
    """Fits of a typical rig under many draws of 1 % noise."""
    model, truth = MODELS[name](), TYPICAL[name]
    theta = model.vector(truth)
    frequency = covering_frequencies(model, theta, SPEEDS[name], 60)
    tests = (
        circular_test(model, theta, speeds=SPEEDS[name], frequency=frequency, noise=0.01, seed=seed, sigma_known=True)
        for seed in range(draws)
    )
    return [plain_fit(model, test, known=known_of(name, truth)) for test in tests]


@pytest.mark.parametrize("name", slow_but(MODELS, "one-mode", "whirl-whip", "anisotropic"))
def test_standard_errors_cover(name):
    """Normalised errors over noise draws: chi-squared consistent, 95 % intervals within binomial error.

    Of 80 draws, chi-squared tells an error bar that is too small by a quarter, or too large by a third.
    """
    truth, fits = TYPICAL[name], fits_of_draws(name)
    draws = len(fits)
    pulls = np.array([[(p.value - truth[n]) / p.stderr for n, p in fit.params.items() if p.vary] for fit in fits])
    # Bonferroni over the parameters at 1 %.
    level = 0.01 / pulls.shape[1] / 2
    low, high = stats.chi2.ppf([level, 1 - level], draws)
    assert np.all((np.sum(pulls**2, axis=0) > low) & (np.sum(pulls**2, axis=0) < high))
    inside = np.sum(np.abs(pulls) < 1.96, axis=0)
    assert np.all(inside >= stats.binom.ppf(level, draws, 0.95))
    assert np.all(inside <= stats.binom.ppf(1 - level, draws, 0.95))


def test_threshold_error_covers():
    truth = TYPICAL["one-mode"]
    exact = rf.models.threshold_speed(OneMode(), OneMode().vector(truth)).speed
    pulls = []
    for fit in fits_of_draws("one-mode"):
        onset = fit.threshold_speed()
        pulls.append((onset.value - exact) / onset.stderr)
    low, high = stats.chi2.ppf([0.005, 0.995], len(pulls))
    assert low < np.sum(np.square(pulls)) < high


def test_robust_errors_cover_with_outliers():
    truth = TYPICAL["one-mode"]
    pulls = []
    for seed in range(60):
        test = one_mode_test(seed=seed, sigma_known=True)
        rng = np.random.default_rng(1000 + seed)
        hit = rng.random(len(test)) < 0.03
        gross = 1 + 4 * np.exp(2j * np.pi * rng.random(len(test)))  # of no preferred sense: no bias, much scatter
        test = replace(test, response=np.where(hit, test.response * gross, test.response))
        fit = plain_fit(OneMode(), test, known=FLUID, loss="huber")
        pulls.append([(fit.params[n].value - truth[n]) / fit.params[n].stderr for n in ("D", "lam", "Mf")])
    low, high = stats.chi2.ppf([0.01 / 6, 1 - 0.01 / 6], len(pulls))
    total = np.sum(np.square(pulls), axis=0)
    assert np.all((low < total) & (total < high))


def test_noise_that_is_overestimated_is_told():
    rig = rf.datasets.rig_open()
    honest = plain_fit(WhirlWhip(), rig, known={"K3": 6000.0})
    noisy = replace(rig, sigma=np.full(len(rig), 1e-5))
    told = plain_fit(WhirlWhip(), noisy, known={"K3": 6000.0})
    assert told.redchi < 0.5
    assert any("the noise is overestimated" in warning for warning in told.warnings)
    assert not any("overestimated" in warning for warning in honest.warnings)


def test_noise_is_found_and_redchi_means_something():
    redchi = [plain_fit(OneMode(), one_mode_test(seed=seed), known=FLUID).redchi for seed in range(20)]
    # sigma^2 of each of four sweeps from 40 to 80 samples: relative error of redchi near 0.1; mean of 20.
    assert np.mean(redchi) == pytest.approx(1.0, abs=0.1)


# ---- several tests in one fit ---------------------------------------------------------------------------------------


def test_joint_fit_of_squeeze_film_and_spinning_tests_is_sharper():
    truth = TYPICAL["one-mode"]
    spinning = one_mode_test(seed=1, sigma_known=True)
    squeeze = one_mode_test(seed=2, speeds=(0.0,), sigma_known=True)
    alone = plain_fit(OneMode(), spinning, known=FLUID)
    joint = plain_fit(OneMode(), [spinning, squeeze], known=FLUID)
    for name in ("K0", "D", "M", "Mf", "lam"):
        assert joint.params[name].stderr < alone.params[name].stderr
        assert abs(joint.params[name].value - truth[name]) < 4 * joint.params[name].stderr


def test_one_value_for_each_speed():
    cold, warm = TYPICAL["one-mode"], TYPICAL["one-mode"] | {"D": 380.0}
    tests = [one_mode_test(seed=3, speeds=(100.0,), truth=cold), one_mode_test(seed=4, speeds=(180.0,), truth=warm)]
    fit = plain_fit(OneMode(), tests, known=FLUID, per={"D": "speed_rpm"})
    names = [name for name in fit.params if name.startswith("D[")]
    assert names == ["D[speed_rpm=954.929659]", "D[speed_rpm=1718.873385]"]
    for name, value in zip(names, (450.0, 380.0), strict=True):
        assert abs(fit.params[name].value - value) < 4 * fit.params[name].stderr
    shared = plain_fit(OneMode(), tests, known=FLUID)
    assert shared.bic > fit.bic
    with refuses(ValueError):
        fit.threshold_speed()
    slow = fit.threshold_speed(at={"speed_rpm": 954.929659})
    assert np.isfinite(slow.stderr)
    assert fit.threshold_speed(at={"speed_rpm": 100 * 30 / np.pi}).value == slow.value  # not the ten digits of the name
    with refuses(KeyError):
        plain_fit(OneMode(), tests, known=FLUID, per={"D": "temperature"})
    every = plain_fit(OneMode(), tests, known={"M": cold["M"], "K": cold["K"]}, per={"K*": "speed_rpm"})
    assert {n.partition("[")[0] for n in every.params if "[" in n} == {"K0"}  # K is known
    with pytest.raises(KeyError, match=r"no fitted parameter of one-mode is like 'Q\*'; there are D, lam"):
        plain_fit(OneMode(), tests, known=cold | {"D": None, "lam": None}, per={"Q*": "speed_rpm"})
    both = [
        replace(test, attributes={"bar": np.full(len(test), bar)}) for test, bar in zip(tests, (2.0, 3.5), strict=True)
    ]
    together = plain_fit(OneMode(), both, known=FLUID, per={"D": "speed_rpm+bar"})
    assert [name for name in together.params if "[" in name] == [
        "D[speed_rpm+bar=954.929659+2]",
        "D[speed_rpm+bar=1718.873385+3.5]",
    ]
    assert together.threshold_speed(at={"speed_rpm+bar": "954.929659+2"}).value == pytest.approx(slow.value, rel=1e-9)


def test_imposed_orbit_gives_the_same_fluid():
    """Displacement in, force out (eqs 14 to 17): the dynamic stiffness itself, the same parameters."""
    truth, model = TYPICAL["one-mode"], OneMode()
    theta, rng = model.vector(truth), np.random.default_rng(5)
    w = np.concatenate([-np.linspace(5, 250, 60)[::-1], np.linspace(5, 250, 60)])
    orbit = 20e-6 * np.exp(0.3j)
    z = np.where(w < 0, np.conj(orbit), orbit)
    force = model.dynamic_stiffness(theta, w, 120.0)[:, 0, 0] * z
    x = np.where(w < 0, force.conj(), force)
    y = np.where(w < 0, 1j, -1j) * x
    sigma = 0.005 * float(np.sqrt(np.mean(np.abs(force) ** 2)))

    def noisy(values):
        return values + sigma * (rng.normal(size=w.size) + 1j * rng.normal(size=w.size))

    test = DisplacementTest(
        run=np.where(w < 0, "backward", "forward"), speed=np.full(w.size, 120.0), frequency=w,
        plane=np.full(w.size, "journal"), displacement=np.full(w.size, orbit), force_x=noisy(x), force_y=noisy(y),
        sigma=np.full(w.size, np.nan),
    )  # fmt: skip
    for result in (plain_fit(model, test, known=FLUID), rf.closed_form(model, test, known=FLUID)):
        for name in ("K0", "D", "lam", "M", "Mf"):
            assert abs(result.params[name].value - truth[name]) < 4 * result.params[name].stderr
        assert result.redchi == pytest.approx(1, abs=0.4)


def test_phase_reference_offsets_are_found():
    test = one_mode_test(noise=0.003)
    run = next(run for run in test.runs[1:] if run.endswith("-1"))  # a backward one
    shifted = replace(test, response=test.response * np.where(test.run == run, np.exp(0.08j), 1.0))
    plain = plain_fit(OneMode(), shifted, known=FLUID)
    fit = plain_fit(OneMode(), shifted, known=FLUID, phase_offsets=True)
    offset = fit.params[f"phase[{run}]"]
    assert abs(offset.value - 0.08) < 4 * offset.stderr
    assert fit.redchi < 0.5 * plain.redchi


def test_priors_resolve_what_data_leave_open():
    fit = plain_fit(OneMode(), one_mode_test(), known={"Ds": 8.0}, priors={"K": stats.norm(8000.0, 50.0)})
    assert not fit.identifiability.unresolved
    assert fit.params["K"].stderr == pytest.approx(50.0, rel=0.01)
    assert fit.params["K"].value == pytest.approx(8000.0, abs=5.0)
    # A gamma prior of the same mean and spread says nearly the same; a bound by a uniform prior holds.
    gamma = plain_fit(OneMode(), one_mode_test(), known={"Ds": 8.0}, priors={"K": stats.gamma(25600, scale=0.3125)})
    assert gamma.params["K"].value == pytest.approx(fit.params["K"].value, abs=5.0)


def test_priors_bound_the_fit_by_their_support_however_narrow_they_are():
    """The closed form may lie outside the support, and a density above one makes no cost below zero."""
    test = one_mode_test(noise=1e-6)
    fit = plain_fit(OneMode(), test, known=FLUID, priors={"lam": stats.uniform(0.40, 0.05)})
    bounded = plain_fit(OneMode(), test, known=FLUID, bounds={"lam": (0.40, 0.45)})
    assert fit.success
    assert fit.params["lam"].at_bound
    assert fit.params["lam"].value == pytest.approx(0.45, abs=1e-6)
    assert fit.params["D"].value == pytest.approx(bounded.params["D"].value, rel=1e-6)
    narrow = plain_fit(OneMode(), test, known=FLUID, priors={"lam": stats.truncnorm(-2, 2, 0.46, 1e-7)})
    assert narrow.success
    assert narrow.params["lam"].value == pytest.approx(0.46, abs=3e-7)


def test_a_bound_of_one_side_is_given_with_none():
    test = rf.read(rf.datasets.path("rig_lumped.csv"))
    params = plain_fit(WhirlWhip(), test, known={"K3": 6000.0}, bounds={"lam": (0.0, None), "D": (None, 900.0)}).params
    assert (params["lam"].min, params["lam"].max) == (0.0, 2.0)
    assert (params["D"].min, params["D"].max) == (-np.inf, 900.0)


def test_bounds_hold_and_are_reported():
    fit = plain_fit(OneMode(), one_mode_test(), known=FLUID, bounds={"lam": (0.3, 0.44)})
    assert fit.params["lam"].at_bound
    assert fit.params["lam"].value == pytest.approx(0.44, abs=1e-6)
    assert any("rests on its bound" in warning for warning in fit.warnings)


# ---- missing probes and planes --------------------------------------------------------------------------------------


def test_a_single_probe_is_taken_as_a_circular_orbit():
    test = one_mode_test(noise=1e-6)
    for direction in "xy":
        fit = plain_fit(OneMode(), test.select(test.direction == direction), known=FLUID)
        assert fit.params["lam"].value == pytest.approx(0.46, rel=1e-4)


def test_without_a_closed_form_several_starts_are_taken():
    model, truth = WhirlWhip(), TYPICAL["whirl-whip"]
    theta = model.vector(truth)
    test = circular_test(
        model,
        theta,
        speeds=(100.0, 200.0),
        frequency=covering_frequencies(model, theta, (100.0, 200.0), 100),
        noise=0.01,
    )
    disk = test.select(test.plane == "disk")
    with refuses(ClosedFormError):
        rf.closed_form(model, disk, known={"K3": 6000.0})
    fit = plain_fit(model, disk, known={"K3": 6000.0, "sigma": truth["sigma"]})
    assert fit.redchi < 1.3
    assert any("no closed form" in warning and "starts was taken" in warning for warning in fit.warnings)
    for name in ("D", "lam", "Md"):
        assert abs(fit.params[name].value - truth[name]) < 4 * fit.params[name].stderr


def test_force_at_one_plane_of_two_disks():
    """Force balance in place of the inverse: one force plane is enough when both probes are there."""
    model, truth = TwoDisk(), TYPICAL["two-disk"]
    theta = model.vector(truth)
    w = covering_frequencies(model, theta, (0.0,), 200)
    test = circular_test(model, theta, speeds=(0.0,), frequency=w, noise=0.002, force_planes=("inboard",))
    for result in (rf.closed_form(model, test), plain_fit(model, test)):
        for name in ("M1", "M2", "K2"):
            assert abs(result.params[name].value - truth[name]) < 4 * result.params[name].stderr


def test_anisotropic_rig_needs_an_anisotropic_model():
    model, truth = Anisotropic(), TYPICAL["anisotropic"]
    theta = model.vector(truth)
    w = covering_frequencies(model, theta, (0.0,), 120)
    test = circular_test(model, theta, speeds=(0.0,), frequency=w, noise=0.003)
    fit = plain_fit(model, test)
    for name in ("Kxx", "Kxy", "Kyx", "Kyy", "Dxx", "Mxy"):
        assert abs(fit.params[name].value - truth[name]) < 4 * fit.params[name].stderr


# ---- honest failures ------------------------------------------------------------------------------------------------


def test_an_unstable_fit_says_that_no_rig_was_measured_there():
    model, truth = OneMode(), TYPICAL["one-mode"]
    theta = model.vector(truth)
    speed = 1.3 * rf.models.threshold_speed(model, theta).speed
    w = np.concatenate([-np.linspace(5, 400, 60)[::-1], np.linspace(5, 400, 60)])
    fit = plain_fit(model, circular_test(model, theta, speeds=(speed,), frequency=w, noise=0.01), known=FLUID)
    assert any("could not have been measured there" in warning for warning in fit.warnings)


def test_a_fit_cut_short_is_a_result_that_says_so():
    test = one_mode_test()
    start = {"M": 30.0, "K0": 1e6, "D": 5.0, "lam": 0.1, "Mf": 5.0}
    # from these values alone: the start that the data give is the optimum
    settings = FitSettings(known=FLUID, start=start, max_iterations=1, causes=None)
    fit = fitted(OneMode(), (test,), settings)
    assert not fit.success
    assert "did not converge" in fit.warnings[0]
    # Its curvature tells nothing of the error: no bars.
    assert table_row(fit, "lam")[2] == "-"
    assert "threshold speed: not given" in summary_words(fit)
    assert all(np.isnan(p.stderr) and np.isnan(p.stderr) for p in fit.params.values() if p.vary)
    assert np.isnan(fit.propagate(1.0, np.ones(len(OneMode().parameters)), "1").stderr)
    assert np.isfinite(fit.x).all()


@pytest.mark.parametrize(
    ("options", "error"),
    [
        ({"known": {"lambda": 0.4}}, KeyError),
        ({"known": {"K": np.nan}}, ValueError),
        ({"known": {"M": -1.0}}, ValueError),
        ({"bounds": {"D": (500.0, 100.0)}}, ValueError),
        ({"loss": "hubr"}, ValueError),
        ({"per": {"DD": "speed_rpm"}}, KeyError),
        ({"start": {"Q": 1.0}}, KeyError),
        ({"priors": {"D": 450.0}}, ValueError),
        ({"known": {"D": 1.0}, "per": {"D": "speed_rpm"}}, ValueError),
    ],
)  # fmt: skip
def test_bad_settings(options, error):
    with refuses(error):
        plain_fit(OneMode(), one_mode_test(lines=20), **options)


def test_bad_data():
    test = one_mode_test(lines=20)
    with refuses(ValueError):
        plain_fit(OneMode(planes=("seal",)), test)
    broken = replace(test, response=np.where(np.arange(len(test)) == 3, np.nan, test.response))
    with refuses(ValueError):
        plain_fit(OneMode(), broken)
    with refuses(ValueError):
        plain_fit(OneMode(), [])
    few = perturbation_test(
        run="a", speed=100.0, frequency=[10.0, 20.0], force_plane="journal", force=1.0, plane="journal", direction="z",
        response=[1e-5, 1e-5], sigma=1e-7,
    )  # fmt: skip
    with refuses(ValueError):
        plain_fit(OneMode(), few)
    with refuses(ValueError):
        plain_fit(OneMode(), replace(few, sigma=np.full(2, np.nan)))
    with refuses(ValueError):
        rf.refine(plain_fit(OneMode(), test, known=FLUID))
    rig = rf.datasets.rig_open()
    with refuses(ValueError):
        rf.dynamic_stiffness(rig.select(rig.force_plane == "journal"))


def test_refinement_is_advised_only_where_it_is_not_refused():
    """One plane has no structure to add, and what the data leave open comes first: both are refused by rf.refine."""
    rig = rf.datasets.rig_open()
    journal = rig.select((rig.plane == "journal") & (rig.force_plane == "journal"))
    fits = {
        "one plane": plain_fit(OneMode(), journal, known=FLUID),
        "open": plain_fit(WhirlWhip(), rig),
        "complete": plain_fit(WhirlWhip(), rig, known={"K3": 6000.0}),
    }
    advised = {}
    for name, fit in fits.items():
        (limited,) = [warning for warning in fit.warnings if "limits this fit" in warning]
        advised[name] = "rf.refine" in limited
    again = replace(fits["complete"].settings.asked, refined=True)  # whose blocks were chosen
    (limited,) = [text for text in fitted(WhirlWhip(), [rig], again).warnings if "limits this fit" in text]
    advised["refined"] = "rf.refine" in limited
    assert advised == {"one plane": False, "open": False, "complete": True, "refined": False}
    assert any("what the data leave open first (K3, K0)" in warning for warning in fits["open"].warnings)
    for name in ("one plane", "open"):
        with refuses(ValueError):
            rf.refine(fits[name])


# ---- reading a result -----------------------------------------------------------------------------------------------


def test_measured_dynamic_stiffness_lies_on_the_model():
    model, truth = WhirlWhip(), TYPICAL["whirl-whip"]
    theta = model.vector(truth)
    test = circular_test(
        model, theta, speeds=(100.0,), frequency=covering_frequencies(model, theta, (100.0,), 100), noise=0.01
    )
    measured = rf.dynamic_stiffness(test)
    miss = (measured.kappa - model.dynamic_stiffness(theta, measured.frequency, 100.0)) / measured.sigma
    # First-order propagation of 1 % noise; kappa at high frequency is nearly linear in it.
    assert np.median(np.abs(miss) ** 2) / (2 * np.log(2)) == pytest.approx(1.0, rel=0.25)


def test_summary_shows_what_a_reader_needs():
    fit = plain_fit(OneMode(), one_mode_test(), known=FLUID)
    text = fit.summary()
    for word in ("lam", "stderr", "known", "redchi", "identifiability", "threshold speed", "rpm", "whirl ratio"):
        assert word in text
    assert text.startswith(str(fit))
    modes = fit.natural_frequencies(100.0)
    assert len(modes) == 2
    assert all(np.isfinite(frequency.stderr) and np.isfinite(damping.stderr) for frequency, damping, _ in modes)
    quality = fit.responses[0]
    assert 0 < quality.nrmse < 0.05
    assert quality.frac > 0.99


def test_a_robust_fit_tells_a_wrong_model_from_outliers():
    wrong_model = plain_fit(WhirlWhip(), rf.datasets.rig_open(), known={"K3": 6000.0}, loss="huber")
    assert any("not outliers but the model limits this fit" in warning for warning in wrong_model.warnings)
    model, values = WhirlWhip(), TYPICAL["whirl-whip"]
    theta = model.vector(values)
    w = covering_frequencies(model, theta, (100.0, 200.0), 100)
    test = circular_test(model, theta, speeds=(100.0, 200.0), frequency=w, noise=0.01, seed=2)
    outlier = np.random.default_rng(3).random(len(test)) < 0.05
    test = replace(test, response=np.where(outlier, 20 * test.response, test.response))
    for loss in ("soft_l1", "huber", "cauchy"):
        fit = plain_fit(model, test, known={"K3": values["K3"]}, loss=loss)
        assert fit.redchi > 2  # the outliers' own share
        assert not any("limits this fit" in warning for warning in fit.warnings)


def test_standard_errors_of_robust_fits_to_few_readings():
    """Pulls of 60 fits to 14 readings: their mean square is one, within chance (chi-squared, p > 1e-3 for each).

    The plain sandwich takes residuals, which few readings keep small, for the noise: it gives 1.9 for K0 here;
    the limit is 1.71.
    """
    pulls = []
    for seed in range(60):
        test = one_mode_test(noise=0.005, seed=seed, speeds=(100.0,), lines=15, sigma_known=True)
        fit = plain_fit(OneMode(), test, known={**FLUID, "M": 1.2}, loss="soft_l1")
        pulls.append([(fit.params[n].value - TYPICAL["one-mode"][n]) / fit.params[n].stderr for n in PULLED])
    mean_square = (np.array(pulls) ** 2).mean(axis=0)
    low, high = stats.chi2.ppf([5e-4, 1 - 5e-4], len(pulls)) / len(pulls)
    assert (mean_square > low).all()
    assert (mean_square < high).all()


def test_results_and_experiments_print_short():
    rig = rf.datasets.rig_open()
    assert repr(rig) == "<PerturbationTest rig_open.csv: 4032 readings in 8 runs, at disk, journal, 1000, 2000 rpm>"
    fit = plain_fit(WhirlWhip(), rig, known={"K3": 6000.0})
    assert repr(fit).startswith("<FitResult whirl-whip, least squares: 10 values from 4032 data, redchi 10.63, conv")


def test_fit_of_a_chain_of_three():
    values = {"M1": 0.9, "M2": 0.5, "M3": 0.3, "K1": 1.4e4, "K2": 1.5e4, "K3": 1.2e4, "K4": 6e3, "Ds1": 3.0, "Ds2": 2.0}
    values |= {"Ds3": 0.0, "K0": 1e4, "D": 300.0, "lam": 0.45, "Mf": 0.2}
    model = Chain(planes=("disk", "coupling", "seal"), fluid="seal")
    theta = model.vector(values)
    speeds = (80.0, 160.0)
    test = circular_test(
        model, theta, speeds=speeds, frequency=covering_frequencies(model, theta, speeds, 120), noise=0.01, seed=5
    )
    # K0 and the last spring stand side by side: only their sum shows in the data.
    open_ = plain_fit(model, test, known={"Ds3": 0.0})
    assert {"K0", "K4"} <= set(open_.identifiability.unresolved)
    fit = plain_fit(model, test, known={"Ds3": 0.0, "K4": 6e3})
    assert fit.success
    for name in set(values) - {"Ds3", "K4"}:
        assert abs(fit.params[name].value - values[name]) < 4 * fit.params[name].stderr, name


def test_measured_dynamic_stiffness_of_an_anisotropic_rig():
    """Eq. (7) with forward and backward runs gives the model's kappa in x and y back."""
    model = Anisotropic(("a", "b"))
    rng = np.random.default_rng(5)
    base = {"Kxx": 2e4, "Kyy": 2.5e4, "Dxx": 30.0, "Dyy": 40.0, "Mxx": 1.0, "Myy": 1.1}
    p = {q.name: (base.get(q.name[:3], 0.0) if q.name[-2:] in ("11", "22") else 0.0) for q in model.parameters}
    p = {name: value + 0.05 * q.scale * rng.normal() for (name, value), q in zip(p.items(), model, strict=True)}
    theta = model.vector(p)
    w = covering_frequencies(model, theta, (0.0,), 20)
    measured = rf.dynamic_stiffness(
        circular_test(model, theta, speeds=(0.0,), frequency=w), ("a", "b"), isotropic=False
    )
    exact = model.dynamic_stiffness(theta, measured.frequency, 0.0)
    np.testing.assert_allclose(measured.kappa, exact, rtol=1e-8, atol=1e-8 * np.abs(exact).max())


def test_a_model_of_ones_own_fits_from_its_own_closed_form():
    model = Disk()
    truth = {"M": 2.0, "K0": 3e4, "D": 200.0, "lam": 0.45}
    w = np.concatenate([-np.linspace(5, 250, 60)[::-1], np.linspace(5, 250, 60)])
    test = circular_test(model, model.vector(truth), speeds=(100.0,), frequency=w)
    fit = plain_fit(model, test)
    for name, expected in truth.items():
        assert fit.params[name].value == pytest.approx(expected, rel=1e-8)
    assert fit.threshold_speed().value == pytest.approx(np.sqrt(3e4 / 2) / 0.45, rel=1e-6)


def test_a_pure_number_at_its_bound_has_no_unit() -> None:
    test = rf.datasets.rig_open()
    fit = plain_fit(rf.models.WhirlWhip(), test, known={"K3": 6000.0}, bounds={"lam": (0.2, 0.4)}, max_iterations=30)
    assert any(w.endswith("lam rests on its bound at 0.4") for w in fit.warnings)
