"""Absolute motion of a rotor by dual probes: what a proximity probe reads relative to the casing, plus the casing's.

The inertia of a rotor acts by its absolute motion. A proximity probe shows the motion relative to what holds it; where
that moves too, an accelerometer or a sensor of velocity beside the probe shows how.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TypeVar

import numpy as np

from rotorfit.base.digits import significant
from rotorfit.base.names import unknown_name
from rotorfit.base.units import RPM_PER_RAD_S
from rotorfit.lab.data.experiments import PerturbationTest
from rotorfit.lab.data.rows import Experiment
from rotorfit.lab.data.stator import lines_of

CASING = "casing"
"""Attribute of readings to which the motion of a casing was added: its plane."""
Test = TypeVar("Test", bound=Experiment)


def with_casing(test: Test, casing: Mapping[str, str] | None) -> Test:
    """The test with the casing's motion added to what probes read relative to it, the casing's planes left out; as it
    is where that has been done.

    Args:
        test: readings at the planes of the rotor and at those of the casing, along the same axes.
        casing: plane of the casing's sensors by plane of the rotor, ``{"journal": "housing"}``.
    """
    if not casing or CASING in test.attributes:
        return test
    whole = test.perturbation
    if whole is None:
        raise ValueError(
            f"{test.source or 'the test'}: casing (casing=, --casing) adds the motion of a casing to responses; this "
            f"is a {test.title}"
        )
    for plane in (*casing, *casing.values()):
        if plane not in whole.planes:
            raise ValueError(f"{test.source or 'the test'}: {unknown_name('plane of casing', plane, whole.planes)}")
    if len({*casing, *casing.values()}) < 2 * len(casing):
        raise ValueError(
            f"casing is {dict(casing)!r}; each plane of the rotor has one of the casing of its own, "
            "{'journal': 'housing'} (--casing journal=housing)"
        )
    return _added(whole, casing)  # type: ignore[return-value]


def _added(test: PerturbationTest, casing: Mapping[str, str]) -> PerturbationTest:
    keys = list(zip(test.plane.tolist(), test.direction.tolist(), lines_of(test), strict=True))
    there = {key: row for row, key in enumerate(keys)}
    own = np.array([row for row, (plane, _, _) in enumerate(keys) if plane in casing], dtype=np.intp)
    beside = np.array([there.get((casing[keys[row][0]], *keys[row][1:]), -1) for row in own.tolist()], dtype=np.intp)
    if (beside < 0).any():
        row = int(own[np.argmin(beside)])
        plane, axis, (run, _, frequency) = keys[row]
        raise ValueError(
            f"{test.source or 'the test'}: reading {row + 1}: the casing at {casing[plane]} was not read along {axis} "
            f"in run {run} at {significant(frequency * RPM_PER_RAD_S, 5)} rpm; each reading at {plane} needs its motion"
        )
    response, sigma, words = test.response.copy(), test.sigma.copy(), np.full(len(test), "", dtype=object)
    response[own] += test.response[beside]
    sigma[own] = np.hypot(test.sigma[own], test.sigma[beside])
    words[own] = [casing[keys[row][0]] for row in own.tolist()]
    whole = replace(
        test, response=response, sigma=sigma, attributes={**test.attributes, CASING: np.array(words.tolist())}
    )
    return whole.select(~np.isin(test.plane, list(casing.values())))
