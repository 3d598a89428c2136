"""The one-phasor equation against integration of the nonlinear equation of motion in time, and its several roots."""

from __future__ import annotations

import numpy as np
from nonlinear_rigs import forces, orbit_equation, rig

from rotorfit.models.motion.journal import journal
from rotorfit.models.motion.orbits import all_roots, nearest_orbits


def test_the_measured_orbit_selects_the_branch() -> None:
    model, theta = rig("jumping")
    frequency = np.full(6, 134.0)
    equation = orbit_equation(model, theta, 50.0, frequency, forces(model, 0, np.ones(6)))
    roots = all_roots(journal(model), equation)[0]
    middle = (roots[1:] + roots[:-1]) / 2
    target = np.array([0.0, roots[0] + 0.01, middle[0] + 1e-6, middle[1] - 1e-6, middle[1] + 1e-6, 1.0])
    found = nearest_orbits(journal(model), equation, target)[0]
    np.testing.assert_allclose(found, roots[[0, 0, 1, 1, 2, 2]], atol=1e-12)
