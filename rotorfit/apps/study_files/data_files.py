"""Test files and recordings of a study, read and looked over."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from fnmatch import fnmatch
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from rotorfit.base.array_types import Index
from rotorfit.base.executors import carry_out
from rotorfit.lab.data.casing import with_casing
from rotorfit.lab.data.findings import DataWarning, Finding, errors_first
from rotorfit.lab.data.rows import Experiment
from rotorfit.lab.data.selection import Wanted, selected, without
from rotorfit.lab.data.stator import without_stator
from rotorfit.lab.io.files import read

if TYPE_CHECKING:
    from rotorfit.lab.recordings.recording import Recording


class StudyProgress(Protocol):
    """Called when a stage begins, and while it goes on where it can say how far it is."""

    def __call__(self, stage: str, done: float | None = None) -> None:
        """Take notice of a stage in a few words and of the share of it that is done."""
        ...


def no_progress(stage: str, done: float | None = None) -> None:
    """Show nothing."""


@dataclass(frozen=True)
class DataFile:
    """A test file and the options to read it with, see :func:`rotorfit.read`."""

    path: Path  # the file
    options: Mapping[str, Any] = field(default_factory=dict)  # by name, those of :func:`rotorfit.read`

    @property
    def paths(self) -> tuple[Path, ...]:
        """The file, as those of recordings."""
        return (self.path,)

    def read(
        self,
        progress: StudyProgress = no_progress,
        on_lines: Callable[[Index], None] | None = None,
    ) -> Experiment:
        """Read the test."""
        stage = f"reading {self.path.name}"
        progress(stage)
        callbacks = {"on_lines": on_lines, "progress": lambda share: progress(stage, share)}
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DataWarning)  # its findings are told with those of the check
            return read(self.path, **{**callbacks, **self.options})


@dataclass(frozen=True, kw_only=True)
class RecordingFiles:
    """Recordings of one rig, see :func:`rotorfit.read_recording`."""

    paths: tuple[Path, ...]  # the files
    setup: Path | None = None  # ``rig.toml``, where the files do not say everything themselves
    windows: int | None = None  # track by windows of so many whole turns, see ``turns`` of :func:`rotorfit.responses`
    where: Mapping[str, Wanted] = field(default_factory=dict)  # vectors to keep, see :func:`rotorfit.read`
    exclude: Mapping[str, Wanted] = field(default_factory=dict)  # vectors to leave out
    casing: Mapping[str, str] = field(default_factory=dict)  # see :func:`rotorfit.read`
    stator: Mapping[str, float] = field(default_factory=dict)  # see :func:`rotorfit.read`
    operating: bool = False  # reduce them to spectra of a machine in operation
    lines: bool = False  # reduce them to the combination lines of a shaft that is not round
    runout_um: float | None = None  # see :func:`rotorfit.shaft_lines`
    skip: tuple[int, ...] = ()  # numbers of vectors to leave out, counted from 1 through all tests that come of them

    @property
    def path(self) -> Path:
        """The first file."""
        return self.paths[0]

    def open(self, progress: Callable[[str], None]) -> list[Recording]:
        """The recordings, of which nothing but headings is read yet."""
        from rotorfit.lab.recordings.recording import named_apart, read_recording
        from rotorfit.lab.recordings.rig.rig_toml import read_setup

        setup = None if self.setup is None else read_setup(self.setup)
        records = []
        for path in self.paths:
            progress(f"opening {path.name}")
            records.append(read_recording(path, setup))
        return named_apart(records)

    def read(self, progress: Callable[[str], None], executor: Executor | None = None) -> tuple[Experiment, ...]:
        """Read the recordings and reduce them, each kind of test to an experiment."""
        from rotorfit.lab.recordings.reduction.responses import recorded_tests
        from rotorfit.lab.recordings.reduction.shaft_lines import shaft_lines

        records = self.open(progress)
        if self.operating:
            from rotorfit.lab.recordings.reduction.operating_spectra import operating_spectra

            progress("spectra of operation")
            return self._chosen((operating_spectra(records, executor=executor),))
        if not self.lines:
            return self._chosen(recorded_tests(records, turns=self.windows, executor=executor, progress=progress))
        progress("finding combination lines")
        return self._chosen((shaft_lines(records, runout_um=self.runout_um),))

    def _chosen(self, tests: tuple[Experiment, ...]) -> tuple[Experiment, ...]:
        """The vectors that are wanted."""
        chosen = (selected(test, where=self.where, exclude=self.exclude) for test in tests)
        kept = (with_casing(test, self.casing) for test in chosen)
        return _without(tuple(without_stator(test, self.stator) for test in kept), self.skip)


def is_named(path: Path, file: DataFile | RecordingFiles) -> bool:
    """True if the pattern that a study gives fits the name of a file."""
    return fnmatch(path.name, file.path.name)


def read_as(path: Path, patterns: Iterable[DataFile | RecordingFiles]) -> DataFile:
    """A file, read as the first pattern says that fits its name."""
    named = (file for file in patterns if isinstance(file, DataFile) and is_named(path, file))
    return DataFile(path, next((file.options for file in named), {}))


def _without(tests: tuple[Experiment, ...], numbers: Sequence[int]) -> tuple[Experiment, ...]:
    """Tests without some vectors, by number from 1 through all of them."""
    count = sum(len(test) for test in tests)
    if wrong := [number for number in numbers if number > count]:
        raise ValueError(f"skip: there is no vector {wrong[0]} in the recordings, of {count} vectors")
    kept, before = [], 0
    for test in tests:
        own = [number - before for number in numbers if before < number <= before + len(test)]
        before += len(test)
        kept.append(without(test, own))
    return tuple(kept)


def read_files(
    files: Sequence[DataFile | RecordingFiles], progress: StudyProgress, executor: Executor | None = None
) -> tuple[tuple[Experiment, ...], tuple[tuple[Finding, ...], ...]]:
    """The tests, and what was found odd in each, errors first."""
    from rotorfit.identify.diagnosis.readings import copied_runs

    experiments: list[Experiment] = []
    findings: list[tuple[Finding, ...]] = []
    for file in files:
        tests, own = _read_file(file, progress, executor)
        experiments += tests
        findings += own
    if len(experiments) > 1:
        copies = copied_runs(experiments)
        findings = [tuple(errors_first((*more, *own))) for own, more in zip(findings, copies, strict=True)]
    return tuple(experiments), tuple(findings)


def _read_file(
    file: DataFile | RecordingFiles, progress: StudyProgress, executor: Executor | None = None
) -> tuple[tuple[Experiment, ...], list[tuple[Finding, ...]]]:
    """The tests of a file, and what was found odd in each."""
    from rotorfit.identify.diagnosis.check import check

    lines: list[Index] = []
    tests = file.read(progress, executor) if isinstance(file, RecordingFiles) else (file.read(progress, lines.append),)
    findings = []
    for test in tests:
        progress(f"checking {test.source}")
        found = check(test)
        if lines and lines[0].size == len(test):  # no runs were differenced, no rows chosen: each is a line of a table
            found = [replace(f, lines=tuple(lines[0][list(f.rows)].tolist())) for f in found]
        findings.append(tuple(found))
    return tests, findings


def look_over(files: Sequence[DataFile], executor: Executor | None) -> tuple[tuple[Finding, ...], ...]:
    """Findings of each file, errors first; no process holds more than one of them."""
    from rotorfit.identify.diagnosis.readings import copies_among, copies_finding

    looked = carry_out(_looked_at, files, executor)
    copies = copies_among([digests for _, digests in looked], [file.path.name for file in files])
    more = [[copies_finding(own)] if own else [] for own in copies]
    return tuple(tuple(errors_first((*own, *found))) for own, (found, _) in zip(more, looked, strict=True))


def _looked_at(file: DataFile) -> tuple[tuple[Finding, ...], dict[str, bytes]]:
    from rotorfit.identify.diagnosis.readings import run_digests

    (test,), (findings,) = _read_file(file, no_progress)
    return tuple(one for one in findings if one.code != "duplicate"), run_digests(test)


def checked_again(
    before: Sequence[Experiment], after: Sequence[Experiment], findings: Sequence[Sequence[Finding]]
) -> tuple[tuple[Finding, ...], ...]:
    """Findings of data that were changed: those of reading stay, the check is made anew."""
    from rotorfit.identify.diagnosis.check import check

    found = []
    for old, new, own in zip(before, after, findings, strict=True):
        of_check = {(finding.code, finding.message) for finding in check(old)}
        stay = [finding for finding in own if (finding.code, finding.message) not in of_check]
        found.append(tuple(errors_first((*stay, *check(new)))))
    return tuple(found)
