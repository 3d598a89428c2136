"""Motion integrated in time obeys what the models say of orbits and equilibria."""

from __future__ import annotations

import numpy as np
import pytest
from nonlinear_rigs import SPEED, forces, loaded, orbit_equation, rig
from sentences import refuses
from slow_cases import slow_but

from rotorfit.base.array_types import ComplexArray, Float
from rotorfit.lab.simulation.integration import IntegrationError, Motion, integrate, rest_position, steady_state
from rotorfit.models import RotorModel
from rotorfit.models.motion.journal import journal
from rotorfit.models.motion.off_centre import (
    coupled_stiffness,
    off_centre_eigenvalues,
)
from rotorfit.models.motion.orbits import all_roots, followed_roots, nearest_orbits
from rotorfit.models.motion.stability import eigenvalues, growth_rate

RIGS = ["muszynska", "even", "spline", "two planes", "two ratios"]


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


def test_a_load_that_no_equilibrium_carries_does_not_come_to_rest() -> None:
    model, theta = rig("jumping")
    motion = Motion(model=model, theta=theta[None], speed=np.array([400.0]))
    assert eigenvalues(model, theta, 400.0).real.max() > 0
    with refuses(IntegrationError):
        rest_position(motion, np.array([[0.01 + 0j]]), np.array([20.0]), tolerance=1e-6)


def phasor(
    model: RotorModel, theta: Float, speed: float, frequency: Float, force: ComplexArray, eps: Float
) -> ComplexArray:
    kappa = model.dynamic_stiffness(np.tile(theta, (eps.size, 1)), frequency, np.full(eps.size, speed), eps)
    return np.asarray(np.linalg.solve(kappa, force[..., None])[..., 0])


@pytest.mark.parametrize(
    ("name", "plane", "newton", "tolerance"),
    slow_but(
        [
            ("muszynska", 0, 4.0, 1e-11),
            ("even", 0, 3.0, 1e-10),
            ("spline", 0, 3.0, 1e-10),
            ("two planes", 0, 3.0, 1e-9),
            ("two planes", 1, 4.0, 1e-9),
            ("two ratios", 0, 3.0, 1e-9),
        ],
        ("muszynska", 0, 4.0, 1e-11),
        ("two ratios", 0, 3.0, 1e-9),
    ),
)
def test_circular_orbits_integrated_in_time_obey_the_phasor_equation(
    name: str, plane: int, newton: float, tolerance: float
) -> None:
    model, theta = rig(name)
    frequency = np.array([50.0, 70.0, 100.0, -70.0])
    force = forces(model, plane, newton * np.exp(0.4j) * np.ones(4))
    motion = Motion(model=model, theta=np.tile(theta, (4, 1)), speed=np.full(4, SPEED))
    decay = -growth_rate(model, theta, SPEED)
    steady = steady_state(motion, frequency, force, np.full(4, float(decay)), tolerance=tolerance)
    equation = orbit_equation(model, theta, SPEED, frequency, force)
    eps = nearest_orbits(journal(model), equation, motion.eccentricity(steady.forward))[0]
    assert 0.3 < eps.max() < 0.95  # well into the nonlinear range
    expected = phasor(model, theta, SPEED, frequency, force, eps)
    # the integration's own tolerance, ten times of which counts as settled
    error = np.abs(steady.forward - expected).max(axis=1) / np.abs(expected).max(axis=1)
    np.testing.assert_array_less(error, 10 * tolerance)
    np.testing.assert_array_less(np.abs(steady.backward), 10 * tolerance * np.abs(expected).max())
    np.testing.assert_array_less(np.abs(steady.mean), 10 * tolerance * np.abs(expected).max())


def test_of_three_orbits_under_one_force_the_outer_two_attract_and_the_middle_one_does_not() -> None:
    model, theta = rig("jumping")
    speed, frequency = 50.0, np.full(3, 134.0)
    force = forces(model, 0, np.ones(3))
    equation = orbit_equation(model, theta, speed, frequency, force)
    roots = all_roots(journal(model), equation)[0]
    assert roots.size == 3
    residual, slope = equation.at(journal(model), roots)[:2]
    np.testing.assert_allclose(residual, 0.0, atol=1e-13)
    assert (np.sign(slope) == [-1, 1, -1]).all()
    # put each orbit two per mille beside the root and let it run
    orbits = phasor(model, theta, speed, frequency, force, roots)
    motion = Motion(model=model, theta=np.tile(theta, (3, 1)), speed=np.full(3, speed))
    z = np.asarray(orbits * 1.002, dtype=complex)
    decay = np.full(3, -float(growth_rate(model, theta, speed)))
    steady = steady_state(motion, frequency, force, decay, start=(z, 1j * frequency[:, None] * z), tolerance=1e-9)
    reached = motion.eccentricity(steady.forward)
    np.testing.assert_allclose(reached[[0, 2]], roots[[0, 2]], rtol=1e-8)
    assert np.abs(reached[1] - roots[[0, 2]]).min() < 1e-8 * roots[2]


@pytest.mark.slow
def test_followed_sweeps_jump_where_their_branch_ends_as_the_integrated_motion_does() -> None:
    model, theta = rig("jumping")
    speed = 50.0
    rising = np.linspace(123.0, 143.0, 8)
    force = np.ones(rising.size)
    followed = {}
    for name, frequency in (("up", rising), ("down", rising[::-1])):
        equation = orbit_equation(model, theta, speed, frequency, forces(model, 0, force))
        followed[name] = followed_roots(journal(model), equation, np.zeros(rising.size, dtype=np.intp))
        motion = Motion(model=model, theta=theta[None], speed=np.array([speed]))
        decay = np.array([-float(growth_rate(model, theta, speed))])
        last: tuple[ComplexArray, ComplexArray] | None = None
        for line, w in enumerate(frequency):
            steady = steady_state(
                motion, np.array([w]), forces(model, 0, np.ones(1)), decay, start=last, tolerance=1e-6
            )
            last = steady.z, steady.v
            assert motion.eccentricity(steady.forward)[0] == pytest.approx(followed[name][line], rel=1e-5)
    difference = followed["up"] - followed["down"][::-1]
    assert np.abs(difference[[0, -1]]).max() < 1e-12  # one orbit outside the range of the jumps
    assert difference.max() > 0.2  # two within: hysteresis


def test_roots_do_not_exist_beyond_the_clearance() -> None:
    model, theta = rig("even")
    equation = orbit_equation(model, theta, SPEED, np.array([70.0]), forces(model, 0, np.array([50.0])))
    assert all_roots(journal(model), equation)[0] == pytest.approx([1.0], abs=1e-8)
    motion = Motion(model=model, theta=theta[None], speed=np.array([SPEED]))
    with refuses(IntegrationError):
        steady_state(motion, np.array([70.0]), forces(model, 0, np.array([50.0])), np.array([30.0]), tolerance=1e-6)


def test_energy_of_an_undamped_rotor_without_fluid_is_kept() -> None:
    model, _ = rig("muszynska")
    theta = model.vector({
        "M": 1.0, "K": 1e4, "Ds": 0.0, "K0": 0.0, "D": 0.0, "lam": 0.0, "Mf": 0.0, "n_K": 0.0, "n_D": 0.0, "b": 0.0,
    })  # fmt: skip
    motion = Motion(model=model, theta=theta[None], speed=np.zeros(1))
    z, v = np.array([[1e-5 + 0j]]), np.array([[2e-3j]])
    path = integrate(
        motion, lambda _: np.zeros((1, 1), dtype=complex), z, v, (0.0, 1.0), size=1e-5, rate=100.0, tolerance=1e-10
    )
    exact = z * np.cos(100 * path.time)[:, None, None] + v / 100 * np.sin(100 * path.time)[:, None, None]
    # about 20 periods of some 20 steps each, the error of each below the tolerance
    np.testing.assert_allclose(path.z, exact, atol=400 * 1e-10 * 2.5e-5)
