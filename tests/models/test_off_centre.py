"""Motion about off-centre equilibria: against finite differences of the nonlinear force and integration in time."""

from __future__ import annotations

import numpy as np
import pytest
from linear_tests import linearised
from nonlinear_rigs import SPEED, loaded, rig

from rotorfit.base.array_types import Float
from rotorfit.models import RotorModel
from rotorfit.models.motion.journal import journal
from rotorfit.models.motion.off_centre import (
    off_centre_eigenvalues,
    off_centre_gradient,
)
from rotorfit.models.motion.stability import eigenvalues

RIGS = ["muszynska", "even", "spline", "two planes", "two ratios"]


def nonlinear_force(model: RotorModel, theta: Float, motion: Float) -> Float:
    """Force of motion (z, z', z''), each x then y of all coordinates, straight from the model's coefficients."""
    n = len(model.coordinates)
    z, v, a = (part[:n] + 1j * part[n:] for part in motion.reshape(3, 2 * n))
    seat = journal(model)
    C = model.coefficients(theta, SPEED, abs(z[seat.at]) / seat.clearance)
    force = C[0] @ z + C[1] @ v + C[2] @ a
    return np.concatenate([force.real, force.imag])


@pytest.mark.parametrize("name", RIGS)
@pytest.mark.parametrize("newton", [1.0 * np.exp(-1.2j), 4.0])
def test_coefficients_are_the_derivatives_of_the_nonlinear_force(name: str, newton: complex) -> None:
    model, theta, z, eps, attitude = loaded(name, newton)
    n = len(model.coordinates)
    rest = np.concatenate([z.real, z.imag, np.zeros(4 * n)])
    exact = linearised(model, theta, SPEED, eps, attitude)
    for power, step in enumerate((1e-9, 1e-6, 1e-3)):  # m, m/s, m/s^2
        for column in range(2 * n):
            change = np.zeros_like(rest)
            change[2 * n * power + column] = step
            slope = nonlinear_force(model, theta, rest + change) - nonlinear_force(model, theta, rest - change)
            # round-off 1e-15 of a force of some N over the step; truncation (step / clearance)^2 = 2.5e-11
            size = np.abs(exact[power]).max()
            tolerance = 1e-8 * size + 1e-14 * abs(newton) / step
            np.testing.assert_allclose(exact[power][:, column], slope / (2 * step), atol=tolerance)


@pytest.mark.parametrize("name", RIGS)
def test_at_the_centre_eigenvalues_are_those_of_circular_motion(name: str) -> None:
    model, theta = rig(name)
    s = eigenvalues(model, theta, SPEED)
    found = off_centre_eigenvalues(model, theta, SPEED, 0.0)
    for value in np.concatenate([s, s.conj()]):
        assert np.abs(found - value).min() < 1e-10 * np.abs(s).max()


@pytest.mark.parametrize("name", RIGS)
def test_gradients_of_eigenvalues_are_exact(name: str) -> None:
    model, theta, _, eps, _ = loaded(name, 3.0)
    values = off_centre_eigenvalues(model, theta, SPEED, eps)
    s = values[np.argmax(values.imag)]
    exact = off_centre_gradient(model, theta, SPEED, eps, complex(s))
    for place, parameter in enumerate(model.parameters):
        size = max(abs(theta[place]), 1e-3 * parameter.scale)
        change = np.zeros_like(theta)
        change[place] = 1e-4 * size
        ends = [off_centre_eigenvalues(model, theta + sign * change, SPEED, eps) for sign in (1, -1)]
        ahead, behind = (end[np.argmin(np.abs(end - s))] for end in ends)
        # truncation (1e-4)^2, round-off 1e-13 / 1e-4
        miss = abs(exact[place] * size - (ahead - behind) / 2e-4)
        assert miss < 1e-6 * abs(s), parameter.name
    ends = [off_centre_eigenvalues(model, theta, SPEED, eps + sign * 1e-4) for sign in (1, -1)]
    ahead, behind = (end[np.argmin(np.abs(end - s))] for end in ends)
    assert abs(exact[-1] - (ahead - behind) / 2e-4) < 1e-5 * max(abs(s), abs(exact[-1]))  # by the eccentricity
