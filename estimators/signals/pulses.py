"""Pulses of a phase reference: edges of a Keyphasor's voltage, counted although some are missing and some are double.

A Keyphasor sees a notch (voltage falls) or a projection (voltage rises) once a turn. Between two samples the edge is
interpolated at the level half way between the two voltages; a hysteresis keeps noise at the edge from being counted.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import median_filter, percentile_filter

from rotorfit.estimators.signals.pulse_bridges import CHATTER, bridged
from rotorfit.estimators.signals.pulse_path import EVEN_INTERVALS, steadier
from rotorfit.models.array_types import Bool, Float, Index
from rotorfit.models.digits import significant

NOISE_STEP_OVER_SCATTER = 3.3
"""Distance of the two voltages over their scatter: Gaussian noise cut in two has 2.7, a sine 4.1, a pulse more."""
_HISTOGRAM_BINS = 512
"""Bins of the histogram of voltages: one is a five-hundredth of their range."""
_SHORT_INTERVAL = 0.6
"""Interval, in expected ones, below which one of its two edges is one too many."""
_LARGEST_CHANGE_OF_TURN = 0.2
"""Change of a turn against its neighbours that neither a shaft's speed makes within two turns nor the spacing of teeth,
but an edge too many or too few among three, which changes it by a third."""
_EDGES_BESIDE = 2 * (EVEN_INTERVALS + 2)
"""Edges on either side of an odd one among which the steadiest count is looked for: two stretches that are beyond
doubt, and an edge more beside each."""


@dataclass(frozen=True, kw_only=True)
class PulseLevels:
    """Voltages of a pulse train."""

    low: float  # voltage between pulses, V
    high: float  # voltage of pulses, V
    level: float  # where an edge is timed, V
    hysteresis: float  # distance from the level that the voltage must reach on both sides, V
    falling: bool  # whether the timed edge falls
    duty: float  # share of the time that the pulse lasts
    noise: float  # scatter of the voltage between edges, V


@dataclass(frozen=True, kw_only=True, eq=False)
class NumberedPulses:
    """Pulses with their numbers: a missing one leaves a gap in the numbers, one too many has none."""

    times: Float  # of the pulses kept, shape ``(N,)``
    numbers: Index  # count from the first pulse, shape ``(N,)``, integers
    missing: Float  # times of the pulses before the gaps, and how many are missing in each, shape ``(G,)`` both
    missing_count: Index  # see ``missing``
    extra: Float  # times of the edges left out
    unsure: Float  # from when to when it is not certain which edges are pulses, shape ``(U, 2)``


def find_levels(voltage: Float, *, edge: str = "", level: float | None = None) -> PulseLevels:
    """The two voltages of a pulse train and the leading edge of its pulse, found where not given. The split is Otsu's
    (largest variance between the two classes). The pulse is what takes less than half of the time; its leading edge is
    timed: falling for a notch, rising for a projection."""
    bottom, top = float(voltage.min()), float(voltage.max())
    if not top > bottom:
        raise ValueError(f"no pulses: the voltage is constant at {significant(bottom, 4)} V")
    counts, at = np.histogram(voltage, _HISTOGRAM_BINS, (bottom, top))
    centres = (at[1:] + at[:-1]) / 2
    below = np.cumsum(counts)[:-1]
    above = voltage.size - below
    moment = np.cumsum(counts * centres)
    between = below * above * (moment[:-1] / below - (moment[-1] - moment[:-1]) / np.maximum(above, 1)) ** 2
    best = np.flatnonzero(between >= between.max() * (1 - 1e-9))  # a plateau where nothing lies between the classes
    split = float(at[1 + round(best.mean())])
    lower, upper = voltage[voltage <= split], voltage[voltage > split]
    low, high = _plateau(lower, top - bottom), _plateau(upper, top - bottom)
    scatter = float(np.hypot(lower.std(), upper.std()) / np.sqrt(2))
    if high - low < NOISE_STEP_OVER_SCATTER * scatter:
        raise ValueError(
            f"no pulses: the voltage, {significant(bottom, 4)} to {significant(top, 4)} V, does not jump "
            "between two levels; is it the channel "
            "of the Keyphasor?"
        )
    if level is not None and not low < level < high:
        raise ValueError(
            f"the level {level:g} V is not between the two voltages of the pulses, {significant(low, 4)}, "
            f"{significant(high, 4)} V"
        )
    duty = min(lower.size, upper.size) / voltage.size
    falling = lower.size <= upper.size if not edge else edge == "falling"
    timed = (low + high) / 2 if level is None else level
    return PulseLevels(
        low=low,
        high=high,
        level=timed,
        hysteresis=0.4 * min(high - timed, timed - low),
        falling=falling,
        duty=duty,
        noise=float(1.4826 * np.median(np.abs(upper - high))),
    )


def _plateau(voltage: Float, span: float) -> float:
    """Where most of the samples are: the median leans towards the ramps of wide edges, by degrees of the shaft."""
    counts, at = np.histogram(voltage, max(round(_HISTOGRAM_BINS * np.ptp(voltage) / span), 1))
    level_bins = 15  # bins that the noise of a level fills, a few hundredths of the jump
    smooth = np.convolve(counts, np.ones(level_bins), mode="same")
    top = int(np.argmax(smooth))
    centre = float(at[top] + at[top + 1]) / 2
    near = voltage[np.abs(voltage - centre) <= level_bins * span / _HISTOGRAM_BINS]
    return float(np.median(near))


def find_edges(pieces: Iterable[Float], levels: PulseLevels) -> Float:
    """Positions of timed edges, in samples from the first piece on, interpolated at the level, shape ``(N,)``."""
    sign = -1.0 if levels.falling else 1.0
    found: list[Float] = []
    begin, held = 0, np.zeros(0)  # held: the samples since the voltage was last clear of the hysteresis
    for piece in pieces:
        values = np.concatenate([held, (piece - levels.level) * sign])
        clear = np.flatnonzero(np.abs(values) > levels.hysteresis)
        above = values[clear] > 0
        rows = np.flatnonzero(above[1:] & ~above[:-1])
        found.append(begin - held.size + _crossings(values, clear[rows], clear[rows + 1]))
        begin += piece.size
        held = values[clear[-1] :] if clear.size else values
    return np.concatenate(found) if found else np.zeros(0)


def _crossings(values: Float, first: Index, last: Index) -> Float:
    """Where ``values`` pass zero upwards between pairs of samples."""
    at = first - values[first] / (values[last] - values[first])
    for row in np.flatnonzero(last - first > 1):
        at[row] = _crossing(values, int(first[row]), int(last[row]))
    return np.asarray(at)


def _crossing(values: Float, first: int, last: int) -> float:
    """Where ``values`` pass zero upwards between two samples; the mean of the ways up where noise crosses often."""
    part = values[first : last + 1]
    rows = np.flatnonzero((part[:-1] < 0) & (part[1:] >= 0))
    return float(first + np.mean(rows - part[rows] / (part[rows + 1] - part[rows])))


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
    return np.asarray(np.abs(period / _expected(period) - 1) > _LARGEST_CHANGE_OF_TURN)


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
    stretches = np.split(odd, np.flatnonzero(np.diff(odd) > 2 * _EDGES_BESIDE) + 1) if odd.size else []
    most_edges = 100_000  # edges for which it is looked for at most, a quarter of a millisecond each
    if sum(int(np.ptp(stretch)) + 2 * _EDGES_BESIDE for stretch in stretches) > most_edges:
        return kept, turns
    for stretch in stretches[::-1]:  # the last first: places of pulses before it stay as they are
        first = max(int(np.searchsorted(kept, stretch[0] - _EDGES_BESIDE)), 0)
        last = min(int(np.searchsorted(kept, stretch[-1] + _EDGES_BESIDE)), kept.size - 1)
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
    first, last = _continued(intervals[:7])[::-1], _continued(intervals[:-8:-1])
    return np.asarray(median_filter(np.concatenate([first, intervals, last]), 5)[2:-2])


def _continued(intervals: Float) -> Float:
    """Two intervals before the given ones, the nearer first."""
    squared = intervals**-2.0
    count = np.arange(squared.size)
    slope = float(np.median(np.diff(squared))) if squared.size > 1 else 0.0
    at_first = float(np.median(squared - slope * count))
    return np.asarray(np.maximum(at_first - slope * np.array([1.0, 2.0]), 0.2 * float(squared.min())) ** -0.5)


def _without_extra(times: Float) -> Float:
    """Edges without those that split a turn: of two too close, the one whose removal leaves the more even intervals."""
    kept = times
    for _ in range(20):
        intervals = np.diff(kept)
        if intervals.size < 4:
            break
        turn = percentile_filter(intervals, 70, 7, mode="mirror")
        short = np.flatnonzero(intervals < _SHORT_INTERVAL * turn)
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
