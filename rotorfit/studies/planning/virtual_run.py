"""A virtual run of a planned test: the rotor is integrated in time, its probes are read with the planned noise."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from rotorfit.base.array_types import ComplexArray, Float, Index
from rotorfit.lab.data.experiments import PerturbationTest
from rotorfit.lab.simulation.forcing import probes
from rotorfit.lab.simulation.integration import Motion, steady_state
from rotorfit.lab.simulation.rig import VirtualRig
from rotorfit.models import RotorModel
from rotorfit.studies.planning.noise import PlannedNoise

_TOLERANCE = 1e-6
"""Error of the integration over the motion, far below what a probe reads."""


def virtual_run(
    model: RotorModel, theta: Float, test: PerturbationTest, noise: PlannedNoise, weight: Float, seed: int
) -> PerturbationTest:
    """The planned test as a rotor with given parameters, shape ``(P,)``, would fill it in. The weight of each line is
    its averaging time over that which the noise is given for."""
    rng = np.random.default_rng(seed)
    first, line = test.lines_apart
    kinds = {kind: float(sd) for kind, sd in noise.runs.items()}
    run = np.unique(test.run[first], return_inverse=True)[1].reshape(-1)
    differences = {kind: sd * rng.normal(size=run.max() + 1)[run] for kind, sd in kinds.items()}
    thetas = _of_runs(model, theta, differences, first.size)
    exact = _readings(model, thetas, test, line, first)
    exact = exact * (1 + differences.get("force", np.zeros(first.size)))[line]
    turn = differences.get("phase", np.zeros(first.size))[line]
    exact = exact * np.exp(1j * turn)

    def errors(size: Float, count: int) -> ComplexArray:
        return np.asarray(size * (rng.normal(size=count) + 1j * rng.normal(size=count)))

    jitter = errors(noise.common / np.sqrt(weight), first.size)[line]
    jitter = np.where(test.frequency < 0, jitter.conj(), jitter) if model.frame == "z" else jitter
    own = np.hypot(noise.of_rows(test), noise.share * np.abs(exact)) / np.sqrt(weight[line])
    readings = exact * (1 + jitter) + errors(own, len(test))
    return replace(test, response=readings, attributes={}, source="virtual run")


def _of_runs(model: RotorModel, theta: Float, differences: Mapping[str, Float], count: int) -> Float:
    """Parameter vectors of the lines, shape ``(L, P)``."""
    found = np.tile(theta, (count, 1))
    for kind, names in (("K0", ("K0",)), ("D", ("D",)), ("lam", ("lam", "lam_D")), ("fluid", ("K0", "D"))):
        for name in names:
            if kind in differences and name in model.parameter_names:
                found[:, model.parameter_names.index(name)] *= 1 + differences[kind]
    return found


def _readings(model: RotorModel, thetas: Float, test: PerturbationTest, line: Index, first: Index) -> ComplexArray:
    """Phasors of all probes in the steady state, by integration in time, shape ``(R,)``."""
    w, speed = test.frequency[first], test.speed[first]
    decay = np.zeros(first.size)
    force = np.zeros((first.size, len(model.coordinates)), dtype=complex)
    for plane in test.force_planes:
        at = test.force_plane[first] == plane
        force[at] = model.force_vector(plane, w[at], test.force[first][at])
    conditions, number = np.unique(np.column_stack([thetas, speed]), axis=0, return_inverse=True)
    for i, (*values, at_speed) in enumerate(conditions.tolist()):
        rig = VirtualRig(
            model=model, theta=np.array(values), noise=0.0, tolerance=_TOLERANCE, rng=np.random.default_rng(0)
        )
        decay[number.reshape(-1) == i] = rig.decay(at_speed)
    motion, turning = Motion(model=model, theta=thetas, speed=speed), w if model.frame == "z" else np.abs(w)
    steady = steady_state(motion, turning, force, decay, tolerance=_TOLERANCE)
    factors = model.functions.factors(thetas[0])
    read: dict[Any, ComplexArray] = {}
    for i, coordinate in enumerate(model.coordinates):
        forward, backward = steady.forward[:, i] * factors[i], steady.backward[:, i] * factors[i]
        for direction, values in probes(model, coordinate.axis, w, forward, backward):
            read[coordinate.plane, direction] = values
    where = zip(test.plane.tolist(), test.direction.tolist(), line.tolist(), strict=True)
    return np.array([read[plane, direction][number] for plane, direction, number in where])
