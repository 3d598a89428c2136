"""Observed stiffness and its changes over dated tests: right numbers, few false alarms, causes named, refusals."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from scipy import stats
from sentences import refuses
from trend_detection import CHANGE, history, judged

import rotorfit as rf
from rotorfit.estimators.change import find_change

SPEED = np.linspace(30.0, 80.0, 12)


def jeffcott(K: float, M: float, D: float, *, seed: int, noise: float = 0.0, **options) -> rf.PerturbationTest:
    """A trial weight on one mass: the motion it adds is the force over ``K + j D Om - M Om^2``."""
    random = np.random.default_rng(seed)
    force = 1e-4 * SPEED**2 * np.exp(0.4j)
    motion = force / (K + 1j * D * SPEED - M * SPEED**2)
    motion = motion + noise * np.abs(motion).max() * (random.normal(size=12) + 1j * random.normal(size=12))
    return rf.perturbation_test(
        run="w", speed=SPEED, frequency=SPEED, force_plane="disk", force=force, plane="disk", direction="z",
        response=motion, sigma=np.abs(motion).max() * max(noise, 1e-6), **options,
    )  # fmt: skip


def test_observed_stiffness_of_one_mode_is_its_stiffness_mass_and_damping() -> None:
    (seen,) = rf.observed_stiffness(jeffcott(4e5, 12.0, 300.0, seed=1))
    for name, truth in (("K", 4e5), ("M", 12.0), ("D", 300.0)):
        assert seen.observed[name][0] == pytest.approx(truth, rel=1e-9)
    np.testing.assert_allclose(seen.stiffness, 4e5 + 300j * SPEED - 12 * SPEED**2, rtol=1e-12)


def test_errors_of_the_lines_are_those_of_many_tests() -> None:
    found = [rf.observed_stiffness(jeffcott(4e5, 12.0, 300.0, seed=i, noise=0.01))[0].observed for i in range(200)]
    for name, truth in (("K", 4e5), ("M", 12.0), ("D", 300.0)):
        pulls = np.array([(one[name][0] - truth) / one[name][1] for one in found])
        # The standard deviation of 200 pulls is known to 5 % of itself: four of those, and room for the widening
        # by sqrt(redchi), which makes the errors larger on average and never smaller.
        assert 0.75 < pulls.std() < 1.2


def test_x_and_y_probes_are_read_as_forward_motion() -> None:
    z = jeffcott(4e5, 12.0, 300.0, seed=1)
    both = [
        rf.perturbation_test(
            run="w", speed=SPEED, frequency=SPEED, force_plane="disk", force=z.force, plane="disk", direction=axis,
            response=z.response * factor, sigma=1e-9,
        )
        for axis, factor in (("x", 1.0), ("y", -1j))
    ]  # fmt: skip
    from rotorfit.lab.data.synchronous import join

    (seen,) = rf.observed_stiffness(join(both))
    assert seen.observed["K"][0] == pytest.approx(4e5, rel=1e-9)


def test_one_speed_gives_stiffness_but_no_mass() -> None:
    test = jeffcott(4e5, 12.0, 300.0, seed=1)
    (seen,) = rf.observed_stiffness(test.select([0]))
    assert seen.observed == {}
    assert seen.stiffness[0] == pytest.approx(4e5 + 300j * 30 - 12 * 900)


def test_a_change_without_cause_is_as_rare_as_promised() -> None:
    """Level and alternative of the permutation test on Student's t with three degrees of freedom, correlated values."""
    random = np.random.default_rng(5)
    mix = random.normal(size=(3, 3))
    p = np.array([find_change(random.standard_t(3, size=(20, 3)) @ mix, orders=199).p_value for _ in range(300)])
    # p-values of an exact test are uniform: the count below 5 % is binomial.
    low, high = stats.binom.interval(0.9999, 300, 0.05)
    assert low <= np.sum(p <= 0.05) <= high
    assert stats.kstest(p, "uniform").pvalue > 1e-4


def test_thousands_of_dates_take_no_room_for_every_order() -> None:
    """The orders of 4,000 dates, all at once, would be 64 MB of indices alone."""
    values = np.random.default_rng(7).normal(size=(4000, 4))
    tracemalloc.start()
    found = find_change(values)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 2e7
    assert found.p_value > 0.01


def test_a_support_that_loosens_is_found_dated_and_named() -> None:
    found = judged(25, loss=0.05, seed=2, false_alarm=0.01)
    assert found["found"] == 1.0
    assert found["placed"] >= 0.8
    assert found["named"] >= 0.8


def test_the_words_say_when_how_much_and_what() -> None:
    tests, _ = history(np.random.default_rng(3), loss=0.05)
    found = rf.trend([s for test in tests for s in rf.observed_stiffness(test)])
    (place,) = found.places
    assert place.change is not None
    assert abs(place.change.index - CHANGE) <= 3  # as close as a shift of 1.7 scatters can be placed
    said = str(found)
    assert f"a change between {place.dates[place.change.index - 1]} and {place.dates[place.change.index]}" in said
    assert "K alone (-" in said
    assert "softer" in said


@pytest.mark.parametrize(("cause", "factors"), [("M", (1.0, 1.05, 1.0)), ("D", (1.0, 1.0, 1.5))])
def test_a_change_of_mass_or_damping_is_named(cause: str, factors: tuple[float, float, float]) -> None:
    values = np.array([4e5, 12.0, 300.0])
    tests = [
        jeffcott(*(values * np.where(i >= 12, factors, 1.0)), seed=i, noise=0.002, source=f"test {i}")
        for i in range(20)
    ]
    (place,) = rf.trend([s for test in tests for s in rf.observed_stiffness(test)]).places
    assert place.found
    assert place.causes[0].name == cause


def test_another_weight_is_not_taken_for_another_rotor() -> None:
    tests = [
        jeffcott(*(np.array([4e5, 12.0, 300.0]) * (1.03 if i >= 12 else 1.0)), seed=i, noise=0.002) for i in range(20)
    ]
    (place,) = rf.trend([s for test in tests for s in rf.observed_stiffness(test)]).places
    assert place.causes[0].name == "all in proportion"
    assert "rather than the rotor" in str(place)


def test_dates_put_tests_in_order() -> None:
    entries = [
        rf.DatedValues(
            date=f"2026-{month:02d}-01", values={"K": (1e6 + 2e5 * (month > 6) + month, 1e3)}, units={"K": "N/m"}
        )
        for month in (12, 3, 7, 1, 10, 5, 8, 2, 11, 6, 9, 4)
    ]
    (place,) = rf.trend(entries).places
    assert place.dates == tuple(sorted(place.dates))
    assert place.change is not None
    assert place.dates[place.change.index] == "2026-07-01"


@pytest.mark.parametrize(
    "entries",
    [
        [],
        [("2026-01-01", {"K": (1.0, 0.1)}), ("", {"K": (1.0, 0.1)})],
        [("01/02/26", {"K": (1.0, 0.1)})] * 8,
        [("", {"K": (1.0, 0.1)}), ("", {"M": (1.0, 0.1)})],
        [("", {"K": (float("nan"), 0.1)})] * 8,
        [("", {"K": (1.0, 0.1)})] * 8,
    ],
)
def test_what_cannot_be_followed_is_refused(entries) -> None:
    tests = [rf.DatedValues(date=date, values=values, units=dict.fromkeys(values, "N/m")) for date, values in entries]
    with refuses(ValueError):
        rf.trend(tests)


def test_few_tests_say_that_they_are_few() -> None:
    tests = [rf.DatedValues(date="", values={"K": (1.0 + i, 0.1)}, units={"K": "N/m"}) for i in range(3)]
    assert "3 tests: at least 6 are needed" in str(rf.trend(tests))


# ---- the command line --------------------------------------------------------------------------
