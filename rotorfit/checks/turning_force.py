"""A force that turns, read as one along an axis: no orbit then holds the other half of its response.

A force along an axis drives a rotor forward and backward at once, with equal halves. What answers to one of the two
alone, at most frequencies, was driven by a force that turns.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from rotorfit.checks.orbits import ENOUGH
from rotorfit.data.experiments import PerturbationTest
from rotorfit.data.findings import Finding, listed
from rotorfit.data.linear_force import probe_pairs
from rotorfit.estimators.blocks.row_keys import combined, in_order, numbers

_NOTHING = 1e-3
"""Share of the lesser half, in power, that is none: a rotor whose forward whirl hardly loses more than it gains answers
30 times less backward only next to its resonance."""


def turning_force(test: PerturbationTest) -> Iterator[Finding]:
    """Runs whose orbits turn one way throughout, though the force was given along an axis."""
    if not test.linear.any():
        return
    x, y = probe_pairs(test, test.linear)[0].T
    ahead = np.abs(test.response[x] + 1j * test.response[y]) ** 2
    behind = np.abs(test.response[x] - 1j * test.response[y]) ** 2
    run = in_order(combined(numbers(test.run[x]), numbers(test.force_plane[x])))[1]
    turns: dict[str, bool] = {}
    for number in range(int(run.max(initial=-1)) + 1):
        own = np.flatnonzero((run == number) & (ahead + behind > 0))
        if own.size < ENOUGH:
            continue
        lesser, greater = sorted((ahead[own], behind[own]), key=np.sum)
        name = str(test.run[x[own[0]]])
        turns[name] = turns.get(name, True) and bool(np.median(lesser / (lesser + greater)) < _NOTHING)
    found = [name for name, turning in turns.items() if turning]
    if found:
        text = (
            f"All orbits in {listed(found)} turn one way, as under a force that turns; one along an axis drives a "
            "rotor forward and backward at once. Leave force_direction out there, or write circular."
        )
        yield Finding("error", "turning-force", text, tuple(np.flatnonzero(np.isin(test.run, found)).tolist()))
