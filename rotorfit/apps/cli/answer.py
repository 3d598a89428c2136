"""Progress of a command, its answer and its end: a folder, JSON or text; what is wrong as one sentence; exit codes."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from enum import IntEnum
from functools import partial
from pathlib import Path
from time import monotonic
from typing import Any, TypeVar

from rotorfit.apps.study_files.folder import complete_folder
from rotorfit.apps.study_files.wording import json_text, sentence
from rotorfit.base.atomic_file import joined
from rotorfit.base.file_reading import shown
from rotorfit.lab.data.findings import Finding, attributed, errors_in, warnings_in
from rotorfit.lab.io.tables.result_tables import frame_csv


class ExitCode(IntEnum):
    """Exit codes of the commands."""

    DONE = 0
    NOT_CONVERGED = 1
    BAD_INPUT = 2
    ALARM = 3
    ERROR_OF_THE_PROGRAM = 4
    INTERRUPTED = 130


T = TypeVar("T")


class BadInputError(Exception):
    """Something in the user's hands is wrong; the message says what, where and what to do."""


def checked(work: Callable[[], T], of: Path | None = None) -> T:
    """Do work that depends on the user's files and settings; what they get wrong becomes a :class:`BadInputError`, with
    the file that the settings are of."""
    try:
        return work()
    except BrokenPipeError:  # of the output, whose reader has seen enough
        raise
    except (ValueError, KeyError, OSError) as problem:
        words = sentence(problem)
        raise BadInputError(words if of is None or str(of) in words else f"{of}: {words}") from problem


Files = Mapping[str, str | bytes | Callable[[Path], Any]]
"""Content of files by name, or what writes one to a path."""


@dataclass(frozen=True, kw_only=True)
class Answer:
    """What a command found."""

    text: str  # for the terminal
    plain: Callable[[], Any] = dict  # for --json
    files: Callable[[], Files] | None = None  # for the folder --out
    warned: Iterable[str] = ()  # warnings that the text holds; --quiet does not silence them
    said: Iterable[str] = ()  # sentences beside the answer: what is wrong, and what was left out
    good: bool = True  # the data have no error, and everything converged
    refused: bool = False  # some of the input


def answered(work: Callable[[argparse.Namespace], Answer]) -> Callable[[argparse.Namespace], ExitCode]:
    """The command that finds an answer, fills the folder, and prints what the options ask for."""
    return lambda options: give(checked(lambda: work(options)), options)


def give(answer: Answer, options: argparse.Namespace) -> ExitCode:
    """Fill the folder and print, as the options ask."""
    out, quiet = getattr(options, "out", None), getattr(options, "quiet", False)
    if out is not None and answer.files is not None:
        try:
            with complete_folder(out) as folder:
                for name, content in answer.files().items():
                    path = checked(partial(joined, folder, name, limit=folder))
                    if callable(content):
                        content(path)
                    else:
                        path.write_bytes(content.encode("utf-8") if isinstance(content, str) else content)
        except OSError as problem:
            raise BadInputError(sentence(problem)) from problem
    if getattr(options, "json", False):
        print(json_text(answer.plain()))
    elif not quiet:
        print(answer.text + (f"\n\nwritten to {out}" if out else ""))
    for words in (*(answer.warned if quiet else ()), *answer.said):
        say(words)
    if answer.refused:
        return ExitCode.BAD_INPUT
    return ExitCode.DONE if answer.good else ExitCode.NOT_CONVERGED


def result_files(found: Any, text: str, options: argparse.Namespace, table: str, figure: str) -> dict[str, Any]:
    """Table, summary and figure of a result."""
    from rotorfit.show.plots.style import picture_of

    kind = options.figure_format
    rows, drawn = frame_csv(found.to_dataframe()), picture_of(found.plot(), kind)
    return {f"{table}.csv": rows, "summary.txt": f"{text}\n", f"{figure}.{kind}": drawn}


def say(problem: str) -> None:
    """One sentence on what is wrong, beside the answer."""
    print(f"rotorfit: {shown(problem)}", file=sys.stderr)


def sentences(findings: Sequence[Iterable[Finding]], sources: Sequence[str]) -> tuple[str, ...]:
    """Errors and warnings about data, for commands whose answer is not printed."""
    found = attributed(findings, sources)
    return (*errors_in(found), *warnings_in(found))


# ---- progress ----------------------------------------------------------------------------------------------------


class ProgressLine:
    """One line on stderr: seconds since the start, stage at work, and a bar and the time left where these are known."""

    def __init__(self, *, enabled: bool) -> None:
        self._begin, self._enabled = monotonic(), enabled
        self._since, self._share = self._begin, 0.0  # when the stage with a bar began, and how far it was last

    def __call__(self, stage: str, done: float | None = None) -> None:
        """Show a stage."""
        if self._enabled:
            seconds = monotonic() - self._begin
            bar = "" if done is None else f"[{'#' * round(24 * done):<24}] {100 * done:3.0f} %  "
            left = "" if done is None else self._left(done)
            print(f"\r\033[K{seconds:5.1f} s  {bar}{shown(stage)} ...{left}", end="", file=sys.stderr, flush=True)

    def _left(self, done: float) -> str:
        """Time left, once it can be estimated from the work done."""
        if done < self._share or done == 0:  # another stage has begun
            self._since = monotonic()
        self._share = done
        spent = monotonic() - self._since
        if spent < 2.0 or not 0 < done < 1:  # in the first two seconds no estimate of the time left is worth much
            return ""
        seconds = spent * (1 - done) / done
        return f" about {seconds:.0f} s left" if seconds < 99 else f" about {seconds / 60:.0f} min left"

    def close(self) -> None:
        """Clear the line."""
        if self._enabled:
            print("\r\033[K", end="", file=sys.stderr, flush=True)


@contextmanager
def progress_line(options: argparse.Namespace) -> Iterator[ProgressLine]:
    """The line of a command, which ends with the block; --quiet leaves it out."""
    line = ProgressLine(enabled=not getattr(options, "quiet", False) and sys.stderr.isatty())
    try:
        yield line
    finally:
        line.close()
