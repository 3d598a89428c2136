"""Output of commands other than a fit: a folder, JSON or text; errors of the data first."""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

from rotorfit.cli.errors import BadInputError
from rotorfit.data.findings import Finding, attributed, errors_in, warnings_in
from rotorfit.estimators.file_reading import shown
from rotorfit.studies.wording import sentence


def give(
    options: argparse.Namespace,
    write: Callable[[Path], None],
    plain: Callable[[], Any],
    text: str,
    warned: Iterable[str] = (),
) -> None:
    """Fill the folder and print, as the options ask; warnings, which the text holds, are not silenced by --quiet."""
    from rotorfit.studies.folder import complete_folder

    if options.out is not None:
        try:
            with complete_folder(options.out) as folder:
                write(folder)
        except OSError as problem:
            raise BadInputError(sentence(problem)) from problem
    if options.json:
        print(json.dumps(plain(), indent=1, allow_nan=False))
    elif not options.quiet:
        print(text + (f"\n\nwritten to {options.out}" if options.out else ""))
    if options.quiet:
        for warning in warned:
            say(warning)


def finite(value: float) -> float | None:
    """A number as JSON has it, which knows no infinities."""
    return value if math.isfinite(value) else None


def say(problem: str) -> None:
    """One sentence on what is wrong, beside the answer."""
    print(f"rotorfit: {shown(problem)}", file=sys.stderr)


def say_findings(findings: Sequence[Iterable[Finding]], sources: Sequence[str]) -> None:
    """Errors and warnings about data, for commands whose answer is not printed."""
    found = attributed(findings, sources)
    for problem in (*errors_in(found), *warnings_in(found)):
        say(problem)
