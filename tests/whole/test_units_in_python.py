"""One rule for units: SI without a suffix, the unit as the end of a keyword elsewhere; and one for random numbers."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from plain import plain_fit
from sentences import refuses

import rotorfit as rf

RPM, HZ = np.pi / 30, 2 * np.pi
VALUES = {"M": 1.2, "K": 8e3, "Ds": 8.0, "K0": 9e3, "D": 450.0, "lam": 0.46, "Mf": 0.4}


def simulated(**options: Any) -> Any:
    test = rf.simulate(rf.models.OneMode(), VALUES, "perturbation", force=5.0, noise=0.01, **options)
    return test.speed, test.frequency


def planned(**options: Any) -> Any:
    design = rf.Design(force_N=5.0, **options)
    return design.speeds, design.frequencies


def from_arrays(**options: Any) -> Any:
    test = rf.perturbation_test(
        run="a", force_plane="journal", force=1.0, plane="journal", direction="z", response=[1e-6, 2e-6], **options
    )
    return test.speed, test.frequency


@pytest.mark.parametrize("made", [simulated, planned, from_arrays])
def test_tests_take_speeds_and_frequencies_in_any_unit(made: Callable[..., Any]) -> None:
    speed, frequency = 1500 * RPM, np.array([400.0, 800.0]) * RPM
    same = made(speed=speed, frequency=frequency)
    for options in (
        {"speed_rpm": 1500, "frequency_rpm": [400, 800]},
        {"speed_rpm": 1500, "frequency": frequency},
        {"speed": speed, "frequency_hz": frequency / HZ},
    ):
        for one, other in zip(made(**options), same, strict=True):
            assert one == pytest.approx(other, rel=1e-12)
    with refuses(TypeError):
        made(speed=speed, speed_rpm=1500, frequency=frequency)
    with refuses(TypeError):
        made(frequency=frequency, frequency_hz=frequency / HZ, speed=speed)


def test_results_take_speeds_and_frequencies_in_any_unit(rig_fit: rf.FitResult) -> None:
    fit, speed = rig_fit, 1500 * RPM
    assert fit.natural_frequencies(speed)[-1] == fit.natural_frequencies(speed_rpm=1500)[-1]
    assert str(fit.modes(speed)) == str(fit.modes(speed_rpm=1500))
    assert fit.coefficients(speed)["Kxy"] == fit.coefficients(speed_rpm=1500)["Kxy"]
    assert str(fit.coefficient_table([speed])) == str(fit.coefficient_table(speed_rpm=[1500]))
    assert str(fit.stability_report(max_speed=speed)) == str(fit.stability_report(max_speed_rpm=1500))
    speeds = [500.0, 1000.0, 1500.0, 2000.0, 2500.0]
    inside, outside = (
        fit.to_ross(version="3.1", nodes={"journal": 3}, **given)["journal"].arguments
        for given in ({"speeds": np.multiply(speeds, RPM)}, {"speed_rpm": speeds})
    )
    assert np.asarray(inside["kxy"]) == pytest.approx(np.asarray(outside["kxy"]), rel=1e-12)
    where = {"force_plane": "disk", "plane": "journal"}
    by_si = fit.predict([100.0, -80.0], speed, **where).response
    for options in (
        {"frequency_rpm": np.array([100.0, -80.0]) / RPM, "speed_rpm": 1500},
        {"frequency_hz": np.array([100.0, -80.0]) / HZ, "speed": speed},
    ):
        assert fit.predict(**where, **options).response == pytest.approx(by_si, rel=1e-9)
    assert fit.predict(speed_rpm=[1200, 1500], mr=1e-5, **where).response.shape == (2,)
    with refuses(TypeError):
        fit.predict([100.0], **where)
    with refuses(TypeError):
        fit.natural_frequencies()
    with refuses(ValueError):
        fit.natural_frequencies(speed_rpm="fast")  # type: ignore[arg-type]


def test_random_numbers_come_from_a_seed_or_a_generator_by_either_name() -> None:
    def noise(**options: Any) -> np.ndarray:
        test = rf.simulate(
            rf.models.OneMode(), VALUES, speed_rpm=1500, frequency_rpm=[400, 800], force=5.0, noise=0.01, **options
        )
        return test.response

    assert (noise(rng=1) == noise(seed=1)).all()
    assert (noise(rng=np.random.default_rng(1)) == noise(seed=1)).all()
    assert (noise() == noise(seed=0)).all()
    with refuses(TypeError):
        noise(rng=1, seed=1)
    fit = plain_fit(rf.models.WhirlWhip(), rf.datasets.rig_lumped(), known={"K3": 6000.0})
    one, same, other = (fit.bootstrap(n=4, **given).samples for given in ({"rng": 3}, {"seed": 3}, {"rng": 4}))
    assert (one == same).all()
    assert not (one == other).all()
    drawn = fit.sample(rng=np.random.default_rng(7), walkers=32, ess=20)
    assert (fit.sample(seed=drawn.seed, walkers=32, ess=20).samples == drawn.samples).all()
