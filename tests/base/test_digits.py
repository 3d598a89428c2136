"""Numbers in tables: two digits of the error, one unit, sums of what is known only together, groups in order."""

from __future__ import annotations

import math

import pytest

from rotorfit.base.digits import interval, plus_minus, significant, with_error, with_errors


@pytest.mark.parametrize(
    ("value", "error", "shown"),
    [
        (448.3712, 0.3113, ("448.37", "0.31")),
        (448.3712, 31.13, ("448", "31")),
        (448371.2, 3113.0, ("448400", "3100")),
        (0.47344, 0.0000147, ("0.473440", "0.000015")),
        (1.0, 0.0996, ("1.00", "0.10")),
        (-0.001, 0.31, ("0.00", "0.31")),
        (1.2345e-9, 1e-11, ("1.234e-9", "0.010e-9")),
        (2.5e9, 1e7, ("2.500e9", "0.010e9")),
        (5.0, 0.0, ("5", "-")),
        (5.0, math.inf, ("5", "-")),
    ],
)
def test_a_number_has_the_digits_that_its_error_leaves_it(value, error, shown):
    assert with_error(value, error) == shown


def test_what_is_not_determined_says_so():
    assert plus_minus(3.0, math.inf) == "not determined"
    assert plus_minus(math.nan, 1.0) == "not determined"
    assert interval(1.0, math.inf) == "[1, inf]"
    assert interval(0.473147, 0.473737) == "[0.47315, 0.47374]"
    assert interval(5.13e-7, 4.49e-4) == "[5.1e-7, 0.00045]"
    assert interval(-200.0, -1.23) == "[-200, -1.2]"
    assert interval(-1.0, 200.0) == "[-1, 200]"


@pytest.mark.parametrize(
    ("value", "digits", "shown"),
    [
        (0.0, 3, "0"), (1.0004, 3, "1"), (2104.0, 2, "2100"), (212345.0, 3, "212000"), (9.9996, 3, "10"),
        (0.00012345, 3, "0.000123"), (6.9e-5, 2, "6.9e-5"), (-3.25e-12, 3, "-3.25e-12"), (1.5e8, 2, "1.5e8"),
        (99999999.0, 3, "1e8"), (math.inf, 3, "inf"),
        (5e-324, 3, "4.94e-324"), (-1.7e308, 2, "-1.7e308"),
    ],
)  # fmt: skip
def test_a_number_without_error_is_decimal_or_has_a_short_exponent(value, digits, shown):
    assert significant(value, digits) == shown


def test_a_value_and_all_its_errors_have_one_exponent():
    assert with_errors(5e-324, 5e-324)[0].endswith("e-307")  # below the powers of ten that there are
    assert with_errors(-4e-9, 4.3e-9, 4.2e-9, 1e-9, 0.0) == ["-4.0e-9", "4.2e-9", "1.0e-9", "-"]
    assert with_errors(-4e-9, 4.3e-8, 4.2e-9) == ["-0.4e-8", "0.42e-8"]
    assert with_errors(0.47235, 0.018, 6.9e-5) == ["0.472", "0.000069"]
