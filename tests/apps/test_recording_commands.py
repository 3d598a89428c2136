"""Recordings given to the command line: figures, templates of their setup, refusals."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from command_words import RIG, Run, refused
from recorded import ATTRIBUTES, RATE, shaft_angle, volts, write_hdf5
from sentences import hear, refuses
from turbulence import ONE_MODE, written

import rotorfit as rf
from rotorfit.apps.cli.main import main
from rotorfit.apps.study_files.folder import CONTENTS
from rotorfit.lab.recordings.rig.template import template


@pytest.mark.usefixtures("sketched")
def test_recordings_of_one_file_name_are_runs_apart(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A folder a day, each with a rec.h5: as one run their differences would enter no error bar."""
    for day, way in (("day0", "fwd"), ("day1", "bwd")):
        (tmp_path / day).mkdir()
        shutil.copyfile(rf.datasets.path(f"volts_journal-{way}.h5"), tmp_path / day / "rec.h5")
    monkeypatch.chdir(tmp_path)
    test = rf.responses([rf.read_recording(f"{day}/rec.h5") for day in ("day0", "day1")])
    assert test.runs == ("day0/rec", "day1/rec")
    assert main(["look", "day0/rec.h5", "day1/rec.h5", "--plane", "disk", "--out", "figures", "--quiet"]) == 0
    names = {file.name for file in (tmp_path / "figures").iterdir()}
    assert {f"{day}-rec-orbit.png" for day in ("day0", "day1")} <= names
    assert sum(name.startswith("day0") for name in names) == sum(name.startswith("day1") for name in names)


def test_raw_signals_given_to_fit_are_told_what_to_do(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    raw = tmp_path / "raw.csv"
    t = np.arange(200) / 1000
    np.savetxt(raw, np.column_stack([t, t]), delimiter=",", header="time_s,disk_X", comments="")
    assert main(["fit", str(raw), "--model", "whirl-whip"]) == 2
    said = capsys.readouterr().err
    assert "raw.csv looks like raw signals (200 samples of time_s, disk_X)" in said
    assert "rotorfit template raw.csv > rig.toml" in said
    bare = write_hdf5(tmp_path / "a.h5", volts(), {})
    assert main(["fit", str(bare), "--model", "whirl-whip"]) == 2
    hear(capsys.readouterr().err)
    with refuses(ValueError):
        rf.read(bare)


def test_template_from_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write_hdf5(tmp_path / "run.h5", volts())
    assert main(["template", str(path)]) == 0
    assert capsys.readouterr().out == template(path)
    assert main(["template", str(tmp_path / "none.h5")]) == 2
    assert "no such file" in capsys.readouterr().err


FIGURES = ("timebase", "orbit", "centreline", "bode", "polar", "full_spectrum", "cascade", "speed")


def test_look_subtracts_the_orbit_of_slow_turning(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A shaft that turns slowly with 12 um of run-out, and the same at speed: what is left is the vibration's alone."""
    channels, t = volts(), np.arange(volts()["disk_X"].size) / RATE
    run_out = 12e-6 * np.exp(1j * shaft_angle(t))
    slow = channels | {"disk_X": -10 + 7870 * run_out.real, "disk_Y": -10 + 7870 * run_out.imag}
    write_hdf5(tmp_path / "slow.h5", slow)
    parts = {"disk_X": run_out.real, "disk_Y": run_out.imag}
    path = write_hdf5(tmp_path / "run.h5", channels | {k: channels[k] + 7870 * v for k, v in parts.items()})
    assert main(["look", str(path), "--slow-roll", str(tmp_path / "slow.h5"), "--out", str(tmp_path / "out")]) == 0
    assert "disk_X 12 µm, disk_Y 12 µm" in capsys.readouterr().out
    for wrong in ("nothing.h5", "-300"):
        assert main(["look", str(path), f"--slow-roll={wrong}"]) == 2
        hear(capsys.readouterr().err)


def test_look_says_and_draws_what_there_is(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write_hdf5(tmp_path / "run.h5", volts())
    out = tmp_path / "figures"
    assert main(["look", str(path), "--out", str(out)]) == 0
    said = capsys.readouterr().out
    assert "run: 4.000 s at 3200 Hz, 4 channels" in said
    assert "shaft        1200.0 to 1200.0 rpm, 80 pulses" in said
    assert "m r = 20 g mm at disk, forward with the perturbator, 40.0 deg ahead of the mark" in said
    assert "nothing odd was found" in said
    names = {"cascade_disk" if name == "cascade" else name for name in FIGURES}
    assert {file.name for file in out.iterdir()} == {f"{name}.png" for name in names} | {"summary.txt", CONTENTS}


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--plane", "journal"], "unknown plane 'journal'"),
        (["--at", "9"], "--at 9 is not within run, 0 to 4 s"),
        (["--setup", "none.toml"], "No such file"),
    ],
)
def test_look_refuses_in_one_sentence_and_leaves_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], words: str
) -> None:
    path = write_hdf5(tmp_path / "run.h5", volts())
    assert main(["look", str(path), "--out", str(tmp_path / "out"), *arguments]) == 2
    said = capsys.readouterr().err
    assert words in said
    assert said.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_look_says_what_is_wrong_with_a_recording(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    channels = volts()
    channels["disk_X"] = np.minimum(channels["disk_X"], -9.7)
    whole = write_hdf5(tmp_path / "run.h5", channels, {**ATTRIBUTES, "whirl": "backward"})
    assert main(["look", str(whole)]) == 1
    said = capsys.readouterr().out
    assert "error [channel-clipped]" in said
    assert "error [whirl-reversed]" in said
    whole.write_bytes(whole.read_bytes()[:5000])
    assert main(["look", str(whole)]) == 2
    assert "run.h5 is not a readable HDF5 file: " in capsys.readouterr().err


def test_a_machine_in_operation_is_fitted_and_tables_are_refused(run: Run, tmp_path: Path) -> None:
    file = written(tmp_path / "run.h5", minutes=1.0)
    known = [word for name in ("M", "K", "Ds") for word in ("--known", f"{name}={ONE_MODE[name]}")]
    code, out, _ = run("fit", str(file), "--operating", "--model", "one-mode", *known, "--out", str(tmp_path / "out"))
    assert code == 0
    assert "operating vibration" in out
    fit = rf.load_fit(tmp_path / "out" / "fit.json")
    assert abs(fit.params["lam"].value - ONE_MODE["lam"]) < 4 * fit.params["lam"].stderr
    hear(refused(run("fit", RIG, "--operating", "--model", "whirl-whip")))
