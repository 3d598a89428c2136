"""Readings that no probe gave: zeros in the midst of a sweep, and amplitudes cut off at one value."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from rotorfit.data.experiments import PerturbationTest
from rotorfit.data.findings import Finding
from rotorfit.estimators.blocks.row_keys import combined
from rotorfit.models.array_types import Bool, ComplexArray, Float, Index

_SAME = 1e-9  # relative difference of what is equal to the last digit
_FEWEST = 4  # readings of one channel at its largest value, and
_TOGETHER = 3  # how many of them follow one another, from which it may be cut off
_STEPS = 5.0  # steps of rounding by which readings beside a hole or a flat top differ from it
_LOOKED_AT = 20  # distinct amplitudes that show the step


def unread(test: PerturbationTest) -> Iterator[Finding]:
    """Zeros where the readings beside are far from it, and probes that read nothing but zero."""
    zero = test.response == 0
    if not zero.any():
        return
    channel, size = _channels(test), np.abs(test.response)
    dead = np.bincount(channel, size) == 0
    alone = dead[channel] & ~test.linear
    if alone.any() and not dead.all():
        names = dict.fromkeys(f"{test.direction[row]} at {test.plane[row]}" for row in np.flatnonzero(alone).tolist())
        text = f"Nothing but zero was read by the probe {', '.join(names)}. Remove its rows."
        yield Finding("error", "dead-probe", text, tuple(np.flatnonzero(alone).tolist()))
    holes: list[int] = []
    for sweep in _sweeps(test, channel):
        holes += _holes(sweep, test.response, _step(_distinct(size[channel == channel[sweep[0]]])[:_LOOKED_AT]))
    if holes:
        text = (
            f"Zero: {len(holes)} readings are exactly zero where those beside them are not: cells that were empty, or "
            "lines that were not measured. Remove these rows."
        )
        yield Finding("error", "zero", text, tuple(sorted(holes)))


def clipped(test: PerturbationTest) -> Iterator[Finding]:
    """Amplitudes that stay at the largest value of their probe, to the last digit, over several lines."""
    channel, size = _channels(test), np.abs(test.response)
    flat = _at_the_top(channel, size)
    if np.bincount(channel[flat]).max(initial=0) < _FEWEST:
        return
    ends: set[int] = set()
    for sweep in _sweeps(test, channel):
        own = int(channel[sweep[0]])
        if own not in ends and _flat_top(sweep, size, flat, _step(_distinct(size[channel == own])[-_LOOKED_AT:])):
            ends.add(own)
    cut = np.flatnonzero(flat & np.isin(channel, list(ends))).tolist()
    if cut:
        names = dict.fromkeys(f"{test.direction[row]} at {test.plane[row]}" for row in cut)
        text = (
            f"Cut off: {len(cut)} readings of {', '.join(names)} have the largest amplitude of their probe to the last "
            f"digit, {size[cut].max():.4g} m, line after line, as where a probe or an amplifier is at the end of its "
            "range. Remove these rows."
        )
        yield Finding("error", "clipped", text, tuple(cut))


def _at_the_top(channel: Index, size: Float) -> Bool:
    """Which amplitudes are the largest of their channel, to the last digit, shape ``(..., N)``."""
    top = np.zeros((int(channel.max(initial=0)) + 1, *size.shape[:-1]))
    np.maximum.at(top, channel, size.T)
    return (size >= top[channel].T * (1 - _SAME)) & (size > 0)


def _channels(test: PerturbationTest) -> Index:
    number = test.lines.number
    return combined(number["plane"], number["direction"])


def _sweeps(test: PerturbationTest, channel: Index) -> Iterator[Index]:
    """Rows of one probe in one run and under one force's plane, in the order of frequency."""
    number = test.lines.number
    sweep = combined(number["run"], number["force_plane"], channel)
    order = np.lexsort((test.frequency, sweep))
    return iter(np.split(order, np.flatnonzero(np.diff(sweep[order])) + 1))


def _distinct(size: Float) -> Float:
    """Amplitudes, each once, that are not zero."""
    return np.unique(size[size > 0])


def _step(distinct: Float) -> float:
    """Step to which amplitudes of like size are rounded: files hold so many digits, or so many significant ones."""
    steps = np.diff(distinct)
    steps = steps[steps > _SAME * distinct[1:]]
    return float(steps.min()) if steps.size else 0.0


def _holes(sweep: Index, response: ComplexArray, step: float) -> list[int]:
    """Rows of a sweep that are zero where those beside them, whose mean turns through zero at an antiresonance, do not
    lead to it."""
    read, empty = np.flatnonzero(response[sweep] != 0), np.flatnonzero(response[sweep] == 0)
    if not read.size:
        return []
    after = np.searchsorted(read, empty)
    before, behind = (read[np.clip(at, 0, read.size - 1)] for at in (after - 1, after))
    between = np.abs(response[sweep[before]] + response[sweep[behind]]) / 2
    found: list[int] = sweep[empty[between > _STEPS * step]].tolist()
    return found


def _flat_top(sweep: Index, size: Float, flat: Bool, step: float) -> bool:
    """Whether several readings in a row are at the largest amplitude, and those beside them fall from it steeply."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flat[sweep], [False]]).astype(np.int8)))
    for begin, end in edges.reshape(-1, 2).tolist():
        beside = [size[sweep[at]] for at in (begin - 1, end) if 0 <= at < sweep.size]
        if end - begin >= _TOGETHER and beside and size[sweep[begin]] - min(beside) > _STEPS * step:
            return True
    return False
