"""Planes of which one answers the other more than the other way round, by one factor at every frequency."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from rotorfit.data.findings import Finding
from rotorfit.diagnosis.orbits import Orbits
from rotorfit.diagnosis.trials.channel_filters import likeness
from rotorfit.estimators.blocks.row_keys import combined, in_order, numbers
from rotorfit.models.array_types import Float, Index
from rotorfit.models.digits import significant

_LARGEST_MEDIAN = 0.4
"""Departure of the median ratio of planes from one, octaves, that stations of probes do not explain."""
_LARGEST_SPREAD = 0.3  # octaves between the quartiles of ratios that one factor explains
_FEWEST_RATIOS = 8  # ratios from which quartiles say anything


def reciprocity(orbits: Orbits) -> Iterator[Finding]:
    """Pairs of planes whose responses to each other's forces differ by one factor."""
    planes = {tuple(sorted(pair)) for pair, _ in orbits.groups("force_plane", "plane") if pair[0] != pair[1]}
    for a, b in sorted(planes):
        logs = _ratios(orbits, a, b)
        if logs.size < _FEWEST_RATIOS:
            continue
        low, middle, high = np.quantile(logs, [0.25, 0.5, 0.75]).tolist()
        if abs(middle) > _LARGEST_MEDIAN and high - low < _LARGEST_SPREAD:
            both = (orbits.at("plane", a) | orbits.at("plane", b)) & (
                orbits.at("force_plane", a) | orbits.at("force_plane", b)
            )
            first, second = (a, b) if middle > 0 else (b, a)
            yield _finding(first, second, float(2 ** abs(middle)), orbits.rows_of(np.flatnonzero(both)))


def _ratios(orbits: Orbits, a: str, b: str) -> Float:
    """log2 of how much more one plane answers a force at another than the other way round, condition by condition."""
    condition = in_order(combined(orbits.number("speed"), numbers(np.round(orbits.frequency, 6))))[1]
    size = np.abs(orbits.right / orbits.force)
    last = np.full((2, int(condition.max()) + 1), -1, dtype=np.intp)
    for found, (forced, plane) in zip(last, ((b, a), (a, b)), strict=True):
        at: Index = np.flatnonzero(orbits.at("force_plane", forced) & orbits.at("plane", plane) & (size > 0))
        found[condition[at]] = at
    there, back = last[:, (last >= 0).all(axis=0)]
    return np.asarray(np.log2(size[there] / size[back]))


def _finding(a: str, b: str, factor: float, rows: tuple[int, ...]) -> Finding:
    """Of planes of which the first answers the second so many times as much as the other way round."""
    text = (
        f"Plane {a} answers forces at {b} {significant(factor, 3)} times as much as {b} answers forces at {a}, "
        "at every frequency; "
        f"on a rotor the two are alike. Either the readings at {a} are {significant(factor, 3)} times too "
        f"large{likeness(factor)}, "
        f"or those at {b} as many times too small{likeness(1 / factor)}, or so are the forces at {b}, or those at {a} "
        "are too large. No fit can tell which: it goes into sigma, or into every mass and stiffness of one plane."
    )
    return Finding("warning", "reciprocity", text, rows, undo="name the unit of the amplitudes, or correct with gains")
