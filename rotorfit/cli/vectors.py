"""``rotorfit vectors``: from recordings of raw signals to a file of responses with their noise."""

from __future__ import annotations

import argparse
import sys
from contextlib import ExitStack
from pathlib import Path

from rotorfit.cli.arguments import add_jobs, add_setup, workers_of

DESCRIPTION = "turn recordings of raw signals into vectors: responses with their noise, in a tidy CSV"


def add_options(to: argparse.ArgumentParser) -> None:
    """Options of the command."""
    to.add_argument("files", nargs="+", type=Path, metavar="FILE", help="recordings (.h5 .tdms .mat .wav .uff .csv)")
    add_setup(to)
    to.add_argument("--out", type=Path, required=True, metavar="FILE", help="file to write (.csv .uff .nc .mat)")
    add_jobs(to, "reduce recordings")
    to.add_argument("--quiet", action="store_true", help="print neither progress nor findings")


def run(options: argparse.Namespace) -> int:
    """Do what the command line says; returns the exit code."""
    from rotorfit.cli.answer import say_findings
    from rotorfit.cli.errors import BadInputError, ExitCode, checked
    from rotorfit.cli.progress import ProgressLine
    from rotorfit.io.files import check_target, write
    from rotorfit.studies.data_files import read_files
    from rotorfit.studies.recording_files import RecordingFiles
    from rotorfit.studies.text import describe_test

    checked(lambda: check_target(options.out))  # before the work, which may take long
    progress = ProgressLine(enabled=not options.quiet and sys.stderr.isatty())
    try:
        source = RecordingFiles(paths=tuple(options.files), setup=options.setup, windows=options.windows)
        with ExitStack() as stack:
            workers = checked(lambda: stack.enter_context(workers_of(options)))
            tests, found = checked(lambda: read_files([source], progress, workers))
    finally:
        progress.close()
    if len(tests) > 1:
        kinds = " and ".join(test.title for test in tests)
        raise BadInputError(f"the recordings are a {kinds}: a file holds one kind of test, give those of one kind")
    (test,), (findings,) = tests, found
    checked(lambda: write(test, options.out))
    if not options.quiet:
        print(f"{describe_test(test, findings)}\n\nwritten to {options.out}")
    else:
        say_findings([findings], [test.source or test.title])
    return ExitCode.NOT_CONVERGED if any(finding.severity == "error" for finding in findings) else ExitCode.DONE
