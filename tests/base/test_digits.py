"""Numbers in tables: two digits of the error, one unit, sums of what is known only together, groups in order."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest
from synthetic import SPEEDS, TYPICAL, circular_test, covering_frequencies, known_of

import rotorfit as rf
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
    ],
)  # fmt: skip
def test_a_number_without_error_is_decimal_or_has_a_short_exponent(value, digits, shown):
    assert significant(value, digits) == shown


def test_a_value_and_all_its_errors_have_one_exponent():
    assert with_errors(-4e-9, 4.3e-9, 4.2e-9, 1e-9, 0.0) == ["-4.0e-9", "4.2e-9", "1.0e-9", "-"]
    assert with_errors(-4e-9, 4.3e-8, 4.2e-9) == ["-0.4e-8", "0.42e-8"]
    assert with_errors(0.47235, 0.018, 6.9e-5) == ["0.472", "0.000069"]


@pytest.fixture(scope="module")
def open_sum():
    return rf.fit(rf.models.WhirlWhip(), rf.datasets.rig_open())


def test_what_is_known_only_as_a_sum_gives_the_sum_with_its_error(open_sum):
    """K3 known would leave K0 with the error of the sum: no other parameter knows how the two share it."""
    told = rf.fit(rf.models.WhirlWhip(), rf.datasets.rig_open(), known={"K3": 6000.0})
    expected = plus_minus(6000.0 + told.params["K0"].value, told.params["K0"].stderr)
    assert f"determined: K3 + K0 = {expected} N/m" in open_sum.summary()


def test_summary_profile_and_budget_have_one_unit_and_say_what_is_extrapolated(open_sum):
    text = open_sum.summary()
    found = re.search(r"threshold speed: ([\d.]+) \+- [\d.]+ rpm.* above the highest tested speed \(2000 rpm\)", text)
    assert found
    assert "extrapolated" in text
    rpm = float(found[1])
    told = rf.fit(rf.models.WhirlWhip(), rf.datasets.rig_open(), known={"K3": 6000.0})
    profile = str(told.profile("threshold_speed"))
    exact = re.match(r"threshold_speed: ([\d.]+), 95 % \[[\d., ]+\] rpm", profile)
    assert exact
    assert abs(float(exact[1]) - rpm) <= 0.5  # the summary rounds by the systematic share, too
    row = next(line for line in str(open_sum.calibration(mr=0.005)).splitlines() if line.startswith("threshold speed"))
    assert row.endswith("rpm")
    assert abs(float(row.split()[2]) - rpm) < 2


def test_groups_stand_in_the_order_of_their_numbers():
    model = rf.models.OneMode()
    theta = model.vector(TYPICAL["one-mode"])
    w = covering_frequencies(model, theta, SPEEDS["one-mode"], 30)
    speeds = tuple(np.array([1000.0, 500.0, 1500.0]) * np.pi / 30)
    test = circular_test(model, theta, speeds=speeds, frequency=w, noise=0.01)
    fit = rf.fit(model, test, known=known_of("one-mode", TYPICAL["one-mode"]), per={"D": "speed_rpm"})
    names = re.findall(r"^(\S+)", fit.summary(), flags=re.MULTILINE)
    assert [name for name in names if name.startswith("D[")] == [f"D[speed_rpm={n}]" for n in (500, 1000, 1500)]
