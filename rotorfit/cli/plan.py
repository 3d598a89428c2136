"""``rotorfit plan``: which errors a test will give, and how its time is best spent, before it is made."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rotorfit.cli.answer import Answer, checked, write_results
from rotorfit.cli.arguments import add_output

if TYPE_CHECKING:
    from rotorfit.planning.record import Plan

HELP = "plan a test: expected errors, speeds to run, and time for each line"


def add_options(to: argparse.ArgumentParser) -> None:
    """Options of the command."""
    to.add_argument("study", type=Path, metavar="PLAN.toml", help="rotor, noise and limits of the rig as TOML keys")
    out = "plan.csv to fill in, lines.csv, summary.txt and plan.png, in place of the file's"
    add_output(to, out, figures=True)


def answer(options: argparse.Namespace) -> Answer:
    """The plan."""
    from rotorfit.studies.plan_file import read_plan, run_plan

    study = read_plan(options.study)
    if options.out is None and study["out"]:
        options.out = Path(study["out"])
    found = checked(lambda: run_plan(study), options.study)

    def write(folder: Path) -> None:
        if found.test is not None:
            found.to_csv(folder / "plan.csv")
        write_results(found, folder, str(found), options, table="lines", figure="plan")

    return Answer(text=str(found), write=write, plain=lambda: _plain(found), warned=found.notes)


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
