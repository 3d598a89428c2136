"""Recordings as hurried engineers bring them: read rightly, said to be wrong, or refused."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest
from numpy.typing import NDArray
from recorded import ATTRIBUTES, RATE, SETUP, volts, write_hdf5
from sentences import refuses

import rotorfit as rf
from rotorfit.lab.recordings.rig.setup import Force

CHANNELS = volts(1.0)
NAMES = list(CHANNELS)
TIME = np.arange(CHANNELS["disk_X"].size) / RATE


def table(
    *,
    time: str = "time_s",
    times: NDArray[np.float64] | None = TIME,
    separator: str = ",",
    decimal: str = ".",
    above: str = "",
    below: str = "",
    end: str = "",
    factor: float = 1.0,
) -> str:
    """The recording as text."""
    columns = [] if times is None else [times]
    rows = np.column_stack([*columns, *(np.round(v * factor, 6) for v in CHANNELS.values())])
    head = ([] if times is None else [time]) + NAMES
    body = "\n".join(separator.join(f"{value:.7g}" for value in row) + end for row in rows).replace(".", decimal)
    return f"{above}{separator.join(head)}{end}\n{below}{body}\n"


def opened(folder: Path, text: str, setup: str = SETUP, encoding: str = "utf-8") -> rf.Recording:
    path, rig = folder / "a.csv", folder / "rig.toml"
    path.write_text(text, encoding=encoding)
    rig.write_text(setup.replace("sample_rate_hz = 3200.0\n", ""), encoding="utf-8")
    return rf.read_recording(path, rig)


WHOLE = {
    "semicolons and commas": table(separator=";", decimal=",", time="Zeit [s]"),
    "byte order mark": "\ufeff" + table(),
    "milliseconds by name": table(time="Time (msec)", times=TIME * 1e3),
    "units below the names": table(below="s,V,V,V,V\n"),
    "heading of an instrument": table(above="Export;v2.1\nSerial;12345\nSample rate;9 Hz\n\n", separator=";"),
    "heading of numbers": table(above="Measurement\nVersion\t2\nSamples\t12\t12\n3\t4\n*End*\n", separator="\t"),
    "rate in the heading": table(above="Sample rate (Hz),3.2 kHz\n", times=None),
    "separator at the end": table(end=","),
}


@pytest.mark.parametrize("name", WHOLE)
def test_text_of_instruments_reads_as_it_was_meant(tmp_path: Path, name: str) -> None:
    record = opened(tmp_path, WHOLE[name])
    assert record.sample_rate == pytest.approx(RATE, rel=1e-5)
    assert np.allclose(record.channel("disk_X"), CHANNELS["disk_X"], atol=1e-5)


REFUSED = {
    "times rounded": (table(times=np.round(TIME, 3)), "the times are rounded"),
    "a gap": (table(times=TIME + 0.5 * (TIME > 0.6)), "not evenly spaced"),
    "dates": (table().replace("\n", "\n2024-05-01 12:00:"), "line 2 holds what is not a number"),
    "a word": (table().replace("\n0.25,", "\n0.25,OVLD,").replace(f",{CHANNELS['disk_X'][800]:.7g},", ",", 1), "OVLD"),
    "prose": ("Dear colleague,\nplease find the data attached.\n", "holds no signals"),
    "names twice": (table().replace("disk_Y", "disk_X"), "every column needs a name of its own"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_text_that_cannot_be_meant_is_refused(tmp_path: Path, name: str) -> None:
    text, words = REFUSED[name]
    with pytest.raises(ValueError, match=words):
        opened(tmp_path, text)


def exchanged(first: str, second: str) -> Callable[[dict[str, NDArray[np.float64]]], None]:
    def exchange(channels: dict[str, NDArray[np.float64]]) -> None:
        channels[first], channels[second] = channels[second], channels[first]

    return exchange


def nothing(channels: dict[str, NDArray[np.float64]]) -> None:
    """As recorded."""


def in_millivolts(channels: dict[str, NDArray[np.float64]]) -> None:
    channels.update({name: values * 1e3 for name, values in channels.items()})


PROBE = '[[probe]]\nplane = "{}"\nchannel = "{}"\n{}\n'

SLIPS = {
    "marks exchanged": (exchanged("keyphasor_shaft", "keyphasor_perturbator"), "", "", "marks-exchanged"),
    "millivolts": (in_millivolts, "", "", "channel-scale"),
    "V/mm for V/m": (nothing, "V_per_mm = 7.87", "V_per_mm = 7870.0", "probe-sensitivity"),
    "mV/um for V/um": (nothing, "mV_per_um = 7.87", "mV_per_um = 0.00787", "probe-sensitivity"),
    "grams for kilograms": (nothing, "mr_g_mm", "mr_kg_m", "unbalance-large"),
    "another rate": (nothing, "3200.0", "6400.0", "setup-contradicts-file"),
    "another angle": (nothing, "angle_deg = 90.0", "angle_deg = 135.0", "setup-contradicts-file"),
}


@pytest.mark.parametrize(
    ("told", "words"),
    [
        ("speed_rpm = 2400", "speed (rpm): rig.toml says 2400, the file 1200"),
        ("[force]\nangle_deg = 43.0", "angle of the heavy spot (deg): rig.toml says 43, the file 40"),
        ("[force]\nangle_deg = 400.0", ""),
        ("[force]\nmr_g_mm = 40", "unbalance (g mm): rig.toml says 40, the file 20"),
        (PROBE.format("disk", "disk_X", "sensitivity_V_per_mm = 3.93"), "X (V/mm): rig.toml says 3.93, the file 7.87"),
        (
            PROBE.format("seal", "disk_X", "angle_deg = 0.0") + PROBE.format("seal", "journal_Y", "angle_deg = 90.0"),
            "rig.toml has disk_X at seal and journal_Y at seal, by their names they are at disk and journal",
        ),
        (PROBE.format("a", "disk_X", "angle_deg = 0.0") + PROBE.format("b", "journal_Y", "angle_deg = 90.0"), ""),
    ],
)
def test_a_setup_against_the_file_is_said_in_its_own_units(tmp_path: Path, told: str, words: str) -> None:
    path = write_hdf5(tmp_path / "a.h5", {**CHANNELS, "journal_Y": CHANNELS["disk_Y"]})
    rig = tmp_path / "rig.toml"
    rig.write_text(told + "\n", encoding="utf-8")
    said = [f.message for f in rf.read_recording(path, rig).findings if f.code == "setup-contradicts-file"]
    assert len(said) == bool(words), said
    assert words in "".join(said)


@pytest.mark.parametrize("name", SLIPS)
def test_slips_are_said(tmp_path: Path, name: str) -> None:
    change, old, new, code = SLIPS[name]
    channels = dict(CHANNELS)
    change(channels)
    path, rig = write_hdf5(tmp_path / "a.h5", channels), tmp_path / "rig.toml"
    rig.write_text(SETUP.replace(old, new, 1) if old else SETUP, encoding="utf-8")
    assert code in {finding.code for finding in rf.read_recording(path, rig).findings}


def test_times_in_milliseconds_that_count_as_seconds_are_said(tmp_path: Path) -> None:
    record = opened(tmp_path, table(times=TIME * 1e3), SETUP.replace("speed_rpm = 1200.0\n", ""))
    assert any("are the times in ms?" in found.message for found in record.findings if found.severity == "error")


@pytest.mark.parametrize("old", ['channel = "disk_Y"', 'channel = "keyphasor_shaft"'])
def test_a_channel_used_twice_is_refused(tmp_path: Path, old: str) -> None:
    path = write_hdf5(tmp_path / "a.h5", CHANNELS)
    rig = tmp_path / "rig.toml"
    rig.write_text(SETUP.replace(old, 'channel = "disk_X"'), encoding="utf-8")
    with refuses(ValueError):
        rf.read_recording(path, rig)


def test_zeros_of_a_setup_go_before_what_the_file_says(tmp_path: Path) -> None:
    """A reference run has no weight, a probe may sit at zero degrees: neither is a word left out."""
    path, rig = (
        write_hdf5(tmp_path / "a.h5", CHANNELS, {**ATTRIBUTES, "probe_angle_deg_X": 45.0}),
        tmp_path / "rig.toml",
    )
    rig.write_text(
        SETUP.replace("mr_g_mm = 20.0", "mr_g_mm = 0.0").replace("deg = 40.0", "deg = 0.0"), encoding="utf-8"
    )
    record = rf.read_recording(path, rig)
    force = record.force
    assert isinstance(force, Force)
    assert (force.mr, force.angle, record.probes[0].angle) == (0.0, 0.0, 0.0)


def test_hdf5_of_several_groups_keeps_their_signals_apart(tmp_path: Path) -> None:
    path, rig = tmp_path / "a.h5", tmp_path / "rig.toml"
    with h5py.File(path, "w") as file:
        file["time"] = TIME
        for number in (1, 2):
            for name, values in CHANNELS.items():
                file[f"run{number}/{name}"] = number * values
    rig.write_text(SETUP.replace('channel = "', 'channel = "run1/').replace("sample_rate_hz = 3200.0\n", ""), "utf-8")
    record = rf.read_recording(path, rig)
    assert record.sample_rate == pytest.approx(RATE)
    assert np.array_equal(record.channel("run1/disk_X"), CHANNELS["disk_X"])


def test_a_tdms_scale_that_is_not_known_is_refused(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """npTDMS logs it and gives counts where volts are meant."""
    from nptdms import ChannelObject, TdmsWriter

    scale = {"NI_Number_Of_Scales": 1, "NI_Scale[0]_Scale_Type": "Shunt", "NI_Scaling_Status": "unscaled"}
    with TdmsWriter(tmp_path / "a.tdms") as file:
        file.write_segment([ChannelObject("run", name, values, scale) for name, values in CHANNELS.items()])
    with refuses(ValueError):
        rf.read_recording(tmp_path / "a.tdms")
    assert capfd.readouterr().err == ""


def test_a_tdms_file_cut_off_within_its_last_segment_is_refused(tmp_path: Path) -> None:
    from nptdms import ChannelObject, TdmsWriter

    path = tmp_path / "a.tdms"
    with TdmsWriter(path) as file:
        for _ in range(2):
            file.write_segment([ChannelObject("run", name, values) for name, values in CHANNELS.items()])
    path.write_bytes(path.read_bytes()[: -8 * len(TIME)])
    with refuses(ValueError):
        rf.read_recording(path)
