"""A rotor of one mode that is judged at running speed, and fits of its tests."""

from __future__ import annotations

from functools import cache

import numpy as np
from plain import plain_fit
from synthetic import circular_test

import rotorfit as rf

MODEL = rf.models.OneMode(planes=("disk",))
TRUE = {"M": 1.2, "K": 30e3, "Ds": 8.0, "K0": 8e3, "D": 60.0, "lam": 0.45, "Mf": 0.0}
KNOWN = {"K": 30e3, "Mf": 0.0, "Ds": 8.0}
SPEEDS = (100.0, 250.0)


def simulated_fit(seed: int, noise: float) -> rf.FitResult:
    w = np.linspace(40.0, 320.0, 30)
    theta = MODEL.vector(TRUE)
    test = circular_test(MODEL, theta, speeds=SPEEDS, frequency=np.r_[-w, w], noise=noise, seed=seed, sigma_known=True)
    return plain_fit(MODEL, test, known=KNOWN)


@cache
def exact() -> rf.FitResult:
    """A fit whose errors are too small to matter."""
    return simulated_fit(1000, 1e-9)
