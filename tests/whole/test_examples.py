"""The examples in docstrings run, and say what they show."""

from __future__ import annotations

import doctest
import importlib
import inspect
from pathlib import Path

import pytest
from package_modules import MODULES

import rotorfit as rf


@pytest.fixture(scope="module")
def names(tmp_path_factory: pytest.TempPathFactory) -> dict[str, object]:
    """What the examples take for granted: the bundled rig, its fit, a folder to write to."""
    rig = rf.datasets.rig_open()
    fit = rf.fit(rf.models.WhirlWhip(), rig, known={"K3": 6000.0})
    return {"rf": rf, "rig": rig, "fit": fit, "folder": Path(tmp_path_factory.mktemp("examples"))}


def examples() -> list[doctest.DocTest]:
    finder = doctest.DocTestFinder()
    return [test for name in MODULES for test in finder.find(importlib.import_module(name)) if test.examples]


EXAMPLES = examples()


def test_the_functions_of_the_front_have_an_example() -> None:
    """All but two, which need a recorded shaft that is not round: making one takes seconds."""
    shown = {example.name.rpartition(".")[2] for example in EXAMPLES}
    wanted = {name for name in rf.__all__ if inspect.isfunction(getattr(rf, name))}
    assert wanted - shown == {"shaft_lines", "dated_anisotropy"}


@pytest.mark.usefixtures("sketched")
@pytest.mark.parametrize("example", EXAMPLES, ids=lambda example: example.name.removeprefix("rotorfit."))
def test_an_example_says_what_it_shows(example: doctest.DocTest, names: dict[str, object]) -> None:
    example.globs = dict(names)
    said: list[str] = []
    result = doctest.DocTestRunner(verbose=False).run(example, out=said.append)
    assert result.failed == 0, "".join(said)
