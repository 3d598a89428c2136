"""Readings of a test put together as orbits, the form in which the data check looks at them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rotorfit.data.experiments import PerturbationTest, Text
from rotorfit.data.linear_force import probe_pairs, whirl_parts
from rotorfit.estimators.blocks.row_keys import combined, in_order, numbers
from rotorfit.models.array_types import ComplexArray, Float, Index

ENOUGH = 12
"""Readings needed for a verdict on a run."""

NEAR_1X = 1e-3
"""Readings with |w| this close to the speed, as a fraction, are once-per-turn readings to a tracking filter."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Orbits:
    """Readings of one plane at one frequency, x and y put together; arrays of one length.

    ``force``, ``right`` and ``wrong`` (the component in and against the direction of the force) are relative to
    exp(jwt) with w signed. ``wrong``, ``x`` and ``y`` are NaN where only one probe was read, which then counts as a
    circular orbit. ``behind`` are the rows of the test that each was read in, -1 where there is none, shape ``(N, k)``.
    """

    run: Text
    speed: Float
    frequency: Float
    force_plane: Text
    plane: Text
    force: ComplexArray
    x: ComplexArray
    y: ComplexArray
    right: ComplexArray
    wrong: ComplexArray
    behind: Index

    def groups(self, *names: str) -> list[tuple[tuple[Any, ...], Index]]:
        """Indices by equal values of columns."""
        if names not in self._groups:
            columns = [getattr(self, name) for name in names]
            first, number = in_order(combined(*[self._numbers(name) for name in names]))
            keys = zip(*[column[first].tolist() for column in columns], strict=True)
            order = np.argsort(number, kind="stable")
            parts = np.split(order, np.cumsum(np.bincount(number, minlength=first.size))[:-1])
            self._groups[names] = list(zip(keys, parts, strict=True)) if first.size else []
        return self._groups[names]

    def _numbers(self, name: str) -> Index:
        if name not in self._codes:
            self._codes[name] = numbers(getattr(self, name))
        return self._codes[name]

    @cached_property
    def _codes(self) -> dict[str, Index]:
        return {}

    @cached_property
    def _groups(self) -> dict[tuple[str, ...], list[tuple[tuple[Any, ...], Index]]]:
        return {}

    def rows_of(self, indices: Index) -> tuple[int, ...]:
        """Rows of the test behind orbits."""
        rows = np.sort(self.behind[indices], axis=1)
        again = np.zeros(rows.shape, dtype=bool)
        again[:, 1:] = rows[:, 1:] == rows[:, :-1]
        return tuple(np.sort(rows[(rows >= 0) & ~again]).tolist())


def orbits_of(test: PerturbationTest, rows: Index) -> Orbits:
    """Put readings together; ``rows`` are the numbers that those of the test have in the whole of it.

    Under a force along an axis the forward and the backward part are two orbits, each with its half of the force;
    readings of one probe alone, which do not tell them apart, are left out.
    """
    if test.linear.any():
        kept = np.setdiff1d(np.arange(len(test)), probe_pairs(test, test.linear)[1])
        test, rows = test.select(kept), rows[kept]
    test, origin = whirl_parts(test)
    columns = (
        test.run, test.speed, test.frequency, test.force_plane, test.force.real, test.force.imag,
        test.force_direction, test.plane,
    )  # fmt: skip
    readings = np.flatnonzero(np.isin(test.direction, ("x", "y", "z")))
    first, orbit = in_order(combined(*[numbers(column[readings]) for column in columns]))
    first = readings[first]
    place = np.full((first.size, 3), -1, dtype=np.intp)
    for k, direction in enumerate("xyz"):
        mine = test.direction[readings] == direction
        place[orbit[mine][::-1], k] = readings[mine][::-1]  # of repeats the first stands for all
    x, y, z = np.where(place >= 0, test.response[place], np.nan).T
    backward = test.frequency[first] < 0
    single = np.where(np.isnan(x), np.where(backward, -1j, 1j) * y, x)  # a circular orbit has Y = -j X, backward +j X
    plus, minus = (x + 1j * y) / 2, np.conj(x - 1j * y) / 2
    right = np.where(np.isnan(plus), np.where(backward, single.conj(), single), np.where(backward, minus, plus))
    force = np.where(backward, test.force[first].conj(), test.force[first])
    share = np.select([test.force_direction[first] == axis for axis in "xy"], [0.5, 0.5j], 1.0)
    return Orbits(
        run=test.run[first],
        speed=test.speed[first],
        frequency=test.frequency[first],
        force_plane=test.force_plane[first],
        plane=test.plane[first],
        force=force * share,
        x=x,
        y=y,
        right=np.where(np.isnan(right), z, right),
        wrong=np.where(backward, plus, minus),
        behind=np.where(place[:, :, None] >= 0, rows[origin][place], -1).reshape(first.size, -1),
    )


def mirrored(orbits: Orbits, at: Index) -> Index:
    """Forward and backward orbits at the same |w|, in ascending order, shape ``(N, 2)``."""
    w, last = np.unique(np.round(orbits.frequency[at][::-1], 6), return_index=True)
    of = at[::-1][last]
    ahead = np.flatnonzero(w > 0)
    place = np.minimum(np.searchsorted(w, -w[ahead]), max(w.size - 1, 0))
    both = w[place] == -w[ahead]
    return np.column_stack([of[ahead[both]], of[place[both]]])


def complete_matrices(orbits: Orbits, at: Index) -> tuple[list[str], Float, Index]:
    """Measured planes, the frequencies at which each of them was read under a force at each, and the orbits there.

    Returns:
        names in alphabetic order, frequencies ascending, and orbits, shape ``(N, n n)``, force planes running fastest.
    """
    planes = sorted(set(orbits.plane[at].tolist()))
    n = len(planes)
    row, column = (
        np.select([names[at] == plane for plane in planes], list(range(n)), -1)
        for names in (orbits.plane, orbits.force_plane)
    )
    w, number = np.unique(np.round(orbits.frequency[at], 6), return_inverse=True)
    found = np.full((w.size, n * n), -1, dtype=np.intp)
    some = column >= 0
    found[number.reshape(-1)[some], (row * n + column)[some]] = at[some]
    whole = (found >= 0).all(axis=1)
    return planes, w[whole], found[whole]


def invertible(matrices: ComplexArray) -> NDArray[np.bool_]:
    """Which of many matrices, shape ``(N, n, n)``, are finite and far from singular."""
    found = np.asarray(np.isfinite(matrices).all(axis=(1, 2)))
    if matrices.shape[-1] == 1:
        return np.asarray(found & (matrices[:, 0, 0] != 0))
    found[found] = np.linalg.cond(matrices[found]) < 1 / np.sqrt(np.finfo(float).eps)
    return found
