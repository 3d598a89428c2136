"""Runs of one test that stand in several files: a run without a trial weight in one, runs with it in others."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from rotorfit.data.experiments import PerturbationTest
from rotorfit.data.synchronous import join
from rotorfit.data.weights import differenced


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
        if not isinstance(test, PerturbationTest):
            raise TypeError(f"runs of perturbation tests can be joined, not a {type(test).__name__}")
    if not tests:
        raise ValueError("there are no tests to join")
    check_planes_spelt(tests)
    shared = set.intersection(*(set(test.attributes) for test in tests))
    probes = Counter(
        key
        for test in tests
        for key in {*zip(test.run.tolist(), test.plane.tolist(), test.direction.tolist(), strict=True)}
    )
    twice = {run for (run, *_), count in probes.items() if count > 1}
    parts = []
    for number, test in enumerate(tests):
        where = Path(test.source).stem or f"test {number + 1}"
        run = np.array([f"{name} ({where})" if name in twice else name for name in test.run.tolist()])
        attributes = {name: values for name, values in test.attributes.items() if name in shared}
        source = ", ".join(dict.fromkeys(t.source for t in tests if t.source))
        parts.append(replace(test, run=run, attributes=attributes, source=source))
    whole = join(parts)
    return differenced(whole) if difference and whole.synchronous else whole


def check_planes_spelt(tests: Sequence[PerturbationTest]) -> None:
    """Refuse names that differ only in capitals: as two planes they would share nothing."""
    spelt: dict[str, tuple[str, str]] = {}
    for test in tests:
        for plane in (*test.planes, *test.force_planes):
            words = f"plane {plane!r}" + (f" of {test.source}" if test.source else "")
            first, there = spelt.setdefault(plane.casefold(), (plane, words))
            if plane != first:
                raise ValueError(f"{there} and {words} differ only in capitals: write one plane alike everywhere")
