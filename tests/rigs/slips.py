"""Slips of wiring and of sign, as they get into files."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rotorfit.lab.data.experiments import PerturbationTest


def mixed(
    test: PerturbationTest, matrix: Sequence[Sequence[float]], planes: Sequence[str] | None = None
) -> PerturbationTest:
    """Readings of each x/y pair (rx/ry) replaced by ``matrix @ (X, Y)``, at some planes or at all."""
    response = test.response.copy()
    pairs: dict[tuple[object, ...], dict[str, int]] = {}
    columns = (test.run, test.frequency, test.speed, test.force_plane, test.plane)
    for row, key in enumerate(zip(*[column.tolist() for column in columns], strict=True)):
        pairs.setdefault((key, test.direction[row][:-1]), {})[test.direction[row][-1]] = row
    for (key, _), rows in pairs.items():
        if planes is None or key[-1] in planes:
            both = [rows["x"], rows["y"]]
            response[both] = np.asarray(matrix) @ test.response[both]
    return replace(test, response=response)


def turned(test: PerturbationTest, degrees: float, planes: Sequence[str] | None = None) -> PerturbationTest:
    """Probes that sit so many degrees from where they are said to sit, from x towards y."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return mixed(test, [[c, s], [-s, c]], planes)


def exchanged(test: PerturbationTest, planes: Sequence[str] | None = None) -> PerturbationTest:
    """x and y probes exchanged."""
    return mixed(test, [[0, 1], [1, 0]], planes)


def lag_as_lead(test: PerturbationTest) -> PerturbationTest:
    """Phases of lag given as lead."""
    return replace(test, response=test.response.conj(), force=test.force.conj())


def thinned(test: PerturbationTest, step: int) -> PerturbationTest:
    """Every so many frequencies only."""
    lines = np.unique(np.abs(np.round(test.frequency, 6)))[::step]
    return test.select(np.isin(np.abs(np.round(test.frequency, 6)), lines))


def told_as_constant(test: PerturbationTest) -> PerturbationTest:
    """The force of an unbalance told as one that does not change with frequency."""
    return replace(test, force=test.force / np.abs(test.force))


def told_as_unbalance(test: PerturbationTest) -> PerturbationTest:
    """A constant force told as that of an unbalance, at frequencies where the noise for it is much the same."""
    size = np.abs(test.frequency)
    test = test.select(size > size.max() / 3)
    growing = (test.frequency / size.max()) ** 2
    return replace(test, response=test.response / np.abs(test.force), force=growing * test.force / np.abs(test.force))


def renamed(test: PerturbationTest, column: str) -> PerturbationTest:
    """The two values of a column under each other's rows."""
    values = getattr(test, column)
    a, b = np.unique(values)
    return replace(test, **{column: np.where(values == a, b, a)})


def in_radians(test: PerturbationTest, column: str) -> PerturbationTest:
    """Phases in radians in a column of degrees."""
    values = getattr(test, column)
    return replace(test, **{column: np.abs(values) * np.exp(1j * np.radians(np.angle(values)))})


def read_through(
    test: PerturbationTest, seen: Callable[[NDArray[np.float64]], Any], rows: NDArray[np.bool_] | None = None
) -> PerturbationTest:
    """Readings, or some of them, as a channel gives them that makes ``seen(|w|)`` of a displacement of one."""
    factor = np.asarray(seen(np.abs(test.frequency))) * np.ones(len(test))
    return replace(test, response=test.response * (factor if rows is None else np.where(rows, factor, 1.0)))


def forced_by(test: PerturbationTest, factor: complex, rows: NDArray[np.bool_]) -> PerturbationTest:
    """Forces of some readings told so many times as large as they are."""
    return replace(test, force=np.where(rows, factor * test.force, test.force))


def exchanged_runs(test: PerturbationTest, a: str, b: str) -> PerturbationTest:
    """The readings of two runs of one plan under each other's names."""
    response = test.response.copy()
    response[test.run == a], response[test.run == b] = test.response[test.run == b], test.response[test.run == a]
    return replace(test, response=response)


def in_decibels(test: PerturbationTest, unit: float) -> PerturbationTest:
    """Amplitudes as levels over a hundredth of a micrometre, read as numbers of some unit."""
    level = 20 * np.log10(np.abs(test.response) / 1e-8)
    return replace(test, response=level * unit * np.exp(1j * np.angle(test.response)))
