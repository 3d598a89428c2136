"""Channels that come late, by another card or filter: their samples at the times of the others."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from rotorfit.base.array_types import Float


def on_time(read: Callable[[int, int], Float], first: int, last: int, size: int, late: float) -> Float:
    """Samples of a channel that comes late, as they would have been on time. Between samples the signal is what a
    windowed sinc makes of its neighbours; beyond the ends of the recording it goes on as the end's image in the first
    or last sample. Of shape ``(last - first,)``."""
    if last <= first:
        return read(first, last)
    whole = math.floor(late)
    half = 32  # samples on either side that a value between two samples is made of
    taps = np.arange(1 - half, half + 1)
    beta = 8.0  # of Kaiser's window: errors stay below 1e-4 of what vibrates up to 0.44 of the sampling rate
    weights = np.sinc(late - whole - taps) * np.kaiser(2 * half + 1, beta)[1:]
    begin, end = first + whole + int(taps[0]), last + whole + int(taps[-1])
    there = read(min(max(begin, 0), size - 1), max(min(end, size), 1))
    before, behind = max(-begin, 0), max(end - size, 0)
    # odd about the ends: no step, as an even image or zeros would make
    head = 2 * there[0] - read(1, before + 1)[::-1] if before else there[:0]
    tail = 2 * there[-1] - read(size - 1 - behind, size - 1)[::-1] if behind else there[:0]
    return np.convolve(np.concatenate([head, there, tail]), (weights / weights.sum())[::-1], "valid")
