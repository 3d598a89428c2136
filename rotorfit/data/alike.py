"""Tests that differ in their readings and speed alone, as the runs of a campaign mostly do: what is worked out of their
plan serves all of them, and what is worked out of their readings can be arrays over tests."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from rotorfit.data.experiments import SYNCHRONOUS_TOLERANCE, Experiment, PerturbationTest
from rotorfit.models.array_types import Bool, ComplexArray, Float, Index

_PLAN = ("frequency", "force", "force_plane", "plane", "direction", "force_direction")
_MOST_ROWS = 200_000  # in one group: some copies of its readings fit into tens of megabytes


@dataclass(frozen=True, eq=False, kw_only=True)
class AlikeTests:
    """Tests of one plan, each of one run at one speed, under turning forces."""

    numbers: Index  # which of the tests that were looked at these are, shape ``(W,)``
    tests: tuple[PerturbationTest, ...]  # the tests
    speed: Float  # rotative speed of each, rad/s, shape ``(W,)``
    response: ComplexArray  # their readings and noise, shape ``(W, N)``; noise is told in all rows or, NaN, in none
    sigma: Float  # their readings and noise, shape ``(W, N)``; noise is told in all rows or, NaN, in none

    def part(self, members: Index) -> AlikeTests:
        """Some of the tests."""
        return AlikeTests(
            numbers=self.numbers[members],
            tests=tuple(self.tests[i] for i in members.tolist()),
            speed=self.speed[members],
            response=self.response[members],
            sigma=self.sigma[members],
        )


def alike(tests: Sequence[Experiment]) -> Iterator[AlikeTests]:
    """Groups of tests of one plan, large ones in parts."""
    groups: dict[tuple[object, ...], list[tuple[int, PerturbationTest]]] = {}
    for number, test in enumerate(tests):
        if isinstance(test, PerturbationTest) and (plan := _plan(test)):
            groups.setdefault(plan, []).append((number, test))
    for members in groups.values():
        first = members[0][1]
        finite = np.isfinite(first.frequency).all() and np.isfinite(first.force).all()
        if not finite or not first.force.all() or first.linear.any():
            continue
        step = max(1, _MOST_ROWS // len(first))
        for begin in range(0, len(members), step):
            numbers, chosen = zip(*members[begin : begin + step], strict=True)
            found = AlikeTests(
                numbers=np.array(numbers),
                tests=chosen,
                speed=np.array([test.speed[0] for test in chosen]),
                response=np.stack([test.response for test in chosen]),
                sigma=np.stack([test.sigma for test in chosen]),
            )
            ordinary = np.flatnonzero(_ordinary(found))
            if ordinary.size:
                yield found if ordinary.size == len(chosen) else found.part(ordinary)


def _plan(test: PerturbationTest) -> tuple[object, ...] | None:
    """What tests of one plan have in common, None for a test of several runs or speeds, or of none."""
    if not len(test) or (test.speed != test.speed[0]).any() or (test.run != test.run[0]).any():
        return None
    columns = [getattr(test, name) for name in _PLAN]
    told = ~np.isnan(test.sigma)
    if told.any() and not told.all():
        return None
    return (bool(told[0]), bool(test.speed[0] == 0), *((c.dtype.str, c.tobytes()) for c in columns))


def _ordinary(found: AlikeTests) -> Bool:
    """Which tests have finite readings, none of them zero, a speed and possible noise, and are no start-ups."""
    finite = np.isfinite(found.response).all(axis=1) & found.response.all(axis=1) & np.isfinite(found.speed)
    possible = (np.isnan(found.sigma) | ((found.sigma > 0) & np.isfinite(found.sigma))).all(axis=1)
    away = np.abs(found.tests[0].frequency - found.speed[:, None])
    swept = (away > SYNCHRONOUS_TOLERANCE * np.abs(found.speed[:, None])).any(axis=1)
    return np.asarray(finite & possible & swept)
