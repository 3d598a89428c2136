"""A fit in a process of its own: it reports how far it is, can be stopped, and leaves nothing behind."""

from __future__ import annotations

import signal
from collections.abc import Mapping
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

from rotorfit.studies.study import Outcome
from rotorfit.studies.wording import sentence, spoken


@dataclass(frozen=True, kw_only=True)
class Stage:
    """What a fit is at."""

    words: str  # the stage in a few words
    done: float | None  # share of it that is done, where that is known


@dataclass(frozen=True, kw_only=True)
class Refusal:
    """Why a fit came to nothing."""

    words: str  # the command line's sentence


@dataclass(frozen=True, kw_only=True)
class Report:
    """The report of the outcome, the last that a fit sends."""

    text: str


News = Stage | Refusal | Outcome | Report


class Work:
    """A fit that is going on."""

    def __init__(self, content: Mapping[str, Any], base: Path) -> None:
        context = get_context("spawn")
        self._receiver, sender = context.Pipe(duplex=False)
        self._process: BaseProcess = context.Process(target=_fit, args=(dict(content), base, sender), daemon=True)
        self._process.start()
        sender.close()

    def news(self) -> list[News]:
        """All that was sent since it was last asked; the last of all is a refusal or the report."""
        found: list[News] = []
        try:
            while self._receiver.poll():
                found.append(self._receiver.recv())
        except EOFError:
            self._process.join()
            found.append(Refusal(words=f"the fit's process ended with exit code {self._process.exitcode}"))
        return found

    def stop(self) -> None:
        """End the process, whatever it is at."""
        self._process.kill()
        self._process.join()
        self._receiver.close()


def _fit(content: Mapping[str, Any], base: Path, sender: Connection) -> None:
    """Run the study and send its stages and its outcome."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the server's, which ends this process

    from rotorfit.studies.data_files import no_progress
    from rotorfit.studies.results import report_text
    from rotorfit.studies.run import run_study
    from rotorfit.studies.study_file import study_of

    def progress(stage: str, done: float | None = None) -> None:
        sender.send(Stage(words=stage, done=done))

    try:
        outcome = run_study(study_of(content, base), progress)
        progress("looking for errors of the data")
        outcome.failure  # noqa: B018 - kept with the fit, as the table of what its numbers rest on
        outcome.best.assumed  # noqa: B018
        sender.send(outcome)
        sender.send(Report(text=report_text(outcome, no_progress)))
    except (ValueError, KeyError, OSError) as problem:
        sender.send(Refusal(words=spoken(sentence(problem))))
