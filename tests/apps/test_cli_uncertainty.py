"""Posteriors, profiles and the bootstrap from the command line: files, seeds, interruption, progress."""

from __future__ import annotations

import csv
import html
import json
import shlex
from pathlib import Path

import numpy as np
import pytest
from command_words import FIGURES, SAMPLED, TABLES, WHOLE, Run, refused
from sentences import refuses
from synthetic import circular_test

import rotorfit as rf
from rotorfit.apps.cli import main as cli
from rotorfit.apps.cli.answer import ProgressLine
from rotorfit.apps.study_files.folder import CHECKPOINT
from rotorfit.identify.fitting.causes.calibration import Calibration, calibration_of


@pytest.fixture
def small(tmp_path: Path) -> list[str]:
    """Words that fit a small test of one mode, which samples in a moment."""
    model = rf.models.OneMode()
    values = {"M": 1.2, "K": 8000.0, "Ds": 8.0, "K0": 9000.0, "D": 450.0, "lam": 0.46, "Mf": 0.4}
    w = np.r_[-300:-20:20.0, 20:300:20.0]
    test = circular_test(
        model, model.vector(values), speeds=(100.0, 180.0), frequency=w, noise=0.02, seed=3, sigma_known=True
    )
    (tmp_path / "data").mkdir()
    rf.write(test, tmp_path / "data" / "small.csv")
    return ["fit", str(tmp_path / "data" / "small.csv"), "--model", "one-mode", "--known", "K=8000,Ds=8"]


MORE = ["--sample", "--seed", "4", "--ess", "800", "--profile", "lam,threshold_speed", "--bootstrap", "20"]


def test_all_measures_of_uncertainty(run: Run, tmp_path: Path, small: list[str]) -> None:
    out = tmp_path / "out"
    code, text, err = run(*small, *MORE, "--out", out)
    assert (code, err) == (0, "")
    extras = SAMPLED | {"profiles.csv", "profile_lam.png", "profile_threshold_speed.png", "bootstrap.csv"}
    assert {p.name for p in out.iterdir()} == TABLES | FIGURES | WHOLE | extras
    fit = rf.load_fit(out / "fit.json")
    posterior = rf.load_posterior(out / "posterior.nc", fit)
    assert posterior.converged
    assert posterior.seed == 4
    for words in ("profile likelihoods", "parametric bootstrap: 20 simulated", "R-hat", "95 % of the posterior"):
        assert words in text
    page = (out / "report.html").read_text(encoding="utf-8")
    for words in ("split R-hat", "profile likelihood", "central 95 % of the estimates from 20 simulated tests"):
        assert words in page
    assert shlex.join(["rotorfit", *small, *MORE, "--out", str(out)]) in html.unescape(page)
    with (out / "bootstrap.csv").open(encoding="utf-8", newline="") as stream:
        head, *rows = list(csv.reader(stream))
    assert tuple(head) == fit.var_names
    assert len(rows) == 20


def test_the_same_seed_gives_the_same_json(run: Run, small: list[str]) -> None:
    code, first, err = run(*small, *MORE, "--json")
    assert (code, err) == (0, "")
    answer = json.loads(first)
    assert answer == json.loads(run(*small, *MORE, "--json")[1])
    low, high = answer["posterior"]["interval_95"]["lam"]
    lam = answer["parameters"]["lam"]
    assert low < lam["value"] < high
    # a posterior that is nearly normal, causes integrated out; those of one sign make an interval longer to one side
    whole = np.ptp(lam["interval_95"])
    assert high - low == pytest.approx(whole, rel=0.25)
    ends = answer["profiles"]["lam"]
    assert ends["upper"] - ends["lower"] == pytest.approx(whole, rel=0.25)  # likewise
    assert answer["bootstrap"]["failures"] == 0
    assert answer["bootstrap"]["stderr"]["lam"] == pytest.approx(lam["stderr"], rel=0.6)  # of 20 draws


def test_sampling_cut_short_is_no_success(run: Run, tmp_path: Path, small: list[str]) -> None:
    code, out, err = run(*small, "--sample", "--ess", "1e6", "--max-steps", "60", "--out", tmp_path / "out")
    assert code == cli.ExitCode.NOT_CONVERGED
    assert err.startswith("rotorfit: the posterior's sampling has not converged")
    assert "NOT CONVERGED" in out
    assert (
        "not converged" in (tmp_path / "out" / "report.html").read_text(encoding="utf-8").partition("<h2>Parameters")[0]
    )


def test_interrupted_sampling_goes_on(
    run: Run, tmp_path: Path, small: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "new" / "out"
    words = [*small, "--sample", "--seed", "4", "--ess", "30000", "--out", str(out), "--quiet"]

    def stop(self: ProgressLine, stage: str, done: float | None = None) -> None:
        if "effective samples" in stage:
            raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(ProgressLine, "__call__", stop)
        code, _, err = run(*words)
    checkpoint = out / CHECKPOINT
    assert (code, err) == (
        cli.ExitCode.INTERRUPTED,
        f"rotorfit: interrupted, the same command goes on from {checkpoint}\n",
    )
    assert list(out.iterdir()) == [checkpoint]
    assert [p.name for p in out.parent.iterdir()] == ["out"]
    assert "another" in refused(run(*words, "--start", "D=450", "--known", "Mf=0.41"))
    assert list(out.iterdir()) == [checkpoint]
    code, said, warned = run(*words)
    assert (code, said) == (0, "")
    assert all(line.startswith("rotorfit: warning: ") for line in warned.splitlines())
    assert {p.name for p in out.iterdir()} == TABLES | FIGURES | WHOLE | SAMPLED


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("--profile lamda", "did you mean 'lam'"),
        ("--calibration probe_gian=0.01", "did you mean 'probe_gain'"),
        ("--calibration mr=-0.01", "a standard uncertainty is zero or a positive number"),
        ("--profile K", "K is known here"),
        ("--ess 0", "argument --ess: 0 is not above zero"),
        ("--bootstrap many", "argument --bootstrap: 'many' is no whole number"),
        ("--seed -1", "argument --seed: -1 is below zero"),
        ("--max-steps 0", "argument --max-steps: at least 1"),
    ],
)
def test_bad_uncertainty_settings(run: Run, tmp_path: Path, small: list[str], words: str, expected: str) -> None:
    code, out, err = run(*small, *words.split(), "--sample", "--out", tmp_path / "out")
    assert (code, out) == (cli.ExitCode.BAD_INPUT, "")
    assert expected in err
    assert [p.name for p in tmp_path.iterdir()] == ["data"]


def test_progress_is_one_line_with_a_bar(capsys: pytest.CaptureFixture[str]) -> None:
    shown = ProgressLine(enabled=True)
    shown("reading")
    shown("sampling", 0.5)
    shown.close()
    err = capsys.readouterr().err
    assert "\n" not in err
    _, reading, sampling, end = err.split("\r\033[K")
    assert "#" not in reading
    assert "[############            ]  50 %  sampling ..." in sampling
    assert end == ""
    ProgressLine(enabled=False)("nothing", 1.0)
    assert capsys.readouterr().err == ""


@pytest.mark.usefixtures("sketched")
def test_studies_and_reports_carry_a_calibration(tmp_path, rig_fit):
    from rotorfit.apps.study_files.study import Study
    from rotorfit.apps.study_files.study_file import read_study

    file = tmp_path / "study.toml"
    file.write_text(
        'files = ["rig.csv"]\nmodel = "whirl-whip"\ncalibration = {probe_gain = {disk = 0.01}, mr = 0.005}\n',
        encoding="utf-8",
    )
    study = read_study(file)
    assert isinstance(study, Study)
    assert calibration_of(study.calibration) == Calibration(probe_gain={"disk": 0.01}, mr=0.005)
    assert calibration_of({}) is None
    with refuses(ValueError):
        calibration_of({"probegain": 0.01})
    calibration = rf.Calibration(probe_gain=0.01)
    fit = rf.fit(rig_fit.model, rig_fit.experiments, known=rig_fit.settings.known, calibration=calibration)
    rf.write_report(fit, tmp_path / "report.html")
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "GUM type A" in text
    assert "--calibration probe_gain=0.01" in text
    assert "calibration=rf.Calibration(probe_gain=0.01" in text
