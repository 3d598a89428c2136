"""Sweeps: readings of one response at one speed in one direction of whirl, in the order of frequency."""

from __future__ import annotations

import numpy as np

from rotorfit.estimators.blocks.observations import Responses
from rotorfit.estimators.blocks.row_keys import combined, numbers, occurrence, rows_by
from rotorfit.models.array_types import Bool, Index


def force_plane(block: Responses) -> Index:
    """Coordinate that the force of each reading acts at, shape ``(R,)``."""
    return np.asarray(np.argmax(np.abs(block.force), axis=1))[block.line]


def acts_alone(block: Responses) -> Bool:
    """True if the force of a line acts at one plane, shape ``(L,)``."""
    planes = [coordinate.plane for coordinate in block.model.coordinates]
    forced = [block.force[:, [p == plane for p in planes]].any(axis=1) for plane in dict.fromkeys(planes)]
    return np.asarray(np.sum(forced, axis=0) == 1)


def sweeps_of(block: Responses, *, synchronous: bool = False) -> list[Index]:
    """Readings of each sweep by frequency; another level of force at the same frequencies is another sweep."""
    w = block.frequency[block.line]
    place = block.speed[block.line] if synchronous else w
    speed = np.zeros_like(block.speed) if synchronous else np.round(block.set_speed, 6)
    at = np.unique(speed, return_inverse=True)[1].reshape(-1)[block.line]
    key = combined(block.label, at, (w < 0).astype(np.intp), force_plane(block))
    return rows_by(combined(key, occurrence(combined(key, numbers(np.round(place, 9))))), w)
