"""Runs of which no process holds all: each part of the data is read where its runs are fitted."""

from __future__ import annotations

import pickle
import warnings
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from pathlib import Path

from rotorfit.base.executors import carry_out
from rotorfit.identify.diagnosis.check import read
from rotorfit.lab.data.findings import DataWarning, level_of_caller
from rotorfit.lab.data.rows import Experiment
from rotorfit.studies.campaigns.runs import Run, distinct, packed, runs_of

Reader = Callable[[], Experiment]
"""Reads a part of the data: ``functools.partial(rf.read, "part-1.nc")``."""


@dataclass(frozen=True, eq=False, slots=True)
class ReadingsOfPart:
    """Readings that are read when they are asked for; a process holds one part of the data at a time."""

    part: bytes = field(repr=False)  # the pickled reader, by which the part in hand is known again
    split: str | None  # attribute that tells the runs apart
    number: int  # of the run in its part
    content: str  # hash of the readings
    spans: Mapping[str, tuple[float, float]]  # least and largest value of numbers that change

    @property
    def experiment(self) -> Experiment:
        """The readings themselves."""
        return _runs_in(self.part, self.split)[self.number].experiment

    def span(self, condition: str) -> tuple[float, float] | None:
        """Least and largest value of a condition that is a number and changes within the run."""
        return self.spans.get(condition)


def is_lazy(item: object) -> bool:
    """True for a path, and for a function that reads."""
    return isinstance(item, str | Path) or callable(item)


def lazy_runs(parts: Sequence[str | Path | Reader], split: str | None, executor: Executor | None) -> tuple[Run, ...]:
    """The runs of all parts, each of which is read once to see what it holds."""
    refusal = (
        "a part of a campaign cannot be read by other processes ({problem}): give its path, "
        "functools.partial(rf.read, path, ...), or a function of a module"
    )
    readers = [packed(partial(read, part) if isinstance(part, str | Path) else part, refusal) for part in parts]
    found = carry_out(partial(_looked_over, split), readers, executor)
    for said in dict.fromkeys(said for _, warned in found for said in warned):
        warnings.warn(said, DataWarning, stacklevel=level_of_caller())
    return tuple(distinct([run for runs, _ in found for run in runs]))


@lru_cache(maxsize=1)
def _runs_in(part: bytes, split: str | None) -> list[Run]:
    """The runs of the part that is in hand."""
    found = pickle.loads(part)()
    if not isinstance(found, Experiment):
        raise TypeError(f"a part of a campaign is a table such as rf.read returns, not {type(found).__name__}")
    return runs_of(found, split)


def _looked_over(split: str | None, part: bytes) -> tuple[list[Run], list[str]]:
    """The runs of a part without their readings, and errors in the data."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        runs = _runs_in(part, split)
    said = [str(one.message) for one in caught if issubclass(one.category, DataWarning)]
    left = []
    for number, run in enumerate(runs):
        spans = {name: span for name in run.attributes if (span := run.readings.span(name)) is not None}
        content = run.readings.content
        readings = ReadingsOfPart(part=part, split=split, number=number, content=content, spans=spans)
        left.append(replace(run, readings=readings))
    return left, said
