"""Many parameter vectors of a nonlinear rotor at once: the same misfit and gradient as one by one, jumps included."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from law_data import CLEARANCE_UM, JUMPING, LIGHT, ONE_MODE, WHIRL_WHIP, impulse, off_centre, squeeze, static, sweep

import rotorfit as rf
from rotorfit.estimators.blocks.nonlinear import OrbitResponses
from rotorfit.estimators.misfit.kernels import Batch
from rotorfit.estimators.misfit.problem import Problem
from rotorfit.identify.fitting.problem_setup import build_problem
from rotorfit.identify.fitting.settings import FitSettings
from rotorfit.lab.data.rows import Experiment
from rotorfit.models.motion.journal import journal, line_stiffness
from rotorfit.models.motion.orbits import OrbitEquation, all_roots, nearest_orbits

LAW = rf.models.Muszynska()
ONE = rf.models.OneMode(law=LAW, clearance_um=CLEARANCE_UM)
TWO = rf.models.WhirlWhip(law=LAW, clearance_um=CLEARANCE_UM)


def problem_of(model: rf.models.RotorModel, tests: Sequence[Experiment], settings: FitSettings) -> Problem:
    return build_problem(model, tests, settings)


def followed(problem: Problem) -> Problem:
    """The same readings as if the journal had not been measured."""
    (block,) = problem.blocks
    assert isinstance(block, OrbitResponses)
    return replace(problem, blocks=(replace(block, mode="followed"),))


CASES = {
    "sweep": lambda: problem_of(ONE, [sweep(ONE_MODE, levels=(1.0, 5.0), lines=8)], FitSettings()),
    "jumps": lambda: problem_of(
        ONE, [sweep(JUMPING, levels=(1.0,), speeds=(50.0,), lines=16, top=200.0, branch="alternate")], FitSettings()
    ),
    "followed": lambda: followed(problem_of(ONE, [sweep(JUMPING, levels=(1.0,), lines=8)], FitSettings())),
    "two planes, robust": lambda: problem_of(
        TWO, [sweep(WHIRL_WHIP, levels=(1.0, 6.0), lines=6)], FitSettings(loss="soft_l1")
    ),
    "all tests, phase references, damping of each speed": lambda: problem_of(
        ONE,
        [
            sweep(LIGHT, levels=(0.5, 3.0), lines=6),
            static(LIGHT, speeds=(100.0,)),
            impulse(LIGHT, speeds=(100.0,)),
            squeeze(LIGHT, lines=3),
            off_centre(LIGHT, lines=4),
        ],
        FitSettings(phase_offsets=True, per={"D": "speed_rpm"}),
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_many_vectors_have_the_cost_and_the_gradient_of_each(name: str) -> None:
    problem = CASES[name]()
    truth = {"jumps": JUMPING, "followed": JUMPING, "sweep": ONE_MODE}.get(name, LIGHT) | (
        WHIRL_WHIP if name.startswith("two") else {}
    )
    centre = np.array([truth[base] for base in problem.space.base] + [0.0] * len(problem.space.nuisance))
    rng = np.random.default_rng(4)
    x = np.concatenate([centre + 0.05 * rng.normal(size=(3, centre.size)) * np.maximum(np.abs(centre), 0.1), [centre]])
    batch = Batch(problem)
    cost, gradient = batch.cost_and_gradient(x)
    alone = [problem.gauss_newton(row) for row in x]
    # the same arithmetic in another order: round-off, which a sum of thousands of squares over noise magnifies little
    np.testing.assert_allclose(cost, [one[0] for one in alone], rtol=1e-10)
    np.testing.assert_allclose(batch.channel_sums(x).sum(axis=1) / 2, cost, rtol=1e-10)
    for row, (_, slope, matrix) in zip(gradient, alone, strict=True):
        # in units of each entry's own curvature, the natural size of a slope
        size = np.sqrt(np.diag(matrix) * max(float(cost.max()), 1.0))
        np.testing.assert_allclose(row / size, slope / size, atol=1e-9)


def test_steps_of_all_lines_together_end_at_the_nearest_of_all_roots() -> None:
    """Where sweeps jump, for targets near roots and anywhere, and parameters that move the jumps."""
    rng = np.random.default_rng(7)
    theta = ONE.vector(JUMPING) * (1 + 0.05 * rng.normal(size=(4, 1, 10)))
    w, seat = np.linspace(100.0, 160.0, 150), journal(ONE)
    H = 1.0 / line_stiffness(ONE).values(theta, w, np.full(150, 50.0), 0.0)[0, 0]
    equation = OrbitEquation(
        theta=theta, frequency=w, speed=np.full(150, 50.0), drive=np.abs(H) / seat.clearance, receptance=H
    )
    flat = equation.select(tuple(place.ravel() for place in np.indices(equation.shape)))
    roots = all_roots(seat, flat)
    assert {len(found) for found in roots} == {1, 3}
    near = np.array([found[-1] for found in roots[:150]]) * (1 + 0.01 * rng.normal(size=150))
    for target in (near, rng.uniform(0.0, 1.0, 150)):
        found, aim = nearest_orbits(seat, equation, target)[0].ravel(), np.tile(target, 4)
        np.testing.assert_allclose(flat.at(seat, found)[0], 0.0, atol=1e-11)
        # Where two roots are about to vanish the search of all may miss them, on its grid, and not the other way round.
        distance = np.array([np.abs(some - at).min() for some, at in zip(roots, aim, strict=True)])
        assert (np.abs(found - aim) <= distance + 1e-12).all()
