"""Sweeps: readings of one response at one speed in one direction of whirl, in the order of frequency."""

from __future__ import annotations

import numpy as np

from rotorfit.estimators.blocks.observations import Responses
from rotorfit.estimators.blocks.row_keys import combined
from rotorfit.models.array_types import Bool, Float, Index


def force_plane(block: Responses) -> Index:
    """Coordinate that the force of each reading acts at, shape ``(R,)``."""
    return np.asarray(np.argmax(np.abs(block.force), axis=1))[block.line]


def acts_alone(block: Responses) -> Bool:
    """True if the force of a line acts at one plane, shape ``(L,)``."""
    planes = [coordinate.plane for coordinate in block.model.coordinates]
    forced = [block.force[:, [p == plane for p in planes]].any(axis=1) for plane in dict.fromkeys(planes)]
    return np.asarray(np.sum(forced, axis=0) == 1)


def sweeps_of(block: Responses, *, synchronous: bool = False) -> list[Index]:
    """Readings of each sweep, ordered by frequency. Frequencies that one run holds again, at another level of force,
    are another sweep."""
    kept = block.layout_notes
    if ("sweeps", synchronous) not in kept:
        kept["sweeps", synchronous] = _sweeps(block, synchronous)
    return list(kept["sweeps", synchronous])


def _sweeps(block: Responses, synchronous: bool) -> list[Index]:
    w = block.frequency[block.line]
    place = block.speed[block.line] if synchronous else w
    speed = np.zeros_like(block.speed) if synchronous else np.round(block.set_speed, 6)
    at = np.unique(speed, return_inverse=True)[1].reshape(-1)[block.line]
    key = combined(block.label, at, (w < 0).astype(np.intp), force_plane(block))
    key = combined(key, _occurrence(key, np.round(place, 9)))
    order = np.lexsort([w, key])
    return np.split(order, np.flatnonzero(np.diff(key[order])) + 1) if order.size else []


def _occurrence(key: Index, place: Float) -> Index:
    """How often a row's key and place came before, shape ``(R,)``."""
    order = np.lexsort([place, key])
    new = np.ones(key.size, dtype=bool)
    new[1:] = (np.diff(key[order]) != 0) | (np.diff(place[order]) != 0)
    first = np.flatnonzero(new)
    found = np.empty(key.size, dtype=np.intp)
    found[order] = np.arange(key.size) - first[np.cumsum(new) - 1]
    return found
