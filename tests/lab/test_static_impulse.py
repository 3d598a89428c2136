"""Static loads, impulses, ring-down records and imposed orbits: alone, together, and as files."""

from __future__ import annotations

import json
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from law_data import (
    CLEARANCE_UM,
    LIGHT,
    WHIRL_WHIP,
    free_vibration,
    impulse,
    off_centre,
    ring_down,
    squeeze,
    static,
    sweep,
    whirl,
)
from plain import plain_fit, summary_words
from scipy.signal import lfilter
from scipy.stats import chi2
from sentences import refuses, warns
from slow_cases import slow_but

import rotorfit as rf
from rotorfit.apps.cli.main import main
from rotorfit.identify.fitting.problem_setup import build_problem
from rotorfit.identify.fitting.result import FitResult
from rotorfit.identify.fitting.settings import FitSettings
from rotorfit.lab.data.rows import NO_COLUMNS, Experiment
from rotorfit.models import Muszynska, OneMode, WhirlWhip

KNOWN = {"Ds": 8.0}


@pytest.fixture(scope="module")
def model() -> OneMode:
    return OneMode(law=Muszynska(), clearance_um=CLEARANCE_UM)


@pytest.fixture(scope="module")
def tests() -> dict[str, Experiment]:
    return {
        "static": static(LIGHT),
        "impulse": impulse(LIGHT),
        "sweep": sweep(LIGHT, levels=(0.5, 1.5, 3.0), lines=30, noise=0.03),
        "squeeze": squeeze(LIGHT, noise=0.03),
    }


@pytest.fixture(scope="module")
def joint(model: OneMode, tests: dict[str, Experiment]) -> FitResult:
    return plain_fit(model, list(tests.values()), known=KNOWN)


def pulls(fit: FitResult, truth: dict[str, float] = LIGHT) -> dict[str, float]:
    return {n: (p.value - truth[n]) / p.stderr for n, p in fit.params.items() if p.vary}


def worst(fit: FitResult, truth: dict[str, float] = LIGHT) -> float:
    return max(map(abs, pulls(fit, truth).values()))


# ---- each alone ---------------------------------------------------------------------------------------


def test_static_loads_give_stiffness_and_the_law(model: OneMode, tests: dict[str, Experiment]) -> None:
    fit = plain_fit(model, tests["static"], known=KNOWN | {"M": 1.2, "Mf": 0.4, "D": 150.0})
    assert fit.success
    assert worst(fit) < 3.5
    assert fit.params["n_K"].stderr < 0.05
    assert np.isinf(fit.band) or fit.band == 0


def test_static_loads_say_what_they_do_not_see(model: OneMode, tests: dict[str, Experiment]) -> None:
    fit = plain_fit(model, tests["static"], known=KNOWN)
    assert {"M", "D", "lam", "Mf"} <= set(fit.identifiability.unresolved)
    assert "M is not observable" in summary_words(fit)
    assert {"K", "K0", "n_K"}.isdisjoint(fit.identifiability.unresolved)


def test_impulses_alone(model: OneMode, tests: dict[str, Experiment]) -> None:
    fit = plain_fit(model, tests["impulse"], known=KNOWN | {"M": 1.2, "Mf": 0.4})
    assert fit.success
    assert worst(fit) < 3.5
    assert fit.params["lam"].value > 0


def test_imposed_orbits_alone(model: OneMode) -> None:
    fit = plain_fit(model, squeeze(LIGHT, speed=120.0, eccentricities=(0.1, 0.4, 0.7, 0.8)), known=KNOWN)
    assert worst(fit) < 3.5
    film = plain_fit(model, squeeze(LIGHT), known=KNOWN | {"lam": 0.46, "b": 0.5})
    assert set(film.identifiability.unresolved) == {"M", "Mf"}
    assert "M + Mf only as a sum" in summary_words(film)


def test_imposed_orbit_has_to_be_at_the_journal() -> None:
    test = replace(squeeze(LIGHT), plane=np.full(80, "disk"))
    with refuses(ValueError):
        plain_fit(WhirlWhip(law=Muszynska(), clearance_um=CLEARANCE_UM), test)


def test_two_planes_under_static_loads_and_forces() -> None:
    model = WhirlWhip(law=Muszynska(), clearance_um=CLEARANCE_UM)
    swept = sweep(WHIRL_WHIP, levels=(1.0, 6.0), lines=40)
    fit = plain_fit(model, [swept, static(WHIRL_WHIP)], known={"K3": 6000.0, "sigma": 1.0})
    assert fit.success
    assert worst(fit, WHIRL_WHIP) < 3.5


def test_linear_rotor_under_static_loads() -> None:
    linear = LIGHT | {"n_K": 0.0, "n_D": 0.0, "b": 0.0}
    test = static(linear, loads=(0.5, 1.0, 1.5, 2.0))
    fit = plain_fit(OneMode(), test, known=KNOWN | {"M": 1.2, "K": 8000.0, "D": 150.0, "Mf": 0.4})
    assert set(pulls(fit, linear)) == {"K0", "lam"}
    assert worst(fit, linear) < 3.5


# ---- all in one ---------------------------------------------------------------------------------------


def test_joint_fit_is_sharper_than_any_alone_and_consistent(
    model: OneMode, tests: dict[str, Experiment], joint: FitResult
) -> None:
    assert joint.success
    assert worst(joint) < 3.5
    assert joint.redchi == pytest.approx(1.0, abs=4 * np.sqrt(2 / joint.nfree))
    assert not joint.identifiability.unresolved
    for name, test in tests.items():
        alone = plain_fit(model, test, known=KNOWN, start={n: LIGHT[n] for n in LIGHT if n != "Ds"})
        for parameter, p in joint.params.items():
            other = alone.params[parameter]
            if not p.vary:
                continue
            assert p.stderr < other.stderr, (name, parameter)
            if other.resolved and name != "impulse":
                # Difference of an estimate and a more efficient one: Hausman's variance.
                spread = np.sqrt(other.stderr**2 - p.stderr**2)
                assert abs(other.value - p.value) < 4 * spread, (name, parameter)


def test_joint_information_is_the_sum(model: OneMode, tests: dict[str, Experiment], joint: FitResult) -> None:
    """Covariance of the joint fit by hand, from the whitened sensitivities of each test."""
    total = np.zeros((joint.x.size, joint.x.size))
    for test in tests.values():
        problem = build_problem(model, test, FitSettings(known=KNOWN))
        _, J = problem.jacobian(joint.x)
        total = total + (J.conj().T @ J).real
    scale = np.abs(joint.x)
    inverse = np.linalg.inv(total * np.outer(scale, scale)) * np.outer(scale, scale)
    errors = [p.stderr for p in joint.params.values() if p.vary]
    np.testing.assert_allclose(errors, np.sqrt(np.diag(inverse)), rtol=1e-6)


def test_quality_is_told_response_by_response(joint: FitResult) -> None:
    names = [quality.name for quality in joint.responses]
    assert "100 rad/s / journal static" in names
    assert "100 rad/s / eigenvalue" in names
    assert "imposed 0 / force at journal" in names
    assert all(quality.nrmse < 0.1 for quality in joint.responses)
    assert joint.speeds.tolist() == [0.0, 100.0, 180.0, 260.0]
    assert joint.band == pytest.approx(410.0)
    assert joint.threshold_speed().stderr < 5.0
    assert "threshold speed" in summary_words(joint)


def test_phase_offsets_are_those_of_turning_forces(model: OneMode, tests: dict[str, Experiment]) -> None:
    problem = build_problem(model, list(tests.values()), FitSettings(known=KNOWN, phase_offsets=True))
    named = [name for name in problem.space.nuisance if name.startswith("phase[")]
    assert named == ["phase[100 rad/s 1.5 N]", "phase[100 rad/s 3 N]", "phase[imposed 0]"]


def test_per_parameter_across_kinds(model: OneMode, tests: dict[str, Experiment]) -> None:
    fit = plain_fit(
        model, [tests["static"], tests["sweep"]], known=KNOWN | {"M": 1.2, "Mf": 0.4}, per={"lam": "speed_rpm"}
    )
    found = [p for n, p in fit.params.items() if n.startswith("lam[")]
    assert len(found) == 3
    assert all(abs(p.value - 0.46) < 3.5 * p.stderr for p in found)


def test_data_that_do_not_see_lam_do_not_call_the_rotor_stable(model: OneMode) -> None:
    fit = plain_fit(model, static(LIGHT), known={"K": 8000.0, "M": 1.2, "Ds": 8.0})
    assert not fit.params["lam"].resolved  # Mf, D and lam of a static load only in combination
    assert np.isinf(fit.threshold_speed().stderr)
    assert "threshold speed: not determined by these data" in summary_words(fit)
    resolved = plain_fit(model, static(LIGHT), known={name: LIGHT[name] for name in ("K", "M", "Ds", "D", "Mf")})
    assert np.isfinite(resolved.threshold_speed().stderr)


# ---- records of free vibration ----------------------------------------------------------------------------


def test_ring_down_gives_the_eigenvalue() -> None:
    test = rf.ring_down_modes(ring_down(LIGHT))
    assert test.runs == ("eps 0", "eps 0.3", "eps 0.6")
    for row, eps in enumerate((0.0, 0.3, 0.6)):
        modes, _ = free_vibration(LIGHT, 180.0, eps)
        # Off centre two modes vibrate; the stronger one is reported.
        error = np.abs(modes - complex(test.eigenvalue[row])).min()
        assert error < 4 * test.sigma[row]
        assert test.sigma[row] < 0.06 * abs(test.eigenvalue[row])
        assert abs(test.position[row]) == pytest.approx(eps * 200e-6, abs=0.2e-6)
    # Fig. 29: damped frequency over speed falls short of lam by little.
    assert test.frequency_ratio[0] == pytest.approx(0.46, rel=0.35)


@pytest.mark.slow
def test_unbalance_in_a_ring_down_is_not_its_mode() -> None:
    """1x and 2x as large as the free vibration: linear in their amplitudes, they leave the mode and its error right."""
    exact = whirl(LIGHT, 180.0, 0.3)
    squares = []
    for seed in range(20):
        record = ring_down(LIGHT, eccentricities=(0.3,), samples=300, seed=seed)
        size = 0.5 * np.ptp(record.x)
        turning = np.exp(1j * (180.0 * record.time + 0.4)) + 0.3 * np.exp(2j * 180.0 * record.time)
        spoiled = replace(record, x=record.x + size * turning.real, y=record.y + size * turning.imag)
        test = rf.ring_down_modes(spoiled)
        squares.append(abs(complex(test.eigenvalue[0]) - exact) ** 2 / test.sigma[0] ** 2)
    low, high = chi2.ppf([1e-4, 1 - 1e-4], 40)
    assert low < sum(squares) < high


def test_unbalance_alone_is_refused_as_a_mode() -> None:
    record = ring_down(LIGHT, eccentricities=(0.3,))
    wave = 1e-5 * np.exp(180.0j * record.time)
    noise = np.random.default_rng(3).normal(size=(2, record.time.size)) * 1e-8
    with refuses(ValueError):
        rf.ring_down_modes(replace(record, x=wave.real + noise[0], y=wave.imag + noise[1]))


def test_ring_down_without_noise_is_exact() -> None:
    test = rf.ring_down_modes(ring_down(LIGHT, noise=0.0, eccentricities=(0.3,)))
    assert abs(complex(test.eigenvalue[0]) - whirl(LIGHT, 180.0, 0.3)) < 1e-6


@pytest.mark.parametrize("passed", slow_but([1.0, 0.2], 0.2))
def test_ring_down_errors_cover(passed: float) -> None:
    """In white noise, and in noise behind a filter of first order that passes a share of each new value."""
    exact = whirl(LIGHT, 180.0, 0.3)
    squares = []
    for seed in range(20):
        record = ring_down(LIGHT, eccentricities=(0.3,), samples=300, noise=0.0, seed=seed)
        noise = np.random.default_rng(seed).normal(size=(2, 350))
        noise = 0.05e-6 * lfilter([passed], [1.0, passed - 1], noise)[:, 50:] * np.sqrt(2 / passed - 1)
        test = rf.ring_down_modes(replace(record, x=record.x + noise[0], y=record.y + noise[1]))
        squares.append(abs(complex(test.eigenvalue[0]) - exact) ** 2 / test.sigma[0] ** 2)
    low, high = chi2.ppf([1e-4, 1 - 1e-4], 40)
    assert low < sum(squares) < high


@pytest.mark.parametrize("centre", slow_but([0.0, 3e-6 - 2e-6j], 3e-6 - 2e-6j))
def test_one_circular_whirl_in_noise_is_found_wherever_it_settles(centre: complex) -> None:
    exact, time, noise = -16.0 + 86.5j, np.linspace(0.0, 0.25, 400), 2e-8
    squares = []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        z = centre + 1e-6 * np.exp(exact * time) + noise * (rng.normal(size=400) + 1j * rng.normal(size=400))
        record = rf.RingDownTest(
            run=np.full(400, "a"), speed=np.full(400, 180.0), time=time, x=z.real, y=z.imag,
            eccentricity=np.full(400, np.nan),
        )  # fmt: skip
        test = rf.ring_down_modes(record)
        squares.append(abs(complex(test.eigenvalue[0]) - exact) ** 2 / test.sigma[0] ** 2)
    low, high = chi2.ppf([1e-4, 1 - 1e-4], 40)
    assert low < sum(squares) < high


def test_several_modes_of_a_record() -> None:
    # Off centre both modes of the 2x2 system vibrate when damping is light.
    light = LIGHT | {"D": 20.0}
    s, _ = free_vibration(light, 180.0, 0.3)
    exact = np.sort_complex(s[s.imag > 1])
    test = rf.ring_down_modes(ring_down(light, eccentricities=(0.3,), noise=1e-9), modes=2)
    assert len(test) == 2
    np.testing.assert_allclose(np.sort_complex(test.eigenvalue), exact, rtol=1e-3)


def test_records_are_fitted_as_they_are(model: OneMode) -> None:
    records = ring_down(LIGHT, eccentricities=(0.0, 0.15, 0.3, 0.45, 0.6))
    known = KNOWN | {"M": 1.2, "Mf": 0.4}
    fit = plain_fit(model, records, known=known)
    assert worst(fit) < 3.5
    reduced = plain_fit(model, rf.ring_down_modes(records), known=known)
    assert fit.params["lam"].value == pytest.approx(reduced.params["lam"].value, rel=1e-9)


@pytest.mark.parametrize(
    "change",
    [
        lambda t: t.select(np.arange(10)),
        lambda t: replace(t, time=t.time**1.1),
        lambda t: replace(t, speed=t.time * 10),
        lambda t: replace(t, x=0.0 * t.x, y=0.0 * t.y),
    ],
)
def test_records_that_cannot_be_analysed(change: Any) -> None:
    with refuses(ValueError):
        rf.ring_down_modes(change(ring_down(LIGHT, eccentricities=(0.3,))))


def test_a_record_without_vibration_is_refused() -> None:
    """Round-off decides whether no mode is left, or one that is lost in its error."""
    record = ring_down(LIGHT, eccentricities=(0.3,))
    with pytest.raises(ValueError, match=r"fewer than 1 vibrating|is unbalance within its error"):
        rf.ring_down_modes(replace(record, x=record.time, y=np.exp(-9 * record.time)))


# ---- noise ----------------------------------------------------------------------------


def test_noise_of_static_loads_from_repeats_and_from_smoothness(model: OneMode) -> None:
    known = KNOWN | {"M": 1.2, "Mf": 0.4, "D": 150.0}
    loads = tuple(np.linspace(2, 45, 24))
    once = static(LIGHT, speeds=(100.0,), loads=loads)
    smooth = plain_fit(model, replace(once, sigma=np.full(24, np.nan)), known=known)
    again = static(LIGHT, speeds=(100.0,), loads=tuple(np.repeat(loads, 3)))
    repeated = plain_fit(model, replace(again, sigma=np.full(72, np.nan)), known=known)
    for fit, error in ((smooth, 0.5), (repeated, 0.35)):
        sigma = fit.problem.blocks[0].sigma
        assert sigma[0] == pytest.approx(0.3e-6, rel=error)
        assert worst(fit) < 3.5


def test_unknown_noise_is_asked_for(model: OneMode) -> None:
    few = replace(static(LIGHT, speeds=(100.0,), loads=(2.0, 9.0, 20.0)), sigma=np.full(3, np.nan))
    with refuses(ValueError):
        plain_fit(model, few)
    hit = replace(impulse(LIGHT), sigma=np.full(10, np.nan))
    with refuses(ValueError):
        plain_fit(model, hit)
    twice = impulse(LIGHT, eccentricities=tuple(np.repeat((0.0, 0.3, 0.5), 4)))
    fit = plain_fit(model, replace(twice, sigma=np.full(24, np.nan)), known=KNOWN | {"M": 1.2, "Mf": 0.4})
    assert fit.problem.blocks[0].sigma[0] == pytest.approx(0.3, rel=0.5)
    table = replace(rf.datasets.seal_muszynska_tum(), sigma=np.full(70, np.nan))
    with refuses(ValueError):
        rf.fit_law(Muszynska(), table)


def test_bad_readings_are_named(model: OneMode) -> None:
    test = static(LIGHT)
    load = test.load.copy()
    load[3] = np.nan
    with refuses(ValueError):
        plain_fit(model, replace(test, load=load))
    with refuses(ValueError):
        plain_fit(OneMode(law=Muszynska(), clearance_um=100.0), test)
    with refuses(ValueError):
        plain_fit(OneMode(planes=("seal",), law=Muszynska(), clearance_um=200.0), test)
    centred = replace(impulse(LIGHT), eccentricity=np.full(10, np.nan))
    with refuses(ValueError):
        plain_fit(model, centred)
    with refuses(ValueError):
        replace(impulse(LIGHT), damping_ratio=np.full(10, 1.2))
    with refuses(ValueError):
        plain_fit(model, replace(off_centre(LIGHT), attributes={"static_x_um": np.full(96, 10.0)}))


def test_position_is_as_good_as_eccentricity(model: OneMode) -> None:
    test = impulse(LIGHT)
    gap = np.full(10, np.nan)
    position = np.array(test.eccentricity * 200e-6 * np.exp(2j), dtype=np.complex128)
    placed = replace(test, eccentricity=gap, position=position)
    settings = FitSettings(known=KNOWN)
    x = np.array([LIGHT[n] for n in model.parameter_names if n != "Ds"])
    a, b = (build_problem(model, t, settings).residuals(x) for t in (test, placed))
    np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-9)


# ---- files ---------------------------------------------------------------------------------


def every_kind() -> list[Experiment]:
    return [
        static(WHIRL_WHIP),
        impulse(LIGHT),
        replace(impulse(LIGHT), eccentricity=np.full(10, np.nan), position=np.linspace(0, 1e-4, 10).astype(complex)),
        ring_down(LIGHT),
        rf.datasets.seal_muszynska_tum(),
        squeeze(LIGHT),
        off_centre(LIGHT),
    ]


@pytest.mark.parametrize("suffix", [".csv", ".nc", ".mat"])
@pytest.mark.parametrize("number", range(7))
def test_files_round_trip(tmp_path: Path, suffix: str, number: int) -> None:
    test = every_kind()[number]
    rf.write(test, tmp_path / f"test{suffix}")
    back = rf.read(tmp_path / f"test{suffix}")
    assert type(back) is type(test)
    for column in fields(test):
        if column.name in NO_COLUMNS:
            continue
        mine, theirs = getattr(test, column.name), getattr(back, column.name)
        if mine.dtype.kind in "UO":
            assert mine.tolist() == theirs.tolist()
        else:
            scale = np.nanmax(np.abs(mine), initial=0.0)
            np.testing.assert_allclose(theirs, mine, rtol=1e-12, atol=1e-13 * scale, err_msg=column.name)
    assert back.attributes.keys() == test.attributes.keys()
    for name, values in test.attributes.items():
        np.testing.assert_allclose(back.attributes[name], values, rtol=1e-14)


def test_static_position_of_a_perturbation_test_in_other_units() -> None:
    test = off_centre(LIGHT)
    x, y = test.attributes["static_x_um"], test.attributes["static_y_um"]
    inches = replace(test, attributes={"static_x_mil": x / 25.4, "static_y_mil": y / 25.4})
    assert test.static_position is not None
    assert inches.static_position is not None
    np.testing.assert_allclose(inches.static_position, test.static_position, rtol=1e-14)
    assert replace(test, attributes={}).static_position is None


def test_joint_fit_from_the_command_line(
    tmp_path: Path, tests: dict[str, Experiment], joint: FitResult, capsys: pytest.CaptureFixture[str]
) -> None:
    files = [tmp_path / f"{name}.csv" for name in tests]
    for file, test in zip(files, tests.values(), strict=True):
        rf.write(test, file)
    words = ["--model", "one-mode", "--law", "muszynska", "--clearance-um", "200", "--known", "Ds=8", "--json"]
    assert main(["fit", *map(str, files), *words]) == 0
    found = json.loads(capsys.readouterr().out)["parameters"]
    for name, parameter in joint.params.items():
        assert found[name]["plain"] == pytest.approx(parameter.value, rel=1e-6)
    study = tmp_path / "study.toml"
    listed = ", ".join(f'"{file.name}"' for file in files)
    settings = 'model = "one-mode"\nlaw = "muszynska"\nclearance_um = 200\nknown = {Ds = 8}\n'
    study.write_text(f"files = [{listed}]\n{settings}", encoding="utf-8")
    assert main(["run", str(study), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["parameters"] == found


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("--law muszinska --clearance-um 200", "did you mean 'muszynska'"),
        ("--law muszynska", "--clearance-um)"),
    ],
)
def test_laws_that_the_command_line_refuses(
    tmp_path: Path, words: str, message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    rf.write(static(LIGHT), tmp_path / "static.csv")
    assert main(["fit", str(tmp_path / "static.csv"), "--model", "one-mode", *words.split()]) == 2
    assert message in capsys.readouterr().err


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "test.csv"
    path.write_text(text, encoding="utf-8")
    return path


def test_minimal_files_and_units(tmp_path: Path) -> None:
    loads = rf.read(written(tmp_path, "speed_rpm,load_lbf,load_deg,x_mil,y_mil\n1000,1,-90,0.1,-0.2\n"))
    assert isinstance(loads, rf.StaticTest)
    assert loads.load[0] == pytest.approx(-4.4482216152605j)
    assert loads.displacement[0] == pytest.approx((0.1 - 0.2j) * 25.4e-6)
    assert loads.planes == loads.force_planes == ("journal",)
    hits = rf.read(written(tmp_path, "speed_rpm,frequency_hz,damping_ratio,x_um,y_um,oil_C\n1000,8,0.1,30,40,45\n"))
    assert isinstance(hits, rf.ImpulseTest)
    assert hits.position[0] == pytest.approx(30e-6 + 40e-6j)
    assert hits.eigenvalue[0] == pytest.approx(16 * np.pi * (1j - 0.1 / np.sqrt(0.99)))
    assert hits.attributes["oil_C"].tolist() == [45.0]
    with warns(rf.DataWarning):
        records = rf.read(written(tmp_path, "run,speed_rpm,time_ms,x_um,y_um\na,1000,0,1,2\na,1000,0.5,3,4\n"))
    assert isinstance(records, rf.RingDownTest)
    assert records.time.tolist() == [0.0, 0.0005]


HEADER = "run,speed_rpm,frequency_rpm,force_plane,force_N,force_phase_deg,plane,direction,amplitude_um,phase_deg"


def test_attributes_do_not_change_the_kind(tmp_path: Path) -> None:
    text = f"{HEADER},load_kg,time_s,damping_ratio\n" + "a,1000,500,disk,1,0,disk,x,10,0,3,4,0.1\n"
    test = rf.read(written(tmp_path, text))
    assert isinstance(test, rf.PerturbationTest)
    assert {"load_kg", "time_s", "damping_ratio"} <= set(test.attributes)


@pytest.mark.parametrize(
    "text",
    [
        "speed_rpm,load_N,load_deg,x_um\n1000,1,0,2\n",
        "load_N,load_deg,x_um,y_um\n1,0,2,3\n",
        "speed_rpm,load_N,load_deg,x_um,y_um\n1000,1,zero,2,3\n",
        "speed_rpm,load_N,load_deg,x_um,y_um,sigma_um\n1000,1,0,2,3,-1\n",
        "speed_rpm,frequency_rpm,damping_ratio\n1000,400,0.1\n",
        "speed_rpm,frequency_rpm,damping_ratio,eccentricity_ratio\n1000,400,1.5,0\n",
        "speed_rpm,frequency_rpm,damping_ratio,eccentricity_ratio\n1000,400,0.1,1.2\n",
        "speed_rpm,time_s,x_um\n1000,0,1\n",
        "speed_rpm,eccentricity_ratio,kxx_N_m\n1000,0,1\n",
    ],
)
def test_files_with_faults(tmp_path: Path, text: str) -> None:
    with refuses(ValueError):
        rf.read(written(tmp_path, text))
