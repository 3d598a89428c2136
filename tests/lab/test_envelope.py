"""A long recording thinned out by least and largest: as going through all samples gives it, and at once."""

from __future__ import annotations

import time

import h5py
import numpy as np
import pytest

import rotorfit as rf
from rotorfit.lab.recordings.views import envelope

RATE, HOUR = 5120, 3600
SETUP = "rotation = 'ccw'\n[[probe]]\nplane = 'disk'\nchannel = 'X'\nangle_deg = 0.0\nsensitivity_V_per_mm = 8.0\n"


@pytest.fixture(scope="module")
def hour(tmp_path_factory: pytest.TempPathFactory) -> rf.Recording:
    """One probe for an hour: a wave that grows, in counts of a millivolt, with one sample that sticks out."""
    folder = tmp_path_factory.mktemp("hour")
    t = np.arange(RATE * 60) / RATE
    wave = np.sin(2 * np.pi * 25 * t)
    with h5py.File(folder / "hour.h5", "w") as file:
        file.attrs["sample_rate_hz"] = float(RATE)
        volts = file.create_dataset("X", shape=(RATE * HOUR,), dtype="<i2")
        volts.attrs["volts_per_count"] = 1e-3
        for minute in range(60):
            volts[minute * wave.size : (minute + 1) * wave.size] = np.round((10 + minute) * wave)
        volts[RATE * 1234] = 3000
    (folder / "rig.toml").write_text(SETUP, encoding="utf-8")
    return rf.read_recording(folder / "hour.h5", folder / "rig.toml")


@pytest.mark.parametrize(("start", "stop"), [(0.0, HOUR), (1200.0, 1300.0), (1233.9, 1234.1), (3599.0, 3600.0)])
def test_least_and_largest_are_those_of_the_samples(hour: rf.Recording, start: float, stop: float) -> None:
    (probe,) = hour.probes
    t, x = envelope(hour, probe, start, stop, 1000)
    assert t.size <= 2 * 1100
    assert (np.diff(t) >= 0).all()
    samples = hour.displacement(probe, round(start * RATE), round(stop * RATE))
    assert x.max() == pytest.approx(samples.max(), rel=1e-12)
    assert x.min() == pytest.approx(samples.min(), rel=1e-12)
    high = x[1::2] if t.size > 1 and t[0] == t[1] else x
    assert (high.max() > 3e-4) == (start <= 1234 < stop)  # 3 V at 8 V/mm, seen at every scale


def test_an_hour_opens_within_two_seconds_of_work(hour: rf.Recording) -> None:
    """Seconds of this process, whatever else the machine does."""
    assert hour.setup is not None
    fresh = rf.read_recording(hour.path, hour.setup)
    begin = time.process_time()
    envelope(fresh, fresh.probes[0], 0.0, fresh.duration, 1000)
    assert time.process_time() - begin < 2.0
    begin = time.process_time()
    for start in np.linspace(0.0, 3000.0, 20):
        envelope(fresh, fresh.probes[0], start, start + 400.0, 1000)
        envelope(fresh, fresh.probes[0], start, start + 10.0, 1000)
    assert (time.process_time() - begin) / 40 < 0.02  # fifty steps of scrolling a second
