"""Amplitude-swept tests of rotors whose fluid changes with eccentricity, fitted; laws from tables of coefficients."""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from law_data import (
    CLEARANCE,
    CLEARANCE_UM,
    JUMPING,
    ONE_MODE,
    WHIRL_WHIP,
    free_vibration,
    kappa,
    off_centre,
    orbits,
    squeeze,
    sweep,
)
from plain import moves_of, plain_fit
from scipy.stats import binom, chi2
from sentences import refuses
from synthetic import circular_test

import rotorfit as rf
from rotorfit.estimators.blocks.nonlinear import OrbitResponses
from rotorfit.estimators.misfit.problem import Problem
from rotorfit.identify.fitting.problem_setup import build_problem
from rotorfit.identify.fitting.result import FitResult
from rotorfit.identify.fitting.settings import FitSettings
from rotorfit.lab.data.experiments import PerturbationTest
from rotorfit.lab.data.from_arrays import perturbation_test
from rotorfit.lab.data.rows import Experiment
from rotorfit.models import (
    Chain,
    Constant,
    EvenPolynomial,
    KnownStructure,
    MonotoneSpline,
    Muszynska,
    OneMode,
    WhirlWhip,
)


@pytest.fixture(scope="module")
def model() -> OneMode:
    return OneMode(law=Muszynska(), clearance_um=CLEARANCE_UM)


@pytest.fixture(scope="module")
def swept() -> Experiment:
    return sweep(ONE_MODE, levels=(0.7, 2.0, 4.0, 6.0), speeds=(100.0, 180.0), lines=40)


@pytest.fixture(scope="module")
def fitted(model: OneMode, swept: Experiment) -> FitResult:
    return plain_fit(model, swept, known={"Ds": 8.0})


def pulls(fit: FitResult, truth: dict[str, float]) -> dict[str, float]:
    return {n: (p.value - truth[n]) / p.stderr for n, p in fit.params.items() if p.vary}


def whitened_slopes(problem: Problem, x: np.ndarray) -> np.ndarray:
    columns = []
    for i in range(x.size):
        step = np.zeros_like(x)
        step[i] = 1e-5 * abs(x[i])
        columns.append((problem.residuals(x + step) - problem.residuals(x - step)) / (2 * step[i]))
    return np.array(columns).T


def test_sweeps_to_large_eccentricity_give_every_parameter(swept: Experiment, fitted: FitResult) -> None:
    assert isinstance(swept, rf.PerturbationTest)
    assert 0.65 < np.abs(swept.response).max() / CLEARANCE < 0.75
    assert fitted.success
    assert set(pulls(fitted, ONE_MODE)) == set(ONE_MODE) - {"Ds"}
    assert max(map(abs, pulls(fitted, ONE_MODE).values())) < 3.5
    assert fitted.redchi == pytest.approx(1.0, abs=4 * np.sqrt(2 / fitted.nfree))
    total = fitted.propagate(
        fitted.params["K"].value + fitted.params["K0"].value,
        np.array([n in ("K", "K0") for n in fitted.model.parameter_names], dtype=float),
        "N/m",
    )
    # The sum is far better known than its parts.
    assert total.stderr < 0.2 * fitted.params["K0"].stderr
    assert abs(total.value - 17000.0) < 3.5 * total.stderr
    assert not fitted.identifiability.unresolved


def test_linear_fit_is_rejected(swept: Experiment, fitted: FitResult) -> None:
    linear = plain_fit(OneMode(), swept, known={"Ds": 8.0, "K": 8000.0})
    assert linear.aic > fitted.aic + 1000
    assert linear.bic > fitted.bic + 1000


@pytest.mark.parametrize("law", [EvenPolynomial(3), MonotoneSpline(knots=(0.3, 0.5), reach=0.75)])
def test_laws_without_a_form_follow_the_stiffness(
    swept: Experiment, law: EvenPolynomial | MonotoneSpline, fitted: FitResult
) -> None:
    # K is not told from K0 by these.
    fit = plain_fit(
        OneMode(law=law, clearance_um=CLEARANCE_UM),
        swept,
        known={"Ds": 8.0, "K": 8000.0},
    )
    eps = 0.4
    found = fit.model.dynamic_stiffness(fit.theta(), 150.0, 100.0, eps)[0, 0]
    assert abs(found - kappa(ONE_MODE, 150.0, 100.0, eps)[0, 0]) < 0.05 * abs(found)
    assert fit.aic > fitted.aic  # the right form wins


def data_for(case: str) -> Experiment:
    if case == "imposed":
        return squeeze(ONE_MODE, speed=100.0, lines=10)
    if case == "off centre":
        return off_centre(ONE_MODE)
    return sweep(WHIRL_WHIP if case == "two planes" else ONE_MODE, levels=(3.0, 8.0), lines=10)


@pytest.mark.parametrize("case", ["one mode", "two planes", "imposed", "off centre"])
def test_sensitivities_are_those_of_finite_differences(case: str) -> None:
    kind, truth = (WhirlWhip, WHIRL_WHIP) if case == "two planes" else (OneMode, ONE_MODE)
    rotor = kind(law=Muszynska(), clearance_um=CLEARANCE_UM)
    problem = build_problem(rotor, data_for(case), FitSettings())
    x = 1.02 * rotor.vector(truth)
    _, jacobian = problem.jacobian(x)
    numeric = whitened_slopes(problem, x)
    error = np.abs(jacobian - numeric).max(axis=0) / np.abs(numeric).max(axis=0)
    assert error.max() < 1e-6


def test_exact_data_give_exact_parameters(model: OneMode) -> None:
    test = sweep(ONE_MODE, levels=(2.0, 6.0), speeds=(100.0,), lines=24, noise=0.0)
    fit = plain_fit(model, replace(test, sigma=np.full(len(test), 1e-9)), known={"Ds": 8.0})
    assert max(abs(fit.params[n].value / ONE_MODE[n] - 1) for n in ONE_MODE) < 1e-7


def test_jumps_the_measurement_chooses_the_branch() -> None:
    model = OneMode(law=Muszynska(), clearance_um=CLEARANCE_UM)
    forced = np.array([2.0 + 0j])
    several = [w for w in np.linspace(60, 200, 57) if len(orbits(JUMPING, w, 60.0, forced)) > 1]
    assert several, "the rig has to jump"
    test = sweep(JUMPING, levels=(0.3, 2.0), speeds=(60.0,), lines=60, top=250.0, branch="alternate")
    upper = sweep(JUMPING, levels=(0.3, 2.0), speeds=(60.0,), lines=60, top=250.0, branch=0)
    assert (np.abs(test.response - upper.response) > 0.1 * np.abs(upper.response)).any()
    fit = plain_fit(model, test, known={"Ds": 8.0})
    assert fit.success
    assert max(map(abs, pulls(fit, JUMPING).values())) < 3.5
    assert fit.redchi == pytest.approx(1.0, abs=4 * np.sqrt(2 / fit.nfree))


def swept_over_the_fold(seed: int, upwards: bool) -> PerturbationTest:
    """Two force levels swept up or down as a rig would run: every line on the stable orbit next to the last one's."""
    rng, w = np.random.default_rng(seed), np.linspace(8.0, 250.0, 30)
    parts = []
    for level, sense in itertools.product((0.3, 2.0), (1.0, -1.0)):
        last, z = 0.0, []
        for x in w if upwards else w[::-1]:
            stable = orbits(JUMPING, sense * x, 60.0, np.array([level + 0j]), 120)[::2]
            last, amplitude = min(stable, key=lambda orbit: abs(orbit[0] - last))
            z.append(amplitude[0])
        noise = 1.4e-6 * (rng.normal(size=w.size) + 1j * rng.normal(size=w.size))
        row = {
            "run": f"{level} N {sense:+g}", "speed": 60.0, "frequency": sense * (w if upwards else w[::-1]),
            "force_plane": "journal", "force": level, "plane": "journal", "direction": "z",
            "response": np.array(z) + noise, "sigma": 1.4e-6,
        }  # fmt: skip
        parts.append({key: np.broadcast_to(np.asarray(cell), w.shape) for key, cell in row.items()})
    return perturbation_test(**{key: np.concatenate([part[key] for part in parts]) for key in parts[0]})


def test_sweeps_over_a_fold_do_not_stall() -> None:
    """Up and down with 1.4 um of noise: where a branch ends its last lines are left out, and the search converges."""
    model = OneMode(law=Muszynska(), clearance_um=CLEARANCE_UM)
    tests = [swept_over_the_fold(2, True), swept_over_the_fold(102, False)]
    fit = plain_fit(model, tests, known={"Ds": 8.0})
    assert fit.success
    assert max(map(abs, pulls(fit, JUMPING).values())) < 4
    assert fit.redchi == pytest.approx(1.0, abs=4 * np.sqrt(2 / fit.nfree))
    assert any("jumps from one orbit to another" in warning for warning in fit.warnings)
    again = plain_fit(model, tests, known={"Ds": 8.0})  # what is left out of a test met before is kept
    assert again.ndata == fit.ndata
    assert again.warnings == fit.warnings
    wide = build_problem(OneMode(law=Muszynska(), clearance_um=1e3 * CLEARANCE_UM), tests, FitSettings())
    assert wide.n_data > fit.ndata  # of another clearance the same steps are no jumps


def test_two_planes_with_a_law() -> None:
    model = WhirlWhip(law=Muszynska(), clearance_um=CLEARANCE_UM)
    test = sweep(WHIRL_WHIP, levels=(1.0, 4.0, 8.0), speeds=(100.0,), lines=60, noise=0.005)
    fit = plain_fit(model, test, known={"K3": 6000.0, "sigma": 1.0})
    assert fit.success
    assert max(map(abs, pulls(fit, WHIRL_WHIP).values())) < 3.5


def test_journal_that_was_not_measured_is_followed_along_the_sweep() -> None:
    model = WhirlWhip(law=Muszynska(), clearance_um=CLEARANCE_UM)
    test = sweep(WHIRL_WHIP, levels=(1.0, 4.0), lines=40, noise=0.001)
    disk = test.select(test.plane == "disk")
    block = build_problem(model, disk, FitSettings()).blocks[0]
    assert isinstance(block, OrbitResponses)
    assert block.mode == "followed"
    exact = block.predict(model.vector(WHIRL_WHIP)[None])
    assert np.abs((exact - block.measured) / block.sigma).max() < 5


def test_x_and_y_probes_and_several_levels_in_one_run(model: OneMode, swept: Experiment, fitted: FitResult) -> None:
    assert isinstance(swept, rf.PerturbationTest)
    z, back = swept.response, swept.frequency < 0
    x = np.where(back, z.conj(), z)
    y = np.where(back, 1j * x, -1j * x)
    columns: dict[str, Any] = {
        name: np.concatenate([getattr(swept, name)] * 2) for name in ("speed", "frequency", "force", "force_plane")
    }
    both = perturbation_test(
        run=np.full(2 * len(swept), "all"),
        plane=["journal"] * (2 * len(swept)),
        direction=["x"] * len(swept) + ["y"] * len(swept),
        response=np.concatenate([x, y]),
        sigma=np.sqrt(2) * np.concatenate([swept.sigma] * 2),
        **columns,
    )
    fit = plain_fit(model, both, known={"Ds": 8.0})
    for name, parameter in fit.params.items():
        assert parameter.value == pytest.approx(fitted.params[name].value, rel=1e-6)


def test_closed_form_says_that_there_is_none(model: OneMode, swept: Experiment) -> None:
    with refuses(ValueError):
        rf.closed_form(model, swept)


def test_readings_that_no_law_explains_are_fitted_with_phase_offsets_too(model: OneMode) -> None:
    """No closed form and no short fit comes near them: random starts take the offsets along."""
    exact = sweep(ONE_MODE, levels=(2.0, 8.0), lines=20)
    place = np.abs(exact.frequency) / np.abs(exact.frequency).max()
    fit = plain_fit(
        model, replace(exact, response=exact.response * (1 - 0.5 * np.sin(4 * place) ** 2)), phase_offsets=True
    )
    assert fit.model_limited
    assert any(name.startswith("phase[") for name in fit.params)


def test_orbits_beyond_the_clearance_are_refused(swept: Experiment) -> None:
    with refuses(ValueError):
        plain_fit(OneMode(law=Muszynska(), clearance_um=50.0), swept)


def test_one_reading_beyond_the_clearance_does_not_refuse_the_others(model: OneMode, swept: Experiment) -> None:
    """The fit is that of the data without this line, and says so."""
    response, row = swept.response.copy(), len(swept) // 2
    response[row] *= 1.5 * model.clearance / abs(response[row])
    fit = plain_fit(model, replace(swept, response=response), known={"Ds": 8.0})
    (words,) = [w for w in fit.warnings if "beyond the clearance" in w]
    assert "1 of " in words
    assert f"{swept.run[row]}, {swept.frequency[row]:.4g} rad/s" in words
    without = plain_fit(model, swept.select(np.arange(len(swept)) != row), known={"Ds": 8.0})
    assert fit.x == pytest.approx(without.x, rel=1e-9)


def test_what_the_clearance_moves_is_that_of_a_fit_with_another(fitted: FitResult, swept: Experiment) -> None:
    """Half a percent: what is of second order moves some hundredths of the shift."""
    share = 0.005
    wider = OneMode(law=Muszynska(), clearance_um=CLEARANCE_UM * (1 + share))
    again = plain_fit(wider, swept, known={"Ds": 8.0})
    caused = rf.fit(fitted.model, swept, known={"Ds": 8.0})
    for name in ("n_K", "n_D"):
        moved = again.params[name].value - fitted.params[name].value
        assert share * moves_of(caused, "clearance", name) == pytest.approx(moved, rel=0.05)


def test_off_centre_perturbation(model: OneMode) -> None:
    tests = [off_centre(ONE_MODE, eps=eps, speed=speed) for eps in (0.3, 0.6) for speed in (100.0, 180.0)]
    fit = plain_fit(model, tests, known={"Ds": 8.0})
    assert fit.success
    assert max(map(abs, pulls(fit, ONE_MODE).values())) < 3.5
    # Taken for centred orbits the same readings fit nothing.
    centred = build_problem(model, [replace(test, attributes={}) for test in tests], FitSettings())
    assert 2 * centred.cost(model.vector(ONE_MODE)) > 100 * centred.n_data


def test_table_of_coefficients_gives_back_its_law() -> None:
    table = rf.datasets.seal_muszynska_tum()
    fit = rf.fit_law(Muszynska(), table)
    for name, value in {"n_K": 2.0, "n_D": 2.0, "b": 0.5, "lam": 0.4}.items():
        assert fit.params[name].value == pytest.approx(value, abs=1e-6)
        assert abs(fit.params[name].value - value) < 3.5 * fit.params[name].stderr
    # Two more exponents of the polynomial do not make up for the wrong form.
    assert rf.fit_law(EvenPolynomial(2), table).redchi > 1e3
    assert rf.fit_law(Constant(), table).redchi > 1e6
    with refuses(ValueError):
        plain_fit(WhirlWhip(), table)


def test_chain_and_known_structure_take_laws() -> None:
    names = {"M1": "M", "K1": "K", "Ds1": "Ds"} | {n: n for n in ("K0", "D", "lam", "Mf", "n_K", "n_D", "b")}
    chain = Chain(1, planes=("journal",), fluid="journal", law=Muszynska(), clearance_um=CLEARANCE_UM)
    theta = chain.vector({"K2": 0.0} | {n: ONE_MODE[m] for n, m in names.items()})
    shaft = KnownStructure(
        [[1.2]], [[8.0]], None, [[8000.0]], planes={"journal": 0}, fluid="journal", dofs=("z",), law=Muszynska(),
        clearance_um=CLEARANCE_UM,
    )  # fmt: skip
    vector = shaft.vector({n: ONE_MODE[n] for n in ("K0", "D", "lam", "Mf", "n_K", "n_D", "b")})
    for eps in (0.0, 0.5):
        expected = kappa(ONE_MODE, 130.0, 90.0, eps)
        np.testing.assert_allclose(chain.dynamic_stiffness(theta, 130.0, 90.0, eps), expected, rtol=1e-13)
        np.testing.assert_allclose(shaft.dynamic_stiffness(vector, 130.0, 90.0, eps), expected, rtol=1e-13)
    with refuses(ValueError):
        Chain(2, law=Muszynska(), clearance_um=100.0)
    with refuses(ValueError):
        KnownStructure([[1.0]], None, None, [[1.0]], planes={"a": 0}, dofs=("z",), law=Muszynska(), clearance_um=1.0)
    assert chain.variant(two_lam=True).law == Muszynska()


def test_known_structure_with_a_law_is_fitted() -> None:
    shaft = KnownStructure(
        [[1.2]], [[8.0]], None, [[8000.0]], planes={"journal": 0}, fluid="journal", dofs=("z",), law=Muszynska(),
        clearance_um=CLEARANCE_UM,
    )  # fmt: skip
    fit = plain_fit(shaft, sweep(ONE_MODE, levels=(1.0, 5.0), lines=30))
    assert max(map(abs, pulls(fit, ONE_MODE).values())) < 3.5


@pytest.mark.parametrize("eps", [0.0, 0.5])
def test_threshold_at_an_eccentricity(fitted: FitResult, eps: float) -> None:
    onset = fitted.threshold_speed(eccentricity=eps)
    low, high = 10.0, 2000.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        stable = free_vibration(ONE_MODE, middle, eps)[0].real.max() < 0
        low, high = (middle, high) if stable else (low, middle)
    assert abs(onset.value - low) < 3.5 * onset.stderr
    assert onset.stderr < 0.05 * onset.value
    if eps == 0:
        centred = fitted.threshold_speed()
        assert onset.value == pytest.approx(centred.value, rel=1e-9)
        assert onset.stderr == pytest.approx(centred.stderr, rel=1e-5)


def test_threshold_refuses_what_is_no_eccentricity(fitted: FitResult) -> None:
    with refuses(ValueError):
        fitted.threshold_speed(eccentricity=1.2)


def test_coverage_of_sweeps(model: OneMode) -> None:
    """Pulls of 40 draws: how many lie within 1.96 standard errors, and their mean square, within 1e-4 tails."""
    exact = sweep(ONE_MODE, levels=(1.0, 2.0, 4.0, 6.0), lines=20, noise=0.0)
    size = np.abs(exact.response)
    level = 0.01 * np.array([np.sqrt(np.mean(size[exact.run == run] ** 2)) for run in exact.run.tolist()])
    rng = np.random.default_rng(7)
    rows = []
    for _ in range(40):
        error = level * (rng.normal(size=len(exact)) + 1j * rng.normal(size=len(exact)))
        test = replace(exact, response=exact.response + error, sigma=level)
        fit = plain_fit(model, test, known={"Ds": 8.0}, start=ONE_MODE_FREE)
        rows.append([(p.value - ONE_MODE[n]) / p.stderr for n, p in fit.params.items() if p.vary])
    found = np.array(rows)
    low, high = chi2.ppf([1e-4, 1 - 1e-4], 40)
    assert (np.sum(found**2, axis=0) > low).all()
    assert (np.sum(found**2, axis=0) < high).all()
    few, many = binom.ppf([1e-4, 1 - 1e-4], 40, 0.95)
    inside = np.sum(np.abs(found) < 1.96, axis=0)
    assert (inside >= few).all()
    assert (inside <= many).all()


ONE_MODE_FREE = {name: value for name, value in ONE_MODE.items() if name != "Ds"}


def test_a_law_of_speed_is_fitted_without_a_remark_on_its_start() -> None:
    """lam that grows by a twentieth when the mean speed doubles, at four speeds."""
    model = rf.models.OneMode(law=rf.models.LinearInSpeed(("lam",)))
    names = ("M", "K", "Ds", "K0", "D", "lam", "Mf")
    theta = model.vector({**{name: ONE_MODE[name] for name in names}, "lam_speed": 0.05})
    w = np.concatenate([-np.linspace(250.0, 15.0, 25), np.linspace(15.0, 250.0, 25)])
    test = circular_test(model, theta, speeds=(60.0, 90.0, 120.0, 150.0), frequency=w, noise=0.005, seed=2)
    fit = plain_fit(model, test, known={"K": ONE_MODE["K"], "Ds": ONE_MODE["Ds"]})
    assert fit.success
    assert not [words for words in fit.warnings if "coefficient" in words]
