"""Files of raw signals as the data of a study: those of one kind of test together are one experiment."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from rotorfit.data.experiments import Experiment
from rotorfit.data.findings import Finding
from rotorfit.data.selection import without

if TYPE_CHECKING:
    from rotorfit.recordings.recording import Recording


@dataclass(frozen=True, kw_only=True)
class RecordingFiles:
    """Recordings of one rig, see :func:`rotorfit.read_recording`."""

    paths: tuple[Path, ...]  # the files
    setup: Path | None = None  # ``rig.toml``, where the files do not say everything themselves
    windows: int | None = None  # track by windows of so many whole turns, see ``turns`` of :func:`rotorfit.responses`
    lines: bool = False  # reduce them to the combination lines of a shaft that is not round
    runout_um: float | None = None  # see :func:`rotorfit.shaft_lines`
    skip: tuple[int, ...] = ()  # numbers of vectors to leave out, counted from 1 through all tests that come of them

    @property
    def path(self) -> Path:
        """The first file."""
        return self.paths[0]

    def open(self, progress: Callable[[str], None]) -> list[Recording]:
        """The recordings, of which nothing but headings is read yet."""
        from rotorfit.recordings.recording import named_apart, read_recording
        from rotorfit.recordings.rig.rig_toml import read_setup

        setup = None if self.setup is None else read_setup(self.setup)
        records = []
        for path in self.paths:
            progress(f"opening {path.name}")
            records.append(read_recording(path, setup))
        return named_apart(records)

    def read(
        self, on_finding: Callable[[Finding], None], progress: Callable[[str], None], executor: Executor | None = None
    ) -> tuple[Experiment, ...]:
        """Read the recordings and reduce them, each kind of test to an experiment."""
        from rotorfit.recordings.reduction.responses import recorded_tests
        from rotorfit.recordings.reduction.shaft_lines import shaft_lines

        records = self.open(progress)
        if not self.lines:
            tests = recorded_tests(
                records, turns=self.windows, executor=executor, on_finding=on_finding, progress=progress
            )
            return _without(tests, self.skip)
        progress("finding combination lines")
        test = shaft_lines(records, runout_um=self.runout_um)
        for record in records:
            for finding in record.findings:
                on_finding(finding)
        return _without((test,), self.skip)


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
