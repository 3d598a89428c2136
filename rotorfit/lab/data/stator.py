"""Forces without what accelerates the stator that they are applied to: F - M a, by accelerometers on the stator.

Load cells of a floating stator read what moves the stator and what the fluid takes. Probes between stator and rotor
show their relative motion: of a rotor that moves too they do not tell the stator's acceleration, as accelerometers do.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import TypeVar

import numpy as np

from rotorfit.base.array_types import ComplexArray, Float
from rotorfit.base.digits import significant
from rotorfit.base.names import unknown_name
from rotorfit.base.significance import SIGNIFICANT_ERRORS
from rotorfit.lab.data.experiments import FORCE_SIGMA, PerturbationTest, records
from rotorfit.lab.data.findings import Finding
from rotorfit.lab.data.rows import Experiment, short_source

STATOR_MASS = "stator_mass_kg"
"""Attribute of tests whose forces are F - M a."""
Test = TypeVar("Test", bound=Experiment)


def without_stator(test: Test, stator: Mapping[str, float] | None) -> Test:
    """The test with the mass of a stator times its acceleration taken off the forces, the plane of its accelerometers
    left out; as it is where that has been done. That the rotor moves too is among its findings.

    Args:
        test: forces along x and y, readings at the plane of the force and at that of the accelerometers.
        stator: mass, kg, by plane of the accelerometers, ``{"housing": 13.6}``.
    """
    if not stator or STATOR_MASS in test.attributes:
        return test
    ((plane, mass),) = _one(stator).items()
    whole = test.perturbation
    if whole is None or not whole.linear.all():
        raise ValueError(
            f"{test.source or 'the test'}: stator (stator=, --stator) takes the stator's inertia off forces that were "
            "measured along x and y; these are others"
        )
    if plane not in whole.planes or len(whole.planes) < 2:
        others = [one for one in whole.planes if one not in whole.force_planes] or list(whole.planes)
        raise ValueError(f"{test.source or 'the test'}: {unknown_name('plane of accelerometers', plane, others)}")
    accelerometers = whole.plane == plane
    motion, sigma = _by_line(whole.select(accelerometers))
    rest = whole.select(~accelerometers)
    found = _with_inertia(rest, motion, sigma, mass)
    return replace(found, findings=(*found.findings, *_of_rotor(rest, motion, sigma, plane)))  # type: ignore[return-value]


def _one(stator: Mapping[str, float]) -> Mapping[str, float]:
    if len(stator) != 1 or not all(isinstance(m, int | float) and 0 < m < math.inf for m in stator.values()):
        raise ValueError(
            f"stator is {dict(stator)!r}; it is the plane of the accelerometers with the mass in kg, "
            "{'housing': 13.6} (--stator housing=13.6)"
        )
    return stator


_Line = tuple[str, float, float]
"""Run, speed and frequency."""


def lines_of(test: PerturbationTest) -> list[_Line]:
    """Run, speed and frequency of each reading."""
    return list(zip(test.run.tolist(), test.speed.tolist(), test.frequency.tolist(), strict=True))


def _by_line(test: PerturbationTest) -> tuple[dict[_Line, dict[str, complex]], dict[_Line, float]]:
    """Motion of the stator by axis at each line, m, and its noise."""
    motion: dict[_Line, dict[str, complex]] = {}
    sigma: dict[_Line, float] = {}
    for line, axis, z, error in zip(
        lines_of(test), test.direction.tolist(), test.response.tolist(), test.sigma.tolist(), strict=True
    ):
        motion.setdefault(line, {})[axis] = z
        sigma[line] = max(sigma.get(line, 0.0), 0.0 if math.isnan(error) else error)
    return motion, sigma


def _with_inertia(
    test: PerturbationTest, motion: Mapping[_Line, Mapping[str, complex]], sigma: Mapping[_Line, float], mass: float
) -> PerturbationTest:
    """F - M a of each row, a = -w^2 z."""
    own, further = test.force.copy(), []
    for row, line in enumerate(lines_of(test)):
        if line not in motion:
            raise ValueError(
                f"{test.source or 'the test'}: reading {row + 1}: no accelerometer was read in run {line[0]} at "
                f"{significant(abs(line[2]) / (2 * math.pi), 5)} Hz; each line needs the stator's motion"
            )
        at, along = str(test.force_plane[row]), str(test.force_direction[row])
        forces = {axis: force for _, force, axis in test.acting(row)}
        for axis, z in motion[line].items():
            forces[axis] = forces.get(axis, 0j) + mass * line[2] ** 2 * z
        own[row] = forces.pop(along)
        further.append(tuple((at, force, axis) for axis, force in forces.items()))
    noise = mass * test.frequency**2 * np.array([sigma[line] for line in lines_of(test)])
    said = {FORCE_SIGMA: np.hypot(test.force_sigma, noise), STATOR_MASS: np.full(len(test), mass)}
    attributes = {**test.attributes, **said}
    return replace(test, force=own, further_forces=records(further), attributes=attributes)


def _of_rotor(
    test: PerturbationTest, motion: Mapping[_Line, Mapping[str, complex]], sigma: Mapping[_Line, float], plane: str
) -> list[Finding]:
    """Whether accelerometers and probes at the forces show one motion, or the rotor moves too."""
    lines = lines_of(test)
    there = [k for k, line in enumerate(lines) if str(test.direction[k]) in motion.get(line, {})]
    stator = np.array([motion[lines[k]][str(test.direction[k])] for k in there])
    probes: ComplexArray = test.response[there]
    noise: Float = np.hypot(np.nan_to_num(test.sigma[there]), [sigma[lines[k]] for k in there])
    weight = 1 / np.where(noise > 0, noise, np.abs(probes).max(initial=1e-12)) ** 2
    power = float(np.sum(weight * np.abs(probes) ** 2))
    share = complex(np.sum(weight * probes.conj() * (stator - probes))) / power
    left = np.abs(stator - probes - share * probes) ** 2
    error = math.sqrt(max(1.0, float(np.mean(weight * left)) / 2) / power)
    least = 0.003  # of the motion, below which sensors differ by their calibration
    if abs(share) < max(SIGNIFICANT_ERRORS * error, least):
        return []
    percent, within = (significant(100 * value, 2) for value in (abs(share), error))
    return [
        Finding(
            "note",
            "rotor-moves",
            f"{short_source(test.source) or 'the test'}: the stator moves by the accelerometers at {plane} otherwise "
            f"than by the probes at {', '.join(test.planes)}, by {percent} +- {within} % of it: the rotor moves too, "
            "if the probes read relative to it, or the sensors differ, which a dry run shows, in which the rotor "
            "stands still. "
            "Forces are F - M a, whatever the rotor does; probes must read relative to it",
        )
    ]
