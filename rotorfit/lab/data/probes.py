"""Correction of the errors of probes and their channels: gain, delay, run-out, and where the probes sit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from rotorfit.base.array_types import ComplexArray, Float
from rotorfit.base.digits import counted
from rotorfit.base.names import unknown_name
from rotorfit.base.units import RPM_PER_RAD_S
from rotorfit.lab.data.experiments import PerturbationTest
from rotorfit.lab.data.findings import PHASE_DATUM
from rotorfit.lab.data.linear_force import probe_pairs
from rotorfit.lab.data.rows import Experiment
from rotorfit.lab.data.synchronous import RUN_OUT_SHARE

Channel = tuple[str, str]
"""Plane and direction of a probe, ``("journal", "x")``."""


def check_channels(test: PerturbationTest, given: Mapping[Channel, Any], option: str) -> None:
    """Refuse channels that a test does not have."""
    channels = list(dict.fromkeys(zip(test.plane.tolist(), test.direction.tolist(), strict=True)))
    for key in given:
        if key not in channels:
            raise ValueError(f"{option}: {test.source} has no channel {key!r}; it has {', '.join(map(repr, channels))}")


def correct_channels(
    test: PerturbationTest, gains: Mapping[Channel, complex], delays: Mapping[Channel, float]
) -> PerturbationTest:
    """Undo gain and delay, ``response exp(j |w| tau) / gain``; z and rz at negative w are conjugated phasors."""
    check_channels(test, gains, "gains")
    check_channels(test, delays, "delays")
    if not all(np.isfinite(value) for value in delays.values()):
        raise ValueError("delays: a delay must be a finite number of seconds")
    if any(not (np.isfinite(value) and value != 0) for value in gains.values()):
        raise ValueError("gains: a gain must be finite and not zero")
    channels = list(zip(test.plane.tolist(), test.direction.tolist(), strict=True))
    gain = np.array([gains.get(channel, 1.0) for channel in channels], dtype=complex)
    delay = np.array([delays.get(channel, 0.0) for channel in channels])
    factor = np.exp(1j * np.abs(test.frequency) * delay) / gain
    conjugated = np.char.endswith(test.direction, "z") & (test.frequency < 0)
    factor = np.where(conjugated, factor.conj(), factor)
    return replace(test, response=test.response * factor, sigma=test.sigma * np.abs(factor))


def subtract_measured_slow_roll(test: PerturbationTest, below: float) -> PerturbationTest:
    """Subtract from each channel of each run of a synchronous test its run-out, from readings at low speed: what they
    tend to at rest, since unbalance moves a rotor as the square of the speed, or their mean where their speeds are too
    alike to tell that apart. What the error of a run-out adds to each reading, :data:`RUN_OUT_SHARE` keeps. A reading
    that alone is the run-out says nothing more, and is left out."""
    if not test.synchronous:
        raise ValueError(f"{test.source}: slow roll can only be taken from the readings of a synchronous test")
    keys = list(zip(test.run.tolist(), test.plane.tolist(), test.direction.tolist(), strict=True))
    _, index = np.unique(np.array(keys), axis=0, return_inverse=True)
    index = index.reshape(-1)
    slow = test.speed < below
    count = np.bincount(index, slow)
    if not count.all():
        run, plane, direction = keys[int(np.flatnonzero(count[index] == 0)[0])]
        raise ValueError(
            f"{test.source}: run {run} has no reading of {plane} {direction} below {below * RPM_PER_RAD_S:g} rpm; its "
            f"slowest is at {test.speed[test.run == run].min() * RPM_PER_RAD_S:g} rpm"
        )
    vector, share = np.zeros(count.size, dtype=complex), np.zeros(count.size)
    for channel in range(count.size):
        rows = np.flatnonzero(slow & (index == channel))
        vector[channel], share[channel] = _at_rest(test.speed[rows], test.response[rows])
    shares = np.hypot(test.attributes.get(RUN_OUT_SHARE, 0.0), share[index])
    attributes = {**test.attributes, RUN_OUT_SHARE: shares}
    itself = slow & (count[index] == 1)
    return replace(test, response=test.response - vector[index], attributes=attributes).select(~itself)


def _at_rest(speed: Float, response: ComplexArray) -> tuple[complex, float]:
    """What readings tend to at rest, and its error over that of a reading."""
    apart, few = 1.5, 3  # ratio of the squares of the speeds, and readings, from which the square tells itself apart
    rising = speed.size >= few and speed.max() ** 2 > apart * speed.min() ** 2
    square = (speed / speed.max()) ** 2 if rising else np.zeros(speed.size)
    inverse = np.linalg.pinv(np.column_stack([np.ones(speed.size), square]))
    return complex(inverse[0] @ response), float(np.linalg.norm(inverse[0]))


def resolve_probe_angles(test: PerturbationTest, angles: Mapping[str, tuple[float, float]]) -> PerturbationTest:
    """Resolve pairs of probes at other angles, which read ``cos(a) X + sin(a) Y``, into independent x and y."""
    response, sigma = test.response.copy(), test.sigma.copy()
    for plane, pair in angles.items():
        if plane not in test.planes:
            raise ValueError(f"probe angles: {unknown_name('plane', plane, test.planes)}")
        if np.shape(pair) != (2,) or not np.isfinite(pair).all():
            raise ValueError(f"probe angles: {plane} needs two angles in degrees, of its probes x and y; got {pair!r}")
        first, second = pair
        a = np.radians([first, second])
        mixing = np.column_stack([np.cos(a), np.sin(a)])
        if abs(np.linalg.det(mixing)) < 1e-3:
            raise ValueError(f"probe angles: probes at {first} and {second} degrees of {plane} see the same direction")
        inverse: Float = np.linalg.inv(mixing)
        rows, lonely = probe_pairs(test, (test.plane == plane) & np.isin(test.direction, ("x", "y")))
        if lonely.size or not rows.size:
            raise ValueError(
                f"probe angles: {counted(lonely.size, 'reading')} of {plane} without a partner in the other "
                "probe to resolve with"
            )
        response[rows] = test.response[rows] @ inverse.T
        sigma[rows] = np.sqrt(test.sigma[rows] ** 2 @ (inverse**2).T)
    return replace(test, response=response, sigma=sigma)


def at_common_zero(experiments: Sequence[Experiment], datum: float) -> tuple[Experiment, ...]:
    """Experiments with their turning forces counted from the zero of the readings, which is known then."""
    turn = np.exp(1j * datum)
    return tuple(
        replace(
            test.with_forces(lambda force: force * turn),
            findings=tuple(found for found in test.findings if found.code != PHASE_DATUM),
        )
        for test in experiments
    )
