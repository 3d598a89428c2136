"""Runs of one test that stand in several files: a run without a trial weight in one, runs with it in others."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from rotorfit.lab.data.experiments import PerturbationTest
from rotorfit.lab.data.rows import Experiment
from rotorfit.lab.data.synchronous import join
from rotorfit.lab.data.weights import difference_unless_solved

T = TypeVar("T", bound=Experiment)


def join_runs(tests: Sequence[PerturbationTest], *, difference: bool = True) -> PerturbationTest:
    """One test of the runs of several, differenced as :func:`rotorfit.read` does with runs of one file.

    Balancing records the run without a trial weight and the run with it in two files; alone, neither says anything of
    the rotor. Files of a run by its name, one for each probe, are one run; runs of one name that a probe read twice
    are distinguished by the name of their file. Attributes that only some of the tests have are left out.

    Args:
        tests: of the same machine; of files read with ``difference=False``.
        difference: difference the runs of a synchronous test, see :func:`rotorfit.difference_synchronous`.

    Raises:
        TypeError: something else than perturbation tests.
        ValueError: no test at all, or planes whose names differ only in capitals.

    Example:
        >>> one, other = (rig.select(rig.force_plane == plane) for plane in ("disk", "journal"))
        >>> len(rf.join_runs([one, other])) == len(rig)
        True
    """
    for test in tests:
        if not isinstance(test, Experiment) or test.perturbation is None:
            raise TypeError(f"runs of perturbation tests can be joined, not a {type(test).__name__}")
    if not tests:
        raise ValueError("there are no tests to join")
    check_planes_spelt(tests)
    shared = set.intersection(*(set(test.attributes) for test in tests))
    source = ", ".join(dict.fromkeys(test.source for test in tests if test.source))
    parts = []
    for test in runs_apart(tests):
        attributes = {name: values for name, values in test.attributes.items() if name in shared}
        parts.append(replace(test, attributes=attributes, source=source))
    whole = join(parts)
    return difference_unless_solved(whole) if difference and whole.synchronous else whole


def runs_apart(tests: Sequence[T]) -> tuple[T, ...]:
    """Tests without two runs of one name: where a probe read a run of that name in several tests of a kind, these are
    different runs, and each is named with its file. Runs that stand in several files, one for each probe, stay one."""
    if len(tests) < 2:
        return tuple(tests)
    read: Counter[tuple[Any, ...]] = Counter()  # kind of a test, run and probe
    for test in tests:
        told = [name for name in ("run", "plane", "direction") if hasattr(test, name)]
        columns, first = [getattr(test, name) for name in told], test.alike(*told)[0]
        read.update((test.title, *row) for row in zip(*(column[first].tolist() for column in columns), strict=True))
    twice = {(kind, run) for (kind, run, *_), count in read.items() if count > 1}
    apart = []
    for test, where in zip(tests, _places(tests), strict=True):
        names, number = test.category("run")
        renamed = [f"{name} ({where})" if (test.title, name) in twice else name for name in names]
        apart.append(test if renamed == names else replace(test, run=np.array(renamed)[number]))
    return tuple(apart)


def _places(tests: Sequence[Experiment]) -> list[str]:
    """Names of the files of tests without suffix, with it where two are alike, or else numbered."""
    stems = [Path(test.source).stem or "test" for test in tests]
    alike = Counter(map(str.casefold, stems))
    sources = Counter(test.source.casefold() for test in tests)
    return [
        stem
        if alike[stem.casefold()] == 1
        else test.source
        if test.source and sources[test.source.casefold()] == 1
        else f"{test.source or stem} #{number}"
        for number, (stem, test) in enumerate(zip(stems, tests, strict=True), 1)
    ]


def check_planes_spelt(tests: Sequence[PerturbationTest]) -> None:
    """Refuse names that differ only in capitals: as two planes they would share nothing."""
    spelt: dict[str, tuple[str, str]] = {}
    for test in tests:
        for plane in (*test.planes, *test.force_planes):
            words = f"plane {plane!r}" + (f" of {test.source}" if test.source else "")
            first, there = spelt.setdefault(plane.casefold(), (plane, words))
            if plane != first:
                raise ValueError(f"{there} and {words} differ only in capitals: write one plane alike everywhere")
