"""Alarms of the machines of a store: the rules, their verdicts, and those that were reported already."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from rotorfit.fitting.quantities import THRESHOLD
from rotorfit.models.array_types import Float
from rotorfit.models.digits import significant
from rotorfit.monitoring.alarms import MARGIN, Rule, WatchedValues, watch_rules
from rotorfit.store.records import StoredFit, StoredTest
from rotorfit.store.store import Store, followed
from rotorfit.studies.study import Study
from rotorfit.units import RAD_S_PER_RPM, RPM_PER_RAD_S

History = Sequence[tuple[StoredTest, StoredFit]]


@dataclass(frozen=True, kw_only=True)
class Watching:
    """Quantities that are watched, and the rule of an alarm."""

    # values whose change raises an alarm; by default K0, lam, D and threshold speed, where fits have them
    names: tuple[str, ...] = ()
    false_alarm: float = 0.01  # probability that a machine which does not change ever raises one
    running_speed: float | None = None  # rad/s; with it the threshold speed is watched
    margin: float = 1.0  # factor on the running speed that the threshold speed should exceed
    against: tuple[str, ...] = ()  # conditions that a level may depend on in a straight line: oil temperature, pressure
    since: str = ""  # date, ISO 8601, from which on tests count


@dataclass(frozen=True, kw_only=True, eq=False)
class MachineState:
    """The rules of one machine after its last test."""

    machine: str  # its name
    history: History  # its tests and fits that are followed, in order
    left_out: History  # those that are not: not converged, errors in the data, a condition not known
    rules: tuple[Rule, ...]  # what is asked of them

    @property
    def alarms(self) -> tuple[Rule, ...]:
        """The rules that have raised an alarm."""
        return tuple(rule for rule in self.rules if rule.alarm is not None)

    def fit_of(self, test: int) -> StoredFit:
        """The fit of one of its tests."""
        return next(fit for one, fit in self.history if one.number == test)

    def test(self, number: int) -> StoredTest:
        """One of its tests."""
        return next(one for one, _ in self.history if one.number == number)

    def sentence(self, rule: Rule) -> str:
        """The state of a rule in words."""
        who = f"{self.machine}: " if self.machine else ""
        what = f"a change of {rule.name}"
        if rule.name == MARGIN:
            what = f"threshold speed below {rule.required * RPM_PER_RAD_S:.6g} rpm"
            if len(rule.evidence):
                what += f", held with probability {significant(rule.probability, 2)} by the last test"
        said = (
            f"{significant(rule.evidence[-1], 2)} of {significant(rule.limit, 4)}" if len(rule.evidence) else "no test"
        )
        if rule.alarm is None:
            return f"{who}no alarm, {what}: evidence {said} after {len(rule.evidence)} tests"
        test = self.test(rule.alarm)
        return f"{who}ALARM, {what}: by the test of {test.date} ({Path(test.sources[0]).name}), evidence now {said}"


def machine_states(store: Store, study: Study | Mapping[str, Any] | None, watching: Watching) -> list[MachineState]:
    """The state of every machine of a store."""
    machines: dict[str, list[tuple[StoredTest, StoredFit]]] = {}
    for test, fit in store.history(study=study, since=watching.since):
        machines.setdefault(test.machine, []).append((test, fit))
    return [_state(machine, history, watching) for machine, history in machines.items()]


def _state(machine: str, history: History, watching: Watching) -> MachineState:
    used = [(test, fit) for test, fit in history if fit.good and _conditions(test, watching.against) is not None]
    numbers = {test.number for test, _ in used}
    left_out = tuple((test, fit) for test, fit in history if test.number not in numbers)
    names = followed(watching.names or None, used[0][1]) if used else ()
    values = [_watched(name, used) for name in names]
    conditions: dict[str, Float] | None = None
    if watching.against:
        tests = {test.number: test for test, _ in used}
        conditions = {
            one.name: np.array([_conditions(tests[number], watching.against) for number in one.tests]) for one in values
        }
    margin = None
    if watching.running_speed is not None:
        margin = (_watched(THRESHOLD, used), watching.margin * watching.running_speed)
    rules = watch_rules(values, watching.false_alarm, conditions=conditions, margin=margin)
    return MachineState(machine=machine, history=tuple(used), left_out=left_out, rules=rules)


def _conditions(test: StoredTest, names: Sequence[str]) -> list[float] | None:
    """Conditions of a test, none where one of them is no number."""
    found = [test.conditions.get(name) for name in names]
    numbers = [float(value) for value in found if isinstance(value, int | float)]
    return numbers if len(numbers) == len(names) else None


def _watched(name: str, history: History) -> WatchedValues:
    rows = [
        (test.number, fit.params[name]) for test, fit in history if name in fit.params and fit.params[name].stderr > 0
    ]
    return WatchedValues(
        name=name,
        unit=rows[0][1].unit if rows else "",
        tests=tuple(number for number, _ in rows),
        value=np.array([value.value for _, value in rows]),
        stderr=np.array([value.stderr for _, value in rows]),
        systematic=np.array([value.systematic for _, value in rows]),
    )


def alarm_json(state: MachineState, rule: Rule) -> dict[str, Any]:
    """An alarm as JSON."""
    number = rule.alarm or 0
    place = rule.watched.tests.index(number)
    test = state.test(number)
    found = {
        "event": "alarm",
        "machine": state.machine,
        "rule": rule.name,
        "test": number,
        "date": test.date,
        "source": test.sources[0],
        "value": float(rule.watched.value[place]),
        "stderr": float(rule.watched.stderr[place]),
        "unit": rule.watched.unit,
        "evidence": float(rule.evidence[place]),
        "limit": rule.limit,
        "said": state.sentence(rule),
    }
    if rule.name == MARGIN:
        found |= {"required_rpm": rule.required / RAD_S_PER_RPM, "probability_held": rule.probability}
    return found
