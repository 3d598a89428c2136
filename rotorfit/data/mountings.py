"""Runs with trial weights: at which speeds they dwell, and which of them are one mounting.

Runs named ``A005-1``, ``A005-2`` are repeats of one mounting: the weight stayed where it was. A column ``mounting``
says so for any other names. A run that neither tells counts as a mounting of its own.
"""

from __future__ import annotations

import re

import numpy as np

from rotorfit.data.experiments import PerturbationTest
from rotorfit.data.synchronous import OPPOSITE_TOLERANCE
from rotorfit.estimators.blocks.set_speeds import SPEED_TOLERANCE
from rotorfit.models.array_types import Float, Index

MOUNTING = "mounting"
"""Column, and attribute, that names the mounting of each row."""

MOST_DWELLS = 8
"""Speeds of a run up to which it dwelt at them; more are a start-up, which is differenced sample by sample."""

_REPEAT = re.compile(r"(.+)-\d+")
_SAME_WEIGHT = 0.02  # relative difference of mass-radius products that are one weight, written down twice


def dwells(test: PerturbationTest) -> bool:
    """True if every run of a test has at most :data:`MOST_DWELLS` speeds."""
    number = dwell_number(test.speed)
    return all(np.unique(number[test.run == run]).size <= MOST_DWELLS for run in test.runs)


def dwell_number(speed: Float) -> Index:
    """Number of the dwell speed of each reading: neighbours within the tolerance of constant speeds are one."""
    values, inverse = np.unique(speed, return_inverse=True)
    steps = np.diff(values) > SPEED_TOLERANCE * values[1:]
    return np.asarray(np.concatenate([[0], np.cumsum(steps)])[inverse.reshape(-1)], dtype=np.intp)


def tells_mountings(test: PerturbationTest) -> bool:
    """True if the file says which runs are repeats of one mounting."""
    return MOUNTING in test.attributes or any(_REPEAT.fullmatch(run) for run in test.runs)


def mountings(test: PerturbationTest) -> list[str]:
    """Name of the mounting of each row: the column, else the name of the run without the number of the repeat. Runs
    whose weights differ are never one mounting, whatever their names."""
    given = MOUNTING in test.attributes
    if given:
        names = [str(value) for value in test.attributes[MOUNTING].tolist()]
    else:
        found = [(run, _REPEAT.fullmatch(run)) for run in test.run.tolist()]
        names = [run if match is None else match[1] for run, match in found]
    weights = test.forces_by_plane / test.speed[:, None] ** 2
    result: list[str] = []
    seen: dict[str, list[tuple[str, list[complex]]]] = {}
    for name, plane, own in zip(names, test.force_plane.tolist(), weights.tolist(), strict=True):
        kinds = seen.setdefault(name, [])
        place = next((i for i, (at, v) in enumerate(kinds) if at == plane and all(map(_same, own, v))), len(kinds))
        if place == len(kinds):
            kinds.append((plane, own))
        if place and given:
            raise ValueError(
                f"{test.source or 'the test'}: mounting {name} has different weights; a weight that was moved is "
                "another mounting"
            )
        result.append(name if not place else f"{name} ({place + 1})")
    return result


def _same(u: complex, v: complex) -> bool:
    if u == 0 or v == 0:
        return u == v
    turned = abs(float(np.angle(u / v)))
    return abs(abs(u) - abs(v)) <= _SAME_WEIGHT * abs(v) and turned <= OPPOSITE_TOLERANCE
