"""Rotative speeds and frequencies as a caller gave them: finite real numbers, or a sentence that says what is wrong."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from rotorfit.base.array_types import Float

HIGHEST_RATE = 1e15
"""Size up to which speeds and frequencies are taken, beyond all machines: the equations of motion do not overflow."""


def real_numbers(values: Any, name: str, allowed: str) -> Float:
    """The value given, as an array; nothing is read from text."""
    try:
        array = np.asarray(values)
    except ValueError as error:  # rows of unequal length
        raise ValueError(f"{name} is {_shown(values)}; it must be {allowed}") from error
    if array.dtype.kind not in "fiu" and array.size:
        raise ValueError(f"{name} is {_shown(values)}; it must be {allowed}")
    return array.astype(float, copy=False)


def real_number(value: Any, name: str, allowed: str) -> float:
    """One real, finite number."""
    array = real_numbers(value, name, allowed)
    if array.ndim or not math.isfinite(array):
        raise ValueError(f"{name} is {_shown(value)}; it must be {allowed}")
    return float(array)


def angular_rate(value: Any, name: str = "speed", unit: str = "rad/s", *, positive: bool = False) -> float:
    """One rotative speed or frequency, signed unless it must be positive."""
    allowed = f"one finite{' positive' if positive else ''} number in {unit}, up to {HIGHEST_RATE:g} in size"
    number = real_number(value, name, allowed)
    if abs(number) > HIGHEST_RATE or (positive and number <= 0):
        raise ValueError(f"{name} is {_shown(value)}; it must be {allowed}")
    return number


def angular_rates(values: Any, name: str = "speed", unit: str = "rad/s") -> Float:
    """Rotative speeds or frequencies, one or several, signed; the shape stays."""
    allowed = f"one or more finite numbers in {unit}, up to {HIGHEST_RATE:g} in size"
    array = real_numbers(values, name, allowed)
    if not array.size:
        raise ValueError(f"{name} is empty; it must be {allowed}")
    if not np.abs(array).max() <= HIGHEST_RATE:  # NaN is not
        first = array[~(np.abs(array) <= HIGHEST_RATE)].flat[0]
        raise ValueError(f"{name} {'is' if array.size == 1 else 'holds'} {first:g}; it must be {allowed}")
    return array


def _shown(value: Any) -> str:
    """The value given, short enough for a sentence."""
    text = " ".join(repr(value).split())
    return text if len(text) <= 40 else f"{text[:37]}..."
