"""One run that does not go with the others is named, and nothing else is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from honest_errors import WORLDS, simulate
from plain import plain_fit
from slips import thinned

import rotorfit as rf
from rotorfit.estimators.noise.run_effects import misfit_without
from rotorfit.lab.data.experiments import PerturbationTest

ODD = "journal-bwd-2000"
Slip = Callable[[PerturbationTest], PerturbationTest]


def in_one_run(test: PerturbationTest, name: str, factor: complex) -> PerturbationTest:
    values = getattr(test, name)
    return replace(test, **{name: np.where(test.run == ODD, factor * values, values)})


SLIPS: dict[str, Slip] = {
    "speed label of another run": lambda test: in_one_run(test, "speed", 0.5),
    "phase reference 10 degrees off": lambda test: in_one_run(test, "response", np.exp(0.17j)),
}


@pytest.fixture(scope="module")
def rig() -> PerturbationTest:
    return thinned(rf.datasets.rig_open(), 2)


def said(fit: rf.FitResult) -> list[str]:
    return [text for text in fit.warnings if "disagrees with the others" in text]


def test_what_is_left_without_a_run_is_that_of_a_fit_to_the_rest() -> None:
    rng = np.random.default_rng(3)
    J = rng.normal(size=(60, 4)) + 1j * rng.normal(size=(60, 4))
    r = rng.normal(size=60) + 1j * rng.normal(size=60)
    runs = np.split(np.arange(60), [10, 30, 45])
    expected = []
    for own in runs:
        rest = np.setdiff1d(np.arange(60), own)
        A, b = np.concatenate([J[rest].real, J[rest].imag]), np.concatenate([r[rest].real, r[rest].imag])
        expected.append(np.linalg.lstsq(A, b, rcond=None)[1][0] / (b.size - 4))
    np.testing.assert_allclose(misfit_without(r, J, np.zeros(4), runs), expected, rtol=1e-10)


@pytest.mark.slow
def test_blocks_taken_in_to_follow_a_run_do_not_hide_it(rig: PerturbationTest) -> None:
    """Peak-to-peak amplitudes in one run, which thirty parameters follow half-way."""
    spoiled = in_one_run(thinned(rig, 2), "response", 2.0)
    plain = plain_fit(rf.models.WhirlWhip(), spoiled, known={"K3": 6000.0})
    assert len(said(plain)) == 1
    best = rf.refine(plain).best
    assert best.redchi > 2
    assert len(said(best)) == 1
    assert f"run {ODD} disagrees" in said(best)[0]


@pytest.mark.parametrize("slip", SLIPS)
def test_a_slip_of_one_run_is_named_with_what_the_others_would_leave(slip: str, rig: PerturbationTest) -> None:
    model, known = rf.models.WhirlWhip(), {"K3": 6000.0}
    spoiled = SLIPS[slip](rig)
    fit = plain_fit(model, spoiled, known=known)
    assert len(said(fit)) == 1
    others = plain_fit(model, spoiled.select(spoiled.run != ODD), known=known)
    name, predicted = fit.noise.run_left_out
    assert name == ODD
    assert predicted == pytest.approx(others.redchi, rel=0.25)  # by one step of Gauss-Newton


@pytest.mark.slow
def test_a_slip_that_blocks_between_planes_lay_bare_is_named_by_refinement(rig: PerturbationTest) -> None:
    """A gain 10 % off is less than what the lumped model misses; refined, nothing else is left."""
    fit = plain_fit(rf.models.WhirlWhip(), in_one_run(rig, "response", 1.1), known={"K3": 6000.0})
    assert not said(fit)
    assert ODD in said(rf.refine(fit).best)[0]


def test_a_model_that_misses_everywhere_blames_no_run(rig: PerturbationTest) -> None:
    fit = plain_fit(rf.models.WhirlWhip(), rig, known={"K3": 6000.0})
    assert fit.redchi > 4
    assert not said(fit)


@pytest.mark.parametrize("seed", range(5))
def test_runs_that_scatter_more_than_their_noise_are_not_blamed(seed: int) -> None:
    """Speeds that jitter move the run near resonance most: without it redchi would fall as much, but it is no slip."""
    world = WORLDS["speed jitter 1 %, probes 0.2 %"]
    test = simulate(world, np.random.default_rng(seed))
    fit = plain_fit(rf.models.OneMode(), test, known={name: world.truth[name] for name in ("K", "Ds")})
    assert fit.redchi > 10
    assert not said(fit)


@pytest.mark.slow
def test_what_one_run_alone_differs_by_is_said_with_its_name(rig: PerturbationTest) -> None:
    """A speed label 5 % off, which the lumped model hides and refinement lays bare."""
    fit = rf.refine(plain_fit(rf.models.WhirlWhip(), in_one_run(rig, "speed", 1.05), known={"K3": 6000.0})).best
    (effect,) = [effect for effect in fit.noise.effects if effect.kind == "run_lam"]
    assert any(f"Nearly all of it is in run {ODD}" in text for text in fit.warnings)
    error = fit.noise.runs[-1][2]  # of one run's label
    size = effect.values[effect.runs.index(ODD)] - np.median(effect.values)
    assert abs(abs(size) - 0.05) < 3 * error


@pytest.mark.slow
def test_runs_that_all_differ_blame_none() -> None:
    """Oil 1 % from run to run: of 20 draws no more say that one run has it all than chance with twelve runs allows."""
    world = WORLDS["oil 1 %, twelve runs"]
    blamed = 0
    for seed in range(20):
        test = simulate(world, np.random.default_rng(seed))
        fit = plain_fit(rf.models.OneMode(), test, known={name: world.truth[name] for name in ("K", "Ds")})
        assert any("runs differ" in text for text in fit.warnings)
        blamed += any("Nearly all of it" in text for text in fit.warnings)
    assert blamed == 0
