"""Data with a slip that the check calls an error: the fit ends, says so first, and the exit code is not zero."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from linear_tests import linear_test
from plain import summary_words
from sentences import warns
from slips import (
    exchanged,
    exchanged_runs,
    in_decibels,
    in_radians,
    lag_as_lead,
    renamed,
    thinned,
    told_as_constant,
    told_as_unbalance,
    turned,
)
from slow_cases import slow_but
from synthetic import TYPICAL

import rotorfit as rf
from rotorfit.apps.cli import main as cli
from rotorfit.identify.diagnosis.findings import explained
from rotorfit.lab.data.experiments import PerturbationTest

Slip = Callable[[PerturbationTest], PerturbationTest]

SLIPS: dict[str, Slip] = {
    "lag entered as lead": lag_as_lead,
    "exchanged probes": exchanged,
    "negative forces": lambda test: replace(test, force=-test.force),
    "45-degree probes": lambda test: turned(test, 45.0),
    "unsigned frequencies": lambda test: replace(test, frequency=np.abs(test.frequency)),
    "unbalance told as constant": told_as_constant,
    "speeds exchanged": lambda test: renamed(test, "speed"),
}

ONLY_A_FIT_TELLS: dict[str, tuple[Slip, str, str]] = {
    "unbalance told as constant": (told_as_constant, "unbalance-as-constant", "the forces are those of an unbalance"),
    "constant told as unbalance": (told_as_unbalance, "constant-as-unbalance", "the forces are constant"),
    "speeds exchanged": (SLIPS["speeds exchanged"], "speeds-exchanged", "1000 and 2000 rpm"),
    "probes' planes exchanged": (lambda test: renamed(test, "plane"), "planes-exchanged", "of the readings"),
    "forced planes exchanged": (lambda test: renamed(test, "force_plane"), "planes-exchanged", "of the forces"),
    "weight holes counted from elsewhere": (
        lambda test: replace(test, force=test.force * np.exp(0.8j)),
        "phase-zeros-differ",
        "one angle off",
    ),
    "probes at 45 degrees": (lambda test: turned(test, 45.0), "probes-turned", "sit 45 degrees"),
    "probes at -90 degrees": (lambda test: turned(test, -90.0), "probes-turned", "sit -90 degrees"),
    "speeds in Hz": (lambda test: replace(test, speed=test.speed / 60), "speed-unit", "in Hz and read as rpm"),
    "force phases in radians": (lambda test: in_radians(test, "force"), "phases-in-radians", "of the forces"),
    "runs exchanged": (
        lambda test: exchanged_runs(test, "disk-bwd-1000", "disk-bwd-2000"),
        "runs-exchanged",
        "disk-bwd-1000 and disk-bwd-2000",
    ),
    "levels read as um": (lambda test: in_decibels(test, 1e-6), "levels-in-decibels", "read as um"),
    "levels read as mil": (lambda test: in_decibels(test, 25.4e-6), "levels-in-decibels", "read as mil"),
    "phases in radians": (lambda test: in_radians(test, "response"), "phases-in-radians", "of the readings"),
}


@pytest.fixture(scope="module")
def rig() -> PerturbationTest:
    return thinned(rf.datasets.rig_open(), 4)


@pytest.mark.usefixtures("sketched")
@pytest.mark.parametrize("slip", slow_but(SLIPS, *list(SLIPS)[::9]))
def test_the_verdict_names_the_error_first_and_the_exit_code_is_one(
    slip: str,
    rig: PerturbationTest,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    rf.write(SLIPS[slip](rig), tmp_path / "t.csv")
    out = tmp_path / "out"
    words = ["fit", tmp_path / "t.csv", "--model", "whirl-whip", "--known", "K3=6000", "--out", out]
    assert cli.main([str(word) for word in words]) == 1
    assert capsys.readouterr().err.startswith("rotorfit: the check of the data calls these an error: ")
    assert (out / "summary.txt").read_text(encoding="utf-8").startswith("ERROR in the data")
    report = (out / "report.html").read_text(encoding="utf-8")
    headline = re.search('class="headline">([^<]*)', report)
    assert headline is not None
    assert headline[1].startswith("The data have an error")
    assert "stable" not in headline[1]
    first = re.search(r'class="warnings"><li>([^<]*)', report)
    assert first is not None
    assert first[1].startswith("Error in the data: ")


def test_a_summary_in_python_begins_with_the_errors_of_the_data(rig: PerturbationTest) -> None:
    fit = rf.fit(rf.models.WhirlWhip(), lag_as_lead(rig), known={"K3": 6000.0})
    assert [finding.code for finding in fit.findings if finding.origin == "reading"] == [
        "lag-as-lead",
        "wrong-direction",
    ]
    assert fit.summary().startswith("ERROR in the data")
    again = rf.fit(rf.models.WhirlWhip(), rig, known={"K3": 6000.0})
    assert again.warnings == ()
    assert "ERROR" not in summary_words(again)


@pytest.mark.slow
def test_findings_of_a_refined_fit_are_those_of_the_fit_before_and_of_a_saved_one(
    rig: PerturbationTest, tmp_path: Path
) -> None:
    """Blocks of a richer model may follow an error of the data, which is an error all the same."""
    fit = rf.fit(rf.models.WhirlWhip(), told_as_constant(thinned(rig, 2)), known={"K3": 6000.0})
    for found in (fit, rf.refine(fit).best):
        assert [finding.code for finding in found.findings if finding.origin == "reading"] == ["unbalance-as-constant"]
    fit.save(tmp_path / "fit.json")
    assert rf.load_fit(tmp_path / "fit.json").findings == fit.findings


def test_reading_warns_of_errors_that_the_data_show_and_the_command_line_says_them_once(
    rig: PerturbationTest, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rf.write(lag_as_lead(rig), tmp_path / "t.csv")
    with warns(rf.DataWarning) as caught:
        test = rf.read(tmp_path / "t.csv")
    assert [warning.filename for warning in caught] == [__file__]
    rf.fit(rf.models.WhirlWhip(), test, known={"K3": 6000.0})  # without a warning, which would be an error here
    assert cli.main(["info", str(tmp_path / "t.csv")]) == 1
    printed = capsys.readouterr()
    assert printed.out.count("The rotor answers mostly") == 1
    assert not printed.err


@pytest.mark.parametrize("slip", slow_but(ONLY_A_FIT_TELLS, "force phases in radians", "unbalance told as constant"))
def test_a_slip_that_only_a_fit_gives_away_is_named(slip: str, rig: PerturbationTest) -> None:
    """The rig is a shaft of finite elements, which the model is not; fits of it as it is say nothing (above)."""
    make, code, words = ONLY_A_FIT_TELLS[slip]
    fit = rf.fit(rf.models.WhirlWhip(), make(thinned(rig, 2)), known={"K3": 6000.0})
    assert fit.findings[0].severity == "error"
    (found,) = [finding for finding in fit.findings if finding.code == code and words in finding.message]
    assert found.remedy


@pytest.mark.parametrize("model", [rf.models.WhirlWhip(), rf.models.OneMode()])
def test_a_model_that_is_wrong_is_no_slip(model: rf.models.RotorModel, rig: PerturbationTest) -> None:
    """A second mode that the model lacks leaves most of the response, and no exchange of labels explains it."""
    test = thinned(rig, 2)
    if len(model.planes) == 1:
        test = test.select((test.plane == "journal") & (test.force_plane == "journal"))
        assert rf.fit(model, test).redchi > 100
    else:  # a rotor of three masses, of which two are known of
        test = replace(test, force=test.force * (1 + 20 * (test.frequency / 500.0) ** 2 * (test.force_plane == "disk")))
    fit = rf.fit(model, test, known={"K3": 6000.0} if len(model.planes) == 2 else {})
    assert not explained(fit)


def test_what_data_leave_open_is_no_sign_of_wrong_signs() -> None:
    """Start-ups tell D and lam only together: that the values shown would be unstable says nothing of the signs."""
    model, w = rf.models.OneMode(), np.linspace(60.0, 300.0, 60)
    z = [model.receptance(model.vector(TYPICAL["one-mode"]), np.array([v]), v)[0, 0, 0] for v in w]
    noise = 1e-9 * np.random.default_rng(4).normal(size=(2, w.size))
    test = rf.perturbation_test(
        run="up",
        speed=w,
        frequency=w,
        force_plane="journal",
        force=1.0,
        plane="journal",
        direction="z",
        response=np.array(z) + noise[0] + 1j * noise[1],
        sigma=1e-9,
    )
    fit = rf.fit(model, test, known={"K": 0.0, "Ds": 0.0}, bounds={"lam": (1.2, 2.0)})
    unstable = [warning for warning in fit.warnings if "the fitted rotor is unstable" in warning]
    assert unstable
    assert all("leave M, D, lam, Mf open" in warning for warning in unstable), unstable


def test_a_rotor_unstable_from_standstill_has_no_whirl_ratio() -> None:
    """Negative damping that does not turn: the onset speed is zero, and nothing is divided by it."""
    model = rf.models.OneMode()
    values = TYPICAL["one-mode"] | {"D": -TYPICAL["one-mode"]["D"], "Ds": 0.0, "K": 0.0}
    test = linear_test(
        model, model.vector(values), speed=100.0, frequency=np.linspace(20.0, 400.0, 60), along="x", noise=1e-3
    )
    fit = rf.fit(model, test, known={"K": 0.0, "Ds": 0.0})
    assert fit.threshold_speed().value == 0
    assert np.isnan(fit.whirl_ratio())
    assert "unstable from standstill on" in summary_words(fit)


@pytest.mark.parametrize("degrees", slow_but([-60.0, 120.0, 170.0], 120.0))
def test_forces_from_another_zero_are_no_error_where_the_fit_finds_it(tmp_path: Path, degrees: float) -> None:
    """Without the zero the sign of damping, and of inertia, seems wrong; with it nothing is."""
    rig = thinned(rf.datasets.rig_open(), 3)
    wrong = replace(rig, force=rig.force * np.exp(-1j * np.radians(degrees)))
    assert [f.code for f in rf.check(wrong) if f.severity == "error"] == ["negative-damping"]
    path, out = tmp_path / "rig.csv", tmp_path / "out"
    rf.write(wrong, path)
    words = ["fit", str(path), "--model", "whirl-whip", "--known", "K3=6000", "--phase-offsets", "common"]
    assert cli.main([*words, "--no-figures", "--out", str(out), "--quiet"]) == 0
    fit = rf.load_fit(out / "fit.json")
    assert np.degrees(fit.params["datum"].value) % 360 == pytest.approx(degrees % 360, abs=1.0)
    assert not [finding for finding in fit.findings if finding.severity == "error"]
    assert "can be relied on" not in (out / "summary.txt").read_text(encoding="utf-8")
    report = rf.write_report(fit, tmp_path / "report.html").read_text(encoding="utf-8")
    assert "Damping would be negative" not in report


def test_forces_half_a_turn_off_in_one_plane_are_told_from_a_conjugated_frf(rig: PerturbationTest) -> None:
    off = replace(rig, force=np.where(rig.force_plane == "journal", -rig.force, rig.force))
    told = next(finding.message for finding in rf.check(off) if finding.code == "negative-damping")
    assert "and so would stiffness: phases are half a turn off" in told
    conjugated = next(finding.message for finding in rf.check(told_by_one_probe(rig)) if finding.code == "conjugated")
    assert "half a turn" not in conjugated


@pytest.mark.parametrize("part", [0.3, 0.9])
@pytest.mark.parametrize(("plane", "side"), [("disk", 1), ("journal", 1), ("journal", -1)])
def test_a_pair_of_probes_inverted_from_some_frequency_on(plane: str, part: float, side: int) -> None:
    rig = rf.datasets.rig_open()
    w = np.abs(rig.frequency)
    limit = part * w.max()
    wrong = replace(rig, response=np.where((rig.plane == plane) & (side * w > side * limit), -1, 1) * rig.response)
    found = {finding.code: finding.message for finding in rf.check(wrong)}
    assert "conjugated" not in found
    words = rf"At {plane} the readings turn by half a turn between ([\d.]+) and ([\d.]+) rpm"
    told = re.search(words, found["half-turn"])
    assert told is not None
    low, high = (float(end) for end in told.groups())
    assert low <= limit * 30 / np.pi * (1 + 1e-3)  # as it is printed
    assert high >= limit * 30 / np.pi * (1 - 1e-3)


def test_what_turns_both_probes_alike_is_no_conjugated_frf(rig: PerturbationTest) -> None:
    """A low pass in both channels of a plane, and a force told 60 degrees off: damping seems negative."""
    w = np.abs(rig.frequency)
    low_pass = np.where(rig.plane == "disk", 1 / (1 + 2j * w / w.max()) ** 2, 1)
    filtered = replace(rig, response=low_pass * rig.response)
    for wrong in (filtered, replace(rig, force=rig.force * np.exp(1j * np.pi / 3))):
        told = {finding.code: finding.message for finding in rf.check(wrong)}
        assert "phases of lag alone are not the cause" in told["negative-damping"]
        assert not {"conjugated", "half-turn"} & set(told)


@pytest.mark.parametrize("damping", [1e-4, 1e-2])
def test_resonances_and_antiresonances_between_two_lines_are_no_half_turn(damping: float) -> None:
    """Two disks hardly damped: responses change their sign from line to line where they pass zero, and at poles."""
    model = rf.models.TwoDisk()
    values = {"M1": 1.0, "M2": 1.5, "K1": 2e4, "K2": 3e4, "K3": 1e4, "D11": damping, "D22": damping}
    theta = model.vector(values | {"D12": 0.0, "D21": 0.0, "beta1": 0.0, "beta2": 0.0})
    rng = np.random.default_rng(3)
    for lines in rng.integers(20, 200, 30).tolist():
        w = np.concatenate([-(grid := np.sort(rng.uniform(20, 400, lines))), grid])
        for forced, column in (("inboard", 0), ("outboard", 1)):
            z = model.receptance(theta, w, 100.0)[:, :, column].T.ravel()
            test = rf.perturbation_test(
                run="a", speed=100.0, frequency=np.tile(w, 2), force_plane=forced, force=1.0,
                plane=np.repeat(["inboard", "outboard"], w.size), direction="z", response=z,
            )  # fmt: skip
            assert "half-turn" not in [finding.code for finding in rf.check(test)]


def told_by_one_probe(test: PerturbationTest) -> PerturbationTest:
    """The x probes alone, phases of their FRF given as lag: no orbit gives it away."""
    return replace(test, response=test.response.conj(), force=test.force.conj()).select(test.direction == "x")


def test_blocks_of_structure_do_not_follow_an_error_unless_asked(
    tmp_path: Path, run: Callable[..., tuple[int, str, str]], rig: PerturbationTest
) -> None:
    file = tmp_path / "slip.csv"
    few = thinned(rig, 2)
    rf.write(replace(few, response=np.where(few.run == few.runs[2], 2.0, 1.0) * few.response), file)
    words = ("fit", file, "--model", "whirl-whip", "--known", "K3=6000", "--refine", "--no-causes")
    _, out, err = run(*words)
    assert "structural refinement" not in out
    assert "not refined" in err
    _, out, err = run(*words, "--despite-errors")
    assert "structural refinement" in out
    assert "not refined" not in err
