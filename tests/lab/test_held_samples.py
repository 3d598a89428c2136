"""Samples that were lost and held: the last one is repeated for some milliseconds."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from recorded import RATE, volts, write_hdf5
from sentences import refuses

import rotorfit as rf


def codes(path: Path) -> set[str]:
    return {finding.code for finding in rf.read_recording(path).findings}


@pytest.mark.filterwarnings("ignore::rotorfit.DataWarning")
@pytest.mark.parametrize("seconds", [0.06, 0.01])
@pytest.mark.parametrize("counts", [False, True])
def test_held_samples_are_a_gap(tmp_path: Path, seconds: float, counts: bool) -> None:
    channels = volts()
    for at in (0.7, 1.55, 2.3, 3.1):
        first = int(at * RATE)
        channels["disk_X"][first : first + int(seconds * RATE)] = channels["disk_X"][first]
    if counts:
        channels = {name: np.round(values / 3e-4) * 3e-4 for name, values in channels.items()}
    path = write_hdf5(tmp_path / "a.h5", channels)
    record = rf.read_recording(path)
    assert "channel-stops" in {finding.code for finding in record.findings}
    found = np.array(record.statistics["disk_X"].still)
    assert found[:, 0] == pytest.approx([0.7, 1.55, 2.3, 3.1], abs=2e-3)
    assert np.diff(found)[:, 0] == pytest.approx(seconds, abs=2e-3)
    assert not record.statistics["disk_Y"].still
    test = rf.responses(record)
    told = test.findings
    assert set(test.direction) == {"y"}
    assert "probe-left-out" in {finding.code for finding in told}


@pytest.mark.parametrize(("noise", "step"), [(3e-3, 1e-5), (3e-4, 5e-4), (0.0, 5e-3), (3e-3, 2e-2)])
def test_quiet_channels_and_coarse_cards_hold_nothing(tmp_path: Path, noise: float, step: float) -> None:
    channels = {name: np.round(values / step) * step for name, values in volts(noise=noise).items()}
    assert not codes(write_hdf5(tmp_path / "a.h5", channels)) & {"channel-stops", "channel-dead"}
    slow = {name: values if "key" in name else -10 + (values + 10) / 50 for name, values in volts(noise=noise).items()}
    slow = {name: np.round(values / step) * step for name, values in slow.items()}
    assert "channel-stops" not in codes(write_hdf5(tmp_path / "b.h5", slow))


@pytest.mark.parametrize("gaps", [(1.55,), (0.7, 2.3)])
def test_gaps_filled_with_zeros_are_gaps(tmp_path: Path, gaps: tuple[float, ...]) -> None:
    """Zero is the highest voltage of a probe at -10 V; a channel that stays there once or twice is not clipped."""
    channels = volts()
    for at in gaps:
        channels["disk_X"][int(at * RATE) : int((at + 0.06) * RATE)] = 0.0
    record = rf.read_recording(write_hdf5(tmp_path / "a.h5", channels))
    assert np.array(record.statistics["disk_X"].still)[:, 0] == pytest.approx(gaps, abs=2e-3)
    assert "channel-stops" in {finding.code for finding in record.findings}


def test_a_recording_without_any_probe_left_says_why(tmp_path: Path) -> None:
    channels = volts()
    for name in ("disk_X", "disk_Y"):
        channels[name][4000:4400] = channels[name][4000]
    record = rf.read_recording(write_hdf5(tmp_path / "a.h5", channels))
    with refuses(ValueError):
        rf.responses(record)
