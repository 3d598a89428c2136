"""Pulses of a phase reference: the levels and edges of a Keyphasor's voltage.

A Keyphasor sees a notch (voltage falls) or a projection (voltage rises) once a turn. Where edge and level are given,
the voltage need not have two levels: the pulses of a magnetic pickup cross the level, and grow with the speed.
Between two samples the edge is interpolated at the level half way between the two voltages; a hysteresis keeps noise
at the edge from being counted.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from rotorfit.base.array_types import Float
from rotorfit.base.digits import significant

NOISE_STEP_OVER_SCATTER = 3.3
"""Distance of the two voltages over their scatter: Gaussian noise cut in two has 2.7, a sine 4.1, a pulse more."""
_HISTOGRAM_BINS = 512
"""Bins of the histogram of voltages: one is a five-hundredth of their range."""


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
    two_levels = high - low >= NOISE_STEP_OVER_SCATTER * scatter
    if edge and level is not None and not (two_levels and low < level < high):
        return _crossings(voltage, falling=edge == "falling", level=level)
    if not two_levels:
        raise ValueError(
            f"no pulses: the voltage, {significant(bottom, 4)} to {significant(top, 4)} V, does not jump between two "
            "levels; is it the channel of the Keyphasor? Of a magnetic pickup, whose pulses go to both sides of a "
            "level and grow with the speed, say edge and level_V (0.0)"
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


def _crossings(voltage: Float, *, falling: bool, level: float) -> PulseLevels:
    """A level that pulses cross, whatever their size: that of magnetic pickups grows with the speed. What is not noise
    crosses it; the noise is that of second differences, in which slow pulses hardly show."""
    bottom, top = float(voltage.min()), float(voltage.max())
    noise = float(1.4826 * np.median(np.abs(np.diff(voltage, 2))) / np.sqrt(6))
    clear_of_noise = 8.0  # deviations of the noise on either side of the level
    hysteresis = max(clear_of_noise * noise, 1e-3 * (top - bottom))
    if not bottom + hysteresis < level < top - hysteresis:
        raise ValueError(
            f"no pulses cross the level of {level:g} V clear of the noise, {significant(noise, 2)} V: the voltage is "
            f"{significant(bottom, 4)} to {significant(top, 4)} V"
        )
    share = float(np.mean(voltage > level))
    return PulseLevels(
        low=bottom,
        high=top,
        level=level,
        hysteresis=hysteresis,
        falling=falling,
        duty=min(share, 1 - share),
        noise=noise,
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
        first, last = clear[rows], clear[rows + 1]
        at = first - values[first] / (values[last] - values[first])
        for row in np.flatnonzero(last - first > 1).tolist():  # the mean of the ways up where noise crosses often
            part = values[first[row] : last[row] + 1]
            ups = np.flatnonzero((part[:-1] < 0) & (part[1:] >= 0))
            at[row] = first[row] + np.mean(ups - part[ups] / (part[ups + 1] - part[ups]))
        found.append(begin - held.size + at)
        begin += piece.size
        held = values[clear[-1] :] if clear.size else values
    return np.concatenate(found) if found else np.zeros(0)
