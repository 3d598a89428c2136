"""A reference run and runs with a trial weight, as balancing records them, are start-ups that can be fitted."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from plain import plain_fit
from sentences import refuses
from synthetic import TYPICAL

import rotorfit as rf
from rotorfit.lab.data.experiments import PerturbationTest
from rotorfit.lab.data.joined import runs_apart


def test_a_start_up_without_weight_takes_the_residual_unbalance_out_of_those_with_one(tmp_path: Path) -> None:
    model = rf.models.TwoDisk()
    speed = np.linspace(60.0, 420.0, 40)
    H = model.receptance(model.vector(TYPICAL["two-disk"]), speed, speed)
    residual = model.force_vector("outboard", speed, 8e-6 * speed**2 * np.exp(0.7j))
    rows: dict[str, list[np.ndarray]] = {}
    for run, plane, weight in (("ref", "inboard", 0.0), ("in", "inboard", 2e-5), ("out", "outboard", 2e-5)):
        force = weight * speed**2 + 0j
        motion = np.einsum("lij,lj->li", H, model.force_vector(plane, speed, force) + residual)
        for number, at in enumerate(model.planes):
            cells = {"run": run, "speed": speed, "frequency": speed, "force_plane": plane, "force": force, "plane": at}
            cells |= {"direction": "z", "response": motion[:, number], "sigma": 1e-8}
            for name, cell in cells.items():
                rows.setdefault(name, []).append(np.broadcast_to(np.asarray(cell), speed.shape))
    test = rf.perturbation_test(**{name: np.concatenate(parts) for name, parts in rows.items()}, source="trial")  # type: ignore[arg-type]
    rf.write(test, tmp_path / "trial.csv")
    fit = plain_fit(model, rf.read(tmp_path / "trial.csv"))
    assert fit.success
    assert [found.code for found in fit.findings if found.severity == "error"] == []
    for name, parameter in fit.params.items():
        # the readings are exact but for the digits of the file: nothing of the residual unbalance is left in them
        assert parameter.value == pytest.approx(TYPICAL["two-disk"][name], rel=1e-4), name


def test_a_reference_run_and_a_trial_run_in_two_files_are_one_test(tmp_path: Path) -> None:
    """As monitoring systems export them: either file alone is refused or shows the residual unbalance only."""
    model = rf.models.TwoDisk()
    speed = np.linspace(60.0, 420.0, 40)
    H = model.receptance(model.vector(TYPICAL["two-disk"]), speed, speed)
    residual = model.force_vector("outboard", speed, 8e-6 * speed**2 * np.exp(0.7j))
    tests = []
    for plane, weight in (("inboard", 0.0), ("inboard", 2e-5), ("outboard", 2e-5)):
        force = weight * speed**2 + 0j
        motion = np.einsum("lij,lj->li", H, model.force_vector(plane, speed, force) + residual)
        test = rf.perturbation_test(
            run="1", speed=np.tile(speed, 2), frequency=np.tile(speed, 2), force_plane=plane, force=np.tile(force, 2),
            plane=np.repeat(model.planes, speed.size), direction="z", response=motion.T.ravel(), sigma=1e-8,
        )  # fmt: skip
        file = tmp_path / f"{plane}-{weight:g}.csv"
        rf.write(test, file)
        tests.append(rf.read(file, difference=False))
    whole = rf.join_runs(tests)
    assert sorted(set(whole.run.tolist())) == [
        "1 (inboard-2e-05) minus 1 (inboard-0)",
        "1 (outboard-2e-05) minus 1 (inboard-0)",
    ]
    fit = plain_fit(model, whole)
    for name, parameter in fit.params.items():
        assert parameter.value == pytest.approx(TYPICAL["two-disk"][name], rel=1e-4), name


def test_what_cannot_be_joined_is_refused() -> None:
    with refuses(ValueError):
        rf.join_runs([])
    with refuses(TypeError):
        rf.join_runs([rf.datasets.seal_muszynska_tum()])  # type: ignore[list-item]


def test_a_run_exported_one_file_a_probe_is_one_run() -> None:
    """A start-up without a weight and one with it, four files: differenced as those of one file."""
    rpm = np.arange(600.0, 3000.0, 50.0)
    parts = []
    for run, force in (("reference", 0.0), ("trial", 1e-5)):
        for direction in ("x", "y"):
            speed = rpm * np.pi / 30
            test = rf.perturbation_test(
                run=run, speed=speed, frequency=speed, force_plane="disk", force=force * speed**2, plane="disk",
                direction=direction, response=1e-6 + force * speed**2 * 1e-5, source=f"{run}_{direction}.csv",
            )  # fmt: skip
            parts.append(test)
    assert rf.join_runs(parts).runs == ("trial minus reference",)
    again = rf.join_runs([*parts, parts[0]], difference=False)  # a file given twice is a run of its own, and a copy
    assert len(again.runs) == 4
    assert any(finding.code == "duplicate" for finding in rf.check(again))


def days() -> tuple[list[PerturbationTest], list[PerturbationTest]]:
    """Two days' tests whose runs have the same names, the second with forces 2 % off; and with names of their own."""
    rig = rf.datasets.rig_lumped()
    rig = rig.select(np.arange(len(rig)) % 40 < 4)  # one frequency in ten
    rng = np.random.default_rng(1)
    alike = [
        replace(
            rig,
            force=factor * rig.force,
            response=rig.response + 2e-7 * (rng.normal(size=len(rig)) + 1j * rng.normal(size=len(rig))),
        )
        for factor in (1.0, 1.02)
    ]
    return alike, [replace(test, run=np.char.add(test.run, day)) for test, day in zip(alike, "ab", strict=True)]


@pytest.mark.parametrize("sources", [("day0.csv", "day1.csv"), ("rig.csv", "rig.nc"), ("rig.csv", "RIG.csv"), ("", "")])
def test_runs_of_one_name_in_several_tests_are_several_runs(sources: tuple[str, str]) -> None:
    """As one run their difference would be in no error bar: these were 19 N/m of K1, where 180 are right."""
    alike, apart = days()
    named = [replace(test, source=source) for test, source in zip(alike, sources, strict=True)]
    found, wanted = (plain_fit(rf.models.WhirlWhip(), tests, known={"K3": 6000.0}) for tests in (named, apart))
    assert any("runs differ" in warning for warning in found.warnings)
    for name in ("Md", "K1", "D"):
        assert found.params[name].stderr == pytest.approx(wanted.params[name].stderr, rel=1e-6)
    names = [run for test in found.experiments for run in test.runs]
    assert len({name.casefold() for name in names}) == len(names) == 16
    assert rf.join_runs(named).runs == tuple(names)


def test_probes_of_a_run_in_several_files_are_one_run() -> None:
    rig = rf.datasets.rig_lumped()
    parts = [replace(rig.select(rig.direction == axis), source=f"{axis}.csv") for axis in "xy"]
    assert runs_apart(parts) == tuple(parts)


@pytest.mark.filterwarnings("ignore::rotorfit.DataWarning")
def test_a_preamble_with_commas_is_no_header(tmp_path: Path) -> None:
    rows = ["Export,,", "Start-up, 1X vectors, raw", "Speed,Disk X 1X Amp,Disk X 1X Phase Lag,Disk Y 1X Amp,"
            "Disk Y 1X Phase Lag", "rpm,um pp,deg,um pp,deg"]  # fmt: skip
    rows += [f"{rpm},{rpm / 100:.2f},30,{rpm / 100:.2f},120" for rpm in range(500, 900, 50)]
    (tmp_path / "ref.csv").write_text("\n".join(rows) + "\n")
    assert len(rf.read(tmp_path / "ref.csv", difference=False)) == 16
