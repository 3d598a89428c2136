"""Pulses with their numbers, although some are missing and some are double.

The intervals beside an edge tell where it stands; where several of these are doubled or halved themselves, the way
through all edges does on which the speed changes least; and across short stretches that remain in doubt, the turns on
either side.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import median_filter, percentile_filter

from rotorfit.base.array_types import Bool, Float, Index

_EXTRA_EDGE_PRICE = 0.3
"""Price of an edge left out. To keep one in the middle of a turn costs twice the logarithm of 2."""
_MISSING_EDGE_PRICE = 0.1
"""Price of a doubled interval, and of each further doubling. To count it once costs twice the logarithm of 2."""
_TURNS = np.arange(1.0, 5.0)
"""Turns that an interval may be of, besides those that the speed before it gives."""
EVEN_INTERVALS = 6
"""Such intervals in a row at which the count is certain. Chosen."""
_MARGIN = 1
"""Pulses next to a stretch that are judged with it: one of them may be the edge too many."""
_DEGREES = (3, 5)
"""Degrees of the polynomials that must agree: that of a smooth change of speed, and one with more freedom."""
_SIDE = max(_DEGREES)
"""Pulses on either side: as many as tell both polynomials, the turns in between and the scatter."""
CHATTER = 0.2
"""Share of a turn within which an edge is the second one of the same mark: one that chatters does so after its edge."""


_Stretch = tuple[int, int]
"""First and last edge."""


@dataclass(frozen=True, kw_only=True, eq=False)
class NumberedPulses:
    """Pulses with their numbers: a missing one leaves a gap in the numbers, one too many has none."""

    times: Float  # of the pulses kept, shape ``(N,)``
    numbers: Index  # count from the first pulse, shape ``(N,)``, integers
    missing: Float  # times of the pulses before the gaps, and how many are missing in each, shape ``(G,)`` both
    missing_count: Index  # see ``missing``
    extra: Float  # times of the edges left out
    unsure: Float  # from when to when it is not certain which edges are pulses, shape ``(U, 2)``


def number_pulses(times: Float) -> NumberedPulses:
    """Count pulses by the intervals around them: a gap of n intervals counts n, an edge too close to others is not one.
    Around gaps and edges too many, the way through the edges on which the speed changes least decides: the intervals
    beside an edge do not say which of two is the pulse where they are doubled or split themselves."""
    kept, turns = _by_neighbours(times)
    if kept.size < 4:
        raise ValueError(f"{kept.size} pulses; at least four are needed to know the angle")
    kept, turns = _settled(times, kept, turns)
    kept, turns, unsure = bridged(times, kept, turns, _uneven(times[kept], turns))
    pulses, extra = times[kept], np.delete(times, kept)
    uneven = uneven_turns(pulses, turns)
    if extra.size > kept.size or uneven.size > 0.2 * turns.size:
        raise ValueError(
            f"no regular pulses: {times.size} edges, {extra.size} of them too close to others, and {uneven.size} of "
            f"{turns.size} intervals unlike their neighbours"
        )
    gaps = np.flatnonzero(turns > 1)
    return NumberedPulses(
        times=pulses,
        numbers=np.concatenate([[0], np.cumsum(turns)]),
        missing=pulses[gaps],
        missing_count=turns[gaps] - 1,
        extra=extra,
        unsure=np.array(unsure, dtype=float).reshape(-1, 2),
    )


def uneven_turns(times: Float, turns: Index) -> Float:
    """Times of the pulses that begin turns unlike the two before and the two after them: a shaft has too much inertia.
    A pulse counted once too often or too seldom makes two of three such turns half or twice as long as the others."""
    return np.asarray(times[:-1][_uneven(times, turns)])


def _uneven(times: Float, turns: Index) -> Bool:
    period = np.diff(times) / turns
    # Change of a turn against its neighbours that neither a shaft's speed makes within two turns nor the spacing of
    # teeth, but an edge too many or too few among three, which changes it by a third
    largest_change_of_turn = 0.2
    return np.asarray(np.abs(period / _expected(period) - 1) > largest_change_of_turn)


def _by_neighbours(times: Float) -> tuple[Index, Index]:
    """Edges that are pulses, and the turns between them, by the intervals beside each."""
    pulses = _without_extra(times)
    intervals = np.diff(pulses)
    turns = np.ones(intervals.size, dtype=np.intp)
    for _ in range(8 if intervals.size > 2 else 0):
        counted = np.maximum(np.rint(intervals / _expected(intervals / turns)).astype(np.intp), 1)
        if np.array_equal(counted, turns):
            break
        turns = counted
    return np.searchsorted(times, pulses), turns


def _settled(times: Float, kept: Index, turns: Index) -> tuple[Index, Index]:
    """The count with every disputed stretch of edges taken as its speed changes least."""
    extra = np.setdiff1d(np.arange(times.size), kept)
    odd = np.union1d(extra, np.searchsorted(times, uneven_turns(times[kept], turns)))
    # Edges on either side of an odd one among which the steadiest count is looked for: two stretches that are beyond
    # doubt, and an edge more beside each
    edges_beside = 2 * (EVEN_INTERVALS + 2)
    stretches = np.split(odd, np.flatnonzero(np.diff(odd) > 2 * edges_beside) + 1) if odd.size else []
    most_edges = 100_000  # edges for which it is looked for at most, a quarter of a millisecond each
    if sum(int(np.ptp(stretch)) + 2 * edges_beside for stretch in stretches) > most_edges:
        return kept, turns
    for stretch in stretches[::-1]:  # the last first: places of pulses before it stay as they are
        first = max(int(np.searchsorted(kept, stretch[0] - edges_beside)), 0)
        last = min(int(np.searchsorted(kept, stretch[-1] + edges_beside)), kept.size - 1)
        edges = slice(kept[first], kept[last] + 1)
        own, counted = steadier(times[edges], kept[first : last + 1] - kept[first], turns[first:last])
        kept = np.concatenate([kept[:first], own + kept[first], kept[last + 1 :]])
        turns = np.concatenate([turns[:first], counted, turns[last:]])
    return kept, turns


def from_index(pulses: NumberedPulses, per_turn: int) -> tuple[NumberedPulses, int]:
    """Count from the index of a wheel, the gap of teeth that are missing at the same place of every turn. Returns the
    pulses, counted so that the first tooth after the gap is a multiple of ``per_turn`` and without the gap among the
    missing; and how many teeth the gap leaves out. Without such a gap, the pulses as they were and zero."""
    turns = int(pulses.numbers[-1]) // per_turn
    if turns < 4 or pulses.missing.size < 0.8 * turns:
        return pulses, 0
    before = pulses.numbers[np.searchsorted(pulses.times, pulses.missing)] % per_turn
    place = int(np.bincount(before).argmax())
    at_index = before == place
    if at_index.sum() < 0.8 * turns:
        return pulses, 0
    size = int(np.median(pulses.missing_count[at_index]))
    counted = replace(
        pulses,
        numbers=pulses.numbers + (-(place + size + 1)) % per_turn,
        missing=pulses.missing[~at_index],
        missing_count=pulses.missing_count[~at_index],
    )
    return counted, size


def _expected(intervals: Float) -> Float:
    """Length that an interval should have by its two neighbours on both sides: the median of the five. Beyond the ends
    they are continued as those of a constant acceleration, whose speeds squared go straight with the count: the first
    turns of a start are long, not signs of missing pulses."""
    first, last = _two_before(intervals[:7])[::-1], _two_before(intervals[:-8:-1])
    return np.asarray(median_filter(np.concatenate([first, intervals, last]), 5)[2:-2])


def _two_before(intervals: Float) -> Float:
    """Two intervals before the given ones, the nearer first."""
    squared = intervals**-2.0
    count = np.arange(squared.size)
    slope = float(np.median(np.diff(squared))) if squared.size > 1 else 0.0
    at_first = float(np.median(squared - slope * count))
    return np.asarray(np.maximum(at_first - slope * np.array([1.0, 2.0]), 0.2 * float(squared.min())) ** -0.5)


def _without_extra(times: Float) -> Float:
    """Edges without those that split a turn: of two too close, the one whose removal leaves the more even intervals."""
    kept = times
    short_interval = 0.6  # interval, in expected ones, below which one of its two edges is one too many
    for _ in range(20):
        intervals = np.diff(kept)
        if intervals.size < 4:
            break
        turn = percentile_filter(intervals, 70, 7, mode="mirror")
        short = np.flatnonzero(intervals < short_interval * turn)
        if not short.size:
            break
        bounce = short[intervals[short] < CHATTER * turn[short]]
        if bounce.size:
            kept = np.delete(kept, bounce + 1)
            continue
        out = np.where(_bend(intervals, short, -1) < _bend(intervals, short, 1), short, short + 1)
        out = out[np.concatenate([[True], np.diff(out) > 2])]  # neighbours of one left out are judged again
        kept = np.delete(kept, out)
    return kept


def _bend(intervals: Float, short: Index, side: int) -> Float:
    """How unlike an even change the intervals around a short one are, once it is joined to its neighbour on one side.
    The intervals left and right of the joined one count too, unless they are short themselves or off the record."""
    padded = np.pad(intervals, 3, constant_values=np.nan)
    at = short + 3
    joined = padded[at] + padded[at + side]
    padded[at] = np.nan
    if side < 0:
        row = np.stack([padded[at - 2], joined, padded[at + 1], padded[at + 2]])
    else:
        row = np.stack([padded[at - 2], padded[at - 1], joined, padded[at + 2]])
    bends = np.abs(row[:-2] - 2 * row[1:-1] + row[2:])
    untold = np.isnan(joined) | np.isnan(bends).all(axis=0)
    return np.asarray(np.where(untold, np.inf, np.nansum(bends, axis=0)))


# ---- the steadiest way through the edges ----------------------------------------------------------------------------


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
    # Change of the logarithm of an interval from the last below which the two are of the same number of turns. Chosen.
    largest_change_of_interval = 0.15
    alike = np.abs(np.log(intervals[1:] / intervals[:-1])) < largest_change_of_interval
    clean = np.flatnonzero(np.convolve(alike, np.ones(EVEN_INTERVALS), mode="valid") == EVEN_INTERVALS)
    if not clean.size:
        return kept, turns
    first, last = int(clean[0]), int(clean[-1]) + EVEN_INTERVALS + 1
    ends = np.searchsorted(kept, [first, last])
    if ends[1] >= kept.size or kept[ends[0]] != first or kept[ends[1]] != last:
        return kept, turns
    own, found = kept[ends[0] : ends[1] + 1] - first, turns[ends[0] : ends[1]]
    between = times[first : last + 1]
    other = _followed(between)
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


def _followed(times: Float) -> tuple[Index, Index]:
    """The cheapest way through the edges from the first to the last: the edges on it, and the turns between them.
    Every edge may be left out and every interval may be several turns, at a price (dynamic programming)."""
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
    edges, counted, last = [times.size - 1], [], 0
    while edges[-1]:
        here = ways[edges[-1]]
        edges.append(int(here.before[last]))
        counted.append(int(here.turns[last]))
        last = int(here.way[last])
    return np.array(edges[::-1], dtype=np.intp), np.array(counted[::-1], dtype=np.intp)


# ---- stretches told by the turns on either side ----------------------------------------------------------------------


def bridged(times: Float, kept: Index, turns: Index, uneven: Bool) -> tuple[Index, Index, list[tuple[float, float]]]:
    """The count with short stretches in doubt taken as the turns on either side say. Each stretch is taken for itself,
    then those that are left together with their neighbours."""
    doubtful = np.flatnonzero((turns > 1) | (np.diff(kept) > 1) | uneven)
    # Turns in doubt that are counted so, half a millisecond each; a wheel with a gap has one every turn
    most_doubtful = 10_000
    if not 0 < doubtful.size <= most_doubtful:
        return kept, turns, []
    stretches = [(int(kept[i]), int(kept[i + 1])) for i in doubtful.tolist()]
    for clean in (2 * _MARGIN, _SIDE + 2 * _MARGIN):
        kept, turns, stretches = _told(times, kept, turns, _near_ones(kept, stretches, clean))
    return kept, turns, [(float(times[a]), float(times[b])) for a, b in stretches if _within_turns(times, kept, a, b)]


def _near_ones(kept: Index, stretches: list[_Stretch], clean: int) -> list[_Stretch]:
    """Stretches, those with fewer clean turns between them as one."""
    found: list[_Stretch] = []
    for begin, end in stretches:
        near = found and np.searchsorted(kept, begin) - np.searchsorted(kept, found[-1][1]) < clean
        found.append((found.pop()[0] if near else begin, end))
    return found


def _told(times: Float, kept: Index, turns: Index, stretches: list[_Stretch]) -> tuple[Index, Index, list[_Stretch]]:
    """The count with stretches that the pulses on either side tell, and those that they do not."""
    left_over = []
    for begin, end in stretches[::-1]:  # the last first: places of pulses before it stay as they are
        first, last = int(np.searchsorted(kept, begin)) - _MARGIN, int(np.searchsorted(kept, end)) + _MARGIN
        if first < _SIDE - 1 or last > kept.size - _SIDE:
            left_over.append((begin, end))
            continue
        before = np.concatenate([[0], np.cumsum(turns[first - _SIDE + 1 : first])])
        after = np.concatenate([[0], np.cumsum(turns[last : last + _SIDE - 1])])
        sides = np.concatenate([kept[first - _SIDE + 1 : first + 1], kept[last : last + _SIDE]])
        found = _between(times, sides, np.concatenate([before - before[-1], after]).astype(float))
        if found is None:
            left_over.append((begin, end))
            continue
        kept = np.concatenate([kept[: first + 1], found[0], kept[last:]])
        turns = np.concatenate([turns[:first], found[1], turns[last:]])
    return kept, turns, left_over[::-1]


def _within_turns(times: Float, kept: Index, begin: int, end: int) -> bool:
    """True if edges were left out in the middle of turns, where they are no second ones of a mark that chatters."""
    inside = np.arange(begin, end + 1)
    own = np.clip(np.searchsorted(kept, inside, side="right") - 1, 0, kept.size - 2)
    since, turn = times[inside] - times[kept[own]], times[kept[own + 1]] - times[kept[own]]
    return bool((~np.isin(inside, kept) & (since > CHATTER * turn)).any())


def _between(times: Float, sides: Index, count: Float) -> tuple[Index, Index] | None:
    """Pulses between those on either side, and the turns across; None where these are not smooth enough to tell."""
    last, first = sides[_SIDE - 1], sides[_SIDE]
    edges = np.arange(last + 1, first)
    middle, half = (times[last] + times[first]) / 2, (times[sides[-1]] - times[sides[0]]) / 2
    at, inner = (times[sides] - middle) / half, (times[edges] - middle) / half
    behind = np.repeat([0.0, 1.0], _SIDE)
    across = [np.linalg.lstsq(np.c_[np.vander(at, n + 1), -behind], count, rcond=None)[0][-1] for n in _DEGREES]
    whole = int(np.rint(across[-1]))
    # Doubt of a place, turns, up to which turns are counted: at half a turn two numbers are as likely
    largest_doubt = 0.25
    # Turns across which pulses on either side tell those in between: an uneven speed shows within as many on each
    longest = 3 * _SIDE
    if not 1 <= whole <= longest or np.abs(np.array(across) - whole).max() > largest_doubt:
        return None
    count = count + whole * behind
    simple, place = (np.linalg.lstsq(np.vander(at, n + 1), count, rcond=None)[0] for n in _DEGREES)
    left_over = count - np.polyval(place, at)
    scatter = float(np.sqrt(left_over @ left_over / (at.size - place.size)))
    leverage = np.sum((np.vander(inner, place.size) @ np.linalg.pinv(np.vander(at, place.size))) ** 2, axis=1)
    turn = np.polyval(place, inner)
    scatters = 5.0  # distance of a pulse from its place over its standard error, beyond which an edge is none
    doubt = np.maximum(scatters * scatter * np.sqrt(1 + leverage), np.abs(turn - np.polyval(simple, inner)))
    if doubt.max(initial=0.0) > largest_doubt:
        return None
    number = np.rint(turn).astype(np.intp)
    off = np.abs(turn - number)
    harmless = 0.02  # distance of a pulse from its place, turns, that does no harm
    near = (off < np.maximum(harmless, doubt)) & (number > 0) & (number < whole)
    best = near & (off <= np.array([off[near & (number == k)].min(initial=np.inf) for k in number]))
    return edges[best], np.diff(np.concatenate([[0], number[best], [whole]]))
