"""The signals of a recording: volts of its channels in pieces, and the motion of the planes that its probes look at."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rotorfit.base.array_types import ComplexArray, Float
from rotorfit.base.names import unknown_name
from rotorfit.estimators.signals.late_channels import on_time
from rotorfit.lab.recordings.formats.raw_file import RawFile
from rotorfit.lab.recordings.rig.resolve import Rig
from rotorfit.lab.recordings.rig.setup import Force, Probe, RigSetup


def integrated(values: Float, rate: float, times: int) -> Float:
    """A signal integrated so many times, for figures: without what is slow, and with ends that fade in and out."""
    from scipy.signal.windows import tukey

    slowest, periods, fading = 2.0, 4, 0.1  # Hz and periods below which nothing is kept, and share that fades
    spectrum = np.fft.rfft(values * tukey(values.size, fading))
    lines = np.arange(spectrum.size)
    w = 2 * np.pi * rate / max(values.size, 1) * lines
    kept = (lines >= periods) & (w >= 2 * np.pi * slowest)
    whole = np.divide(spectrum, (1j * w) ** times, out=np.zeros_like(spectrum), where=kept)
    return np.asarray(np.fft.irfft(whole, values.size))


LARGEST_SAMPLE = 1e30
"""Size of a sample, volts or another unit, beyond which squares and products are no numbers any more."""
SAMPLES_OF_A_PIECE = 1 << 20
"""Samples read at once where a channel is gone through from end to end: 8 MB in double precision."""


def source_of(records: Sequence[Signals]) -> str:
    """Where a test came from: the files of its recordings and their setup."""
    setup = records[0].setup.source if records[0].setup is not None else ""
    return ", ".join(record.path.name for record in records) + (f" with {setup}" if setup else "")


@contextmanager
def said_of(name: str) -> Iterator[None]:
    """Refusals inside begin with what they are about."""
    try:
        yield
    except ValueError as problem:
        raise ValueError(f"{name}: {problem}") from problem


@dataclass(frozen=True, kw_only=True, eq=False)
class Signals:
    """Volts and motions of one run."""

    raw: RawFile = field(compare=False)  # what the file holds
    rig: Rig = field(compare=False)  # which channel is what, complete
    path: Path  # the file
    setup: RigSetup | None  # the setup it was opened with
    label: str | None = None  # name of the run, where another recording of the test has a file of the same name

    @property
    def name(self) -> str:
        """Name of the run: that of the file without folder and suffix, unless another is given."""
        return self.label or self.path.stem

    @property
    def sample_rate(self) -> float:
        """Samples a second, Hz."""
        return self.rig.sample_rate

    @property
    def size(self) -> int:
        """Samples of every channel."""
        return self.rig.size

    @property
    def duration(self) -> float:
        """Length of the recording, s."""
        return self.size / self.sample_rate

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the channels that the rig uses."""
        return tuple(self.rig.scales)

    @property
    def probes(self) -> tuple[Probe, ...]:
        """All displacement probes."""
        return self.rig.probes

    @property
    def planes(self) -> tuple[str, ...]:
        """Planes that have probes."""
        return tuple(dict.fromkeys(probe.plane for probe in self.probes))

    def derivative(self, plane: str) -> int:
        """How often the sensors of a plane differentiate its motion: 1 of velocity, 2 of acceleration."""
        orders = {probe.derivative for probe in self._probes_of(plane)}
        if len(orders) > 1:
            raise ValueError(f"{self.name}: {plane} has sensors of different quantities; call them by different planes")
        return orders.pop()

    def need_displacements(self, what: str) -> None:
        """Refuse sensors of velocity and acceleration for what they do not tell."""
        others = [probe.channel for probe in self.probes if probe.derivative]
        if others:
            raise ValueError(
                f"{self.name}: {', '.join(others)} read velocity or acceleration; {what} needs displacement probes. "
                "Responses to a perturbator or to measured forces, of a hammer for instance, take such sensors"
            )

    @property
    def pairs(self) -> tuple[str, ...]:
        """Planes that have two probes or more, so that the orbit is known."""
        return tuple(plane for plane in self.planes if len(self._probes_of(plane)) > 1)

    @property
    def force(self) -> Force | None:
        """Force that drives the rotor; None where neither file nor setup says."""
        return self.rig.force

    @property
    def speed(self) -> float | None:
        """Nominal rotative speed as file or setup give it, rad/s."""
        return self.rig.speed

    @property
    def stated_speed(self) -> float:
        """Rotative speed of a shaft without a mark, rad/s, as file or setup give it.

        Raises:
            ValueError: neither does.
        """
        if self.speed is None:
            raise ValueError(
                f"{self.name}: nothing says how fast the shaft turns: name the channel of its mark in [shaft], or say "
                "speed_rpm in the setup (speed_rpm = 0.0 for a rotor at rest)"
            )
        return abs(self.speed)

    @property
    def attributes(self) -> Mapping[str, float | str]:
        """Test attributes, such as the oil temperature."""
        return self.rig.attributes

    def channel(self, name: str, start: int = 0, stop: int | None = None) -> Float:
        """Voltage of a channel, shape ``(stop - start,)``; of a probe whose channel comes late at the others' times."""
        if name not in self.rig.scales:
            raise ValueError(f"{self.name}: {unknown_name('channel', name, self.rig.scales)}")
        first, last, _ = slice(start, stop).indices(self.size)
        factor, offset = self.rig.scales[name]
        if late := self.rig.late(name) * self.sample_rate:
            volts = on_time(lambda *ends: self._stored(name, *ends) * factor, first, last, self.size, late)
        else:
            volts = self._stored(name, first, last) * factor
        return np.asarray(volts + offset if offset else volts, dtype=float)

    def _stored(self, name: str, first: int, last: int) -> NDArray[Any]:
        """Samples as the file stores them, counts or volts."""
        counts = self.raw.channels[name].samples(first, last)
        if counts.dtype.kind == "f" and not (np.abs(counts) <= LARGEST_SAMPLE).all():
            at = first + int(np.flatnonzero(~(np.abs(counts) <= LARGEST_SAMPLE))[0])
            allowed = f"; samples may be up to {LARGEST_SAMPLE:g} in size" if np.isfinite(counts[at - first]) else ""
            raise ValueError(
                f"{self.name}: channel {name} is {counts[at - first]} at sample {at} ({at / self.sample_rate:.4f} s); "
                f"cut the recording there or leave the channel out{allowed}"
            )
        return counts

    def stored_pieces(self, name: str) -> Iterator[NDArray[Any]]:
        """A channel in consecutive pieces as the file stores it, for what can be computed quicker in counts."""
        for start in range(0, self.size, SAMPLES_OF_A_PIECE):
            yield self._stored(name, start, min(start + SAMPLES_OF_A_PIECE, self.size))

    def pieces(self, name: str) -> Iterator[Float]:
        """A channel in consecutive pieces, V."""
        for start in range(0, self.size, SAMPLES_OF_A_PIECE):
            yield self.channel(name, start, start + SAMPLES_OF_A_PIECE)

    def motion(self, plane: str, start: int = 0, stop: int | None = None) -> NDArray[Any]:
        """Motion about the mean position over the recording, m: complex ``z = x + jy``, y 90 degrees ahead of x as the
        shaft turns, or real, along the angle of the only probe."""
        probes = self._probes_of(plane)
        along = np.stack([self.displacement(probe, start, stop) for probe in probes])
        if len(probes) == 1:
            return np.asarray(along[0])
        return np.asarray(self._mixing(plane) @ along)

    def displacement(self, probe: Probe, start: int = 0, stop: int | None = None) -> Float:
        """Motion towards one probe, about the mean, m; of velocity and acceleration as far as a stretch tells it."""
        volts = self.without_run_out(probe, start, stop)
        values = np.asarray((volts - self.gap_voltage(probe.channel)) / float(probe.sensitivity or 1.0))
        return integrated(values, self.sample_rate, probe.derivative) if probe.derivative and values.size else values

    def without_run_out(self, probe: Probe, start: int = 0, stop: int | None = None) -> Float:
        """Voltage of a probe without the run-out that the setup says slow turning shows."""
        return self.channel(probe.channel, start, stop)

    def gap_voltage(self, name: str) -> float:
        """Mean voltage of a channel over the recording."""
        means = self.__dict__.setdefault("_means", {})
        if name not in means:
            factor, offset = self.rig.scales[name]
            wide = {"f": np.float64}  # what adds up without overflow or loss; of counts whole numbers
            pieces = self.stored_pieces(name)
            total = sum(float(piece.sum(dtype=wide.get(piece.dtype.kind, np.int64))) for piece in pieces)
            means[name] = total / self.size * factor + offset
        return float(means[name])

    def _probes_of(self, plane: str) -> tuple[Probe, ...]:
        if plane not in self.planes:
            raise ValueError(f"{self.name}: {unknown_name('plane', plane, self.planes)}")
        return tuple(probe for probe in self.probes if probe.plane == plane)

    def resolved(self, plane: str, along: NDArray[Any]) -> NDArray[Any]:
        """x and y of what each probe of a plane reads, shape ``(2, ...)``, of readings of shape ``(probes, ...)``."""
        mixing = self._mixing(plane)
        return np.stack([mixing.real @ along, mixing.imag @ along])

    def resolved_variance(self, plane: str, along: Float) -> Float:
        """Variance of x and of y, their mean, of those of the readings along the probes of a plane."""
        return np.asarray(np.tensordot(np.abs(self._mixing(plane)) ** 2, along, 1) / 2)

    def _mixing(self, plane: str) -> ComplexArray:
        """Row that makes ``x + jy`` of the motions along the probes: least squares for more than two probes."""
        angles = np.array([float(probe.angle or 0.0) for probe in self._probes_of(plane)])
        directions = np.column_stack([np.cos(angles), np.sin(angles)])
        if np.linalg.matrix_rank(directions, tol=1e-3) < 2:
            listed = ", ".join(f"{a:g}" for a in np.degrees(angles))
            raise ValueError(f"{self.name}: the probes of {plane} at {listed} degrees look in the same direction")
        inverse = np.linalg.pinv(directions)
        return np.asarray(inverse[0] + 1j * self.rig.rotation * inverse[1])

    def bearing_centre(self, plane: str) -> complex | None:
        """Where the bearing's centre is in the coordinates of :meth:`motion`, m; None where no ``centre_V`` says it."""
        probes = self._probes_of(plane)
        if len(probes) < 2 or any(probe.centre is None for probe in probes):
            return None
        volts = np.array([float(probe.centre or 0.0) - self.gap_voltage(probe.channel) for probe in probes])
        return complex(self._mixing(plane) @ (volts / [float(probe.sensitivity or 1.0) for probe in probes]))

    def force_signal(self, start: int = 0, stop: int | None = None) -> ComplexArray:
        """A measured force ``Fx + j Fy``, N."""
        force = self.force
        if force is None or not force.measured:
            raise ValueError(f"{self.name} has no measured force; name its channels in [force]")
        parts = [self.channel(name, start, stop) / force.sensitivity if name else 0.0 for name in force.channels]
        return np.asarray(parts[0] + 1j * self.rig.rotation * parts[1])
