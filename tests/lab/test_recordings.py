"""Recordings of every format read alike, in pieces, with the setup applied; what is wrong is one sentence."""

from __future__ import annotations

import json
import pickle
import wave
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from recorded import ATTRIBUTES, RATE, SETUP, motion, perturbator_angle, shaft_angle, volts, write_hdf5
from scipy.io import savemat, wavfile
from sentences import hear, refuses

import rotorfit as rf
from rotorfit.base.array_types import Float
from rotorfit.estimators.signals.pulse_numbers import number_pulses
from rotorfit.estimators.signals.pulses import find_edges, find_levels
from rotorfit.estimators.signals.shaft_angle import smooth_angle
from rotorfit.lab.recordings.formats.files import open_raw
from rotorfit.lab.recordings.recording import named_apart
from rotorfit.lab.simulation.turning_speeds import Sweep

CHANNELS = volts()
TIME = np.arange(CHANNELS["disk_X"].size) / RATE


def setup_file(folder: Path, text: str = SETUP) -> Path:
    path = folder / "rig.toml"
    path.write_text(text, encoding="utf-8")
    return path


def write_tdms(path: Path) -> None:
    from nptdms import ChannelObject, RootObject, TdmsWriter

    with TdmsWriter(path) as file:
        parts = np.array_split(np.arange(TIME.size), 3)  # three segments, as a logger writes while it runs
        for rows in parts:
            properties = {"wf_increment": 1 / RATE}
            channels = [ChannelObject("run", name, v[rows], properties) for name, v in CHANNELS.items()]
            file.write_segment([RootObject({"oil_temperature_C": 41.5}), *channels])


def write_mat(path: Path) -> None:
    savemat(path, {"fs": RATE, **CHANNELS})


def write_mat_structs(path: Path) -> None:
    """As Siemens' and LMS' exports: a struct a signal, with its axis and its name."""
    signals = {
        f"Signal_{i}": {
            "x_values": {"start_value": 0.0, "increment": 1 / RATE, "number_of_values": float(v.size)},
            "y_values": {"values": v, "quantity": {"label": "V"}},
            "function_record": {"name": name, "type": "Time"},
        }
        for i, (name, v) in enumerate(CHANNELS.items())
    }
    savemat(path, signals)


def write_mat_one_struct(path: Path) -> None:
    """The same with all signals in one struct: a matrix, and a list of names in the record."""
    values = np.column_stack(list(CHANNELS.values()))
    axis = {"start_value": 0.0, "increment": 1 / RATE, "number_of_values": float(len(values))}
    record = {"name": np.array(list(CHANNELS), dtype=object), "type": "Time"}
    savemat(path, {"Signal": {"x_values": axis, "y_values": {"values": values}, "function_record": record}})


def write_mat_dspace(path: Path) -> None:
    """As dSPACE ControlDesk: one X with the times, an array Y of structs."""
    y = np.array([(name, v) for name, v in CHANNELS.items()], dtype=[("Name", object), ("Data", object)])
    savemat(path, {"capture": {"X": {"Name": "time", "Data": TIME}, "Y": y}})


def write_mat_matrix(path: Path) -> None:
    names = np.array(list(CHANNELS), dtype=object)
    savemat(path, {"record": {"data": np.column_stack(list(CHANNELS.values())), "names": names, "Fs": RATE}})


def write_mat73(path: Path) -> None:
    """Version 7.3 is HDF5 behind 512 bytes of header."""
    with h5py.File(path, "w", userblock_size=512) as file:
        file["fs"] = np.array([[RATE]])
        group = file.create_group("run")
        for name, v in CHANNELS.items():
            group[name] = v.reshape(1, -1)
    with path.open("r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")


def write_uff(path: Path, **changes: object) -> None:
    import pyuff

    records = []
    for name, v in CHANNELS.items():
        plane, _, axis = name.partition("_")
        lateral = plane == "disk"
        records.append({
            "type": 58, "binary": 0, "func_type": 1, "rsp_node": 1 if lateral else 0, "ref_node": 0,
            "rsp_dir": " XY".index(axis) if lateral else 0, "ref_dir": 0, "rsp_ent_name": "disk" if lateral else "NONE",
            "ref_ent_name": "NONE", "id1": name, "data": v, "x": TIME, "abscissa_spacing": 1,
            "abscissa_inc": 1 / RATE, "abscissa_min": 0.0, "ord_data_type": 4, "orddenom_spec_data_type": 0, **changes,
        })  # fmt: skip
    pyuff.UFF(str(path)).write_sets(records, "overwrite")


def write_csv(path: Path) -> None:
    table = np.column_stack([TIME, *CHANNELS.values()])
    np.savetxt(path, table, delimiter=",", fmt="%.8g", header="time_s," + ",".join(CHANNELS), comments="")


def write_csv_rate(path: Path) -> None:
    table = np.column_stack(list(CHANNELS.values()))
    header = "# sample_rate_hz = 3200\n" + "\t".join(CHANNELS)
    np.savetxt(path, table, delimiter="\t", fmt="%.8g", header=header, comments="")


def write_parquet(path: Path) -> None:
    import pyarrow as pa
    from pyarrow import parquet

    parquet.write_table(pa.table({"Time [ms]": TIME * 1e3, **CHANNELS}), path, row_group_size=5000)


def write_npz(path: Path) -> None:
    np.savez(path, fs=RATE, **CHANNELS)


def write_npz_matrix(path: Path) -> None:
    """A matrix, its names, times, and what the rig is as JSON."""
    table = np.column_stack(list(CHANNELS.values())).T
    said = json.dumps({"force_plane": "disk", "mr_kg_m": 2e-5, "whirl": "forward"})
    np.savez_compressed(path, data=table, channels=list(CHANNELS), t=TIME, attributes=said)


FORMATS: dict[str, tuple[str, Callable[[Path], object]]] = {
    "hdf5": (".h5", lambda path: write_hdf5(path, CHANNELS)),
    "tdms": (".tdms", write_tdms),
    "mat": (".mat", write_mat),
    "mat structs": (".mat", write_mat_structs),
    "mat one struct": (".mat", write_mat_one_struct),
    "mat dspace": (".mat", write_mat_dspace),
    "mat matrix": (".mat", write_mat_matrix),
    "mat 7.3": (".mat", write_mat73),
    "uff": (".uff", write_uff),
    "uff of no type": (".uff", lambda path: write_uff(path, func_type=0, abscissa_spec_data_type=17)),
    "csv": (".csv", write_csv),
    "tsv with a rate": (".tsv", write_csv_rate),
    "parquet": (".parquet", write_parquet),
    "npz": (".npz", write_npz),
    "npz matrix": (".npz", write_npz_matrix),
}


@pytest.mark.parametrize("kind", FORMATS)
def test_every_format_reads_alike(tmp_path: Path, kind: str) -> None:
    suffix, write = FORMATS[kind]
    path = tmp_path / f"run{suffix}"
    write(path)
    without_rate = SETUP.replace("sample_rate_hz = 3200.0\n", "")
    record = rf.read_recording(path, setup_file(tmp_path, without_rate))
    assert record.sample_rate == pytest.approx(RATE)
    assert record.size == TIME.size
    assert record.planes == ("disk",)
    step = 8.0 / 32000 if suffix == ".h5" else 1e-6  # counts of 16 bits; other formats hold the numbers
    for name, values in CHANNELS.items():
        np.testing.assert_allclose(record.channel(name), values, atol=step)
        np.testing.assert_allclose(record.channel(name, 3000, 3010), values[3000:3010], atol=step)
    np.testing.assert_allclose(np.concatenate(list(record.pieces("disk_X"))), CHANNELS["disk_X"], atol=step)


@pytest.mark.parametrize(
    "content",
    [
        {**CHANNELS, "fs": RATE, "rig": {"mr_kg_m": 1.0}},
        {"fs": RATE, "few": np.arange(5.0)},
        CHANNELS,
        {**CHANNELS, "t": TIME**2},
    ],
)
def test_npz_files_that_are_no_recording(tmp_path: Path, content: dict[str, object]) -> None:
    np.savez(tmp_path / "run.npz", **content)  # type: ignore[arg-type]
    with refuses(ValueError):
        rf.read_recording(tmp_path / "run.npz", setup_file(tmp_path, SETUP.replace("sample_rate_hz = 3200.0\n", "")))


def test_a_channel_called_x_holds_no_times(tmp_path: Path) -> None:
    """Probes are called X and Y; times stand in t, before them or after."""
    np.savez(tmp_path / "run.npz", X=CHANNELS["disk_X"], Y=CHANNELS["disk_Y"], t=TIME)
    found = open_raw(tmp_path / "run.npz").channels
    assert list(found) == ["X", "Y"]
    assert found["X"].sample_rate == pytest.approx(RATE)


def test_an_npz_file_says_what_the_rig_is(tmp_path: Path) -> None:
    write_npz_matrix(tmp_path / "run.npz")
    setup = SETUP.partition("[force]")[0].replace("sample_rate_hz = 3200.0\n", "")
    record = rf.read_recording(tmp_path / "run.npz", setup_file(tmp_path, setup))
    assert record.force is not None
    assert record.force.mr == pytest.approx(2e-5)
    (tmp_path / "text.npz").write_text("x,y\n")
    with refuses(ValueError):
        rf.read_recording(tmp_path / "text.npz")


@pytest.mark.parametrize("width", [16, 24, 32, -32])
def test_wav_of_every_width_needs_its_scale(tmp_path: Path, width: int) -> None:
    path = tmp_path / "run.wav"
    table = np.column_stack(list(CHANNELS.values())) / 20.0
    if width == -32:
        wavfile.write(path, int(RATE), table.astype("f4") * 20)
    else:
        with wave.open(str(path), "wb") as file:
            file.setparams((4, width // 8, int(RATE), 0, "NONE", ""))
            counts = np.round(table * (2 ** (width - 1) - 1)).astype("<i4")
            file.writeframes(counts.reshape(-1, 1).view(np.uint8)[:, : width // 8].tobytes())
    names = {name: f"channel_{i + 1}" for i, name in enumerate(CHANNELS)}
    text = SETUP
    for name, number in names.items():
        text = text.replace(f'"{name}"', f'"{number}"')
    if width > 0:
        with refuses(ValueError):
            rf.read_recording(path, setup_file(tmp_path, text))
        text += "".join(f'[[channel]]\nname = "{n}"\nfull_scale_V = 20.0\n' for n in names.values())
    record = rf.read_recording(path, setup_file(tmp_path, text))
    for name, number in names.items():
        np.testing.assert_allclose(record.channel(number, 100, 400), CHANNELS[name][100:400], atol=20 / 2**14)


def test_motion_angles_and_force_come_out_in_si(tmp_path: Path) -> None:
    record = rf.read_recording(write_hdf5(tmp_path / "run.h5", CHANNELS))
    z = record.motion("disk")
    exact = motion(TIME) - motion(TIME).mean()
    assert np.abs(z - exact).std() < 1e-6  # 3 mV of noise a probe are 0.54 um in z, and 16-bit steps
    shaft, perturbator = record.shaft_angle(), record.perturbator_angle()
    assert perturbator is not None
    inner = np.linspace(0.5, 3.5, 300)
    for track, angle in ((shaft, shaft_angle), (perturbator, perturbator_angle)):
        turns = (track.angle(inner) - angle(inner)) / (2 * np.pi)
        np.testing.assert_allclose(turns, np.round(turns.mean()), atol=2e-3)
    np.testing.assert_allclose(perturbator.acceleration(inner), 20 * np.pi, rtol=0.02)
    assert record.force is not None
    assert record.force.mr == pytest.approx(2e-5)
    assert np.degrees(record.force.angle) == pytest.approx(40.0)
    assert (record.force.whirl, record.force.reference, record.force.datum_known) == (1, "perturbator", True)
    assert record.findings == ()


def test_setup_in_a_file_says_what_attributes_say(tmp_path: Path) -> None:
    path = write_hdf5(tmp_path / "run.h5", CHANNELS, {})
    said = rf.read_recording(write_hdf5(tmp_path / "said.h5", CHANNELS))
    with refuses(ValueError):
        rf.read_recording(path)
    record = rf.read_recording(path, setup_file(tmp_path))
    assert record.force is not None
    assert said.force is not None
    assert replace(record.force, mr=2e-5, sensitivity=1.0) == replace(said.force, sensitivity=1.0)
    assert record.speed == said.speed
    np.testing.assert_allclose(record.motion("disk", 0, 50), said.motion("disk", 0, 50), atol=1e-15)


@pytest.mark.parametrize("angles", [(45.0, 135.0), (-45.0, 45.0), (10.0, 80.0)])
def test_probes_at_other_angles_give_the_same_motion(tmp_path: Path, angles: tuple[float, float]) -> None:
    said = {**ATTRIBUTES, "probe_angle_deg_X": angles[0], "probe_angle_deg_Y": angles[1]}
    record = rf.read_recording(write_hdf5(tmp_path / "run.h5", volts(angles=angles), said))
    assert np.abs(record.motion("disk") - motion(TIME) + motion(TIME).mean()).std() < 1.5e-6


def test_a_shaft_that_turns_clockwise_is_mirrored(tmp_path: Path) -> None:
    """Seen from the end where y is left of x, forward whirl goes from y to x: the motion is the conjugate."""
    path = write_hdf5(tmp_path / "run.h5", volts(angles=(0.0, -90.0)), {**ATTRIBUTES, "probe_angle_deg_Y": -90.0})
    drawn = rf.read_recording(path).motion("disk")
    # with y drawn upwards the same probe is at +90 degrees and the shaft turns clockwise
    text = 'rotation = "cw"\n[[probe]]\nplane = "disk"\nchannel = "disk_X"\nangle_deg = 0\n[[probe]]\nplane = "disk"\n'
    text += 'channel = "disk_Y"\nangle_deg = 90\n'
    np.testing.assert_allclose(rf.read_recording(path, setup_file(tmp_path, text)).motion("disk"), drawn, atol=1e-18)


def test_one_probe_gives_real_motion_along_its_angle(tmp_path: Path) -> None:
    record = rf.read_recording(write_hdf5(tmp_path / "run.h5", {"disk_X": CHANNELS["disk_X"]}))
    assert record.motion("disk").dtype.kind == "f"
    assert record.perturbator_angle() is None
    with refuses(ValueError):
        record.shaft_angle()


def test_run_tables_go_before_what_holds_for_all(tmp_path: Path) -> None:
    path = write_hdf5(tmp_path / "run.h5", CHANNELS, {})
    text = SETUP + '[[run]]\nfile = "run.h5"\nspeed_rpm = 1500\nforce = {whirl = "backward", angle_deg = -120.0}\n'
    text += "[run.attributes]\noil_temperature_C = 44.0\n"
    record = rf.read_recording(path, setup_file(tmp_path, text))
    assert record.force is not None
    assert (record.force.whirl, record.force.plane, record.force.mr) == (-1, "disk", pytest.approx(2e-5))
    assert record.speed == pytest.approx(1500 * np.pi / 30)
    assert record.attributes == {"oil_temperature_C": 44.0}


def test_setup_that_contradicts_the_file_is_followed_and_said(tmp_path: Path) -> None:
    path = write_hdf5(tmp_path / "run.h5", CHANNELS)
    record = rf.read_recording(path, setup_file(tmp_path, SETUP.replace('"forward"', '"backward"')))
    assert record.force is not None
    assert record.force.whirl == -1
    assert any("direction of whirl: rig.toml says backward, the file forward" in f.message for f in record.findings)


def test_a_measured_force_is_read_in_newtons(tmp_path: Path) -> None:
    path = write_hdf5(tmp_path / "run.h5", {**CHANNELS, "Fx": 0.5 * TIME, "Fy": -TIME})
    text = '[force]\nplane = "disk"\nchannel_x = "Fx"\nchannel_y = "Fy"\nsensitivity_V_per_N = 0.1\n'
    record = rf.read_recording(path, setup_file(tmp_path, text))
    assert record.force is not None
    assert record.force.measured
    np.testing.assert_allclose(record.force_signal(), (5 - 10j) * TIME, atol=2e-2)


def test_recordings_travel_to_workers(tmp_path: Path) -> None:
    record = rf.read_recording(write_hdf5(tmp_path / "run.h5", CHANNELS))
    again = pickle.loads(pickle.dumps(record))
    np.testing.assert_array_equal(again.channel("disk_X"), record.channel("disk_X"))


# ---- what is wrong --------------------------------------------------------------------------------


def test_truncated_files_are_refused(tmp_path: Path) -> None:
    for kind, (suffix, write) in FORMATS.items():
        if suffix in (".csv", ".tsv"):
            continue  # a text file that ends early is a shorter recording, unless it ends within a row
        path = tmp_path / f"{kind.replace(' ', '-')}{suffix}"
        write(path)
        path.write_bytes(path.read_bytes()[: path.stat().st_size * 2 // 3])
        with refuses(ValueError):
            rf.read_recording(path, setup_file(tmp_path)).channel("keyphasor_perturbator")


def test_unequal_lengths_are_refused(tmp_path: Path) -> None:
    path = write_hdf5(tmp_path / "run.h5", {**CHANNELS, "disk_Y": CHANNELS["disk_Y"][:-7]})
    with refuses(ValueError):
        rf.read_recording(path)


def test_missing_rate_is_refused(tmp_path: Path) -> None:
    path = write_hdf5(tmp_path / "run.h5", CHANNELS, {k: v for k, v in ATTRIBUTES.items() if k != "sample_rate_hz"})
    with refuses(ValueError):
        rf.read_recording(path)


def test_text_that_is_no_table_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    rows = "\n".join(f"{i * 1e-3:g},1.0" for i in range(100))
    for text, words in (
        ("time_s,disk_X\n" + rows + "\n0.1,", "after line"),
        ("time_s,disk_X\n" + rows + "\n0.2,1.0", "not evenly spaced"),
        ("time_s,disk_X\n" + rows + "\n0.1,x", "after line"),
        ("time_s,disk_X\n0.1,x\n", "line 2 holds what is not a number"),
        ("", "is empty"),
        ("time_s,disk_X\n", "holds no signals"),
    ):
        path.write_text(text)
        with pytest.raises(ValueError, match=words):
            rf.read_recording(path)


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "cp1252"])
def test_text_as_analysers_write_it(tmp_path: Path, encoding: str) -> None:
    """Decimal commas, semicolons, a line for Excel, a row of units, and more rows than are read at once."""
    t = np.arange(150_000) / 1000
    lines = [f"{a:.3f};{b:.4f}".replace(".", ",") for a, b in zip(t, np.sin(t) - 9, strict=True)]
    path = tmp_path / "run.csv"
    path.write_text("sep=;\n# oil_C = 41.5\nTime [s];disk_µ_X\ns;V\n" + "\n".join(lines) + "\n", encoding=encoding)
    text = '[[probe]]\nplane = "disk"\nchannel = "disk_µ_X"\nangle_deg = 0\nsensitivity_V_per_mm = 1.0\n'
    record = rf.read_recording(path, setup_file(tmp_path, text))
    assert record.sample_rate == pytest.approx(1000.0)
    assert record.attributes == {"oil_C": 41.5}
    np.testing.assert_allclose(record.channel("disk_µ_X"), np.sin(t) - 9, atol=1e-4)


@pytest.mark.parametrize(
    "change",
    [
        ("rotation", "rotatoin"),
        ('"ccw"', '"left"'),
        ("angle_deg = 90.0", 'angle_deg = "up"'),
        ("mr_g_mm = 20.0", "mr_g_mm = -20.0"),
        ("sensitivity_V_per_mm = 7.87", "sensitivity_V_per_inch = 200"),
        ('channel = "disk_X"', 'channel = "dsk_X"'),
        ("[force]", "[force"),
        ("[shaft]", "[[shaft]]"),
        ("mr_g_mm = 20.0", "mr_g_mm = 20.0\nmr_kg_m = 2e-5"),
    ],
)
def test_setups_with_a_slip_are_refused(tmp_path: Path, change: tuple[str, str]) -> None:
    path = write_hdf5(tmp_path / "run.h5", CHANNELS, {})
    assert change[0] in SETUP
    with refuses(ValueError):
        rf.read_recording(path, setup_file(tmp_path, SETUP.replace(*change)))


# ---- a perturbator without a mark -------------------------------------------------------------------


def steady(t: Float, hertz: float, wander: float = 0.0) -> dict[str, Float]:
    """A backward perturbation at one frequency, beside the shaft's own motion."""
    phase = 2 * np.pi * hertz * t + wander * np.sin(2 * np.pi * 0.3 * t)
    z = 30e-6 * np.exp(1j * shaft_angle(t)) + 20e-6 * np.exp(-1j * (phase + 0.7))
    rng = np.random.default_rng(3)
    probes = {"disk_X": z.real, "disk_Y": z.imag}
    return {name: -10 + 7870 * part + 3e-3 * rng.normal(size=t.size) for name, part in probes.items()}


UNMARKED = SETUP.replace('channel = "keyphasor_perturbator"', "steady = true").replace('"forward"', '"backward"')


def test_a_steady_perturbation_without_a_mark_is_found_in_the_motion(tmp_path: Path) -> None:
    channels = {**steady(TIME, 33.217), "keyphasor_shaft": CHANNELS["keyphasor_shaft"]}
    record = rf.read_recording(write_hdf5(tmp_path / "run.h5", channels, {}), setup_file(tmp_path, UNMARKED))
    track = record.perturbator_angle()
    assert track is not None
    # 0.54 um of noise in z against 20 um over 4 s: sqrt(6)/(2 pi T) (s/A)/sqrt(N) = 2e-5 Hz
    np.testing.assert_allclose(track.speed(TIME[::1000]) / (2 * np.pi), 33.217, atol=1.5e-4)
    assert record.force is not None
    assert not record.force.datum_known
    assert [finding.code for finding in record.findings] == ["steady-perturbation"]
    hear(record.findings[0].message)


def test_a_perturbation_that_wanders_needs_a_mark(tmp_path: Path) -> None:
    shaft = {"keyphasor_shaft": CHANNELS["keyphasor_shaft"]}
    setup = setup_file(tmp_path, UNMARKED)
    wandering = write_hdf5(tmp_path / "run.h5", {**steady(TIME, 33.2, wander=1.5), **shaft}, {})
    with refuses(ValueError):
        rf.read_recording(wandering, setup).perturbator_angle()
    with refuses(ValueError):
        rf.read_recording(
            write_hdf5(tmp_path / "still.h5", {**steady(TIME, 0.0), **shaft}, {}), setup
        ).perturbator_angle()


def test_names_of_recordings_use_as_many_folders_as_they_need(tmp_path: Path) -> None:
    files = [tmp_path / name for name in ("a/x/rec.h5", "b/x/rec.h5", "a/y/rec.h5", "a/y/rec.wav", "a/y/other.h5")]
    for file in files:
        file.parent.mkdir(parents=True, exist_ok=True)
        file.touch()
    one = rf.read_recording(rf.datasets.path("volts_journal-fwd.h5"))
    found = [record.name for record in named_apart([replace(one, path=file) for file in files])]
    assert found == ["a/x/rec", "b/x/rec", "y/rec.h5", "rec.wav", "other"]
    assert pickle.loads(pickle.dumps(replace(one, label="a/x/rec"))).name == "a/x/rec"


@pytest.mark.parametrize("ends", [(60.0, 5000.0), (5000.0, 60.0)])
def test_the_error_of_the_angle_holds_in_every_tenth_of_a_fast_sweep(ends: tuple[float, float]) -> None:
    """60 to 5000 rpm in 10 s: a turn a second at one end, where the angle between two pulses is the spline's alone.

    Noise of 0.05 V meets an edge that falls by 6 V over 6 degrees: scatter in angle, not in time. Errors over three
    draws follow each other over some pulses, so that a tenth of the record holds ten or more values: their rms is known
    to a fifth, and what is stated of the jerk to about as much.
    """
    sweep = Sweep(first=ends[0] * np.pi / 30, last=ends[1] * np.pi / 30, duration=10.0)
    time = np.arange(64000) / 6400.0
    ratio = []
    for seed in range(3):
        into = np.mod(np.degrees(sweep.angle(time) + 0.3) + 180, 360) - 180
        depth = np.clip((into + 3) / 6, 0, 1) - np.clip((into - 21) / 6, 0, 1)
        volts = -2.0 - 6.0 * depth + 0.05 * np.random.default_rng(seed).normal(size=time.size)
        pulses = number_pulses(find_edges(iter([volts]), find_levels(volts, edge="falling")) / 6400.0)
        smooth = smooth_angle(pulses, duration=10.0, resolution=1 / 6400.0)
        inside = time[(time >= smooth.begin) & (time <= smooth.end)]
        error = smooth.angle(inside) - sweep.angle(inside) - 0.3
        error -= 2 * np.pi * np.round(np.median(error) / (2 * np.pi))
        ratio.append([np.mean(part**2) for part in np.array_split(error / smooth.stderr(inside), 10)])
    rms = np.sqrt(np.mean(ratio, axis=0))
    assert (rms > 0.5).all()
    assert (rms < 2.0).all()
