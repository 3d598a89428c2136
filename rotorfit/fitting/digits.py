"""Numbers as tables print them: to the second significant digit of their error."""

from __future__ import annotations

import math

from rotorfit.estimators.significance import CHANCE_ERRORS

_LARGEST_END_RATIO = 100.0  # ratio of an interval's ends


def with_error(value: float, error: float) -> tuple[str, str]:
    """Value and error, both to the second significant digit of the error."""
    if not math.isfinite(value):
        return "-", "-"
    if not (math.isfinite(error) and error > 0):
        return f"{value:.6g}", "-"
    size = max(abs(value), error)
    if not 1e-4 <= size < 1e7:
        exponent = math.floor(math.log10(size))
        a, b = with_error(value / 10**exponent, error / 10**exponent)
        return f"{a}e{exponent}", f"{b}e{exponent}"
    decimals = 1 - math.floor(math.log10(float(f"{error:.1e}")))  # 0.0996 is 0.10, not 0.100
    if decimals < 0:
        value, error, decimals = round(value, decimals), round(error, decimals), 0
    value = round(value, decimals) + 0.0  # no minus sign before a zero
    return f"{value:.{decimals}f}", f"{error:.{decimals}f}"


def two_digits(value: float, sign: str = "-") -> str:
    """A size to two significant digits, in the style of errors; with ``sign="+"`` one before positive numbers too."""
    if not (math.isfinite(value) and value):
        return f"{value:{sign}g}"
    return f"{'-' if value < 0 else sign.strip('-')}{with_error(0.0, abs(value))[1]}"


def is_left_open(value: float, error: float, systematic: float) -> bool:
    """True if what the data do not show may well move a number by more than itself: two such shares of it, beyond what
    its error does. Then it is no number."""
    return CHANCE_ERRORS * systematic > abs(value) and systematic > error


def plus_minus(value: float, error: float) -> str:
    """``value +- error``, the value alone where the error is zero, or that the data do not determine it."""
    if not (math.isfinite(value) and math.isfinite(error)):
        return "not determined"
    if error <= 0:
        return with_error(value, error)[0]
    return " +- ".join(with_error(value, error))


def interval(low: float, high: float) -> str:
    """An interval, to the second digit of a quarter of its width, about the standard error; words where it is NaN. Ends
    that are decades apart have two digits each: the width says nothing of the lower one."""
    if math.isnan(low) or math.isnan(high):
        return "not determined"
    width = (high - low) / 4
    if not width > 0 or math.isinf(width):
        return f"[{low:.6g}, {high:.6g}]"
    if low * high > 0 and max(low / high, high / low) > _LARGEST_END_RATIO:
        return f"[{low:.2g}, {high:.2g}]"
    return f"[{with_error(low, width)[0]}, {with_error(high, width)[0]}]"
