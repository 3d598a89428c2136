"""Rows of a test from local responses: one for each probe at each line."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rotorfit.data.experiments import PerturbationTest, perturbation_test
from rotorfit.models.array_types import Bool, ComplexArray, Float
from rotorfit.recordings.reduction.reduced_record import is_pair

if TYPE_CHECKING:
    from rotorfit.estimators.signals.local_response import LocalResponse
    from rotorfit.recordings.recording import Recording


@dataclass(frozen=True, kw_only=True, eq=False)
class ProbeResponses:
    """Responses of one probe, output over force."""

    plane: str  # plane of the probe
    direction: str  # direction of the probe
    response: ComplexArray  # shape ``(L,)``
    sigma: Float  # standard deviation of its real part and of its imaginary part, shape ``(L,)``


def readings(record: Recording, whirl: int, found: LocalResponse, disturbance: Float) -> list[ProbeResponses]:
    """Responses to the first force, probe by probe.

    The noise of x and of y is each one's own, widened together where the orbit's component in the direction of the
    force is noisier than independent probes would make it: what disturbs the force or the phase reference moves both.
    """
    response, variance = found.response[0], found.sigma[0] ** 2
    listed: list[ProbeResponses] = []
    row = 0
    for plane in record.planes:
        if not is_pair(record, plane):
            sigma = np.sqrt(variance[row] + disturbance[row] ** 2 / 2)
            axis, factor = single_direction(record, plane, whirl)
            listed.append(ProbeResponses(plane=plane, direction=axis, response=factor * response[row], sigma=sigma))
            row += 1
            continue
        right = variance[row] + disturbance[row] ** 2 / 2
        widening = np.sqrt(np.maximum(1.0, right / ((variance[row + 2] + variance[row + 3]) / 4)))
        listed += [
            ProbeResponses(
                plane=plane, direction=axis, response=response[row + at], sigma=np.sqrt(variance[row + at]) * widening
            )
            for at, axis in ((2, "x"), (3, "y"))
        ]
        row += 4
    return listed


def single_direction(record: Recording, plane: str, whirl: int) -> tuple[str, complex]:
    """Direction of a plane's only probe, and the factor that makes a phasor there of what it reads.

    A probe that sits neither along x nor along y gives the x of a circular orbit in the direction of the force; a fit
    takes any single probe so.
    """
    angle = record.rig.rotation * float(next(probe.angle or 0.0 for probe in record.probes if probe.plane == plane))
    for axis, place in (("x", 0.0), ("y", np.pi / 2)):
        if abs(np.sin(angle - place)) < 1e-3:
            return axis, complex(np.sign(np.cos(angle - place)))
    return "x", complex(np.exp(1j * whirl * angle))


def rows(
    probes: Sequence[ProbeResponses],
    kept: Bool,
    *,
    run: str,
    frequency: Float,
    speed: Float | float,
    force_plane: str,
    force: ComplexArray,
    attributes: Mapping[str, float | str],
    force_direction: str = "circular",
    unit: Float | None = None,
) -> PerturbationTest:
    """A test of one run."""
    reference = force if unit is None else unit.astype(complex)
    speeds = np.broadcast_to(speed, frequency.shape)
    names = [(probe.plane, probe.direction) for probe in probes for _ in range(int(kept.sum()))]

    def each(values: NDArray[np.generic]) -> NDArray[np.generic]:
        return np.tile(values[kept], len(probes))

    return perturbation_test(
        run=run,
        speed=each(speeds),
        frequency=each(frequency),
        force_plane=force_plane,
        force=each(force),
        plane=[plane for plane, _ in names],
        direction=[direction for _, direction in names],
        response=np.concatenate([(probe.response * reference)[kept] for probe in probes]),
        sigma=np.concatenate([(probe.sigma * np.abs(reference))[kept] for probe in probes]),
        attributes={name: np.full(len(names), value) for name, value in attributes.items()},
        force_direction=force_direction,
        source=run,
    )
