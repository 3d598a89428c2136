"""``rotorfit simulate`` and ``rotorfit fit --laws``: what Python gives, in files and on the terminal."""

from __future__ import annotations

import csv
import inspect
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_words import Run, toml_file

import rotorfit as rf
from rotorfit.apps.study_files.virtual_test import PARSERS
from rotorfit.lab.simulation.recordings import RECORDED
from rotorfit.lab.simulation.simulate import SIMULATED
from rotorfit.show.plots import eccentricity, static_and_impulse

TRUTH = {"M": 1.2, "K": 2000.0, "Ds": 8.0, "K0": 9000.0, "D": 60.0, "lam": 0.46, "Mf": 0.4}
LAW = {"n_K": 2.0, "n_D": 1.4, "b": 0.5}
KNOWN = {"M": 1.2, "K": 2000.0, "Ds": 8.0}
MODEL = rf.models.OneMode(law=rf.models.Muszynska(), clearance_um=200.0)


RIG: dict[str, Any] = {"model": "one-mode", "law": "muszynska", "clearance_um": 200, "params": TRUTH | LAW}
FLAT = dict.fromkeys(("K0_2", "D_2", "lam_2", "K0_4", "D_4", "lam_4"), 0)
SOFT = {**RIG, "law": "even-polynomial", "params": TRUTH | FLAT}
RPM = [*np.linspace(-1600, -400, 7), *np.linspace(400, 1600, 7)]
SWEEP = {"speed_rpm": 600, "frequency_rpm": RPM, "force": [0.2, 0.6, 1.2]}
STATIC = {"kind": "static-load", "speed_rpm": [300, 600], "load": [0.5, 1, 2, 4]}
IMPULSE = {"kind": "impulse", "speed_rpm": 600, "load": [1, 2], "impulse": 1e-5}
KNOWN_WORDS = ",".join(f"{name}={value}" for name, value in KNOWN.items())
RANK = ["--model", "one-mode", "--clearance-um", "200", "--known", KNOWN_WORDS]


@pytest.fixture
def run(draw: Run) -> Run:
    """Run the command line in this process, with figures."""
    return draw


@pytest.fixture
def simulated(run: Run, tmp_path: Path) -> Callable[..., tuple[int, str, str]]:
    """Run the command with a file of these keys."""

    def simulate(out: Path, *words: str, **keys: Any) -> tuple[int, str, str]:
        (tmp_path / "virtual").mkdir(exist_ok=True)
        return run("simulate", toml_file(tmp_path / "virtual" / "test.toml", **keys), "--out", out, *words)

    return simulate


@pytest.fixture(scope="module")
def sweep() -> rf.PerturbationTest:
    test = rf.simulate(MODEL, TRUTH | LAW, speed_rpm=600, frequency_rpm=RPM, force=[0.2, 0.6, 1.2], seed=1)
    assert isinstance(test, rf.PerturbationTest)
    return test


@pytest.mark.parametrize("suffix", [".csv", ".nc", ".mat", ".uff"])
def test_simulate_writes_what_python_simulates(
    run: Run, simulated: Run, tmp_path: Path, sweep: rf.PerturbationTest, suffix: str
) -> None:
    file, same = tmp_path / "out" / f"sweep{suffix}", tmp_path / "out" / f"python{suffix}"
    file.parent.mkdir()
    code, out, err = simulated(file, **RIG, test=SWEEP, seed=1)
    assert (code, err) == (0, "")
    assert f"written to {file}" in out
    rf.write(sweep, same)
    mine, theirs = rf.read(file), rf.read(same)
    assert isinstance(mine, rf.PerturbationTest)
    assert isinstance(theirs, rf.PerturbationTest)
    np.testing.assert_array_equal(mine.response, theirs.response)
    np.testing.assert_array_equal(mine.sigma, theirs.sigma)
    assert sorted(p.name for p in file.parent.iterdir()) == sorted([file.name, same.name])
    assert run("info", file)[0] == 0


def test_files_of_several_kinds_are_one_joint_fit(run: Run, simulated: Run, tmp_path: Path) -> None:
    files = [tmp_path / name for name in ("sweep.csv", "static.csv", "impulse.csv")]
    for file, kind in zip(files, (SWEEP, STATIC, IMPULSE), strict=True):
        assert simulated(file, "--quiet", **RIG, test=kind, seed=3) == (0, "", "")
    code, out, _ = run("fit", *files, *RANK, "--law", "muszynska", "--json")
    assert code == 0
    found = json.loads(out)["parameters"]
    for name, value in (TRUTH | LAW).items():
        if name not in KNOWN:
            assert abs(found[name]["value"] - value) < 3.5 * found[name]["stderr"], name


def test_direction_of_a_load_is_that_of_the_library(simulated: Run, tmp_path: Path) -> None:
    """A load of a perturbation test is a complex number in Python, size and direction in a file."""
    own = {"speed_rpm": 600, "frequency_rpm": [500, 900], "force": 0.01, "load": 2, "load_deg": 30}
    assert simulated(tmp_path / "a.nc", "--quiet", **RIG, test=own, noise=0) == (0, "", "")
    load = 2 * np.exp(1j * np.pi / 6)
    test = rf.simulate(MODEL, TRUTH | LAW, speed_rpm=600, frequency_rpm=[500, 900], force=0.01, load=load, noise=0)
    mine = rf.read(tmp_path / "a.nc")
    for name in ("static_x_um", "static_y_um"):
        np.testing.assert_allclose(mine.attributes[name].astype(float), test.attributes[name].astype(float), rtol=1e-12)


@pytest.mark.parametrize("kind", [
    {"kind": "squeeze-film", "frequency_rpm": [500, 900], "unbalance": 1e-5},
    {"kind": "synchronous", "speed_rpm": {"from": 300, "to": 900, "count": 4}, "unbalance": 1e-5},
    {"kind": "displacement", "speed_rpm": 600, "frequency_rpm": [500, 900], "amplitude_um": 40},
])  # fmt: skip
def test_every_other_kind_is_written_and_described(simulated: Run, tmp_path: Path, kind: dict[str, Any]) -> None:
    code, out, err = simulated(tmp_path / "test.csv", **RIG, test=kind)
    assert (code, err) == (0, "")
    assert "readings" in out
    assert len(rf.read(tmp_path / "test.csv")) > 0


@pytest.mark.parametrize(("keys", "message"), [
    ({"params": TRUTH | LAW | {"Q": 1}}, "Q"),
    ({"params": TRUTH | LAW | {"M": "heavy"}}, "params.M must be a number, got 'heavy'"),
    ({"params": TRUTH}, "needs a value for n_K"),
    ({"test": SWEEP | {"kind": "statical"}}, "static-load"),
    ({"test": SWEEP | {"kind": "static-load"}}, "unknown key of [test] of kind static-load 'frequency_rpm'"),
    ({"test": SWEEP | {"load": [1, 2]}}, "test.load must be a number"),
    ({"test": {"speed_rpm": 600}}, "needs frequency_rpm"),
    ({"noise": -1}, "noise must be zero or positive"),
    ({"noice": 1}, "did you mean 'noise'"),
    ({"test": SWEEP | {"force": 0}}, "finite and not zero"),
    ({"test": SWEEP | {"frequency_rpm": {"from": 1, "to": 2}}}, "{from = 100, to = 3000, count = 40}"),
    ({"test": SWEEP | {"speed_rpm": 9000}}, "unstable at 9000 rpm"),
    ({**SOFT, "test": SWEEP | {"force": 20}}, "wall"),  # found while integrating
    ({"model": "one-mod"}, "one-mode"),
    ({"model": "anisotropic"}, "planes"),
])  # fmt: skip
def test_simulate_says_what_is_wrong_and_writes_nothing(
    simulated: Run, tmp_path: Path, keys: dict[str, Any], message: str
) -> None:
    code, out, err = simulated(tmp_path / "test.csv", **{**RIG, "test": SWEEP, **keys})
    assert (code, out) == (2, "")
    assert message in err
    assert [path.name for path in tmp_path.iterdir()] == ["virtual"]


def test_every_option_of_every_kind_can_stand_in_a_file() -> None:
    types = [p.annotation for kinds in (SIMULATED, RECORDED) for one in kinds.values()
             for name, p in inspect.signature(one).parameters.items() if name != "rig"]  # fmt: skip
    assert set(types) == set(PARSERS)


def test_the_template_of_a_virtual_test_runs(run: Run, tmp_path: Path) -> None:
    code, out, _ = run("template", "simulation")
    (tmp_path / "virtual.toml").write_text(out, encoding="utf-8")
    assert (code, run("simulate", tmp_path / "virtual.toml", "--out", tmp_path / "test.csv")[0]) == (0, 0)
    fit = rf.fit(rf.models.OneMode(), rf.read(tmp_path / "test.csv"), known={"K": 8000.0, "Ds": 8.0})
    assert abs(fit.params["lam"].value - 0.46) < 3.5 * fit.params["lam"].stderr


def test_a_file_that_cannot_be_written_is_told_and_left_alone(simulated: Run, tmp_path: Path) -> None:
    code, _, err = simulated(tmp_path / "test.xlsx", **RIG, test=SWEEP)
    assert (code, ".csv" in err) == (2, True)
    code, _, err = simulated(tmp_path / "none" / "test.csv", **RIG, test=SWEEP)
    assert (code, "no folder" in err) == (2, True)
    old = tmp_path / "test.uff"
    old.write_text("kept", encoding="utf-8")
    assert simulated(old, **RIG, test=STATIC)[0] == 2  # universal files hold no static loads
    assert old.read_text(encoding="utf-8") == "kept"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["test.uff", "virtual"]


def test_a_fit_ranks_laws_and_takes_the_best(run: Run, tmp_path: Path, sweep: rf.PerturbationTest) -> None:
    rf.write(sweep, tmp_path / "sweep.csv")
    out_folder = tmp_path / "laws"
    laws = ["--laws", "constant,muszynska"]
    code, out, err = run("fit", tmp_path / "sweep.csv", *RANK, *laws, "--out", out_folder, "--no-figures")
    assert (code, err) == (0, "")
    found = rf.compare_laws(
        rf.models.OneMode(), rf.read(tmp_path / "sweep.csv"), (rf.models.Constant(), rf.models.Muszynska()),
        clearance_um=200, known=KNOWN,
    )  # fmt: skip
    assert str(found) in out
    with (out_folder / "law_comparison.csv").open(encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    assert [(row["law"], float(row["aic"])) for row in rows] == [(repr(e.law), e.aic) for e in found.laws]
    assert found.verdict in (out_folder / "summary.txt").read_text(encoding="utf-8")
    saved = rf.load_fit(out_folder / "fit.json")
    assert saved.model.options()["law"] == rf.models.Muszynska()
    study = {"files": ["sweep.csv"], "model": "one-mode", "clearance_um": 200, "known": KNOWN, "laws": ["all"]}
    written = "\n".join(f"{key} = {json.dumps(value)}" for key, value in study.items() if key != "known")
    known = "\n".join(f"{name} = {value}" for name, value in KNOWN.items())
    (tmp_path / "study.toml").write_text(f"{written}\n[known]\n{known}\n", encoding="utf-8")
    code, out, _ = run("run", tmp_path / "study.toml", "--json")
    answer = json.loads(out)
    assert (code, answer["laws"][0]["law"], len(answer["laws"])) == (0, "Muszynska()", 5)
    assert "ask for a nonlinear stiffness" in answer["verdict"]


@pytest.mark.parametrize(("words", "message"), [
    (["--model", "one-mode", "--laws", "all"], "--clearance-um"),
    ([*RANK, "--laws", "muszinska"], "muszynska"),
    ([*RANK, "--laws", "all", "--law", "muszynska"], "one of the two"),
    ([*RANK, "--laws", "all", "--known", "Q=1"], "Q"),
    ([*RANK, "--laws", "all", "--planes", "seal"], "seal"),
])  # fmt: skip
def test_a_ranking_says_what_is_wrong(
    run: Run, tmp_path: Path, sweep: rf.PerturbationTest, words: list[str], message: str
) -> None:
    rf.write(sweep, tmp_path / "sweep.csv")
    code, out, err = run("fit", tmp_path / "sweep.csv", *words, "--out", tmp_path / "laws")
    assert (code, out) == (2, "")
    assert message in err
    assert not (tmp_path / "laws").exists()


def test_figures_of_a_fit_are_its_methods(sweep: rf.PerturbationTest) -> None:
    static = rf.simulate(MODEL, TRUTH | LAW, "static-load", speed_rpm=[300, 600], load=[1.0, 2.0], seed=2)
    ring = rf.simulate(MODEL, TRUTH | LAW, "impulse", speed_rpm=600, load=[1.0, 2.0], impulse=1e-5, seed=3)
    fit = rf.fit(MODEL, [sweep, static, ring], known=KNOWN)
    for name in ("law", "nonlinear_stiffness", "static_locus", "static_stiffness", "velocity_ratio"):
        plots = static_and_impulse if hasattr(static_and_impulse, f"plot_{name}") else eccentricity
        figure, same = getattr(fit.plot, name)(), getattr(plots, f"plot_{name}")(fit)
        drawn = [line.get_xydata() for axis in figure.axes for line in axis.lines]
        again = [line.get_xydata() for axis in same.axes for line in axis.lines]
        assert drawn
        for one, other in zip(drawn, again, strict=True):
            np.testing.assert_array_equal(one, other)
