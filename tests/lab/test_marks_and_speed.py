"""Marks that are no two levels, wheels that are sampled too slowly, and speeds of shafts that have no mark."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest
from recorded import ATTRIBUTES, RATE, SETUP, perturbator_angle, shaft_angle, volts, write_hdf5

import rotorfit as rf
from rotorfit.apps.cli.main import main
from rotorfit.estimators.signals.pulses import find_edges, find_levels
from rotorfit.lab.data.experiments import PerturbationTest

CHANNELS = volts(4.0)
TIME = np.arange(CHANNELS["disk_X"].size) / RATE
UNMARKED = {name: values for name, values in CHANNELS.items() if name != "keyphasor_shaft"}


def unmarked(folder: Path, speed: float | None, name: str = "a.h5") -> rf.Recording:
    said = {key: value for key, value in ATTRIBUTES.items() if key != "speed_rpm"}
    return rf.read_recording(
        write_hdf5(folder / name, UNMARKED, said if speed is None else {**said, "speed_rpm": speed})
    )


@pytest.mark.parametrize("speed", [1200.0, -1200.0])
@pytest.mark.parametrize("turns", [None, 24])
def test_the_speed_that_is_said_is_that_of_a_shaft_without_a_mark(
    tmp_path: Path, speed: float, turns: int | None
) -> None:
    test = rf.responses(unmarked(tmp_path, speed), turns=turns)
    assert isinstance(test, PerturbationTest)
    np.testing.assert_allclose(test.speed, 1200 * np.pi / 30)
    if turns is None:
        order = test.frequency / test.speed
        assert np.abs(order - np.maximum(np.round(order), 1)).min() > 0.01  # the shaft's own motion is in no line


def test_the_speed_of_the_setup_goes_before_that_of_the_file(tmp_path: Path) -> None:
    setup = tmp_path / "rig.toml"
    setup.write_text("speed_rpm = 1300.0\n", encoding="utf-8")
    record = rf.read_recording(unmarked(tmp_path, 1200.0).path, setup)
    np.testing.assert_allclose(rf.responses(record).speed, 1300 * np.pi / 30)
    assert [finding.code for finding in record.findings if finding.severity == "warning"] == ["setup-contradicts-file"]


def test_without_mark_and_speed_nothing_is_taken_for_granted(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"how fast the shaft turns: name the channel .*speed_rpm = 0.0 for a rotor"):
        rf.responses(unmarked(tmp_path, None))
    assert rf.responses(unmarked(tmp_path, 0.0, "b.h5")).speed.max() == 0


# ---- magnetic pickups --------------------------------------------------------------------------------------------


def pickup(angle: np.ndarray, speed: np.ndarray, *, per_turn: int = 1, noise: float = 0.02) -> np.ndarray:
    """Voltage of a magnetic pickup: up, through zero at the mark and down, the larger the faster."""
    away = (angle * per_turn / (2 * np.pi) + 0.5) % 1 - 0.5
    shape = -away / 0.05 * np.exp(-((away / 0.05) ** 2))
    return 0.05 * speed * shape + np.random.default_rng(4).normal(size=angle.size) * noise


@pytest.mark.parametrize("turned", [1.0, -1.0])
@pytest.mark.parametrize("offset", [0.0, 2.5])
def test_pickups_are_counted_where_they_cross_the_level(turned: float, offset: float) -> None:
    rate = 20_000.0
    t = np.arange(80_000) / rate
    angle, speed = perturbator_angle(t), 2 * np.pi * (5 + 10 * t)
    voltage = turned * pickup(angle, speed) + offset
    levels = find_levels(voltage, edge="falling" if turned > 0 else "rising", level=offset)
    found = find_edges([voltage[:30_000], voltage[30_000:]], levels) / rate
    turns = np.arange(1, 100)
    true = (-5 + np.sqrt(25 + 20 * turns)) / 10
    true = true[true < t[-1]]
    assert found.size == true.size
    assert np.abs(found - true).max() * rate < 1.5


def test_a_smooth_wheel_and_a_level_off_zero() -> None:
    t = np.arange(4000) / 1000.0
    voltage = 3 * np.sin(2 * np.pi * 7.3 * t) + np.random.default_rng(1).normal(size=t.size) * 0.01
    levels = find_levels(voltage, edge="rising", level=1.5)
    found = find_edges([voltage], levels) / 1000
    np.testing.assert_allclose(found, (np.arange(found.size) + 1 / 12) / 7.3, atol=2e-3)
    assert found.size == 30


def test_a_level_that_nothing_crosses_is_said() -> None:
    noise = np.random.default_rng(1).normal(size=4000) * 0.02
    for edge, level, words in (
        ("falling", 0.0, "no pulses cross the level of 0 V clear of the noise"),
        ("falling", 9.0, "no pulses cross the level of 9 V"),
        ("", None, "magnetic pickup, whose pulses go to both sides"),
    ):
        with pytest.raises(ValueError, match=words):
            find_levels(noise, edge=edge, level=level)


# ---- wheels ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("teeth", "said", "words"),
    [
        (150, 150, "150 pulses a turn pass at 3000 Hz there, above half the sampling rate .3200 Hz., and what is seen"),
        (4, 1, "has the wheel 4 marks a turn. Say pulses_per_turn = 4"),
        (1, 20, "is pulses_per_turn right .20."),
    ],
)
def test_wheels_that_are_counted_wrong_are_an_error(tmp_path: Path, teeth: int, said: int, words: str) -> None:
    wheel = np.where((teeth * shaft_angle(TIME) / (2 * np.pi)) % 1 < 0.4, -2.0, -8.0)
    noise = np.random.default_rng(2).normal(size=TIME.size) * 0.02
    path = write_hdf5(tmp_path / "a.h5", {**CHANNELS, "keyphasor_shaft": wheel + noise})
    (tmp_path / "rig.toml").write_text(SETUP.replace("[perturbator]", f"pulses_per_turn = {said}\n[perturbator]"))
    record = rf.read_recording(path, tmp_path / "rig.toml")
    found = {finding.code: finding for finding in record.findings}
    assert found["speed-disagrees"].severity == "error"
    with pytest.warns(rf.DataWarning, match=words):
        rf.responses(record)


@pytest.mark.parametrize("size", [1e31, 1e155, 1e300, np.inf])
def test_samples_without_squares_are_refused_with_their_time(tmp_path: Path, size: float) -> None:
    broken = CHANNELS["disk_X"].copy()
    broken[1600] = size
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.attrs.update(ATTRIBUTES)
        for name, values in {**CHANNELS, "disk_X": broken}.items():
            file[name] = values
    for command in ("look", "vectors"):
        assert main([command, str(tmp_path / "a.h5"), "--out", str(tmp_path / f"{command}.csv")]) == 2
    with pytest.raises(ValueError, match=r"channel disk_X is (1e\+\d+|inf) at sample 1600 .0.5000 s."):
        rf.responses(rf.read_recording(tmp_path / "a.h5"))


UNUSED = {
    "[load]": ('[load]\nplane = "disk"\nN = 3.0\nangle_deg = 0.0\n', "[force] says what drives the rotor"),
    "sensitivity_... of [force]": ("sensitivity_V_per_N = 0.1\n", "no channel_x or channel_y measures the force"),
    "hole_angle_deg of [force]": ("hole_angle_deg = 10.0\n", "angle_deg says where the heavy spot is"),
    '[[channel]] name = "spare"': ('[[channel]]\nname = "spare"\nvolts_per_count = 2.0\n', "no probe, mark or force"),
    "the sensitivity at the top": ("TOP", "every probe has its own"),
}


@pytest.mark.parametrize("what", UNUSED)
def test_what_a_setup_says_for_nothing_is_said(tmp_path: Path, what: str) -> None:
    path = write_hdf5(tmp_path / "a.h5", {**CHANNELS, "spare": CHANNELS["disk_X"]}, {"sample_rate_hz": RATE})
    line, why = UNUSED[what]
    text = f"sensitivity_V_per_mm = 1.0\n{SETUP}" if line == "TOP" else f"{SETUP}{line}"
    (tmp_path / "rig.toml").write_text(text, encoding="utf-8")
    said = [found.message for found in rf.read_recording(path, tmp_path / "rig.toml").findings]
    assert [f"{what} in rig.toml is not used" in each and why in each for each in said] == [True]
    (tmp_path / "rig.toml").write_text(SETUP, encoding="utf-8")
    assert not rf.read_recording(path, tmp_path / "rig.toml").findings


@pytest.mark.parametrize(("run", "said"), [("a2.h5", 1), ("A", 1), ("a", 0), ("a.h5", 0), ("b", 0)])
def test_a_run_of_a_file_that_is_not_there_is_said(run: str, said: int, tmp_path: Path) -> None:
    """Misspelt, its unbalance goes to no file; that of another file beside this one is no fault."""
    for name in ("a.h5", "b.h5"):
        write_hdf5(tmp_path / name, CHANNELS, {"sample_rate_hz": RATE})
    (tmp_path / "rig.toml").write_text(f'{SETUP}[[run]]\nfile = "{run}"\nmr_g_mm = 20.0\n', encoding="utf-8")
    found = rf.read_recording(tmp_path / "a.h5", tmp_path / "rig.toml").findings
    assert [one.code for one in found] == ["run-absent"] * said
