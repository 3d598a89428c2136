"""Turning anisotropy with orthotropic supports: truncated sets of lines against time integration and exact pairs."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from sentences import refuses

import rotorfit as rf
from rotorfit.models import Chain, Turning, harmonic_set

SPEED, W = 130.0, -190.0
CHAIN = Turning(Chain(2), ("mass-1", "mass-2"))
VALUES = {
    "M1": 0.8, "M2": 0.6, "K1": 2e4, "K2": 3e4, "K3": 2.5e4, "Ds1": 16.0, "Ds2": 19.0, "dK_cos": 1500.0,
    "dK_sin": -2500.0,
}  # fmt: skip
SUPPORT = {"mass-1": 1200.0 * np.exp(0.8j), "mass-2": -900.0}
FORCE = {"mass-1": 1.0 + 0.5j}


def test_the_truncated_set_is_the_motion_in_time():
    found = harmonic_set(CHAIN, CHAIN.vector(VALUES), W, SPEED, FORCE, SUPPORT, tolerance=1e-11)
    v = VALUES
    K = np.array([[v["K1"] + v["K2"], -v["K2"]], [-v["K2"], v["K2"] + v["K3"]]])
    M, D = np.array([v["M1"], v["M2"]]), np.array([v["Ds1"], v["Ds2"]])
    turning = complex(v["dK_cos"], v["dK_sin"]) * np.array([[1.0, -1.0], [-1.0, 1.0]])
    still = np.diag([SUPPORT["mass-1"], SUPPORT["mass-2"]])

    def slope(t, state):
        z, velocity = state[:2], state[2:]
        pull = (turning * np.exp(2j * SPEED * t) + still) @ z.conj()
        force = np.array([FORCE["mass-1"], 0.0]) * np.exp(1j * W * t)
        return np.concatenate([velocity, (force - D * velocity - K @ z - pull) / M])

    rates = np.concatenate(found.frequencies)
    lines = np.concatenate([found.ahead, found.behind])
    start = np.concatenate([lines.sum(axis=0), (1j * rates[:, None] * lines).sum(axis=0)])
    time = np.linspace(0.0, 1.0, 50)
    motion = solve_ivp(slope, (0.0, 1.0), start, method="DOP853", t_eval=time, rtol=1e-12, atol=1e-18).y[:2].T
    # Lines left out change none by more than 1e-11; the integrator adds 1e-12 a step.
    assert np.abs(motion - found.at(time)).max() < 1e-9 * np.abs(motion).max()
    assert found.error < 1e-11


def test_the_error_that_is_shown_bounds_what_more_lines_change():
    rough = harmonic_set(CHAIN, CHAIN.vector(VALUES), W, SPEED, FORCE, SUPPORT, tolerance=1e-3)
    exact = harmonic_set(CHAIN, CHAIN.vector(VALUES), W, SPEED, FORCE, SUPPORT, tolerance=1e-13)
    assert rough.terms < exact.terms
    rest = exact.terms - rough.terms
    missed = np.abs(exact.ahead - np.pad(rough.ahead, ((rest, rest), (0, 0)))).max() / np.abs(exact.ahead).max()
    assert missed <= rough.error


def test_either_anisotropy_alone_couples_two_lines():
    theta = CHAIN.vector(VALUES)
    pair = CHAIN.turning.receptance(theta, W - SPEED, SPEED)[:, 0] * FORCE["mass-1"]
    round_support = harmonic_set(CHAIN, theta, W, SPEED, FORCE, {})
    N = round_support.terms
    assert round_support.ahead[N] == pytest.approx(pair[:2], rel=1e-10)
    assert round_support.behind[N + 1] == pytest.approx(pair[2:].conj(), rel=1e-10)
    still = harmonic_set(
        Chain(2), Chain(2).vector({k: v for k, v in VALUES.items() if k[0] != "d"}), W, SPEED, FORCE, SUPPORT
    )
    lines = np.abs(np.concatenate([still.ahead, still.behind])).max(axis=1)
    assert np.sum(lines > 1e-12 * lines.max()) == 2  # w and -w


def test_what_makes_no_set_is_refused_in_words():
    theta = CHAIN.vector(VALUES)
    with refuses(ValueError):
        harmonic_set(rf.models.Anisotropic(), [0.0] * 12, W, SPEED, {}, {})
    with refuses(KeyError):
        harmonic_set(CHAIN, theta, W, SPEED, {"seal": 1.0}, {})
    with refuses(ValueError):
        harmonic_set(CHAIN, theta, W, SPEED, FORCE, SUPPORT, tolerance=0.0, most=3)
