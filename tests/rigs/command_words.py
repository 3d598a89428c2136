"""What tests of the command line share: the bundled rig, what a fit of it writes, the sentence of a refusal."""

from __future__ import annotations

import csv
from collections.abc import Callable
from pathlib import Path

import rotorfit as rf
from rotorfit.apps.cli import main as cli
from rotorfit.apps.study_files.folder import CONTENTS

RIG = str(rf.datasets.path("rig_open.csv"))
TRUTH = rf.datasets.truth("rig_open")
FIT = ["fit", RIG, "--model", "whirl-whip", "--known", "K3=6000"]
FIGURES = {"dynamic_stiffness.png", "bode.png", "polar.png", "residuals.png", "stability.png"}
FIGURES |= {"budget.png", "quadrature.png", "damping.png"}
TABLES = {"summary.txt", "parameters.csv", "covariance.csv", "responses.csv", "curves.csv"}
WHOLE = {"report.html", "fit.json", CONTENTS}
FROM_VOLTS = ["demo", "--from-volts"]
"""A command of the README that tests/lab/test_responses.py runs, and looks at what it writes."""
SAMPLED = {"posterior.nc", "corner.png", "chains.png"}

Run = Callable[..., tuple[int, str, str]]


def refused(result: tuple[int, str, str]) -> str:
    """The one sentence of a refusal."""
    code, out, err = result
    assert (code, out) == (cli.ExitCode.BAD_INPUT, "")
    assert err.startswith("rotorfit: ")
    assert len(err.splitlines()) == 1, err
    return err.removeprefix("rotorfit: ").rstrip("\n")


def perturbed() -> rf.PerturbationTest:
    rig = rf.datasets.rig_open()
    assert isinstance(rig, rf.PerturbationTest)
    return rig


def table(path: Path) -> dict[str, dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as stream:
        return {row["parameter"]: row for row in csv.DictReader(stream)}
