"""Campaigns by the command line: what it prints and writes, runs that say nothing, the report."""

from __future__ import annotations

import csv
import json
from dataclasses import replace

import numpy as np
import pytest
from command_words import refused, toml_file
from seal_campaigns import KNOWN, joined, seal_campaign, truth_at
from sentences import hear, refuses
from synthetic import circular_test

import rotorfit as rf
from rotorfit.apps.cli.main import main
from rotorfit.apps.study_files.folder import CONTENTS
from rotorfit.models import OneMode
from rotorfit.studies.campaigns.trends import common_middle


@pytest.fixture(scope="module")
def small():
    return seal_campaign(20)


@pytest.fixture(scope="module")
def fitted(small):
    return rf.campaign(OneMode(), small[0], known=KNOWN)


# ---- command line -------------------------------------------------------------------------------------------------


def test_command_line(tmp_path, capsys, small, fitted):
    table, _ = small
    file, out = tmp_path / "seal.csv", tmp_path / "results"
    rf.write(table, file)
    study = toml_file(tmp_path / "study.toml", files=["seal.csv"], model="one-mode", known=KNOWN)
    words = ["campaign", str(study), "--against", "pressure_psi", "--by", "inlet"]
    assert main([*words, "--out", str(out)]) == 0
    printed = capsys.readouterr().out
    assert "radial - anti-swirl at pressure_psi" in printed
    assert {path.name for path in out.iterdir()} == {"runs.csv", "summary.txt", "report.html", "trends.png", CONTENTS}
    rows = list(csv.DictReader((out / "runs.csv").read_text().splitlines()))
    assert [row["run"] for row in rows] == [run.name for run in fitted.runs]
    for row, run in zip(rows, fitted.runs, strict=True):
        # The file holds rounded readings.
        assert float(row["lam"]) == pytest.approx(run.params["lam"].value, abs=0.05 * run.params["lam"].stderr)
    assert main([*words, "--json", "--follow", "lam"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert len(result["runs"]) == 20
    assert [trend["group"] for trend in result["trends"]] == ["anti-swirl", "radial"]
    bare = toml_file(tmp_path / "bare.toml", model="one-mode", known={"K": 8000, "Ds": 8})
    assert main(["campaign", str(bare), str(file), "--shared", "M", "--quiet"]) == 0
    assert capsys.readouterr().out == ""
    assert main([*words, "--jobs", "2", "--quiet"]) == 0


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--against", "pressure"], "did you mean 'pressure_psi'"),
        (["--by", "inlet"], "say --against what"),
        (["--shared", "M", "--against", "inlet"], "M cannot be known and shared"),
        (["--split", "day"], "no attribute 'day'"),
    ],
)
def test_command_line_mistakes(tmp_path, capsys, small, words, message):
    file = tmp_path / "seal.csv"
    rf.write(small[0].select(small[0].run == "r00"), file)
    study = toml_file(tmp_path / "study.toml", model="one-mode", known=KNOWN)
    assert main(["campaign", str(study), str(file), *words]) == 2
    assert message in capsys.readouterr().err


def test_no_run_that_can_be_fitted_is_bad_input(tmp_path, capsys, small):
    """Planes of another name spoil every run alike: the reason is said, and nothing is written."""
    file, out = tmp_path / "seal.csv", tmp_path / "results"
    rf.write(small[0].select(np.isin(small[0].run, ["r00", "r01"])), file)
    study = toml_file(tmp_path / "study.toml", model="one-mode", planes=["seal"], known=KNOWN, out="results")
    assert main(["campaign", str(study), str(file), "--against", "pressure_psi"]) == 2
    hear(capsys.readouterr().err)
    assert not out.exists()


def test_trends_that_no_run_resolves_leave_no_picture(tmp_path, capsys, small):
    """With K free only K + K0 is seen: K0 has no value in any run."""
    file, out = tmp_path / "seal.csv", tmp_path / "results"
    rf.write(small[0].select(np.isin(small[0].run, ["r00", "r01"])), file)
    study = toml_file(tmp_path / "study.toml", model="one-mode", known={"M": 1.2, "Ds": 8}, out="results")
    assert main(["campaign", str(study), str(file), "--against", "pressure_psi", "--follow", "K0"]) == 0
    assert "no run has a resolved value" in capsys.readouterr().out
    assert {path.name for path in out.iterdir()} == {"runs.csv", "summary.txt", "report.html", CONTENTS}


def test_command_line_tells_of_failed_runs(tmp_path, capsys, small):
    table, _ = small
    keep = ~((table.run == "r01") & (np.arange(len(table)) > np.flatnonzero(table.run == "r01")[0]))
    file = tmp_path / "seal.csv"
    rf.write(table.select(keep & np.isin(table.run, ["r00", "r01"])), file)
    study = toml_file(tmp_path / "study.toml", model="one-mode", known=KNOWN)
    assert main(["campaign", str(study), str(file)]) == 1
    hear(capsys.readouterr().err)


@pytest.mark.parametrize("keys", [{"sample": True}, {"per": {"K0": "run"}}, {"refine": True}])
def test_keys_of_a_single_fit_are_refused(tmp_path, run, small, keys):
    """What a campaign would not do is not left out in silence."""
    rf.write(small[0].select(small[0].run == "r00"), tmp_path / "seal.csv")
    study = toml_file(tmp_path / "study.toml", model="one-mode", known=KNOWN, **keys)
    hear(refused(run("campaign", study, tmp_path / "seal.csv")))


def test_files_are_read_as_the_patterns_of_the_study_say(tmp_path, run, small):
    rf.write(small[0].select(np.isin(small[0].run, ["r00", "r01", "r02"])), tmp_path / "seal.csv")
    patterns = [{"path": "s*.csv", "exclude": {"run": ["r01"]}}]
    study = toml_file(tmp_path / "study.toml", model="one-mode", known=KNOWN, files=patterns)
    code, out, _ = run("campaign", study, tmp_path / "seal.csv", "--json")
    assert (code, [one["run"] for one in json.loads(out)["runs"]]) == (0, ["r00", "r02"])
    (tmp_path / "volts.h5").write_bytes(b"")
    hear(refused(run("campaign", study, tmp_path / "volts.h5")))


# ---- runs that say nothing, several conditions, the report ----------------------------------------------------------


def with_a_dead_run(table):
    """The first run's readings replaced by noise of the size that its sigma says."""
    rng = np.random.default_rng(5)
    dead = table.run == "r00"
    noise = table.sigma * (rng.normal(size=len(table)) + 1j * rng.normal(size=len(table)))
    return replace(table, response=np.where(dead, noise, table.response))


def test_a_dead_run_is_flagged_and_flattens_nothing(tmp_path, capsys, small, fitted):
    """A probe that was not connected gave D = -6759 beside 300 to 620 N s/m, and a figure of one point and a line."""
    table, _ = small
    found = rf.campaign(OneMode(), with_a_dead_run(table), known=KNOWN)
    assert [run.name for run in found.runs if run.silent] == ["r00"]
    assert not any(run.silent for run in fitted.runs)
    assert "r00: says nothing" in found.summary()
    assert all("r00" not in trend.runs for trend in found.trends(against="pressure_psi"))
    axis = found.plot.trends("D", against="pressure_psi").axes[0]
    assert 200 < axis.get_ylim()[0] < axis.get_ylim()[1] < 800
    file = tmp_path / "seal.csv"
    rf.write(with_a_dead_run(table), file)
    main(["campaign", str(toml_file(tmp_path / "study.toml", model="one-mode", known=KNOWN)), str(file)])
    hear(capsys.readouterr().err)


@pytest.mark.slow
def test_noise_is_told_from_motion_whatever_the_seed():
    """Fifteen dead runs, and fifteen forced so weakly that the rms reading is only four times its noise."""
    model = OneMode()
    theta = model.vector(truth_at(40.0, "radial"))
    half = np.linspace(2.0, 300.0, 50)
    w = np.r_[-half[::-1], half]
    test = circular_test(model, theta, speeds=(100.0,), frequency=w, sigma_known=True, noise=0.01)
    scale = 1 / np.sqrt(np.mean(np.abs(test.response / test.sigma) ** 2))
    flagged = {"dead": 0, "weak": 0}
    for seed in range(15):
        rng = np.random.default_rng(seed)
        noise = test.sigma * (rng.normal(size=len(test)) + 1j * rng.normal(size=len(test)))
        for name, size in (("dead", 0.0), ("weak", 4.0)):
            run = replace(test, response=noise + size * scale * test.response, force=4 * scale * test.force)
            flagged[name] += rf.campaign(OneMode(), run, known=KNOWN).runs[0].silent
    # By chance, chi-squared falls by 1 to 5 a parameter; by signals of the noise's own size, which a search from a
    # start of noise does not always find, by some 50; by these, by 800.
    assert flagged == {"dead": 15, "weak": 0}


def test_two_conditions_are_told_apart():
    """D rises with pressure and falls with temperature, which rises with it: alone, either slope is wrong."""
    model, rng = OneMode(), np.random.default_rng(2)
    half = np.linspace(2.0, 300.0, 30)
    w = np.r_[-half[::-1], half]
    parts = []
    for number in range(14):
        pressure = float(rng.uniform(5, 80))
        oil = 25.0 + 0.3 * pressure + rng.normal(0, 5)
        values = KNOWN | {"K0": 4000.0, "D": 500.0 + 4 * pressure - 6 * oil, "lam": 0.45, "Mf": 0.4}
        test = circular_test(
            model, model.vector(values), speeds=(100.0,), frequency=w, noise=0.01, seed=number, sigma_known=True
        )
        count = len(test)
        attributes = {"pressure_psi": np.full(count, pressure), "oil_C": np.full(count, oil)}
        parts.append(replace(test, run=np.full(count, f"r{number:02d}"), attributes=attributes))
    found = rf.campaign(OneMode(), joined(parts), known=KNOWN)
    pressure, oil = found.trends("D", against=("pressure_psi", "oil_C"))
    assert abs(pressure.slope.value - 4) < 4 * pressure.slope.stderr < 1
    assert abs(oil.slope.value + 6) < 4 * oil.slope.stderr < 2
    (alone,) = found.trends("D", against="pressure_psi")
    assert abs(alone.slope.value - 4) > 5 * pressure.slope.stderr
    # The points of a panel are what is left for its attribute: they lie on its line.
    assert pressure.scatter < 3
    line = np.array([pressure.at(x).value for x in pressure.x])
    assert np.sqrt(np.mean(((pressure.value - line) / pressure.stderr) ** 2)) < 2
    assert "each with the others held" in found.summary("D", against=["pressure_psi", "oil_C"])
    assert len(found.plot.trends(["D", "lam"], against=["pressure_psi", "oil_C"]).axes) == 4
    with refuses(ValueError):
        rf.campaign(OneMode(), joined(parts[:2]), known=KNOWN).trends("D", against=("pressure_psi", "oil_C"))


def test_report_of_a_campaign(tmp_path, small):
    table, _ = small
    found = rf.campaign(OneMode(), with_a_dead_run(table), known=KNOWN)
    text = rf.write_campaign_report(found, tmp_path / "c.html", against="pressure_psi", by="inlet").read_text()
    assert "19 of 20 runs give an answer" in text
    assert "As pressure_psi grows, K0 and D rise; lam (anti-swirl) falls; lam (radial) stays." in text  # as simulated
    first = text[: text.index("<h2>Trends")]
    for t in found.trends(["K0", "lam"], against="pressure_psi", by="inlet"):
        shown = t.at(common_middle(found.trends(t.parameter, against="pressure_psi", by="inlet"))).shown()
        assert f"<b>{shown.value}</b>\u00a0±\u00a0{shown.error}" in first  # the digits of the summary
    assert "R00: says nothing" in text
    assert "data:image/png" in text
    for name in ("anti-swirl", "pressure_psi", "r19"):
        assert name in text


def test_errors_of_the_check_say_which_file(tmp_path, capsys, small):
    table, _ = small
    for run in ("r00", "r02"):
        part = table.select(table.run == run)
        rf.write(part if run == "r00" else replace(part, force=-part.force), tmp_path / f"{run}.csv")
    study = toml_file(tmp_path / "study.toml", model="one-mode", known=KNOWN, files=["r00.csv", "r02.csv"])
    assert main(["campaign", str(study), "--quiet"]) == 1
    errors = capsys.readouterr().err
    assert "the check of the data calls these an error: r02.csv: " in errors
    assert "r00.csv: " not in errors


def test_a_file_given_twice_is_warned_of(tmp_path, capsys, small):
    table, _ = small
    file = tmp_path / "seal.csv"
    rf.write(table.select(np.isin(table.run, ["r00", "r01", "r02", "r03"])), file)
    study = toml_file(tmp_path / "study.toml", model="one-mode", known=KNOWN, files=["seal.csv", "seal.csv"])
    words = ["campaign", str(study), "--against", "pressure_psi"]
    assert main(words) == 0
    warned = (
        "warning: seal.csv: Copies of runs, to the last digit: r00 repeats r00 of seal.csv, r01 repeats r01 of seal.csv"
    )
    assert warned in capsys.readouterr().out
    assert main([*words, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["warnings"][0].startswith(warned)
    assert main(["info", str(file), str(file)]) == 0
    assert "check: warning [duplicate] Copies of runs" in " ".join(capsys.readouterr().out.split())


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--cluster", "host:8786"], "--cluster takes local:N or the address of a scheduler"),
        (["--cluster", "local:0"], "from 1"),
        (["--cluster", "local:2", "--jobs", "2"], "give one of them"),
    ],
)
def test_an_address_that_is_none_is_one_sentence(words, said, capsys, tmp_path):
    table, _ = seal_campaign(2)
    rf.write(table, tmp_path / "seal.csv")
    file = str(tmp_path / "seal.csv")
    study = toml_file(tmp_path / "study.toml", model="one-mode")
    commands = ["campaign", str(study), file], ["fit", file, "--model", "one-mode"]
    for command in (*commands, ["vectors", file, "--out", str(tmp_path / "out.csv")]):
        assert main([*command, *words]) == 2
        assert said in capsys.readouterr().err
