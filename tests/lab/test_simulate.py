"""The virtual rig: what it measures against the phasor equations, and fits that give its parameters back."""

from __future__ import annotations

from dataclasses import replace
from inspect import signature
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np
import pytest
from law_data import CLEARANCE, fluid
from nonlinear_rigs import CLEARANCE_UM, JUMPING, ONE_MODE, POWER, WHIRL_WHIP
from plain import plain_fit
from scipy.integrate import solve_ivp
from sentences import refuses
from slow_cases import slow_but
from synthetic import TYPICAL

import rotorfit as rf
from rotorfit.lab.data.ring_down import ring_down_modes
from rotorfit.lab.simulation.integration import IntegrationError
from rotorfit.lab.simulation.recordings import RECORDED
from rotorfit.lab.simulation.rig import nonlinear_path
from rotorfit.lab.simulation.simulate import SIMULATED, ExperimentOptions, RecordingOptions
from rotorfit.models import EvenPolynomial, Muszynska, OneMode
from rotorfit.models.motion.off_centre import off_centre_eigenvalues, static_equilibria

RPM = np.pi / 30
VALUES = ONE_MODE | POWER
FREQUENCY_RPM = np.concatenate([-np.linspace(300, 2500, 8), np.linspace(300, 2500, 8)])


def one_mode() -> rf.models.OneMode:
    return rf.models.OneMode(law=rf.models.Muszynska(), clearance_um=CLEARANCE_UM)


def predicted(model: Any, values: dict[str, float], test: Any) -> tuple[np.ndarray, np.ndarray]:
    """Readings and what the phasor equations make of the truth."""
    block = test.observe(model, np.zeros(len(test), dtype=np.intp))
    return block.measured, block.predict(model.vector(values)[None])


@pytest.mark.parametrize(
    ("kind", "options"),
    [
        ("perturbation", {"speed_rpm": [0.0, 1000.0], "frequency_rpm": FREQUENCY_RPM[6:10], "force": [1.0, 4.0j]}),
        ("perturbation", {"speed_rpm": 1000.0, "frequency_rpm": FREQUENCY_RPM[4:12], "unbalance": 3e-4}),
        ("squeeze-film", {"frequency_rpm": FREQUENCY_RPM[6:10], "force": 2.0}),
        ("displacement", {"speed_rpm": 1000.0, "frequency_rpm": FREQUENCY_RPM[6:10], "amplitude_um": [50.0, 120.0]}),
        ("static-load", {"speed_rpm": [500.0, 1000.0], "load": [1.0, 4.0, 8.0]}),
    ],
)
@pytest.mark.parametrize("name", slow_but(["one mode", "whirl and whip"], "whirl and whip"))
def test_noiseless_simulations_are_what_the_phasor_equations_predict(
    kind: str, options: dict[str, Any], name: str
) -> None:
    if name == "one mode":
        model, values = one_mode(), VALUES
    else:
        model = rf.models.WhirlWhip(law=rf.models.Muszynska(), clearance_um=CLEARANCE_UM)
        values = WHIRL_WHIP | POWER
    tolerance = 1e-6 if name == "one mode" else 1e-5
    test = rf.simulate(model, values, kind, noise=1e-12, tolerance=tolerance, **options)
    measured, expected = predicted(model, values, test)
    # ten tolerances count as settled; a force follows from displacements by kappa, whose terms cancel in part
    reach = np.abs(expected).max()
    assert np.abs(measured - expected).max() < (20 if kind == "displacement" else 10) * tolerance * reach


def test_a_small_perturbation_about_a_loaded_position_obeys_the_linearised_equation() -> None:
    model = one_mode()
    test = rf.simulate(
        model,
        VALUES,
        speed_rpm=1000.0,
        frequency_rpm=[-800.0, 500.0],
        force=0.02,
        load=-3j,
        noise=1e-12,
        tolerance=1e-8,
    )
    assert isinstance(test, rf.PerturbationTest)
    position = test.static_position
    assert position is not None
    rest = static_equilibria(model, model.vector(VALUES), 1000 * RPM, [-3j])[0][0]
    # the orbit is about 1 um; its square over the clearance moves the mean
    np.testing.assert_allclose(position, rest, atol=(1e-6) ** 2 / (CLEARANCE_UM * 1e-6))
    measured, expected = predicted(model, VALUES, test)
    np.testing.assert_allclose(measured, expected, atol=1e-4 * np.abs(expected).max())


def test_the_same_data_by_integration_and_by_the_phasor_equation_give_the_same_fit() -> None:
    model = one_mode()
    options: dict[str, Any] = {"speed_rpm": 1000.0, "frequency_rpm": FREQUENCY_RPM, "force": [0.5, 1.5, 3.0, 4.5]}
    exact, integrated = (
        rf.simulate(model, VALUES, noise=noise, seed=1, tolerance=1e-7, **options) for noise in (0.0, 0.01)
    )
    assert isinstance(exact, rf.PerturbationTest)
    assert isinstance(integrated, rf.PerturbationTest)
    single = exact.select(exact.direction == "x")
    _, amplitude = predicted(model, VALUES, replace(single, sigma=np.ones(len(single))))
    x = np.where(single.frequency < 0, amplitude.conj(), amplitude)
    phasor = np.concatenate([x, np.where(single.frequency < 0, 1j, -1j) * x])  # rows are all x, then all y
    equation = replace(integrated, response=integrated.response + phasor - exact.response)
    fits = [plain_fit(model, test, known={"Ds": VALUES["Ds"]}) for test in (integrated, equation)]
    # Cauchy and Schwarz: no least-squares estimate moves by more standard errors than the size of the change over
    # the noise; fits stop within 1e-4 of an error from the minimum
    change = float(np.linalg.norm((phasor - exact.response) / integrated.sigma))
    assert change < 0.01
    for name, parameter in fits[0].params.items():
        if parameter.vary:
            assert abs(parameter.value - VALUES[name]) < 3.5 * parameter.stderr, name
            moved = abs(parameter.value - fits[1].params[name].value) / parameter.stderr
            assert moved < 1.1 * change + 1e-4, name
    assert 0.7 < fits[0].redchi < 1.3


def test_ring_down_records_show_the_eigenvalues_of_the_linearised_rotor() -> None:
    values = JUMPING | POWER
    model = one_mode()
    test = rf.simulate(
        model, values, "impulse", speed_rpm=600.0, load=[0.0, 1.0], impulse=2e-4, noise=1e-6, tolerance=1e-8
    )
    modes = ring_down_modes(test)
    seat = model.vector(values)
    for found, load in zip(modes.eigenvalue, (0.0, -1j), strict=True):
        z = static_equilibria(model, seat, 600 * RPM, [load])[0]
        exact = off_centre_eigenvalues(model, seat, 600 * RPM, float(abs(z[0])) / (CLEARANCE_UM * 1e-6))
        # the vibration, 1e-4 m/s over 100 rad/s, is 1 % of the clearance: its square changes the frequency
        assert np.abs(exact - found).min() < 1e-3 * abs(found)


@pytest.mark.parametrize("damping", slow_but([60.0, 150.0], 60.0))
def test_forward_and_backward_whirl_that_lie_close_are_told_apart_in_noisy_records(damping: float) -> None:
    model, values = one_mode(), JUMPING | POWER | {"D": damping}
    pulls = []
    for seed in range(2):
        test = rf.simulate(
            model, values, "impulse", speed_rpm=[600.0, 1000.0], load=[0.0, 1.0, 4.0], impulse=5e-5, noise=0.02,
            seed=seed, tolerance=1e-6,
        )  # fmt: skip
        block = test.observe(model, np.zeros(len(test), dtype=np.intp))
        pulls.append((block.measured - block.predict(model.vector(values)[None])) / block.sigma)
    squares = np.abs(np.concatenate(pulls)) ** 2 / 2
    # 12 values of mean and standard deviation 1 where the stated errors hold; one mode for both would give 10 to 20
    assert squares.mean() < 1 + 4 / np.sqrt(squares.size)


def test_slow_sweeps_up_and_down_jump_at_different_frequencies() -> None:
    model, values = one_mode(), JUMPING | POWER | {"n_D": 0.5}
    rpm = np.linspace(1170.0, 1370.0, 5)
    sweeps = {
        order: rf.simulate(
            model, values, speed_rpm=480.0, frequency_rpm=rpm, force=1.0, order=order, noise=0.0, tolerance=1e-5
        )
        for order in ("up", "down")
    }
    size = {order: np.abs(test.response[test.direction == "x"]) for order, test in sweeps.items()}
    np.testing.assert_allclose(size["up"][[0, -1]], size["down"][[0, -1]], rtol=1e-3)
    assert (size["up"] / size["down"]).max() > 1.5


@pytest.mark.slow
def test_synchronous_start_ups_give_the_two_disk_rotor_back_whatever_its_residual_unbalance() -> None:
    model, values = rf.models.TwoDisk(), TYPICAL["two-disk"]
    test = rf.simulate(
        model, values, "synchronous", speed_rpm=np.linspace(900, 5200, 18), unbalance=2e-4,
        residual={"inboard": 1e-4j, "outboard": -2e-4}, seed=3, tolerance=1e-5,
    )  # fmt: skip
    fit = plain_fit(model, rf.difference_synchronous(test))
    for name, parameter in fit.params.items():
        if parameter.vary:
            assert abs(parameter.value - values[name]) < 3.5 * parameter.stderr, name


@pytest.mark.slow
def test_models_with_x_and_y_apart_and_with_tilts_are_simulated_too() -> None:
    for name, model in (("anisotropic", rf.models.Anisotropic()), ("overhung", rf.models.Overhung())):
        rpm = np.array([-2500.0, -900.0, 1200.0, 3000.0])
        test = rf.simulate(
            model, TYPICAL[name], speed_rpm=1500.0, frequency_rpm=rpm, force=2.0, noise=1e-12, tolerance=1e-7
        )
        measured, expected = predicted(model, TYPICAL[name], test)
        np.testing.assert_allclose(measured, expected, atol=1e-6 * np.abs(expected).max())


def test_noise_has_the_size_asked_for_and_the_seed_decides_it() -> None:
    model = rf.models.OneMode()
    options: dict[str, Any] = {"speed_rpm": 1000.0, "frequency_rpm": np.linspace(50, 3000, 300), "force": 2.0}
    exact, one, two, same = (
        rf.simulate(model, ONE_MODE, noise=noise, seed=seed, tolerance=1e-4, **options)
        for noise, seed in ((0.0, 0), (0.05, 1), (0.05, 2), (0.05, 1))
    )
    np.testing.assert_array_equal(one.response, same.response)
    assert np.isnan(exact.sigma).all()
    for noisy in (one, two):
        error = (noisy.response - exact.response) / noisy.sigma
        scatter = np.concatenate([error.real, error.imag])
        # 1200 numbers: their variance is 1 within 4 standard deviations sqrt(2 / 1200)
        assert abs(scatter.var() - 1) < 4 * np.sqrt(2 / scatter.size)
        x = noisy.direction == "x"
        rms = np.sqrt(np.mean(np.abs(exact.response[x]) ** 2))
        np.testing.assert_allclose(noisy.sigma[x], 0.05 * rms, rtol=1e-9)


@pytest.mark.parametrize(
    ("change", "error"),
    [
        ({"speed_rpm": 3000.0}, ValueError),
        ({"kind": "perturbations"}, ValueError),
        ({"force": None}, ValueError),
        ({"force": 0.0}, ValueError),
        ({"frequency_rpm": [0.0]}, ValueError),
        ({"frequncy_rpm": 3.0}, TypeError),
        ({"planes": "disk"}, ValueError),
        ({"order": "sideways"}, ValueError),
        ({"noise": -1.0}, ValueError),
        ({"force": 200.0}, IntegrationError),
        ({"load": -500j}, ValueError),
    ],
)
def test_what_cannot_be_simulated_is_refused_in_words(change: dict[str, Any], error: type[Exception]) -> None:
    law = rf.models.EvenPolynomial(1)  # its wall does not stiffen, so that it can be touched
    model = rf.models.OneMode(law=law, clearance_um=CLEARANCE_UM)
    values = ONE_MODE | {"K0_2": 1e4, "D_2": 100.0, "lam_2": -0.3}
    options: dict[str, Any] = {"speed_rpm": 1000.0, "frequency_rpm": [500.0], "force": 1.0} | change
    with refuses(error):
        rf.simulate(model, values, **options)


@pytest.mark.parametrize("kind", sorted(SIMULATED))
def test_missing_options_are_named(kind: str) -> None:
    with refuses(TypeError):
        rf.simulate(one_mode(), VALUES, kind)


def test_equations_that_no_integrator_can_follow_are_refused() -> None:
    options: dict[str, Any] = {"speed_rpm": 100.0, "frequency_rpm": [500.0], "force": 1.0}
    with refuses(ValueError):
        rf.simulate(rf.models.OneMode(), ONE_MODE | {"M": 0.0, "Mf": 0.0}, **options)
    shaft = rf.models.KnownStructure(
        np.eye(2), None, None, np.eye(2) * 1e5, planes={"journal": 0}, fluid="journal", dofs=("z",)
    )
    with refuses(ValueError):
        rf.simulate(shaft, {"K0": 1e4, "D": 400.0, "lam": 0.4, "Mf": 0.1}, **options)
    with refuses(ValueError):
        rf.simulate(rf.models.Anisotropic(), TYPICAL["anisotropic"], "static-load", speed_rpm=100.0, load=1.0)


@pytest.mark.parametrize(("kinds", "options"), [(SIMULATED, ExperimentOptions), (RECORDED, RecordingOptions)])
def test_an_editor_offers_every_option_that_some_kind_has(kinds: dict[str, Any], options: type) -> None:
    taken = {name for kind in kinds.values() for name in signature(kind).parameters} - {"rig"}
    told = set(options.__annotations__)
    assert taken <= told
    rates = {name.removesuffix("_rpm") for name in taken if name.endswith("_rpm")}
    assert told - taken <= rates | {f"{name}_hz" for name in rates}  # the same in rad/s and Hz


def test_what_no_force_moves_is_at_rest_and_no_weight_is_refused() -> None:
    """Steps had no size to be held to, and the integration did not end."""
    model, values = rf.models.OneMode(), ONE_MODE | {"K0": 9000.0, "D": 450.0, "lam": 0.46, "Mf": 0.4}
    values = {name: values[name] for name in model.parameter_names}
    for weight in (0.0, {"journal": 0.0}, -1e-4):
        with refuses(ValueError):
            rf.simulate(model, values, "synchronous", speed_rpm=[300, 600], unbalance=weight)
    with refuses(ValueError):
        rf.simulate(model, values, "synchronous", speed_rpm=[300], unbalance={}, planes="journal")
    cancelled = rf.simulate(
        model, values, "synchronous", speed_rpm=[300, 600], unbalance=1e-4, residual={"journal": -1e-4}, noise=0.0
    )
    assert np.abs(cancelled.response[cancelled.run == "journal 0 deg"]).max() == 0
    assert np.abs(cancelled.response[cancelled.run == "journal 180 deg"]).min() > 0


def test_a_simulated_start_up_runs_through_the_onset(tmp_path: Path) -> None:
    """Against the equation of motion at the speed of the moment, written out here."""
    first, rate, unbalance, v = 230.0, 80.0, 6e-5, VALUES
    rotor = OneMode(law=Muszynska(), clearance_um=CLEARANCE_UM)
    onset = rf.models.threshold_speed(rotor, rotor.vector(v))
    assert onset is not None
    assert first < onset.speed < first + rate

    def push(t: Any) -> Any:
        speed = first + rate * t
        return unbalance * (speed**2 - 1j * rate) * np.exp(1j * (first * t + rate * t**2 / 2))

    def motion(t: float, s: np.ndarray) -> np.ndarray:
        K0, D, lam = fluid(v, abs(s[0]) / CLEARANCE)
        turn = 1j * lam * (first + rate * t)
        force = (K0 - D * turn + v["Mf"] * turn**2 + v["K"]) * s[0] + (D - 2 * v["Mf"] * turn + v["Ds"]) * s[1]
        return np.array([s[1], (push(t) - force) / (v["M"] + v["Mf"])])

    given = {"speed": lambda t: first + rate * t, "force": lambda t: push(t)[:, None], "rate": 500.0, "count": 500}
    path = nonlinear_path(rotor, rotor.vector(v), **given)[:, 0]
    t = np.arange(500) / 500.0
    z = solve_ivp(motion, (0, 1.0), np.zeros(2, complex), t_eval=t, rtol=1e-9, atol=1e-14, method="DOP853").y[0]
    assert np.abs(path - z).max() < 1e-4 * np.abs(z).max()  # steps of 1e-6 over a hundred periods
    quick = {"duration": 0.5, "hole_deg": (0.0,), "speed_rpm": (2200.0, 3000.0)}
    rf.simulate_recordings(rotor, v, tmp_path / "raw", "synchronous", unbalance=6e-5, **quick)
    for file in (tmp_path / "raw").glob("*.h5"):
        z = rf.read_recording(file).motion("journal")
        assert 0.1 * CLEARANCE < np.abs(z[-200:]).max() < CLEARANCE
    soft = OneMode(law=EvenPolynomial(terms=1), clearance_um=CLEARANCE_UM)
    values = {name: value for name, value in v.items() if name not in ("n_K", "n_D", "b")}
    values |= {"K0_2": 0.0, "D_2": 0.0, "lam_2": 0.0}
    with refuses(IntegrationError):
        rf.simulate_recordings(soft, values, tmp_path, "synchronous", unbalance=1e-2, **quick)
    with refuses(ValueError):
        rf.simulate_recordings(rotor, v, tmp_path, "release", speed_rpm=1000)


@pytest.mark.parametrize("name", ["one-mode", "whirl-whip", "anisotropic", "overhung", "two-disk"])
@pytest.mark.parametrize("kind", ["perturbation", "synchronous"])
def test_exact_responses_are_those_of_the_integrated_motion(name: str, kind: str) -> None:
    model, how = rf.models.MODELS[name](), {"noise": 0.0, "tolerance": 1e-8}
    options: dict[str, Any] = {"speed_rpm": [300.0, 600.0]}
    options |= {"unbalance": 1e-4} if kind == "synchronous" else {"frequency_rpm": [-400.0, 300.0], "force": 1.0 + 1j}
    exact = rf.simulate(model, TYPICAL[name], kind, exact=True, **how, **options)
    integrated = rf.simulate(model, TYPICAL[name], kind, **how, **options)
    for column in ("run", "plane", "direction", "force", "frequency"):
        assert (getattr(exact, column) == getattr(integrated, column)).all()
    # ten tolerances count as settled
    assert np.abs(exact.response - integrated.response).max() < 1e-7 * np.abs(exact.response).max()


def test_exact_responses_take_milliseconds_and_are_of_linear_rotors_alone() -> None:
    rotor = rf.models.WhirlWhip()
    options: dict[str, Any] = {"frequency_rpm": np.arange(50, 4000, 20), "force": 1.0}
    begin = process_time()
    test = rf.simulate(rotor, TYPICAL["whirl-whip"], speed_rpm=[500, 1000], exact=True, **options)
    assert process_time() - begin < 2.0  # some 20 ms; integrated it takes tens of seconds
    fit = plain_fit(rotor, test, known={"K3": TYPICAL["whirl-whip"]["K3"]})
    pull = (fit.params["lam"].value - TYPICAL["whirl-whip"]["lam"]) / fit.params["lam"].stderr
    assert abs(pull) < 4.5
    for model, values, kind, more in (
        (one_mode(), VALUES, "perturbation", {}),
        (rotor, TYPICAL["whirl-whip"], "perturbation", {"load": 1.0}),
        (rotor, TYPICAL["whirl-whip"], "static-load", {"load": [1.0]}),
    ):
        given = {"load": [1.0]} if kind == "static-load" else options | more
        with refuses(ValueError):
            rf.simulate(model, values, kind, speed_rpm=500, exact=True, **given)
    with refuses(ValueError):  # unstable there
        rf.simulate(rotor, TYPICAL["whirl-whip"], speed_rpm=20000, exact=True, **options)
