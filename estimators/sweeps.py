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

    Args:
        block: the readings.
        synchronous: the frequency is the speed, so that a sweep runs over speeds.
    """
    w = block.frequency[block.line]
    speed = np.zeros_like(w) if synchronous else np.round(block.speed[block.line], 6)
    keys = np.column_stack([block.label, np.unique(speed, return_inverse=True)[1], w < 0, force_plane(block)])
    _, number = np.unique(keys, axis=0, return_inverse=True)
    order = np.lexsort([w, number.reshape(-1)])
    return np.split(order, np.cumsum(np.bincount(number.reshape(-1)))[:-1])
