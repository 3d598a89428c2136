"""Readings of a test put together as orbits, the form in which the data check looks at them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rotorfit.data.directional import directional
from rotorfit.data.experiments import PerturbationTest
from rotorfit.data.linear_force import probe_pairs, whirl_parts
from rotorfit.data.lines import Lines
from rotorfit.estimators.blocks.response import inverse
from rotorfit.estimators.blocks.row_keys import combined, in_order, numbers
from rotorfit.models.array_types import ComplexArray, Float, Index

ENOUGH = 12
"""Readings needed for a verdict on a run."""

_FAR = 1 / np.sqrt(np.finfo(float).eps)  # condition number from which a matrix is near a singular one

NEAR_1X = 1e-3
"""Readings with |w| this close to the speed, as a fraction, are once-per-turn readings to a tracking filter."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Orbits:
    """Readings of one plane at one frequency, x and y put together; arrays of one length.

    ``force``, ``right`` and ``wrong`` (the component in and against the direction of the force) are relative to
    exp(jwt) with w signed, ``wrong`` to exp(-jwt). It is NaN where only one probe was read, which then counts as a
    circular orbit.
    """

    test: PerturbationTest  # what was measured, forces along an axis as their halves
    lines: Lines  # its rows by lines
    origin: Index  # numbers that each of its rows has in the whole test, shape ``(rows, k)``
    first: Index  # first row of each orbit, shape ``(N,)``
    rows: Index  # rows of its readings x, y and z, -1 where there is none, shape ``(N, 3)``
    frequency: Float  # signed, rad/s, shape ``(N,)`` like all that follow
    force: ComplexArray  # N
    right: ComplexArray  # component in and against the direction of the force, m
    wrong: ComplexArray  # component in and against the direction of the force, m

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
        """Rotative speed of each, rad/s."""
        return self.test.speed[self.first]

    @cached_property
    def x(self) -> ComplexArray:
        """Reading x of each, NaN where there is none."""
        return self._read(0)

    @cached_property
    def y(self) -> ComplexArray:
        """Reading y of each, NaN where there is none."""
        return self._read(1)

    def _read(self, probe: int) -> ComplexArray:
        rows = self.rows[:, probe]
        return np.where(rows >= 0, self.test.response[rows], np.nan)

    @cached_property
    def paired(self) -> NDArray[np.bool_]:
        """Where both x and y were read."""
        return np.asarray((self.rows[:, 0] >= 0) & (self.rows[:, 1] >= 0))

    @cached_property
    def names(self) -> list[str]:
        """Names of planes, measured or forced, in order of appearance."""
        return list(dict.fromkeys([*self.lines.names["plane"], *self.lines.names["force_plane"]]))

    @cached_property
    def place(self) -> Index:
        """Number of the measured plane of each among :attr:`names`."""
        return self._numbers("plane")

    @cached_property
    def force_place(self) -> Index:
        """Number of the plane of the force of each among :attr:`names`."""
        forced = [self.names.index(name) for name in self.lines.names["force_plane"]]
        return np.array(forced, dtype=np.intp)[self._numbers("force_plane")]

    @cached_property
    def frequencies(self) -> tuple[Float, Index]:
        """Distinct frequencies to a millionth of a rad/s, ascending, and the number of that of each."""
        w, number = self.lines.frequencies
        return w, number[self.first]

    @cached_property
    def conditions(self) -> Index:
        """Number of the speed and, to a millionth of a rad/s, the frequency of each."""
        return combined(self._numbers("speed"), self.frequencies[1])

    def receptances(self, most: int | None = None) -> list[Receptances | None]:
        """Complete matrices of responses at each speed, in the order of the groups by speed; None where too few."""
        groups = self.groups("speed")[:most]
        for _, at in groups[len(self._receptances) :]:
            self._receptances.append(receptances_of(self, self.right, at))
        return self._receptances[: len(groups)]

    def groups(self, *names: str) -> list[tuple[tuple[Any, ...], Index]]:
        """Indices by equal values of columns."""
        if names not in self._groups:
            number = self.number(*names)
            first = in_order(number)[0]
            keys = zip(*[getattr(self, name)[first].tolist() for name in names], strict=True)
            order, begin = self._sorted(names)
            self._groups[names] = list(zip(keys, np.split(order, begin[1:]), strict=True)) if first.size else []
        return self._groups[names]

    def number(self, *names: str) -> Index:
        """Number of the group of each, in order of appearance."""
        if names not in self._number:
            first, sweep = self._sweeps
            self._number[names] = in_order(combined(*[self._numbers(name)[first] for name in names]))[1][sweep]
        return self._number[names]

    def total(self, values: NDArray[Any], *names: str) -> NDArray[Any]:
        """Sums over the groups, shape ``(..., G)``."""
        order, begin = self._sorted(names)
        return np.asarray(np.add.reduceat(values[..., order], begin, axis=-1))

    def largest(self, values: Float, *names: str) -> Float:
        """Largest value in the group of each, shape ``(..., N)``."""
        order, begin = self._sorted(names)
        return np.asarray(np.maximum.reduceat(values[..., order], begin, axis=-1)[..., self.number(*names)])

    def _sorted(self, names: tuple[str, ...]) -> tuple[Index, Index]:
        """All group by group, and where each group begins."""
        if names not in self._order:
            number = self.number(*names)
            order = np.argsort(number, kind="stable")
            self._order[names] = order, np.concatenate([[0], np.cumsum(np.bincount(number))[:-1]])
        return self._order[names]

    def _numbers(self, name: str) -> Index:
        return self.lines.number[name][self.first]

    @cached_property
    def _sweeps(self) -> tuple[Index, Index]:
        """First orbit, and number of each, of what one run at one speed under one force measures at one plane."""
        return in_order(combined(*[self._numbers(name) for name in ("run", "speed", "force_plane", "plane")]))

    @cached_property
    def _receptances(self) -> list[Receptances | None]:
        return []

    @cached_property
    def _groups(self) -> dict[tuple[str, ...], list[tuple[tuple[Any, ...], Index]]]:
        return {}

    @cached_property
    def _number(self) -> dict[tuple[str, ...], Index]:
        return {}

    @cached_property
    def _order(self) -> dict[tuple[str, ...], tuple[Index, Index]]:
        return {}

    def part(self, at: Index) -> Orbits:
        """Some of them."""
        arrays = ("first", "rows", "frequency", "force", "right", "wrong")
        return replace(self, **{name: getattr(self, name)[at] for name in arrays})

    def rows_of(self, indices: Index) -> tuple[int, ...]:
        """Rows of the whole test behind orbits."""
        rows = self.rows[indices]
        return tuple(np.unique(self.origin[rows[rows >= 0]]).tolist())


@dataclass(frozen=True, eq=False, kw_only=True)
class Receptances:
    """Responses at one speed where each measured plane was read under a force at each."""

    planes: list[str]  # measured planes, in alphabetic order, shape ``(n,)``
    frequency: Float  # rad/s, ascending, shape ``(N,)``
    at: Index  # orbits, shape ``(N, n n)``, force planes running fastest
    regular: NDArray[np.bool_]  # where matrices are finite and far from singular, shape ``(N,)``
    H: ComplexArray  # responses along the force to unit forces there, shape ``(..., M, n, n)``
    kappa: ComplexArray  # their inverses


def receptances_of(orbits: Orbits, amplitude: ComplexArray, at: Index) -> Receptances | None:
    """Complete matrices of responses, None where there are too few."""
    planes, w, index = _complete_matrices(orbits, at)
    if w.size < ENOUGH:
        return None
    n = len(planes)
    H = (amplitude[..., index] / orbits.force[index]).reshape(*amplitude.shape[:-1], -1, n, n)
    kappa = surely_inverse(H)
    regular = np.ones(w.size, dtype=bool)
    if kappa is None:
        regular = np.asarray(_invertible(H.reshape(-1, n, n)).reshape(-1, w.size).all(axis=0))
        H = H[..., regular, :, :]
        kappa = np.asarray(np.linalg.inv(H), dtype=complex)
    return Receptances(planes=planes, frequency=w, at=index, regular=regular, H=H, kappa=kappa)


def surely_inverse(matrices: NDArray[Any]) -> NDArray[Any] | None:
    """Inverses of matrices where their sizes alone show that all are finite and far from singular."""
    try:
        with np.errstate(all="ignore"):
            found = inverse(matrices.reshape(-1, *matrices.shape[-2:])).reshape(matrices.shape)
    except np.linalg.LinAlgError:
        return None
    # By the norm of Frobenius, which no condition number exceeds; not a number is not smaller.
    return found if (squared_norm(matrices) * squared_norm(found) < _FAR**2).all() else None


def total_power(amplitude: ComplexArray) -> float:
    """Sum of squared magnitudes."""
    return float(np.sum(np.abs(amplitude) ** 2))


def squared_norm(matrices: NDArray[Any]) -> Float:
    """Square of the norm of Frobenius, shape ``(...)``."""
    return np.asarray((matrices.real**2 + matrices.imag**2).sum(axis=(-2, -1)))


def orbits_of(test: PerturbationTest, rows: Index) -> Orbits:
    """Put readings together.

    Under a force along an axis the forward and the backward part are two orbits, each with its half of the force;
    readings of one probe alone, which do not tell them apart, are left out.
    """
    lines, origin = test.lines, rows[:, None]
    if lines.names["force_direction"] != ["circular"]:
        kept = np.setdiff1d(np.arange(len(test)), probe_pairs(test, test.linear)[1])
        test, pairs = whirl_parts(test.select(kept))
        lines, origin = test.lines, rows[kept][pairs]
    probe = np.array(["xyz".find(direction) for direction in lines.names["direction"]], dtype=np.intp)
    probe = probe[lines.number["direction"]]
    readings = np.flatnonzero(probe >= 0)
    first, orbit = in_order(combined(lines.line, lines.number["plane"])[readings])
    place = np.full((first.size, 3), -1, dtype=np.intp)
    place[orbit[::-1], probe[readings][::-1]] = readings[::-1]  # of repeats the first stands for all
    first = readings[first]
    backward = test.frequency[first] < 0
    right, wrong = directional(test.response, place, backward)
    axes = lines.names["force_direction"]
    share = np.array([{"x": 0.5, "y": 0.5j}.get(axis, 1.0) for axis in axes], dtype=complex)
    force = np.where(backward, test.force[first].conj(), test.force[first])
    return Orbits(
        test=test,
        lines=lines,
        origin=origin,
        first=first,
        rows=place,
        frequency=test.frequency[first],
        force=force * share[lines.number["force_direction"][first]],
        right=right,
        wrong=wrong,
    )


def mirrored(orbits: Orbits, at: Index, *names: str) -> Index:
    """Forward and backward orbits at the same |w| in the same group, shape ``(N, 2)``; of repeats the last."""
    w, number = orbits.frequencies
    keys = [numbers(np.abs(w))[number[at]], *([orbits.number(*names)[at]] if names else [])]
    first, pair = in_order(combined(*keys))
    found = np.full((2, first.size), -1, dtype=np.intp)
    for one, some in zip(found, (w[number[at]] > 0, w[number[at]] < 0), strict=True):
        one[pair[some]] = at[some]
    return found[:, (found[0] >= 0) & (found[1] >= 0)].T


def _complete_matrices(orbits: Orbits, at: Index) -> tuple[list[str], Float, Index]:
    """Measured planes, the frequencies at which each of them was read under a force at each, and the orbits there.

    Returns:
        names in alphabetic order, frequencies ascending, and orbits, shape ``(N, n n)``, force planes running fastest.
    """
    measured = np.flatnonzero(np.bincount(orbits.place[at], minlength=len(orbits.names))).tolist()
    planes = sorted(orbits.names[number] for number in measured)
    n = len(planes)
    rank = np.array([planes.index(name) if name in planes else -1 for name in orbits.names], dtype=np.intp)
    row, column = rank[orbits.place[at]], rank[orbits.force_place[at]]
    w, number = orbits.frequencies
    if at.size < number.size:
        there, number = np.unique(number[at], return_inverse=True)
        w = w[there]
    found = np.full((w.size, n * n), -1, dtype=np.intp)
    some = column >= 0
    found[number[some], (row * n + column)[some]] = at[some]
    whole = (found >= 0).all(axis=1)
    return planes, w[whole], found[whole]


def _invertible(matrices: ComplexArray) -> NDArray[np.bool_]:
    """Which of many matrices, shape ``(N, n, n)``, are finite and far from singular."""
    found = np.asarray(np.isfinite(matrices).all(axis=(1, 2)))
    if matrices.shape[-1] == 1:
        return np.asarray(found & (matrices[:, 0, 0] != 0))
    found[found] = np.linalg.cond(matrices[found]) < _FAR
    return found
