"""Numbers as all tables and sentences write them: to the second significant digit of their error, or to a few digits.

Between 1e-4 and 1e7 numbers are decimal, 0.00069 and 2100; beyond they have an exponent, 6.9e-5. A value and its errors
share theirs.
"""

from __future__ import annotations

import math

NOT_DETERMINED = "not determined"
"""In place of a number that the data do not determine."""

_ROUND_OFF = 1e-14
"""Error over value below which there is none."""


def with_error(value: float, error: float) -> tuple[str, str]:
    """Value and error, both to the second significant digit of the error."""
    shown, spread = with_errors(value, error, error)
    return shown, spread


def with_errors(value: float, error: float, *shares: float) -> list[str]:
    """A value to the second significant digit of its error, and shares of that error to their own, in the exponent of
    the value; a dash for shares that are zero or infinite."""
    if not math.isfinite(value):
        return ["-"] * (1 + len(shares))
    if not (math.isfinite(error) and error > _ROUND_OFF * abs(value)):
        return [significant(value, 6), *(["-"] * len(shares))]
    exponent = _exponent(max(abs(value), error))
    tail, scale = (f"e{exponent}", 10.0**exponent) if exponent else ("", 1.0)
    sizes = [f"{_decimal(share / scale, share / scale)}{tail}" if 0 < share < math.inf else "-" for share in shares]
    return [f"{_decimal(value / scale, error / scale)}{tail}", *sizes]


def _exponent(size: float) -> int:
    """Power of ten that a number is written with, zero for none."""
    smallest = -307  # power of ten of the smallest normal number
    return 0 if 1e-4 <= size < 1e7 else max(math.floor(math.log10(size)), smallest)


def _decimal(value: float, error: float) -> str:
    """A number without exponent to the second significant digit of its error."""
    decimals = 1 - math.floor(math.log10(float(f"{error:.1e}")))  # 0.0996 is 0.10, not 0.100
    if decimals < 0:
        value, decimals = round(value, decimals), 0
    value = round(value, decimals) + 0.0  # no minus sign before a zero
    return f"{value:.{decimals}f}"


def significant(value: float, digits: int, *, sign: bool = False) -> str:
    """A number to a few significant digits, without zeros at its end; with ``sign`` one before positive numbers too."""
    plus = "+" if sign else "-"
    if not (math.isfinite(value) and value):
        return f"{value:{plus}g}"
    rounded = float(f"{value:.{digits - 1}e}")
    if _exponent(abs(rounded)):
        mantissa, _, power = f"{rounded:.{digits - 1}e}".partition("e")
        return f"{float(mantissa):{plus}.{digits}g}e{int(power)}"
    shown = f"{rounded:{plus}.{max(digits - 1 - math.floor(math.log10(abs(rounded))), 0)}f}"
    return shown.rstrip("0").rstrip(".") if "." in shown else shown


def two_digits(value: float, sign: str = "-") -> str:
    """A size to two significant digits, in the style of errors; with ``sign="+"`` one before positive numbers too."""
    if not (math.isfinite(value) and value):
        return f"{value:{sign}g}"
    return f"{'-' if value < 0 else sign.strip('-')}{with_error(0.0, abs(value))[1]}"


def plus_minus(value: float, error: float) -> str:
    """``value +- error``, the value alone where the error is zero, or that the data do not determine it."""
    if not (math.isfinite(value) and math.isfinite(error)):
        return NOT_DETERMINED
    if error <= _ROUND_OFF * abs(value):
        return with_error(value, error)[0]
    return " +- ".join(with_error(value, error))


def interval(low: float, high: float) -> str:
    """An interval, to the second digit of a quarter of its width, about the standard error; words where it is NaN. Ends
    that are decades apart have two digits each: the width says nothing of the lower one."""
    if math.isnan(low) or math.isnan(high):
        return NOT_DETERMINED
    width = (high - low) / 4
    if not width > 0 or math.isinf(width):
        return f"[{significant(low, 6)}, {significant(high, 6)}]"
    largest_end_ratio = 100.0  # ratio of an interval's ends
    if low * high > 0 and max(low / high, high / low) > largest_end_ratio:
        return f"[{significant(low, 2)}, {significant(high, 2)}]"
    exponent = _exponent(max(abs(low), abs(high)))
    tail, scale = (f"e{exponent}", 10.0**exponent) if exponent else ("", 1.0)
    return f"[{_decimal(low / scale, width / scale)}{tail}, {_decimal(high / scale, width / scale)}{tail}]"


def counted(count: int, noun: str) -> str:
    """A number with its noun: ``1 reading``, ``4 readings``."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"
