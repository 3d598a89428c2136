"""Alarms of a machine that is tested again and again: values that changed, a margin that is not held.

The false-alarm rate that is asked for is the probability that a machine which does not change, or just holds its
margin, ever raises one, however often it is tested: see :mod:`rotorfit.estimators.change`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np

from rotorfit.base.array_types import Bool, Float
from rotorfit.estimators.change import change_evidence, low_evidence, without_any

MARGIN = "margin"
"""Name of the rule about the threshold speed."""


@dataclass(frozen=True, kw_only=True, eq=False)
class WatchedValues:
    """One value of a machine, test after test in order of arrival."""

    name: str  # of the value
    unit: str  # its unit
    tests: tuple[int, ...]  # numbers of the tests, shape ``(N,)`` like all that follow
    value: Float  # estimates
    stderr: Float  # their standard errors, without what all tests have in common
    systematic: Float  # standard uncertainties by that


@dataclass(frozen=True, kw_only=True, eq=False)
class Rule:
    """One question asked after every test."""

    name: str  # the value whose level may change, or ``margin``
    watched: WatchedValues  # what it looks at
    # after each test, 1 where nothing is known, shape ``(N,)``; where a change raises the alarm, that of the tests but
    # one, whichever is left out
    evidence: Float
    limit: float  # evidence at which the alarm is raised: the number of rules over the false-alarm rate
    required: float = float("nan")  # what the value has to exceed, its unit; NaN where its change is looked for

    @property
    def crossings(self) -> Bool:
        """Tests by which the evidence passes the limit for the first time, shape ``(N,)``."""
        above = self.evidence >= self.limit
        return np.asarray(above & (np.cumsum(above) == 1))

    @property
    def alarm(self) -> int | None:
        """Number of the test that raised the alarm, none without one."""
        found = np.flatnonzero(self.crossings)
        return self.watched.tests[int(found[0])] if found.size else None

    @property
    def probability(self) -> float:
        """Probability by the last test that the margin is held, NaN for a change."""
        if not len(self.watched.value) or not np.isfinite(self.required):
            return float("nan")
        last = self.watched
        error = float(np.hypot(last.stderr[-1], last.systematic[-1]))
        return NormalDist().cdf(float(last.value[-1] - self.required) / error)


def margin_rule(watched: WatchedValues, required: float, false_alarm: float) -> Rule:
    """Is the threshold speed below what is required?

    The systematic share is common to all tests and does not average out: half of the false-alarm rate is spent on it,
    as a shift that it exceeds so seldom, the other half on the scatter, for which the larger of a test's own error and
    of the scatter from test to test stands. Of the latter the first test shows nothing and the second little, so that
    the mean of squares begins with a scatter of three errors: one test raises the alarm where it is far below.
    """
    shift = NormalDist().inv_cdf(1 - false_alarm / 2) * watched.systematic
    steps = np.diff(watched.value) ** 2 / 2  # of successive tests: a slow fall of the level is no scatter
    # Scatter from test to test, in errors of the first, before tests show it. Chosen by the rows of the benchmark
    scatter_at_first = 3.0
    squares = np.concatenate([(scatter_at_first * watched.stderr[:1]) ** 2, steps])
    scatter = np.sqrt(np.cumsum(squares) / np.arange(1, len(squares) + 1))
    error = np.maximum(watched.stderr, scatter)
    scores = (required - watched.value - shift) / error
    return Rule(name=MARGIN, watched=watched, evidence=low_evidence(scores), limit=2 / false_alarm, required=required)


def watch_rules(
    watched: Sequence[WatchedValues],
    false_alarm: float,
    *,
    conditions: Mapping[str, Float] | None = None,
    margin: tuple[WatchedValues, float] | None = None,
) -> tuple[Rule, ...]:
    """The rules of one machine, which share its false-alarm rate evenly: the probability that a machine which does not
    change ever raises an alarm. Levels may depend in a straight line on ``conditions``, regressors by name of a value,
    shape ``(N, C)``; the margin is the threshold speed and what is required of it, rad/s."""
    if not 0 < false_alarm < 1:
        raise ValueError(f"false_alarm is a probability, between 0 and 1, got {false_alarm:g}")
    share = false_alarm / max(len(watched) + (margin is not None), 1)
    regressors = conditions or {}
    rules, limit = [], 1 / share
    for one in watched:
        given = regressors.get(one.name)
        evidence = change_evidence(one.value, given)
        for last in np.flatnonzero(evidence >= limit).tolist():  # no single test raises the alarm
            until = slice(0, last + 1)
            evidence[last] = without_any(one.value[until], None if given is None else given[until])
            if evidence[last] >= limit:
                break
        rules.append(Rule(name=one.name, watched=one, evidence=evidence, limit=limit))
    return (*rules, *([] if margin is None else [margin_rule(*margin, share)]))
