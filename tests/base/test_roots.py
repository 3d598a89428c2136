"""Zeros beside those known by formula, and by SciPy's Brent method."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest
from scipy.optimize import brentq

from rotorfit.base.roots import crossing


@pytest.mark.parametrize(
    ("function", "high"),
    [
        (lambda x: x**3 - 2, 5.0),
        (lambda x: math.tanh(50 * (x - 0.3)), 1.0),
        (lambda x: math.exp(x) - 1e5, 100.0),
        (lambda x: 1 / (x + 1e-3) - 7, 10.0),
        (lambda x: x, 1.0),
    ],
)
def test_a_crossing_is_found_in_as_few_steps_as_by_brent(function: Callable[[float], float], high: float) -> None:
    asked = []

    def noted(x: float) -> float:
        asked.append(x)
        return function(x)

    found = crossing(noted, -5e-4, high, 1e-12 * high)
    exact, by_brent = brentq(function, -5e-4, high, xtol=1e-12 * high, full_output=True)
    assert found == pytest.approx(exact, abs=2e-12 * high)
    assert len(asked) <= 1.3 * by_brent.function_calls + 3


def test_a_jump_is_halved() -> None:
    assert crossing(lambda x: 1.0 if x > 0.123 else -2.0, 0.0, 1.0, 1e-9) == pytest.approx(0.123, abs=1e-9)


def test_no_crossing_is_refused() -> None:
    with pytest.raises(ValueError, match="no crossing"):
        crossing(lambda x: x + 2, 0.0, 1.0, 1e-9)
