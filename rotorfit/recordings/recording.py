"""A recording: volts of all channels of one run, read in pieces, with the setup that turns them into motion and angles.

:func:`read_recording` opens one. Nothing is read before it is asked for, and nothing whole unless asked for whole.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from rotorfit.data.findings import Finding
from rotorfit.recordings.angle_track import AngleTrack, track
from rotorfit.recordings.files import open_raw
from rotorfit.recordings.quality import (
    ChannelStatistics,
    direction_findings,
    hum_findings,
    probe_findings,
    speed_findings,
    statistics,
)
from rotorfit.recordings.resolve import complete
from rotorfit.recordings.rig_toml import read_setup
from rotorfit.recordings.setup import RigSetup
from rotorfit.recordings.signals import Signals


@dataclass(frozen=True, kw_only=True, eq=False)
class Recording(Signals):
    """One run as it was recorded: signals, angles and what was found wrong. Made by :func:`read_recording`."""

    def __reduce__(self) -> tuple[Any, ...]:
        return read_recording, (self.path, self.setup)  # a worker opens the file again

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
        shaft = None if self.rig.shaft is None else self._shaft
        perturbator = self.perturbator_angle()
        found += [finding for angle in (shaft, perturbator) if angle is not None for finding in angle.findings]
        found += [] if shaft is None else speed_findings(self, shaft)
        found += probe_findings(self, self.statistics)
        found += direction_findings(self, shaft, perturbator)
        found += hum_findings(self, shaft)
        return tuple(found)

    @cached_property
    def statistics(self) -> Mapping[str, ChannelStatistics]:
        """Mean, range and scatter of the voltage of each probe, from one pass over its channel."""
        return {probe.channel: statistics(self, probe.channel) for probe in self.probes}


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
