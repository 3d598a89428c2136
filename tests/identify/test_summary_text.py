"""Numbers and columns of a printed summary: digits, units, sums of what is known only together, groups in order."""

from __future__ import annotations

import re

import numpy as np
import pytest
from plain import plain_fit, summary_words
from sentences import refuses
from synthetic import SPEEDS, TYPICAL, circular_test, covering_frequencies, known_of

import rotorfit as rf
from rotorfit.base.digits import plus_minus
from rotorfit.identify.fitting.summary import WIDTH
from rotorfit.models import WhirlWhip


@pytest.fixture(scope="module")
def open_sum():
    return plain_fit(rf.models.WhirlWhip(), rf.datasets.rig_open())


def test_what_is_known_only_as_a_sum_gives_the_sum_with_its_error(open_sum):
    """K3 known would leave K0 with the error of the sum: no other parameter knows how the two share it."""
    told = plain_fit(rf.models.WhirlWhip(), rf.datasets.rig_open(), known={"K3": 6000.0})
    expected = plus_minus(6000.0 + told.params["K0"].value, told.params["K0"].stderr)
    assert f"determined: K3 + K0 = {expected} N/m" in summary_words(open_sum)


def test_summary_profile_and_budget_have_one_unit_and_say_what_is_extrapolated(open_sum):
    text = summary_words(open_sum)
    found = re.search(r"threshold speed: ([\d.]+) \+- [\d.]+ rpm.* above the highest tested speed \(2000 rpm\)", text)
    assert found
    assert "extrapolated" in text
    rpm = float(found[1])
    told = plain_fit(rf.models.WhirlWhip(), rf.datasets.rig_open(), known={"K3": 6000.0})
    profile = str(told.profile("threshold_speed"))
    exact = re.match(r"threshold_speed: ([\d.]+), 95 % \[[\d., ]+\] rpm", profile)
    assert exact
    assert abs(float(exact[1]) - rpm) <= 0.5  # the summary rounds by the systematic share, too
    row = next(line for line in str(open_sum.budget()).splitlines() if line.startswith("threshold speed"))
    assert row.endswith("rpm")
    assert float(row.split()[2]) == rpm
    with refuses(KeyError):
        open_sum.budget()["lamda"]


def test_groups_stand_in_the_order_of_their_numbers():
    model = rf.models.OneMode()
    theta = model.vector(TYPICAL["one-mode"])
    w = covering_frequencies(model, theta, SPEEDS["one-mode"], 30)
    speeds = tuple(np.array([1000.0, 500.0, 1500.0]) * np.pi / 30)
    test = circular_test(model, theta, speeds=speeds, frequency=w, noise=0.01)
    fit = plain_fit(model, test, known=known_of("one-mode", TYPICAL["one-mode"]), per={"D": "speed_rpm"})
    text = fit.summary()
    table = text[text.index("\nparameter ") :]
    names = re.findall(r"^(\S+)", table, flags=re.MULTILINE)
    assert [name for name in names if name.startswith("D[")] == [f"D[speed_rpm={n}]" for n in (500, 1000, 1500)]


def test_the_summary_of_a_fit_with_long_names_is_aligned() -> None:
    rig = rf.datasets.rig_open()
    fit = plain_fit(WhirlWhip(), rig, known={"K3": 6000.0}, per={"D": "speed_rpm"})
    text = fit.summary()
    below = text[text.index("\nparameter ") :].split("\n")
    table = [line for line in below if line.startswith(("parameter", "D[", "K0 "))]
    assert len(table) > 2
    assert max(map(len, text.split("\n"))) <= WIDTH
    assert len({line.index("unit") if "unit" in line else line.index("N") for line in table}) == 1
