"""Refusals and warnings: a test names their type, and ``data/sentences.json`` holds what they say.

    with refuses(ValueError):
        rf.fit(...)

Who improves a sentence writes the file anew, ``pytest --write-sentences``, and reads there what changed. Folders are
left out of paths, because every run has its own.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TypeVar

import pytest

from rotorfit.base.faults import of_program
from rotorfit.base.version import VERSIONS

FILE = Path(__file__).parents[1] / "data" / "sentences.json"
FOLDERS = re.compile(r"(?<![\w./)])/(?:[^\s/'\":]+/)+")

writing = False
"""Whether the file is written anew, ``--write-sentences``."""
heard: dict[str, list[str]] = {}
"""Sentences of the tests of this process, in their order."""

Raised = TypeVar("Raised", bound=BaseException)


@contextmanager
def refuses(kind: type[Raised] | tuple[type[Raised], ...]) -> Iterator[pytest.ExceptionInfo[Raised]]:
    """The block raises an exception of a type, with the sentence of the file; not one that a program's error has."""
    with pytest.raises(kind) as caught:
        yield caught
    assert not of_program(caught.value)
    hear(str(caught.value))


@contextmanager
def warns(kind: type[Warning]) -> Iterator[pytest.WarningsRecorder]:
    """The block warns, with the sentences of the file and no other of the type."""
    with pytest.warns(kind) as caught:
        yield caught
    for warning in caught:
        if isinstance(warning.message, kind):
            hear(str(warning.message))


def hear(sentence: str) -> None:
    """Compare the next sentence of the test that runs."""
    path, _, name = os.environ["PYTEST_CURRENT_TEST"].rpartition(" ")[0].partition("::")
    test = f"{Path(path).name}::{name}"
    said = heard.setdefault(test, [])
    said.append(FOLDERS.sub("", sentence).replace(VERSIONS, "VERSIONS"))  # which change with the numbers
    if not writing:
        expected = written().get(test, [])
        assert said == expected[: len(said)], f"{test} in {FILE.name}"


def written() -> dict[str, list[str]]:
    """Sentences by test, as the file has them."""
    found: dict[str, list[str]] = json.loads(FILE.read_text(encoding="utf-8"))
    return found


def write() -> None:
    """Put the sentences of this process into the file, and take out those of tests that are gone."""
    import fcntl  # which Windows lacks, where tests read the file only

    with FILE.open("r+", encoding="utf-8") as file:
        fcntl.flock(file, fcntl.LOCK_EX)  # every process of a parallel run writes its own
        kept = {test: said for test, said in json.load(file).items() if _stands(test)} | heard
        file.seek(0)
        file.truncate()
        json.dump(dict(sorted(kept.items())), file, indent=1, ensure_ascii=False)
        file.write("\n")


def _stands(test: str) -> bool:
    """Whether its file has a test of this name."""
    file, _, name = test.partition("::")
    defined = f"def {name.partition('[')[0].rpartition('::')[2]}("
    return any(defined in path.read_text(encoding="utf-8") for path in FILE.parents[1].glob(f"*/{file}"))
