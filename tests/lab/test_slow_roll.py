"""Run-out read from slow turning and taken out of the signals: a start-up made of known motion and known run-out."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pytest
from recorded import RATE, notch, write_hdf5
from sentences import hear, refuses

import rotorfit as rf

FIRST, LAST, SECONDS, SLOW = 2.0, 25.0, 20.0, 4.0  # turns a second; slow roll below 4, which is 1.7 s of the start-up
SIZE, NOISE = 60e-6, 3e-3  # m of vibration at the highest speed; V
SETUP = """
[shaft]
channel = "keyphasor_shaft"
[[probe]]
plane = "disk"
channel = "disk_X"
[[probe]]
plane = "disk"
channel = "disk_Y"
"""
SLOW_ROLL = "[slow_roll]\nbelow_rpm = 240\n"
WAVEFORM = SLOW_ROLL + 'as = "waveform"\n'


def angle(t):
    return 2 * np.pi * (FIRST * t + (LAST - FIRST) / SECONDS * t**2 / 2) + 0.9


def vibration(t, size=SIZE):
    """As unbalance far below a resonance: it grows with the square of the speed."""
    turns = FIRST + (LAST - FIRST) / SECONDS * t
    return size * (turns / LAST) ** 2 * np.exp(1j * (angle(t) + 0.5))


def scratch(theta, depth=20e-6):
    """8 um of bow, and a scratch 20 degrees wide, as the probe at 0 degrees sees them at an angle of the shaft."""
    place = np.mod(theta - 2.0, 2 * np.pi) - np.pi
    return 8e-6 * np.cos(theta + 1.1) + depth * np.exp(-((place / np.radians(20)) ** 2))


def recorded(folder: Path, name="up.h5", *, size=SIZE, mark="keyphasor_shaft") -> Path:
    t = np.arange(round(SECONDS * RATE)) / RATE
    rng = np.random.default_rng(4)
    z, theta = vibration(t, size), angle(t)
    seen = {"X": z.real + scratch(theta), "Y": z.imag + scratch(theta - np.pi / 2)}
    channels = {f"disk_{axis}": -10 + 7870 * m + NOISE * rng.normal(size=t.size) for axis, m in seen.items()}
    known = {"sample_rate_hz": RATE, "sensitivity_V_per_mm": 7.87, "probe_angle_deg_X": 0.0, "probe_angle_deg_Y": 90.0}
    return write_hdf5(folder / name, {**channels, mark: notch(theta)}, known)


def opened(path: Path, words: str) -> rf.recordings.recording.Recording:
    setup = path.parent / "rig.toml"
    setup.write_text(SETUP + words)
    return rf.read_recording(path, setup)


def errors(record):
    """rms of what is left beside the vibration where the shaft turns fastest, m, at 1x and at all else."""
    t = np.arange(record.size) / RATE
    fast = t > SECONDS - 3
    left = (record.motion("disk") - vibration(t))[fast]
    left -= left.mean()
    turn = np.exp(1j * angle(t[fast]))
    both = np.column_stack([turn, turn.conj()])
    once = both @ np.linalg.lstsq(both, left, rcond=None)[0]
    return float(np.sqrt(np.mean(np.abs(once) ** 2))), float(np.sqrt(np.mean(np.abs(left - once) ** 2)))


AT_SLOW_SPEED = SIZE * (SLOW / LAST) ** 2
"""The most that vibrates below the limit, and is taken for run-out: 1.5 um."""
PROBES = np.sqrt(2) * NOISE / 7870
"""rms noise of z, m."""


def test_without_slow_roll_the_run_out_is_in_the_motion(tmp_path):
    once, other = errors(opened(recorded(tmp_path), ""))
    assert once > 8e-6
    assert other > 4e-6


def test_a_vector_takes_out_the_first_two_orders(tmp_path):
    path = recorded(tmp_path)
    plain = errors(opened(path, ""))
    once, other = errors(opened(path, SLOW_ROLL))
    assert once < AT_SLOW_SPEED + 0.2e-6  # and the noise of some thousand samples
    assert PROBES < other < plain[1]


def test_a_waveform_takes_out_the_scratch_too(tmp_path):
    once, other = errors(opened(recorded(tmp_path), WAVEFORM))
    assert once < AT_SLOW_SPEED + 0.2e-6
    # 24 orders of two probes, each told by the 5300 samples below 240 rpm: 96 real numbers of 2 * 5300.
    assert other < PROBES * np.sqrt(1 + 96 / 5300) + 0.1e-6


def test_run_out_of_another_recording(tmp_path):
    path = recorded(tmp_path)
    recorded(tmp_path, "slow.h5", size=0.0)
    record = opened(path, '[slow_roll]\nfile = "slow.h5"\nbelow_rpm = 600\nas = "waveform"\n')
    once, other = errors(record)
    assert once < 0.2e-6
    assert other < PROBES * 1.02
    assert errors(pickle.loads(pickle.dumps(record))) == (once, other)
    (note,) = [finding for finding in record.findings if finding.code == "slow-roll"]
    hear(note.message)
    amplitude = np.abs(record.run_out.amplitudes["disk_X"][0]) / 7870
    assert f"disk_X {1e6 * amplitude:.3g} µm" in note.message


def test_vectors_by_windows_lose_the_run_out(tmp_path):
    """The 1x vector at the highest speed, which slow roll moves by 8 um or more."""
    record = opened(
        recorded(tmp_path), '[slow_roll]\nbelow_rpm = 240\nas = "waveform"\n[force]\nplane = "disk"\nmr_g_mm = 20\n'
    )
    test = rf.responses(record, turns=8)
    last = np.argmax(test.speed)
    one = test.select(test.frequency == test.frequency[last])
    at = dict(zip(one.direction.tolist(), one.response.tolist(), strict=True))
    size = abs(at["x"] + 1j * at["y"]) / 2 if "x" in at else abs(at["z"])
    expected = SIZE * (test.speed[last] / (2 * np.pi * LAST)) ** 2
    assert size == pytest.approx(expected, abs=AT_SLOW_SPEED + 0.3e-6)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("[slow_roll]\n", "give below_rpm"),
        ("[slow_roll]\nbelow_rpm = -3\n", "must be above zero"),
        ("[slow_roll]\nbelow_rpm = 125\n", "at least 4 turns"),
        ('[slow_roll]\nbelow_rpm = 240\nas = "wave"\n', "must be one of vector, waveform"),
        ('[slow_roll]\nfile = "gone.h5"\n', "gone.h5"),
        ("[slow_roll]\nunder_rpm = 240\n", "under_rpm"),
    ],
)
def test_slips_are_refused_in_a_sentence(tmp_path, words, said):
    path = recorded(tmp_path)
    with refuses((ValueError, OSError)) as caught:
        opened(path, words).motion("disk")
    assert said in str(caught.value)


def test_slow_roll_needs_the_mark_of_the_shaft(tmp_path):
    path = recorded(tmp_path, mark="pulses")
    (tmp_path / "rig.toml").write_text(SETUP.partition("[[probe]]")[1] + SETUP.partition("[[probe]]")[2] + SLOW_ROLL)
    with refuses(ValueError):
        rf.read_recording(path, tmp_path / "rig.toml")


def test_the_orbit_says_that_run_out_is_gone_and_its_titles_are_apart(tmp_path):
    """One plane: axes of equal scales are then narrower than their place is high."""
    figure = opened(recorded(tmp_path), SLOW_ROLL).plot.orbit(at=18.5)
    figure.savefig(tmp_path / "orbit.png", dpi=100)
    titles = [axis._left_title for axis in figure.axes]
    assert titles[0].get_text() == "disk, without run-out"
    head = figure._suptitle.get_window_extent()
    assert all(title.get_window_extent().y1 < head.y0 for title in titles)
