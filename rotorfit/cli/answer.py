"""Output of commands other than a fit: a folder, JSON or text; errors of the data first."""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

from rotorfit.cli.errors import BadInputError
from rotorfit.data.findings import Finding, attributed, errors_in, warnings_in
from rotorfit.estimators.file_reading import shown
from rotorfit.studies.json_text import json_text
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
        print(json_text(plain()))
    elif not options.quiet:
        print(text + (f"\n\nwritten to {options.out}" if options.out else ""))
    if options.quiet:
        for warning in warned:
            say(warning)


def write_results(found: Any, folder: Path, text: str, options: argparse.Namespace, *, table: str, figure: str) -> None:
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


def say_findings(findings: Sequence[Iterable[Finding]], sources: Sequence[str]) -> None:
    """Errors and warnings about data, for commands whose answer is not printed."""
    found = attributed(findings, sources)
    for problem in (*errors_in(found), *warnings_in(found)):
        say(problem)
