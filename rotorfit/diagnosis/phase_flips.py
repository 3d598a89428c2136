"""Pairs of probes whose readings turn by half a turn from one line to the next, as no rotor's do.

A response changes its sign in one step where it passes zero, at an antiresonance, or through infinity, at a resonance
that hardly is damped: it then changes by as much as its own size between the lines beside that too. Readings that are
smooth on both sides, and of one size, were inverted on one of them.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from rotorfit.data.findings import Finding, listed
from rotorfit.diagnosis.orbits import Orbits
from rotorfit.models.array_types import ComplexArray, Float, Index
from rotorfit.models.digits import significant
from rotorfit.units import RPM_PER_RAD_S

_LINES_BESIDE = 3  # lines on either side that have to be smooth
_LARGEST_STEP = 0.3
"""Change from line to line, over the response and scaled to the step of frequency at the jump, of a smooth response: at
a resonance or an antiresonance between two lines it is one half at least."""


def half_turns(orbits: Orbits) -> Iterator[Finding]:
    """Planes whose readings change their sign between two lines of a sweep."""
    found: dict[tuple[str, float, float], list[Index]] = {}
    for (_, plane, _, _), at in orbits.groups("run", "plane", "force_plane", "speed"):
        for side in (at[orbits.frequency[at] > 0], at[orbits.frequency[at] < 0]):
            sweep = side[np.argsort(np.abs(orbits.frequency[side]), kind="stable")]
            w = np.abs(orbits.frequency[sweep])
            if sweep.size < 2 * _LINES_BESIDE or (np.diff(w) == 0).any():
                continue
            for k in _jumps(w, orbits.right[sweep] / orbits.force[sweep]).tolist():
                found.setdefault((plane, float(w[k]), float(w[k + 1])), []).append(sweep)
    for (plane, low, high), sweeps in found.items():
        hit = np.concatenate(sweeps)
        text = (
            f"At {plane} the readings turn by half a turn between {significant(low * RPM_PER_RAD_S, 4)} and "
            f"{significant(high * RPM_PER_RAD_S, 4)} rpm, and are smooth on both sides, as no rotor's are, in "
            f"{listed(list(dict.fromkeys(orbits.run[hit].tolist())))}. Either side may be the inverted one: check "
            "range, polarity and filters of the probes there, and the angle of the force."
        )
        yield Finding("warning", "half-turn", text, orbits.rows_of(np.sort(hit)))


def _jumps(w: Float, response: ComplexArray) -> Index:
    """Lines of a sweep after which the response goes on with the other sign."""
    step, size = np.abs(np.diff(response)), np.abs(response)
    at = np.arange(_LINES_BESIDE - 1, w.size - _LINES_BESIDE)
    jump = np.diff(w)[at]
    smooth = np.ones(at.size, dtype=bool)
    for k in range(1, _LINES_BESIDE):
        for near, end in ((at - k, at - k + 1), (at + k, at + k)):  # steps before and behind, and where they end
            smooth &= step[near] * np.maximum(jump / np.diff(w)[near], 1.0) < _LARGEST_STEP * size[end]
    opposite = np.abs(response[at] + response[at + 1]) < _LARGEST_STEP * step[at]
    return np.asarray(at[smooth & opposite])
