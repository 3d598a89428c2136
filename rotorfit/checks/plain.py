"""Tests in which the check surely finds no error, by its own first questions, put to one test or to many at once."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rotorfit.checks.linear_force import SHARE, powers
from rotorfit.checks.orbits import Orbits
from rotorfit.checks.probe_angles import surely_straight
from rotorfit.checks.signs import surely_right
from rotorfit.models.array_types import ComplexArray, Float


def surely_turning(orbits: Orbits, right: ComplexArray, wrong: ComplexArray, speed: Float) -> NDArray[np.bool_]:
    """Whether nothing is wrong with the sense in which the rotor, its forces and its probes turn, for sure, shape
    ``(...)``.

    No plane in any run that turns as little against the force as :func:`powers` is asked for here leaves a force along
    an axis or a wrong direction to be found.
    """
    with np.errstate(all="ignore"):  # of readings that are zero nothing is sure, and comparisons say so
        both, against = powers(orbits, right, wrong)
        found = np.broadcast_to((against <= SHARE[0] * both).all(axis=-1), right.shape[:-1])
        if found.any():
            found = found & surely_straight(orbits, right)
        if found.any():
            found = found & surely_right(orbits, right, speed)
    return np.asarray(found)
