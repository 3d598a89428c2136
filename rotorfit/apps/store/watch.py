"""Machines watched: files of a folder are added when they no longer change, and alarms are reported once."""

from __future__ import annotations

import json
import os
import shlex
import subprocess
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from rotorfit.apps.store.adding import add_sources, is_known
from rotorfit.apps.store.database import claimed
from rotorfit.apps.store.records import Added, StoredFit, StoredTest
from rotorfit.apps.store.sources import Source
from rotorfit.apps.store.store import Store, followed
from rotorfit.apps.study_files.data_files import StudyProgress, is_named, no_progress
from rotorfit.apps.study_files.study import Study
from rotorfit.base.array_types import Float
from rotorfit.base.digits import significant
from rotorfit.base.units import RAD_S_PER_RPM, RPM_PER_RAD_S
from rotorfit.identify.fitting.quantities import THRESHOLD
from rotorfit.lab.io.files import SUFFIXES
from rotorfit.lab.io.tables.cells import EXCEL
from rotorfit.lab.recordings.formats.files import ALWAYS_RAW, FORMATS
from rotorfit.studies.monitoring.alarms import MARGIN, Rule, WatchedValues, watch_rules

History = Sequence[tuple[StoredTest, StoredFit]]


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
        stderr=np.array([value.scatter for _, value in rows]),
        systematic=np.array([value.systematic for _, value in rows]),
    )


def _alarm_json(state: MachineState, rule: Rule) -> dict[str, Any]:
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
        "stderr": float(np.hypot(rule.watched.stderr[place], rule.watched.systematic[place])),
        "unit": rule.watched.unit,
        "evidence": float(rule.evidence[place]),
        "limit": rule.limit,
        "said": state.sentence(rule),
    }
    if rule.name == MARGIN:
        found |= {"required_rpm": rule.required / RAD_S_PER_RPM, "probability_held": rule.probability}
    return found


# ---- the folder ---------------------------------------------------------------------------------------------------

_OWN = (".rotorfit-", "~$", ".")
"""First characters of names that are no data: drafts, locks of office programs, hidden files."""


@dataclass(kw_only=True)
class FolderWatch:
    """A folder and the store that follows it.

    ``look`` does one round. Files count that no longer change: their sizes and times, by the file server's own word,
    have been the same for ``settle`` seconds. Nothing depends on what a round before has seen: a watch that was killed
    goes on from the store.
    """

    folder: Path
    store: Store
    study: Study
    # values whose change raises an alarm; by default K0, lam, D and threshold speed, where fits have them
    names: tuple[str, ...] = ()
    false_alarm: float = 0.01  # probability that a machine which does not change ever raises one
    running_speed: float | None = None  # rad/s; with it the threshold speed is watched
    margin: float = 1.0  # factor on the running speed that the threshold speed should exceed
    against: tuple[str, ...] = ()  # conditions that a level may depend on in a straight line: oil temperature, pressure
    since: str = ""  # date, ISO 8601, from which on tests count
    setup: Path | None = None  # ``rig.toml``; all files are recordings then
    machine: str = ""  # of tests that do not name theirs
    settle: float = 5.0  # s
    on_alarm: str = ""  # command, run without a shell, that reads the alarm's JSON
    tell: Callable[[dict[str, Any]], None] = print  # called with every event
    progress: StudyProgress = no_progress
    executor: Executor | None = None  # to fit with
    _seen: dict[str, tuple[str, float]] = field(default_factory=dict)  # stamp of a source, and since when
    _earlier: int = 0  # fits of another version of the numbers that were spoken of
    _told: dict[str, str] = field(default_factory=dict)  # what was said of a source that could not be read

    def look(self) -> list[Added]:
        """Add what is ready; returns what became of it."""
        ready = [source for source in self._new() if self._stands_still(source)]
        ready.sort(key=lambda source: (source.date(), source.name))
        added = [*add_sources(self.store, ready, self.machine, self.executor, self.progress)]
        fits = {fit.number: fit for fit in self.store.fits} if added else {}
        for one in added:
            if one.refusal and self._told.get(one.source) != one.refusal:
                self.tell({"event": "refused", "source": one.source, "reason": one.refusal})
                self._told[one.source] = one.refusal
            elif one.fit is not None:
                self.tell({"event": "test", "added": one, "fit": fits[one.fit]})
        return added

    def waiting(self) -> bool:
        """True if something is there that has not been added or refused."""
        return any(True for _ in self._new())

    def states(self) -> list[MachineState]:
        """The state of every machine, after its alarms were reported."""
        machines: dict[str, list[tuple[StoredTest, StoredFit]]] = {}
        for test, fit in self.store.history(study=self.study, since=self.since):
            machines.setdefault(test.machine, []).append((test, fit))
        states = [self._state(machine, history) for machine, history in machines.items()]
        with claimed(self.store.database, "alarms"):
            for state in states:
                for rule in state.alarms:
                    key = (state.fit_of(rule.alarm or 0).number, rule.name)
                    with self.store.database.look() as ask:
                        told = ask("SELECT 1 FROM alarms WHERE fit = ? AND rule = ?", key)
                    if not told and self._tell_alarm(_alarm_json(state, rule)):
                        with self.store.database.change() as connection:
                            connection.execute("INSERT OR IGNORE INTO alarms VALUES (?, ?)", key)
        earlier = sum(fit.outdated for state in states for _, fit in (*state.history, *state.left_out))
        if earlier and earlier != self._earlier:
            said = f"{earlier} fits are of an earlier rotorfit: `rotorfit store refit` makes them anew"
            self.tell({"event": "problem", "said": said})
        self._earlier = earlier
        return states

    def _state(self, machine: str, history: History) -> MachineState:
        used = [(test, fit) for test, fit in history if fit.good and _conditions(test, self.against) is not None]
        tests = {test.number: test for test, _ in used}
        left_out = tuple((test, fit) for test, fit in history if test.number not in tests)
        values = [_watched(name, used) for name in (followed(self.names or None, used[0][1]) if used else ())]
        conditions: dict[str, Float] | None = None
        if self.against:
            rows = {one.name: [_conditions(tests[number], self.against) for number in one.tests] for one in values}
            conditions = {name: np.array(own) for name, own in rows.items()}
        margin = None
        if self.running_speed is not None:
            margin = (_watched(THRESHOLD, used), self.margin * self.running_speed)
        rules = watch_rules(values, self.false_alarm, conditions=conditions, margin=margin)
        return MachineState(machine=machine, history=tuple(used), left_out=left_out, rules=rules)

    def _tell_alarm(self, alarm: dict[str, Any]) -> bool:
        """True if it reached whom it should: a command that fails is run again in the next round."""
        self.tell(alarm)
        if not self.on_alarm:
            return True
        words = shlex.split(self.on_alarm, posix=os.name == "posix")
        try:
            command_limit = 60.0  # seconds that the command of an alarm may take. Chosen
            done = subprocess.run(words, input=json.dumps(alarm) + "\n", text=True, check=False, timeout=command_limit)
        except (OSError, subprocess.TimeoutExpired) as problem:
            self.tell({"event": "problem", "said": f"the command of --on-alarm did not run: {problem}"})
            return False
        if done.returncode:
            said = f"the command of --on-alarm ended with {done.returncode}; it is run again in the next round"
            self.tell({"event": "problem", "said": said})
        return done.returncode == 0

    def _new(self) -> Iterator[Source]:
        for source in sources_in(self.folder, self.study, self.setup):
            try:
                if not is_known(self.store, source):
                    yield source
            except FileNotFoundError:  # taken away while looking
                continue

    def _stands_still(self, source: Source) -> bool:
        try:
            stamp = source.stamp()
        except OSError:
            return False
        before, since = self._seen.get(source.name, ("", 0.0))
        if stamp != before:
            self._seen[source.name] = (stamp, time.monotonic())
            return self.settle == 0
        return time.monotonic() - since >= self.settle


def sources_in(folder: Path, study: Study | None = None, setup: Path | None = None) -> list[Source]:
    """Test files and recordings of a folder, one by one, and in its folders: the recordings of one together."""
    allowed = FORMATS if setup is not None else (*SUFFIXES, *EXCEL, *ALWAYS_RAW)
    patterns = () if study is None else study.files

    def is_data(path: Path) -> bool:
        if path.name.startswith(_OWN) or not path.is_file():  # no pipe, and no link in a circle
            return False
        named = not patterns or any(is_named(path, pattern) for pattern in patterns)
        return named and path.suffix.lower() in allowed and path != setup

    found: list[Source] = []
    for path in sorted(folder.iterdir()):
        if is_data(path):
            found.append(Source(path=path, paths=(path,), setup=setup, study=study))
        elif path.is_dir() and not path.name.startswith(_OWN):
            files = [file for file in sorted(path.iterdir()) if is_data(file)]
            raw = tuple(file for file in files if setup is not None or file.suffix.lower() in ALWAYS_RAW)
            found += [Source(path=path, paths=raw, setup=setup, study=study)] if raw else []
            found += [Source(path=file, paths=(file,), study=study) for file in files if file not in raw]
    return found
