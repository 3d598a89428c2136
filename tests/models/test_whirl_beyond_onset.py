"""Whirl beyond the onset against integration in time of the equation of motion, which is written out here."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest
from law_data import CLEARANCE, CLEARANCE_UM, ONE_MODE, WHIRL_WHIP, fluid
from scipy.integrate import solve_ivp

import rotorfit as rf
from rotorfit.base.array_types import ComplexArray
from rotorfit.models import Muszynska, OneMode, WhirlWhip, whirl_branch

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
