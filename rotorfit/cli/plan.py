"""``rotorfit plan``: which errors a test will give, and how its time is best spent, before it is made."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rotorfit.cli.answer import give, write_results
from rotorfit.cli.arguments import add_figure_format, add_output

if TYPE_CHECKING:
    from rotorfit.planning.record import Plan

DESCRIPTION = "plan a test: expected errors, speeds to run, and time for each line"


def add_options(to: argparse.ArgumentParser) -> None:
    """Options of the command."""
    to.add_argument("study", type=Path, metavar="PLAN.toml", help="rotor, noise and limits of the rig as TOML keys")
    to.add_argument(
        "--out", type=Path, help="folder for plan.csv to fill in, lines.csv, summary.txt and plan.png, in place of the "
        "file's",
    )  # fmt: skip
    add_figure_format(to)
    add_output(to)


def run(options: argparse.Namespace) -> int:
    """Do what the command line says; returns the exit code."""
    from rotorfit.cli.errors import ExitCode, checked
    from rotorfit.studies.plan_file import read_plan, run_plan

    study = checked(lambda: read_plan(options.study))
    if options.out is None:
        options.out = study.out
    found = checked(lambda: run_plan(replace(study, out=options.out)), options.study)

    def write(folder: Path) -> None:
        if found.test is not None:
            found.to_csv(folder / "plan.csv")
        write_results(found, folder, str(found), options, table="lines", figure="plan")

    give(options, write, lambda: _plain(found), str(found), found.notes)
    return ExitCode.DONE


def _plain(found: Plan) -> dict[str, Any]:
    return {
        "model": found.model.name,
        "quantity": found.quantity,
        "expected": {
            name: {
                "value": one.value,
                "stderr": one.stderr,
                "stderr_low": one.low,
                "stderr_high": one.high,
                "stderr_all_lines_alike": found.even[name].stderr,
                "unit": one.unit,
            }
            for name, one in found.expected.items()
        },
        "certificate": {name: getattr(found.certificate, name) for name in ("optimal", "gap", "efficiency")},
        "time_s": found.time_s,
        "suggestions": found.suggestions,
        "notes": found.notes,
        "lines": found.to_dataframe().to_dict("records"),
    }
