"""Random rigs tested as people test them, without a slip: what the data check must leave alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from synthetic import MODELS, TYPICAL, circular_test, covering_frequencies

from rotorfit.lab.data.experiments import PerturbationTest
from rotorfit.models import RotorModel
from rotorfit.models.motion.stability import growth_rate

LARGEST = 200e-6
"""Peak response that the exciter is set for, m."""

SPREAD = {"sigma": 0.04, "beta1": 0.02, "beta2": 0.02}
"""Half a width, in decades, of what reciprocity and calibration keep near one; other parameters spread over one."""


def random_rig(name: str, rng: np.random.Generator) -> tuple[RotorModel, NDArray[np.float64], float]:
    """A rig within half a decade of the typical one, and a speed below 95 % of its threshold, rad/s."""
    model = MODELS[name]()
    wide = 0.15 if name == "anisotropic" else 0.5
    while True:
        values = {
            key: value * 10 ** (SPREAD.get(key, wide) * rng.uniform(-1, 1)) for key, value in TYPICAL[name].items()
        }
        theta = model.vector(values)
        speed = 10 ** rng.uniform(1.3, 2.8)
        static = np.linalg.eigvals(model.dynamic_stiffness(theta, 0.0, 0.0)).real
        if static.min() > 0 and all(growth_rate(model, theta, part * speed) < 0 for part in (0.3, 0.6, 1.0, 1 / 0.95)):
            return model, theta, speed


def clean_test(name: str, seed: int) -> PerturbationTest:
    """Both directions of whirl, all planes or the last one forced, 20 to 200 lines, noise of 0.1 to 5 %.

    No line within 2 % of the speed; the force is such that the largest response is :data:`LARGEST`.
    """
    rng = np.random.default_rng([seed, len(name)])
    model, theta, speed = random_rig(name, rng)
    speeds = (speed, 0.6 * speed) if rng.random() < 0.5 else (speed,)
    frequency = covering_frequencies(model, theta, speeds, 2 * int(rng.integers(10, 100)))
    for turn in speeds:
        frequency = frequency[np.abs(np.abs(frequency) - turn) > 0.02 * turn]
    test = circular_test(
        model,
        theta,
        speeds=speeds,
        frequency=frequency,
        noise=10 ** rng.uniform(-3, -1.3),
        seed=seed,
        force_planes=model.planes if rng.random() < 0.7 else model.planes[-1:],
        force=np.exp(2j * np.pi * rng.random()),
    )
    scale = LARGEST / np.abs(test.response).max()
    return replace(test, force=test.force * scale, response=test.response * scale)
