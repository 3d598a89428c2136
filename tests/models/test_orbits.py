"""The one-phasor equation against integration of the nonlinear equation of motion in time, and its several roots."""

from __future__ import annotations

import numpy as np
import pytest
from nonlinear_rigs import rig
from numpy.typing import NDArray
from sentences import refuses
from slow_cases import slow_but

from rotorfit.base.array_types import ComplexArray, Float
from rotorfit.estimators.blocks.nonlinear import OrbitBranch, OrbitResponses
from rotorfit.estimators.blocks.observations import Responses
from rotorfit.lab.simulation.integration import IntegrationError, Motion, integrate, steady_state
from rotorfit.models import RotorModel
from rotorfit.models.motion.journal import journal
from rotorfit.models.motion.orbits import OrbitEquation, all_roots, followed_roots, nearest_orbits
from rotorfit.models.motion.stability import growth_rate

SPEED = 100.0


def orbit_equation(
    model: RotorModel, theta: Float, speed: float, frequency: Float, force: ComplexArray
) -> OrbitEquation:
    """The equation of each line, force of shape ``(L, n)``."""
    seat = journal(model)
    H = model.receptance(theta, frequency, speed)
    drive = np.einsum("lij,lj->li", H, force)[:, seat.at] / seat.clearance
    lines = frequency.size
    return OrbitEquation(
        theta=np.tile(theta, (lines, 1)),
        frequency=frequency,
        speed=np.full(lines, speed),
        drive=np.abs(drive),
        receptance=H[:, seat.at, seat.at],
    )


def phasor(
    model: RotorModel, theta: Float, speed: float, frequency: Float, force: ComplexArray, eps: Float
) -> ComplexArray:
    kappa = model.dynamic_stiffness(np.tile(theta, (eps.size, 1)), frequency, np.full(eps.size, speed), eps)
    return np.asarray(np.linalg.solve(kappa, force[..., None])[..., 0])


def forces(model: RotorModel, plane: int, size: NDArray[np.generic]) -> ComplexArray:
    vector = np.zeros((size.size, len(model.coordinates)), dtype=complex)
    vector[:, plane] = size
    return vector


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


def test_the_measured_orbit_selects_the_branch() -> None:
    model, theta = rig("jumping")
    frequency = np.full(6, 134.0)
    equation = orbit_equation(model, theta, 50.0, frequency, forces(model, 0, np.ones(6)))
    roots = all_roots(journal(model), equation)[0]
    middle = (roots[1:] + roots[:-1]) / 2
    target = np.array([0.0, roots[0] + 0.01, middle[0] + 1e-6, middle[1] - 1e-6, middle[1] + 1e-6, 1.0])
    found = nearest_orbits(journal(model), equation, target)[0]
    np.testing.assert_allclose(found, roots[[0, 0, 1, 1, 2, 2]], atol=1e-12)


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


@pytest.mark.parametrize(("mode", "imposed"), [("nearest", False), ("given", False), ("given", True)])
@pytest.mark.parametrize("name", ["muszynska", "spline", "two planes", "two ratios"])
def test_sensitivities_of_the_implicit_equation_are_exact(name: str, mode: OrbitBranch, imposed: bool) -> None:
    model, theta = rig(name)
    n = len(model.coordinates)
    frequency = np.array([-90.0, -30.0, 35.0, 60.0, 95.0])
    lines = frequency.size
    force = forces(model, journal(model).at, 3.0 * np.exp(0.3j) * np.ones(lines))
    equation = orbit_equation(model, theta, SPEED, frequency, force)
    eps = np.array([roots[0] for roots in all_roots(journal(model), equation)])
    drive = force if not imposed else force * 4e-5
    coordinate = np.tile(np.arange(n), lines) if not imposed else np.full(lines, journal(model).at)
    line = np.repeat(np.arange(lines), n) if not imposed else np.arange(lines)
    zeros = np.zeros(line.size, dtype=np.intp)
    base = Responses(
        model=model,
        speed=np.full(lines, SPEED),
        frequency=frequency,
        force=drive,
        group=np.zeros(lines, dtype=np.intp),
        line=line,
        coordinate=coordinate,
        measured=np.ones(line.size, dtype=complex),
        sigma=np.ones(line.size),
        label=zeros,
        labels=("r",),
        run=np.full(line.size, "r"),
        imposed=imposed,
    )
    block = OrbitResponses(base, eps, mode, np.zeros(lines, dtype=np.intp))
    predicted, slopes = block.predict_jacobian(theta[None])
    np.testing.assert_array_equal(predicted, block.predict(theta[None]))
    for place, parameter in enumerate(model.parameters):
        step = 1e-5 * max(abs(theta[place]), 1e-3 * parameter.scale)
        change = np.zeros_like(theta)
        change[place] = step
        numeric = (block.predict((theta + change)[None]) - block.predict((theta - change)[None])) / (2 * step)
        # truncation (1e-5)^2, round-off 1e-14 / 1e-5 of the response per relative change of the parameter
        scale = np.abs(predicted).max() / max(abs(theta[place]), 1e-3 * parameter.scale)
        np.testing.assert_allclose(slopes[:, place] / scale, numeric / scale, atol=1e-8, err_msg=parameter.name)


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
