"""Readings that are no measurement: not finite, zero, cut off, doubled, copied, in another unit than the speeds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from checked import codes, found, rows
from sentences import hear

import rotorfit as rf
from rotorfit.identify.diagnosis.check import check
from rotorfit.lab.data.experiments import PerturbationTest


@pytest.fixture(scope="module")
def rig() -> PerturbationTest:
    return rf.datasets.rig_open()


@pytest.mark.parametrize("column", ["response", "force", "frequency", "speed"])
def test_readings_that_are_not_finite(rig: PerturbationTest, column: str) -> None:
    values = getattr(rig, column).copy()
    values[[5, 77]] = [np.nan, np.inf]
    test = replace(rig, **{column: values})
    finding = found(test, "not-finite")
    assert finding.severity == "error"
    assert finding.rows == (5, 77)
    assert str(finding).startswith("error [not-finite] Not finite: 2 readings; remove them")
    assert " Readings 6, 78. (" in str(finding)  # counted from 1


def rounded(test: PerturbationTest, step: float) -> PerturbationTest:
    """Amplitudes rounded to so many metres."""
    size = np.round(np.abs(test.response) / step) * step
    return replace(test, response=size * np.exp(1j * np.angle(test.response)))


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
    hear(found[0].message)
    assert found[0].rows == tuple(np.flatnonzero(dead).tolist())


@pytest.mark.parametrize("share", [0.3, 0.6, 0.8])
def test_amplitudes_cut_off_at_one_value(rig: PerturbationTest, share: float) -> None:
    size = np.abs(rig.response)
    limit = share * size[rig.plane == "disk"].max()
    some = (rig.plane == "disk") & (size > limit)
    cut = replace(rig, response=np.where(some, limit / size, 1) * rig.response)
    found = [finding for finding in check(cut) if finding.code == "clipped"]
    assert [finding.severity for finding in found] == ["error"]
    hear(found[0].message)
    assert found[0].rows == tuple(np.flatnonzero(some).tolist())


@pytest.mark.parametrize("step", [1e-7, 5e-7, 1e-6, 2e-6, 5e-6])
def test_rounded_amplitudes_are_neither_holes_nor_cut_off(rig: PerturbationTest, step: float) -> None:
    """Zeros far from resonance, and flat tops of resonances, are then what was read."""
    coarse = rounded(rig, step)
    assert (coarse.response == 0).any() == (step > 2e-7)
    assert not codes(coarse) & {"zero", "clipped", "dead-probe"}


@pytest.mark.parametrize(("name", "factor"), [("frequency", 1 / 60), ("speed", 60.0)])
def test_frequencies_and_speeds_in_different_units(rig: PerturbationTest, name: str, factor: float) -> None:
    found = [f for f in check(replace(rig, **{name: getattr(rig, name) * factor})) if f.code == "frequency-unit"]
    assert [finding.severity for finding in found] == ["warning"]
    hear(found[0].message)


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
    hear(finding.message)


def test_a_run_that_is_a_copy_under_another_name(rig: PerturbationTest) -> None:
    again = rig.select(rig.run == "disk-fwd-1000")
    copy = replace(again, run=np.full(len(again), "repeat"))
    both = rf.join_runs([rig, copy])
    finding = found(both, "duplicate")
    hear(finding.message)
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
