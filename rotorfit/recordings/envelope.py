"""Least and largest displacement along a probe in every piece of a stretch: what a long recording looks like."""

from __future__ import annotations

import numpy as np

from rotorfit.models.array_types import Float
from rotorfit.recordings.rig.setup import Probe
from rotorfit.recordings.signals import SAMPLES_OF_A_PIECE, Signals

_BLOCK = 512
"""Samples whose least and largest are kept once they were read: an hour of a channel is some ten thousand of them."""


def envelope(record: Signals, probe: Probe, start: float, stop: float, points: int) -> tuple[Float, Float]:
    """Displacement of the shaft along a probe from one time to another, thinned out by least and largest.

    Args:
        record: the recording.
        probe: one of its probes.
        start, stop: s.
        points: pieces at most; where there are hardly more samples, all of them are given.

    Returns:
        times, s, and displacements about the mean, m; of a piece its least and its largest, one after the other.
    """
    first = int(np.clip(np.floor(start * record.sample_rate), 0, record.size - 1))
    last = int(np.clip(np.ceil(stop * record.sample_rate) + 1, first + 1, record.size))
    size = -(-(last - first) // points)
    if size <= 2:
        return np.arange(first, last) / record.sample_rate, record.displacement(probe, first, last)
    if size < _BLOCK:
        least, most = _extremes(record.displacement(probe, first, last), size)
    else:
        low, high = _blocks(record, probe)
        first -= first % _BLOCK
        count, own = size // _BLOCK, slice(first // _BLOCK, -(-last // _BLOCK))
        least, most = _extremes(low[own], count)[0], _extremes(high[own], count)[1]
        size = count * _BLOCK
    middles = (first + size * (np.arange(least.size) + 0.5)) / record.sample_rate
    return np.repeat(middles, 2), np.column_stack([least, most]).ravel()


def _extremes(values: Float, size: int) -> tuple[Float, Float]:
    """Least and largest of consecutive pieces of so many values, the last of which may be shorter."""
    edges = np.arange(0, values.size, size)
    return np.minimum.reduceat(values, edges), np.maximum.reduceat(values, edges)


def _blocks(record: Signals, probe: Probe) -> tuple[Float, Float]:
    """Least and largest of all blocks of a channel, read once."""
    known = record.__dict__.setdefault("_envelopes", {})
    if probe.channel not in known:
        parts = [
            _extremes(record.displacement(probe, begin, begin + SAMPLES_OF_A_PIECE), _BLOCK)
            for begin in range(0, record.size, SAMPLES_OF_A_PIECE)
        ]
        known[probe.channel] = tuple(np.concatenate(ends) for ends in zip(*parts, strict=True))
    low, high = known[probe.channel]
    return low, high
