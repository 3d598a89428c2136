"""Recordings of tests of a virtual rig: HDF5 files and a setup, as a data acquisition would have left them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from rotorfit.models import RotorModel
from rotorfit.models.array_types import ComplexArray, Float
from rotorfit.models.parameters import unknown_name
from rotorfit.simulation.instruments import Instruments, Played, record, wandering_angle
from rotorfit.simulation.linear_path import linear_path
from rotorfit.simulation.rig import VirtualRig, some_planes
from rotorfit.units import RAD_S_PER_RPM as RPM


@dataclass(frozen=True, kw_only=True)
class Sweep:
    """Angle of a perturbator or shaft that is swept, not quite evenly.

    Attributes:
        first, last: speed at both ends, rad/s.
        duration: s.
        uneven: amplitude of the unevenness of the speed over the range swept.
    """

    first: float
    last: float
    duration: float
    uneven: float = 2e-3

    @property
    def _slope(self) -> float:
        return (self.last - self.first) / self.duration

    @property
    def _wave(self) -> tuple[float, float]:
        return abs(self.last - self.first) * self.uneven, 2 * np.pi * 7.3 / self.duration

    def angle(self, t: Float) -> Float:
        """rad."""
        size, rate = self._wave
        return np.asarray(self.first * t + self._slope * t**2 / 2 - size / rate * (np.cos(rate * t) - 1))

    def speed(self, t: Float) -> Float:
        """rad/s."""
        size, rate = self._wave
        return np.asarray(self.first + self._slope * t + size * np.sin(rate * t))

    def acceleration(self, t: Float) -> Float:
        """rad/s^2."""
        size, rate = self._wave
        return np.asarray(self._slope + size * rate * np.cos(rate * t))

    def force(self, t: Float, heavy_spot: float) -> ComplexArray:
        """Force of one kg m as seen from x turning with it, N."""
        turned = np.exp(1j * (self.angle(t) + heavy_spot))
        return np.asarray((self.speed(t) ** 2 - 1j * self.acceleration(t)) * turned)


@dataclass(frozen=True, eq=False)
class _Rig:
    """A linear rotor with its instruments."""

    virtual: VirtualRig
    instruments: Instruments
    residual: float

    def path(
        self, speed: Callable[[Float], Float], force: Callable[[Float], ComplexArray], plane: str, count: int
    ) -> dict[str, ComplexArray]:
        """Motion of each plane under a force at one of them and the rotor's own residual unbalance."""
        model, theta = self.virtual.model, self.virtual.theta
        along = _along(model, plane)

        def forces(t: Float) -> ComplexArray:
            return along(force(t))

        path = linear_path(model, theta, speed=speed, force=forces, rate=self.instruments.sample_rate, count=count)
        path = path * model.functions.factors(theta)
        if model.frame == "z":
            return {c.plane: path[:, i] for i, c in enumerate(model.coordinates) if c.axis == "z"}
        axes = {(c.plane, c.axis): path[:, i].real for i, c in enumerate(model.coordinates)}
        return {plane: axes[plane, "x"] + 1j * axes[plane, "y"] for plane in model.planes}

    @property
    def rng(self) -> np.random.Generator:
        """Source of noise and chance."""
        return self.virtual.rng


def _along(model: RotorModel, plane: str) -> Callable[[ComplexArray], ComplexArray]:
    """From a force ``Fx + j Fy`` in time to generalised forces, shape ``(T, n)``."""
    vector = np.zeros(len(model.coordinates), dtype=complex)
    if model.frame == "z":
        vector[model.coordinate(plane, "z")] = 1.0
        return lambda f: f[:, None] * vector
    x, y = model.coordinate(plane, "x"), model.coordinate(plane, "y")

    def apart(f: ComplexArray) -> ComplexArray:
        both = np.zeros((f.size, vector.size), dtype=complex)
        both[:, x], both[:, y] = f.real, f.imag
        return both

    return apart


def _perturbation(
    rig: _Rig,
    *,
    speed_rpm: ArrayLike = 1500.0,
    sweep_rpm: tuple[float, float] = (60.0, 5000.0),
    duration: float = 30.0,
    unbalance: float = 2e-5,
    planes: str | Sequence[str] | None = None,
    directions: Sequence[str] = ("forward", "backward"),
) -> Iterator[Played]:
    """A perturbator is swept at constant rotative speed, in each plane and direction."""
    chosen = some_planes(rig.virtual.model, planes)
    sweep = Sweep(first=sweep_rpm[0] * RPM, last=sweep_rpm[1] * RPM, duration=duration)
    for rpm in np.atleast_1d(np.asarray(speed_rpm, dtype=float)).tolist():
        rig.virtual.decay(rpm * RPM)  # refuses an unstable rotor
        for plane, direction in product(chosen, directions):
            yield _swept(rig, sweep, rpm, plane, direction, unbalance)


def _swept(rig: _Rig, sweep: Sweep, rpm: float, plane: str, direction: str, unbalance: float) -> Played:
    """One run of a perturbator; where its mark and its heavy spot are is left to chance."""
    if direction not in ("forward", "backward"):
        raise ValueError(f"directions are forward and backward, got {direction!r}")
    spot, mark = (float(angle) for angle in rig.rng.uniform(-np.pi, np.pi, 2))
    time = rig.instruments.time(sweep.duration)

    def speed(t: Float) -> Float:
        return np.full(np.shape(t), rpm * RPM)

    def force(t: Float) -> ComplexArray:
        turning = unbalance * sweep.force(t, spot + mark)
        return turning if direction == "forward" else turning.conj()

    return Played(
        name=f"{plane}-{'fwd' if direction == 'forward' else 'bwd'}-{rpm:g}",
        motion=rig.path(speed, force, plane, time.size),
        shaft=wandering_angle(time, rpm * RPM, rig.instruments.wander, rig.rng),
        perturbator=sweep.angle(time) + mark,
        attributes={
            "force_plane": plane, "whirl": direction, "mr_kg_m": unbalance, "speed_rpm": rpm,
            "heavy_spot_deg_ahead_of_mark": float(np.degrees(spot)),
        },
    )  # fmt: skip


def _synchronous(
    rig: _Rig,
    *,
    speed_rpm: tuple[float, float] = (250.0, 6000.0),
    duration: float = 30.0,
    unbalance: float = 1.5e-5,
    planes: str | Sequence[str] | None = None,
    hole_zero_deg: float = 25.0,
) -> Iterator[Played]:
    """Start-ups with a weight in one of the planes at opposite places of the pattern of holes."""
    time = rig.instruments.time(duration)
    places = {plane: rig.residual * np.exp(2j * np.pi * rig.rng.uniform()) for plane in rig.virtual.model.planes}
    for plane in some_planes(rig.virtual.model, planes):
        for hole in (0.0, 180.0):
            sweep = Sweep(
                first=speed_rpm[0] * RPM,
                last=speed_rpm[1] * RPM * float(rig.rng.uniform(0.99, 1.01)),
                duration=duration,
            )
            weight = unbalance * np.exp(1j * np.radians(hole + hole_zero_deg)) + places[plane]
            yield Played(
                name=f"{plane}-{hole:g}",
                motion=rig.path(sweep.speed, partial(_turning, sweep, weight), plane, time.size),
                shaft=sweep.angle(time),
                attributes={"weight_plane": plane, "weight_angle_deg": hole, "mr_kg_m": unbalance},
            )


def _measured_force(
    rig: _Rig,
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
    rig.virtual.decay(speed_rpm * RPM)
    for plane, direction in product(some_planes(rig.virtual.model, planes), directions):
        if direction not in _ACTS:
            raise ValueError(f"directions are {', '.join(_ACTS)}, got {direction!r}")
        acts = partial(_ACTS[direction], force, sweep)
        newton = acts(time)
        yield Played(
            name=f"{plane}-{direction}",
            motion=rig.path(lambda t: np.full(np.shape(t), speed_rpm * RPM), acts, plane, time.size),
            shaft=wandering_angle(time, speed_rpm * RPM, rig.instruments.wander, rig.rng),
            signals={"force_X": FORCE_SENSITIVITY * newton.real, "force_Y": FORCE_SENSITIVITY * newton.imag},
            attributes={"speed_rpm": speed_rpm, "force_plane": plane},
        )


def _impulse(
    rig: _Rig,
    *,
    speed_rpm: ArrayLike = 1500.0,
    impulse: float = 0.02,
    plane: str | None = None,
    blows: int = 4,
    apart: float = 2.0,
) -> Iterator[Played]:
    """Blows of a hammer, half sines of 2 ms."""
    where = plane or rig.virtual.model.planes[-1]
    time = rig.instruments.time(apart * (blows + 1))
    at, length = apart * np.arange(1, blows + 1), 2e-3

    def force(t: Float) -> ComplexArray:
        into = (t[:, None] - at) / length
        pulse = np.where((into > 0) & (into < 1), np.sin(np.pi * into), 0.0).sum(axis=1)
        return np.asarray(impulse * np.pi / (2 * length) * pulse, dtype=complex)

    for rpm in np.atleast_1d(np.asarray(speed_rpm, dtype=float)).tolist():
        rig.virtual.decay(rpm * RPM)
        speed = partial(_steady, rpm * RPM)
        yield Played(
            name=f"{where}-blows-{rpm:g}",
            motion=rig.path(speed, force, where, time.size),
            shaft=wandering_angle(time, rpm * RPM, rig.instruments.wander, rig.rng),
            attributes={"speed_rpm": rpm},
        )


def _steady(speed: float, t: Float) -> Float:
    return np.full(np.shape(t), speed)


FORCE_SENSITIVITY = 0.1
"""Of the channels of a measured force, V/N."""
_ACTS: Mapping[str, Callable[[float, Sweep, Float], ComplexArray]] = {
    "forward": lambda size, sweep, t: size * np.exp(1j * sweep.angle(t)),
    "backward": lambda size, sweep, t: size * np.exp(-1j * sweep.angle(t)),
    "x": lambda size, sweep, t: np.asarray(size * np.cos(sweep.angle(t)), dtype=complex),
    "y": lambda size, sweep, t: 1j * size * np.cos(sweep.angle(t)),
}


def _setup(kind: str) -> str:
    """What the files of a kind do not say themselves, as ``rig.toml``."""
    said = '# the files say the rest themselves\nrotation = "ccw"\n'
    if kind != "measured-force":
        return said
    return f'{said}[force]\nchannel_x = "force_X"\nchannel_y = "force_Y"\nsensitivity_V_per_N = {FORCE_SENSITIVITY}\n'


def _turning(sweep: Sweep, weight: complex, t: Float) -> ComplexArray:
    return weight * sweep.force(t, 0.0)


RECORDED: Mapping[str, Callable[..., Iterator[Played]]] = {
    "perturbation": _perturbation,
    "synchronous": _synchronous,
    "measured-force": _measured_force,
    "impulse": _impulse,
}
"""Kinds of tests that are recorded."""


def simulate_recordings(
    model: RotorModel,
    params: Mapping[str, float],
    folder: str | Path,
    kind: str = "perturbation",
    *,
    instruments: Instruments | None = None,
    residual: float = 1e-5,
    seed: int = 0,
    **options: Any,
) -> list[Path]:
    """Record tests of a virtual rig: raw volts of probes and Keyphasors in HDF5 files that say what they are.

    The linear rotor is integrated in time. Options of the kinds:

    - ``perturbation``: speed_rpm, sweep_rpm (first and last), duration, unbalance, planes, directions
    - ``synchronous``: speed_rpm (first and last), duration, unbalance, planes, hole_zero_deg
    - ``measured-force``: speed_rpm, sweep_rpm, duration, force, planes, directions (forward, backward, x, y)
    - ``impulse``: speed_rpm, impulse (N s), plane, blows, apart (s)

    A ``rig.toml`` beside the files says what they do not.

    Args:
        model: the rotor.
        params: its true parameters, SI units.
        folder: where the files go; it is made if it is not there.
        kind: a name above.
        instruments: what measures, by default :class:`rotorfit.simulation.instruments.Instruments`.
        residual: unbalance of the rotor itself in a start-up, kg m.
        seed: of noise and chance.
        options: of the kind.

    Returns:
        the files.

    Raises:
        ValueError: unknown kind, or a rotor that is unstable or whose motion depends on its eccentricity.
        KeyError: unknown or missing parameters.
    """
    if kind not in RECORDED:
        raise ValueError(unknown_name("kind of recorded test", kind, RECORDED))
    if model.eccentricity_dependent:
        raise ValueError(f"{model.name} with a law of eccentricity: recordings are simulated of linear rotors only")
    place = Path(folder)
    place.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(seed)
    rig = _Rig(VirtualRig(model, model.vector(params), 0.0, 1e-6, rng), instruments or Instruments(), residual)
    (place / "rig.toml").write_text(_setup(kind), encoding="utf-8")
    return [record(played, rig.instruments, place, rng) for played in RECORDED[kind](rig, **options)]
