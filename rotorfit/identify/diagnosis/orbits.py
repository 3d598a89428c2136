"""Readings of a test put together as orbits, the form in which the check of the data looks at them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rotorfit.base.array_types import ComplexArray, Float, Index
from rotorfit.estimators.blocks.row_keys import combined, in_order, numbers, rows_by
from rotorfit.lab.data.experiments import PerturbationTest
from rotorfit.lab.data.findings import listed
from rotorfit.lab.data.linear_force import directional, probe_pairs, whirl_parts

FEWEST_READINGS = 12
"""Readings needed for a verdict on a run."""

_ENOUGH_READINGS = 5000
"""Readings that are enough for a verdict of a search, which takes time and memory for each. Chosen."""

SYNCHRONOUS_DISTANCE = 1e-3
"""Readings with |w| this close to the speed, as a fraction, are once-per-turn readings to a tracking filter."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Orbits:
    """Readings of one plane at one frequency, x and y put together; arrays of one length. ``force``, ``right`` and
    ``wrong`` (the component in and against the direction of the force) are relative to exp(jwt) with w signed,
    ``wrong`` to exp(-jwt). It is NaN where only one probe was read, which then counts as a circular orbit."""

    test: PerturbationTest  # what was measured, forces along an axis as their halves
    origin: Index  # numbers that each of its rows has in the whole test, shape ``(rows, k)``
    first: Index  # first row of each orbit, shape ``(N,)``
    rows: Index  # rows of its readings x, y and z, -1 where there is none, shape ``(N, 3)``
    frequency: Float  # signed, rad/s, shape ``(N,)`` like all that follow
    force: ComplexArray  # N
    right: ComplexArray  # component in the direction of the force, m
    wrong: ComplexArray  # component against it, m

    @cached_property
    def run(self) -> NDArray[np.str_]:
        """Run of each."""
        return self.test.run[self.first]

    @cached_property
    def plane(self) -> NDArray[np.str_]:
        """Measured plane of each."""
        return self.test.plane[self.first]

    @cached_property
    def force_plane(self) -> NDArray[np.str_]:
        """Plane of the force of each."""
        return self.test.force_plane[self.first]

    @cached_property
    def speed(self) -> Float:
        """Rotative speed that each was set to, rad/s."""
        return self.test.set_speed[self.first]

    def xy(self, at: Index) -> tuple[ComplexArray, ComplexArray]:
        """Readings x and y of some, NaN where there is none."""
        x, y = (np.where(rows >= 0, self.test.response[rows], np.nan) for rows in self.rows[at, :2].T)
        return x, y

    @cached_property
    def paired(self) -> NDArray[np.bool_]:
        """Where both x and y were read."""
        return np.asarray((self.rows[:, 0] >= 0) & (self.rows[:, 1] >= 0))

    @cached_property
    def driven(self) -> NDArray[np.bool_]:
        """Where the measured plane is that of the force."""
        return np.asarray(self.plane == self.force_plane)

    def number(self, *names: str) -> Index:
        """Number of the group of equal values of columns that each belongs to, in order of appearance."""
        columns = ["set_speed" if name == "speed" else name for name in names]
        return in_order(combined(*[self.test.category(name).number[self.first] for name in columns]))[1]

    def groups(self, *names: str) -> list[tuple[tuple[Any, ...], Index]]:
        """Indices by equal values of columns."""
        parts = rows_by(self.number(*names))
        return [(tuple(getattr(self.test, name)[self.first[at[0]]].item() for name in names), at) for at in parts]

    def part(self, at: Index) -> Orbits:
        """Some of them."""
        if at.size == self.first.size:
            return self
        arrays = ("first", "rows", "frequency", "force", "right", "wrong")
        return replace(self, **{name: getattr(self, name)[at] for name in arrays})

    def rows_of(self, indices: Index) -> tuple[int, ...]:
        """Rows of the whole test behind orbits."""
        rows = self.rows[indices]
        return tuple(np.unique(self.origin[rows[rows >= 0]]).tolist())

    def runs(self, indices: Index) -> str:
        """Runs of orbits in words."""
        return listed(list(dict.fromkeys(self.run[indices].tolist())))


def enough(count: int) -> slice:
    """Every so many of some readings, enough for a verdict."""
    return slice(None, None, max(1, -(-count // _ENOUGH_READINGS)))


def total_power(amplitude: ComplexArray) -> float:
    """Sum of squared magnitudes."""
    return float(np.sum(np.abs(amplitude) ** 2))


def orbits_of(test: PerturbationTest, rows: Index) -> Orbits:
    """Readings of a test, which are such rows of a whole, put together. Under a force along an axis the forward and the
    backward part are two orbits, each with its half of the force; readings of one probe alone, which do not tell them
    apart, are left out, but for those along the force on a rotor at rest."""
    origin = rows[:, None]
    if test.category("force_direction").names != ["circular"]:
        lonely = probe_pairs(test, test.linear)[1]
        planar = (test.speed == 0) & (np.char.lstrip(test.direction, "r") == test.force_direction)
        kept = np.setdiff1d(np.arange(len(test)), lonely[~planar[lonely]])
        test, pairs = whirl_parts(test.select(kept), planar[kept])
        origin = rows[kept][pairs]
    directions, direction = test.category("direction")
    probe = np.array(["xyz".find(name) for name in directions], dtype=np.intp)[direction]
    readings = np.flatnonzero(probe >= 0)
    first, orbit = in_order(combined(test.lines[1], test.category("plane").number)[readings])
    place = np.full((first.size, 3), -1, dtype=np.intp)
    place[orbit[::-1], probe[readings][::-1]] = readings[::-1]  # of repeats the first stands for all
    first = readings[first]
    backward = test.frequency[first] < 0
    right, wrong = directional(test.response, place, backward)
    axes, axis = test.category("force_direction")
    share = np.array([{"x": 0.5, "y": 0.5j}.get(name, 1.0) for name in axes], dtype=complex)
    force = np.where(backward, test.force[first].conj(), test.force[first])
    return Orbits(
        test=test,
        origin=origin,
        first=first,
        rows=place,
        frequency=test.frequency[first],
        force=force * share[axis[first]],
        right=right,
        wrong=wrong,
    )


def orbits_of_tests(tests: Sequence[PerturbationTest]) -> list[Orbits]:
    """Orbits of each of several tests whose readings all stand under one force."""
    return [orbits_of(test, np.arange(len(test))) for test in tests if test.force.all() and not test.several.any()]


def mirrored(orbits: Orbits, at: Index, *names: str) -> Index:
    """Forward and backward orbits at the same |w| in the same group, shape ``(N, 2)``; of repeats the last."""
    w = np.round(orbits.frequency[at], 6)
    first, pair = in_order(combined(numbers(np.abs(w)), orbits.number(*names)[at]))
    found = np.full((2, first.size), -1, dtype=np.intp)
    for one, some in zip(found, (w > 0, w < 0), strict=True):
        one[pair[some]] = at[some]
    return found[:, (found[0] >= 0) & (found[1] >= 0)].T
