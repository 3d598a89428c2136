"""Run-ups through a resonance on a ramp of speed: ringing, its rate, and the natural frequency behind it."""

from __future__ import annotations

import numpy as np
from plain import plain_fit
from scipy.integrate import solve_ivp
from sentences import hear

import rotorfit as rf
from rotorfit.estimators.signals.ring_down import find_beat, fit_ramp, ramp_response, steady_response

RPM = np.pi / 30


def integrated(speed: np.ndarray, wn: float, zeta: float, rate: float) -> np.ndarray:
    """The same run-up by time integration of the demodulated equation of motion, from far below the resonance."""
    begin = 0.2 * wn

    def slope(t: float, state: np.ndarray) -> list[complex]:
        w = begin + rate * t
        a, b = state
        force = w**2 - 1j * rate
        return [b, force - (2j * w + 2 * zeta * wn) * b - (wn**2 - w**2 + 1j * rate + 2j * zeta * wn * w) * a]

    t = (speed - begin) / rate
    start = complex(steady_response(np.array([begin]), wn, zeta)[0])
    done = solve_ivp(slope, (0, t[-1] * 1.001), [start, 0j], t_eval=t, rtol=1e-9, atol=1e-9, method="DOP853")
    return np.asarray(done.y[0])


def test_response_on_a_ramp_is_that_of_time_integration() -> None:
    wn, zeta, rate = 40.0, 0.03, 4.0
    speed = np.linspace(25.0, 60.0, 80)
    expected = integrated(speed, wn, zeta, rate)
    # the integration starts settled to first order in the rate only: rate/(wn - Omega)^2 = 0.4 % of a small vector
    np.testing.assert_allclose(ramp_response(speed, wn, zeta, rate), expected, atol=2e-3 * np.abs(expected).max())


def test_a_slow_ramp_is_the_settled_response() -> None:
    speed = np.linspace(100.0, 240.0, 50)
    # off by rate H''/2, with H'' at most 2 |H|/(zeta wn)^2: 1e-3/(0.03 * 170)^2 = 4e-5 of the peak
    settled = steady_response(speed, 170.0, 0.03)
    np.testing.assert_allclose(ramp_response(speed, 170.0, 0.03, 1e-3), settled, atol=1e-4 * np.abs(settled).max())


def test_natural_frequency_is_found_through_the_ringing() -> None:
    rng = np.random.default_rng(3)
    speed = np.linspace(1000, 2100, 130) * RPM
    wn, rate = 1630 * RPM, 25.0
    y = (3 - 2j) * ramp_response(speed, wn, 0.02, rate) + 0.5 + 0.2j
    y = y + 0.1 * (rng.normal(size=130) + 1j * rng.normal(size=130))
    found = fit_ramp(speed, y)
    assert found is not None
    assert abs(found.wn - wn) < 4 * found.wn_error
    assert abs(found.rate - rate) < 4 * found.rate_error
    assert found.steady_wn > wn + 2 * RPM  # late on the way up


def test_a_settled_run_up_does_not_beat() -> None:
    speed = np.linspace(1000, 2100, 130) * RPM
    rng = np.random.default_rng(4)
    y = steady_response(speed, 1630 * RPM, 0.02) + 0.3 * (rng.normal(size=130) + 1j * rng.normal(size=130))
    assert find_beat(speed, y) is None


def test_the_measured_run_up_is_noticed_and_fitted_where_it_does_not_beat() -> None:
    test = rf.datasets.rk4_runup()
    (finding,) = [f for f in rf.check(test) if f.code == "ramp"]
    hear(finding.message)
    early = test.select(test.speed < 1700 * RPM)
    fit = plain_fit(rf.models.Modal(("disk2",), gains="plane"), early, phase_offsets="common")
    assert abs(fit.params["wn"].value / RPM - 1658) < 15
    ramp = fit_ramp(test.speed, test.response)
    assert ramp is not None
    assert abs(ramp.wn / RPM - 1626) < 10
    # and the trial weights of the same kit agree with the natural frequency behind the ramp, not with the late peak
    weights = plain_fit(rf.models.Modal(("disk2", "disk1")), rf.datasets.rk4(), phase_offsets="common")
    low, high = weights.interval("wn")
    assert low < ramp.wn < high < ramp.steady_wn
