"""What tests of the command line share: the bundled rig, what a fit of it writes, the sentence of a refusal."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

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


def toml(value: Any) -> str:
    """A value as TOML, tables in braces."""
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{json.dumps(str(name))} = {toml(item)}" for name, item in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(toml, value)) + "]"
    return json.dumps(str(value) if isinstance(value, Path) else value)


def toml_file(path: Path, **keys: Any) -> Path:
    """A file of these keys, and its path."""
    path.write_text("".join(f"{name} = {toml(value)}\n" for name, value in keys.items()), encoding="utf-8")
    return path


def perturbed() -> rf.PerturbationTest:
    rig = rf.datasets.rig_open()
    assert isinstance(rig, rf.PerturbationTest)
    return rig


def table(path: Path) -> dict[str, dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as stream:
        return {row["parameter"]: row for row in csv.DictReader(stream)}
