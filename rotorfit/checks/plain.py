"""Tests in which the check surely finds no error, by its own first questions, put to one test or to many at once."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rotorfit.checks.amplitudes import SUSPECT, sizes
from rotorfit.checks.linear_force import SHARE, powers
from rotorfit.checks.orbits import Orbits, orbits_of
from rotorfit.checks.probe_angles import surely_straight
from rotorfit.checks.readings import surely_whole
from rotorfit.checks.signs import surely_right
from rotorfit.data.alike import AlikeTests
from rotorfit.data.directional import directional
from rotorfit.data.experiments import PerturbationTest
from rotorfit.data.kept import kept, unchanged
from rotorfit.models.array_types import ComplexArray, Float


def surely_clean(group: AlikeTests) -> NDArray[np.bool_]:
    """Which tests of one plan have no errors for sure, shape ``(W,)``; the others are to be checked one by one."""
    first = group.tests[0]
    with unchanged([first]):
        orbits = orbits_of(first, np.arange(len(first)))
        found = (sizes(first, group.response) <= SUSPECT).all(axis=1) & surely_whole(first, group.response)
    right, wrong = directional(group.response, orbits.rows, orbits.frequency < 0)
    return np.asarray(found & surely_turning(orbits, right, wrong, group.speed[:, None]))


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


def keep_clean(test: PerturbationTest) -> None:
    """Keep with a test that it has no errors, for :func:`~rotorfit.checks.checklist.errors`."""
    kept(test).setdefault("errors", ())
