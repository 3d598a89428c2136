"""x and y put together as motion along and against the force, held to the motion itself in time."""

from __future__ import annotations

import numpy as np
import pytest

from rotorfit.lab.data.linear_force import directional, directional_noise

RIGHT, WRONG = 3e-5 * np.exp(0.7j), 1e-5 * np.exp(-1.1j)


def phasors(w: float, right: complex, wrong: complex) -> tuple[complex, complex]:
    """What probes x and y read of ``z = R exp(jwt) + W exp(-jwt)``, relative to exp(j|w|t), over one period."""
    t = np.arange(64) / 64 * 2 * np.pi / abs(w)
    z = right * np.exp(1j * w * t) + wrong * np.exp(-1j * w * t)
    x, y = (2 * np.mean(axis * np.exp(-1j * abs(w) * t)) for axis in (z.real, z.imag))
    return complex(x), complex(y)


@pytest.mark.parametrize("w", [40.0, -40.0])
def test_motion_in_time_gives_its_parts(w: float) -> None:
    x, y = phasors(w, RIGHT, WRONG)
    circular = phasors(w, RIGHT, 0.0)
    response = np.array([[x, y, *circular, RIGHT, 9.0], [2 * x, 2 * y, *(2 * part for part in circular), RIGHT, 9.0]])
    rows = np.array([[0, 1, -1], [2, -1, -1], [-1, 3, -1], [-1, -1, 4], [2, -1, 5], [-1, -1, -1]])
    right, wrong = directional(response, rows, np.full(6, w < 0))
    nothing = np.nan
    np.testing.assert_allclose(right[0], [RIGHT, RIGHT, RIGHT, RIGHT, RIGHT, nothing], rtol=1e-12)
    np.testing.assert_allclose(wrong[0], [WRONG, *[nothing] * 5], rtol=1e-12)
    np.testing.assert_allclose(right[1, :3], 2 * RIGHT, rtol=1e-12)
    np.testing.assert_allclose(wrong[1, 0], 2 * WRONG, rtol=1e-12)


def test_noise_of_a_pair_is_that_of_simulated_probes() -> None:
    """4000 draws tell a standard deviation to 1.1 %."""
    rng, sigma, rows = np.random.default_rng(3), np.array([2.0, 1.0]), np.array([[0, 1, -1], [0, -1, -1], [-1, 1, -1]])
    noise = sigma * (rng.normal(size=(4000, 2)) + 1j * rng.normal(size=(4000, 2)))
    right, _ = directional(noise, rows, np.array([False, True, False]))
    told = directional_noise(sigma, rows)
    np.testing.assert_allclose(right.real.std(axis=0), told, rtol=0.05)
    np.testing.assert_allclose(right.imag.std(axis=0), told, rtol=0.05)
