"""Tests of a virtual rig: rotating forces and imposed orbits, constant loads and impulses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import product
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rotorfit.base.array_types import ComplexArray, Float, Index, Records, Text
from rotorfit.base.digits import significant
from rotorfit.base.units import RAD_S_PER_RPM, RPM_PER_RAD_S
from rotorfit.lab.data.experiments import PerturbationTest, none_further, records
from rotorfit.lab.data.from_arrays import perturbation_test
from rotorfit.lab.data.ring_down import ring_down_test
from rotorfit.lab.kinds.displacement_test import DisplacementTest
from rotorfit.lab.kinds.free_vibration import RingDownTest
from rotorfit.lab.kinds.static_test import StaticTest
from rotorfit.lab.simulation.instruments import sample_times
from rotorfit.lab.simulation.integration import Steady, integrate, rest_position, steady_state
from rotorfit.lab.simulation.rig import VirtualRig, positive, rates_rpm, some_planes
from rotorfit.models import RotorModel
from rotorfit.models.motion.off_centre import off_centre_eigenvalues

LineOrder = Literal["rest", "up", "down"]


class _Lines(NamedTuple):
    """Forced motion to integrate, all shape ``(L,)``, force and load ``(L, n)``."""

    run: Text
    plane: Text
    speed: Float
    frequency: Float
    phasor: ComplexArray
    further: Records
    force: ComplexArray
    load: ComplexArray
    decay: Float
    sweep: Index


def perturbation(
    rig: VirtualRig,
    *,
    speed_rpm: ArrayLike,
    frequency_rpm: ArrayLike,
    force: complex | Sequence[complex] | None = None,
    unbalance: complex | Sequence[complex] | None = None,
    planes: str | Sequence[str] | None = None,
    order: LineOrder = "rest",
    load: complex = 0.0,
    load_plane: str | None = None,
) -> PerturbationTest:
    """Nonsynchronous perturbation: rotating forces, x and y at every plane; amplitude sweeps with several forces."""
    if (force is None) == (unbalance is None):
        raise ValueError("give either force, in N, or unbalance, in kg m")
    if order not in ("rest", "up", "down"):
        raise ValueError(f"order must be rest, up or down, got {order!r}")
    levels = np.atleast_1d(np.asarray(force if unbalance is None else unbalance, dtype=complex))
    w = rates_rpm("frequency_rpm", frequency_rpm) * RAD_S_PER_RPM
    if not (levels.size and w.all() and levels.all() and np.isfinite(levels).all()):
        raise ValueError("frequencies and forces must be finite and not zero")
    speeds = rates_rpm("speed_rpm", speed_rpm) * RAD_S_PER_RPM
    constant = rig.load(load, load_plane) if load else np.zeros(len(rig.model.coordinates), dtype=complex)
    decay = {float(speed): rig.decay(float(speed), constant) for speed in speeds}
    cases = list(product(some_planes(rig.model, planes), speeds.tolist(), levels.tolist()))
    parts = []
    for number, (plane, speed, level) in enumerate(cases):
        phasor = np.full(w.size, level) if unbalance is None else level * w**2
        unit = "N" if unbalance is None else "kg m"
        name = f"{plane}, {speed * RPM_PER_RAD_S:.6g} rpm, {significant(abs(level), 4)} {unit}"
        parts.append(
            {
                "run": np.where(w > 0, f"{name}, forward", f"{name}, backward"),
                "plane": np.full(w.size, plane),
                "speed": np.full(w.size, speed),
                "frequency": w,
                "phasor": phasor,
                "further": none_further(w.size),
                "force": rig.model.force_vector(plane, w, phasor),
                "load": np.tile(constant, (w.size, 1)),
                "decay": np.full(w.size, decay[speed]),
                "sweep": 2 * number + (w < 0),
            }
        )
    return _test(rig, parts, order)


def squeeze_film(
    rig: VirtualRig,
    *,
    frequency_rpm: ArrayLike,
    force: complex | Sequence[complex] | None = None,
    unbalance: complex | Sequence[complex] | None = None,
    planes: str | Sequence[str] | None = None,
) -> PerturbationTest:
    """Squeeze film (Fig. 25): rotating forces on a rotor that does not turn."""
    forced: dict[str, Any] = {"force": force, "unbalance": unbalance, "planes": planes}
    return perturbation(rig, speed_rpm=0.0, frequency_rpm=frequency_rpm, **forced)


def synchronous(
    rig: VirtualRig,
    *,
    speed_rpm: ArrayLike,
    unbalance: float | Mapping[str, float],
    residual: Mapping[str, complex] | None = None,
    planes: str | Sequence[str] | None = None,
    kept: bool = False,
) -> PerturbationTest:
    """Start-ups with a calibration weight at 0 and at 180 degrees at each plane (eqs 19 to 23). With ``kept``, as in
    balancing: one without a weight, then one weight more in each, those before staying in."""
    speed = positive("speed_rpm", speed_rpm) * RAD_S_PER_RPM
    model = rig.model
    decay = np.array([rig.decay(v) for v in speed.tolist()])
    rest = np.zeros((speed.size, len(model.coordinates)), dtype=complex)
    if kept and not any((residual or {}).values()):
        raise ValueError("weights that are kept need a residual unbalance: the run without a weight would not move")
    for plane, weight in (residual or {}).items():
        rest += model.force_vector(plane, speed, weight * speed**2)
    parts = []
    for number, (run, loads) in enumerate(_weights(model, unbalance, planes, kept).items()):
        forces = [(plane, weight * speed**2) for plane, weight in loads]
        (first, phasor), *further = forces
        parts.append(
            {
                "run": np.full(speed.size, run),
                "plane": np.full(speed.size, first),
                "speed": speed,
                "frequency": speed,
                "phasor": phasor,
                "further": records(tuple((at, f[k].item()) for at, f in further) for k in range(speed.size)),
                "force": rest + np.sum([model.force_vector(at, speed, f) for at, f in forces], axis=0),
                "load": np.zeros_like(rest),
                "decay": decay,
                "sweep": np.full(speed.size, 2 * number),
            }
        )
    return _test(rig, parts, "rest")


def _weights(
    model: RotorModel, unbalance: float | Mapping[str, float], planes: str | Sequence[str] | None, kept: bool
) -> dict[str, list[tuple[str, complex]]]:
    """Weights of each run, kg m: one at 0, then at 180 degrees, plane by plane; or none, then one more in each."""
    given = [*unbalance] if planes is None and isinstance(unbalance, Mapping) else planes
    chosen = some_planes(model, given)
    sizes = unbalance if isinstance(unbalance, Mapping) else dict.fromkeys(chosen, unbalance)
    if missing := [plane for plane in chosen if plane not in sizes]:
        raise ValueError(f"unbalance has no weight for {', '.join(missing)}; start-ups need one for each of planes")
    weights = {plane: float(positive(f"unbalance at {plane}", sizes[plane])[0]) for plane in chosen}
    if not kept:
        return {
            f"{plane} {degrees} deg": [(plane, weight * np.exp(1j * np.radians(degrees)))]
            for (plane, weight), degrees in product(weights.items(), (0, 180))
        }
    loads: list[tuple[str, complex]] = [(plane, complex(weight)) for plane, weight in weights.items()]
    runs = {" + ".join(plane for plane, _ in loads[:count]): loads[:count] for count in range(1, len(loads) + 1)}
    return {"reference": [(loads[0][0], 0j)]} | runs


def displacement(
    rig: VirtualRig,
    *,
    speed_rpm: ArrayLike,
    frequency_rpm: ArrayLike,
    amplitude_um: ArrayLike,
    plane: str | None = None,
) -> DisplacementTest:
    """Constant circular displacement input (Figs 4, 16 and 17): an orbit is imposed, its force measured."""
    rig.need_circular("imposed orbits")
    radii, speeds = positive("amplitude_um", amplitude_um) * 1e-6, rates_rpm("speed_rpm", speed_rpm) * RAD_S_PER_RPM
    cases = np.array(list(product(speeds, radii, rates_rpm("frequency_rpm", frequency_rpm) * RAD_S_PER_RPM)))
    speed, radius, w = cases.T
    at = rig.seat if plane is None else rig.model.coordinate(plane, "z")
    motion = rig.motion(speed, imposed=at)
    if motion.eccentricity(np.eye(len(rig.model.coordinates))[at] * radii.max() + 0j) >= 1:
        raise ValueError(f"an orbit of {radii.max() * 1e6:g} um does not fit into the clearance")
    orbit = np.zeros((w.size, len(rig.model.coordinates)), dtype=complex)
    orbit[:, at] = radius
    decay = np.array([rig.decay(v) for v in speed.tolist()])
    spin = 1j * w[:, None]
    given = steady_state(motion, w, spin**2 * orbit, decay, start=(orbit, spin * orbit), tolerance=rig.tolerance)
    z = given.forward
    force = motion.force(z, spin * z, spin**2 * z)[:, at]
    x = np.where(w < 0, force.conj(), force)
    y = np.where(w < 0, 1j * x, -1j * x)
    sigma = rig.sigma(x, np.column_stack([speed, radius]))
    names = [f"{v * RPM_PER_RAD_S:.6g} rpm, {significant(a * 1e6, 4)} um" for v, a in zip(speed, radius, strict=True)]
    return DisplacementTest(
        run=np.array(names),
        speed=speed,
        frequency=w,
        plane=np.full(w.size, rig.model.coordinates[at].plane),
        displacement=radius.astype(complex),
        force_x=rig.noisy(x, sigma),
        force_y=rig.noisy(y, sigma),
        sigma=rig.sigma_given(sigma),
        source="simulated",
    )


# ---- integration and readings -------------------------------------------------------------------------------------


def _steady(rig: VirtualRig, lines: _Lines, order: LineOrder) -> Steady:
    """Steady motion of all lines: each from rest, or one after the other in the sweeps that they are of."""
    frequency = lines.frequency if rig.model.frame == "z" else np.abs(lines.frequency)
    if rig.exact:
        forward = (rig.model.receptance(rig.theta, frequency, lines.speed) @ lines.force[..., None])[..., 0]
        still = np.zeros_like(forward)
        return Steady(forward=forward, backward=still, mean=still, z=forward, v=1j * frequency[:, None] * forward)
    motion = rig.motion(lines.speed)
    if pushed := [str(rig.model.coordinates[i]) for i in motion.rows.massless if lines.force[:, i].any()]:
        raise ValueError(
            f"{rig.model.name}: {', '.join(pushed)} has no mass, and its motion in time under a force is not followed; "
            "leave it out of planes="
        )
    direction = -1 if order == "down" else 1
    queues = list(np.arange(frequency.size)[:, None])
    if order != "rest":
        sweeps = [np.flatnonzero(lines.sweep == number) for number in np.unique(lines.sweep)]
        queues = [sweep[np.argsort(direction * np.abs(frequency[sweep]))] for sweep in sweeps]
    parts = {name: np.zeros_like(lines.force) for name in Steady._fields}
    z, v = np.zeros((2, len(queues), lines.force.shape[1]), dtype=complex)
    for step in range(max(queue.size for queue in queues)):
        running = np.array([k for k, queue in enumerate(queues) if queue.size > step])
        part = np.array([queues[k][step] for k in running])
        acting, start = (frequency[part], lines.force[part], lines.decay[part]), (z[running], v[running])
        steady = steady_state(motion.select(part), *acting, load=lines.load[part], start=start, tolerance=rig.tolerance)
        z[running], v[running] = steady.z, steady.v
        for name, values in steady._asdict().items():
            parts[name][part] = values
    return Steady(**parts)


def _test(rig: VirtualRig, parts: Sequence[Mapping[str, Any]], order: LineOrder) -> PerturbationTest:
    """Readings of x and y at every coordinate of every line of several sweeps."""
    lines = _Lines(**{name: np.concatenate([part[name] for part in parts]) for name in parts[0]})
    steady = _steady(rig, lines, order)
    factors = rig.model.functions.factors(rig.theta)
    columns: dict[str, list[NDArray[np.generic]]] = {}
    for number, coordinate in enumerate(rig.model.coordinates):
        forward, backward = (part[:, number] * factors[number] for part in (steady.forward, steady.backward))
        for direction, exact in probes(rig.model, coordinate.axis, lines.frequency, forward, backward):
            sigma = rig.sigma(exact, lines.sweep // 2)
            cells = {
                "run": lines.run,
                "speed": lines.speed,
                "frequency": lines.frequency,
                "force_plane": lines.plane,
                "force": lines.phasor,
                "further_forces": lines.further,
                "plane": np.full(sigma.size, coordinate.plane),
                "direction": np.full(sigma.size, direction),
                "response": rig.noisy(exact, sigma),
                "sigma": rig.sigma_given(sigma),
            }
            if lines.load.any():
                rest = steady.mean[:, rig.seat] * factors[rig.seat].real
                cells |= {"static_x_um": rest.real * 1e6, "static_y_um": rest.imag * 1e6}
            for name, cell in cells.items():
                columns.setdefault(name, []).append(cell)
    whole = {name: np.concatenate(parts) for name, parts in columns.items()}
    attributes = {name: whole.pop(name) for name in ("static_x_um", "static_y_um") if name in whole}
    return perturbation_test(**whole, attributes=attributes, source="simulated")  # type: ignore[arg-type]


def probes(
    model: RotorModel, axis: str, frequency: Float, along: ComplexArray, against: ComplexArray
) -> list[tuple[str, ComplexArray]]:
    """Phasors, relative to exp(+j|w|t), of the probes that see a coordinate. ``z = A exp(j|w|t) + B exp(-j|w|t)`` is
    read as ``X = A + conj(B)`` and ``Y = -j (A - conj(B))``."""
    if model.frame != "z":
        return [(axis, along)]
    A, B = np.where(frequency > 0, along, against), np.where(frequency > 0, against, along)
    prefix = "r" if axis == "r" else ""
    return [(f"{prefix}x", A + B.conj()), (f"{prefix}y", -1j * (A - B.conj()))]


def static_load(
    rig: VirtualRig, *, speed_rpm: ArrayLike, load: ArrayLike, load_deg: float = -90.0, plane: str | None = None
) -> StaticTest:
    """Static loads (Figs 26 to 28): where every plane comes to rest under each load at each speed."""
    speeds, loads = rates_rpm("speed_rpm", speed_rpm) * RAD_S_PER_RPM, positive("load", load)
    turned = loads * np.exp(1j * np.radians(load_deg))
    rests = [rest_under(rig, speed, turned, plane) for speed in speeds.tolist()]
    planes = [number for number, c in enumerate(rig.model.coordinates) if c.axis == "z"]
    cases = list(product(range(speeds.size), planes, range(loads.size)))
    factors = rig.model.functions.factors(rig.theta)  # of the probes
    exact = np.array([rests[i][k, c] * factors[c] for i, c, k in cases])
    sigma = rig.sigma(exact, np.array([(i, c) for i, c, _ in cases]))
    acts = rig.model.coordinates[rig.seat].plane if plane is None else plane
    return StaticTest(
        run=np.array([f"{speeds[i] * RPM_PER_RAD_S:.6g} rpm" for i, _, _ in cases]),
        speed=np.array([speeds[i] for i, _, _ in cases]),
        load_plane=np.full(len(cases), acts),
        load=np.array([turned[k] for _, _, k in cases]),
        plane=np.array([rig.model.coordinates[c].plane for _, c, _ in cases]),
        displacement=rig.noisy(exact, sigma),
        sigma=rig.sigma_given(sigma),
        source="simulated",
    )


def rest_under(rig: VirtualRig, speed: float, loads: ComplexArray, plane: str | None) -> ComplexArray:
    """Equilibria under several loads at one speed, shape ``(loads, n)``."""
    vectors = np.array([rig.load(newton, plane) for newton in loads.tolist()])
    decay = np.array([rig.decay(speed, vector) for vector in vectors])
    return rest_position(rig.motion(np.full(loads.size, speed)), vectors, decay, tolerance=rig.tolerance)


def impulse(
    rig: VirtualRig,
    *,
    speed_rpm: ArrayLike,
    impulse: float,
    load: ArrayLike = 0.0,
    impulse_deg: float = 0.0,
    load_deg: float = -90.0,
    plane: str | None = None,
    duration: float | None = None,
    sampling_hz: float | None = None,
) -> RingDownTest:
    """Impulses (Fig. 29): the journal's free vibration about its static position."""
    rig.need_circular("impulses")
    speeds, loads = rates_rpm("speed_rpm", speed_rpm) * RAD_S_PER_RPM, np.atleast_1d(np.asarray(load, float))
    blow = rig.load(positive("impulse", impulse)[0] * np.exp(1j * np.radians(impulse_deg)), plane)
    factor = rig.model.functions.factors(rig.theta)[rig.seat].real  # of the journal's probes
    parts: list[tuple[str, float, Float, ComplexArray]] = []
    for speed, newton in product(speeds.tolist(), loads.tolist()):
        turned = newton * np.exp(1j * np.radians(load_deg))
        rest = np.zeros(blow.size, dtype=complex)
        if newton:
            rest = rest_under(rig, speed, np.array([turned]), plane)[0]
        time, z = _record(rig, speed, rig.load(turned, plane), rest, blow, duration, sampling_hz)
        size = rig.noise * float(np.sqrt(np.mean(np.abs(z - rest[rig.seat]) ** 2)))
        run = f"{speed * RPM_PER_RAD_S:.6g} rpm, {significant(newton, 4)} N"
        parts.append((run, speed, time, factor * rig.noisy(z, np.full(z.size, size))))
    return ring_down_test(parts, "simulated")


def _record(
    rig: VirtualRig,
    speed: float,
    load: ComplexArray,
    rest: ComplexArray,
    blow: ComplexArray,
    duration: float | None,
    sampling_hz: float | None,
) -> tuple[Float, ComplexArray]:
    motion = rig.motion(np.array([speed]))
    s = off_centre_eigenvalues(rig.model, rig.theta, speed, float(motion.eccentricity(rest[None])[0]))
    slowest, fastest = -float(s.real.max()), float(np.abs(s.imag).max())
    left = 0.01  # vibration left at the end of a record
    length = duration if duration is not None else float(np.log(1 / left)) / rig.decay(speed, load)
    fewest = 256  # samples in a record
    a_period = 16.0  # samples in a period of the fastest mode
    rate = sampling_hz if sampling_hz is not None else max(a_period * fastest / (2 * np.pi), fewest / length)
    time = sample_times(length, rate)
    v = np.asarray(np.linalg.solve(motion.mass[0], blow), dtype=complex)
    size = float(np.abs(v).max()) / max(fastest, slowest)
    path = integrate(
        motion,
        lambda _: load[None],
        rest[None],
        v[None],
        (0.0, float(time[-1])),
        size=size,
        rate=max(fastest, slowest),
        times=time,
        tolerance=rig.tolerance,
    )
    return time, path.z[:, 0, rig.seat]
