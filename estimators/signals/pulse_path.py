"""Count pulses of which many are missing, or many too many: the way through all edges on which the speed changes least.

Counting an interval by its few neighbours loses its way where several of these are doubled or halved themselves. Here
every edge may be left out and every interval may be several turns, at a price; among all ways through the edges the one
is taken whose logarithm of the speed changes least in sum, prices included (dynamic programming over the edges).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rotorfit.models.array_types import Float, Index

_EXTRA_EDGE_PRICE = 0.3
"""Price of an edge left out. To keep one in the middle of a turn costs twice the logarithm of 2."""
_MISSING_EDGE_PRICE = 0.1
"""Price of a doubled interval, and of each further doubling. To count it once costs twice the logarithm of 2."""
_TURNS = np.arange(1.0, 5.0)
"""Turns that an interval may be of, besides those that the speed before it gives."""
_LARGEST_CHANGE_OF_INTERVAL = 0.15
"""Change of the logarithm of an interval from the last below which the two are of the same number of turns. Chosen."""
EVEN_INTERVALS = 6
"""Such intervals in a row at which the count is certain. Chosen."""


@dataclass(frozen=True, eq=False)
class _Ways:
    """The best ways to an edge."""

    period: Float  # logarithm of the last turn's length on each, shape ``(S,)``
    price: Float  # of each, shape ``(S,)``
    before: Index  # edge before this one, shape ``(S,)``
    way: Index  # which of that edge's ways, shape ``(S,)``
    turns: Index  # turns in between, shape ``(S,)``


def steadier(times: Float, kept: Index, turns: Index) -> tuple[Index, Index]:
    """A count of pulses, or the one on which the speed changes less; ends at which the shaft starts or stops stay."""
    intervals = np.diff(times)
    alike = np.abs(np.log(intervals[1:] / intervals[:-1])) < _LARGEST_CHANGE_OF_INTERVAL
    clean = np.flatnonzero(np.convolve(alike, np.ones(EVEN_INTERVALS), mode="valid") == EVEN_INTERVALS)
    if not clean.size:
        return kept, turns
    first, last = int(clean[0]), int(clean[-1]) + EVEN_INTERVALS + 1
    ends = np.searchsorted(kept, [first, last])
    if ends[1] >= kept.size or kept[ends[0]] != first or kept[ends[1]] != last:
        return kept, turns
    own, found = kept[ends[0] : ends[1] + 1] - first, turns[ends[0] : ends[1]]
    between = times[first : last + 1]
    other = _traced(_followed(between))
    if _price(between, *other) >= _price(between, own, found):
        return kept, turns
    return (
        np.concatenate([kept[: ends[0]], other[0] + first, kept[ends[1] + 1 :]]),
        np.concatenate([turns[: ends[0]], other[1], turns[ends[1] :]]),
    )


def _price(times: Float, kept: Index, turns: Index) -> float:
    """Cost of a count: changes of the logarithm of the speed, edges left out, turns without an edge."""
    period = np.log(np.diff(times[kept]) / turns)
    left_out = times.size - kept.size
    return float(
        np.abs(np.diff(period)).sum() + _EXTRA_EDGE_PRICE * left_out + _MISSING_EDGE_PRICE * np.log2(turns).sum()
    )


def _followed(times: Float) -> list[_Ways]:
    """The best ways to every edge, from the first one on."""
    none = np.zeros(1, dtype=np.intp)
    ways = [_Ways(np.full(1, np.nan), np.zeros(1), none, none, none)]
    skipped = 5  # edges in a row that may be left out, less one
    ways_kept = 8  # ways to an edge that are followed further
    for edge in range(1, times.size):
        found: list[tuple[Float, Float, Index, Index, Index]] = []
        for before in range(max(0, edge - skipped), edge):
            left_out = _EXTRA_EDGE_PRICE * (edge - before - 1)
            here, interval = ways[before], float(times[edge] - times[before])
            turns = _TURNS
            if before and interval > _TURNS[-1] * np.exp(here.period[0]):
                turns = np.append(_TURNS, np.rint(interval / np.exp(here.period[0])))
            period = np.log(interval / turns)
            change = np.zeros((turns.size, 1)) if before == 0 else np.abs(period[:, None] - here.period)
            whole = here.price + change
            way = np.argmin(whole, axis=1)
            price = whole[np.arange(turns.size), way] + left_out + _MISSING_EDGE_PRICE * np.log2(turns)
            found.append((period, price, np.full(turns.size, before), way, turns.astype(np.intp)))
        columns = [np.concatenate(parts) for parts in zip(*found, strict=True)]
        best = np.argsort(columns[1], kind="stable")[:ways_kept]
        ways.append(_Ways(*(column[best] for column in columns)))
    return ways


def _traced(ways: list[_Ways]) -> tuple[Index, Index]:
    """The cheapest way to the last edge: the edges on it, and the turns between them."""
    edges, turns = [len(ways) - 1], []
    way = 0
    while edges[-1]:
        here = ways[edges[-1]]
        edges.append(int(here.before[way]))
        turns.append(int(here.turns[way]))
        way = int(here.way[way])
    return np.array(edges[::-1], dtype=np.intp), np.array(turns[::-1], dtype=np.intp)
