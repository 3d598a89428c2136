"""Runs that are copies of other runs, under the same name in another file or under another name in the same."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from rotorfit.data.experiments import Experiment, PerturbationTest
from rotorfit.data.findings import NO_COPIES, Finding, listed
from rotorfit.models.array_types import Index

_FEWEST = 3  # readings of a run that agree to the last digit from which that is no chance


def copied_runs(tests: Sequence[Experiment]) -> list[list[Finding]]:
    """Runs all of whose readings a run before it has, to the last digit, for each of several tests."""
    first: dict[Any, tuple[int, str]] = {}
    found: list[list[Finding]] = []
    for number, test in enumerate(tests):
        copies: dict[str, str] = {}
        if not isinstance(test, PerturbationTest):
            found.append([])
            continue
        for run in test.runs:
            rows = np.flatnonzero(test.run == run)
            if rows.size >= _FEWEST and test.response[rows].any():
                of, original = first.setdefault(_readings(test, rows), (number, run))
                if (of, original) != (number, run):
                    copies[run] = original if of == number else f"{original} of {tests[of].source or f'test {of + 1}'}"
        found.append([_finding(test, copies)] if copies else [])
    return found


def _readings(test: PerturbationTest, rows: Index) -> tuple[Any, ...]:
    values = (test.speed, test.frequency, test.force, test.response)
    numbers = np.stack([part for column in values for part in (column.real, column.imag)])[:, rows]
    order = np.lexsort(numbers)
    words = tuple(zip(*(getattr(test, name)[rows[order]].tolist() for name in _PLACES), strict=True))
    return words, numbers[:, order].tobytes()


_PLACES = ("force_plane", "plane", "direction")


def _finding(test: PerturbationTest, copies: dict[str, str]) -> Finding:
    pairs = listed([f"{run} is {original}" for run, original in copies.items()])
    text = f"Copies of runs: to the last digit {pairs}. {NO_COPIES}"
    return Finding("warning", "duplicate", text, tuple(np.flatnonzero(np.isin(test.run, list(copies))).tolist()))
