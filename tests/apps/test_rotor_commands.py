"""Predictions and judgements by the command line: tables, JSON, refusals."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from judged_rotor import MODEL, SPEEDS, TRUE, exact
from sentences import hear
from synthetic import TYPICAL, circular_test, covering_frequencies, known_of

import rotorfit as rf
from rotorfit.apps.cli.main import main
from rotorfit.apps.study_files.folder import CONTENTS


def test_judge(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    exact().save(tmp_path / "fit.json")
    words = ["judge", str(tmp_path / "fit.json"), "--max-speed", "2800"]
    out = tmp_path / "out"
    assert main([*words, "--unbalance", "disk=20", "--cross-coupling", "disk=9000", "--out", str(out)]) == 0
    assert {"stability.csv", "stability.png", "summary.txt"} <= {file.name for file in out.iterdir()}
    assert "NOT MET" in capsys.readouterr().out
    assert main([*words, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["criteria"][0]["probability"] == 1
    assert main([*words, "--unbalance", "dsik=20"]) == 2
    hear(capsys.readouterr().err)
    assert main([*words, "--plane", "disk"]) == 2
    hear(capsys.readouterr().err)
    assert main([*words, "--unbalance", "20"]) == 2
    hear(capsys.readouterr().err)
    assert main([*words, "--cross-coupling", "disk=3kN/m"]) == 2
    hear(capsys.readouterr().err)
    with pytest.raises(SystemExit):
        main(["judge", str(tmp_path / "fit.json"), "--max-speed", "2800rpm"])
    hear(capsys.readouterr().err)
    assert main([*words, "--case", "worn: K0=0.6,D=0.5", "--json"]) == 0
    cases = {row["case"] for row in json.loads(capsys.readouterr().out)["criteria"]}
    assert cases == {"", "worn"}
    for wrong in ("K0=0.6", "worn:", "worn: K0"):
        assert main([*words, "--case", wrong]) == 2
        hear(capsys.readouterr().err)
    before = (tmp_path / "fit.json").read_bytes()
    (tmp_path / CONTENTS).write_text("fit.json\n", encoding="utf-8")  # the folder of results that holds the fit
    assert main([*words, "--out", str(tmp_path)]) == 2
    assert (tmp_path / "fit.json").read_bytes() == before
    hear(capsys.readouterr().err)


def test_a_rotor_known_to_have_no_stiffness_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    theta, w = MODEL.vector(TRUE | {"K": 0.0, "K0": 0.0}), np.linspace(40.0, 320.0, 30)
    test = circular_test(MODEL, theta, speeds=SPEEDS, frequency=np.r_[-w, w], noise=0.01, seed=1, sigma_known=True)
    rf.write(test, tmp_path / "free.csv")
    known = [word for name in ("K", "K0") for word in ("--known", f"{name}=0")]
    assert main(["fit", str(tmp_path / "free.csv"), "--model", "one-mode", "--planes", "disk", *known]) == 2
    hear(capsys.readouterr().err)


TWO_PLANES = rf.models.WhirlWhip()
KNOWN_STIFFNESS = known_of("whirl-whip", TYPICAL["whirl-whip"])


def swept(lines: int, seed: int) -> rf.PerturbationTest:
    theta, speeds = TWO_PLANES.vector(TYPICAL["whirl-whip"]), (100.0, 180.0)
    w = covering_frequencies(TWO_PLANES, theta, speeds, lines)
    return circular_test(TWO_PLANES, theta, speeds=speeds, frequency=w, noise=0.02, seed=seed, sigma_known=True)


def test_predict(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    fit = rf.fit(TWO_PLANES, swept(25, 0), known=KNOWN_STIFFNESS)
    fit.save(tmp_path / "fit.json")
    words = ["predict", str(tmp_path / "fit.json"), "--force-plane", "disk", "--plane", "journal"]
    out = tmp_path / "out"
    assert main([*words, "--speed", "1500", "--mr-g-mm", "30", "--out", str(out)]) == 0
    assert {"prediction.csv", "prediction.png", "summary.txt"} <= {file.name for file in out.iterdir()}
    capsys.readouterr()
    assert main([*words, "--speed", "1400,1500", "--synchronous", "--mr-g-mm", "30", "--json"]) == 0
    points = json.loads(capsys.readouterr().out)["points"]
    expected = fit.predict(None, np.array([1400.0, 1500.0]) * np.pi / 30, force_plane="disk", plane="journal", mr=3e-5)
    assert [p["amplitude_um"] for p in points] == pytest.approx((np.abs(expected.response) * 1e6).tolist(), rel=1e-9)
    assert main([*words, "--speed", "9000"]) == 2
    refused = capsys.readouterr().err
    assert "unstable at 9000 rpm" in refused
    assert f"below its threshold of {fit.threshold_speed().value * 30 / np.pi:.5g} rpm" in refused
    assert main([*words[:2], "--speed", "1500"]) == 2
    hear(capsys.readouterr().err)
    assert main([*words, "--speed", "1400,1500"]) == 2
    hear(capsys.readouterr().err)


def test_the_condition_of_a_fit_with_parameters_per_speed_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    fit = rf.fit(TWO_PLANES, swept(10, 3), known=KNOWN_STIFFNESS, per={"D": "speed_rpm"})
    fit.save(tmp_path / "fit.json")
    words = ["predict", str(tmp_path / "fit.json"), "--speed", "1500", "--force-plane", "disk", "--frequency", "1000"]
    assert main(words) == 2
    refused = capsys.readouterr().err
    assert "--at NAME=VALUE" in refused
    assert main(["judge", words[1]]) == 2
    hear(capsys.readouterr().err)
    speed = next(name for name in fit.var_names if name.startswith("D["))[len("D[speed_rpm=") : -1]
    assert main([*words, "--at", f"speed_rpm={speed}", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    expected = fit.predict(1000 * np.pi / 30, 1500 * np.pi / 30, force_plane="disk", at={"speed_rpm": float(speed)})
    assert found["points"][0]["amplitude_um"] == pytest.approx(1e6 * abs(expected.response[0]), rel=1e-9)
    assert main(["judge", words[1], "--at", f"speed_rpm={speed}"]) == 0
