"""Evidence over a history: against integration by trapezia, and by how often it raises an alarm without a reason."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm

from rotorfit.estimators.change import FEWEST_FREEDOM, SHIFTS, change_evidence, low_evidence, without_any
from rotorfit.studies.monitoring.alarms import WatchedValues, watch_rules


def marginal(values: np.ndarray, step: np.ndarray, size: float) -> float:
    """Likelihood integrated over level (flat), scatter (1/sigma) and shift (normal), by trapezia in all three."""
    level = np.linspace(-30, 30, 401)[:, None, None]
    sigma = np.exp(np.linspace(-1.5, 3, 61))[:, None]
    shift = np.linspace(-6, 6, 41) * size if size else np.zeros(1)
    likelihood = 1.0
    for value, stepped in zip(values, step, strict=True):
        likelihood = likelihood * np.exp(-(((value - level) / sigma - shift * stepped) ** 2) / 2) / sigma
    weights = norm.pdf(shift, scale=size) / norm.pdf(shift, scale=size).sum() if size else np.ones(1)
    return float((likelihood * weights).sum())  # flat in the logarithm of sigma is 1/sigma


def test_evidence_is_the_ratio_of_integrated_likelihoods() -> None:
    values = np.array([0.3, -0.9, 0.1, 0.6, 2.4])
    found = change_evidence(values)
    first = 1 + FEWEST_FREEDOM
    assert found[:first].tolist() == [1.0] * first
    step = np.arange(len(values)) >= first
    mean = np.mean([marginal(values, step, size) for size in SHIFTS]) / marginal(values, step, 0.0)
    assert found[-1] == pytest.approx(mean / 2 + 0.5, rel=1e-3)  # the change came with the first possible test, or will


def test_evidence_depends_on_neither_level_nor_unit_nor_condition() -> None:
    random = np.random.default_rng(0)
    values, oil = random.normal(size=20), random.uniform(40, 60, (20, 1))
    values[12:] += 3
    np.testing.assert_allclose(change_evidence(1e6 * values - 5e6), change_evidence(values), rtol=1e-6)
    np.testing.assert_allclose(change_evidence(values - 7 * oil[:, 0], oil), change_evidence(values, oil), rtol=1e-6)
    assert change_evidence(np.full(9, 4.7)).tolist() == [1.0] * 9


@pytest.mark.parametrize("tails", ["normal", "t3", "lognormal"])
def test_an_unchanged_machine_seldom_raises_an_alarm(tails: str) -> None:
    """150 histories of 40 tests at 10 %: more than 25 alarms would come once in 1000 times at that rate."""
    random = np.random.default_rng(1)
    draw = {
        "normal": lambda: random.normal(size=40),
        "t3": lambda: random.standard_t(3, size=40),
        "lognormal": lambda: random.lognormal(0, 0.5, size=40),
    }[tails]
    assert sum(alarm_of(draw(), 0.1) is not None for _ in range(150)) <= 25


def alarm_of(values: np.ndarray, false_alarm: float) -> int | None:
    tests = tuple(range(len(values)))
    errors = np.full(len(values), 0.1)
    watched = WatchedValues(name="D", unit="1", tests=tests, value=values, stderr=errors, systematic=0 * errors)
    return watch_rules([watched], false_alarm)[0].alarm


def test_a_change_raises_it_soon_and_one_odd_test_never() -> None:
    random = np.random.default_rng(2)
    waits = []
    for _ in range(20):
        values = random.normal(size=40)
        values[20:] += 6
        waits.append((alarm_of(values, 0.01) or 99) - 20)
    assert np.median(waits) <= 4
    odd = random.normal(size=40)
    odd[20] += 1000
    assert alarm_of(odd, 0.01) is None
    assert without_any(odd) < 1


def test_a_machine_at_its_limit_seldom_raises_an_alarm() -> None:
    """The same for 400 histories of 50 tests at 5 %: more than 35 come once in 1000 times."""
    random = np.random.default_rng(3)
    assert sum(low_evidence(random.normal(size=50)).max() >= 20 for _ in range(400)) <= 35
    assert np.median([np.argmax(low_evidence(random.normal(1.0, size=50)) >= 20) for _ in range(20)]) < 25


def test_a_margin_is_not_given_up_over_scatter_that_errors_do_not_show() -> None:
    """Histories at the limit that scatter by three of their errors, at 5 %: of 150 more than 17 come once in 1000."""
    random = np.random.default_rng(4)

    def alarm(values: np.ndarray, false_alarm: float = 0.05) -> int | None:
        each = np.ones(len(values))
        tests = tuple(range(1, len(values) + 1))
        watched = WatchedValues(name="onset", unit="1", tests=tests, value=values, stderr=each, systematic=0 * each)
        return watch_rules([], false_alarm, margin=(watched, 0.0))[0].alarm

    assert sum(alarm(3 * random.normal(size=25)) is not None for _ in range(150)) <= 17
    assert alarm(np.array([-20.0]), 0.01) == 1  # one test far below
