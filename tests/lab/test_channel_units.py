"""Channels that are scaled already: units of files and of rig.toml in place of volts and sensitivities."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest
from recorded import ATTRIBUTES, RATE, motion, volts
from scipy.io import savemat, wavfile
from sentences import refuses

import rotorfit as rf
from rotorfit.apps.cli.main import main
from rotorfit.lab.recordings.rig.setup import channel_unit, name_and_unit

SECONDS = 4.0
TOLD = {name: value for name, value in ATTRIBUTES.items() if name != "sensitivity_V_per_mm"}


def scaled(unit: float, axis_names: tuple[str, str] = ("disk_X", "disk_Y")) -> dict[str, np.ndarray]:
    """Motion in a unit (m), marks in volts."""
    z = motion(np.arange(round(SECONDS * RATE)) / RATE)
    marks = {name: values for name, values in volts(SECONDS).items() if "keyphasor" in name}
    noise = np.random.default_rng(1).normal(size=(2, z.size)) * 1e-7
    return {axis_names[0]: (z.real + noise[0]) / unit, axis_names[1]: (z.imag + noise[1]) / unit, **marks}


def hdf5(path: Path, channels: dict[str, np.ndarray], units: dict[str, str]) -> Path:
    with h5py.File(path, "w") as file:
        file.attrs.update(TOLD)
        for name, values in channels.items():
            file[name] = values
            if name in units:
                file[name].attrs["unit"] = units[name]
    return path


def toml(path: Path, *lines: str, probe: str = "", names: tuple[str, str] = ("disk_X", "disk_Y")) -> Path:
    probes = [
        f'[[probe]]\nplane = "disk"\nchannel = "{name}"\nangle_deg = {angle}\n{probe}'
        for name, angle in zip(names, (0, 90), strict=True)
    ]
    path.write_text("\n".join([*lines, *probes]), encoding="utf-8")
    return path


def same_motion(record: rf.Recording) -> None:
    z = motion(np.arange(record.size) / RATE)
    assert np.abs(record.motion("disk") - (z - z.mean())).max() < 1e-6
    assert not [finding for finding in record.findings if finding.severity != "note"]


@pytest.mark.parametrize(("text", "metres"), [("um", 1e-6), ("µm", 1e-6), ("mm", 1e-3), ("mil", 25.4e-6), ("m", 1.0)])
def test_a_file_that_says_its_unit_needs_no_sensitivity(tmp_path: Path, text: str, metres: float) -> None:
    path = hdf5(tmp_path / "a.h5", scaled(metres), {"disk_X": text, "disk_Y": text, "keyphasor_shaft": "V"})
    same_motion(rf.read_recording(path))
    assert text in rf.read_recording(path).rig.probes[0].unit
    test = rf.responses(rf.read_recording(path))
    assert np.all(np.isfinite(test.response.real))


def test_the_setup_says_the_unit(tmp_path: Path) -> None:
    path = hdf5(tmp_path / "a.h5", scaled(1e-6), {})
    same_motion(rf.read_recording(path, toml(tmp_path / "a.toml", probe='unit = "um"\n')))
    by_channel = "".join(f'[[channel]]\nname = "disk_{axis}"\nunit = "um"\n' for axis in "XY")
    same_motion(rf.read_recording(path, toml(tmp_path / "b.toml", by_channel)))


def test_millivolts_are_volts(tmp_path: Path) -> None:
    channels = {name: 1e3 * values if "disk" in name else values for name, values in volts(SECONDS, noise=1e-3).items()}
    path = hdf5(tmp_path / "a.h5", channels, {"disk_X": "mV", "disk_Y": "mV"})
    same_motion(rf.read_recording(path, toml(tmp_path / "a.toml", "sensitivity_V_per_mm = 7.87")))


@pytest.mark.parametrize("heading", ["names", "row"])
def test_text_with_units_in_its_heading(tmp_path: Path, heading: str) -> None:
    names = ("disk_X [um]", "disk_Y (µm)") if heading == "names" else ("disk_X", "disk_Y")
    channels = scaled(1e-6, names)
    above = [f"# {key} = {value}" for key, value in TOLD.items()] + [",".join(channels)]
    above += ["um,um,V,V"] if heading == "row" else []
    path = tmp_path / "a.csv"
    rows = np.column_stack(list(channels.values()))
    path.write_text("\n".join(above) + "\n" + "\n".join(",".join(f"{v:.5f}" for v in row) for row in rows), "utf-8")
    same_motion(rf.read_recording(path))


def test_structs_of_matlab_say_units(tmp_path: Path) -> None:
    channels = scaled(25.4e-6)
    structs = {
        name: {"data": values, "fs": RATE, "unit": "mil" if "disk" in name else "V"}
        for name, values in channels.items()
    }
    savemat(tmp_path / "a.mat", {**structs, **TOLD})
    same_motion(rf.read_recording(tmp_path / "a.mat"))


def test_wav_of_floats_with_units_of_the_setup(tmp_path: Path) -> None:
    channels = scaled(1e-6)
    wavfile.write(tmp_path / "a.wav", int(RATE), np.column_stack(list(channels.values())).astype(np.float32))
    marks = '[shaft]\nchannel = "channel_3"\n[perturbator]\nchannel = "channel_4"\n'
    force = '[force]\nplane = "disk"\nmr_kg_m = 2e-5\nwhirl = "forward"\nangle_deg = 40.0\n'
    setup = toml(tmp_path / "a.toml", marks, force, probe='unit = "um"\n', names=("channel_1", "channel_2"))
    same_motion(rf.read_recording(tmp_path / "a.wav", setup))


@pytest.mark.parametrize(
    ("unit", "setup"),
    [
        ("um", "sensitivity_mV_per_um = 7.87\n"),
        ("g", "sensitivity_mV_per_um = 7.87\n"),
        ("N", ""),
        ("", ""),
        ("um pk", ""),
    ],
)
def test_contradictions_are_refused_with_what_is_allowed(tmp_path: Path, unit: str, setup: str) -> None:
    path = hdf5(tmp_path / "a.h5", scaled(1e-6), {"disk_X": unit, "disk_Y": unit})
    with refuses(ValueError):
        rf.read_recording(path, toml(tmp_path / "a.toml", probe=setup))
    assert main(["look", str(path), "--setup", str(tmp_path / "a.toml"), "--out", str(tmp_path / "out")]) == 2


def test_one_volt_a_millimetre_as_setups_of_before_say_it(tmp_path: Path) -> None:
    path = hdf5(tmp_path / "a.h5", scaled(1e-3), {"disk_X": "mm", "disk_Y": "mm"})
    same_motion(rf.read_recording(path, toml(tmp_path / "a.toml", probe="sensitivity_V_per_mm = 1.0\n")))


def test_a_force_in_newtons(tmp_path: Path) -> None:
    channels = scaled(1e-6) | {"cell": np.random.default_rng(2).normal(size=round(SECONDS * RATE))}
    path = hdf5(tmp_path / "a.h5", channels, {"disk_X": "um", "disk_Y": "um", "cell": "lbf"})
    force = '[force]\nplane = "disk"\nchannel_x = "cell"\n'
    record = rf.read_recording(path, toml(tmp_path / "a.toml", force))
    assert np.std(record.force_signal().real) == pytest.approx(4.448, rel=0.03)
    with refuses(ValueError):
        rf.read_recording(path, toml(tmp_path / "b.toml", force + "sensitivity_mV_per_N = 10.0\n"))


def test_counts_of_another_unit_are_noticed(tmp_path: Path) -> None:
    """Metres said for micrometres."""
    path = hdf5(tmp_path / "a.h5", scaled(1e-6), {"disk_X": "mm", "disk_Y": "mm"})
    assert "probe-sensitivity" in {finding.code for finding in rf.read_recording(path).findings}


def test_a_unit_of_the_setup_against_that_of_the_file_is_named(tmp_path: Path) -> None:
    """Everything is 25 times too small, and no fit can notice."""
    path = hdf5(tmp_path / "a.h5", scaled(25.4e-6), {"disk_X": "mils", "disk_Y": "µm"})
    record = rf.read_recording(path, toml(tmp_path / "a.toml", probe='unit = "um"\n'))
    said = [finding.message for finding in record.findings if finding.code == "setup-contradicts-file"]
    assert said == ["a.h5: unit of disk_X: a.toml says um, the file mils; the setup is followed."]


def test_a_channel_without_its_unit_in_the_name_is_no_channel(tmp_path: Path) -> None:
    path = hdf5(tmp_path / "a.h5", scaled(1e-6, ("disk_X [um]", "disk_Y [um]")), {})
    with refuses(ValueError):
        rf.read_recording(path, toml(tmp_path / "a.toml"))


def test_a_recording_without_probes_is_refused_and_looked_at(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = hdf5(tmp_path / "a.h5", scaled(1e-6, ("front", "side")), {})
    with refuses(ValueError):
        rf.responses(rf.read_recording(path))
    assert main(["look", str(path), "--out", str(tmp_path / "out")]) == 1
    assert "no timebase: a: none of its channels is known as a probe" in capsys.readouterr().out


def test_words_for_units() -> None:
    assert all(channel_unit(text) is not None for text in (" Mils ", "m/s²", "m/s^2", "microns", "lbf"))
    assert channel_unit("Pa") is None
    assert name_and_unit("disk_X [um]") == ("disk_X", "um")
    assert name_and_unit("journal Y (mil)") == ("journal Y", "mil")
    assert name_and_unit("disk_X (left)") == ("disk_X (left)", "")
