"""Count pulses across short stretches of missing and double ones by the turns on either side.

Where the neighbours of an edge are in doubt themselves, the intervals beside it do not say whether it is a pulse. A
shaft has too much inertia to change its speed within some turns otherwise than smoothly: a polynomial through the
pulses on either side says how many turns lie in between, and where in them a pulse is to be expected.
"""

from __future__ import annotations

import numpy as np

from rotorfit.models.array_types import Bool, Float, Index

_MARGIN = 1
"""Pulses next to a stretch that are judged with it: one of them may be the edge too many."""
_DEGREES = (3, 5)
"""Degrees of the polynomials that must agree: that of a smooth change of speed, and one with more freedom."""
_SIDE = max(_DEGREES)
"""Pulses on either side: as many as tell both polynomials, the turns in between and the scatter."""
_LARGEST_DOUBT = 0.25
"""Doubt of a place, turns, up to which turns are counted: at half a turn two numbers are as likely."""
_HARMLESS = 0.02
"""Distance of a pulse from its place, turns, that does no harm."""
_SCATTERS = 5.0
"""Distance of a pulse from its place over its standard error, beyond which an edge is none."""
CHATTER = 0.2
"""Share of a turn within which an edge is the second one of the same mark: one that chatters does so after its edge."""
_LONGEST = 3 * _SIDE
"""Turns across which pulses on either side tell those in between: an uneven speed shows within as many on each."""
_MOST_DOUBTFUL = 10_000
"""Turns in doubt that are counted so, half a millisecond each; a wheel with a gap has one every turn."""


def bridged(times: Float, kept: Index, turns: Index, uneven: Bool) -> tuple[Index, Index, list[tuple[float, float]]]:
    """The count with short stretches in doubt taken as the turns on either side say. Each stretch is taken for itself,
    then those that are left together with their neighbours."""
    doubtful = np.flatnonzero((turns > 1) | (np.diff(kept) > 1) | uneven)
    if not 0 < doubtful.size <= _MOST_DOUBTFUL:
        return kept, turns, []
    stretches = [(int(kept[i]), int(kept[i + 1])) for i in doubtful.tolist()]
    for clean in (2 * _MARGIN, _SIDE + 2 * _MARGIN):
        kept, turns, stretches = _settled(times, kept, turns, _joined(kept, stretches, clean))
    return kept, turns, [(float(times[a]), float(times[b])) for a, b in stretches if _within_turns(times, kept, a, b)]


_Stretch = tuple[int, int]
"""First and last edge."""


def _joined(kept: Index, stretches: list[_Stretch], clean: int) -> list[_Stretch]:
    """Stretches, those with fewer clean turns between them as one."""
    found: list[_Stretch] = []
    for begin, end in stretches:
        near = found and np.searchsorted(kept, begin) - np.searchsorted(kept, found[-1][1]) < clean
        found.append((found.pop()[0] if near else begin, end))
    return found


def _settled(times: Float, kept: Index, turns: Index, stretches: list[_Stretch]) -> tuple[Index, Index, list[_Stretch]]:
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
    if not 1 <= whole <= _LONGEST or np.abs(np.array(across) - whole).max() > _LARGEST_DOUBT:
        return None
    count = count + whole * behind
    simple, place = (np.linalg.lstsq(np.vander(at, n + 1), count, rcond=None)[0] for n in _DEGREES)
    left_over = count - np.polyval(place, at)
    scatter = float(np.sqrt(left_over @ left_over / (at.size - place.size)))
    leverage = np.sum((np.vander(inner, place.size) @ np.linalg.pinv(np.vander(at, place.size))) ** 2, axis=1)
    turn = np.polyval(place, inner)
    doubt = np.maximum(_SCATTERS * scatter * np.sqrt(1 + leverage), np.abs(turn - np.polyval(simple, inner)))
    if doubt.max(initial=0.0) > _LARGEST_DOUBT:
        return None
    number = np.rint(turn).astype(np.intp)
    off = np.abs(turn - number)
    near = (off < np.maximum(_HARMLESS, doubt)) & (number > 0) & (number < whole)
    best = near & (off <= np.array([off[near & (number == k)].min(initial=np.inf) for k in number]))
    return edges[best], np.diff(np.concatenate([[0], number[best], [whole]]))
