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
