"""Sweeps: readings of one response at one speed in one direction of whirl, in the order of frequency."""

from __future__ import annotations

import numpy as np

from rotorfit.estimators.observations import Responses
from rotorfit.models.array_types import Index


def force_plane(block: Responses) -> Index:
    """Coordinate that the force of each reading acts at, shape ``(R,)``."""
    return np.asarray(np.argmax(np.abs(block.force[block.line]), axis=1))


def sweeps_of(block: Responses, *, synchronous: bool = False) -> list[Index]:
    """Readings of each sweep, ordered by frequency.

    Frequencies that one run holds again, at another level of force, are another sweep.

    Args:
        block: the readings.
        synchronous: the frequency is the speed, so that a sweep runs over speeds.
    """
    w = block.frequency[block.line]
    speed = np.zeros_like(w) if synchronous else np.round(block.speed[block.line], 6)
    keys = np.column_stack([block.label, np.unique(speed, return_inverse=True)[1], w < 0, force_plane(block)])
    place = np.round(block.speed[block.line] if synchronous else w, 9)
    again = _occurrence(np.column_stack([keys, np.unique(place, return_inverse=True)[1]]))
    _, number = np.unique(np.column_stack([keys, again]), axis=0, return_inverse=True)
    order = np.lexsort([w, number.reshape(-1)])
    return np.split(order, np.cumsum(np.bincount(number.reshape(-1)))[:-1])


def _occurrence(keys: Index) -> Index:
    """How often a row's key came before, shape ``(R,)``."""
    _, same = np.unique(keys, axis=0, return_inverse=True)
    same = same.reshape(-1)
    order = np.argsort(same, kind="stable")
    count = np.bincount(same)
    found = np.empty(same.size, dtype=np.intp)
    found[order] = np.arange(same.size) - np.repeat(np.cumsum(count) - count, count)
    return found
