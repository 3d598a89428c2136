"""Runs in several files, and data that the check calls an error, from the command line."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_words import toml_file
from linear_tests import linear_test
from sentences import hear
from synthetic import TYPICAL

import rotorfit as rf
from rotorfit.apps.cli.main import main


@pytest.fixture
def balancing(tmp_path: Path) -> list[Path]:
    """A reference run and two runs with a trial weight, each in a file of its own, residual unbalance in all."""
    model = rf.models.TwoDisk()
    speed = np.linspace(60.0, 420.0, 40)
    H = model.receptance(model.vector(TYPICAL["two-disk"]), speed, speed)
    residual = model.force_vector("outboard", speed, 8e-6 * speed**2 * np.exp(0.7j))
    files = []
    for name, plane, weight in (("reference", "inboard", 0.0), ("in", "inboard", 2e-5), ("out", "outboard", 2e-5)):
        force = weight * speed**2 + 0j
        motion = np.einsum("lij,lj->li", H, model.force_vector(plane, speed, force) + residual)
        test = rf.perturbation_test(
            run="1", speed=np.tile(speed, 2), frequency=np.tile(speed, 2), force_plane=plane, force=np.tile(force, 2),
            plane=np.repeat(model.planes, speed.size), direction="z", response=motion.T.ravel(), sigma=1e-8,
        )  # fmt: skip
        files.append(tmp_path / f"{name}.csv")
        rf.write(test, files[-1])
    return files


def test_joined_files_are_differenced_and_fitted(balancing: list[Path], capsys: pytest.CaptureFixture[str]) -> None:
    both = balancing[0].parent / "both.csv"
    assert main(["join", *map(str, balancing), "--out", str(both)]) == 0
    assert "160 readings in 2 runs" in capsys.readouterr().out
    fit = rf.fit(rf.models.TwoDisk(), rf.read(both))
    for name, parameter in fit.params.items():
        # the readings are exact but for the digits of the file: nothing of the residual unbalance is left in them
        assert parameter.value == pytest.approx(TYPICAL["two-disk"][name], rel=1e-4), name


def test_a_lone_reference_run_is_called_one(balancing: list[Path], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["info", str(balancing[0])]) == 0
    said = capsys.readouterr().out
    assert "warning [reference-run] This is a reference run: no reading has a force" in said
    assert "rotorfit join REFERENCE TRIAL --out BOTH.csv" in said
    assert "error" not in said
    assert main(["fit", str(balancing[0]), "--model", "two-disk"]) == 2
    hear(capsys.readouterr().err)


def test_what_cannot_be_joined_is_said(balancing: list[Path], capsys: pytest.CaptureFixture[str]) -> None:
    target = str(balancing[0].parent / "both.xyz")
    assert main(["join", *map(str, balancing), "--out", target]) == 2
    loads = balancing[0].parent / "loads.csv"
    capsys.readouterr()
    assert main(["template", "static-load"]) == 0
    loads.write_text(capsys.readouterr().out, encoding="utf-8")
    assert main(["join", str(balancing[0]), str(loads), "--out", str(balancing[0].parent / "both.csv")]) == 2
    hear(capsys.readouterr().err)


def test_no_file_that_is_joined_is_written_over(balancing: list[Path], capsys: pytest.CaptureFixture[str]) -> None:
    before = balancing[1].read_bytes()
    again = balancing[1].parent / "." / balancing[1].name
    assert main(["join", *map(str, balancing), "--out", str(again)]) == 2
    hear(capsys.readouterr().err)
    assert balancing[1].read_bytes() == before


def test_planes_that_differ_in_capitals_are_not_taken_for_two(
    balancing: list[Path], capsys: pytest.CaptureFixture[str]
) -> None:
    balancing[2].write_text(balancing[2].read_text(encoding="utf-8").replace("inboard", "Inboard"), encoding="utf-8")
    both = balancing[0].parent / "both.csv"
    assert main(["join", *map(str, balancing), "--out", str(both)]) == 2
    said = capsys.readouterr().err
    assert "plane 'inboard' of reference.csv and plane 'Inboard' of out.csv differ only in capitals" in said
    assert not both.exists()


@pytest.fixture
def misread(tmp_path: Path) -> Path:
    """A shaker along x whose test does not say so: read as a circular force, it doubles every coefficient."""
    model = rf.models.OneMode()
    theta = model.vector(TYPICAL["one-mode"])
    test = linear_test(model, theta, speed=150.0, frequency=np.linspace(30.0, 400.0, 60), along="x", noise=1e-3)
    rf.write(replace(test, force_direction=np.full(len(test), "circular")), tmp_path / "shaker.csv")
    return tmp_path / "shaker.csv"


@pytest.mark.parametrize("words", [["campaign"], ["fit", "--clearance-um", "200", "--laws", "constant"]])
def test_errors_of_the_data_are_said_and_end_with_1(
    words: list[str], misread: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command, *rest = words
    if command == "campaign":
        given = [str(toml_file(tmp_path / "study.toml", model="one-mode")), str(misread)]
    else:
        given = [str(misread), "--model", "one-mode"]
    assert main([command, *given, *rest, "--quiet"]) == 1
    *warned, last = capsys.readouterr().err.splitlines()
    assert all(line.startswith("rotorfit: warning: ") for line in warned)
    assert last.startswith("rotorfit: the check of the data calls these an error: ")
    assert "force_direction" in last


SPEEDS = np.linspace(600, 4000, 60)
RESIDUAL = 8e-6 * np.exp(0.7j)  # kg m, at outboard


@pytest.fixture
def exports(tmp_path: Path) -> list[str]:
    """Three start-ups as an analyser exports them: titles, units in a line of their own, and nothing of a weight."""
    model, speed, rng = rf.models.TwoDisk(), SPEEDS * np.pi / 30, np.random.default_rng(0)
    H = model.receptance(model.vector(TYPICAL["two-disk"]), speed, speed)
    names, words = [], []
    for name, weight in (("ref", (0, 0)), ("in", (2e-5, 0)), ("out", (0, 2e-5))):
        unbalance = np.array(weight) + np.array([0, RESIDUAL])
        motion = np.einsum("lij,j,l->li", H, unbalance, speed**2)
        read = np.stack([motion[:, 0], -1j * motion[:, 0], motion[:, 1], -1j * motion[:, 1]], axis=1)
        read = read * (1 + 0.002 * (rng.normal(size=read.shape) + 1j * rng.normal(size=read.shape)))
        lines = ["Machine: Pump 3", "Run: start-up", ""]
        head = [
            f"{plane} {way} 1X {part}"
            for plane in ("Inboard", "Outboard")
            for way in "XY"
            for part in ("Amp", "Phase Lag")
        ]
        lines += [",".join(["Speed", *head]), ",".join(["rpm", *["mil pp", "deg"] * 4])]
        for rpm, row in zip(SPEEDS, read, strict=True):
            cells = [f"{abs(z) * 2 / 25.4e-6:.5f},{-np.degrees(np.angle(z)) % 360:.3f}" for z in row]
            lines.append(",".join([f"{rpm:.2f}", *cells]))
        file = tmp_path / f"{name}.csv"
        file.write_text("\n".join(lines), encoding="utf-8")
        names.append(str(file))
        if any(weight):
            plane = "inboard" if weight[0] else "outboard"
            words += ["--constant", f"{file.name}:mr_g_mm=20,{file}:force_phase_deg=0,{file.name}:force_plane={plane}"]
    return [*names, *words]


@pytest.mark.filterwarnings("ignore:.*holds no weight")
def test_exports_without_a_weight_are_joined_with_constants_of_their_own(exports: list[str], tmp_path: Path) -> None:
    both = tmp_path / "both.csv"
    assert main(["join", *exports, "--out", str(both), "--quiet"]) == 0
    fit = rf.fit(rf.models.TwoDisk(), rf.read(both))
    for name in ("M1", "M2", "K1", "K2", "K3", "D11", "D22"):  # a test at a thousandth and less
        assert abs(fit.params[name].value - TYPICAL["two-disk"][name]) < 4 * fit.params[name].stderr, name


def test_constants_of_a_file_that_is_not_given_are_refused(
    exports: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["--constant", "other.csv:mr_g_mm=20", "--out", str(tmp_path / "both.csv")]
    assert main(["join", exports[0], *words]) == 2
    hear(capsys.readouterr().err)
    assert main(["fit", exports[0], "--model", "two-disk"]) == 2
    hear(capsys.readouterr().err)


def test_columns_of_one_file_get_names_of_their_own(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Names with spaces, commas, equals signs and colons, as a person types them; theirs first, ours behind."""
    head = {"a.csv": ("DE X, 1X (mil pp)", "DE X: lag=deg"), "b.csv": ("DE X, 1X (mil pp)", "phase b")}
    for number, (name, (size, phase)) in enumerate(head.items()):
        cells = [f"{speed},{0.1 * speed:g},{40 + number}" for speed in (1000, 1500, 2000)]
        (tmp_path / name).write_text("\n".join([f'speed_rpm,"{size}",{phase}', *cells]))
    files = [str(tmp_path / name) for name in head]
    words = ["--column", "DE X, 1X (mil pp)=de_x_mil_pp,a.csv:DE X: lag=deg=de_x_lag_deg"]
    words += ["--column", "b.csv:phase b=de_x_lag_deg"]
    both = tmp_path / "both.csv"
    assert main(["join", *files, *words, "--out", str(both), "--quiet"]) == 0
    read = rf.read(both, difference=False)
    assert isinstance(read, rf.PerturbationTest)
    expected = {
        run: 0.05 * read.speed * 30 / np.pi * 25.4e-6 * np.exp(-1j * np.radians(40 + at)) for at, run in enumerate("ab")
    }
    np.testing.assert_allclose(read.response, np.where(read.run == "a", expected["a"], expected["b"]), rtol=1e-6)
    capsys.readouterr()
    assert main(["info", files[1], "--column", "de_x_lag_deg=phase b"]) == 2
    hear(capsys.readouterr().err)
    assert main(["info", files[1], "--column", "other.csv:phase b=de_x_lag_deg"]) == 2
    hear(capsys.readouterr().err)


@pytest.mark.filterwarnings("ignore:.*holds no weight")
def test_start_ups_are_balanced_at_chosen_speeds(exports: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["balance", *exports]) == 2
    hear(capsys.readouterr().err)
    assert main(["balance", *exports, "--speeds", "1500,9000"]) == 2
    hear(capsys.readouterr().err)
    assert main(["balance", *exports, "--speeds", "1500,3200", "--json"]) == 0
    found = {row["plane"]: row for row in json.loads(capsys.readouterr().out)["weights"]}
    own = found["outboard"]
    assert own["mr_low_g_mm"] < abs(RESIDUAL) * 1e6 < own["mr_high_g_mm"]
    assert own["mr_high_g_mm"] - own["mr_low_g_mm"] < 0.5
    assert (own["force_phase_deg"] - np.degrees(np.angle(-RESIDUAL)) + 180) % 360 - 180 == pytest.approx(0, abs=1)
    assert found["inboard"]["mr_g_mm"] < 0.2
