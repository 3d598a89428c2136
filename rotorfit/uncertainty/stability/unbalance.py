"""Critical speeds of unbalance responses: amplification factors and separation margins."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from rotorfit.models.array_types import Bool, Float, Index

HALF_POWER = 1 / np.sqrt(2.0)
"""Share of a peak's amplitude between whose speeds the amplification factor is read."""

NO_MARGIN_ASKED = 2.5
"""Amplification factor up to which a critical speed counts as well damped, as API 617 and 684 are cited."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Peaks:
    """One critical speed of many rotors."""

    speed: Float  # of the peak, shape ``(W,)``, NaN for rotors without a peak there
    amplification: Float  # ``N_c / (N_2 - N_1)``, zero where one side does not fall to 0.707 of the peak


def peaks_near(amplitude: Float) -> Index:
    """Places of the peaks of a curve ``(S,)``."""
    from scipy.signal import find_peaks

    return np.asarray(find_peaks(amplitude)[0], dtype=np.intp)


def peaks_of(speed: Float, amplitudes: Float, near: Index) -> list[Peaks]:
    """The peaks of many curves ``(W, S)`` that belong to those of a reference curve."""
    middle = (near[1:] + near[:-1]) // 2
    edges = [0, *middle.tolist(), speed.size]
    found = []
    for low, high in pairwise(edges):
        pairs = np.array([_peak(speed, curve, low, high) for curve in amplitudes]).reshape(-1, 2)
        found.append(Peaks(speed=pairs[:, 0], amplification=pairs[:, 1]))
    return found


def _peak(speed: Float, curve: Float, low: int, high: int) -> tuple[float, float]:
    from scipy.signal import peak_widths

    at = low + int(np.argmax(curve[low:high]))
    if at in (0, speed.size - 1) or not curve[at - 1] < curve[at] >= curve[at + 1]:
        return np.nan, np.nan
    places = np.array([at])
    whole = (curve[places], np.array([0]), np.array([speed.size - 1]))  # down to zero, not to the next valley
    _, _, left, right = peak_widths(curve, places, rel_height=1 - HALF_POWER, prominence_data=whole)
    ends = np.interp([left[0], right[0]], np.arange(speed.size), speed)
    reached = curve[[int(np.floor(left[0])), int(np.ceil(right[0]))]] <= HALF_POWER * curve[at]
    x, y = speed[at - 1 : at + 2], curve[at - 1 : at + 2]  # the top is that of the parabola through three points
    rise, fall = np.diff(y) / np.diff(x)
    top = float((x[0] + x[1]) / 2 + rise / (rise - fall) * (x[2] - x[0]) / 2)
    return top, float(top / (ends[1] - ends[0])) if reached.all() else 0.0


def margin(critical: Float, lowest: float, highest: float) -> Float:
    """Distance of critical speeds from a range of running speeds, as a share of its nearer end; zero inside."""
    below, above = 1 - critical / lowest, critical / highest - 1
    return np.asarray(np.maximum(np.maximum(below, above), 0.0))


def margin_asked(amplification: Float, is_below: Bool) -> Float:
    """Separation margin that API 617 and 684 are said to ask for; shares of the running speed."""
    damped = amplification <= NO_MARGIN_ASKED
    rise = 1 - 1 / (np.where(damped, NO_MARGIN_ASKED, amplification) - 1.5)
    asked = np.where(is_below, np.minimum(0.16, 0.17 * rise), np.minimum(0.26, 0.10 + 0.17 * rise))
    return np.asarray(np.where(damped, 0.0, asked))
