"""The data check finds each slip on data that have it, names the rows, and leaves clean data alone."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from clean_rigs import clean_test
from synthetic import MODELS, SPEEDS, TYPICAL, circular_test, covering_frequencies

import rotorfit as rf
from rotorfit.checks.checklist import Finding, check, errors
from rotorfit.cli import main as cli
from rotorfit.data.experiments import DisplacementTest, Experiment, PerturbationTest, RingDownTest, StaticTest

Change = Callable[[PerturbationTest], PerturbationTest]


@pytest.fixture(scope="module")
def rig() -> PerturbationTest:
    """The bundled rig, made by an independent finite-element program: both planes forced, x and y, two speeds."""
    test = rf.datasets.rig_open()
    assert isinstance(test, PerturbationTest)
    return test


def found(test: Experiment, code: str) -> Finding:
    """The only finding of its kind."""
    findings = [finding for finding in check(test) if finding.code == code]
    assert len(findings) == 1, [str(f) for f in check(test)]
    finding = findings[0]
    assert finding.message[0].isupper()
    assert finding.message.endswith(".")
    return finding


def codes(test: Experiment, *severities: str) -> set[str]:
    return {f.code for f in check(test) if not severities or f.severity in severities}


def rows(mask: Any) -> tuple[int, ...]:
    return tuple(np.flatnonzero(mask).tolist())


# ---- clean data are left alone ------------------------------------------------------------------


@pytest.mark.parametrize("name", ["rig_open", "two_disk"])
def test_nothing_about_the_bundled_rigs(name: str) -> None:
    assert check(getattr(rf.datasets, name)()) == []


@pytest.mark.parametrize("name", ["one-mode", "whirl-whip", "two-disk", "overhung", "anisotropic"])
def test_no_false_alarm_on_forty_random_rigs(name: str) -> None:
    """200 in all; of 500 of each model none raised an error and none a warning when the limits were set."""
    tests = [clean_test(name, seed) for seed in range(40)]
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
    assert "phase_lag_deg" in finding.message
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
    assert "in journal-bwd-1000:" in finding.message


@pytest.mark.parametrize(
    "change",
    [
        conjugated, exchanged, mirrored, lambda t: conjugated(in_x(t)), conjugated_z,
        lambda t: replace(t, response=1e3 * t.response),
        lambda t: replace(t, force=np.where(t.frequency > 0, t.force, 0)),
    ],
)  # fmt: skip
def test_errors_alone_are_the_errors_among_all_findings(rig: PerturbationTest, change: Change) -> None:
    """A fit asks for errors only: in an order of its own, and without what can be no error."""
    alone = errors(change(rig))
    assert alone
    assert alone == [finding for finding in rf.check(change(rig)) if finding.severity == "error"]


@pytest.mark.parametrize("change", [conjugated, exchanged])
def test_responses_in_the_wrong_direction(rig: PerturbationTest, change: Change) -> None:
    finding = found(change(rig), "wrong-direction")
    assert finding.severity == "error"
    assert finding.rows == tuple(range(len(rig)))
    assert "in all runs" in finding.message
    assert "x and y probes exchanged" in finding.message
    assert "conjugated" not in codes(change(rig))


def test_probes_exchanged_at_one_plane(rig: PerturbationTest) -> None:
    disk = rig.plane == "disk"
    test = replace(rig, direction=np.where(disk, exchanged(rig).direction, rig.direction))
    finding = found(test, "wrong-direction")
    assert finding.rows == rows(disk)
    assert "the probes at disk: x and y exchanged" in finding.message


def test_frequency_sign_of_one_run(rig: PerturbationTest) -> None:
    run = rig.run == "disk-bwd-2000"
    test = replace(rig, frequency=np.where(run, -rig.frequency, rig.frequency))
    finding = found(test, "wrong-direction")
    assert finding.rows == rows(run)
    assert "disk-bwd-2000. Check the sign of the frequency in these runs" in finding.message


@pytest.mark.parametrize("change", [mirrored, lambda t: in_x(mirrored(t)), lambda t: combined(mirrored(t))])
def test_reversed_sense_of_rotation(rig: PerturbationTest, change: Change) -> None:
    test = change(rig)
    finding = found(test, "reversed-rotation")
    assert finding.severity == "error"
    assert "lam would be negative" in finding.message
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


def peak_to_peak(test: PerturbationTest) -> list[Finding]:
    findings = [f for f in check(test) if f.code == "peak-to-peak"]
    assert all("amplitude_um_pp" in f.message for f in findings)
    return findings


def test_one_probe_peak_to_peak(rig: PerturbationTest) -> None:
    (finding,) = peak_to_peak(doubled(rig, (rig.plane == "disk") & (rig.direction == "y")))
    assert finding.message.startswith("The x and y probes at disk differ by a factor of two")
    assert finding.rows == rows(rig.plane == "disk")


def test_one_direction_of_whirl_peak_to_peak(rig: PerturbationTest) -> None:
    for side, some in (("forward", rig.frequency > 0), ("backward", rig.frequency < 0)):
        findings = peak_to_peak(doubled(rig, some))
        assert [f.message.split(" forces")[0] for f in findings] == [
            f"Responses at {rpm} rpm are twice as large under {side}" for rpm in (1000, 2000)
        ]
        assert [f.rows for f in findings] == [rows(rig.speed == speed) for speed in np.unique(rig.speed)]


def test_one_direction_of_whirl_peak_to_peak_seen_from_one_plane(rig: PerturbationTest) -> None:
    test = clean_test("whirl-whip", 4)
    test = test.select(test.force_plane == "journal")
    findings = peak_to_peak(doubled(test, test.frequency > 0))
    assert findings
    assert all(f.message.startswith("Forward and backward responses at") for f in findings)


def test_one_plane_peak_to_peak(rig: PerturbationTest) -> None:
    (finding,) = peak_to_peak(doubled(rig, rig.force_plane == "disk"))
    assert finding.message.startswith("Reciprocal responses between disk and journal differ by a factor of two")
    assert finding.rows == tuple(range(len(rig)))


@pytest.mark.parametrize(
    ("factor", "code", "severity"),
    [
        (1e6, "large-amplitude", "error"),
        (10, "large-amplitude", "warning"),
        (1e-4, "small-amplitude", "warning"),
        (1e-8, "small-amplitude", "warning"),
    ],
)
def test_amplitudes_in_another_unit(rig: PerturbationTest, factor: float, code: str, severity: str) -> None:
    test = replace(rig, response=rig.response * factor)
    finding = found(test, code)
    assert finding.severity == severity
    assert "Check the unit" in finding.message
    if factor > 1:
        assert finding.rows == rows(np.abs(test.response) > 5e-3)


# ---- numbers that are none, doubled readings -------------------------------------------------------------


@pytest.mark.parametrize("column", ["response", "force", "frequency", "speed"])
def test_readings_that_are_not_finite(rig: PerturbationTest, column: str) -> None:
    values = getattr(rig, column).copy()
    values[[5, 77]] = [np.nan, np.inf]
    test = replace(rig, **{column: values})
    finding = found(test, "not-finite")
    assert finding.severity == "error"
    assert finding.rows == (5, 77)
    assert str(finding).startswith("error [not-finite] Not finite: 2 readings; remove them")
    assert str(finding).endswith(" Readings 6, 78.")  # counted from 1


def test_other_findings_keep_their_rows_beside_readings_that_are_not_finite(rig: PerturbationTest) -> None:
    response = rig.response.copy()
    response[3] = np.nan
    disk = rig.plane == "disk"
    test = replace(rig, response=response, direction=np.where(disk, exchanged(rig).direction, rig.direction))
    # row 3 is left out, and row 2 is the other probe at the same line, which alone tells no direction
    assert {2, 3} <= set(rows(disk))
    assert set(found(test, "wrong-direction").rows) | {2} == set(rows(disk)) - {3}


def rounded(test: PerturbationTest, step: float) -> PerturbationTest:
    """Amplitudes rounded to so many metres."""
    size = np.round(np.abs(test.response) / step) * step
    return replace(test, response=size * np.exp(1j * np.angle(test.response)))


def codes_of(test: PerturbationTest) -> set[str]:
    return {finding.code for finding in check(test)}


def test_zeros_in_the_midst_of_a_sweep(rig: PerturbationTest) -> None:
    response = rig.response.copy()
    response[40::77] = 0
    found = [finding for finding in check(replace(rig, response=response)) if finding.code == "zero"]
    assert [finding.severity for finding in found] == ["error"]
    assert found[0].rows == tuple(range(40, len(rig), 77))


def test_a_probe_that_reads_nothing_at_all(rig: PerturbationTest) -> None:
    dead = (rig.plane == "disk") & (rig.direction == "y")
    found = [f for f in check(replace(rig, response=np.where(dead, 0, rig.response))) if f.code == "dead-probe"]
    assert [finding.severity for finding in found] == ["error"]
    assert "y at disk" in found[0].message
    assert found[0].rows == tuple(np.flatnonzero(dead).tolist())


@pytest.mark.parametrize("share", [0.3, 0.6, 0.8])
def test_amplitudes_cut_off_at_one_value(rig: PerturbationTest, share: float) -> None:
    size = np.abs(rig.response)
    limit = share * size[rig.plane == "disk"].max()
    some = (rig.plane == "disk") & (size > limit)
    cut = replace(rig, response=np.where(some, limit / size, 1) * rig.response)
    found = [finding for finding in check(cut) if finding.code == "clipped"]
    assert [finding.severity for finding in found] == ["error"]
    assert "x at disk" in found[0].message
    assert found[0].rows == tuple(np.flatnonzero(some).tolist())


@pytest.mark.parametrize("step", [1e-7, 5e-7, 1e-6, 2e-6, 5e-6])
def test_rounded_amplitudes_are_neither_holes_nor_cut_off(rig: PerturbationTest, step: float) -> None:
    """Zeros far from resonance, and flat tops of resonances, are then what was read."""
    coarse = rounded(rig, step)
    assert (coarse.response == 0).any() == (step > 2e-7)
    assert not codes_of(coarse) & {"zero", "clipped", "dead-probe"}


@pytest.mark.parametrize(("name", "factor"), [("frequency", 1 / 60), ("speed", 60.0)])
def test_frequencies_and_speeds_in_different_units(rig: PerturbationTest, name: str, factor: float) -> None:
    found = [f for f in check(replace(rig, **{name: getattr(rig, name) * factor})) if f.code == "frequency-unit"]
    assert [finding.severity for finding in found] == ["warning"]
    assert "name its unit" in found[0].message


def test_speeds_that_a_spreadsheet_continued_downwards(rig: PerturbationTest) -> None:
    run = rig.select((rig.run == "disk-fwd-1000") & (rig.direction == "x"))
    filled = replace(run, speed=run.speed + np.arange(len(run)) * np.pi / 30)
    assert found(filled, "filled-speed").rows == rows(np.ones(len(run)))
    blocks = np.arange(len(run)) % (len(run) // 2)  # x and y below each other, each continued by itself
    assert found(replace(run, speed=run.speed + blocks * np.pi / 30), "filled-speed").severity == "warning"
    assert "filled-speed" not in codes(replace(run, frequency=filled.speed, speed=filled.speed))  # a start-up


def test_copies_of_readings(rig: PerturbationTest) -> None:
    order = np.r_[0:100, 7, 100 : len(rig), 250]
    finding = found(rig.select(order), "duplicate")
    assert finding.rows == (100, len(rig) + 1)
    assert "2 readings repeat" in finding.message


def test_a_run_that_is_a_copy_under_another_name(rig: PerturbationTest) -> None:
    again = rig.select(rig.run == "disk-fwd-1000")
    copy = replace(again, run=np.full(len(again), "repeat"))
    both = rf.join_runs([rig, copy])
    finding = found(both, "duplicate")
    assert "repeat is disk-fwd-1000" in finding.message
    assert finding.rows == rows(both.run == "repeat")


def test_a_second_sweep_is_no_copy(rig: PerturbationTest) -> None:
    twice = rig.select(np.r_[0 : len(rig), 0 : len(rig)])
    again = replace(twice, response=twice.response * np.r_[np.ones(len(rig)), np.full(len(rig), 1.001)])
    assert "duplicate" not in codes(again)


def test_forces_of_zero_and_noise_that_is_not_positive(rig: PerturbationTest) -> None:
    force, sigma = rig.force.copy(), np.full(len(rig), 1e-7)
    force[[2, 3]] = 0
    sigma[9] = 0.0
    test = replace(rig, force=force, sigma=sigma)
    assert found(test, "no-force").rows == (2, 3)
    assert found(test, "sigma").rows == (9,)


def test_a_test_without_readings(rig: PerturbationTest) -> None:
    assert found(rig.select(np.zeros(len(rig), dtype=bool)), "empty").severity == "error"


# ---- the plan of the test ------------------------------------------------------------------------------------


def test_readings_at_once_per_turn(rig: PerturbationTest) -> None:
    near = np.flatnonzero(np.abs(np.abs(rig.frequency) / rig.speed - 1) < 0.05)[:6]
    frequency = rig.frequency.copy()
    frequency[near] = np.sign(frequency[near]) * rig.speed[near] * 1.0004
    finding = found(replace(rig, frequency=frequency), "near-1x")
    assert finding.rows == tuple(sorted(near.tolist()))
    assert "slow_roll" in finding.message


def test_too_few_forces_for_equation_7(rig: PerturbationTest) -> None:
    test = rig.select(rig.force_plane == "journal")
    finding = found(test, "force-planes")
    assert finding.severity == "note"
    assert "No force was applied at disk: eq. (7)" in finding.message
    with pytest.raises(ValueError, match="disk"):
        rf.dynamic_stiffness(test)


def test_forces_where_nothing_is_measured(rig: PerturbationTest) -> None:
    test = rig.select((rig.force_plane == "disk") & (rig.plane == "journal"))
    assert "Forces act at disk" in found(test, "measured-planes").message


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
    assert "disk-fwd-1000" in finding.message


def test_two_rigs_in_one_test(rig: PerturbationTest) -> None:
    own = rig.select(rig.plane == rig.force_plane)
    assert "disk; journal" in found(own, "unconnected-planes").message


def test_start_ups_without_partner() -> None:
    raw = rf.read(rf.datasets.path("two_disk.csv"), difference=False)
    assert isinstance(raw, PerturbationTest)
    finding = found(raw, "not-differenced")
    assert finding.rows == tuple(range(len(raw)))
    half = rf.difference_synchronous(raw.select(raw.run != "outboard-180"))
    finding = found(half, "not-differenced")
    assert finding.rows == rows(half.run == "outboard-0")


def test_imposed_orbits() -> None:
    test = imposed()
    w = test.frequency
    assert check(test) == []
    assert codes(test.select(w > 0)) == {"one-direction"}
    assert codes(replace(test, displacement=test.displacement * 1e4)) == {"large-amplitude"}
    force = test.force_x.copy()
    force[4] = np.nan
    assert found(replace(test, force_x=force), "not-finite").rows == (4,)


def imposed() -> DisplacementTest:
    """The force of one mode in a fluid, ``K - M w^2 + j D (w - lam Omega)``, at a circular orbit, either way round."""
    w = np.r_[-100.0:-10:5, 10:100:5]
    along = (9e3 - 1.2 * w**2 + 60j * (w - 0.46 * 92.0)) * 5e-5
    phasor = np.where(w < 0, along.conj(), along)
    return DisplacementTest(
        run=np.full(w.size, "orbit"), plane=np.full(w.size, "seal"), speed=np.full(w.size, 92.0), frequency=w,
        displacement=np.full(w.size, 5e-5 + 0j), force_x=phasor, force_y=phasor * np.where(w < 0, 1j, -1j),
        sigma=np.full(w.size, np.nan),
    )  # fmt: skip


IMPOSED: dict[str, tuple[Callable[[DisplacementTest], DisplacementTest], str]] = {
    "x inverted": (lambda t: replace(t, force_x=-t.force_x), "wrong-direction"),
    "x and y exchanged": (lambda t: replace(t, force_x=t.force_y, force_y=t.force_x), "wrong-direction"),
    "lag as lead": (lambda t: replace(t, force_x=t.force_x.conj(), force_y=t.force_y.conj()), "wrong-direction"),
    "the bearing's forces": (lambda t: replace(t, force_x=-t.force_x, force_y=-t.force_y), "conjugated"),
    "unsigned frequencies": (lambda t: replace(t, frequency=np.abs(t.frequency)), "turned-lines"),
}


@pytest.mark.parametrize("slip", IMPOSED)
def test_slips_of_imposed_orbits_are_errors(slip: str) -> None:
    change, code = IMPOSED[slip]
    assert check(imposed()) == []
    assert found(change(imposed()), code).severity == "error"


def test_an_orbit_of_no_size_is_an_error_and_no_fit(recwarn: pytest.WarningsRecorder) -> None:
    test = imposed()
    test.displacement[3] = 0
    assert found(test, "no-orbit").rows == (3,)
    with pytest.raises(ValueError, match=r"the imposed orbit is zero \(rows 4\)"):
        rf.fit(rf.models.OneMode(planes=("seal",)), test, known={"K": 0.0, "Ds": 0.0})
    assert not recwarn.list


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


# ---- loads and free vibration ------------------------------------------------------------------------------------


def under_load() -> StaticTest:
    """Positions ``P / (K - j D lam Omega)`` under loads downwards, at two speeds."""
    load = np.tile([0.5, 1.0, 2.0, 4.0], 2) * -1j
    speed = np.repeat([30.0, 60.0], 4)
    return StaticTest(
        run=np.repeat(["slow", "fast"], 4), speed=speed, load_plane=np.full(8, "journal"), load=load,
        plane=np.full(8, "journal"), displacement=load / (11e3 - 1j * 60 * 0.46 * speed), sigma=np.full(8, 1e-6),
    )  # fmt: skip


def swapped(z: Any) -> Any:
    return z.imag + 1j * z.real


LOADED: dict[str, tuple[Callable[[StaticTest], StaticTest], str, str]] = {
    "load told upwards": (lambda t: replace(t, load=-t.load), "against-load", "error"),
    "positions of the other sign": (lambda t: replace(t, displacement=-t.displacement), "against-load", "error"),
    "x and y exchanged": (lambda t: replace(t, displacement=swapped(t.displacement)), "against-load", "error"),
    "x mirrored": (lambda t: replace(t, displacement=-t.displacement.conj()), "against-rotation", "warning"),
}


@pytest.mark.parametrize("slip", LOADED)
def test_positions_against_load_or_rotation(slip: str) -> None:
    change, code, severity = LOADED[slip]
    assert check(under_load()) == []
    assert found(change(under_load()), code).severity == severity


def test_a_position_without_load_is_refused_in_words(recwarn: pytest.WarningsRecorder) -> None:
    test = under_load()
    test.load[0] = 0
    assert found(test, "no-load").rows == (0,)
    with pytest.raises(ValueError, match="the load is zero in 1 rows"):
        rf.fit(rf.models.OneMode(law=rf.models.Muszynska(), clearance_um=900.0), test)
    assert not recwarn.list


def test_times_in_milliseconds_and_records_that_do_not_move() -> None:
    t = np.arange(120) * 1e-3
    z = 4e-5 * np.exp((-30 + 75j) * t)
    record = RingDownTest(
        run=np.full(t.size, "r1"), speed=np.full(t.size, 157.0), time=t, x=z.real, y=z.imag,
        eccentricity=np.full(t.size, np.nan),
    )  # fmt: skip
    assert check(record) == []
    finding = found(replace(record, time=1e3 * t), "frequency-unit")
    assert finding.severity == "warning"
    assert "time_ms" in finding.message
    assert found(replace(record, x=0 * t, y=0 * t), "ring-down").severity == "error"


def test_anisotropy_is_a_note() -> None:
    finding = found(clean_test("anisotropic", 1), "anisotropy")
    assert finding.severity == "note"
    assert "Compare with the model Anisotropic" in finding.message


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
def test_info_prints_findings(
    rig: PerturbationTest, change: Change, code: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    test = change(rig)
    rf.write(test, tmp_path / "t.csv")
    wrong = any(finding.severity == "error" for finding in check(test))
    assert cli.main(["info", str(tmp_path / "t.csv")]) == int(wrong)
    printed = " ".join(capsys.readouterr().out.split())
    for finding in check(test):
        assert " ".join(f"{finding.severity} [{finding.code}] {finding.message}".split()) in printed
    lines = (tmp_path / "t.csv").read_text(encoding="utf-8").splitlines()
    for first, last in re.findall(r"Lines (\d+)-(\d+)", printed):  # of the file, its header and comments counted
        assert 1 < int(first) <= int(last) <= len(lines)
    assert f"[{code}]" in printed


def test_info_of_a_clean_file(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["info", str(rf.datasets.path("rig_open.csv"))]) == 0
    printed = capsys.readouterr().out
    assert "[" not in printed
    assert "disk, journal" in printed


def test_slopes_alone_are_checked_and_fitted() -> None:
    """They make no orbits to be looked at; of an overhung disk they tell the stiffness that couples both motions."""
    model, truth = MODELS["overhung"](), TYPICAL["overhung"]
    theta, speeds = model.vector(truth), SPEEDS["overhung"]
    frequency = covering_frequencies(model, theta, speeds, 40)
    test = circular_test(model, theta, speeds=speeds, frequency=frequency, noise=0.01, seed=1, sigma_known=True)
    slopes = test.select(np.char.startswith(test.direction, "r"))
    assert not check(slopes)
    coupling = rf.fit(model, slopes).params["k12"]
    assert coupling.stderr is not None
    assert abs(coupling.value - truth["k12"]) < 4 * coupling.stderr < 0.05 * abs(truth["k12"])
