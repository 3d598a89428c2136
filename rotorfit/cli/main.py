"""The command line: ``rotorfit demo``, ``fit``, ``run``, ``campaign``, ``compare-laws``, ``simulate`` and others.

Exit codes: 0 done, 1 the data have an error or the fit or sampling did not converge, 2 bad input (one sentence on
stderr), 3 an alarm of a watched machine, 130 interrupted.
"""

from __future__ import annotations

import argparse
import os
import sys
import warnings
import webbrowser
from collections.abc import Callable, Sequence
from contextlib import ExitStack, nullcontext, suppress
from dataclasses import replace
from io import UnsupportedOperation
from pathlib import Path
from shutil import copyfile
from typing import TYPE_CHECKING, Any, NoReturn

from numpy.linalg import LinAlgError

from rotorfit.cli import balance, history, recordings, rotors, several, simulate, watch
from rotorfit.cli.answer import Answer, BadInputError, ExitCode, answered, checked, say
from rotorfit.cli.arguments import (
    add_files,
    add_fit_options,
    add_jobs,
    add_paths,
    add_report,
    data_files,
    fit_study,
    option,
    workers_of,
)
from rotorfit.cli.progress import ProgressLine, progress_line
from rotorfit.estimators.atomic_file import protected_inputs
from rotorfit.estimators.file_reading import shown
from rotorfit.models import MODELS, KnownStructure
from rotorfit.studies.wording import sentence
from rotorfit.version import __version__

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from rotorfit.studies.study import Outcome, Study


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line.

    Returns:
        the exit code.
    """
    try:
        try:
            return _carry_out(arguments)
        finally:  # help ends by an exit of its own
            sys.stdout.flush()
    except BrokenPipeError:  # whoever reads the output, `head` for instance, has seen enough
        _close_output()
        return ExitCode.DONE
    except OSError as problem:  # the output, or what no command expects of its files
        _close_output()
        print(f"rotorfit: the output cannot be written: {shown(sentence(problem))}", file=sys.stderr)
        return ExitCode.BAD_INPUT


def _carry_out(arguments: Sequence[str] | None) -> int:
    """Do what the words say; what is wrong with them, or with the files that they name, becomes a sentence."""
    parser = build_parser()
    options = parser.parse_args(arguments)
    if options.command is None:
        parser.print_help()
        return ExitCode.DONE
    named = (getattr(options, name, None) for name in ("setup", "study", "fit"))
    given = (*getattr(options, "files", ()), *named)
    try:
        with warnings.catch_warnings(), protected_inputs([path for path in given if path is not None]):
            # As a sentence, without the file and line of the program that it comes from.
            warnings.showwarning = lambda message, *_, **__: say(str(message))
            return int(options.command(options))
    except BadInputError as problem:
        print(f"rotorfit: {shown(str(problem))}", file=sys.stderr)
        return ExitCode.BAD_INPUT
    except LinAlgError as problem:  # equations of motion that cannot be solved, as known values are
        print(f"rotorfit: {problem}", file=sys.stderr)
        return ExitCode.BAD_INPUT
    except KeyboardInterrupt as stop:
        print(f"rotorfit: interrupted, {stop.args[0] if stop.args else 'nothing was written'}", file=sys.stderr)
        return ExitCode.INTERRUPTED


def _close_output() -> None:
    """Drop what is still to be printed: nor may the last flush complain."""
    with suppress(UnsupportedOperation):  # an output of no file, as of tests and notebooks
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


# ---- commands ---------------------------------------------------------------------------------


def _add_fit(to: argparse.ArgumentParser) -> None:
    add_fit_options(to)
    add_jobs(to, "reduce recordings and fit simulated tests")
    add_report(to)


def _fit(options: argparse.Namespace) -> int:
    return _identify(checked(lambda: fit_study(options)), options)


def _add_run(to: argparse.ArgumentParser) -> None:
    to.add_argument("study", type=Path, metavar="STUDY.toml", help="settings of a fit as TOML keys")
    option(to, "--out OUT", "folder for the results, instead of the file's", Path)
    add_jobs(to, "reduce recordings and fit simulated tests")
    add_report(to)


def _run(options: argparse.Namespace) -> int:
    from rotorfit.studies.study_file import read_study

    study = checked(lambda: read_study(options.study))
    return _identify(study if options.out is None else replace(study, out=options.out), options)


def _add_demo(to: argparse.ArgumentParser) -> None:
    what = to.add_mutually_exclusive_group()
    option(what, "--from-volts", "begin with the raw signals of bundled recordings")
    words = "identify a rig of 56 degrees of freedom instead, which a chain of two masses describes only roughly"
    option(what, "--finite-elements", words)
    option(to, "--out OUT", "folder for the results [%(default)s]", Path, default=Path("rotorfit-demo"))
    add_report(to)


def _demo(options: argparse.Namespace) -> int:
    from rotorfit import datasets
    from rotorfit.studies.data_files import DataFile, RecordingFiles
    from rotorfit.studies.study import Study

    name = "volts" if options.from_volts else "rig_open" if options.finite_elements else "rig_lumped"
    volts = RecordingFiles(paths=tuple(datasets.volts())) if options.from_volts else None
    rig = volts or DataFile(datasets.path(f"{name}.csv"))
    study = Study(files=(rig,), model="whirl-whip", known={"K3": 6000.0}, refine=True, out=options.out)
    return _identify(study, options, rig=name)


def _identify(study: Study, options: argparse.Namespace, rig: str = "") -> int:
    """Run a study, write its folder, print its summary, say how it went."""
    from rotorfit.report.interactive import check_interactive
    from rotorfit.studies.results import outcome_json
    from rotorfit.studies.text import summary

    if options.interactive:
        if study.out is None:
            raise BadInputError("--interactive is for the report; say by --out where to write it")
        checked(check_interactive)
    try:
        with progress_line(options) as progress, ExitStack() as stack:
            executor = None if rig else checked(lambda: stack.enter_context(workers_of(options)))
            outcome = _work(study, progress, rig, options, executor)
    except OSError as problem:  # the folder for the results
        raise BadInputError(sentence(problem)) from problem
    if options.json:
        print(outcome_json(outcome))
    elif not options.quiet:
        print(summary(outcome, rig) + (f"\n\nwritten to {study.out}" if study.out else ""))
    for warned in outcome.warnings if options.quiet else ():
        say(warned)
    if outcome.failure:
        print(f"rotorfit: {outcome.failure}", file=sys.stderr)
        return ExitCode.NOT_CONVERGED
    return ExitCode.DONE


def _work(
    study: Study, progress: ProgressLine, rig: str, options: argparse.Namespace, executor: Executor | None
) -> Outcome:
    from rotorfit.studies.folder import complete_folder, kept_checkpoint
    from rotorfit.studies.results import write_outcome
    from rotorfit.studies.run import run_study

    keep = kept_checkpoint(study.out) if study.out and study.sample else nullcontext()
    with keep as checkpoint, complete_folder(study.out) if study.out else nullcontext() as folder:
        outcome = checked(lambda: run_study(study, progress, checkpoint, executor), getattr(options, "study", None))
        if folder is not None:
            write_outcome(outcome, folder, progress, rig, options.figure_format, options.interactive)
            for path in [path for file in study.files for path in file.paths] if rig else ():
                copyfile(path, folder / path.name)  # so that what the report says to reproduce it runs there
    return outcome


def _add_models(to: argparse.ArgumentParser) -> None:
    to.add_argument("name", nargs="?", help="only this one")


def _models(options: argparse.Namespace) -> Answer:
    from rotorfit.studies.study import check_model_name

    one = KnownStructure([[1.0]], None, None, [[1.0]], planes={"journal": 0}, fluid="journal", dofs=("z",))
    known = {**{name: model() for name, model in MODELS.items()}, one.name: one}
    if options.name is not None and options.name != one.name:
        check_model_name(options.name)
    tables = []
    for model in known.values() if options.name is None else (known[options.name],):
        head, _, rows = model.describe().partition("\n")
        first = (model.__doc__ or "").partition("\n")[0]
        tables.append(f"{head}\n  {first}\n{rows}")
    return Answer(text="\n\n".join(tables))


def _info(options: argparse.Namespace) -> Answer:
    from rotorfit.studies.data_files import read_files
    from rotorfit.studies.text import describe_test

    with progress_line(options) as progress:
        tests = read_files(data_files(options), progress)
    wrong = any(finding.severity == "error" for findings in tests[1] for finding in findings)
    text = "\n\n".join(describe_test(test, findings) for test, findings in zip(*tests, strict=True))
    return Answer(text=text, good=not wrong)


def _add_completion(to: argparse.ArgumentParser) -> None:
    words = "the shell; source the printed script when it starts"
    to.add_argument("shell", choices=("bash", "zsh", "tcsh"), help=words)


def _completion(options: argparse.Namespace) -> Answer:
    try:
        import shtab
    except ImportError as reason:
        raise BadInputError('completion needs shtab: pip install "rotorfit[completion]"') from reason
    return Answer(text=shtab.complete(build_parser(), options.shell))


def _add_open(to: argparse.ArgumentParser) -> None:
    words = "test files and recordings, or a folder of them [this folder]; nothing outside their folder is touched"
    add_paths(to, words, "*")
    option(to, "--port N", "port of the server [any free one]", int, default=0)
    option(to, "--no-browser", "print the address and start no browser")


def _open(options: argparse.Namespace) -> int:
    """Serve until interrupted; returns the exit code."""
    from rotorfit.app.server import serve

    def tell(address: str) -> None:
        print(f"rotorfit is at {address}\nCtrl-C ends it", flush=True)
        if not options.no_browser:
            webbrowser.open(address)

    checked(lambda: serve(options.files, port=options.port, on_ready=tell))
    return ExitCode.DONE


COMMANDS: dict[str, tuple[str, Callable[[Any], None], Callable[[Any], int]]] = {
    "demo": ("identify the bundled rig and compare with its truth", _add_demo, _demo),
    "fit": ("fit a model to test files", _add_fit, _fit),
    "run": ("fit with the settings of a TOML file", _add_run, _run),
    "campaign": (several.CAMPAIGN_HELP, several.add_campaign, answered(several.campaign)),
    "compare-laws": (several.LAWS_HELP, several.add_laws, answered(several.laws)),
    "simulate": (simulate.HELP, simulate.add_options, answered(simulate.answer)),
    "vectors": (recordings.VECTORS, recordings.add_vectors, answered(recordings.vectors)),
    "join": (recordings.JOIN, recordings.add_join, answered(recordings.join)),
    "balance": (balance.HELP, balance.add_options, answered(balance.answer)),
    "predict": (rotors.PREDICT, rotors.add_predict, answered(rotors.predict)),
    "plan": (rotors.PLAN, rotors.add_plan, answered(rotors.plan)),
    "judge": (rotors.JUDGE, rotors.add_judge, answered(rotors.judge)),
    "store": (history.STORE, history.add_store, answered(history.store)),
    "open": ("view, fit and judge tests and recordings in a browser, on this machine only", _add_open, _open),
    "watch": (watch.HELP, watch.add_options, watch.run),
    "template": (recordings.TEMPLATE, recordings.add_template, answered(recordings.template)),
    "look": (recordings.LOOK, recordings.add_look, answered(recordings.look)),
    "trend": (history.TREND, history.add_trend, answered(history.machine_trend)),
    "models": ("list the models and their parameters", _add_models, answered(_models)),
    "info": ("summarise a test file with its findings", add_files, answered(_info)),
    "completion": (
        "print a script that lets a shell complete commands and options", _add_completion, answered(_completion),
    ),
}  # fmt: skip
"""Each command: what it is for, its options, and what it does; it returns the exit code."""


class _Parser(argparse.ArgumentParser):
    """A parser that refuses in one sentence, as the rest of the program does."""

    def error(self, message: str) -> NoReturn:
        self.exit(ExitCode.BAD_INPUT, f"rotorfit: {message}; `{self.prog} --help` says what there is\n")


def build_parser() -> argparse.ArgumentParser:
    """The words that the command line understands."""
    whole = _Parser(
        prog="rotorfit",
        allow_abbrev=False,
        description="Identify rotor and fluid-force parameters from rotating-force perturbation tests.",
        epilog="Exit codes: 0 done, 1 the data have an error or the fit or sampling did not converge, 2 bad input, "
        "3 an alarm.",
    )
    whole.add_argument("--version", action="version", version=f"rotorfit {__version__}")
    whole.set_defaults(command=None)
    group = whole.add_subparsers(metavar="COMMAND")
    for name, (help, add_options, command) in COMMANDS.items():
        added = group.add_parser(name, help=help, description=help, allow_abbrev=False)
        added.set_defaults(command=command)
        add_options(added)
    return whole
