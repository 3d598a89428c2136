"""The rotor identified from its own vibration, without an exciter: truth, gradient, files, refusals."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import ks_2samp
from sentences import refuses
from turbulence import ONE_MODE, recorded, written

import rotorfit as rf
from rotorfit.estimators.blocks.operating import unpacked
from rotorfit.estimators.signals.cells import Cells
from rotorfit.identify.diagnosis.free_rotor import likelihood_ratio
from rotorfit.identify.fitting.headline import decrement_of
from rotorfit.identify.fitting.problem_setup import build_problem
from rotorfit.identify.fitting.settings import FitSettings
from rotorfit.lab.kinds.operating_test import operating_test
from rotorfit.models.motion.stability import eigenvalues, threshold_speed

MODEL = rf.models.OneMode()
KNOWN = {"M": 1.0, "K": 7000.0, "Ds": 5.0}


@pytest.fixture(scope="module")
def test() -> rf.OperatingTest:
    return recorded(MODEL, ONE_MODE, np.array([200.0]), minutes=10, seed=3)


@pytest.fixture(scope="module")
def fit(test: rf.OperatingTest) -> rf.FitResult:
    return rf.fit(MODEL, test, known=KNOWN, causes=None)


def test_one_speed_without_force_tells_threshold_and_decrement(fit: rf.FitResult) -> None:
    assert fit.success
    assert abs(fit.redchi - 1) < 5 * np.sqrt(2 / fit.nfree)
    theta = MODEL.vector(ONE_MODE)
    threshold, true = fit.threshold_speed(), threshold_speed(MODEL, theta)
    assert true is not None
    assert abs(threshold.value - true.speed) < 3 * threshold.stderr
    assert threshold.stderr < 0.02 * true.speed
    s = eigenvalues(MODEL, theta, 200.0)[-1]
    mode = max(fit.modes(speed=200.0), key=lambda mode: mode.frequency.value)
    decrement = decrement_of(mode.damping_ratio)
    assert abs(decrement.value + 2 * np.pi * s.real / s.imag) < 3 * decrement.stderr
    # a lone mode without floor has 1 over the root of decrement times cycles
    cycles = s.imag / (2 * np.pi) * 600
    assert 0.9 < decrement.stderr / decrement.value * np.sqrt(decrement.value * cycles) < 1.6


def test_modes_need_no_rotor_and_judge_one(test: rf.OperatingTest) -> None:
    free = rf.fit(rf.models.FreePolynomial(MODEL.planes), test)
    s = eigenvalues(MODEL, MODEL.vector(ONE_MODE), 200.0)[-1]
    mode = max(free.modes(speed=200.0), key=lambda mode: mode.frequency.value)
    assert abs(mode.frequency.value - s.imag) < 3 * mode.frequency.stderr
    assert abs(mode.damping_ratio.value + s.real / abs(s)) < 3 * mode.damping_ratio.stderr
    assert mode.damping_ratio.stderr < 0.03 * mode.damping_ratio.value
    ratio, freedom = likelihood_ratio(rf.fit(MODEL, test, known=KNOWN | {"Mf": 0.2}, causes=None))
    assert freedom == 1
    assert 0 <= ratio < 10.8  # of chi-squared of one degree of freedom one in a thousand is more
    wrong = rf.fit(MODEL, test, known=KNOWN | {"K0": 3000.0, "Mf": 0.4, "lam": 0.42}, causes=None)
    assert "equations" in {one.code for one in wrong.findings}


def test_gradient_of_the_profile_is_that_of_differences(test: rf.OperatingTest) -> None:
    problem = build_problem(MODEL, test, FitSettings(known=KNOWN, causes=None))
    x = 1.02 * np.array([ONE_MODE[name] for name in problem.space.names])
    gradient = problem.gauss_newton(x)[1]
    steps = np.diag(1e-5 * x)
    differences = [(problem.cost(x + step) - problem.cost(x - step)) / 2 / step.sum() for step in steps]
    np.testing.assert_allclose(gradient, differences, rtol=1e-5, atol=1e-6 * np.abs(gradient * x).max() / x.min())


def test_a_rotor_that_is_not_stable_has_no_spectra(test: rf.OperatingTest) -> None:
    problem = build_problem(MODEL, test, FitSettings(known=KNOWN, causes=None))
    mirror = np.array([ONE_MODE[name] for name in problem.space.names])
    mirror[problem.space.names.index("lam")] = 0.6  # beyond its threshold at this speed
    assert not np.isfinite(problem.cost(mirror))


def test_errors_hold_over_draws() -> None:
    """The short form of benchmarks/operating_coverage.py."""
    onset = threshold_speed(MODEL, MODEL.vector(ONE_MODE))
    assert onset is not None
    z = []
    for seed in range(2, 5):
        fit = rf.fit(
            MODEL,
            recorded(MODEL, ONE_MODE, np.array([200.0]), minutes=3, seed=seed, width=0.5),
            known=KNOWN,
            causes=None,
        )
        threshold, D = fit.threshold_speed(), fit.params["D"]
        if seed == 2:  # chance makes a force that turns and falls as likely: the rotor is then less well known
            assert fit.model_uncertainty is not None
            assert threshold.stderr > 0.03 * threshold.value
            assert "internal-problem" not in {finding.code for finding in fit.findings}
        z.append([(threshold.value - onset.speed) / threshold.stderr, (D.value - ONE_MODE["D"]) / D.stderr])
    assert (np.square(z).sum(axis=0) < 16.3).all()  # of 3 draws: one in a thousand is more


def test_the_profile_does_not_depend_on_the_way_there() -> None:
    """A floor that a rotor far away does without is found again, and with it the errors of the rotor."""
    quiet = recorded(MODEL, ONE_MODE, np.array([200.0]), minutes=3, seed=1, floor=42.0)
    problem, fresh = (build_problem(MODEL, quiet, FitSettings(known=KNOWN, causes=None)) for _ in range(2))
    truth = np.array([ONE_MODE[name] for name in problem.space.names])
    for far in ([1000.0, 400.0, 0.4, -0.5], [8000.0, 400.0, 0.4, -0.5], [3000.0, 250.0, 0.38, -0.6]):
        problem.gauss_newton(np.array(far))  # K0, D, lam, Mf
        assert problem.cost(truth) == pytest.approx(fresh.cost(truth), rel=1e-9)
    np.testing.assert_allclose(problem.gauss_newton(truth)[2], fresh.gauss_newton(truth)[2], rtol=1e-5)


def test_the_spectrum_of_the_force_is_chosen_and_kept(
    test: rf.OperatingTest, fit: rf.FitResult, tmp_path: Path
) -> None:
    assert fit.settings.force_spectrum == "white"
    red = replace(test, power=test.power * (2 * np.pi * 10 / test.frequency))  # force and floor fall as 1/f
    fit = rf.fit(MODEL, red, known=KNOWN, causes=None)
    assert fit.settings.force_spectrum.startswith("power")
    threshold, true = fit.threshold_speed(), threshold_speed(MODEL, MODEL.vector(ONE_MODE))
    assert true is not None
    assert abs(threshold.value - true.speed) < 3 * threshold.stderr
    fit.save(tmp_path / "fit.json")
    again = rf.load_fit(tmp_path / "fit.json")
    assert again.settings.force_spectrum == fit.settings.force_spectrum
    np.testing.assert_allclose(again.redchi, fit.redchi, rtol=1e-6)


def test_what_the_rotor_cannot_be_is_warned_of(test: rf.OperatingTest, fit: rf.FitResult) -> None:
    assert not {finding.code for finding in fit.notices}
    hump = 1 + 4 * np.exp(-0.5 * ((test.frequency / (2 * np.pi) - 8.0) / 1.5) ** 2)  # another structure's mode
    humped = rf.fit(MODEL, replace(test, power=test.power * hump), known=KNOWN, causes=None)
    assert "band-residual" in {finding.code for finding in humped.notices}
    taller = recorded(MODEL, ONE_MODE, np.array([200.0]), minutes=10, seed=1, taller=1.2)
    assert "rotary-coherence" in {f.code for f in rf.fit(MODEL, taller, known=KNOWN, causes=None).notices}


def test_one_per_cent_of_anisotropy_is_seen_where_modes_are_sharp() -> None:
    """Wishart draws about the spectra of forward and backward motion that are solved together."""
    values = {"M": 20.0, "K": 3.7e6, "Ds": 558.0, "K0": 1.7e5, "D": 212.0, "lam": 0.45, "Mf": 0.0}
    f, freedom, rng = np.arange(1.0, 110.0, 0.25), 75, np.random.default_rng(1)
    kappa = [1 / MODEL.receptance(MODEL.vector(values), way * 2 * np.pi * f, 968.0)[:, 0, 0] for way in (1, -1)]
    for dK in (0.0, 0.005 * values["K"]):  # half of what stiffness differs by in x and y
        both = np.array([[kappa[0], np.full(f.size, dK)], [np.full(f.size, dK), kappa[1].conj()]]).transpose(2, 0, 1)
        noise = rng.normal(size=(2, f.size, 4, freedom)) / np.sqrt(2)
        force, floor = np.split(noise[0] + 1j * noise[1], 2, axis=1)
        u = np.linalg.solve(both, force) + 1e-7 * floor
        cells = Cells(frequency=f, power=u @ u.conj().mT / freedom, freedom=np.full(f.size, float(freedom)))
        known = {name: values[name] for name in ("M", "K0", "D", "Mf")}
        fit = rf.fit(MODEL, operating_test("run", 968.0, MODEL.planes, cells, {}, ""), known=known, causes=None)
        assert ("rotary-coherence" in {finding.code for finding in fit.notices}) == (dK > 0)


def test_it_is_written_and_read(test: rf.OperatingTest, tmp_path: Path) -> None:
    few = test.select(np.arange(60))
    for name in ("test.csv", "test.nc"):
        rf.write(few, tmp_path / name)
        again = rf.read(tmp_path / name)
        assert isinstance(again, rf.OperatingTest)
        np.testing.assert_allclose(again.power, few.power, rtol=1e-9)
        np.testing.assert_allclose(again.freedom, few.freedom, rtol=1e-9)


def test_recordings_become_spectra_without_orders_and_hum(tmp_path: Path) -> None:
    record = written(tmp_path / "run.h5", minutes=1.5, hum=50.0)
    test = rf.operating_spectra(rf.read_recording(record))
    assert any(finding.code == "foreign-lines" and "50.0" in finding.message for finding in test.findings)
    fit = rf.fit(MODEL, test, known=KNOWN, causes=None)
    assert fit.redchi < 1.25
    assert abs(fit.params["lam"].value - ONE_MODE["lam"]) < 4 * fit.params["lam"].stderr


def test_spectra_are_drawn_as_averages_of_normal_lines_scatter() -> None:
    m, freedom, rng = 4, 9.0, np.random.default_rng(1)
    root = np.tril(rng.normal(size=(m, m)) + 1j * rng.normal(size=(m, m)))
    power = np.tile(root @ root.conj().T, (2000, 1, 1))
    cells = Cells(frequency=np.arange(1.0, 2001.0), power=power, freedom=np.full(2000, freedom))
    model = rf.models.WhirlWhip()
    test = operating_test("run", 200.0, model.planes, cells, {}, "")
    block = test.observe(model, np.zeros(test.run.size, dtype=np.intp))
    block = block.with_noise(np.full(block.sigma.size, np.sqrt(1.5)))
    noise = rng.normal(size=(2, block.measured.size))
    drawn = unpacked(block.measured + block.sigma * block.drawn(noise[0] + 1j * noise[1]), m)
    lines = rng.normal(size=(2, 2000, m, 6)) / np.sqrt(2)  # of 6 degrees of freedom, as noise is wider
    averages = np.einsum("cik,cjk->cij", u := root @ (lines[0] + 1j * lines[1]), u.conj()) / 6
    for of in (lambda P: P[:, 0, 0].real, lambda P: P[:, 0, 3].real, lambda P: np.linalg.slogdet(P)[1]):
        assert ks_2samp(of(drawn), of(averages)).pvalue > 1e-3


def test_fits_of_simulated_spectra_scatter_as_standard_errors_say(fit: rf.FitResult) -> None:
    """The part of them that is not of the choice between two spectra of the force."""
    assert fit.model_uncertainty is not None
    drawn = fit.bootstrap(n=40, seed=1)
    assert "choice among candidate models" in str(drawn)
    assert drawn.failures == 0
    ratio = drawn.samples.std(axis=0, ddof=1) / np.sqrt(np.diag(fit.covar - fit.model_uncertainty))
    assert (np.abs(ratio - 1) < 3 / np.sqrt(2 * 40)).all()


def test_a_posterior_of_spectra_takes_few_walkers(fit: rf.FitResult) -> None:
    """Each vector has its force and floor fitted by itself, so that many at once save nothing."""
    posterior = fit.sample(seed=1, max_steps=2)
    assert posterior.settings.walkers == 32
    assert not posterior.converged


def test_a_robust_loss_and_leaving_readings_out_are_refused(test: rf.OperatingTest, fit: rf.FitResult) -> None:
    with refuses(ValueError):
        rf.fit(MODEL, test, known=KNOWN, loss="huber")
    with refuses(ValueError):
        fit.jackknife()


def test_whirl_that_keeps_its_orbit_is_warned_of(tmp_path: Path) -> None:
    for steady in (0.0, 200e-6):
        test = rf.operating_spectra(rf.read_recording(written(tmp_path / "run.h5", minutes=0.5, steady=steady)))
        assert ("self-excited" in {finding.code for finding in test.findings}) == (steady > 0)


def test_what_tells_no_operating_spectra_is_refused(tmp_path: Path) -> None:
    with refuses(ValueError):
        rf.operating_spectra(rf.read_recording(written(tmp_path / "one.h5", minutes=0.5, probes="X")))
    with refuses(ValueError):
        rf.operating_spectra(rf.read_recording(written(tmp_path / "quick.h5", minutes=0.5, acceleration=0.5)))
    with refuses(ValueError):
        rf.operating_spectra(rf.read_recording(written(tmp_path / "quiet.h5", minutes=0.5, force=1e-9)))
    with refuses(ValueError):
        rf.operating_spectra(rf.read_recording(written(tmp_path / "mark.h5", minutes=0.5, mark=False)))
    with refuses(ValueError):
        rf.operating_spectra(rf.read_recording(written(tmp_path / "short.h5", minutes=0.005)))
