"""Unknown words are answered with the nearest; every help has an example; tables are there as JSON."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path

import pytest

import rotorfit as rf
from rotorfit.apps.cli.main import COMMANDS, DAILY, EXAMPLES, build_parser

Run = Callable[..., tuple[int, str, str]]


@pytest.mark.parametrize(
    ("words", "meant"),
    [
        (("fitt", "rig.csv"), "'fit'"),
        (("simulat",), "'simulate'"),
        (("fit", "rig.csv", "--modle", "one-mode"), "--model"),
        (("judge", "fit.json", "--max-sped", "2000"), "--max-speed"),
        (("store", "lsit", "machine.db"), "'list'"),
    ],
)
def test_a_misspelt_word_is_answered_with_the_nearest(run: Run, words: tuple[str, ...], meant: str) -> None:
    code, _, said = run(*words)
    assert code == 2
    assert f"did you mean {meant}?" in said
    assert len(said.strip().splitlines()) == 1


def test_help_is_a_command_too(run: Run) -> None:
    assert run("help", "fit")[:2] == run("fit", "--help")[:2]
    assert run("help")[0] == 0


@pytest.mark.parametrize("name", COMMANDS)
def test_every_help_has_an_example_that_the_command_line_takes(name: str) -> None:
    for line in EXAMPLES[name].splitlines():
        words = line.partition(" > ")[0].split()
        assert words[0] == name
        assert build_parser([name]).parse_args(words).command is not None
        assert len(line) <= 70  # one line of a terminal, which does not break it


def test_help_of_what_a_store_does_has_examples_too(run: Run) -> None:
    _, shown, _ = run("store", "--help")
    for action in re.findall(r"^    ([a-z]+) ", shown, re.MULTILINE):
        code, own, _ = run("store", action, "--help")
        example = own.partition("Example: rotorfit ")[2].split()
        assert (code, example[:2]) == (0, ["store", action])
        assert build_parser(["store"]).parse_args(example).action is not None


@pytest.mark.parametrize("name", DAILY)
def test_help_shows_the_options_of_every_day_first(run: Run, name: str) -> None:
    code, short, _ = run(name, "--help")
    _, whole, _ = run(name, "--help-all")
    shown = set(re.findall(r"^  (--[a-z-]+)", short, re.MULTILINE))
    assert code == 0
    assert shown == {"--help-all", *(f"--{option}" for option in DAILY[name])}
    assert len(short.splitlines()) < len(whole.splitlines()) / 2


@pytest.mark.parametrize("name", sorted(set(COMMANDS) - {"completion", "open", "store", "template"}))
def test_every_command_that_prints_a_table_gives_it_as_json(name: str) -> None:
    words = EXAMPLES[name].splitlines()[0].partition(" > ")[0].split()
    assert build_parser([name]).parse_args([*words, "--json"]).json


def test_what_a_file_that_was_written_holds_is_there_as_json(run: Run, tmp_path: Path) -> None:
    first, both = tmp_path / "first.csv", tmp_path / "both.csv"
    (tmp_path / "virtual.toml").write_text(run("template", "simulation")[1])
    code, made, _ = run("simulate", tmp_path / "virtual.toml", "--out", first, "--quiet", "--json")
    joined = run("join", first, "--out", both, "--json")
    assert (code, joined[0]) == (0, 0)
    assert json.loads(made) == {**json.loads(joined[1]), "source": "first.csv"}
    assert [json.loads(made)] == json.loads(run("info", first, "--json")[1])
    code, out, _ = run("vectors", rf.datasets.path("volts_disk-fwd.h5"), "--out", tmp_path / "v.csv", "--json")
    assert (code, json.loads(out)["planes"]) == (0, ["disk", "journal"])


def test_tables_are_there_as_json(run: Run) -> None:
    code, out, _ = run("models", "whirl-whip", "--json")
    assert (code, [p["name"] for p in json.loads(out)["whirl-whip"]]) == (
        0,
        list(rf.models.WhirlWhip().parameter_names),
    )
    code, out, _ = run("info", str(rf.datasets.path("rig_open.csv")), "--json")
    [test] = json.loads(out)
    assert (code, test["readings"], test["speed_rpm"]) == (0, 4032, [1000, 2000])
    code, out, _ = run("look", str(rf.datasets.path("volts_disk-fwd.h5")), "--json")
    [record] = json.loads(out)
    assert (code, record["planes"], record["findings"]) == (0, ["disk", "journal"], [])
