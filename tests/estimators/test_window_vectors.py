"""Vectors by windows: exact where the frequency stands still, behind where it is swept."""

from __future__ import annotations

import numpy as np
import pytest
from sentences import refuses
from swept import Rotor, Sweep

from rotorfit.estimators.signals.tracking import track_windows

RATE = 2048.0


def test_a_dwell_beside_orders_of_the_shaft_is_measured_exactly() -> None:
    t = np.arange(int(20 * RATE)) / RATE
    shaft = 157.0 * t
    z = (3.0 + 1.0j) * np.exp(1j * 211.0 * t) + 0.5 * np.exp(-1j * 211.0 * t) + 7.0 * np.exp(1j * shaft) + 2.0
    found = track_windows(z[None], 211.0 * t, shaft, turns=24)
    assert found.clear.all()
    assert found.along[0] == pytest.approx(3.0 + 1.0j, abs=1e-9)
    assert found.against[0] == pytest.approx(0.5, abs=1e-9)


def test_backward_drives_and_windows_on_an_order() -> None:
    t = np.arange(int(20 * RATE)) / RATE
    z = 2.0j * np.exp(-1j * 157.0 * t) + np.exp(1j * 157.0 * t)
    found = track_windows(z[None], -157.0 * t, 157.0 * t, turns=12)
    assert not found.clear.any()
    assert found.along[0] == pytest.approx(2.0j, abs=1e-9)


def test_sigma_of_windows_is_that_of_white_noise() -> None:
    rng = np.random.default_rng(3)
    t = np.arange(int(200 * RATE)) / RATE
    z = 1e-6 * (rng.standard_normal(t.size) + 1j * rng.standard_normal(t.size))
    found = track_windows(z[None], 211.0 * t, 157.0 * t, turns=24)
    # some 280 windows, two numbers each: 1/sqrt(2 * 560) = 3 %
    assert np.sqrt(np.mean(np.abs(found.along / found.sigma) ** 2) / 2) == pytest.approx(1.0, abs=0.1)


def test_windows_lag_behind_a_sweep_as_the_second_derivative_says() -> None:
    """The quasi-steady response is off by -(j/2) w' H''(w); further terms are smaller by w' H'''/H'' = 5 %."""
    rotor = Rotor(np.array([-12.0 + 200.0j]), np.array([[1.0 + 0.0j]]))
    sweep = Sweep(100.0, 300.0, 100.0, wobble=0.0)
    count = int(100.0 * RATE)
    t = np.arange(count) / RATE
    z = rotor.motion(sweep.force, RATE, count)
    found = track_windows(z, sweep.angle(t), None, turns=2)  # short ones, whose own smearing is small
    w = sweep.speed(t[found.centre])
    H = rotor.receptance(w)[0]
    second = 2.0 / (1j * w - rotor.poles[0]) ** 3 * (1j) ** 2
    force = sweep.mr * w**2 * np.exp(1j * sweep.angle(t[found.centre]))
    lag = (found.along[0] * np.exp(1j * sweep.angle(t[found.centre])) / force - H)[20:-20]
    told = (-0.5j * 2.0 * second)[20:-20]
    peak = np.argmax(np.abs(told))
    assert abs(lag[peak] - told[peak]) < 0.2 * abs(told[peak])


def test_less_than_a_window_is_refused() -> None:
    with refuses(ValueError):
        track_windows(np.zeros((1, 100), complex), np.linspace(0, 30, 100), None, turns=24)
