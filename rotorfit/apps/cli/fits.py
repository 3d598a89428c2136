"""One identification: ``rotorfit demo``, ``fit``, ``run``; ``info`` and ``open``, which look at tests."""

from __future__ import annotations

import argparse
import shlex
import webbrowser
from contextlib import ExitStack, nullcontext
from dataclasses import replace
from pathlib import Path
from shutil import copyfile

from rotorfit import datasets
from rotorfit.apps.app.server import serve, way_to
from rotorfit.apps.cli.answer import Answer, BadInputError, ExitCode, answered, checked, give, progress_line
from rotorfit.apps.cli.arguments import (
    add_files,
    add_fit_options,
    add_jobs,
    add_paths,
    add_report,
    data_files,
    fit_study,
    option,
    wanted_units,
    workers_of,
)
from rotorfit.apps.study_files.data_files import DataFile, RecordingFiles, read_files
from rotorfit.apps.study_files.folder import complete_folder, kept_checkpoint
from rotorfit.apps.study_files.results import outcome_values, write_outcome
from rotorfit.apps.study_files.run import run_study
from rotorfit.apps.study_files.study import Study
from rotorfit.apps.study_files.study_file import read_study
from rotorfit.apps.study_files.text import describe_test, summary, test_values
from rotorfit.apps.study_files.wording import sentence
from rotorfit.base.units import shown_in
from rotorfit.show.report.interactive import check_interactive


def add_fit(to: argparse.ArgumentParser) -> None:
    """Options of ``rotorfit fit``."""
    add_fit_options(to)
    add_jobs(to, "reduce recordings and fit simulated tests")
    add_report(to)


def fit(options: argparse.Namespace) -> ExitCode:
    """The fit of files."""
    return _identify(checked(lambda: fit_study(options)), options)


def add_run(to: argparse.ArgumentParser) -> None:
    """Options of ``rotorfit run``."""
    to.add_argument("study", type=Path, metavar="STUDY.toml", help="settings of a fit as TOML keys")
    option(to, "--out OUT", "folder for the results, instead of the file's", Path)
    add_jobs(to, "reduce recordings and fit simulated tests")
    add_report(to)


def run(options: argparse.Namespace) -> ExitCode:
    """The fit with the settings of a file."""
    study = checked(lambda: read_study(options.study))
    return _identify(study if options.out is None else replace(study, out=options.out), options)


def add_demo(to: argparse.ArgumentParser) -> None:
    """Options of ``rotorfit demo``."""
    what = to.add_mutually_exclusive_group()
    option(what, "--from-volts", "begin with the raw signals of bundled recordings")
    words = "identify a rig of 56 degrees of freedom instead, which a chain of two masses describes only roughly"
    option(what, "--finite-elements", words)
    option(to, "--out OUT", "folder for the results [%(default)s]", Path, default=Path("rotorfit-demo"))
    add_report(to)


def demo(options: argparse.Namespace) -> ExitCode:
    """The fit of a bundled rig beside its truth."""
    name = "volts" if options.from_volts else "rig_open" if options.finite_elements else "rig_lumped"
    volts = RecordingFiles(paths=tuple(datasets.volts())) if options.from_volts else None
    rig = volts or DataFile(datasets.path(f"{name}.csv"))
    study = Study(files=(rig,), model="whirl-whip", known={"K3": 6000.0}, refine=True, out=options.out)
    return _identify(study, options, rig=name)


def _identify(study: Study, options: argparse.Namespace, rig: str = "") -> ExitCode:
    """Run a study, write its folder, print its summary, say how it went."""
    if options.interactive:
        if study.out is None:
            raise BadInputError("--interactive is for the report; say by --out where to write it")
        checked(check_interactive)
    keep = kept_checkpoint(study.out) if study.out and study.sample else nullcontext()
    unwritten: tuple[str, ...] = ()
    try:
        with progress_line(options) as progress, ExitStack() as stack:
            stack.enter_context(shown_in(wanted_units(options)))
            executor = None if rig else checked(lambda: stack.enter_context(workers_of(options)))
            checkpoint = stack.enter_context(keep)
            folder = stack.enter_context(complete_folder(study.out)) if study.out else None
            outcome = checked(lambda: run_study(study, progress, checkpoint, executor), getattr(options, "study", None))
            if folder is not None:
                outcome = replace(outcome, command="" if rig else shlex.join(["rotorfit", *options.words]))
                unwritten = write_outcome(outcome, folder, progress, rig, options.figure_format, options.interactive)
                for path in [path for file in study.files for path in file.paths] if rig else ():
                    copyfile(path, folder / path.name)  # so that what the report says to reproduce it runs there
    except OSError as problem:  # the folder for the results
        raise BadInputError(sentence(problem)) from problem
    options.out = study.out
    failure = [outcome.failure] if outcome.failure else []
    with shown_in(wanted_units(options)):
        text = summary(outcome, rig)
    found = Answer(
        text=text,
        plain=lambda: outcome_values(outcome),
        warned=outcome.warnings,
        said=[*failure, *unwritten],
        good=not failure,
    )
    return give(found, options)


def add_info(to: argparse.ArgumentParser) -> None:
    """Options of ``rotorfit info``."""
    add_files(to)
    option(to, "--json", "print what each test holds as JSON instead of text")


@answered
def info(options: argparse.Namespace) -> Answer:
    """Contents of test files, and what was found in them."""
    with progress_line(options) as progress:
        tests = read_files(data_files(options), progress)
    wrong = any(finding.severity == "error" for findings in tests[1] for finding in findings)
    text = "\n\n".join(describe_test(test, findings) for test, findings in zip(*tests, strict=True))
    return Answer(text=text, plain=lambda: list(map(test_values, *tests)), good=not wrong)


def add_open(to: argparse.ArgumentParser) -> None:
    """Options of ``rotorfit open``."""
    words = "test files and recordings, or a folder of them [this folder]; nothing outside their folder is touched"
    add_paths(to, words, "*")
    option(to, "--port N", "port of the server [any free one]", int, default=0)
    option(to, "--no-browser", "print the address and start no browser")


def open(options: argparse.Namespace) -> ExitCode:
    """Serve until interrupted."""

    with ExitStack() as stack:

        def tell(address: str) -> None:
            print(f"rotorfit is at {address}\nCtrl-C ends it", flush=True)
            if not options.no_browser:
                webbrowser.open(stack.enter_context(way_to(address)))

        checked(lambda: serve(options.files, port=options.port, on_ready=tell))
    return ExitCode.DONE
