"""A recording: volts of all channels of one run, read in pieces, with the setup that turns them into motion and angles.

:func:`read_recording` opens one. Nothing is read before it is asked for, and nothing whole unless asked for whole.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rotorfit.data.findings import Finding
from rotorfit.models.parameters import unknown_name
from rotorfit.recordings.angle_track import AngleTrack, track
from rotorfit.recordings.files import open_raw
from rotorfit.recordings.raw_file import RawFile
from rotorfit.recordings.resolve import Rig, complete
from rotorfit.recordings.rig_toml import read_setup
from rotorfit.recordings.setup import Force, Probe, RigSetup

Float = NDArray[np.float64]

PIECE = 1 << 20
"""Samples read at once where a channel is gone through from end to end: 8 MB in double precision."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Recording:
    """One run as it was recorded. Made by :func:`read_recording`.

    Attributes:
        raw: what the file holds.
        rig: which channel is what, complete.
        path: the file.
        setup: the setup it was opened with.
    """

    raw: RawFile
    rig: Rig
    path: Path
    setup: RigSetup | None

    def __reduce__(self) -> tuple[Any, ...]:
        return read_recording, (self.path, self.setup)  # a worker opens the file again

    @property
    def name(self) -> str:
        """Name of the file without folder and suffix."""
        return self.path.stem

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

    @property
    def force(self) -> Force | None:
        """What drives the rotor; None where neither file nor setup says."""
        return self.rig.force

    @property
    def speed(self) -> float | None:
        """Nominal rotative speed as file or setup give it, rad/s."""
        return self.rig.speed

    @property
    def attributes(self) -> Mapping[str, float | str]:
        """Test attributes, such as the oil temperature."""
        return self.rig.attributes

    def channel(self, name: str, start: int = 0, stop: int | None = None) -> Float:
        """Voltage of a channel.

        Args:
            name: of the channel.
            start, stop: samples from and to; by default all.

        Returns:
            V, shape ``(stop - start,)``.

        Raises:
            ValueError: no such channel, or samples that cannot be read.
        """
        if name not in self.rig.scales:
            raise ValueError(f"{self.name}: {unknown_name('channel', name, self.rig.scales)}")
        first, last, _ = slice(start, stop).indices(self.size)
        factor, offset = self.rig.scales[name]
        counts = self.raw.channels[name].samples(first, last)
        volts = counts * factor
        return np.asarray(volts + offset if offset else volts, dtype=float)

    def pieces(self, name: str) -> Iterator[Float]:
        """A channel in consecutive pieces, V.

        Args:
            name: of the channel.
        """
        for start in range(0, self.size, PIECE):
            yield self.channel(name, start, start + PIECE)

    def motion(self, plane: str, start: int = 0, stop: int | None = None) -> NDArray[Any]:
        """Motion of the shaft about its mean position over the recording.

        Args:
            plane: one of :attr:`planes`.
            start, stop: samples from and to.

        Returns:
            ``z = x + jy`` in m, complex, y 90 degrees ahead of x as the shaft turns; for a plane with one probe the
            motion along its angle, real.

        Raises:
            ValueError: no such plane, or its probes look in the same direction.
        """
        probes = self._probes_of(plane)
        along = np.stack([self.displacement(probe, start, stop) for probe in probes])
        if len(probes) == 1:
            return np.asarray(along[0])
        return np.asarray(self._mixing(plane) @ along)

    def displacement(self, probe: Probe, start: int = 0, stop: int | None = None) -> Float:
        """Motion towards one probe, about the mean, m.

        Args:
            probe: one of :attr:`probes`.
            start, stop: samples from and to.
        """
        volts = self.channel(probe.channel, start, stop)
        return np.asarray((volts - self.gap_voltage(probe.channel)) / float(probe.sensitivity or 1.0))

    def gap_voltage(self, name: str) -> float:
        """Mean voltage of a channel over the recording.

        Args:
            name: of the channel.
        """
        means = self.__dict__.setdefault("_means", {})
        if name not in means:
            means[name] = sum(float(piece.sum()) for piece in self.pieces(name)) / self.size
        return float(means[name])

    def _probes_of(self, plane: str) -> tuple[Probe, ...]:
        if plane not in self.planes:
            raise ValueError(f"{self.name}: {unknown_name('plane', plane, self.planes)}")
        return tuple(probe for probe in self.probes if probe.plane == plane)

    def _mixing(self, plane: str) -> NDArray[np.complex128]:
        """Row that makes ``x + jy`` of the motions along the probes: least squares for more than two probes."""
        angles = np.array([float(probe.angle or 0.0) for probe in self._probes_of(plane)])
        directions = np.column_stack([np.cos(angles), np.sin(angles)])
        if np.linalg.matrix_rank(directions, tol=1e-3) < 2:
            listed = ", ".join(f"{a:g}" for a in np.degrees(angles))
            raise ValueError(f"{self.name}: the probes of {plane} at {listed} degrees look in the same direction")
        inverse = np.linalg.pinv(directions)
        return np.asarray(inverse[0] + 1j * self.rig.rotation * inverse[1])

    def force_signal(self, start: int = 0, stop: int | None = None) -> NDArray[np.complex128]:
        """A measured force ``Fx + j Fy``, N.

        Args:
            start, stop: samples from and to.

        Raises:
            ValueError: the force of this recording was not measured.
        """
        force = self.force
        if force is None or not force.measured:
            raise ValueError(f"{self.name} has no measured force; name its channels in [force]")
        parts = [self.channel(name, start, stop) / force.sensitivity if name else 0.0 for name in force.channels]
        return np.asarray(parts[0] + 1j * self.rig.rotation * parts[1])

    def shaft_angle(self) -> AngleTrack:
        """Angle of the shaft from its Keyphasor.

        Raises:
            ValueError: the recording has no shaft reference, or no pulses on it.
        """
        if self.rig.shaft is None:
            raise ValueError(f"{self.name} has no phase reference of the shaft; name its channel in [shaft]")
        return self._shaft

    def perturbator_angle(self) -> AngleTrack | None:
        """Angle of the perturbator from its mark, growing whichever way it turns; None without a mark.

        Raises:
            ValueError: no pulses on its channel.
        """
        return None if self.rig.perturbator is None else self._perturbator

    @cached_property
    def _shaft(self) -> AngleTrack:
        return track(self, self.rig.shaft)  # type: ignore[arg-type]

    @cached_property
    def _perturbator(self) -> AngleTrack:
        return track(self, self.rig.perturbator)  # type: ignore[arg-type]

    @cached_property
    def findings(self) -> tuple[Finding, ...]:
        """What was found wrong or mended: setup against file, pulses, channels."""
        found = [*(Finding("note", "file", text) for text in self.raw.remarks), *self.rig.findings]
        if self.rig.shaft is not None:
            found += self._shaft.findings
        if self.rig.perturbator is not None:
            found += self._perturbator.findings
        return tuple(found)


def read_recording(path: str | Path, setup: str | Path | RigSetup | None = None) -> Recording:
    """Open a recording of raw signals: probes and Keyphasors in volts. Samples are read when they are asked for.

    Args:
        path: the file.
        setup: of the rig: path of ``rig.toml``, a setup, or None where the file's own attributes suffice.

    Raises:
        ValueError: what in file or setup is wrong or not said, and what to do.
        FileNotFoundError: no such file.
    """
    raw = open_raw(path)
    given = setup if isinstance(setup, RigSetup) or setup is None else read_setup(setup)
    return Recording(raw=raw, rig=complete(raw, given), path=Path(path), setup=given)
