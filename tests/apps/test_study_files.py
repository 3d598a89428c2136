"""Studies in TOML files: every key, and what is wrong with one in a sentence."""

from __future__ import annotations

import html
import json
import re
import shlex
from pathlib import Path

import numpy as np
import pytest
from command_words import FIGURES, FIT, RIG, TABLES, WHOLE, Run, refused

import rotorfit as rf
from rotorfit.apps.cli.arguments import fit_study
from rotorfit.apps.cli.main import build_parser
from rotorfit.apps.study_files.data_files import DataFile
from rotorfit.apps.study_files.study import Study
from rotorfit.apps.study_files.study_file import read_study

STUDY = """
files = ["rig.csv"]
model = "whirl-whip"
out = "results"
refine = true
known = {K3 = 6000.0}
bounds = {lam = [0.0, 0.6]}
"""


def test_run_is_fit_from_a_file(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "study"
    folder.mkdir()
    (folder / "rig.csv").write_bytes(Path(RIG).read_bytes())
    (folder / "study.toml").write_text(STUDY, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    code, out, _ = run("run", "study/study.toml", "--json")
    assert code == 0
    assert {p.name for p in (folder / "results").iterdir()} == TABLES | FIGURES | WHOLE
    same = run(*FIT, "--bounds", "lam=0:0.6", "--refine", "--json")[1]
    assert json.loads(out)["parameters"] == json.loads(same)["parameters"]


def test_the_report_of_a_study_writes_its_start_back(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What was typed stands there; of a fit alone, the command that it proposes is read as its settings."""
    (tmp_path / "rig.csv").write_bytes(Path(RIG).read_bytes())
    (tmp_path / "study.toml").write_text(
        'files = ["rig.csv"]\nmodel = "whirl-whip"\nout = "results"\nknown = {K3 = 6000.0}\nstart = {D = 312.5}\n',
        encoding="utf-8",
    )
    monkeypatch.chdir(tmp_path)
    assert run("run", "study.toml", "--no-figures")[0] == 0
    typed = (tmp_path / "results" / "report.html").read_text(encoding="utf-8")
    assert "<pre>rotorfit run study.toml --no-figures</pre>" in typed
    report = rf.write_report(rf.load_fit(tmp_path / "results" / "fit.json"), tmp_path / "alone.html")
    page = report.read_text(encoding="utf-8")
    command = re.search("<pre>(rotorfit fit .*?)</pre>", page)
    assert command is not None
    asked = fit_study(build_parser().parse_args(shlex.split(html.unescape(command[1]))[1:]))
    assert (asked.start, asked.known) == ({"D": 312.5}, {"K3": 6000.0})
    assert "start={'D': 312.5}" in html.unescape(page)


def test_every_key_of_a_study(tmp_path: Path) -> None:
    (tmp_path / "all.toml").write_text(
        """
        model = "whirl-whip"
        out = "results"
        planes = ["rotor", "seal"]
        blocks = ["coupling_mass"]
        two_lam = true
        known = {K3 = 6000, sigma = "free"}
        bounds = {lam_D = [-inf, 0.6]}
        priors = {sigma = {norm = [1.0, 0.01]}}
        per = {D = "speed_rpm"}
        start = {D = 400}
        loss = "cauchy"
        phase_offsets = true
        refine = true
        sample = true
        seed = 0
        ess = 1000
        max_steps = 500
        profile = ["lam", "threshold_speed"]
        bootstrap = 100
        [[files]]
        path = "a.csv"
        [[files]]
        path = "b.csv"
        slow_roll_below_rpm = 300
        probe_angles_deg = {journal = [45, 135]}
        gains = {"upper journal x" = [1.02, 90.0]}
        delays_s = {"journal y" = 1e-5}
        slow_roll_um_deg = {"journal x" = [2.0, 180.0]}
        speed_rpm = 600
        difference = false
        speed_tolerance = 0.01
        """,
        encoding="utf-8",
    )
    study = read_study(tmp_path / "all.toml")
    assert study.files[0] == DataFile(tmp_path / "a.csv")
    options = dict(study.files[1].options)
    assert options["gains"]["upper journal", "x"] == pytest.approx(1.02j)
    assert options["slow_roll"]["journal", "x"] == pytest.approx(-2e-6)
    assert options["speed"] == pytest.approx(20 * np.pi)
    assert options["delays"] == {("journal", "y"): 1e-5}
    assert options["probe_angles"] == {"journal": (45.0, 135.0)}
    assert (options["slow_roll_below_rpm"], options["difference"], options["speed_tolerance"]) == (300.0, False, 0.01)
    prior = study.priors["sigma"]
    assert (prior.mean(), prior.std()) == pytest.approx((1.0, 0.01))
    expected = Study(
        files=study.files, model="whirl-whip", out=tmp_path / "results", planes=("rotor", "seal"),
        blocks=("coupling_mass",), two_lam=True, known={"K3": 6000.0, "sigma": None}, bounds={"lam_D": (-np.inf, 0.6)},
        priors={"sigma": prior}, per={"D": "speed_rpm"}, start={"D": 400.0}, loss="cauchy", phase_offsets=True,
        refine=True, sample=True, seed=0, ess=1000.0, max_steps=500, profile=("lam", "threshold_speed"), bootstrap=100,
    )  # fmt: skip
    assert study == expected


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ("knwon = {K3 = 1}", "unknown key 'knwon', did you mean 'known'"),
        ('planes = "disk"', "planes must be a list of texts"),
        ("loss = 3", "loss must be a text"),
        ('two_lam = "yes"', "two_lam must be true or false"),
        ("start = {D = true}", "start.D must be a number"),
        ("start = 3", "start must be a table"),
        ("priors = {D = {nrm = [1, 2]}}", "did you mean 'norm'"),
        ("priors = {D = {norm = [1, 2, 3]}}", "does not take the numbers"),
        ("priors = {D = 3}", "must be one distribution"),
        ('known = {K3 = "fixed"}', '"free" to fit it'),
        ("per = {D = 3}", "per.D must be a text"),
        ('sample = "yes"', "sample must be true or false"),
        ("seed = 1.5", "seed must be a whole number"),
        ("ess = 0", "ess must be above zero"),
        ("bootstrap = 0", "bootstrap must be at least 1"),
        ('profile = "lam"', "profile must be a list of texts"),
        ("= 3", "not a readable TOML file"),
        ("known = {K3 = nan}", "known.K3 must be a finite number"),
        ("start = {lam = 1e308}", "start.lam must be a finite number, at most 1e+30"),
        ("bounds = {lam = [nan, inf]}", "bounds.lam must be a finite number"),
    ],
)
def test_bad_studies_are_one_sentence(run: Run, tmp_path: Path, change: str, expected: str) -> None:
    key = change.partition(" ")[0]
    lines = [line for line in STUDY.splitlines() if not line.startswith(f"{key} ")]
    (tmp_path / "study.toml").write_text("\n".join([*lines, change]), encoding="utf-8")
    message = refused(run("run", tmp_path / "study.toml"))
    assert expected in message
    assert "study.toml" in message
    assert [p.name for p in tmp_path.iterdir()] == ["study.toml"]


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ("known = {K9 = 1.0}", "unknown parameter of whirl-whip 'K9'"),
        ('model = "whirl"', "unknown model 'whirl'"),
        ("bounds = {lam = [0.6, 0.0]}", "bounds of lam are contradictory"),
        ('per = {lam = "oil"}', "has no attribute 'oil'"),
        ('baseline = "absent.csv"', "absent.csv"),
        ('planes = ["a", "b"]', "has a, b"),
    ],
)
def test_values_that_do_not_suit_name_the_study(run: Run, tmp_path: Path, change: str, expected: str) -> None:
    """Also where they are only seen with the data."""
    lines = [line for line in STUDY.splitlines() if not line.startswith((change.partition(" ")[0], "refine"))]
    (tmp_path / "rig.csv").write_bytes(Path(RIG).read_bytes())
    (tmp_path / "study.toml").write_text("\n".join([*lines, change]), encoding="utf-8")
    message = refused(run("run", tmp_path / "study.toml"))
    assert message.startswith(f"{tmp_path / 'study.toml'}: ")
    assert expected in message


@pytest.mark.parametrize(
    ("files", "expected"),
    [
        ("[]", "at least one file"),
        ('[{paht = "rig.csv"}]', "tables with a path"),
        ('[{path = "rig.csv", slow_roll_below = 3}]', "did you mean 'slow_roll_below_rpm'"),
        ('[{path = "rig.csv", gains = {journal = [1, 0]}}]', "a channel is a plane and a direction"),
        ('["absent.csv"]', "absent.csv"),
    ],
)
def test_bad_file_entries_are_one_sentence(run: Run, tmp_path: Path, files: str, expected: str) -> None:
    text = STUDY.replace('["rig.csv"]', files)
    (tmp_path / "study.toml").write_text(text, encoding="utf-8")
    assert expected in refused(run("run", tmp_path / "study.toml"))


def test_study_without_files(run: Run, tmp_path: Path) -> None:
    (tmp_path / "study.toml").write_text('model = "whirl-whip"', encoding="utf-8")
    assert "the key 'files' is missing" in refused(run("run", tmp_path / "study.toml"))
    assert "absent.toml" in refused(run("run", tmp_path / "absent.toml"))
