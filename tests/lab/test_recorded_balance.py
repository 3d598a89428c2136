"""Recordings with a weight beside those without one or with it elsewhere: the rotor's own unbalance drops out."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from plain import plain_fit
from sentences import refuses
from synthetic import TYPICAL

import rotorfit as rf

ROTOR = rf.models.TwoDisk()
VALUES = TYPICAL["two-disk"]
SLOW = rf.Instruments(sample_rate=2560.0)


def recorded(folder: Path, kind: str, **options: Any) -> list[rf.Recording]:
    """Runs whose own unbalance is as large as the weight."""
    files = rf.simulate_recordings(ROTOR, VALUES, folder, kind, instruments=SLOW, residual=1.5e-5, seed=5, **options)
    return [rf.read_recording(file, folder / "rig.toml") for file in files]


def agrees(test: rf.PerturbationTest) -> float:
    """Hold the fit to the truth, at 25 degrees between mark and holes; its reduced chi-squared."""
    fit = plain_fit(ROTOR, test, phase_offsets="common")
    assert fit.params["datum"].value * 57.29578 == pytest.approx(25.0, abs=0.2)
    for name in fit.model.parameter_names:
        parameter = fit.params[name]
        assert not parameter.vary or abs(parameter.value - VALUES[name]) < 4.5 * parameter.stderr, name
    assert fit.params["K2"].stderr < 0.01 * VALUES["K2"]
    return fit.redchi


def test_start_ups_beside_one_without_a_weight(tmp_path: Path) -> None:
    """Both planes count from the same run: its variance is in either, which leaves redchi two thirds of one."""
    records = recorded(tmp_path, "synchronous", duration=8.0, hole_deg=(0.0,), reference=True)
    test = rf.responses(records)
    assert test.runs == ("inboard-0 minus reference", "outboard-0 minus reference")
    assert 0.5 < agrees(test) < 0.85  # 500 numbers and more: three standard deviations are 0.19 of it


@pytest.mark.slow
def test_start_ups_with_weights_at_three_places(tmp_path: Path) -> None:
    records = recorded(tmp_path, "synchronous", duration=8.0, hole_deg=(0.0, 100.0, 220.0))
    assert 0.7 < agrees(rf.responses(records)) < 1.3


def test_balance_runs_at_steady_speeds_are_solved_for_the_influence_of_their_weights(tmp_path: Path) -> None:
    rpm = [900.0, 1400.0, 1700.0, 2500.0, 3300.0, 4200.0]
    records = recorded(tmp_path, "balance", speed_rpm=rpm, duration=3.0)
    test = rf.responses(records)
    assert len(test.runs) == 3 * len(rpm)
    assert set(test.force[[run.startswith("reference") for run in test.run]]) == {0}
    agrees(test)
    with refuses(ValueError):
        rf.responses(records[len(rpm)])
    with refuses(ValueError):
        rf.responses(records[: len(rpm)])


def test_a_perturbator_without_unbalance_is_refused(tmp_path: Path) -> None:
    files = rf.simulate_recordings(
        rf.models.OneMode(), TYPICAL["one-mode"], tmp_path, speed_rpm=900.0, duration=1.0, directions=["forward"],
        instruments=SLOW,
    )  # fmt: skip
    rig = tmp_path / "rig.toml"
    rig.write_text('rotation = "ccw"\nmr_kg_m = 0.0\n', encoding="utf-8")
    with refuses(ValueError):
        rf.responses(rf.read_recording(files[0], rig))
