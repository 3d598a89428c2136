"""Speeds that a rotor was set to, about which the logged ones wander."""

from __future__ import annotations

import numpy as np

from rotorfit.base.array_types import Bool, Float, Index

SPEED_TOLERANCE = 0.005
"""Speeds closer than this fraction are one constant speed that jitters; see :func:`set_speeds`."""


def set_speeds(speed: Float, frequency: Float, run: Index, tolerance: float = SPEED_TOLERANCE) -> Float:
    """The constant speed that each logged one belongs to, a mean, rad/s. Sorted speeds of a run without a gap of more
    than twice ``tolerance`` (relative) are one, unless they span ten: then the speed was swept, and stays, as do runs
    at once-per-turn frequency. Speeds of several runs without a gap of a tolerance, and within two, are one."""
    steady = np.bincount(run, ~once_per_turn(frequency, speed))[run] > 0
    if not steady.any() or np.ptp(speed[steady]) == 0:
        return speed
    found = speed.copy()
    found[steady] = _means_by_run(speed[steady], run[steady], tolerance)
    values = np.unique(found[steady])
    breaks = np.flatnonzero(np.diff(values) > tolerance * np.abs(values[1:])) + 1
    for group in np.split(values, breaks):
        if 0 < group[-1] - group[0] <= 2 * tolerance * abs(group[-1]):
            rows = steady & (found >= group[0]) & (found <= group[-1])
            found[rows] = speed[rows].mean()
    return found


ONLY_1X = (
    "all forces turn with the shaft (1x), which shows a fluid's D (1 - lam) as one number: a threshold speed needs D "
    "and lam apart, hence forces at other frequencies too, forward and backward, or lam known (known=, --known)"
)
"""Why synchronous data give no threshold speed."""


def once_per_turn(frequency: Float, speed: Float) -> Bool:
    """Readings at once-per-turn frequency."""
    synchronous_tolerance = 1e-4  # A reading is 1x when its frequency equals its speed to this fraction of the speed
    return np.abs(frequency - speed) <= synchronous_tolerance * np.abs(speed)


def _means_by_run(speed: Float, run: Index, tolerance: float) -> Float:
    """For each reading the mean of the speeds of its run that are about the same, itself where the speed was swept."""
    order = np.lexsort([speed, run])
    ordered = speed[order]
    # Of 50 lines that jitter by 0.3 % one is a tolerance from all others in one run of fifty.
    apart = (np.diff(run[order]) != 0) | (np.diff(ordered) > 2 * tolerance * np.abs(ordered[1:]))
    begin = np.r_[0, np.flatnonzero(apart) + 1]
    size = np.diff(np.r_[begin, speed.size])
    low, high = ordered[begin], ordered[begin + size - 1]
    mean = low + np.add.reduceat(ordered - np.repeat(low, size), begin) / size  # of equal speeds to the last digit
    # Tolerances that the speed of one run may wander over: 5 %, more than a drive without a governor slips under load
    wander_tolerances = 10
    steady = np.repeat(high - low <= wander_tolerances * tolerance * np.abs(high), size)
    found = np.empty_like(speed)
    found[order] = np.where(steady, np.repeat(mean, size), ordered)
    return found
