"""Motion about off-centre equilibria: against finite differences of the nonlinear force and integration in time."""

from __future__ import annotations

import numpy as np
import pytest
from linear_tests import linearised
from nonlinear_rigs import rig
from sentences import refuses

from rotorfit.base.array_types import ComplexArray, Float
from rotorfit.lab.simulation.integration import IntegrationError, Motion, rest_position, steady_state
from rotorfit.models import RotorModel
from rotorfit.models.motion.journal import journal
from rotorfit.models.motion.off_centre import (
    coupled_stiffness,
    off_centre_eigenvalues,
    off_centre_gradient,
    static_equilibria,
)
from rotorfit.models.motion.stability import eigenvalues

SPEED = 100.0
RIGS = ["muszynska", "even", "spline", "two planes", "two ratios"]


def loaded(name: str, newton: complex) -> tuple[RotorModel, Float, ComplexArray, float, float]:
    """A rig under a load at its journal: model, parameters, displacements, eccentricity and attitude."""
    model, theta = rig(name)
    seat = journal(model)
    load = np.zeros(len(model.coordinates), dtype=complex)
    load[seat.at] = newton
    z = static_equilibria(model, theta, SPEED, load)[0]
    return model, theta, z, float(abs(z[seat.at]) / seat.clearance), float(np.angle(z[seat.at]))


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


@pytest.mark.parametrize("name", ["muszynska", "two planes", "spline"])
def test_equilibria_balance_the_load_and_the_integrated_rotor_comes_to_rest_there(name: str) -> None:
    model, theta, z, eps, _ = loaded(name, 4.0j)
    seat = journal(model)
    load = np.zeros(len(model.coordinates), dtype=complex)
    load[seat.at] = 4.0j
    balance = model.coefficients(theta, SPEED, eps)[0] @ z
    np.testing.assert_allclose(balance, load, atol=4e-12)
    decay = -off_centre_eigenvalues(model, theta, SPEED, eps).real.max()
    found = rest_position(
        Motion(model=model, theta=theta[None], speed=np.array([SPEED])), load[None], np.array([decay]), tolerance=1e-9
    )
    np.testing.assert_allclose(found[0], z, atol=1e-8 * np.abs(z).max())


@pytest.mark.parametrize(("name", "newton"), [("muszynska", 3.0), ("two planes", 4.0)])
@pytest.mark.parametrize("frequency", [60.0, -45.0])
def test_small_orbits_about_the_equilibrium_integrated_in_time_obey_the_coupled_equation(
    name: str, newton: float, frequency: float
) -> None:
    model, theta, z, eps, attitude = loaded(name, newton * np.exp(-0.8j))
    seat, n = journal(model), len(model.coordinates)
    motion = Motion(model=model, theta=theta[None], speed=np.array([SPEED]))
    load, unit = np.zeros((2, 1, n), dtype=complex)
    load[0, seat.at], unit[0, seat.at] = newton * np.exp(-0.8j), np.exp(0.5j)
    stiffness = coupled_stiffness(model, theta, frequency, SPEED, eps, attitude)[0]
    drive = np.zeros(2 * n, dtype=complex)
    if frequency > 0:
        drive[:n] = unit[0]
    else:
        drive[n:] = unit[0].conj()
    ahead, behind = np.linalg.solve(stiffness, drive).reshape(2, n)
    along, against = (ahead, behind.conj()) if frequency > 0 else (behind.conj(), ahead)
    decay = np.array([-off_centre_eigenvalues(model, theta, SPEED, eps).real.max()])
    errors = []
    begin = z[None], np.zeros((1, n), dtype=complex)
    for size in (0.04, 0.02):
        force = np.asarray(size * unit, dtype=complex)
        steady = steady_state(motion, np.array([frequency]), force, decay, load=load, start=begin, tolerance=1e-8)
        miss = np.abs(steady.forward[0] / size - along).max(), np.abs(steady.backward[0] / size - against).max()
        errors.append(max(miss) / np.abs(along).max())
    assert np.abs(against).max() > 0.02 * np.abs(along).max()  # both directions are there
    # what the linearisation leaves out changes phasors with the square of the orbit
    assert errors[0] < 2e-3
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.05)


@pytest.mark.parametrize("name", RIGS)
def test_eigenvalues_are_those_of_the_numerically_linearised_first_order_system(name: str) -> None:
    model, theta, z, eps, _ = loaded(name, 3.0 * np.exp(0.3j))
    n, seat = len(model.coordinates), journal(model)
    motion = Motion(model=model, theta=theta[None], speed=np.array([SPEED]))
    load = np.zeros((1, n), dtype=complex)
    load[0, seat.at] = 3.0 * np.exp(0.3j)
    scale = np.r_[np.full(2 * n, 1e-4), np.full(2 * n, 1e-2)]  # states of like size

    def slope(state: Float) -> Float:
        x, y, vx, vy = (state * scale).reshape(4, n)
        a = motion.acceleration((x + 1j * y)[None], (vx + 1j * vy)[None], load)[0]
        return np.asarray(np.concatenate([vx, vy, a.real, a.imag]) / scale)

    rest = np.concatenate([z.real, z.imag, np.zeros(2 * n)]) / scale
    # central differences with Richardson's extrapolation: truncation h^4, round-off 1e-16 / h
    h = 3e-4
    matrix = np.empty((4 * n, 4 * n))
    for column, change in enumerate(np.eye(4 * n)):
        wide, narrow = ((slope(rest + k * h * change) - slope(rest - k * h * change)) / (2 * k * h) for k in (2, 1))
        matrix[:, column] = (4 * narrow - wide) / 3
    expected = np.linalg.eigvals(matrix)
    found = off_centre_eigenvalues(model, theta, SPEED, eps)
    assert found.size == expected.size
    for s in found:
        assert np.abs(expected - s).min() < 1e-8 * np.abs(found).max()


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


def test_a_load_that_no_equilibrium_carries_does_not_come_to_rest() -> None:
    model, theta = rig("jumping")
    motion = Motion(model=model, theta=theta[None], speed=np.array([400.0]))
    assert eigenvalues(model, theta, 400.0).real.max() > 0
    with refuses(IntegrationError):
        rest_position(motion, np.array([[0.01 + 0j]]), np.array([20.0]), tolerance=1e-6)
