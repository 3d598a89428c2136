"""The command line: ``rotorfit demo``, ``fit``, ``run``, ``campaign``, ``compare-laws``, ``simulate`` and others.

Exit codes: 0 done, 1 the fit or the sampling did not converge, 2 bad input (one sentence on stderr), 130 interrupted.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import replace
from time import monotonic
from typing import TYPE_CHECKING, TypeVar

from rotorfit.cli_options import data_files, fit_study, parser

if TYPE_CHECKING:
    from rotorfit.study import Outcome, Study

DONE, NOT_CONVERGED, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130

_BAR = 24  # characters of the bar of progress

T = TypeVar("T")


class BadInputError(Exception):
    """Something in the user's hands is wrong; the message says what, where and what to do."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line.

    Args:
        arguments: words after the program's name, by default those it was started with.

    Returns:
        the exit code.
    """
    options = parser(COMMANDS).parse_args(arguments)
    try:
        code = int(options.command(options))
        sys.stdout.flush()
        return code
    except BrokenPipeError:  # whoever reads the output, `head` for instance, has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # nor may the last flush complain
        return DONE
    except BadInputError as problem:
        print(f"rotorfit: {problem}", file=sys.stderr)
        return BAD_INPUT
    except KeyboardInterrupt as stop:
        print(f"rotorfit: interrupted, {stop.args[0] if stop.args else 'nothing was written'}", file=sys.stderr)
        return INTERRUPTED


def sentence(problem: BaseException) -> str:
    """Message of an exception as a person would write it."""
    if isinstance(problem, KeyError) and problem.args:
        return str(problem.args[0])  # str() of a KeyError puts quotes around the sentence
    if isinstance(problem, OSError) and problem.strerror:
        return f"{problem.filename}: {problem.strerror}" if problem.filename else problem.strerror
    return str(problem)


def checked(work: Callable[[], T]) -> T:
    """Do work that depends on the user's files and settings; what they get wrong becomes a :class:`BadInputError`."""
    try:
        return work()
    except (ValueError, KeyError, OSError) as problem:
        raise BadInputError(sentence(problem)) from problem


# ---- commands ---------------------------------------------------------------------------------


def _fit(options: argparse.Namespace) -> int:
    return _identify(checked(lambda: fit_study(options)), options)


def _run(options: argparse.Namespace) -> int:
    from rotorfit.study_toml import read_study

    study = checked(lambda: read_study(options.study))
    return _identify(study if options.out is None else replace(study, out=options.out), options)


def _demo(options: argparse.Namespace) -> int:
    from rotorfit import datasets
    from rotorfit.study import DataFile, Study

    rig = DataFile(datasets.path("rig_open.csv"))
    study = Study(files=(rig,), model="whirl-whip", known={"K3": 6000.0}, refine=True, out=options.out)
    return _identify(study, options, rig="rig_open")


def _identify(study: Study, options: argparse.Namespace, rig: str = "") -> int:
    """Run a study, write its folder, print its summary, say how it went."""
    from rotorfit.cli_output import outcome_json, summary

    progress = Progress(enabled=not options.quiet and sys.stderr.isatty())
    try:
        outcome = _work(study, progress, rig)
    except OSError as problem:  # the folder for the results
        raise BadInputError(sentence(problem)) from problem
    finally:
        progress.close()
    if options.json:
        print(outcome_json(outcome))
    elif not options.quiet:
        print(summary(outcome, rig))
        if study.out:
            print(f"\nwritten to {study.out}")
    for finding in (finding for found in outcome.findings for finding in found):
        if finding.severity == "error":
            print(f"rotorfit: {finding.message}", file=sys.stderr)
    if outcome.failure:
        print(f"rotorfit: {outcome.failure}", file=sys.stderr)
        return NOT_CONVERGED
    return DONE


def _work(study: Study, progress: Progress, rig: str) -> Outcome:
    from rotorfit.cli_output import complete_folder, kept_checkpoint, write_outcome
    from rotorfit.study import run_study

    keep = kept_checkpoint(study.out) if study.out and study.sample else nullcontext()
    with complete_folder(study.out) if study.out else nullcontext() as folder, keep as checkpoint:
        outcome = checked(lambda: run_study(study, progress, checkpoint))
        if folder is not None:
            write_outcome(outcome, folder, progress, rig)
    return outcome


def _models(options: argparse.Namespace) -> int:
    from rotorfit.models import MODELS
    from rotorfit.study import check_model_name

    if options.name is not None:
        checked(lambda: check_model_name(options.name))
    tables = []
    for model in MODELS.values() if options.name is None else (MODELS[options.name],):
        head, _, rows = model().describe().partition("\n")
        first = (model.__doc__ or "").partition("\n")[0]
        tables.append(f"{head}\n  {first}\n{rows}")
    print("\n\n".join(tables))
    return DONE


def _info(options: argparse.Namespace) -> int:
    from rotorfit.cli_output import describe_test
    from rotorfit.data_check import check

    tests = checked(lambda: [file.read() for file in data_files(options)])
    print("\n\n".join(describe_test(test, check(test)) for test in tests))
    return DONE


def _campaign(options: argparse.Namespace) -> int:
    from rotorfit.cli_campaign import run

    return run(options)


def _compare_laws(options: argparse.Namespace) -> int:
    from rotorfit.cli_laws import run

    return run(options)


def _simulate(options: argparse.Namespace) -> int:
    from rotorfit.cli_simulate import run

    return run(options)


COMMANDS = {
    "demo": _demo,
    "fit": _fit,
    "run": _run,
    "campaign": _campaign,
    "compare-laws": _compare_laws,
    "simulate": _simulate,
    "models": _models,
    "info": _info,
}
"""What each word does."""


class Progress:
    """One line on stderr: the stage at work, a bar where it is known how far it is, the seconds since the start."""

    def __init__(self, *, enabled: bool) -> None:
        self._begin, self._enabled = monotonic(), enabled

    def __call__(self, stage: str, done: float | None = None) -> None:
        """Show a stage."""
        if self._enabled:
            seconds = monotonic() - self._begin
            bar = "" if done is None else f"[{'#' * round(_BAR * done):<{_BAR}}] {100 * done:3.0f} %  "
            print(f"\r\033[K{seconds:5.1f} s  {bar}{stage} ...", end="", file=sys.stderr, flush=True)

    def close(self) -> None:
        """Clear the line."""
        if self._enabled:
            print("\r\033[K", end="", file=sys.stderr, flush=True)
