"""Long work in a process of its own: it reports how far it is, can be stopped, and leaves nothing behind."""

from __future__ import annotations

import signal
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from rotorfit.apps.study_files.study import Outcome, Study
from rotorfit.apps.study_files.wording import sentence
from rotorfit.base.atomic_file import reading_only_within

if TYPE_CHECKING:
    from rotorfit.lab.data.findings import Finding
    from rotorfit.lab.data.rows import Experiment


class Stage(NamedTuple):
    """Step that the work has reached."""

    words: str  # the stage in a few words
    done: float | None  # share of it that is done, where that is known


class Refusal(NamedTuple):
    """Why the work came to nothing."""

    words: str  # the command line's sentence


@dataclass(frozen=True, kw_only=True)
class Data:
    """The tests of a study, with all their readings, and what was found odd in each."""

    experiments: tuple[Experiment, ...]
    findings: tuple[tuple[Finding, ...], ...]


class Report(NamedTuple):
    """The report of an outcome."""

    text: str


class End(NamedTuple):
    """Nothing more is sent."""


News = Stage | Refusal | Data | Outcome | Report | End
Send = Callable[[News], None]
Task = Callable[[Study, Send], None]


class Work:
    """A task that is going on."""

    def __init__(self, task: Task, study: Study, folder: Path) -> None:
        context = get_context("spawn")
        self._receiver, sender = context.Pipe(duplex=False)
        self._process: BaseProcess = context.Process(target=_carry_out, args=(task, study, folder, sender), daemon=True)
        self._process.start()
        sender.close()

    def news(self) -> list[News]:
        """All that was sent since it was last asked."""
        found: list[News] = []
        try:
            while self._receiver.poll():
                found.append(self._receiver.recv())
        except EOFError:
            if not any(isinstance(one, Refusal | End) for one in found):
                self._process.join()
                found.append(Refusal(words=f"the process of the work ended with exit code {self._process.exitcode}"))
        return found

    def stop(self) -> None:
        """End the process, whatever it is at."""
        self._process.kill()
        self._process.join()
        self._receiver.close()


def read(study: Study, send: Send) -> None:
    """Read the files of a study and look them over."""
    from rotorfit.apps.study_files.data_files import read_files
    from rotorfit.apps.study_files.run import for_model

    experiments, findings = read_files([for_model(study, file) for file in study.files], _progress(send))
    send(Data(experiments=experiments, findings=findings))


def fit(study: Study, send: Send) -> None:
    """Run a study; its outcome is sent first, its report when it is drawn."""
    from rotorfit.apps.study_files.data_files import no_progress
    from rotorfit.apps.study_files.results import report_text
    from rotorfit.apps.study_files.run import run_study

    progress = _progress(send)
    outcome = run_study(study, progress)
    progress("looking for errors of the data")
    outcome.failure  # noqa: B018 - findings are kept with the fit, as the table of what its numbers rest on
    send(outcome)
    send(Report(text=report_text(outcome, no_progress)))


def _progress(send: Send) -> Callable[..., None]:
    def progress(stage: str, done: float | None = None) -> None:
        send(Stage(words=stage, done=done))

    return progress


def _carry_out(task: Task, study: Study, folder: Path, sender: Connection) -> None:
    """Do a task with files of the folder and send what comes of it; what files or settings have wrong is a sentence."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the server's, which ends this process
    try:
        with reading_only_within(folder):
            task(study, sender.send)
        sender.send(End())
    except BrokenPipeError:
        return  # the server has ended, and nobody waits any more
    except (ValueError, KeyError, OSError) as problem:
        sender.send(Refusal(words=sentence(problem)))
