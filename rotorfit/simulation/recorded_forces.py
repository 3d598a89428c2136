"""Recorded tests with forces that turn or swing: sweeps, dwells, start-ups and forces that are measured."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import product

import numpy as np
from numpy.typing import ArrayLike

from rotorfit.models.array_types import ComplexArray, Float
from rotorfit.models.shafts.angular_rates import angular_rate
from rotorfit.simulation.instruments import Played
from rotorfit.simulation.recorded_rig import RecordedRig
from rotorfit.simulation.rig import rates_rpm, some_planes
from rotorfit.simulation.turning_speeds import Dwells, Rotation, Sweep
from rotorfit.units import RAD_S_PER_RPM as RPM

_ACTS: Mapping[str, Callable[[float, Sweep, Float], ComplexArray]] = {
    "forward": lambda size, sweep, t: size * np.exp(1j * sweep.angle(t)),
    "backward": lambda size, sweep, t: size * np.exp(-1j * sweep.angle(t)),
    "x": lambda size, sweep, t: np.asarray(size * np.cos(sweep.angle(t)), dtype=complex),
    "y": lambda size, sweep, t: 1j * size * np.cos(sweep.angle(t)),
}


def perturbation(
    rig: RecordedRig,
    *,
    speed_rpm: ArrayLike = 1500.0,
    sweep_rpm: tuple[float, float] = (60.0, 5000.0),
    duration: float = 30.0,
    unbalance: float = 2e-5,
    planes: str | Sequence[str] | None = None,
    directions: Sequence[str] = ("forward", "backward"),
) -> Iterator[Played]:
    """A perturbator is swept at constant rotative speed, in each plane and direction."""
    chosen = some_planes(rig.model, planes)
    sweep = Sweep(first=sweep_rpm[0] * RPM, last=sweep_rpm[1] * RPM, duration=duration)
    for rpm in rates_rpm("speed_rpm", speed_rpm).tolist():
        rig.decay(rpm * RPM)  # refuses an unstable rotor
        for plane, direction in product(chosen, directions):
            yield _perturbed(rig, sweep, duration, rpm, plane, direction, unbalance)


def dwell(
    rig: RecordedRig,
    *,
    frequency_rpm: ArrayLike,
    speed_rpm: ArrayLike = 1500.0,
    duration: float = 6.0,
    unbalance: float = 2e-5,
    planes: str | Sequence[str] | None = None,
    directions: Sequence[str] = ("forward", "backward"),
    mark: bool = True,
) -> Iterator[Played]:
    """A perturbator dwells at one frequency after the other; without a mark each dwell is a recording of its own."""
    steps = np.abs(rates_rpm("frequency_rpm", frequency_rpm)) * RPM
    runs = [steps] if mark else np.split(steps, steps.size)
    for rpm in rates_rpm("speed_rpm", speed_rpm).tolist():
        rig.decay(rpm * RPM)
        for plane, direction, run in product(some_planes(rig.model, planes), directions, runs):
            turning = Dwells.at(run.tolist(), duration)
            played = _perturbed(rig, turning, turning.duration, rpm, plane, direction, unbalance)
            if mark:
                yield replace(played, name=f"{played.name}-dwells")
                continue
            said = {k: v for k, v in played.attributes.items() if k != "heavy_spot_deg_ahead_of_mark"}
            name = f"{played.name}-at-{run[0] / RPM:g}"
            yield replace(played, name=name, perturbator=None, attributes=said)


def _perturbed(
    rig: RecordedRig, turning: Rotation, duration: float, rpm: float, plane: str, direction: str, unbalance: float
) -> Played:
    """One run of a perturbator; where its mark and its heavy spot are is left to chance."""
    if direction not in ("forward", "backward"):
        raise ValueError(f"directions are forward and backward, got {direction!r}")
    spot, mark = (float(angle) for angle in rig.rng.uniform(-np.pi, np.pi, 2))
    time = rig.instruments.time(duration)

    def force(t: Float) -> ComplexArray:
        turned = unbalance * turning.force(t, spot + mark)
        return turned if direction == "forward" else turned.conj()

    shaft = rig.shaft(rpm * RPM)
    return Played(
        name=f"{plane}-{'fwd' if direction == 'forward' else 'bwd'}-{rpm:g}",
        motion=rig.path(shaft.speed, {plane: force}, time.size),
        shaft=shaft.angle(time),
        perturbator=turning.angle(time) + mark,
        attributes={
            "force_plane": plane,
            "whirl": direction,
            "mr_kg_m": unbalance,
            "speed_rpm": rpm,
            "heavy_spot_deg_ahead_of_mark": float(np.degrees(spot)),
        },
    )


def synchronous(
    rig: RecordedRig,
    *,
    speed_rpm: tuple[float, float] = (250.0, 6000.0),
    duration: float = 30.0,
    unbalance: float = 1.5e-5,
    planes: str | Sequence[str] | None = None,
    hole_zero_deg: float = 25.0,
    hole_deg: Sequence[float] = (0.0, 180.0),
    reference: bool = False,
) -> Iterator[Played]:
    """Start-ups with a weight in one of the planes at places of the pattern of holes, and perhaps one without."""
    spread = 0.01  # of the last speed from run to run
    if not rig.model.eccentricity_dependent:  # whose whirl nothing limits
        rig.decay((1 + spread) * speed_rpm[1] * RPM)
    time = rig.instruments.time(duration)
    for name, weights, said in _weighted(rig, unbalance, planes, hole_zero_deg, hole_deg, reference):
        sweep = Sweep(
            first=speed_rpm[0] * RPM,
            last=speed_rpm[1] * RPM * float(rig.rng.uniform(1 - spread, 1 + spread)),
            duration=duration,
        )
        forces = {plane: partial(_turning, sweep, weight) for plane, weight in weights.items()}
        yield Played(
            name=name,
            motion=rig.path(sweep.speed, forces, time.size),
            shaft=sweep.angle(time),
            attributes=said,
        )


def balance(
    rig: RecordedRig,
    *,
    speed_rpm: ArrayLike,
    duration: float = 10.0,
    unbalance: float = 1.5e-5,
    planes: str | Sequence[str] | None = None,
    hole_zero_deg: float = 25.0,
    hole_deg: Sequence[float] = (0.0,),
    reference: bool = True,
) -> Iterator[Played]:
    """Runs at steady speeds without a weight and with one in each of the planes, as balancing records them."""
    time = rig.instruments.time(duration)
    for rpm in rates_rpm("speed_rpm", speed_rpm).tolist():
        rig.decay(rpm * RPM)
    for name, weights, said in _weighted(rig, unbalance, planes, hole_zero_deg, hole_deg, reference):
        for rpm in rates_rpm("speed_rpm", speed_rpm).tolist():
            shaft = rig.shaft(rpm * RPM)
            forces = {plane: partial(_turning, shaft, weight) for plane, weight in weights.items()}
            yield Played(
                name=f"{name}-{rpm:g}",
                motion=rig.path(shaft.speed, forces, time.size),
                shaft=shaft.angle(time),
                attributes={**said, "speed_rpm": rpm},
            )


def _weighted(
    rig: RecordedRig,
    unbalance: float,
    planes: str | Sequence[str] | None,
    hole_zero_deg: float,
    hole_deg: Sequence[float],
    reference: bool,
) -> Iterator[tuple[str, dict[str, complex], dict[str, float | str]]]:
    """Runs with a weight in one plane after the other, the rotor's own unbalance in all: name, weights, attributes."""
    own = {plane: rig.residual * np.exp(2j * np.pi * rig.rng.uniform()) for plane in rig.model.planes}
    forced = some_planes(rig.model, planes)
    if reference:
        yield "reference", own, {"weight_plane": forced[0], "mr_kg_m": 0.0}
    for plane, hole in product(forced, hole_deg):
        weight = unbalance * np.exp(1j * np.radians(hole + hole_zero_deg))
        said: dict[str, float | str] = {"weight_plane": plane, "weight_angle_deg": hole, "mr_kg_m": unbalance}
        yield f"{plane}-{hole:g}", {**own, plane: own[plane] + weight}, said


def measured_force(
    rig: RecordedRig,
    *,
    speed_rpm: float = 1500.0,
    sweep_rpm: tuple[float, float] = (300.0, 5000.0),
    duration: float = 20.0,
    force: float = 2.0,
    planes: str | Sequence[str] | None = None,
    directions: Sequence[str] = ("forward", "backward", "x"),
) -> Iterator[Played]:
    """A magnetic bearing or a shaker whose force is measured: turning sweeps, and sweeps along x or y."""
    sweep = Sweep(first=sweep_rpm[0] * RPM, last=sweep_rpm[1] * RPM, duration=duration)
    time = rig.instruments.time(duration)
    speed_rpm = angular_rate(speed_rpm, "speed_rpm", "rpm")
    rig.decay(speed_rpm * RPM)
    for plane, direction in product(some_planes(rig.model, planes), directions):
        if direction not in _ACTS:
            raise ValueError(f"directions are {', '.join(_ACTS)}, got {direction!r}")
        acts = partial(_ACTS[direction], force, sweep)
        newton = acts(time)
        shaft = rig.shaft(speed_rpm * RPM)
        yield Played(
            name=f"{plane}-{direction}",
            motion=rig.path(shaft.speed, {plane: acts}, time.size),
            shaft=shaft.angle(time),
            forces={"force_X": newton.real, "force_Y": newton.imag},
            attributes={"speed_rpm": speed_rpm, "force_plane": plane},
        )


def _turning(shaft: Rotation, weight: complex, t: Float) -> ComplexArray:
    return weight * shaft.force(t, 0.0)
