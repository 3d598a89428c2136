"""Numbers as a report prints them."""

from __future__ import annotations

import math

import numpy as np

from rotorfit.base import digits
from rotorfit.base.units import RPM_PER_RAD_S


def plain(value: float, places: int = 5) -> str:
    """A number to a few significant digits with a real minus sign; a dash where there is none."""
    return typeset(digits.significant(value, places)) if math.isfinite(value) else "–"


def with_error(value: float, error: float) -> tuple[str, str]:
    """Value and error, both to the second significant digit of the error; see :mod:`rotorfit.base.digits`."""
    if not (math.isfinite(value) and math.isfinite(error) and error > 0):
        return plain(value), "–"
    shown, spread = digits.with_error(value, error)
    return typeset(shown), typeset(spread)


def typeset(number: str) -> str:
    """A printed number as a page sets it; a dash for one that is not there."""
    if number == "-":
        return "–"
    mantissa, _, exponent = number.partition("e")
    return mantissa.replace("-", "−") + (f"·10{superscript(int(exponent))}" if exponent else "")


def interval(low: float, high: float) -> str:
    """An interval, to the second digit of a quarter of its width, about the standard error."""
    if not (math.isfinite(low) and math.isfinite(high) and high > low):
        return "–"
    ends = digits.interval(low, high)[1:-1].split(", ")
    return f"[{', '.join(map(typeset, ends))}]"


def superscript(exponent: int) -> str:
    """An exponent as it is set, raised."""
    return str(exponent).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))


def speeds_in_words(speeds: np.ndarray[tuple[int], np.dtype[np.float64]]) -> str:
    """Speeds in rpm: all of them if they are few, else their range."""
    rpm = np.unique(np.round(speeds * RPM_PER_RAD_S, 1))
    if rpm.size > 6:
        return f"{rpm[0]:g} to {rpm[-1]:g} rpm"
    return ", ".join(f"{value:g}" for value in rpm) + " rpm"
