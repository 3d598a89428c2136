"""Exports of condition-monitoring systems: sample tables with repeated headers, and Bode tables."""

from __future__ import annotations

import numpy as np
import pytest
from sentences import refuses

import rotorfit as rf

CHANNELS = "CH#|Channel Name|Machine Name|Status|Angle|Direction|Speed Units(P)|Amp Unit|Phase Unit|"
SAMPLES = (
    "CH#|Channel Name|Sample#|Sample Cause|Date|Speed(P)|Speed(S)|Direct|Avg Gap|Inst Gap|1XAmplitude|1X Phase|"
    "2XAmplitude|2X Phase|Bandpass|Process Variable|"
)
SPEEDS = np.arange(500, 1300, 100)
X = 2e-6 * np.exp(-1j * np.radians(100 + np.arange(SPEEDS.size)))
Y = 1e-6 * np.exp(-1j * np.radians(190 + np.arange(SPEEDS.size)))
"""Vectors of the machine, m 0-peak, phase lead."""
QUIET = pytest.mark.filterwarnings("ignore:.*(measure no displacement|were skipped|holds no weight)")


def phase(vector):
    return f"{-np.degrees(np.angle(vector)) % 360:.6f}"


def export(names=("BRG1X", "BRG1Y"), marks=None, date="03Mar1953", machines=("TURBINE", "TURBINE")):
    """Text of a sample table, two blocks a speed: mil pp on one channel, um pp on the other."""
    lines = ["", ""]
    for k, rpm in enumerate(SPEEDS):
        mark = (marks or {}).get(k, "")
        stamp = f"{date} 03:03:{k:02d}.468|{rpm}|0|0.9|-10.4|-10.4"
        lines += [
            "", CHANNELS,
            f"1|{names[0]}|{machines[0]}|OK|45°|Right|rpm|mil pp|deg|",
            f"2|{names[1]}|{machines[1]}|OK|45°|Left|rpm|µm pp|deg|",
            "3|KPH|TURBINE|OK|90°|Right|rpm|V pp|deg|",
            "", SAMPLES,
            f"1|{names[0]}|{k}|DT-T|{stamp}|{abs(X[k]) * 2 / 25.4e-6:.9f}|{phase(X[k])}{mark}|0.2|25|0.9||",
            f"2|{names[1]}|{k}|DT-T|{stamp}|{abs(Y[k]) * 2e6:.9f}|{phase(Y[k])} V|0.2|25|0.9||",
            f"3|KPH|{k}|DT-T|{stamp}|||||10.6||",
        ]  # fmt: skip
    return "\r\n".join(lines) + "\r\n"


def written(path, text, encoding="utf-16"):
    path.write_bytes(text.encode(encoding))
    return path


@QUIET
@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "utf-16-be", "utf-8", "utf-8-sig", "cp1252"])
@pytest.mark.parametrize("suffix", ["txt", "csv"])
def test_a_sample_table_gives_the_vectors_of_the_machine(tmp_path, encoding, suffix):
    test = rf.read(written(tmp_path / f"export.{suffix}", export(), encoding))
    assert test.planes == ("BRG1",)
    for direction, expected in (("x", X), ("y", Y)):
        one = test.select(test.direction == direction)
        np.testing.assert_allclose(
            one.response, expected, rtol=1e-7
        )  # amplitudes and phases have nine and six decimals
        np.testing.assert_allclose(one.speed, SPEEDS * np.pi / 30)
    np.testing.assert_array_equal(test.frequency, test.speed)
    assert (test.force == 0).all()
    assert set(test.run.tolist()) == {"export"}
    assert set(test.attributes["date"].tolist()) == {"1953-03-03"}


@pytest.mark.filterwarnings("ignore::rotorfit.DataWarning")
def test_what_is_left_out_is_said_with_its_mark_and_line(tmp_path):
    path = written(tmp_path / "export.txt", export(marks={1: "BMA", 2: "*", 4: "BMA"}))
    test = rf.read(path)
    found = test.findings
    assert len(test) == 2 * SPEEDS.size - 3
    words = "\n".join(str(finding) for finding in found)
    assert "left out: KPH (V pp)" in words
    assert "3 of 16 samples were skipped (phase marked BMA: 2, phase marked *: 1; lines 20, 30, 50)" in words
    assert "export.txt holds no weight, so its run is a reference run" in words


@pytest.mark.filterwarnings("ignore::rotorfit.DataWarning")
def test_probes_that_are_not_at_right_angles_are_noticed(tmp_path):
    found = rf.read(written(tmp_path / "right.txt", export())).findings
    assert "probe-angles" not in [finding.code for finding in found]
    path = written(tmp_path / "askew.txt", export().replace("45°|Left", "30°|Left"))
    found = rf.read(path).findings
    (note,) = (finding.message for finding in found if finding.code == "probe-angles")
    assert "BRG1 sit at 45° Right and 30° Left, 75 degrees apart and not 90" in note
    assert '"BRG1=0:75"' in note


@QUIET
def test_a_weight_is_a_constant_of_the_file(tmp_path):
    path = written(tmp_path / "export.txt", export())
    weight = {"force_plane": "disk", "mr_g_mm": 30, "force_phase_deg": 90, "run": "with"}
    test = rf.read(path, constants=weight)
    np.testing.assert_allclose(test.force, 30e-6 * test.frequency**2 * 1j)
    assert set(test.force_plane.tolist()) == {"disk"}
    assert set(test.run.tolist()) == {"with"}


@QUIET
def test_options_of_the_reader_apply(tmp_path):
    path = written(tmp_path / "export.txt", export())
    test = rf.read(path, where={"speed_rpm": (650, 1250)}, exclude={"direction": ["y"]})
    np.testing.assert_allclose(test.response, X[2:], rtol=1e-7)
    test = rf.read(path, slow_roll_below_rpm=550, exclude={"direction": ["y"]})
    np.testing.assert_allclose(test.response, X[1:] - X[0], atol=1e-7 * abs(X[0]))  # and it is gone itself
    turned = rf.read(path, probe_angles={"BRG1": (45, 135)})
    np.testing.assert_allclose(turned.select(turned.direction == "x").response, (X - Y) / np.sqrt(2), rtol=1e-7)


@QUIET
@pytest.mark.parametrize(
    ("names", "plane"),
    [(("Brg 1 X", "Brg 1 Y"), "Brg 1"), (("1X", "1Y"), "1"), (("INBD X", "INBD Y"), "INBD"), (("DEX", "DEY"), "DE")],
)
def test_names_of_channels_tell_plane_and_direction(tmp_path, names, plane):
    assert rf.read(written(tmp_path / "export.txt", export(names))).planes == (plane,)


@QUIET
def test_names_that_do_not_tell_are_refused_until_they_are_given(tmp_path):
    path = written(tmp_path / "export.txt", export(("Gearbox", "Relay")))
    with refuses(ValueError):
        rf.read(path)
    test = rf.read(path, columns={"Gearbox": "gear_x", "Relay": "gear_y"})
    assert test.planes == ("gear",)
    with refuses(ValueError):
        rf.read(path, columns={"Gear": "gear_x"})


@QUIET
def test_machines_of_one_file_are_told_apart(tmp_path):
    path = written(tmp_path / "export.txt", export(machines=("TURBINE", "PUMP")))
    assert set(rf.read(path).planes) == {"TURBINE BRG1", "PUMP BRG1"}
    path = written(tmp_path / "same.txt", export(("1X", "1X"), machines=("TURBINE", "PUMP")))
    test = rf.read(path)
    np.testing.assert_allclose(test.select(test.plane == "TURBINE 1").response, X, rtol=1e-7)
    np.testing.assert_allclose(test.select(test.plane == "PUMP 1").response, Y, rtol=1e-7)


@QUIET
def test_a_day_that_is_ambiguous_is_no_date(tmp_path):
    test = rf.read(written(tmp_path / "export.txt", export(date="03/04/1953")))
    assert "date" not in test.attributes
    assert test.attributes["timestamp"][0] == "03/04/1953 03:03:00.468"


@pytest.mark.parametrize(
    "change",
    [
        lambda text: text.replace("|mil pp|", "|mil|"),
        lambda text: text.replace("mil pp", "g pk").replace("µm pp", "g pk"),
        lambda text: text.replace("|rpm|", "|knots|"),
        lambda text: text.replace("deg|", "grad|"),
        lambda text: text.replace("|500|", "|0,5e3|"),
        lambda text: text.replace("|1X Phase", "|1X Angle"),
        lambda text: text.replace(CHANNELS, ""),
        lambda text: text[: text.index(SAMPLES)],
        lambda text: text.replace("1|BRG1X|0|", "1|BRG9X|0|"),
        lambda text: text.replace("1|BRG1X|0|DT-T|", "1|BRG1X|0|"),
        lambda text: text.replace(" V|", "BMA|").replace("DT-T", "").replace("|mil pp|", "|V pp|"),
        lambda text: text.replace("BRG1Y", "BRG1X"),
        lambda text: text.replace("BRG1Y", "BRG1 X"),
    ],
)
def test_what_cannot_be_told_is_refused_in_words(tmp_path, change):
    path = written(tmp_path / "export.txt", change(export()))
    with refuses(ValueError) as caught:
        rf.read(path)
    assert "\n" not in str(caught.value)


@QUIET
def test_a_weight_without_its_plane_or_angle_is_refused(tmp_path):
    path = written(tmp_path / "export.txt", export(("1X", "2Y")))
    with refuses(ValueError):
        rf.read(path, constants={"mr_g_mm": 30, "force_phase_deg": 0})
    with refuses(ValueError):
        rf.read(path, constants={"mr_g_mm": 30, "force_plane": "1"})


# ---- Bode tables ----------------------------------------------------------------------------------------------------


def bode():
    rows = [
        f"{rpm},{abs(x) * 2e6:.9f},{phase(x)},2025-03-01T10:00:{k:02d}"
        for k, (rpm, x) in enumerate(zip(SPEEDS, X, strict=True))
    ]
    return "\n".join(["X-Axis Value,Y-Axis Value,Phase,Timestamp", *rows]) + "\n"


AMPLITUDE = {"Y-Axis Value": "amplitude_um_pp"}


@QUIET
@pytest.mark.parametrize(
    ("name", "constants", "plane"), [("Brg 1 X.csv", {}, "Brg 1"), ("a.csv", {"plane": "p", "direction": "x"}, "p")]
)
def test_a_bode_table_is_a_channel(tmp_path, name, constants, plane):
    test = rf.read(written(tmp_path / name, bode(), "utf-8"), columns=AMPLITUDE, constants=constants)
    np.testing.assert_allclose(test.response, X, rtol=1e-7)
    np.testing.assert_array_equal(test.frequency, test.speed)
    assert test.planes == (plane,)


def test_a_bode_table_says_neither_unit_nor_channel(tmp_path):
    path = written(tmp_path / "bode.csv", bode(), "utf-8")
    with refuses(ValueError):
        rf.read(path)
    with refuses(ValueError):
        rf.read(path, columns=AMPLITUDE)


@pytest.mark.filterwarnings("ignore::rotorfit.DataWarning")
def test_samples_of_a_bode_table_without_a_phase_are_skipped_with_a_word(tmp_path):
    path = written(tmp_path / "bode.csv", bode().replace(phase(X[3]), "---"), "utf-8")
    weight = {"plane": "disk", "direction": "x", "mr_g_mm": 30, "force_phase_deg": 0}
    test = rf.read(path, columns=AMPLITUDE, constants=weight)
    found = test.findings
    assert len(test) == 7
    words = "\n".join(map(str, found))
    assert "1 of 8 samples were skipped (no phase: 1; line 5)" in words
    assert "no weight" not in words
