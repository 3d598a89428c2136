"""Plans by the command line: tables, JSON, the model of a saved fit, and what is wrong with a file in one sentence."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from synthetic import TYPICAL, circular_test, covering_frequencies, known_of

import rotorfit as rf
from rotorfit.apps.cli.main import main

ONE = rf.models.OneMode()
TRUTH = TYPICAL["one-mode"]
KNOWN = known_of("one-mode", TRUTH)
THETA = ONE.vector(TRUTH)
SPEEDS = (100.0, 180.0)


def swept(seed: int) -> rf.PerturbationTest:
    w = covering_frequencies(ONE, THETA, SPEEDS, 30)
    return circular_test(ONE, THETA, speeds=SPEEDS, frequency=w, noise=0.01, seed=seed, sigma_known=True)


PLAN = """
model = "one-mode"
known = {K = 8000.0, Ds = 8.0}
quantity = "lam"
noise_um = 0.5
wanted = 0.001
[values]
M = 1.2
K0 = [8e3, 10e3]
D = {norm = [450.0, 30.0]}
lam = 0.46
Mf = 0.4
[design]
speed_rpm = [600, 1200, 1800]
speed_count = 2
frequency_rpm = {from = 200, to = 2400, count = 12}
force_N = 3.0
"""


def test_plan(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file, out = tmp_path / "plan.toml", tmp_path / "out"
    file.write_text(PLAN, encoding="utf-8")
    assert main(["plan", str(file), "--out", str(out)]) == 0
    assert {"plan.csv", "lines.csv", "summary.txt", "plan.png"} <= {one.name for one in out.iterdir()}
    assert "Run at" in capsys.readouterr().out
    assert main(["plan", str(file), "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["expected"]["lam"]["stderr"] > 0
    assert len(answer["lines"]) == 2 * 2 * 12


def test_the_model_of_a_plan_may_be_that_of_the_fit(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rf.fit(ONE, swept(1), known=KNOWN).save(tmp_path / "fit.json")
    head, design = PLAN.partition("[values]")[0], PLAN[PLAN.index("[design]") :]
    head = head.replace('model = "one-mode"', 'fit = "fit.json"').replace("known = {K = 8000.0, Ds = 8.0}", "")
    (tmp_path / "plan.toml").write_text(head + design, encoding="utf-8")
    assert main(["plan", str(tmp_path / "plan.toml"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["model"] == "one-mode"


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("1800]", "9000]", "unstable at 9000 rpm"),
        ("force_N = 3.0", "force_N = -3.0", "force_N is -3.0"),
        ("force_N = 3.0", 'force_N = 3.0\nforce_planes = "disk"', "unknown force plane of one-mode 'disk'"),
        ("force_N = 3.0", "", "needs a limit of the force"),
        ("count = 12", "steps = 12", "as a table is {from = 100"),
        ("[design]", "[desing]", "did you mean 'design'"),
        ("lam = 0.46", "lam = [0.5, 0.4]", "low below high"),
        ("lam = 0.46", "lam = true", "must be a number"),
        ("lam = 0.46", "", "no value for lam"),
        ("noise_um = 0.5", "", "give noise_um= or noise_share="),
        ('"one-mode"', '"one-node"', "did you mean 'one-mode'"),
        ('quantity = "lam"', 'quantity = "lamb"', "did you mean 'lam'"),
        ("[values]", 'fit = "no.json"\n[values]', "give the values of the rotor"),
        ("wanted = 0.001", 'tests = ["no.csv"]', "no.csv"),
        ("wanted = 0.001", "wanted = ", "TOML"),
        ('model = "one-mode"', "", "the key 'model' is missing"),
    ],
)
def test_a_wrong_file_is_one_sentence(
    old: str, new: str, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "plan.toml"
    file.write_text(PLAN.replace(old, new), encoding="utf-8")
    assert main(["plan", str(file), "--out", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1
    assert not (tmp_path / "out").exists()
