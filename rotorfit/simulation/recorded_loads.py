"""Recorded tests with constant loads and blows: static positions, hammers with and without a load cell, releases."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from rotorfit.models.array_types import ComplexArray, Float
from rotorfit.simulation.instruments import Played
from rotorfit.simulation.loads import rest_under
from rotorfit.simulation.recorded_rig import Force, RecordedRig
from rotorfit.simulation.rig import rates_rpm
from rotorfit.units import RAD_S_PER_RPM as RPM


def impulse(
    rig: RecordedRig,
    *,
    speed_rpm: ArrayLike = 1500.0,
    impulse: float = 0.02,
    plane: str | None = None,
    blows: int = 4,
    apart: float = 2.0,
) -> Iterator[Played]:
    """Blows of a hammer, 4 ms each."""
    for played, where, _ in _struck(rig, "blows", speed_rpm, impulse, plane, blows, apart):
        yield replace(played, attributes={**played.attributes, "impulse_plane": where})


def hammer(
    rig: RecordedRig,
    *,
    speed_rpm: ArrayLike = 1500.0,
    impulse: float = 0.05,
    plane: str | None = None,
    blows: int = 12,
    apart: float = 2.0,
) -> Iterator[Played]:
    """Blows along x of a hammer whose force is measured."""
    for played, where, force in _struck(rig, "hammer", speed_rpm, impulse, plane, blows, apart):
        yield replace(played, forces={"force_X": force}, attributes={**played.attributes, "force_plane": where})


def _struck(
    rig: RecordedRig, kind: str, speed_rpm: ArrayLike, size: float, plane: str | None, blows: int, apart: float
) -> Iterator[tuple[Played, str, Float]]:
    """Runs under blows along x, where they strike, and their force, N."""
    where = plane or rig.model.planes[-1]
    time, force = rig.instruments.time(apart * (blows + 1)), _blows(size, blows, apart, rig.rng)
    for rpm in _speeds(rig, speed_rpm):
        shaft = rig.shaft(rpm * RPM)
        played = Played(
            name=f"{where}-{kind}-{rpm:g}",
            motion=rig.path(shaft.speed, {where: force}, time.size),
            shaft=shaft.angle(time),
            attributes={"speed_rpm": rpm},
        )
        yield played, where, force(time).real


def release(
    rig: RecordedRig,
    *,
    speed_rpm: ArrayLike = 1500.0,
    load: float = 5.0,
    load_deg: float = -90.0,
    plane: str | None = None,
    duration: float = 4.0,
) -> Iterator[Played]:
    """A constant load that is let go in the middle of the recording."""
    if rig.model.eccentricity_dependent:
        name = f"{rig.model.name} with a law of eccentricity"
        raise ValueError(f"{name}: a load that is let go is simulated of linear rotors; take impulse or static-load")
    where = plane or rig.model.planes[-1]
    time, newton = rig.instruments.time(duration), load * np.exp(1j * np.radians(load_deg))

    def gone(t: Float) -> ComplexArray:
        return np.where(t > duration / 2, -newton, 0.0)

    for rpm in _speeds(rig, speed_rpm):
        shaft = rig.shaft(rpm * RPM)
        moved = rig.path(shaft.speed, {where: gone}, time.size)
        rest = _rest(rig, rpm, newton, where)
        yield Played(
            name=f"{where}-release-{rpm:g}",
            motion={each: z + rest[each] for each, z in moved.items()},
            shaft=shaft.angle(time),
            attributes={"speed_rpm": rpm, "impulse_plane": where},
        )


def static_load(
    rig: RecordedRig,
    *,
    load: ArrayLike,
    speed_rpm: ArrayLike = 1500.0,
    load_deg: float = -90.0,
    plane: str | None = None,
    duration: float = 4.0,
) -> Iterator[Played]:
    """Where the shaft rests under constant loads, and at each speed without one."""
    where = plane or rig.model.coordinates[rig.seat].plane
    time = rig.instruments.time(duration)
    loads = [0.0, *np.atleast_1d(np.asarray(load, dtype=float)).tolist()]
    for rpm in rates_rpm("speed_rpm", speed_rpm).tolist():
        for size in loads:
            rest = _rest(rig, rpm, size * np.exp(1j * np.radians(load_deg)), where)
            yield Played(
                name=f"{where}-{size:g}N-{rpm:g}",
                motion={plane: np.full(time.size, z) for plane, z in rest.items()},
                shaft=rig.shaft(rpm * RPM).angle(time),
                attributes={"speed_rpm": rpm, "load_plane": where, "load_N": size, "load_deg": load_deg},
            )


def _speeds(rig: RecordedRig, speed_rpm: ArrayLike) -> Iterator[float]:
    """Speeds, rpm, at which the rotor is stable."""
    for rpm in rates_rpm("speed_rpm", speed_rpm).tolist():
        rig.decay(rpm * RPM)
        yield rpm


def _blows(size: float, blows: int, apart: float, rng: np.random.Generator) -> Force:
    """Smooth blows of so many N s along x, not quite evenly spaced."""
    at = apart * (np.arange(1, blows + 1) + rng.uniform(-0.1, 0.1, blows))

    length = 4e-3  # length of a blow, s: long enough that a recorder without a filter sees all of it

    def force(t: Float) -> ComplexArray:
        into = (t[:, None] - at) / length
        pulse = np.where((into > 0) & (into < 1), 1 - np.cos(2 * np.pi * into), 0.0).sum(axis=1)
        return np.asarray(size / length * pulse, dtype=complex)

    return force


def _rest(rig: RecordedRig, rpm: float, newton: complex, plane: str) -> dict[str, complex]:
    """Position of each plane under a constant load, m."""
    model, speed = rig.model, rpm * RPM
    rig.need_circular("constant loads")
    if model.eccentricity_dependent and newton:
        z = rest_under(rig, speed, np.array([newton]), plane)[0]
    else:
        rig.decay(speed)
        z = model.receptance(rig.theta, np.zeros(1), np.array([speed]))[0] @ rig.load(newton, plane)
    return {c.plane: complex(z[i]) for i, c in enumerate(model.coordinates) if c.axis == "z"}
