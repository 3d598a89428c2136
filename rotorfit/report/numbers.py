"""Numbers as a report prints them."""

from __future__ import annotations

import math

import numpy as np

from rotorfit.fitting import digits
from rotorfit.units import RPM_PER_RAD_S


def plain(value: float, places: int = 5) -> str:
    """A number with a few significant digits and a real minus sign; a dash where there is none."""
    if not math.isfinite(value):
        return "–"
    if value and not 1e-4 <= abs(value) < 1e7:
        mantissa, exponent = f"{value:.{places - 1}e}".split("e")
        return f"{mantissa}·10{superscript(int(exponent))}".replace("-", "−")
    shown = f"{value:#.{places}g}" if abs(value) < 10 ** (places - 1) else f"{value:.0f}"
    return shown.rstrip(".").replace("-", "−")


def with_error(value: float, error: float) -> tuple[str, str]:
    """Value and error, both to the second significant digit of the error; see :mod:`rotorfit.fitting.digits`."""
    if not (math.isfinite(value) and math.isfinite(error) and error > 0):
        return plain(value), "–"
    shown, spread = digits.with_error(value, error)
    return _typeset(shown), _typeset(spread)


def _typeset(number: str) -> str:
    mantissa, _, exponent = number.partition("e")
    return mantissa.replace("-", "−") + (f"·10{superscript(int(exponent))}" if exponent else "")


def interval(low: float, high: float) -> str:
    """An interval, to the second digit of a quarter of its width, about the standard error."""
    width = (high - low) / 4
    if not (math.isfinite(low) and math.isfinite(high) and width > 0):
        return "–"
    size = max(abs(low), abs(high))
    if size >= 1e7 or size < 1e-4:
        exponent = math.floor(math.log10(size))
        inner = interval(low / 10**exponent, high / 10**exponent)
        return f"{inner}·10{superscript(exponent)}"
    return f"[{with_error(low, width)[0]}, {with_error(high, width)[0]}]"


def superscript(exponent: int) -> str:
    """An exponent as it is set, raised."""
    return str(exponent).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))


def speeds_in_words(speeds: np.ndarray[tuple[int], np.dtype[np.float64]]) -> str:
    """Speeds in rpm: all of them if they are few, else their range."""
    rpm = np.unique(np.round(speeds * RPM_PER_RAD_S, 1))
    if rpm.size > 6:
        return f"{rpm[0]:g} to {rpm[-1]:g} rpm"
    return ", ".join(f"{value:g}" for value in rpm) + " rpm"
