"""Twist from a torsion channel or from tooth wheels at two planes, and its figure."""

import h5py
import numpy as np
import pytest
from sentences import refuses

import rotorfit as rf

RATE, SPEED, TEETH = 20_000.0, 120.0, 36
SETUP = """rotation = "ccw"
[shaft]
channel = "key"
[[probe]]
plane = "disk"
channel = "disk_X"
angle_deg = 0.0
sensitivity_V_per_mm = 7.87
"""
WHEELS = '[twist]\neven_wheel = "motor"\nwheel = "wheel"\nteeth = 36\n'


def wheel(angle, rng):
    """Voltage of a wheel whose teeth are unevenly spaced by some hundredths of a degree."""
    error = rng.normal(scale=5e-4, size=TEETH)
    marks = np.append(2 * np.pi * np.arange(TEETH) / TEETH + error, 2 * np.pi + error[0])
    place = np.interp(np.mod(angle, 2 * np.pi), marks, np.arange(TEETH + 1.0), left=-0.01)
    return np.clip(2.5 + 8.0 * np.sin(2 * np.pi * place), 0.0, 5.0)


@pytest.fixture(scope="module")
def record(tmp_path_factory):
    """Four seconds of a shaft whose disk twists at 47 and 61 Hz."""
    folder, rng = tmp_path_factory.mktemp("wheels"), np.random.default_rng(4)
    time = np.arange(int(4 * RATE)) / RATE
    twist = 8e-4 * np.sin(2 * np.pi * 47.0 * time) + 2e-4 * np.cos(2 * np.pi * 61.0 * time)
    shaft = SPEED * time
    channels = {
        "key": np.where(np.mod(shaft, 2 * np.pi) < 0.3, -8.0, -2.0),
        "disk_X": 0.2 * np.cos(shaft),
        "motor": wheel(shaft, rng),
        "wheel": wheel(shaft + twist, rng),
    }
    with h5py.File(folder / "wheels.h5", "w") as file:
        file.attrs["sample_rate_hz"] = RATE
        for name, volts in channels.items():
            file[name] = volts + rng.normal(scale=3e-3, size=time.size)
    return folder, time, twist


def opened(folder, more):
    (folder / "rig.toml").write_text(SETUP + more)
    return rf.read_recording(folder / "wheels.h5", folder / "rig.toml")


def test_two_tooth_wheels_give_the_twist_between_them(record):
    folder, time, twist = record
    found = opened(folder, WHEELS).twist
    inside = (time > 0.1) & (time < 3.9)
    for hertz, amplitude in ((47.0, 8e-4), (61.0, 2e-4)):
        turn = np.exp(-2j * np.pi * hertz * time[inside])
        ratio = np.mean(found[inside] * turn) / np.mean(twist[inside] * turn)
        # The pattern of 76 turns takes 1/(pi 3.7 Hz 4 s) = 2 % of a line 3.7 Hz from 3x, and less of others.
        assert abs(ratio - 1) < 0.025, (hertz, amplitude)
    # Teeth 0.03 degrees off their place would be six times this if they were left in.
    assert np.std(found[inside] - twist[inside]) < 8e-5


def test_the_twist_is_drawn_over_time_where_nothing_is_swept(record):
    folder, _, _ = record
    figure = opened(folder, WHEELS).plot.twist(spectra=12)
    assert [axis.get_xlabel() for axis in figure.axes] == ["time, s", "frequency, Hz"]


@pytest.mark.parametrize(
    "more",
    [
        '[twist]\nwheel = "wheel"\nteeth = 36\n',
        '[twist]\nchannel = "wheel"\n',
        '[twist]\nchannel = "wheel"\nsensitivity_V_per_rad = 1.0\nteeth = 36\n',
        WHEELS.replace("36", "4"),
        WHEELS.replace('"motor"', '"mtor"'),
        '[twist]\ntooth = 3\n',
    ],
)  # fmt: skip
def test_setups_that_make_no_twist_are_refused_in_words(record, more):
    with refuses(ValueError):
        opened(record[0], more)


def test_a_recording_without_twist_says_so(record):
    with refuses(ValueError):
        opened(record[0], "").plot.twist()
