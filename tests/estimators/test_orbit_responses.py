"""Responses of nonlinear rotors: derivatives of orbits that an equation gives only implicitly."""

from __future__ import annotations

import numpy as np
import pytest
from nonlinear_rigs import SPEED, forces, orbit_equation, rig

from rotorfit.estimators.blocks.nonlinear import OrbitBranch, OrbitResponses
from rotorfit.estimators.blocks.observations import Responses
from rotorfit.models.motion.journal import journal
from rotorfit.models.motion.orbits import all_roots


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
    block = OrbitResponses(base, eps[None], mode, np.zeros(lines, dtype=np.intp))
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
