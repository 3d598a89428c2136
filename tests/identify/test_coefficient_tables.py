"""Coefficients as engineers tabulate them, from fluid models and from those with x and y apart."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from drawn import faults_of, points_of
from plain import plain_fit
from seal_rig import FLUID, floating_stator, matrices
from sentences import refuses

import rotorfit as rf
from rotorfit.models import RotorModel
from rotorfit.models.coefficient_tables import COEFFICIENTS, plane_force

RPM = np.pi / 30
FLUIDS: list[tuple[RotorModel, dict[str, float]]] = [
    (rf.models.OneMode(), {"M": 0.0, "K": 0.0, "Ds": 0.0, "K0": 9e3, "D": 450.0, "lam": 0.47, "Mf": 0.4}),
    (
        rf.models.OneMode(two_lam=True),
        {"M": 0.0, "K": 0.0, "Ds": 0.0, "K0": 9e3, "D": 450.0, "lam_D": 0.36, "lam_M": 0.6, "Mf": 0.4},
    ),
    (
        rf.models.OneMode(law=rf.models.Muszynska(), clearance_um=200.0),
        {"M": 0.0, "K": 0.0, "Ds": 0.0, "K0": 9e3, "D": 60.0, "lam": 0.46, "Mf": 0.4, "n_K": 2.0, "n_D": 1.4, "b": 0.5},
    ),
]


@pytest.mark.parametrize(("model", "values"), FLUIDS)
@pytest.mark.parametrize("eccentricity", [0.0, 0.3])
def test_real_matrices_exert_what_the_complex_equation_does(
    model: RotorModel, values: dict[str, float], eccentricity: float
) -> None:
    """Structure zero: what is left is the fluid, whirling forward and backward at any frequency."""
    theta, speed = model.vector(values), 140.0
    K, C, M = plane_force(model, theta, speed, "journal", eccentricity).values
    for w in (-90.0, 35.0, 250.0):
        kappa = K + 1j * w * C - w**2 * M
        x, y = kappa @ np.array([1.0, -1j])  # x + jy = exp(jwt)
        expected = model.dynamic_stiffness(theta, w, speed, eccentricity)[..., 0, 0].item()
        assert complex(x + 1j * y) / 2 == pytest.approx(expected, rel=1e-12)
        assert abs(x - 1j * y) < 1e-9 * abs(x)  # nothing turns the other way


def test_the_structure_is_left_out_and_slopes_are_those_of_differences() -> None:
    model = rf.models.WhirlWhip()
    theta = model.vector(
        {
            "Md": 1,
            "Ds": 3,
            "K1": 1e4,
            "K2": 2e4,
            "sigma": 0.9,
            "Mb": 0.3,
            "K3": 6e3,
            "K0": 1e4,
            "D": 450,
            "lam": 0.47,
            "Mf": 0.4,
        }
    )
    found = plane_force(model, theta, 140.0, "journal")
    (kxx, kxy), (kyx, kyy) = found.values[0]
    assert (kxx, kxy) == pytest.approx((1e4 - 0.4 * (0.47 * 140) ** 2, 450 * 0.47 * 140), rel=1e-12)
    assert (kyy, kyx) == (kxx, -kxy)
    assert found.values[1, 0].tolist() == pytest.approx([450, 2 * 0.47 * 140 * 0.4])
    for k, value in enumerate(theta):
        step = 1e-6 * value
        ends = [
            plane_force(model, theta + sign * step * np.eye(theta.size)[k], 140.0, "journal").values for sign in (1, -1)
        ]
        np.testing.assert_allclose((ends[0] - ends[1]) / (2 * step), found.slopes[..., k], rtol=1e-6, atol=1e-6)


@pytest.fixture(scope="module")
def fit() -> rf.FitResult:
    return plain_fit(rf.models.WhirlWhip(), rf.read(rf.datasets.path("rig_open.csv")), known={"K3": 6000.0})


def test_errors_and_correlations_are_those_of_the_parameters(fit: rf.FitResult) -> None:
    speed = 150.0
    found = fit.coefficients(speed)
    derived = fit.derive(lambda p: p.K0 - p.Mf * (p.lam * speed) ** 2)
    assert (found["Kxx"].value, found["Kxx"].stderr) == pytest.approx((derived.value, derived.stderr), rel=1e-9)
    assert found["Cxx"].stderr == pytest.approx(fit.params["D"].stderr, rel=1e-9)
    assert found.correlation[0, 3] == pytest.approx(1.0)  # Kxx and Kyy are one
    assert found.correlation[1, 2] == pytest.approx(-1.0)
    inertia = fit.derive(lambda p: p.K0 - p.Mf * (120.0 - p.lam * speed) ** 2)
    stiffness = found.effective_stiffness(120.0)
    assert (stiffness.value, stiffness.stderr) == pytest.approx((inertia.value, inertia.stderr), rel=1e-6)
    damping = fit.derive(lambda p: p.D * (120.0 - p.lam * speed) / 120.0)
    assert found.effective_damping(120.0).stderr == pytest.approx(damping.stderr, rel=1e-6)


def test_the_whirl_frequency_ratio_is_where_a_mass_on_the_force_alone_whirls() -> None:
    """Lund's formula against the eigenvalues of a mass at its threshold: damped by none, whirling at the ratio."""
    fluid, rpm = FLUID(3000.0), 3000.0
    table = floating_stator(speeds_rpm=[rpm], fluid=lambda _: fluid, mass=0.0, exact=True)
    fit = plain_fit(
        rf.models.Anisotropic(("stator",)), rf.read(table), known={f"M{i}{j}": 0.0 for i in "xy" for j in "xy"}
    )
    ratio = fit.coefficients(rpm * RPM).whirl_frequency_ratio.value
    K, C, _ = matrices(fluid)

    def growth(mass: float) -> complex:
        A = np.block([[np.zeros((2, 2)), np.eye(2)], [-K / mass, -C / mass]])
        s = np.linalg.eigvals(A)
        return complex(s[np.argmax(s.real)])

    low, high = 0.1, 1000.0
    for _ in range(100):
        middle = np.sqrt(low * high)
        low, high = (middle, high) if growth(middle).real < 0 else (low, middle)
    assert ratio == pytest.approx(abs(growth(low).imag) / (rpm * RPM), rel=1e-6)


def test_a_table_over_speeds_as_csv_and_figure(tmp_path: Path, fit: rf.FitResult) -> None:
    names = [k + i + j for k in "KD" for i in "xy" for j in "xy"]
    test = rf.read(floating_stator(speeds_rpm=[1500.0, 3000.0], mass=0.0, force_noise=0.6, force_sigma=0.6))
    known = {f"M{i}{j}": 0.0 for i in "xy" for j in "xy"}
    found = plain_fit(rf.models.Anisotropic(("stator",)), test, known=known, per=dict.fromkeys(names, "speed_rpm"))
    table = found.coefficient_table()
    table.to_csv(tmp_path / "coefficients.csv")
    back = pd.read_csv(tmp_path / "coefficients.csv")
    assert back["speed_rpm"].tolist() == pytest.approx([1500.0, 3000.0])
    assert back["Kxy"].tolist() == pytest.approx([found.params[f"Kxy[speed_rpm={r}]"].value for r in (1500, 3000)])
    assert (back["Mxx_stderr"] == 0).all()
    assert [line.split()[0] for line in str(table).splitlines()][1:3] == ["Kxx", "Kxy"]
    assert len(found.plot.coefficients().axes) == 5  # K, k, C, c and the ratio; no inertia
    with refuses(ValueError):
        found.coefficients(2000 * RPM)
    with refuses(ValueError):
        fit.coefficients(100.0, plane="nowhere")
    with refuses(KeyError):
        fit.coefficients(100.0)["kxx"]
    assert set(COEFFICIENTS) < set(back.columns)


def test_models_without_fluid_are_refused_in_words() -> None:
    theta = np.ones(len(rf.models.TwoDisk().parameters))
    with refuses(ValueError):
        plane_force(rf.models.TwoDisk(), theta, 100.0, "inboard")


@pytest.mark.parametrize("by", ["speed_rpm", "meant_rpm"])
def test_several_pressures_are_conditions_and_lines_of_their_own(by: str, tmp_path: Path) -> None:
    names = [k + i + j for k in "KD" for i in "xy" for j in "xy"]
    rig = {"speeds_rpm": [1500.0, 3000.0], "mass": 0.0, "force_noise": 0.6, "force_sigma": 0.6}
    tables = [floating_stator(**rig, seed=bar).assign(pressure_bar=bar) for bar in (2, 5)]  # type: ignore[arg-type]
    tables = [table.assign(meant_rpm=table["speed_rpm"] - 20) for table in tables]
    test = rf.read(pd.concat([table.assign(run=table.run + f" {k} bar") for k, table in enumerate(tables)]))
    known = {f"M{i}{j}": 0.0 for i in "xy" for j in "xy"}
    per = dict.fromkeys(names, f"{by}+pressure_bar")
    fit = plain_fit(rf.models.Anisotropic(("stator",)), test, known=known, per=per)
    conditions = [f"pressure_bar={bar}, {rpm} rpm" for bar in (2, 5) for rpm in (1500, 3000)]
    assert [row.condition for row in fit.coefficient_table().rows] == conditions
    figure = fit.plot.coefficients()
    (first, *_) = figure.axes
    curves = [container.lines[0] for container in first.containers]
    assert [np.round(curve.get_xdata(), -2).tolist() for curve in curves] == [[1500.0, 3000.0]] * 4
    assert {"pressure 2 bar", "pressure 5 bar"} == {text.get_text() for text in first.texts}
    drawn = {tuple(np.round(curve.get_ydata(), 6)) for curve in curves}
    table = fit.coefficient_table().rows
    assert drawn == {
        tuple(np.round([row[name].value / 1e6 for row in table if f"bar={bar}," in row.condition], 6))
        for bar in (2, 5)
        for name in ("Kxx", "Kyy")
    }
    assert faults_of(figure) == []
    page = rf.write_report(fit, tmp_path / "a.html", figure_format="none").read_text(encoding="utf-8")
    assert page.index('id="coefficients"') < page.index('id="parameters"')
    assert all(f"<td>{condition}</td>" in page for condition in conditions)
    crossed = fit.plot.dynamic_stiffness().axes[2]  # stator.x by stator.y alone: its mirror image has the other sign
    assert points_of(crossed)[:, 1].min() > 0


def test_a_summary_of_six_conditions_fits_on_a_screen() -> None:
    """K, C, M and the whirl frequency ratio by condition in place of 72 lines, each with the numbers of the table."""
    speeds, bars = (1500.0, 3000.0, 4500.0), (15.0, 30.0)
    tables = [
        floating_stator(speeds_rpm=speeds, mass=0.0, motion_noise=0.1, sigma_um=0.1, seed=seed).assign(
            pressure_bar=bar, run=lambda own, bar=bar: own["run"] + f" {bar:g} bar"
        )
        for seed, bar in enumerate(bars)
    ]
    names = [kind + row + column for kind in "KDM" for row in "xy" for column in "xy"]
    per = dict.fromkeys(names, "speed_rpm+pressure_bar")
    fit = rf.fit(rf.models.Anisotropic(("stator",)), rf.read(pd.concat(tables)), per=per)
    lines = fit.summary().splitlines()
    assert len(lines) <= 60
    assert max(map(len, lines)) <= 88
    rows = {line.split()[0]: line for line in reversed(lines) if "+" in line.split(" ")[0]}  # the first of each
    for row in fit.coefficient_table().rows:
        rpm, bar = round(row.speed / RPM), row.condition.partition("pressure_bar=")[2].partition(",")[0]
        own = next(line for line in lines if line.startswith(f"{rpm}+{bar} "))
        assert row["Kxx"].to("MN/m").shown().number in own
    assert set(rows) >= {f"{rpm:g}+{bar:g}" for rpm in speeds for bar in bars}
