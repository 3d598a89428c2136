"""``rotorfit join``: a run without a trial weight and runs with one that stand in several files, as one file."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from rotorfit.cli.arguments import add_files, data_files

if TYPE_CHECKING:
    from rotorfit.data.experiments import PerturbationTest

DESCRIPTION = "put runs of several files, such as a reference run and runs with a trial weight, into one file"


def add_options(to: argparse.ArgumentParser) -> None:
    """Options of the command."""
    add_files(to)
    to.add_argument("--out", type=Path, required=True, metavar="FILE", help="file to write (.csv .uff .nc .mat)")
    to.add_argument("--quiet", action="store_true", help="do not say what the file holds")


def run(options: argparse.Namespace) -> int:
    """Do what the command line says; returns the exit code."""
    from rotorfit.cli.answer import say_findings
    from rotorfit.cli.errors import ExitCode, checked
    from rotorfit.io.files import check_target, write
    from rotorfit.studies.data_files import DataFile, no_progress, read_files
    from rotorfit.studies.text import describe_test

    checked(lambda: check_target(options.out))
    test = checked(lambda: joined_runs(options))
    checked(lambda: write(test, options.out))
    (whole,), (findings,) = checked(lambda: read_files([DataFile(options.out)], no_progress))
    if options.quiet:
        say_findings([findings], [whole.source])
    else:
        print(f"{describe_test(whole, findings)}\n\nwritten to {options.out}")
    return ExitCode.DONE


def joined_runs(options: argparse.Namespace) -> PerturbationTest:
    """Runs of all files, not differenced."""
    from rotorfit.data.experiments import PerturbationTest
    from rotorfit.data.joined import join_runs
    from rotorfit.studies.data_files import DataFile, no_progress, read_files

    files = []
    for file in data_files(options):
        if not isinstance(file, DataFile):
            raise ValueError(f"{file.paths[0].name} is a recording: make vectors of it first, `rotorfit vectors`")
        files.append(DataFile(file.path, {**file.options, "difference": False}))
    tests, _ = read_files(files, no_progress)
    for test in tests:
        if not isinstance(test, PerturbationTest):
            raise ValueError(f"{test.source}: a {test.title} cannot be joined: it has no runs with a force")
    return join_runs([test for test in tests if isinstance(test, PerturbationTest)], difference=False)
