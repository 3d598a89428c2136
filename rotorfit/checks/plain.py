"""Tests of one plan in which the check surely finds no error, by its own first questions, put to all at once."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rotorfit.checks.checklist import SUSPECT, sizes
from rotorfit.checks.linear_force import SHARE, powers
from rotorfit.checks.orbits import directions_of, orbits_of
from rotorfit.checks.probes import surely_straight
from rotorfit.checks.readings import surely_whole
from rotorfit.checks.signs import surely_right
from rotorfit.data.alike import AlikeTests
from rotorfit.data.experiments import PerturbationTest
from rotorfit.data.kept import kept


def surely_clean(group: AlikeTests) -> NDArray[np.bool_]:
    """Which tests of one plan have no errors for sure, shape ``(W,)``; the others are to be checked one by one.

    Args:
        group: the tests.
    """
    first = group.tests[0]
    orbits = orbits_of(first, np.arange(len(first)))
    with np.errstate(all="ignore"):  # of readings that are zero nothing is sure, and comparisons say so
        probes = orbits.behind.reshape(orbits.frequency.size, 3, -1)[..., 0]  # of two rows behind each, here the same
        _, _, right, wrong = directions_of(group.response, probes, orbits.frequency < 0)
        both, against = powers(orbits, right, wrong)
        found = (sizes(first, group.response) <= SUSPECT).all(axis=1) & (against <= SHARE[0] * both).all(axis=1)
        found &= surely_whole(first, group.response)
        found &= surely_straight(orbits, right) & surely_right(orbits, right, group.speed)
    return np.asarray(found)


def keep_clean(test: PerturbationTest) -> None:
    """Keep with a test that it has no errors, for :func:`~rotorfit.checks.checklist.errors`."""
    kept(test).setdefault("errors", ())
