"""How a command answers and ends: a folder, JSON or text; what the user got wrong as one sentence; exit codes."""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path
from typing import Any, TypeVar

from rotorfit.data.findings import Finding, attributed, errors_in, warnings_in
from rotorfit.estimators.file_reading import shown
from rotorfit.studies.wording import json_text, sentence


class ExitCode(IntEnum):
    """Exit codes of the commands."""

    DONE = 0
    NOT_CONVERGED = 1
    BAD_INPUT = 2
    ALARM = 3
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


@dataclass(frozen=True, kw_only=True)
class Answer:
    """What a command found."""

    text: str  # for the terminal
    plain: Callable[[], Any] = dict  # for --json
    write: Callable[[Path], None] | None = None  # fills the folder --out
    warned: Iterable[str] = ()  # warnings that the text holds; --quiet does not silence them
    said: Iterable[str] = ()  # sentences beside the answer: what is wrong, and what was left out
    good: bool = True  # the data have no error, and everything converged
    refused: bool = False  # some of the input


def answered(work: Callable[[argparse.Namespace], Answer]) -> Callable[[argparse.Namespace], ExitCode]:
    """The command that finds an answer, fills the folder, and prints what the options ask for."""

    def command(options: argparse.Namespace) -> ExitCode:
        return give(checked(lambda: work(options)), options)

    return command


def give(answer: Answer, options: argparse.Namespace) -> ExitCode:
    """Fill the folder and print, as the options ask."""
    from rotorfit.studies.folder import complete_folder

    out, quiet = getattr(options, "out", None), getattr(options, "quiet", False)
    if out is not None and answer.write is not None:
        try:
            with complete_folder(out) as folder:
                answer.write(folder)
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


def write_results(found: Any, text: str, options: argparse.Namespace, table: str, figure: str, folder: Path) -> None:
    """Table, summary and figure of a result in a folder."""
    from rotorfit.io.tables.result_tables import frame_csv
    from rotorfit.plots.style import picture_of

    (folder / f"{table}.csv").write_text(frame_csv(found.to_dataframe()), encoding="utf-8")
    (folder / "summary.txt").write_text(f"{text}\n", encoding="utf-8")
    drawn = picture_of(found.plot(), options.figure_format)
    (folder / f"{figure}.{options.figure_format}").write_bytes(drawn)


def finite(value: float) -> float | None:
    """A number as a table has it, in which a blank cell stands for what is not finite."""
    return value if math.isfinite(value) else None


def say(problem: str) -> None:
    """One sentence on what is wrong, beside the answer."""
    print(f"rotorfit: {shown(problem)}", file=sys.stderr)


def sentences(findings: Sequence[Iterable[Finding]], sources: Sequence[str]) -> tuple[str, ...]:
    """Errors and warnings about data, for commands whose answer is not printed."""
    found = attributed(findings, sources)
    return (*errors_in(found), *warnings_in(found))
