"""Several weights in one run, as two-plane balancing leaves the first trial weight in."""

from __future__ import annotations

import cmath
import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest
from nonlinear_rigs import POWER, WHIRL_WHIP, rig
from plain import plain_fit
from sentences import refuses

import rotorfit as rf
from rotorfit.estimators.blocks.nonlinear import OrbitResponses

HEAD = (
    "run,speed_rpm,frequency_rpm,force_plane,mr_g_mm,force_phase_lag_deg,plane,direction,amplitude_mil_pp,phase_lag_deg"
)
PROBES = ("aft,x", "aft,y", "fwd,x", "fwd,y")
READINGS = {
    "reference": ((0.68, 32), (0.56, 86), (1.94, 231), (2.07, 335)),
    "trial 1": ((1.31, 1), (1.25, 75), (0.93, 251), (1.00, 342)),
    "trial 2": ((0.54, 9), (0.52, 75), (0.81, 196), (0.90, 296)),
}
"""Feese and Grazier, Balance This! Case Histories from Difficult Balance Jobs, 33rd Turbomachinery Symposium, 2004: mil
pk-pk, degrees of lag."""
WEIGHTS = {"reference": ("aft,0,0",), "trial 1": ("aft,11.1,35",), "trial 2": ("aft,11.1,35", "fwd,3.7,135")}
"""Weights that are in during each run: the first trial weight was left in."""


def field_rows() -> list[str]:
    return [
        f"{run},3600,3600,{weight},{probe},{size},{lag}"
        for run, readings in READINGS.items()
        for probe, (size, lag) in zip(PROBES, readings, strict=True)
        for weight in WEIGHTS[run]
    ]


def written(path: Path, rows: list[str], head: str = HEAD) -> Path:
    path.write_text("\n".join([head, *rows, ""]))
    return path


def by_hand(size: float, lag: float) -> complex:
    return cmath.rect(size, -math.radians(lag))


def test_influences_of_the_field_case_are_those_computed_by_hand(tmp_path: Path) -> None:
    test = rf.read(written(tmp_path / "field.csv", field_rows()))
    assert (len(test), test.forces) == (12, ("aft", "aft + fwd"))
    found = rf.influence(test)
    assert found.planes == ("aft", "fwd")
    um = 25.4 / 2  # of a mil pk-pk, 0-pk
    for row, reference, one, two in zip(found.solved.influence, *READINGS.values(), strict=True):
        first = by_hand(*one) - by_hand(*reference)
        second = by_hand(*two) - by_hand(*one)  # the first weight is in both runs
        expected = [um * first / by_hand(11.1, 35), um * second / by_hand(3.7, 135)]
        np.testing.assert_allclose(row, expected, rtol=1e-9)
    # by hand to four digits, um/(g mm) and degrees of lead, aft x
    size, angle = np.abs(found.solved.influence[0]), np.degrees(np.angle(found.solved.influence[0]))
    np.testing.assert_allclose(size, [0.9234, 2.673], rtol=2e-4)
    np.testing.assert_allclose(angle, [59.72, -40.46], atol=0.01)
    assert "no error is known" in found.summary()


def test_weights_in_two_holes_of_a_plane_act_as_their_sum(tmp_path: Path) -> None:
    """Written a row each they are one weight; a reference run may leave the cells of its weight blank."""
    whole = by_hand(11.1, 35)
    first = by_hand(5.0, 100)
    rest = whole - first
    split = f"aft,{abs(rest)},{-math.degrees(cmath.phase(rest))}"
    rows = []
    for row in field_rows():
        if "reference" in row:
            rows.append(row.replace("aft,0,0", ",,"))
        elif "aft,11.1,35" in row:
            rows += [row.replace("aft,11.1,35", "aft,5,100"), row.replace("aft,11.1,35", split)]
        else:
            rows.append(row)
    found = rf.influence(rf.read(written(tmp_path / "split.csv", rows)))
    expected = rf.influence(rf.read(written(tmp_path / "field.csv", field_rows())))
    np.testing.assert_allclose(found.solved.influence, expected.solved.influence, rtol=1e-9)


@pytest.mark.parametrize("suffix", [".csv", ".nc", ".mat"])
def test_several_forces_are_written_and_read_again(tmp_path: Path, suffix: str) -> None:
    test = rf.read(written(tmp_path / "field.csv", field_rows()))
    rf.write(test, tmp_path / f"again{suffix}")
    again = rf.read(tmp_path / f"again{suffix}")
    assert again.run.tolist() == test.run.tolist()
    assert again.force_planes == test.force_planes
    np.testing.assert_allclose(again.forces_by_plane, test.forces_by_plane, rtol=1e-14)
    np.testing.assert_allclose(again.response, test.response, rtol=1e-14)


M = np.diag([0.73, 0.79])
K = np.array([[18900.0 + 63700.0, -63700.0], [-63700.0, 63700.0 + 22600.0]])
D = np.array([[14.2, -7.0], [-7.0, 14.8]])
NOISE = 2e-8


def start_ups(rng: np.random.Generator) -> rf.PerturbationTest:
    """A reference start-up, one with a weight inboard, one with a second weight outboard; unbalance remains in all."""
    speed = np.linspace(60.0, 420.0, 40)
    remaining = np.array([8e-6 * np.exp(0.7j), 3e-6j])
    inboard, outboard = 2e-5 * np.exp(0.3j), 1.5e-5 * np.exp(-2.1j)
    rows: dict[str, list[object]] = {}
    one = {"inboard": inboard}
    for run, weights in {"ref": {"inboard": 0j}, "one": one, "two": one | {"outboard": outboard}}.items():
        unbalance = remaining + [weights.get(plane, 0.0) for plane in ("inboard", "outboard")]
        for w in speed.tolist():
            motion = np.linalg.solve(K - w**2 * M + 1j * w * D, unbalance * w**2)
            motion = motion + NOISE * (rng.normal(size=2) + 1j * rng.normal(size=2))
            for plane, response in zip(("inboard", "outboard"), motion.tolist(), strict=True):
                for force_plane, weight in weights.items():
                    cells = {"run": run, "speed": w, "frequency": w, "force_plane": force_plane}
                    cells |= {"force": weight * w**2, "plane": plane, "response": response}
                    for name, cell in cells.items():
                        rows.setdefault(name, []).append(cell)
    return rf.perturbation_test(**rows, direction="z", sigma=NOISE, source="start-ups")  # type: ignore[arg-type]


def test_start_ups_with_a_kept_weight_are_compared_with_the_reference_and_fitted() -> None:
    test = rf.difference_synchronous(start_ups(np.random.default_rng(3)))
    assert test.runs == ("one minus ref", "two minus ref")
    fit = plain_fit(rf.models.TwoDisk(), test)
    truth = {"M1": 0.73, "M2": 0.79, "K1": 18900.0, "K2": 63700.0, "K3": 22600.0, "D11": 14.2, "D22": 14.8}
    for name, value in truth.items():
        off = (fit.params[name].value - value) / fit.params[name].stderr
        assert abs(off) < 4.5, name  # 7 of 7 within 4.5 errors in all but 5 of 100000 data sets
    # both differences contain the reference's noise, which the chi square takes as two: below 1 by up to a quarter
    assert 0.6 < fit.redchi < 1.3


def test_the_virtual_rig_keeps_weights_and_gives_the_rotor_back() -> None:
    """By integration in time, which knows nothing of the phasors that a fit solves."""
    values = {"M1": 0.73, "M2": 0.79, "K1": 18900.0, "K2": 63700.0, "K3": 22600.0}
    values |= {"D11": 14.2, "D12": 7.0, "D21": 7.0, "D22": 14.8}
    test = rf.simulate(
        rf.models.TwoDisk(), values, "synchronous", speed_rpm=np.linspace(900, 5200, 18), kept=True,
        unbalance={"inboard": 2e-4, "outboard": 1e-4}, residual={"outboard": 3e-5 + 2e-5j}, noise=0.0,
    )  # fmt: skip
    assert isinstance(test, rf.PerturbationTest)
    assert test.runs == ("reference", "inboard", "inboard + outboard")
    fit = plain_fit(rf.models.TwoDisk(), rf.difference_synchronous(test))
    for name, value in values.items():
        assert fit.params[name].value == pytest.approx(value, rel=1e-4), name  # integrated to 1e-6, resonances at 4 %
    with refuses(ValueError):
        rf.simulate(rf.models.TwoDisk(), values, "synchronous", speed_rpm=[900, 1000], unbalance=1e-4, kept=True)


def test_orbits_of_a_nonlinear_journal_are_those_of_both_weights_together() -> None:
    """Against integration in time to 1e-6, at eccentricities up to 0.8, where the orbits of two weights do not add."""
    model, theta = rig("two planes")
    weights = {"disk": 8e-4, "journal": 6e-4}
    test = rf.simulate(
        model, WHIRL_WHIP | POWER, "synchronous", speed_rpm=[600, 900, 1200], kept=True, unbalance=weights,
        residual={"disk": 1e-12}, noise=0.0,
    )  # fmt: skip
    assert isinstance(test, rf.PerturbationTest)
    both = test.select(test.several)
    given = dataclasses.replace(both, sigma=np.full(len(both), 1e-9))
    block = given.observe(model, np.zeros(len(both), dtype=np.intp))
    assert isinstance(block, OrbitResponses)
    assert block.eccentricity.max() > 0.5
    size = np.abs(block.base.measured).max()
    np.testing.assert_allclose(block.predict(theta[None]), block.base.measured, atol=1e-5 * size)


def test_a_saved_fit_keeps_several_forces(tmp_path: Path) -> None:
    test = rf.difference_synchronous(start_ups(np.random.default_rng(3)))
    fit = plain_fit(rf.models.TwoDisk(), test)
    fit.save(tmp_path / "fit.json")
    (again,) = rf.load_fit(tmp_path / "fit.json").experiments
    assert isinstance(again, rf.PerturbationTest)
    np.testing.assert_array_equal(again.forces_by_plane, test.forces_by_plane)


ROWS = field_rows()
AWKWARD = {
    "one reading differs": (
        [row.replace("fwd,3.7,135,aft,x,0.54", "fwd,3.7,135,aft,x,0.55") for row in ROWS],
        "this reading of aft x stands under aft alone",
    ),
    "second row left empty": (
        [row.replace(",0.54,9", ",0.54,") if "fwd,3.7" in row else row for row in ROWS],
        "If both acted at once, write the reading in both rows",
    ),
    "phase of a weight missing": (
        [row.replace("fwd,3.7,135", "fwd,3.7,") for row in ROWS],
        "a blank cell where a finite number is needed",
    ),
    "two amounts at one plane": (
        [*ROWS, *[row.replace("fwd,3.7,135", "fwd,3.9,135") for row in ROWS if "fwd,3.7" in row]],
        "write two weights at one angle as one, their sum",
    ),
    "one probe with both holes, the others with one": (
        [*ROWS, *[row.replace("aft,11.1,35", "aft,3,90") for row in ROWS if "trial 1" in row][:1]],
        "in run trial 1 forces act at aft and aft at once, but this reading of aft y stands under aft alone",
    ),
    "name of a plane mistyped": ([row.replace("fwd,3.7", "Fwd,3.7") for row in ROWS], "differ only in capitals"),
    "run without name": (
        [row.split(",", 1)[1] for row in ROWS],
        "add a column run that says whether they acted at once",
    ),
}


@pytest.mark.parametrize(("rows", "sentence"), AWKWARD.values(), ids=list(AWKWARD))
def test_awkward_tables_are_one_sentence(rows: list[str], sentence: str, tmp_path: Path) -> None:
    head = HEAD if rows[0].count(",") == HEAD.count(",") else HEAD.split(",", 1)[1]
    path = written(tmp_path / "awkward.csv", rows, head)
    with refuses(ValueError) as caught:
        rf.read(path)
    assert sentence in str(caught.value)
    assert "\n" not in str(caught.value)


def test_what_does_not_take_several_forces_says_so(tmp_path: Path) -> None:
    test = start_ups(np.random.default_rng(3))
    weighted = test.select(test.force != 0)
    with refuses(ValueError):
        rf.write(weighted, tmp_path / "t.uff")
    with refuses(ValueError):
        rf.observed_stiffness(test)
    with refuses(ValueError):
        rf.dynamic_stiffness(test)
