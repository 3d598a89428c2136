"""The instruments of a virtual rig: probes, Keyphasors and a recorder, with all that real ones do to a signal."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path

import numpy as np

from rotorfit.base.array_types import ComplexArray, Float
from rotorfit.base.atomic_file import whole_file

_NOTCH, _RAMP = np.radians(24.0), np.radians(6.0)
"""Width of the notch and of each of its ramps, rad."""


LARGEST_RECORD = 100_000_000
"""Samples of a channel that a virtual rig records at most."""


def sample_times(duration: float, rate: float) -> Float:
    """Times of the samples of a record, s; two at least.

    Raises:
        ValueError: a duration or a rate that is not above zero, or too many samples.
    """
    if not (duration > 0 and rate > 0 and duration * rate <= LARGEST_RECORD):
        raise ValueError(
            f"a record of {duration:g} s at {rate:g} Hz cannot be: both must be above zero, with at most "
            f"{LARGEST_RECORD:g} samples"
        )
    return np.arange(max(int(duration * rate), 2)) / rate


@dataclass(frozen=True, kw_only=True)
class Probes:
    """Displacement probes in x and y and what reads them, alike on every virtual rig."""

    sample_rate: float = 6400.0  # Hz
    sensitivity: float = 7870.0  # V/m
    gap: float = -10.0  # voltage at rest
    noise: float = 3e-3  # standard deviation of the noise, V

    def volts(self, towards: Float) -> Float:
        """Voltage of a probe without noise."""
        return self.gap + self.sensitivity * towards

    def said(self, angles: tuple[float, float] = (0.0, 90.0)) -> dict[str, str | float]:
        """Attributes of a file that tell of the probes."""
        return {
            "sample_rate_hz": self.sample_rate,
            "sensitivity_V_per_mm": self.sensitivity / 1e3,
            "probe_angle_deg_X": angles[0],
            "probe_angle_deg_Y": angles[1],
        }


@dataclass(frozen=True, kw_only=True)
class Instruments(Probes):
    """Instruments that measure and record; the defaults are a good set of instruments on a rotor with ordinary run-out.

    Attributes:
        sample_rate: Hz.
        sensitivity: of the probes, V/m.
        gap: voltage of a probe at rest.
        noise: standard deviation of the noise of every channel, V.
        keyphasor_noise: of the Keyphasors, V.
        bits, full_scale: of the recorder; full scale in V.
        runout: amplitude of run-out at 1x, 2x, ..., m, in an arbitrary direction for each plane.
        hum, hum_hz: amplitude of mains hum in all channels, V, and its frequency.
        wander: standard deviation of the rotative speed over the speed, slow.
        force_sensitivity, force_noise: of the channels of a measured force, V/N, and their noise, N.
        probe_angles: of the probes named X and Y, degrees.
        lost, doubled: Keyphasor pulses of the shaft that are missing and that are there twice.
        clipped: channel that saturates, "" for none.
        ac_coupled: whether the recorder takes out the gap voltage.
    """

    keyphasor_noise: float = 0.05
    bits: int = 16
    full_scale: float = 20.0
    runout: tuple[float, ...] = (12e-6, 4e-6, 2e-6, 1e-6, 0.5e-6)
    hum: float = 0.0
    hum_hz: float = 50.0
    wander: float = 2e-4
    force_sensitivity: float = 0.1
    force_noise: float = 0.03
    probe_angles: tuple[float, float] = (0.0, 90.0)
    lost: int = 0
    doubled: int = 0
    clipped: str = ""
    ac_coupled: bool = False

    def time(self, duration: float) -> Float:
        """Times of the samples, s.

        Args:
            duration: of the recording, s.
        """
        return sample_times(duration, self.sample_rate)


@dataclass(frozen=True, kw_only=True, eq=False)
class Played:
    """One run of a virtual rig, before instruments."""

    name: str  # of the run; the file is named so
    motion: Mapping[str, ComplexArray]  # of each plane, ``x + jy``, m, shape ``(T,)``
    shaft: Float  # angle of the shaft, rad, shape ``(T,)``
    perturbator: Float | None = None  # angle of the perturbator, growing whichever way it turns; None without
    forces: Mapping[str, Float] = field(default_factory=dict)  # measured forces by channel, N
    attributes: Mapping[str, str | float] = field(default_factory=dict)  # of the file


def record(played: Played, instruments: Instruments, folder: Path, rng: np.random.Generator) -> Path:
    """Measure a run and write its HDF5 file. Returns the path of the file."""
    channels: dict[str, Float] = {}
    time = np.arange(played.shaft.size) / instruments.sample_rate
    for plane, z in played.motion.items():
        seen = z + _runout(played.shaft, instruments, plane)
        for axis, degrees in zip("XY", instruments.probe_angles, strict=True):
            towards = np.real(seen * np.exp(-1j * np.radians(degrees)))
            channels[f"{plane}_{axis}"] = instruments.volts(towards)
    channels = {name: _disturbed(name, clean, time, instruments, rng) for name, clean in channels.items()}
    for name, newton in played.forces.items():
        measured = newton + instruments.force_noise * rng.standard_normal(newton.size)
        channels[name] = _disturbed(name, instruments.force_sensitivity * measured, time, instruments, rng, noise=0.0)
    channels["keyphasor_shaft"] = _keyphasor(played.shaft, instruments, rng, mishaps=True)
    if played.perturbator is not None:
        channels["keyphasor_perturbator"] = _keyphasor(played.perturbator, instruments, rng, mishaps=False)
    said = instruments.said(instruments.probe_angles) | {"keyphasor": "falling edge of a notch, -2 V to -8 V"}
    path, said = folder / f"{played.name}.h5", said | dict(played.attributes)
    return write_counts(path, channels, said, bits=instruments.bits, full_scale=instruments.full_scale)


def write_counts(
    path: Path,
    channels: Mapping[str, Float],
    attributes: Mapping[str, str | float],
    *,
    bits: int = 16,
    full_scale: float = 20.0,
) -> Path:
    """Write channels as the counts of a recorder, for :func:`rotorfit.read_recording`, whole or not at all. Returns the
    path."""
    import h5py

    slashed = next((name for name in channels if "/" in name), None)
    if slashed is not None:
        raise ValueError(f"no channel of an HDF5 file can be called {slashed!r}: a slash stands between groups")
    limit = 2 ** (bits - 1)
    step = full_scale / limit
    content = BytesIO()  # the HDF5 library ends the process where a disk is full
    with h5py.File(content, "w") as file:
        for name, volts in channels.items():
            counts = np.clip(np.rint(volts / step), -limit, limit - 1).astype(np.int16 if limit <= 2**15 else np.int32)
            chunks = (min(6000, counts.size),)
            data = file.create_dataset(name, data=counts, chunks=chunks, compression="gzip", shuffle=True)
            data.attrs["volts_per_count"] = step
        file.attrs.update(attributes)
    with whole_file(path) as draft:
        draft.write_bytes(content.getbuffer())
    return path


def _disturbed(
    name: str, clean: Float, time: Float, instruments: Instruments, rng: np.random.Generator, noise: float | None = None
) -> Float:
    """A channel with hum and noise, as the recorder takes it."""
    size = instruments.noise if noise is None else noise
    hum = instruments.hum * np.cos(2 * np.pi * instruments.hum_hz * time + rng.uniform(0, 2 * np.pi))
    volts = clean + hum + size * rng.standard_normal(time.size)
    if instruments.ac_coupled:
        volts -= volts.mean()
    return np.clip(volts, *np.quantile(volts, [0.03, 0.97])) if name == instruments.clipped else np.asarray(volts)


def _runout(angle: Float, instruments: Instruments, plane: str) -> ComplexArray:
    """Readings of the probes of a plane of a shaft that does not move: the same in every run."""
    rng = np.random.default_rng(list(plane.encode()))
    seen = np.zeros(angle.size, dtype=complex)
    for order, size in enumerate(instruments.runout, start=1):
        forward, backward = rng.uniform(0, 2 * np.pi, 2)
        seen += size * np.exp(1j * (order * angle + forward)) + 0.3 * size * np.exp(-1j * (order * angle + backward))
    return seen


def _keyphasor(angle: Float, instruments: Instruments, rng: np.random.Generator, *, mishaps: bool) -> Float:
    """Voltage of a notch 24 degrees wide whose falling edge, 6 degrees wide, is angle zero."""
    depth = notch(angle, width=_NOTCH, ramp=_RAMP)
    if mishaps:
        turn = np.floor(np.degrees(angle) / 360.0 + 0.5)
        turns = np.arange(turn.min() + 3, turn.max() - 3)
        chosen = rng.choice(turns, min(instruments.lost + instruments.doubled, turns.size), replace=False)
        depth = np.where(np.isin(turn, chosen[: instruments.lost]), 0.0, depth)
        again = notch(angle - np.radians(63.0), width=np.radians(15.0), ramp=_RAMP)
        depth = depth + np.where(np.isin(turn, chosen[instruments.lost :]), again, 0.0)
    return keyphasor_volts(depth) + instruments.keyphasor_noise * rng.standard_normal(angle.size)


def notch(angle: Float, *, width: float, ramp: float) -> Float:
    """Depth, 0 to 1, of a notch that begins half way down its first ramp at angle zero."""
    into = np.mod(angle + np.pi, 2 * np.pi) - np.pi
    return np.asarray(np.clip(0.5 + into / ramp, 0.0, 1.0) - np.clip(0.5 + (into - width) / ramp, 0.0, 1.0))


def keyphasor_volts(depth: Float) -> Float:
    """Voltage of a Keyphasor over a notch."""
    return np.asarray(-2.0 - 6.0 * depth)  # -2 V beside the notch, -8 V in it
