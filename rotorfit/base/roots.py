"""Where a function crosses zero, without loading SciPy."""

from __future__ import annotations

from collections.abc import Callable


def crossing(function: Callable[[float], float], low: float, high: float, tolerance: float) -> float:
    """A zero between two places where a function has different signs, by inverse quadratic interpolation where it
    pays and halves elsewhere (Chandrupatla, Adv. Eng. Softw. 28 (1997) 145).

    Args:
        function: continuous.
        low, high: the two places.
        tolerance: width of the range that holds the zero, at which the search ends.
    """
    a, b = high, low
    at_a, at_b = function(a), function(b)
    if at_a * at_b > 0:
        raise ValueError(f"no crossing between {low} and {high}: the values are {at_b} and {at_a}")
    share = 0.5
    while True:
        x = a + share * (b - a)
        value = function(x)
        if (value > 0) == (at_a > 0):
            c, at_c = a, at_a
        else:
            c, at_c, b, at_b = b, at_b, a, at_a
        a, at_a = x, value
        best, least = (a, at_a) if abs(at_a) < abs(at_b) else (b, at_b)
        room = tolerance / abs(b - a)
        if room >= 1 or least == 0:
            return best
        place, height = (a - b) / (c - b), (at_a - at_b) / (at_c - at_b)
        share = 0.5
        if height**2 < place and (1 - height) ** 2 < 1 - place:
            share = at_a / (at_b - at_a) * at_c / (at_b - at_c)
            share += (c - a) / (b - a) * at_a / (at_c - at_a) * at_b / (at_c - at_b)
        share = min(1 - room / 2, max(room / 2, share))
