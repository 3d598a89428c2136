"""Tests that differ in their readings and speed alone, as the runs of a campaign mostly do: what is worked out of their
plan serves all of them, and what is worked out of their readings can be arrays over tests."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from rotorfit.data.experiments import SYNCHRONOUS_TOLERANCE, Experiment, PerturbationTest
from rotorfit.models.array_types import ComplexArray, Float, Index

_PLAN = ("frequency", "force", "force_plane", "plane", "direction", "force_direction")


@dataclass(frozen=True, eq=False, kw_only=True)
class AlikeTests:
    """Tests of one plan, each of one run at one speed, under turning forces.

    Attributes:
        numbers: which of the tests that were looked at these are, shape ``(W,)``.
        tests: the tests.
        speed: rotative speed of each, rad/s, shape ``(W,)``.
        response, sigma: their readings and noise, shape ``(W, N)``; noise is told in all rows or, NaN, in none.
    """

    numbers: Index
    tests: tuple[PerturbationTest, ...]
    speed: Float
    response: ComplexArray
    sigma: Float

    def part(self, members: Index) -> AlikeTests:
        """Some of the tests."""
        return AlikeTests(
            numbers=self.numbers[members], tests=tuple(self.tests[i] for i in members.tolist()),
            speed=self.speed[members], response=self.response[members], sigma=self.sigma[members],
        )  # fmt: skip


def alike(tests: Sequence[Experiment]) -> Iterator[AlikeTests]:
    """Groups of tests of one plan; a test that is anything out of the ordinary is in none of them.

    Args:
        tests: any experiments.
    """
    groups: dict[tuple[object, ...], list[int]] = {}
    for number, test in enumerate(tests):
        if isinstance(test, PerturbationTest) and (plan := _plan(test)):
            groups.setdefault(plan, []).append(number)
    for members in groups.values():
        chosen = [test for test in (tests[number] for number in members) if isinstance(test, PerturbationTest)]
        first = chosen[0]
        if first.linear.any() or not (np.isfinite(first.frequency).all() and np.isfinite(first.force).all()):
            continue
        found = AlikeTests(
            numbers=np.array(members), tests=tuple(chosen), speed=np.array([test.speed[0] for test in chosen]),
            response=np.stack([test.response for test in chosen]), sigma=np.stack([test.sigma for test in chosen]),
        )  # fmt: skip
        ordinary = _ordinary(found)
        if first.force.all() and ordinary.any():
            yield found.part(np.flatnonzero(ordinary))


def _plan(test: PerturbationTest) -> tuple[object, ...] | None:
    """What tests of one plan have in common, None for a test of several runs or speeds, or of none."""
    if not len(test) or (test.speed != test.speed[0]).any() or (test.run != test.run[0]).any():
        return None
    columns = [getattr(test, name) for name in _PLAN]
    told = ~np.isnan(test.sigma)
    if told.any() and not told.all():
        return None
    return (bool(told[0]), bool(test.speed[0] == 0), *((c.dtype.str, c.tobytes()) for c in columns))


def _ordinary(found: AlikeTests) -> Index:
    """Which tests have finite readings, a speed and possible noise, and are no start-ups, shape ``(W,)``."""
    finite = np.isfinite(found.response).all(axis=1) & np.isfinite(found.speed)
    possible = (np.isnan(found.sigma) | ((found.sigma > 0) & np.isfinite(found.sigma))).all(axis=1)
    away = np.abs(found.tests[0].frequency - found.speed[:, None])
    swept = (away > SYNCHRONOUS_TOLERANCE * np.abs(found.speed[:, None])).any(axis=1)
    return np.asarray(finite & possible & swept)
