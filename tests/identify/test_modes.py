"""Modes of a fitted rotor: the paper's numbers, another solver's, their errors, half-power and MAC beside them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from plain import plain_fit
from scipy.linalg import eig, eigh
from sentences import refuses
from synthetic import SPEEDS, TYPICAL, circular_test, covering_frequencies, known_of

import rotorfit as rf
from rotorfit.apps.cli.main import main
from rotorfit.identify.fitting.structure.modes import half_power, own_modes
from rotorfit.models import MODELS, TwoDisk


@pytest.fixture(scope="module")
def fit() -> rf.FitResult:
    return plain_fit(TwoDisk(), rf.datasets.two_disk())


def test_the_papers_numbers_come_out(fit: rf.FitResult) -> None:
    """To what it printed: phi by eye to half a hundredth, what was computed with it so much off, zeta to two digits."""
    paper, modes = rf.datasets.published_two_disk(), fit.modes()
    K2, K23, M2 = paper["K2"], paper["K2"] + paper["K3"], paper["M2"]
    for mode, number in zip(modes, ("I", "II"), strict=True):
        phi, printed = mode.shape["outboard"].value, paper[f"phi_{number}"]
        assert abs(phi - printed) < 0.0065
        assert mode.shape["inboard"].value == 1.0
        mass, stiffness, damping = mode.mass, mode.stiffness, mode.damping
        assert mass is not None
        assert stiffness is not None
        assert damping is not None
        off = abs(phi - printed)
        assert abs(mass.value - paper[f"M_{number}"]) < 0.006 + 2 * M2 * off
        assert abs(stiffness.value - paper[f"K_{number}"]) < 600 + 2 * abs(K23 * phi - K2) * off
        assert mode.damping_ratio.value == pytest.approx(paper[f"zeta_{number}"], abs=0.0005)
        assert damping.value == pytest.approx(paper[f"D_{number}"], rel=0.0005 / 0.03 + 0.005)
        assert mode.half_power == pytest.approx(mode.damping_ratio.value, rel=0.1)  # a reading each 1 % of the speed
        assert mode.frequency.value == pytest.approx(np.sqrt(stiffness.value / mass.value), rel=1e-12)
    table = str(modes)
    assert "half-power" in table
    assert "at outboard" in table


def test_the_command_gives_the_modes_too(fit: rf.FitResult, tmp_path: Path) -> None:
    """As columns, and in the report as they are printed."""
    data = str(rf.datasets.path("two_disk.csv"))
    assert (
        main(["fit", data, "--model", "two-disk", "--out", str(tmp_path), "--no-figures", "--quiet", "--no-causes"])
        == 0
    )
    table = pd.read_csv(tmp_path / "modes.csv")
    for number, (mode, row) in enumerate(zip(fit.modes(), table.itertuples(), strict=True), 1):
        assert mode.mass is not None
        assert row.mode == number
        assert (row.mass_kg, row.mass_kg_stderr) == pytest.approx((mode.mass.value, mode.mass.stderr), rel=1e-6)
        assert row.shape_outboard == pytest.approx(mode.shape["outboard"].value, rel=1e-6)
        assert row.half_power == pytest.approx(mode.half_power, rel=1e-6)
    report = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "half-power" in report
    assert fit.modes().rows()[1][4] in report
    damped = plain_fit(rf.models.WhirlWhip(), rf.datasets.rig_lumped(), known={"K3": 6e3})
    assert own_modes(damped) is None


def test_modes_of_a_passive_rotor_are_another_solvers(fit: rf.FitResult) -> None:
    p = {name: parameter.value for name, parameter in fit.params.items()}
    K = np.array([[p["K1"] + p["K2"], -p["K2"]], [-p["K2"], p["K2"] + p["K3"]]])
    squares, vectors = eigh(K, np.diag([p["M1"], p["M2"]]))
    modes = fit.modes(normalise="outboard")
    np.testing.assert_allclose([m.frequency.value for m in modes], np.sqrt(squares), rtol=1e-10)
    np.testing.assert_allclose([m.shape["inboard"].value for m in modes], vectors[0] / vectors[1], rtol=1e-10)


def test_modes_with_a_fluid_are_another_solvers() -> None:
    """The state matrix of eq. (18), written out."""
    p, speed = TYPICAL["whirl-whip"], 200.0
    model = MODELS["whirl-whip"]()
    w = covering_frequencies(model, model.vector(p), SPEEDS["whirl-whip"], 40)
    test = circular_test(model, model.vector(p), speeds=SPEEDS["whirl-whip"], frequency=w)
    fit = plain_fit(model, test, known=known_of("whirl-whip", p))
    turn = 1j * p["lam"] * speed
    fluid = p["K0"] - p["D"] * turn + p["Mf"] * turn**2
    K = np.array([[p["K1"] + p["K2"], -p["K2"] * p["sigma"]], [-p["K2"], p["K3"] + p["K2"] * p["sigma"] + fluid]])
    C = np.diag([p["Ds"], p["D"] - 2 * p["Mf"] * turn])
    M = np.diag([p["Md"], p["Mb"] + p["Mf"]])
    s, vectors = eig(np.block([[np.zeros((2, 2)), np.eye(2)], [-np.linalg.solve(M, K), -np.linalg.solve(M, C)]]))
    modes = fit.modes(speed)
    for mode in modes:
        k = int(np.argmin(np.abs(s.imag - mode.frequency.value)))
        assert mode.mass is None
        assert mode.frequency.value == pytest.approx(s[k].imag, rel=1e-6, abs=1e-4)
        assert mode.damping_ratio.value == pytest.approx(-s[k].real / abs(s[k]), rel=1e-6)
        assert mode.vector[1] == pytest.approx(vectors[1, k] / vectors[0, k], rel=1e-5)


def test_errors_of_modes_are_the_spread_of_fits_to_simulated_tests() -> None:
    model, truth = TwoDisk(), TYPICAL["two-disk"]
    theta = model.vector(truth)
    w = covering_frequencies(model, theta, (0.0,), 40)
    rows = []
    for seed in range(60):
        test = circular_test(model, theta, speeds=(0.0,), frequency=w, noise=0.02, seed=seed, sigma_known=True)
        first, _ = plain_fit(model, test).modes()
        rows.append(
            [
                (q.value, q.stderr)
                for q in (first.frequency, first.damping_ratio, first.mass, first.damping, first.shape["outboard"])
                if q
            ]
        )
    values, errors = np.moveaxis(np.array(rows), 2, 0)
    ratio = values.std(axis=0, ddof=1) / errors.mean(axis=0)
    assert (np.abs(ratio - 1) < 3.5 / np.sqrt(2 * 59)).all()  # standard error of a standard deviation of 60


@pytest.mark.parametrize("zeta", [0.01, 0.0299, 0.06])
@pytest.mark.parametrize("off", [0.0, 0.25, 0.5, 0.75])
def test_half_power_does_not_depend_on_where_the_lines_are(zeta: float, off: float) -> None:
    w = np.linspace(100, 1000, 120) + off * 900 / 119  # the bandwidth of the least damped is less than a step
    size = np.abs(1 / (300.0**2 - w**2 + 2j * zeta * 300.0 * w))
    assert half_power([(w, size)], 300.0) == pytest.approx(zeta, rel=2 * zeta**2 + 1e-6)  # by its definition


def test_half_power_is_the_damping_ratio_of_one_mode() -> None:
    w = np.linspace(50.0, 150.0, 801)
    for zeta in (0.01, 0.03, 0.06):
        size = 1 / np.abs(100.0**2 - w**2 + 2j * zeta * 100.0 * w)
        assert half_power([(w, size)], 100.0) == pytest.approx(zeta, rel=4 * zeta**2 + 0.01)
    assert np.isnan(half_power([(w[:300], size[:300])], 100.0))  # no peak inside
    assert np.isnan(half_power([], 100.0))


def test_shapes_are_compared(fit: rf.FitResult) -> None:
    modes = fit.modes()
    np.testing.assert_allclose(modes.mac([[1.0, 1.0], [0.984, -0.939]]), np.eye(2), atol=0.003)
    assert modes.mac({"outboard": 2.0, "inboard": 2.0}).shape == (2, 1)
    with refuses(KeyError):
        modes.mac({"outbaord": [1.0], "inboard": [1.0]})
    with refuses(ValueError):
        modes.mac({"outboard": [1.0]})
    with refuses(KeyError):
        fit.modes(normalise="middle")


def test_the_half_power_bandwidth_is_that_of_the_readings_wherever_the_lines_are() -> None:
    """On 120 lines, two or three to the bandwidth of the first mode, and with causes, which change no reading."""
    model, force = TwoDisk(), 5.0
    p = {"M1": 0.73, "M2": 0.79, "K1": 18900.0, "K2": 63700.0, "K3": 22600.0}
    p |= {"D11": 14.2, "D12": 7.0, "D21": 7.0, "D22": 14.8}
    mass, springs = (
        np.diag([p["M1"], p["M2"]]),
        np.array([[p["K1"] + p["K2"], -p["K2"]], [-p["K2"], p["K2"] + p["K3"]]]),
    )
    dampers, rng = np.array([[p["D11"], -p["D12"]], [-p["D21"], p["D22"]]]), np.random.default_rng(5)
    motion_by_state = np.hstack([-np.linalg.solve(mass, springs), -np.linalg.solve(mass, dampers)])
    poles = np.linalg.eigvals(np.vstack([np.eye(4)[2:], motion_by_state]))
    zeta = np.sort(-poles.real[poles.imag > 0] / np.abs(poles[poles.imag > 0]))
    for begin in (15.0, 25.0, 37.0):
        w = np.linspace(begin, 520.0, 120)
        motion = np.array([np.linalg.solve(springs - v**2 * mass + 1j * v * dampers, [force, 0.0]) for v in w]).T
        sigma = 0.002 * np.sqrt(np.mean(np.abs(motion) ** 2, axis=1, keepdims=True)) * np.ones(w.size)
        motion = motion + sigma * (rng.normal(size=(2, *motion.shape)).transpose(1, 2, 0) @ [1, 1j])
        test = rf.perturbation_test(
            run="a", speed=100.0, frequency=np.tile(w, 2), force_plane=model.planes[0], force=force,
            plane=np.repeat(model.planes, w.size), direction="z", response=motion.ravel(), sigma=sigma.ravel(),
        )  # fmt: skip
        modes = rf.fit(model, test).modes()
        np.testing.assert_allclose([mode.half_power for mode in modes], zeta, rtol=0.05)  # the other mode adds to each
