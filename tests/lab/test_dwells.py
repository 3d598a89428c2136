"""Dwells of a perturbator: found in a recording, estimated without the shaft's orders, with errors that hold."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest
from plain import plain_fit
from recorded import ATTRIBUTES, RATE, notch, shaft_angle, write_hdf5
from sentences import hear, refuses
from unreliable import Unreliable

import rotorfit as rf
from rotorfit.apps.cli.main import main
from rotorfit.estimators.signals.tracking import dwells
from rotorfit.lab.simulation.turning_speeds import Dwells, Sweep

RIG = rf.models.WhirlWhip()
VALUES = {"Md": 0.97, "Ds": 3.0, "K1": 14e3, "K2": 14e3, "sigma": 1.0, "Mb": 0.33, "K3": 6e3, "K0": 9e3, "D": 450.0,
          "lam": 0.475, "Mf": 0.35}  # fmt: skip
SLOW = rf.Instruments(sample_rate=3200.0)
STEPS = [400.0, 700.0, 1000.0, 1300.0, 1500.0, 1800.0, 2200.0]
"""rpm; the fifth is the shaft's own speed."""


@pytest.fixture(scope="module")
def stepped(tmp_path_factory: pytest.TempPathFactory) -> list[rf.Recording]:
    """Seven dwells in each of four recordings."""
    paths = rf.simulate_recordings(
        RIG, VALUES, tmp_path_factory.mktemp("dwells"), "dwell", frequency_rpm=STEPS, duration=3.0, instruments=SLOW
    )
    return [rf.read_recording(path) for path in paths]


@pytest.fixture(scope="module")
def test_of_dwells(stepped: list[rf.Recording]) -> rf.PerturbationTest:
    return rf.responses(stepped)


def test_dwells_are_told_from_sweeps() -> None:
    t = np.arange(0, 30, 1e-3)
    speeds = [50.0, 80.0, 200.0, 190.0]
    steps = Dwells(speeds=np.asarray(speeds, dtype=float), each=6.0)
    found = dwells(t[t < steps.duration], steps.angle(t[t < steps.duration]), steps.speed(t[t < steps.duration]))
    assert [steps.speed(t[part]).mean() for part in found] == pytest.approx(speeds, rel=1e-3)
    assert len(dwells(t, 100.0 * t + 0.05 * np.sin(t), 100.0 + 0.05 * np.cos(t))) == 1
    even = Sweep(first=20.0, last=500.0, duration=30.0)
    assert dwells(t, even.angle(t), even.speed(t)) == []
    grows = np.log(25.0) / 30  # a logarithmic sweep, slow at its beginning
    assert dwells(t, 20 / grows * np.exp(grows * t), 20 * np.exp(grows * t)) == []


def test_each_dwell_gives_a_line_with_an_error_that_holds(test_of_dwells: rf.PerturbationTest) -> None:
    """6 lines in 4 runs at 2 planes: 96 numbers, their rms known to 7 %; sigma itself to 11 % from 20 lines."""
    test, ratios = test_of_dwells, []
    for run in test.runs:
        for plane in test.planes:
            x, y = ((test.run == run) & (test.plane == plane) & (test.direction == d) for d in "xy")
            assert np.abs(test.frequency[x] * 30 / np.pi).round() == pytest.approx([w for w in STEPS if w != 1500.0])
            turned = np.sign(test.frequency[x])
            z = (test.response[x] + 1j * turned * test.response[y]) / 2
            H = RIG.receptance(RIG.vector(VALUES), test.frequency[x], test.speed[x])
            H = H[:, RIG.coordinate(plane, "z"), RIG.coordinate(str(test.force_plane[x][0]), "z")]
            exact = np.where(turned > 0, H, H.conj()) * test.force[x]
            error = (z - exact) / (np.hypot(test.sigma[x], test.sigma[y]) / 2)
            ratios += [error.real, error.imag]
    assert 0.75 < np.sqrt(np.mean(np.concatenate(ratios) ** 2)) < 1.3


def test_dwells_on_an_order_are_left_out_in_words_and_the_rest_fits(stepped: list[rf.Recording]) -> None:
    test = rf.responses(stepped)
    found = test.findings
    assert {(f.code, "1 of 7 lines left out" in f.message) for f in found} == {("lines-at-orders", True)}
    told = [name for f in found for name in f.message.partition(": ")[0].split(", ")]
    assert sorted(told) == sorted(record.name for record in stepped)  # each once, with those that say the same
    fit = plain_fit(RIG, test, known={"K3": 6e3, "sigma": 1.0})
    assert {f.message for f in test.findings} <= {f.message for f in fit.findings}  # a fit tells what recordings showed
    assert test.select(test.plane == test.plane[0]).findings == found
    for name in ("Md", "K0", "D", "lam"):
        assert abs(fit.params[name].value - VALUES[name]) < 4 * fit.params[name].stderr, name


@pytest.mark.parametrize("losses", [2, 1000])
def test_recordings_whose_worker_was_lost_are_reduced_again(
    stepped: list[rf.Recording], test_of_dwells: rf.PerturbationTest, losses: int
) -> None:
    pool = Unreliable(losses)
    said = nullcontext() if losses == 2 else pytest.warns(UserWarning, match="4 of 4 pieces of work done here")
    with said:
        again = rf.responses(stepped, executor=pool)
    assert pool.attempts == (4 + 2 if losses == 2 else 3 * 4)
    assert again.run.tolist() == test_of_dwells.run.tolist()
    np.testing.assert_array_equal(again.response, test_of_dwells.response)


@pytest.mark.slow
def test_files_are_reduced_in_processes_from_the_command_line(stepped: list[rf.Recording], tmp_path: Path) -> None:
    files = [str(record.path) for record in stepped[:2]]
    for jobs in ("1", "2"):
        assert main(["vectors", *files, "--jobs", jobs, "--out", str(tmp_path / f"{jobs}.csv"), "--quiet"]) == 0
    assert (tmp_path / "1.csv").read_text() == (tmp_path / "2.csv").read_text()
    assert main(["vectors", *files, "--jobs", "0", "--out", str(tmp_path / "0.csv"), "--quiet"]) == 2


# ---- without a mark ----

SETUP = "[perturbator]\nsteady = true\n"


def unmarked(folder: Path, frequency: float, wander: float = 0.0) -> rf.Recording:
    """A recording of 6 s without the perturbator's mark: 40 um forward beside the shaft's 30 um."""
    t = np.arange(round(6.0 * RATE)) / RATE
    rng = np.random.default_rng(5)
    phase = 2 * np.pi * frequency * t + wander * t**2
    z = 30e-6 * np.exp(1j * shaft_angle(t)) + 40e-6 * np.exp(1j * phase)
    probes = {f"disk_{a}": -10 + 7870 * p + 3e-3 * rng.normal(size=t.size) for a, p in (("X", z.real), ("Y", z.imag))}
    said = {k: v for k, v in ATTRIBUTES.items() if k != "heavy_spot_deg_ahead_of_mark"}
    (folder / "steady.toml").write_text(SETUP)
    path = write_hdf5(folder / f"at-{frequency:g}.h5", {**probes, "keyphasor_shaft": notch(shaft_angle(t))}, said)
    return rf.read_recording(path, folder / "steady.toml")


def test_a_dwell_without_a_mark_has_its_size_and_a_free_phase(tmp_path: Path) -> None:
    test = rf.responses(unmarked(tmp_path, 33.217))
    found = test.findings
    assert [finding.code for finding in found] == ["phase-datum", "steady-perturbation"]  # of responses, of a recording
    assert 'phase_offsets="common"' in found[0].message
    assert test.frequency == pytest.approx(2 * np.pi * 33.217, abs=1e-3)
    # 40 um; 0.54 um of noise in z over 19200 samples, and its share in x and y
    assert np.abs(test.response) == pytest.approx(40e-6, abs=5 * test.sigma.max())
    assert (test.sigma < 0.02e-6).all()
    assert np.abs(test.response[1] / test.response[0] + 1j) < 2e-3  # y follows x by a quarter of a turn
    two = [unmarked(tmp_path, f) for f in (27.3, 33.217)]
    with pytest.warns(rf.DataWarning):
        found = rf.responses(two).findings
    (error,) = (finding for finding in found if finding.severity == "error")
    hear(error.message)


def test_what_has_no_mark_and_is_not_steady_is_refused(tmp_path: Path) -> None:
    with refuses(ValueError):
        rf.responses(unmarked(tmp_path, 31.0, wander=0.6))
    with refuses(ValueError):
        rf.responses(unmarked(tmp_path, 20.02))


def test_a_recording_that_says_nothing_of_its_perturbator_is_told_what_to_say(tmp_path: Path) -> None:
    record = unmarked(tmp_path, 33.2)
    with refuses(ValueError):
        rf.responses(rf.read_recording(record.path))
