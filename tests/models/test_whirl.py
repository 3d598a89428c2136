"""Whirl beyond the onset against integration in time of the equation of motion, which is written out here."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from law_data import CLEARANCE, CLEARANCE_UM, ONE_MODE, WHIRL_WHIP, fluid, static, sweep
from plain import plain_fit
from scipy.integrate import solve_ivp
from sentences import refuses

import rotorfit as rf
from rotorfit.apps.cli.main import main
from rotorfit.base.array_types import ComplexArray
from rotorfit.lab.simulation.integration import IntegrationError
from rotorfit.lab.simulation.rig import nonlinear_path
from rotorfit.models import EvenPolynomial, Muszynska, OneMode, WhirlWhip, whirl_branch

WHIP = WHIRL_WHIP | {"Ds": 3.0}
"""Lightly damped: its whirl becomes a whip."""


def whirl(
    v: Mapping[str, float], speed: float, orbit: ComplexArray, frequency: float, periods: int = 60
) -> tuple[float, float]:
    """Eccentricity and frequency of the journal long after it circled on an orbit."""

    def motion(t: float, s: np.ndarray) -> np.ndarray:
        z, velocity = s.reshape(2, -1)
        K0, D, lam = fluid(v, min(abs(z[-1]) / CLEARANCE, 0.999))
        turn = 1j * lam * speed
        force = (K0 - D * turn + v["Mf"] * turn**2) * z[-1] + (D - 2 * v["Mf"] * turn) * velocity[-1]
        if "M" in v:
            push = [-(force + v["K"] * z[0] + v["Ds"] * velocity[0]) / (v["M"] + v["Mf"])]
        else:
            disk = (v["K1"] + v["K2"]) * z[0] - v["K2"] * v["sigma"] * z[1] + v["Ds"] * velocity[0]
            journal = force + (v["K3"] + v["K2"] * v["sigma"]) * z[1] - v["K2"] * z[0]
            push = [-disk / v["Md"], -journal / (v["Mb"] + v["Mf"])]
        return np.concatenate([velocity, push])

    n, end = (1 if "M" in v else 2), periods * 2 * np.pi / 150
    start = np.r_[orbit, 1j * frequency * orbit]
    t = np.linspace(0.98 * end, end, 300)
    z = solve_ivp(motion, (0, end), start, t_eval=t, rtol=1e-8, atol=1e-13, method="DOP853").y[n - 1]
    return float(np.abs(z).mean() / CLEARANCE), float(np.polyfit(t, np.unwrap(np.angle(z)), 1)[0])


@pytest.mark.parametrize(("values", "model"), [(ONE_MODE, OneMode), (WHIP, WhirlWhip)])
def test_the_orbit_is_the_one_that_integration_in_time_ends_on(values: dict[str, float], model: type) -> None:
    rotor = model(law=Muszynska(), clearance_um=CLEARANCE_UM)
    branch = whirl_branch(rotor, rotor.vector(values), max_speed=900.0)
    assert branch is not None
    assert branch.eccentricity[0] == 0
    threshold = rf.models.threshold_speed(rotor, rotor.vector(values))
    assert threshold is not None
    assert branch.speed[0] == pytest.approx(threshold.speed, rel=1e-9)
    k = int(np.argmin(np.abs(branch.eccentricity - 0.4)))
    assert branch.stable[k]
    eps, w = whirl(values, float(branch.speed[k]), 0.7 * branch.orbit[k], float(branch.frequency[k]))
    assert eps == pytest.approx(branch.eccentricity[k], rel=1e-3)  # what is left of the transient
    assert w == pytest.approx(branch.frequency[k], rel=1e-3)


def test_a_start_up_runs_through_the_onset(tmp_path: Path) -> None:
    """Against the equation of motion at the speed of the moment, written out here."""
    first, rate, unbalance, v = 230.0, 80.0, 6e-5, ONE_MODE
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
    rig = ["--model", "one-mode", "--law", "muszynska", "--clearance-um", "200", "--kind", "synchronous"]
    rig += [word for name, value in v.items() for word in ("--set", f"{name}={value}")]
    rig += ["--speed-rpm", "2200,3000", "--duration", "0.5", "--unbalance", "6e-5", "--sampling-hz", "2000"]
    assert main(["simulate", *rig, "--recordings", str(tmp_path / "raw"), "--quiet"]) == 0
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


def test_a_whirl_becomes_a_whip() -> None:
    """Whirl at a share of the speed, whip near a bending frequency that the speed no longer moves."""
    rotor = WhirlWhip(law=Muszynska(), clearance_um=CLEARANCE_UM)
    branch = whirl_branch(rotor, rotor.vector(WHIP))
    assert branch is not None
    outward = slice(0, int(np.argmax(branch.speed)))
    ratio = np.gradient(branch.frequency[outward], branch.speed[outward])
    assert branch.speed.max() > 4 * branch.speed[0]
    assert abs(np.median(ratio[len(ratio) // 2 :])) < 0.05  # rad/s a rad/s
    bending = np.sqrt((WHIP["K1"] + WHIP["K2"]) / WHIP["Md"])  # of the disk, the journal held
    assert branch.frequency[outward][-1] == pytest.approx(bending, rel=0.08)


def test_an_unstable_orbit_parts_rest_from_whirl() -> None:
    """Back from the fold the rotor keeps still if let go inside the orbit, and whirls if let go outside."""
    rotor = WhirlWhip(law=Muszynska(), clearance_um=CLEARANCE_UM)
    branch = whirl_branch(rotor, rotor.vector(WHIRL_WHIP))
    assert branch is not None
    fold = int(np.argmax(branch.speed))
    assert branch.stable[1 : fold - 1].all()
    assert not branch.stable[fold + 2 : -2].any()
    back = fold + int(np.argmin(np.abs(branch.eccentricity[fold:] - 0.2)))
    speed, orbit = float(branch.speed[back]), branch.orbit[back]
    assert abs(orbit[-1]) == pytest.approx(branch.eccentricity[back] * CLEARANCE)
    w = float(branch.frequency[back])
    rest, _ = whirl(WHIRL_WHIP, speed, 0.8 * orbit, w, 100)
    assert rest < 0.02
    away, _ = whirl(WHIRL_WHIP, speed, 1.2 * orbit, w, 100)
    outer = float(np.interp(speed, branch.speed[:fold], branch.eccentricity[:fold]))
    assert away == pytest.approx(outer, rel=0.02)


def test_the_band_is_that_of_changed_parameters() -> None:
    rotor = OneMode(law=Muszynska(), clearance_um=CLEARANCE_UM)
    theta = rotor.vector(ONE_MODE)
    branch = whirl_branch(rotor, theta, max_speed=500.0)
    assert branch is not None
    k = len(branch.speed) // 2
    slope = np.gradient(branch.eccentricity, branch.speed)[k]
    for name in ("K0", "lam", "D", "n_K", "b"):
        place = rotor.parameter_names.index(name)
        step = np.zeros(theta.size)
        step[place] = 1e-4 * theta[place]
        sides = [whirl_branch(rotor, theta + sign * step, max_speed=500.0) for sign in (1, -1)]
        ahead, behind = (
            np.interp(branch.speed[k], side.speed, side.eccentricity) for side in sides if side is not None
        )
        by_speed, by_radius = branch.gradient[k, :, place]
        expected = by_radius - slope * by_speed  # the radius at the same speed
        assert (ahead - behind) / (2 * step[place]) == pytest.approx(
            expected, rel=0.03
        )  # points of 0.02, straight between


def test_figures_and_what_they_refuse() -> None:
    rotor = OneMode(law=Muszynska(), clearance_um=CLEARANCE_UM)
    fit = plain_fit(rotor, [sweep(ONE_MODE, levels=(3.0, 30.0), lines=20), static(ONE_MODE)], known={"Ds": 8.0})
    radius, frequency = fit.plot.whirl(max_speed_rpm=6000, unit=("hz", "mil")).axes
    assert "mil" in radius.get_ylabel()
    line = frequency.get_lines()[0].get_xydata()
    assert line[0, 0] == pytest.approx(fit.threshold_speed().value / (2 * np.pi), rel=1e-6)
    _, load = fit.plot.side_load().axes
    assert "N" in load.get_xlabel()
    with refuses(ValueError):
        fit.plot.whirl(max_speed_rpm=1000)
    linear = plain_fit(OneMode(), sweep(ONE_MODE, levels=(0.3,), lines=20), known={"K": 8e3, "Ds": 8.0})
    with refuses(ValueError):
        linear.plot.whirl()
