"""``rotorfit simulate`` and ``rotorfit fit --laws``: what Python gives, in files and on the terminal."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from command_words import Run

import rotorfit as rf
from rotorfit.show.plots import eccentricity, static_and_impulse

TRUTH = {"M": 1.2, "K": 2000.0, "Ds": 8.0, "K0": 9000.0, "D": 60.0, "lam": 0.46, "Mf": 0.4}
LAW = {"n_K": 2.0, "n_D": 1.4, "b": 0.5}
KNOWN = {"M": 1.2, "K": 2000.0, "Ds": 8.0}
MODEL = rf.models.OneMode(law=rf.models.Muszynska(), clearance_um=200.0)


def pairs(values: dict[str, float]) -> str:
    return ",".join(f"{name}={value}" for name, value in values.items())


RIG = ["--model", "one-mode", "--law", "muszynska", "--clearance-um", "200", "--set", pairs(TRUTH), "--set", pairs(LAW)]
SOFT = ["--model", "one-mode", "--law", "even-polynomial", "--clearance-um", "200", "--set", pairs(TRUTH),
        "--set", "K0_2=0,D_2=0,lam_2=0,K0_4=0,D_4=0,lam_4=0"]  # fmt: skip
SWEEP = ["--speed-rpm", "600", "--frequency-rpm", "400:1600:7", "--backward", "--force", "0.2,0.6,1.2"]
STATIC = ["--kind", "static-load", "--speed-rpm", "300,600", "--load", "0.5,1,2,4"]
IMPULSE = ["--kind", "impulse", "--speed-rpm", "600", "--load", "1,2", "--impulse", "1e-5"]
RANK = ["--model", "one-mode", "--clearance-um", "200", "--known", pairs(KNOWN)]


@pytest.fixture
def run(draw: Run) -> Run:
    """Run the command line in this process, with figures."""
    return draw


@pytest.fixture(scope="module")
def sweep() -> rf.PerturbationTest:
    rpm = np.linspace(400, 1600, 7)
    test = rf.simulate(
        MODEL, TRUTH | LAW, speed_rpm=600, frequency_rpm=np.r_[-rpm[::-1], rpm], force=[0.2, 0.6, 1.2], seed=1
    )
    assert isinstance(test, rf.PerturbationTest)
    return test


@pytest.mark.parametrize("suffix", [".csv", ".nc", ".mat", ".uff"])
def test_simulate_writes_what_python_simulates(
    run: Run, tmp_path: Path, sweep: rf.PerturbationTest, suffix: str
) -> None:
    file, same = tmp_path / f"sweep{suffix}", tmp_path / f"python{suffix}"
    code, out, err = run("simulate", *RIG, *SWEEP, "--seed", "1", "--out", file)
    assert (code, err) == (0, "")
    assert f"written to {file}" in out
    rf.write(sweep, same)
    mine, theirs = rf.read(file), rf.read(same)
    assert isinstance(mine, rf.PerturbationTest)
    assert isinstance(theirs, rf.PerturbationTest)
    np.testing.assert_array_equal(mine.response, theirs.response)
    np.testing.assert_array_equal(mine.sigma, theirs.sigma)
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted([file.name, same.name])
    assert run("info", file)[0] == 0


def test_files_of_several_kinds_are_one_joint_fit(run: Run, tmp_path: Path) -> None:
    files = [tmp_path / name for name in ("sweep.csv", "static.csv", "impulse.csv")]
    for file, kind in zip(files, (SWEEP, STATIC, IMPULSE), strict=True):
        assert run("simulate", *RIG, *kind, "--seed", "3", "--out", file, "--quiet") == (0, "", "")
    code, out, _ = run("fit", *files, *RIG[:6], "--known", pairs(KNOWN), "--json")
    assert code == 0
    found = json.loads(out)["parameters"]
    for name, value in (TRUTH | LAW).items():
        if name not in KNOWN:
            assert abs(found[name]["value"] - value) < 3.5 * found[name]["stderr"], name


def test_direction_of_a_load_is_that_of_the_library(run: Run, tmp_path: Path) -> None:
    """A load of a perturbation test is a complex number in Python, size and direction on the command line."""
    words = ["--speed-rpm", "600", "--frequency-rpm", "500,900", "--force", "0.01", "--load", "2", "--load-deg", "30"]
    assert run("simulate", *RIG, *words, "--noise", "0", "--out", tmp_path / "a.nc", "--quiet") == (0, "", "")
    load = 2 * np.exp(1j * np.pi / 6)
    test = rf.simulate(MODEL, TRUTH | LAW, speed_rpm=600, frequency_rpm=[500, 900], force=0.01, load=load, noise=0)
    mine = rf.read(tmp_path / "a.nc")
    for name in ("static_x_um", "static_y_um"):
        np.testing.assert_allclose(mine.attributes[name].astype(float), test.attributes[name].astype(float), rtol=1e-12)


@pytest.mark.parametrize("kind", [
    ["--kind", "squeeze-film", "--frequency-rpm", "500,900", "--unbalance", "1e-5"],
    ["--kind", "synchronous", "--speed-rpm", "300:900:4", "--unbalance", "1e-5"],
    ["--kind", "displacement", "--speed-rpm", "600", "--frequency-rpm", "500,900", "--amplitude-um", "40"],
])  # fmt: skip
def test_every_other_kind_is_written_and_described(run: Run, tmp_path: Path, kind: list[str]) -> None:
    code, out, err = run("simulate", *RIG, *kind, "--out", tmp_path / "test.csv")
    assert (code, err) == (0, "")
    assert "readings" in out
    assert len(rf.read(tmp_path / "test.csv")) > 0


@pytest.mark.parametrize(("words", "message"), [
    ([*RIG, *SWEEP, "--set", "Q=1"], "Q"),
    ([*RIG[:6], *SWEEP, "--set", "M=heavy"], "'heavy' is not a number"),
    ([*RIG, *SWEEP, "--set", "M=2"], "names M twice"),
    ([*RIG[:8], *SWEEP], "needs a value for n_K"),
    ([*RIG, *SWEEP, "--kind", "statical"], "static-load"),
    ([*RIG, *SWEEP, "--kind", "static-load"], "--frequency-rpm: a test of kind static-load takes"),
    ([*RIG, *SWEEP, "--load", "1,2"], "takes one value, got 2"),
    ([*RIG, *SWEEP, "--noise", "-1"], "noise must be zero or positive"),
    ([*RIG, *SWEEP, "--force", "0"], "finite and not zero"),
    ([*RIG, *SWEEP, "--frequency-rpm", "1:2"], "neither a number nor LO:HI:N"),
    ([*RIG, *STATIC, "--backward"], "--backward turns frequencies around"),
    ([*RIG, *SWEEP, "--speed-rpm", "9000"], "unstable at 9000 rpm"),
    ([*SOFT, *SWEEP, "--force", "20"], "wall"),  # found while integrating
    (["--model", "one-mod", *SWEEP], "one-mode"),
    (["--model", "anisotropic", *SWEEP], "--planes"),
])  # fmt: skip
def test_simulate_says_what_is_wrong_and_writes_nothing(
    run: Run, tmp_path: Path, words: list[str], message: str
) -> None:
    code, out, err = run("simulate", *words, "--out", tmp_path / "test.csv")
    assert (code, out) == (2, "")
    assert message in err
    assert not list(tmp_path.iterdir())


def test_a_file_that_cannot_be_written_is_told_and_left_alone(run: Run, tmp_path: Path) -> None:
    code, _, err = run("simulate", *RIG, *SWEEP, "--out", tmp_path / "test.xlsx")
    assert (code, ".csv" in err) == (2, True)
    code, _, err = run("simulate", *RIG, *SWEEP, "--out", tmp_path / "none" / "test.csv")
    assert (code, "no folder" in err) == (2, True)
    old = tmp_path / "test.uff"
    old.write_text("kept", encoding="utf-8")
    assert run("simulate", *RIG, *STATIC, "--out", old)[0] == 2  # universal files hold no static loads
    assert old.read_text(encoding="utf-8") == "kept"
    assert [p.name for p in tmp_path.iterdir()] == ["test.uff"]


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
