"""Readings of a test put together as orbits, the form in which the data check looks at them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rotorfit.data.experiments import PerturbationTest
from rotorfit.data.linear_force import probe_pairs, whirl_parts
from rotorfit.estimators.blocks.row_keys import combined, in_order, numbers, words
from rotorfit.models.array_types import ComplexArray, Float, Index, Text

ENOUGH = 12
"""Readings needed for a verdict on a run."""

_FAR = 1 / np.sqrt(np.finfo(float).eps)  # condition number from which a matrix is near a singular one

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

    @property
    def names(self) -> list[str]:
        """Names of planes, measured or forced, in order of appearance."""
        return self._planes[0]

    @property
    def place(self) -> Index:
        """Number of the measured plane of each among :attr:`names`."""
        return self._planes[1]

    @property
    def force_place(self) -> Index:
        """Number of the plane of the force of each among :attr:`names`."""
        return self._planes[2]

    @cached_property
    def _planes(self) -> tuple[list[str], Index, Index]:
        measured, place = words(self.plane)
        forced, force_place = words(self.force_plane)
        names = list(dict.fromkeys([*measured, *forced]))
        return names, place, np.array([names.index(name) for name in forced], dtype=np.intp)[force_place]

    @cached_property
    def conditions(self) -> Index:
        """Number of the speed and, to a millionth of a rad/s, the frequency of each."""
        return combined(self._numbers("speed"), numbers(np.round(self.frequency, 6)))

    @cached_property
    def receptances(self) -> list[Receptances | None]:
        """Complete matrices of responses at each speed, in the order of the groups by speed; None where too few."""
        return [receptances_of(self, self.right, at) for _, at in self.groups("speed")]

    def groups(self, *names: str) -> list[tuple[tuple[Any, ...], Index]]:
        """Indices by equal values of columns."""
        if names not in self._groups:
            columns = [getattr(self, name) for name in names]
            first, number = in_order(combined(*[self._numbers(name) for name in names]))
            keys = zip(*[column[first].tolist() for column in columns], strict=True)
            order = np.argsort(number, kind="stable") if first.size > 1 else np.arange(number.size)
            parts = np.split(order, np.cumsum(np.bincount(number))[:-1]) if first.size > 1 else [order]
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


@dataclass(frozen=True, eq=False, kw_only=True)
class Receptances:
    """Responses at one speed where each measured plane was read under a force at each.

    Attributes:
        planes: measured planes, in alphabetic order, shape ``(n,)``.
        frequency: rad/s, ascending, shape ``(N,)``.
        at: orbits, shape ``(N, n n)``, force planes running fastest.
        regular: where matrices are finite and far from singular, shape ``(N,)``.
        H: responses along the force to unit forces there, shape ``(..., M, n, n)``.
        kappa: their inverses.
    """

    planes: list[str]
    frequency: Float
    at: Index
    regular: NDArray[np.bool_]
    H: ComplexArray
    kappa: ComplexArray


def receptances_of(orbits: Orbits, amplitude: ComplexArray, at: Index) -> Receptances | None:
    """Complete matrices of responses, None where there are too few.

    Args:
        orbits: all orbits.
        amplitude: their responses along the force, shape ``(..., N)``; of many tests of one plan all matrices of a
            frequency have to be regular, or it is left out.
        at: orbits of one speed.
    """
    planes, w, index = complete_matrices(orbits, at)
    if w.size < ENOUGH:
        return None
    n = len(planes)
    H = (amplitude[..., index] / orbits.force[index]).reshape(*amplitude.shape[:-1], -1, n, n)
    kappa = _inverse(H)
    regular = np.ones(w.size, dtype=bool)
    if kappa is None:
        regular = np.asarray(invertible(H.reshape(-1, n, n)).reshape(-1, w.size).all(axis=0))
        H = H[..., regular, :, :]
        kappa = np.asarray(np.linalg.inv(H), dtype=complex)
    return Receptances(planes=planes, frequency=w, at=index, regular=regular, H=H, kappa=kappa)


def _inverse(matrices: ComplexArray) -> ComplexArray | None:
    """Inverses of matrices, where their sizes alone show that all are finite and far from singular."""
    try:
        found = np.asarray(np.linalg.inv(matrices), dtype=complex)
    except np.linalg.LinAlgError:
        return None
    # By the norm of Frobenius, which no condition number exceeds; not a number is not smaller.
    size = np.linalg.norm(matrices, axis=(-2, -1)) * np.linalg.norm(found, axis=(-2, -1))
    return found if (size < _FAR).all() else None


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
    directions, number = words(test.direction)
    kind = np.array(["xyz".find(direction) for direction in directions], dtype=np.intp)[number]
    readings = np.flatnonzero(kind >= 0)
    whole = readings.size == kind.size
    first, orbit = in_order(combined(*[numbers(column if whole else column[readings]) for column in columns]))
    first = readings[first]
    place = np.full((first.size, 3), -1, dtype=np.intp)
    place[orbit[::-1], kind[readings][::-1]] = readings[::-1]  # of repeats the first stands for all
    backward = test.frequency[first] < 0
    x, y, right, wrong = directions_of(test.response, place, backward)
    force = np.where(backward, test.force[first].conj(), test.force[first])
    along, number = words(test.force_direction[first])
    share = np.array([{"x": 0.5, "y": 0.5j}.get(axis, 1.0) for axis in along], dtype=complex)[number]
    return Orbits(
        run=test.run[first],
        speed=test.speed[first],
        frequency=test.frequency[first],
        force_plane=test.force_plane[first],
        plane=test.plane[first],
        force=force * share,
        x=x,
        y=y,
        right=right,
        wrong=wrong,
        behind=np.where(place[:, :, None] >= 0, rows[origin][place], -1).reshape(first.size, -1),
    )


def directions_of(
    response: ComplexArray, place: Index, backward: NDArray[np.bool_]
) -> tuple[ComplexArray, ComplexArray, ComplexArray, ComplexArray]:
    """Readings x and y of orbits, and their parts in and against the direction of the force, shape ``(..., N)`` each.

    Args:
        response: readings of one test or of many of one plan, shape ``(..., rows)``.
        place: rows of x, y and z of each orbit, -1 where there is none, shape ``(N, 3)``.
        backward: orbits under a force that turns backward, shape ``(N,)``.
    """
    x, y, z = np.moveaxis(np.where(place >= 0, response[..., place], np.nan), -1, 0)
    single = np.where(np.isnan(x), np.where(backward, -1j, 1j) * y, x)  # a circular orbit has Y = -j X, backward +j X
    plus, minus = (x + 1j * y) / 2, np.conj(x - 1j * y) / 2
    right = np.where(np.isnan(plus), np.where(backward, single.conj(), single), np.where(backward, minus, plus))
    return x, y, np.where(np.isnan(right), z, right), np.where(backward, plus, minus)


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
    measured = np.flatnonzero(np.bincount(orbits.place[at], minlength=len(orbits.names))).tolist()
    planes = sorted(orbits.names[number] for number in measured)
    n = len(planes)
    rank = np.array([planes.index(name) if name in planes else -1 for name in orbits.names], dtype=np.intp)
    row, column = rank[orbits.place[at]], rank[orbits.force_place[at]]
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
    found[found] = np.linalg.cond(matrices[found]) < _FAR
    return found
