"""Recorded tests: forces that turn, swing or are measured, constant loads, blows and releases."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import product

import numpy as np
from numpy.typing import ArrayLike

from rotorfit.base.array_types import ComplexArray, Float
from rotorfit.base.units import RAD_S_PER_RPM as RPM
from rotorfit.lab.simulation.forcing import rest_under
from rotorfit.lab.simulation.instruments import Played
from rotorfit.lab.simulation.rig import Force, RecordedRig, rates_rpm, some_planes
from rotorfit.lab.simulation.turning_speeds import Dwells, Rotation, Sweep
from rotorfit.models.shafts.angular_rates import angular_rate

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
    for rpm in _speeds(rig, speed_rpm):
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
    for rpm in _speeds(rig, speed_rpm):
        for plane, direction, run in product(some_planes(rig.model, planes), directions, runs):
            turning = Dwells(speeds=run, each=duration)
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

    said: dict[str, str | float] = {
        "force_plane": plane,
        "whirl": direction,
        "mr_kg_m": unbalance,
        "speed_rpm": rpm,
        "heavy_spot_deg_ahead_of_mark": float(np.degrees(spot)),
    }
    name = f"{plane}-{'fwd' if direction == 'forward' else 'bwd'}-{rpm:g}"
    return rig.run(name, rig.shaft(rpm * RPM), {plane: force}, time, said, perturbator=turning.angle(time) + mark)


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
        yield rig.run(name, sweep, _turning(sweep, weights), time, said)


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
    speeds = list(_speeds(rig, speed_rpm))
    for name, weights, said in _weighted(rig, unbalance, planes, hole_zero_deg, hole_deg, reference):
        for rpm in speeds:
            shaft = rig.shaft(rpm * RPM)
            yield rig.run(f"{name}-{rpm:g}", shaft, _turning(shaft, weights), time, {**said, "speed_rpm": rpm})


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
        said: dict[str, str | float] = {"speed_rpm": speed_rpm, "force_plane": plane}
        measured = {"force_X": newton.real, "force_Y": newton.imag}
        yield rig.run(f"{plane}-{direction}", rig.shaft(speed_rpm * RPM), {plane: acts}, time, said, forces=measured)


def _turning(shaft: Rotation, weights: Mapping[str, complex]) -> dict[str, Force]:
    """Forces of weights on the shaft, by plane."""

    def force(weight: complex, t: Float) -> ComplexArray:
        return weight * shaft.force(t, 0.0)

    return {plane: partial(force, weight) for plane, weight in weights.items()}


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
    return _struck(rig, "blows", speed_rpm, impulse, plane, blows, apart)


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
    return _struck(rig, "hammer", speed_rpm, impulse, plane, blows, apart)


def _struck(
    rig: RecordedRig, kind: str, speed_rpm: ArrayLike, size: float, plane: str | None, blows: int, apart: float
) -> Iterator[Played]:
    """Runs under smooth blows of so many N s along x, not quite evenly spaced, measured if a hammer gives them."""
    where, measured = plane or rig.model.planes[-1], kind == "hammer"
    time = rig.instruments.time(apart * (blows + 1))
    at = apart * (np.arange(1, blows + 1) + rig.rng.uniform(-0.1, 0.1, blows))
    length = 4e-3  # length of a blow, s: long enough that a recorder without a filter sees all of it

    def force(t: Float) -> ComplexArray:
        into = (t[:, None] - at) / length
        pulse = np.where((into > 0) & (into < 1), 1 - np.cos(2 * np.pi * into), 0.0).sum(axis=1)
        return np.asarray(size / length * pulse, dtype=complex)

    for rpm in _speeds(rig, speed_rpm):
        said: dict[str, str | float] = {"speed_rpm": rpm, "force_plane" if measured else "impulse_plane": where}
        forces = {"force_X": force(time).real} if measured else {}
        yield rig.run(f"{where}-{kind}-{rpm:g}", rig.shaft(rpm * RPM), {where: force}, time, said, forces=forces)


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
        said: dict[str, str | float] = {"speed_rpm": rpm, "impulse_plane": where}
        run = rig.run(f"{where}-release-{rpm:g}", rig.shaft(rpm * RPM), {where: gone}, time, said)
        rest = _rest(rig, rpm, newton, where)
        yield replace(run, motion={each: z + rest[each] for each, z in run.motion.items()})


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


def operating(rig: RecordedRig, *, speed_rpm: ArrayLike = 1500.0, duration: float = 60.0) -> Iterator[Played]:
    """A rotor at steady speeds that turbulence and its own unbalance shake, as it does after some time."""
    if rig.turbulence is None:
        raise ValueError("a test of kind operating needs turbulence to shake the rotor (turbulence=, --turbulence)")
    own = {plane: rig.residual * np.exp(2j * np.pi * rig.rng.uniform()) for plane in rig.model.planes}
    for rpm in rates_rpm("speed_rpm", speed_rpm).tolist():
        shaft = rig.shaft(rpm * RPM)
        time = rig.instruments.time(rig.settling(rpm * RPM) + duration)
        last = slice(-rig.instruments.time(duration).size, None)
        run = rig.run(
            f"operating-{rpm:g}", shaft, _turning(shaft, own) if rig.residual else {}, time, {"speed_rpm": rpm}
        )
        yield replace(run, motion={plane: z[last] for plane, z in run.motion.items()}, shaft=run.shaft[last])


def _speeds(rig: RecordedRig, speed_rpm: ArrayLike) -> Iterator[float]:
    """Speeds, rpm; at one where the rotor is unstable nothing can be recorded."""
    for rpm in rates_rpm("speed_rpm", speed_rpm).tolist():
        rig.decay(rpm * RPM)
        yield rpm


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
