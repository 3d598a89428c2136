"""The data check finds each slip on data that have it, names the rows, and leaves clean data alone."""

from __future__ import annotations

import re
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from checked import codes, found, rows
from clean_rigs import clean_test, random_rig
from plain import plain_fit
from scipy.stats import spearmanr
from sentences import hear, refuses
from slips import read_through, thinned
from slow_cases import slow_but
from synthetic import MODELS, SPEEDS, TYPICAL, circular_test, covering_frequencies, known_of

import rotorfit as rf
from rotorfit.identify.diagnosis.check import check
from rotorfit.identify.diagnosis.signs import rank_correlation
from rotorfit.lab.data.experiments import PerturbationTest
from rotorfit.lab.io.files import read as read_alone

Change = Callable[[PerturbationTest], PerturbationTest]


@pytest.fixture(scope="module")
def rig() -> PerturbationTest:
    """The bundled rig, made by an independent finite-element program: both planes forced, x and y, two speeds."""
    test = rf.datasets.rig_open()
    assert isinstance(test, PerturbationTest)
    return test


# ---- clean data are left alone ------------------------------------------------------------------


@pytest.mark.parametrize("name", ["rig_open", "two_disk"])
def test_nothing_about_the_bundled_rigs(name: str) -> None:
    assert check(getattr(rf.datasets, name)()) == []


@pytest.mark.parametrize("name", ["one-mode", "whirl-whip", "two-disk", "overhung", "anisotropic"])
def test_no_false_alarm_on_random_rigs(name: str) -> None:
    """100 in all; of 500 of each model none raised an error and none a warning when the limits were set."""
    tests = [clean_test(name, seed) for seed in range(20)]
    alarms = [str(f) for test in tests for f in check(test) if f.severity != "note"]
    assert alarms == []
    notes = {f.code for test in tests for f in check(test)}
    assert notes <= {"force-planes", "anisotropy"}
    assert all(("force-planes" in codes(t)) == (set(t.force_planes) < set(t.planes)) for t in tests)
    if name != "anisotropic":
        assert sum("anisotropy" in codes(t) for t in tests) <= 1


# ---- conjugated, reversed, exchanged -----------------------------------------------------------------


def conjugated(test: PerturbationTest) -> PerturbationTest:
    """The FRF conjugated at unchanged signed frequency, as lag read as lead does."""
    return replace(test, response=np.conj(test.response / test.force) * test.force)


def in_x(test: PerturbationTest) -> PerturbationTest:
    return test.select(test.direction == "x")


def combined(test: PerturbationTest) -> PerturbationTest:
    """Directional components in place of x and y."""
    x, y = test.select(test.direction == "x"), test.select(test.direction == "y")
    z = np.where(x.frequency > 0, (x.response + 1j * y.response) / 2, np.conj(x.response - 1j * y.response) / 2)
    return replace(x, response=z, direction=np.full(len(x), "z"))


def conjugated_z(test: PerturbationTest) -> PerturbationTest:
    z = combined(test)
    force = np.where(z.frequency < 0, z.force.conj(), z.force)
    return replace(z, response=np.conj(z.response / force) * force)


def exchanged(test: PerturbationTest) -> PerturbationTest:
    """The cables of x and y exchanged."""
    other = {"x": "y", "y": "x"}
    return replace(test, direction=np.array([other.get(d, d) for d in test.direction.tolist()]))


def mirrored(test: PerturbationTest) -> PerturbationTest:
    """Axes x and y exchanged for probes and force alike: the rotor seems to turn from y to x."""
    # Fx' = Fy = F sin(wt + d) = F cos(wt + d - 90 deg), Fy' = Fx: backward where it was forward
    force = test.force * np.where(test.frequency > 0, -1j, 1j)
    return replace(exchanged(test), frequency=-test.frequency, force=force)


@pytest.mark.parametrize("change", [lambda t: conjugated(in_x(t)), conjugated_z])
def test_conjugated_responses(rig: PerturbationTest, change: Change) -> None:
    test = change(rig)
    finding = found(test, "conjugated")
    assert finding.severity == "error"
    hear(finding.message)
    assert all(run in finding.message for run in test.runs[:6])
    assert finding.rows == rows(test.plane == test.force_plane)  # the drive points tell
    fit = rf.closed_form(rf.models.WhirlWhip(), test, known={"K3": 6000.0})
    assert fit.params["D"].value < 0  # what it spoils, and lam is unchanged
    assert fit.params["lam"].value == pytest.approx(0.475, rel=0.02)


def test_one_conjugated_run_is_named(rig: PerturbationTest) -> None:
    test = in_x(rig)
    bad = test.run == "journal-bwd-1000"
    test = replace(test, response=np.where(bad, conjugated(test).response, test.response))
    finding = found(test, "conjugated")
    assert finding.rows == rows(bad & (test.plane == "journal"))
    hear(finding.message)


@pytest.mark.parametrize("change", [conjugated, exchanged])
def test_responses_in_the_wrong_direction(rig: PerturbationTest, change: Change) -> None:
    finding = found(change(rig), "wrong-direction")
    assert finding.severity == "error"
    assert finding.rows == tuple(range(len(rig)))
    hear(finding.message)
    assert "conjugated" not in codes(change(rig))


def test_probes_exchanged_at_one_plane(rig: PerturbationTest) -> None:
    disk = rig.plane == "disk"
    test = replace(rig, direction=np.where(disk, exchanged(rig).direction, rig.direction))
    finding = found(test, "wrong-direction")
    assert finding.rows == rows(disk)
    hear(finding.message)


def test_frequency_sign_of_one_run(rig: PerturbationTest) -> None:
    run = rig.run == "disk-bwd-2000"
    test = replace(rig, frequency=np.where(run, -rig.frequency, rig.frequency))
    finding = found(test, "wrong-direction")
    assert finding.rows == rows(run)
    hear(finding.message)


def test_other_findings_keep_their_rows_beside_readings_that_are_not_finite(rig: PerturbationTest) -> None:
    response = rig.response.copy()
    response[3] = np.nan
    disk = rig.plane == "disk"
    test = replace(rig, response=response, direction=np.where(disk, exchanged(rig).direction, rig.direction))
    # row 3 is left out, and row 2 is the other probe at the same line, which alone tells no direction
    assert {2, 3} <= set(rows(disk))
    assert set(found(test, "wrong-direction").rows) | {2} == set(rows(disk)) - {3}


@pytest.mark.parametrize("change", [mirrored, lambda t: in_x(mirrored(t)), lambda t: combined(mirrored(t))])
def test_reversed_sense_of_rotation(rig: PerturbationTest, change: Change) -> None:
    test = change(rig)
    finding = found(test, "reversed-rotation")
    assert finding.severity == "error"
    hear(finding.message)
    concerned = test.select(np.array(finding.rows))
    assert (np.abs(concerned.frequency) < 0.5 * concerned.speed).all()
    assert (concerned.plane == concerned.force_plane).all()
    fit = rf.closed_form(rf.models.WhirlWhip(), test, known={"K3": 6000.0})
    assert fit.params["lam"].value == pytest.approx(-0.475, rel=0.02)
    assert fit.params["D"].value > 0


POWER = {
    ("one-mode", lambda t: conjugated(in_x(t)), "conjugated"): 1.0,
    ("whirl-whip", conjugated_z, "conjugated"): 1.0,
    ("two-disk", lambda t: conjugated(in_x(t)), "conjugated"): 0.8,
    ("anisotropic", conjugated_z, "conjugated"): 1.0,
    ("one-mode", exchanged, "wrong-direction"): 1.0,
    ("overhung", exchanged, "wrong-direction"): 1.0,
    ("whirl-whip", conjugated, "wrong-direction"): 1.0,
    ("one-mode", mirrored, "reversed-rotation"): 0.7,
    ("whirl-whip", mirrored, "reversed-rotation"): 0.3,
}
"""Model, slip, its code, and the share of random rigs, noise up to 5 %, in which it has to be found. Where the fluid is
weak, slow whirl is hardly driven, and light damping hides in the noise away from resonance."""


@pytest.mark.parametrize(("name", "change", "code", "share"), [(*key, share) for key, share in POWER.items()])
def test_slips_are_found_on_random_rigs(name: str, change: Change, code: str, share: float) -> None:
    tests = [change(clean_test(name, seed)) for seed in range(30)]
    assert sum(code in codes(test) for test in tests) >= share * len(tests)


# ---- amplitudes ------------------------------------------------------------------------------------


def doubled(test: PerturbationTest, some: Any) -> PerturbationTest:
    return replace(test, response=np.where(some, 2 * test.response, test.response))


def test_one_probe_peak_to_peak(rig: PerturbationTest) -> None:
    finding = found(doubled(rig, (rig.plane == "disk") & (rig.direction == "y")), "peak-to-peak")
    hear(finding.message)
    assert finding.rows == rows(rig.plane == "disk")


def test_one_probe_peak_to_peak_where_anisotropy_could_look_like_another_gain() -> None:
    """Far below any resonance a factor of 1.2 may be an anisotropic stiffness; one of two is hardly that."""
    w = np.linspace(2.0, 20.0, 60)
    model = MODELS["one-mode"]()
    theta = model.vector(TYPICAL["one-mode"])
    test = circular_test(model, theta, speeds=(100.0,), frequency=np.r_[-w[::-1], w], noise=0.003, seed=1)
    assert "peak-to-peak" in codes(doubled(test, test.direction == "y"), "warning")


@pytest.mark.parametrize("side", slow_but([1, -1], -1))
def test_one_direction_of_whirl_peak_to_peak_is_seen_by_a_fit(rig: PerturbationTest, side: int) -> None:
    test = thinned(rig, 4)
    fit = plain_fit(rf.models.WhirlWhip(), doubled(test, side * test.frequency > 0), known={"K3": 6000.0})
    assert fit.findings[0].code == "readings-scaled"
    assert fit.findings[0].severity == "error"
    assert any(f"of {'forward' if side > 0 else 'backward'} whirl are" in f.message for f in fit.findings)


def test_one_plane_peak_to_peak(rig: PerturbationTest) -> None:
    assert "peak-to-peak" in found(doubled(rig, rig.plane == "disk"), "reciprocity").message
    assert found(doubled(rig, rig.force_plane == "disk"), "reciprocity").rows == tuple(range(len(rig)))


def test_several_machines_in_one_test(rig: PerturbationTest) -> None:
    """A store and a fit would take them for one machine."""
    names = np.where(np.arange(len(rig)) % 3 == 0, "pump B", "pump A")
    finding = found(replace(rig, attributes={"machine": names}), "several-machines")
    assert finding.message.startswith("The readings are of 2 machines, pump A, pump B")
    assert rf.check(replace(rig, attributes={"machine": np.full(len(rig), "pump A")})) == rf.check(rig)


@pytest.mark.parametrize(
    ("factor", "code", "severity"),
    [
        (1e6, "large-amplitude", "error"),
        (5, "large-amplitude", "warning"),
        (25.4, "large-amplitude", "error"),
        (1e-4, "small-amplitude", "warning"),
        (1e-8, "small-amplitude", "warning"),
    ],
)
def test_amplitudes_in_another_unit(rig: PerturbationTest, factor: float, code: str, severity: str) -> None:
    test = replace(rig, response=rig.response * factor)
    finding = found(test, code)
    assert finding.severity == severity
    hear(finding.message)
    if factor > 1:
        assert finding.rows == rows(np.abs(test.response) > 5e-3)


def test_the_size_of_a_frequency_response_function_says_nothing(rig: PerturbationTest) -> None:
    """As analysers write them: metres over one newton."""
    test = replace(rig, response=1e-4 * rig.response / rig.force, force=np.ones_like(rig.force))
    assert "small-amplitude" not in {finding.code for finding in rf.check(test)}


# ---- the plan of the test ------------------------------------------------------------------------------------


def test_readings_at_once_per_turn(rig: PerturbationTest) -> None:
    near = np.flatnonzero(np.abs(np.abs(rig.frequency) / rig.speed - 1) < 0.05)[:6]
    frequency = rig.frequency.copy()
    frequency[near] = np.sign(frequency[near]) * rig.speed[near] * 1.0004
    finding = found(replace(rig, frequency=frequency), "near-1x")
    assert finding.rows == tuple(sorted(near.tolist()))
    hear(finding.message)


def test_too_few_forces_for_equation_7(rig: PerturbationTest) -> None:
    test = rig.select(rig.force_plane == "journal")
    finding = found(test, "force-planes")
    assert finding.severity == "note"
    hear(finding.message)
    with refuses(ValueError):
        rf.dynamic_stiffness(test)


def test_forces_where_nothing_is_measured(rig: PerturbationTest) -> None:
    test = rig.select((rig.force_plane == "disk") & (rig.plane == "journal"))
    hear(found(test, "measured-planes").message)


def test_one_direction_of_whirl(rig: PerturbationTest) -> None:
    message = found(rig.select(rig.frequency > 0), "one-direction").message
    assert message.startswith("All runs are forward. Backward runs separate")
    message = found(rig.select(rig.frequency < 0), "one-direction").message
    assert message.startswith("All runs are backward. Forward runs separate")


def test_runs_of_one_frequency(rig: PerturbationTest) -> None:
    run = rig.run == "disk-fwd-1000"
    first = run & (rig.frequency == rig.frequency[run][0])
    test = rig.select(~run | first)
    finding = found(test, "single-frequency")
    assert finding.rows == rows(test.run == "disk-fwd-1000")
    hear(finding.message)


def test_two_rigs_in_one_test(rig: PerturbationTest) -> None:
    own = rig.select(rig.plane == rig.force_plane)
    hear(found(own, "unconnected-planes").message)


def test_start_ups_without_partner() -> None:
    raw = rf.read(rf.datasets.path("two_disk.csv"), difference=False)
    assert isinstance(raw, PerturbationTest)
    finding = found(raw, "not-differenced")
    assert finding.rows == tuple(range(len(raw)))
    half = rf.difference_synchronous(raw.select(raw.run != "outboard-180"))
    finding = found(half, "not-differenced")
    assert finding.rows == rows(half.run == "outboard-0")


# ---- lines in which a probe was turned round ---------------------------------------------------------------------


@pytest.mark.parametrize("which", ["every other line", "upper part"])
def test_a_probe_that_was_turned_round_in_some_lines(rig: PerturbationTest, which: str) -> None:
    size = np.abs(np.round(rig.frequency, 6))
    lines = np.unique(size)
    some = lines[::2] if which == "every other line" else lines[lines.size // 4 :]
    hit = (rig.plane == "journal") & (rig.direction == "y") & np.isin(size, some)
    finding = found(replace(rig, response=np.where(hit, -rig.response, rig.response)), "turned-lines")
    assert finding.severity == "error"
    told = np.zeros(len(rig), dtype=bool)
    told[list(finding.rows)] = True
    assert (told & hit).sum() > 0.6 * hit.sum()  # of sweeps that turn into noise at their ends nothing is said
    assert not told[rig.plane == "disk"].any()


def test_backward_whirl_between_split_resonances_is_no_turned_probe() -> None:
    """Between the resonances of x and y an anisotropic rotor whirls against a forward force, with clear lines too."""
    w = np.linspace(50.0, 150.0, 600)
    x, y = (1.0 / (k - w**2 + 0.4j * w) for k in (90.0**2, 110.0**2))
    test = rf.perturbation_test(
        run="sweep",
        speed=0.0,
        frequency=np.tile(w, 2),
        force_plane="disk",
        force=1.0,
        plane="disk",
        direction=np.repeat(["x", "y"], w.size),
        response=np.concatenate([x, -1j * y]),
    )
    against = np.abs(x - y) > 4 * np.abs(x + y)
    assert against.sum() > 10
    assert "turned-lines" not in codes(test)


def test_anisotropy_is_a_note() -> None:
    finding = found(clean_test("anisotropic", 1), "anisotropy")
    assert finding.severity == "note"
    hear(finding.message)


# ---- on the command line -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "code"),
    [
        (conjugated_z, "conjugated"),
        (exchanged, "wrong-direction"),
        (mirrored, "reversed-rotation"),
        (lambda t: doubled(t, t.direction == "x"), "peak-to-peak"),
        (lambda t: t.select(t.frequency > 0), "one-direction"),
        (lambda t: t.select(np.r_[0 : len(t), 0:4]), "duplicate"),
        (lambda t: t.select(t.force_plane == "disk"), "force-planes"),
    ],
)
def test_findings_of_a_file_are_those_of_its_test_with_lines_of_the_file(
    rig: PerturbationTest, change: Change, code: str, tmp_path: Path
) -> None:
    test = change(rig)
    rf.write(test, tmp_path / "t.csv")
    found = check(read_alone(tmp_path / "t.csv"))
    told = {(one.severity, one.code, one.message) for one in found}
    assert {(one.severity, one.code, one.message) for one in check(test)} <= told
    printed = " ".join(map(str, found))
    lines = (tmp_path / "t.csv").read_text(encoding="utf-8").splitlines()
    for first, last in re.findall(r"Lines (\d+)-(\d+)", printed):  # of the file, its header and comments counted
        assert 1 < int(first) <= int(last) <= len(lines)
    assert code in {one.code for one in found}


def test_slopes_alone_are_checked_and_fitted() -> None:
    """They make no orbits to be looked at; of an overhung disk they tell the stiffness that couples both motions."""
    model, truth = MODELS["overhung"](), TYPICAL["overhung"]
    theta, speeds = model.vector(truth), SPEEDS["overhung"]
    frequency = covering_frequencies(model, theta, speeds, 40)
    test = circular_test(model, theta, speeds=speeds, frequency=frequency, noise=0.01, seed=1, sigma_known=True)
    slopes = test.select(np.char.startswith(test.direction, "r"))
    assert not check(slopes)
    coupling = plain_fit(model, slopes).params["k12"]
    assert coupling.stderr is not None
    assert abs(coupling.value - truth["k12"]) < 4 * coupling.stderr < 0.05 * abs(truth["k12"])


QUANTITIES = {"velocities": lambda w: 1j * w / 100, "accelerations": lambda w: -(w**2) / 1e4}


@pytest.mark.slow  # one of each by default in tests/identify/test_data_errors.py
@pytest.mark.parametrize(("quantity", "draws"), [(q, n) for q in QUANTITIES for n in (1, 5)])
def test_velocities_and_accelerations_are_seen_by_a_fit(quantity: str, draws: int) -> None:
    """Of random rigs, each with its own model."""
    seen, named = QUANTITIES[quantity], 0
    for name in ("one-mode", "whirl-whip", "two-disk"):
        for seed in range(draws):
            clean = clean_test(name, seed)
            model, theta, _ = random_rig(name, np.random.default_rng([seed, len(name)]))
            known = known_of(name, dict(zip(model.parameter_names, theta.tolist(), strict=True)))
            assert quantity not in {f.code for f in plain_fit(model, clean, known=known).findings}, (name, seed)
            named += quantity in {f.code for f in plain_fit(model, read_through(clean, seen), known=known).findings}
    assert named > 2 * draws


def seconds_to_check(runs: int) -> float:
    """Processor time for runs of four frequencies, read in x and y."""
    w = np.tile(np.repeat([40.0, 80.0, 120.0, 160.0], 2), runs)
    direction = np.tile(["x", "y"], 4 * runs)
    test = rf.perturbation_test(
        run=np.repeat([f"r{i}" for i in range(runs)], 8), speed=100.0, frequency=w,
        force_plane=np.full(w.size, "journal"), force=1.0, plane=np.full(w.size, "journal"), direction=direction,
        response=1e-6 / (1 - w**2 / 1e4 + 0.1j) * np.where(direction == "x", 1, -1j),
    )  # fmt: skip
    begin = time.process_time()
    check(test)
    return time.process_time() - begin


def test_the_time_of_a_check_is_in_proportion_to_the_runs() -> None:
    """Eight times the runs take 64 times as long where every run looks at all rows, and 8 times where none does."""
    assert seconds_to_check(4000) < 20 * seconds_to_check(500)


def test_ranks_of_ties_are_shared() -> None:
    """Repeats of a line have one frequency, so that their order in the file must not count."""
    rng = np.random.default_rng(4)
    for _ in range(20):
        w, quadrature = rng.integers(0, 6, size=(2, 30)).astype(float)
        assert rank_correlation(w, quadrature) == pytest.approx(spearmanr(w, quadrature).statistic, abs=1e-12)
