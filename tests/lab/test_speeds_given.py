"""What is no speed or frequency is refused in a sentence, wherever a result, a model or a virtual rig takes one."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from sentences import refuses

import rotorfit as rf
from rotorfit.identify.fitting.result import FitResult
from rotorfit.identify.uncertainty.posterior import Posterior
from rotorfit.models.motion.off_centre import static_equilibria
from rotorfit.models.motion.stability import growing_bands, growth_rate

NONE_SUCH = (
    math.nan,
    math.inf,
    -math.inf,
    "1500",
    "fast",
    None,
    1 + 2j,
    True,
    [],
    np.zeros(0),
    [100.0, math.nan],
    1e300,
)
GIVEN = tuple(value for value in NONE_SUCH if value is not None)  # where None is as if it were left out
SEVERAL = [100.0, 200.0]
MODEL = rf.models.WhirlWhip()
ROTOR = {"M": 1.2, "K": 8e3, "Ds": 8.0, "K0": 9e3, "D": 450.0, "lam": 0.46, "Mf": 0.4}


@pytest.fixture(scope="module")
def posterior(rig_fit: FitResult) -> Posterior:
    return rig_fit.sample(seed=1, walkers=32, ess=50)


def refused(name: str, unit: str, call: Callable[[Any], object], values: tuple[Any, ...]) -> None:
    for value in values:
        with refuses(ValueError) as error:
            call(value)
        assert unit in str(error.value)
        assert "\n" not in str(error.value)


def test_a_result_refuses_what_is_no_speed(rig_fit: FitResult) -> None:
    refused("speed", "rad/s", rig_fit.natural_frequencies, (*GIVEN, SEVERAL))


def test_a_posterior_refuses_what_is_no_speed(posterior: Posterior) -> None:
    for call in (
        posterior.modal_parameters,
        posterior.natural_frequencies,
        posterior.lam_speed,
        lambda speed: posterior.dynamic_stiffness([50.0, 90.0], speed),
    ):
        refused("speed", "rad/s", call, (*GIVEN, SEVERAL))
    refused("frequency", "rad/s", lambda frequency: posterior.dynamic_stiffness(frequency, 100.0), GIVEN)


def test_functions_of_models_refuse_what_is_no_speed(rig_fit: FitResult) -> None:
    theta = rig_fit.theta()
    one, push = rf.models.OneMode(), {"journal": 1.0}
    vector = one.vector(ROTOR)
    for call in (
        lambda speed: rf.models.eigenvalues(MODEL, theta, speed),
        lambda speed: growth_rate(MODEL, theta, speed),
        lambda speed: MODEL.coefficients(theta, speed),
        lambda speed: MODEL.motion(theta, speed),
        lambda speed: MODEL.dynamic_stiffness(theta, 50.0, speed),
        lambda speed: MODEL.receptance(theta, 50.0, speed),
        lambda speed: static_equilibria(MODEL, theta, speed, [1.0, 0.0]),
        lambda speed: rf.models.harmonic_set(one, vector, 50.0, speed, push, push),
    ):
        refused("speed", "rad/s", call, NONE_SUCH)
    for call in (
        lambda frequency: MODEL.dynamic_stiffness(theta, frequency, 100.0),
        lambda frequency: rf.models.harmonic_set(one, vector, frequency, 100.0, push, push),
    ):
        refused("frequency", "rad/s", call, NONE_SUCH)
    for call in (
        lambda speed: growing_bands(MODEL, theta, speed),
        lambda speed: rf.models.unstable_bands(rf.models.AnisotropicShaft(), np.ones(12), speed),
        lambda speed: rf.models.threshold_speed(MODEL, theta, max_speed=math.nan if speed is None else speed),
    ):
        refused("max_speed", "rad/s", call, (*NONE_SUCH, SEVERAL, 0.0, -100.0))
    for band in (math.nan, 0.0, -1.0, "1500", None, 1j):
        with refuses(ValueError):
            rf.models.threshold_speed(MODEL, theta, band=band)


def test_a_speed_against_the_axes_mirrors_the_rotor(rig_fit: FitResult) -> None:
    """A negative speed is allowed: seen from the other side forward whirl is backward."""
    ahead, back = (
        sorted(f.value for f, *_ in rig_fit.natural_frequencies(speed)) for speed in (np.float64(100.0), np.array(-100))
    )
    assert ahead == pytest.approx([-w for w in reversed(back)])


def test_an_eccentricity_that_is_none_is_refused(rig_fit: FitResult) -> None:
    for value in (math.nan, 1.0, -0.1, "0.3", 0.1j, [], [0.1, 0.2]):
        with refuses(ValueError):
            rig_fit.threshold_speed(eccentricity=value)


def test_a_virtual_rig_refuses_what_is_no_speed() -> None:
    rig, kinds = rf.models.OneMode(), ("perturbation", "displacement")
    size = {"perturbation": {"force": 5.0}, "displacement": {"amplitude_um": 10.0}}
    for kind in kinds:
        given: dict[str, Any] = size[kind]
        refused(
            "speed_rpm",
            "rpm",
            lambda speed, kind=kind, given=given: rf.simulate(
                rig, ROTOR, kind, speed_rpm=speed, frequency_rpm=[400.0], **given
            ),
            NONE_SUCH,
        )
        refused(
            "frequency_rpm",
            "rpm",
            lambda frequency, kind=kind, given=given: rf.simulate(
                rig, ROTOR, kind, speed_rpm=1500.0, frequency_rpm=frequency, **given
            ),
            NONE_SUCH,
        )
    for force in (math.inf, [], 0.0, [2.0, math.nan]):
        with refuses(ValueError):
            rf.simulate(rig, ROTOR, "perturbation", speed_rpm=1500.0, frequency_rpm=[400.0], force=force)
