"""Tests of a virtual rig with constant loads and impulses."""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import ArrayLike

from rotorfit.data.experiments import RingDownTest, StaticTest
from rotorfit.models.array_types import ComplexArray, Float
from rotorfit.models.digits import significant
from rotorfit.models.motion.off_centre import off_centre_eigenvalues
from rotorfit.simulation.integration import integrate
from rotorfit.simulation.rig import VirtualRig, positive, rates_rpm
from rotorfit.simulation.steady_state import rest_position
from rotorfit.units import RAD_S_PER_RPM, RPM_PER_RAD_S


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
    columns: dict[str, list[Float]] = {name: [] for name in ("speed", "time", "x", "y")}
    factor = rig.model.functions.factors(rig.theta)[rig.seat].real  # of the journal's probes
    runs: list[str] = []
    for speed, newton in product(speeds.tolist(), loads.tolist()):
        turned = newton * np.exp(1j * np.radians(load_deg))
        rest = np.zeros(blow.size, dtype=complex)
        if newton:
            rest = rest_under(rig, speed, np.array([turned]), plane)[0]
        time, z = _record(rig, speed, rig.load(turned, plane), rest, blow, duration, sampling_hz)
        size = rig.noise * float(np.sqrt(np.mean(np.abs(z - rest[rig.seat]) ** 2)))
        z = factor * rig.noisy(z, np.full(z.size, size))
        runs += [f"{speed * RPM_PER_RAD_S:.6g} rpm, {significant(newton, 4)} N"] * time.size
        for name, values in zip(columns, (np.full(time.size, speed), time, z.real, z.imag), strict=True):
            columns[name].append(values)
    speed_of, instant, x, y = (np.concatenate(parts) for parts in columns.values())
    return RingDownTest(
        run=np.array(runs),
        speed=speed_of,
        time=instant,
        x=x,
        y=y,
        eccentricity=np.full(len(runs), np.nan),
        source="simulated",
    )


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
    time = np.arange(max(int(length * rate), 2)) / rate
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
