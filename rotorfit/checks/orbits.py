"""Readings of a test put together as orbits, the form in which the data check looks at them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from rotorfit.data.experiments import PerturbationTest, Text
from rotorfit.data.linear_force import probe_pairs, whirl_parts
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
    circular orbit.
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
    rows: Sequence[tuple[int, ...]]

    def groups(self, *names: str) -> Iterator[tuple[tuple[str, ...], Index]]:
        """Indices by equal values of columns."""
        found: dict[tuple[str, ...], list[int]] = {}
        for i, key in enumerate(zip(*[getattr(self, name).tolist() for name in names], strict=True)):
            found.setdefault(key, []).append(i)
        for key, indices in found.items():
            yield key, np.array(indices)

    def rows_of(self, indices: Index) -> tuple[int, ...]:
        """Rows of the test behind orbits."""
        return tuple(sorted(row for i in indices.tolist() for row in self.rows[i]))


def orbits_of(test: PerturbationTest, numbers: Index) -> Orbits:
    """Put readings together; ``numbers`` are the rows that they have in the whole test.

    Under a force along an axis the forward and the backward part are two orbits, each with its half of the force;
    readings of one probe alone, which do not tell them apart, are left out.
    """
    alone = probe_pairs(test, test.linear)[1]
    kept = np.setdiff1d(np.arange(len(test)), alone)
    test, origin = whirl_parts(test.select(kept))
    behind = numbers[kept][origin].tolist()
    found: dict[Any, dict[str, int]] = {}
    columns = (test.run, test.speed, test.frequency, test.force_plane, test.force, test.force_direction, test.plane)
    keys = zip(*[column.tolist() for column in columns], strict=True)
    for row, (key, direction) in enumerate(zip(keys, test.direction.tolist(), strict=True)):
        if direction in ("x", "y", "z"):
            found.setdefault(key, {}).setdefault(direction, row)  # of repeats the first stands for all
    first = np.array([next(iter(rows.values())) for rows in found.values()], dtype=np.intp)

    def reading(direction: str) -> ComplexArray:
        values = [test.response[rows[direction]] if direction in rows else np.nan for rows in found.values()]
        return np.array(values, dtype=complex)

    x, y, z = reading("x"), reading("y"), reading("z")
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
        rows=[tuple(sorted({n for row in rows.values() for n in behind[row]})) for rows in found.values()],
    )


def mirrored(orbits: Orbits, at: Index) -> list[tuple[int, int]]:
    """Forward and backward orbits at the same |w|."""
    number = {float(w): int(i) for w, i in zip(np.round(orbits.frequency[at], 6), at, strict=True)}
    return [(number[w], number[-w]) for w in sorted(number) if w > 0 and -w in number]
