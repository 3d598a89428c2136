"""A folder watched by polling: files are added when they no longer change, and alarms are reported once."""

from __future__ import annotations

import json
import os
import shlex
import subprocess
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Executor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rotorfit.io.files import SUFFIXES
from rotorfit.io.tables.cells import EXCEL
from rotorfit.recordings.formats.files import ALWAYS_RAW, FORMATS
from rotorfit.store.alarms import MachineState, Watching, alarm_json, machine_states
from rotorfit.store.database import claimed
from rotorfit.store.records import Added
from rotorfit.store.sources import Source, is_named
from rotorfit.store.store import Store
from rotorfit.studies.data_files import StudyProgress, no_progress
from rotorfit.studies.study import Study

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
    watching: Watching = field(default_factory=Watching)
    setup: Path | None = None  # ``rig.toml``; all files are recordings then
    machine: str = ""  # of tests that do not name theirs
    settle: float = 5.0  # s
    on_alarm: str = ""  # command, run without a shell, that reads the alarm's JSON
    tell: Callable[[dict[str, Any]], None] = print  # called with every event
    progress: StudyProgress = no_progress
    executor: Executor | None = None  # to fit with
    _seen: dict[str, tuple[str, float]] = field(default_factory=dict)  # stamp of a source, and since when
    _told: dict[str, str] = field(default_factory=dict)  # what was said of a source that could not be read

    def look(self) -> list[Added]:
        """Add what is ready; returns what became of it."""
        ready = [source for source in self._new() if self._stands_still(source)]
        ready.sort(key=lambda source: (source.date(), source.name))
        added = list(
            self.store.add_sources(ready, machine=self.machine, executor=self.executor, progress=self.progress)
        )
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
        states = machine_states(self.store, self.study, self.watching)
        with claimed(self.store.database, "alarms"):
            for state in states:
                for rule in state.alarms:
                    fit = state.fit_of(rule.alarm or 0).number
                    if not self.store.is_told(fit, rule.name) and self._tell_alarm(alarm_json(state, rule)):
                        self.store.note_told(fit, rule.name)
        return states

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
                if not self.store.is_known(source):
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
    found: list[Source] = []
    for path in sorted(folder.iterdir()):
        if path.name.startswith(_OWN):
            continue
        if path.is_dir():
            found += _sources_of_folder(path, study, setup)
        elif path.is_file() and _is_data(path, study, setup):  # no pipe, and no link in a circle
            found.append(Source(path=path, paths=(path,), setup=setup, study=study))
    return found


def _sources_of_folder(folder: Path, study: Study | None, setup: Path | None) -> list[Source]:
    inside = [path for path in sorted(folder.iterdir()) if path.is_file() and not path.name.startswith(_OWN)]
    files = [path for path in inside if _is_data(path, study, setup)]
    raw = tuple(path for path in files if setup is not None or path.suffix.lower() in ALWAYS_RAW)
    tests = [Source(path=path, paths=(path,), study=study) for path in files if path not in raw]
    return [*([Source(path=folder, paths=raw, setup=setup, study=study)] if raw else []), *tests]


def _is_data(path: Path, study: Study | None, setup: Path | None) -> bool:
    allowed = FORMATS if setup is not None else (*SUFFIXES, *EXCEL, *ALWAYS_RAW)
    if path.suffix.lower() not in allowed or path == setup:
        return False
    patterns = () if study is None else study.files
    return not patterns or any(is_named(path, pattern) for pattern in patterns)
