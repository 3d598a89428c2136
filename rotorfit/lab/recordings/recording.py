"""A recording: volts of all channels of one run, read in pieces, with the setup that turns them into motion and angles.

:func:`read_recording` opens one. Nothing is read before it is asked for, and nothing whole unless asked for whole.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from rotorfit.base.accessors import Accessor
from rotorfit.base.array_types import Float
from rotorfit.base.atomic_file import joined
from rotorfit.base.digits import significant
from rotorfit.base.equality import ByValue
from rotorfit.lab.data.findings import Finding, listed
from rotorfit.lab.recordings import quality, views
from rotorfit.lab.recordings.angle_track import AngleTrack, Marks, steady_track, track
from rotorfit.lab.recordings.channel_statistics import ChannelStatistics, statistics
from rotorfit.lab.recordings.formats.files import open_raw
from rotorfit.lab.recordings.rig.resolve import complete
from rotorfit.lab.recordings.rig.rig_toml import read_setup
from rotorfit.lab.recordings.rig.setup import Probe, RigSetup
from rotorfit.lab.recordings.signals import Signals
from rotorfit.lab.recordings.slow_roll import RunOut, find_run_out, in_words


@dataclass(frozen=True, kw_only=True, eq=False)
class Recording(ByValue, Signals):
    """One run as it was recorded: signals, angles and what was found wrong. Made by :func:`read_recording`."""

    plot = Accessor()

    def __repr__(self) -> str:
        """Name, length and channels, on one line."""
        channels = ", ".join(self.channels)
        return f"<Recording {self.name}: {significant(self.duration, 4)} s at {self.sample_rate:.6g} Hz, {channels}>"

    def _repr_html_(self) -> str:
        """Channels and what they are, as a table for a notebook."""
        probes = {p.channel: f"probe at {p.plane}, {np.degrees(p.angle or 0.0):g} degrees" for p in self.probes}
        cells = "".join(f"<tr><td>{escape(c)}</td><td>{escape(probes.get(c, ''))}</td></tr>" for c in self.channels)
        head = "<thead><tr><th>channel</th><th>what it is</th></tr></thead>"
        return f"<p>{escape(repr(self)[1:-1])}</p><table>{head}<tbody>{cells}</tbody></table>"

    def __reduce__(self) -> tuple[Any, ...]:
        return read_recording, (self.path, self.setup), {"label": self.label}  # a worker opens the file again

    def shaft_angle(self) -> AngleTrack:
        """Angle of the shaft from its Keyphasor.

        Raises:
            ValueError: the recording has no shaft reference, or no pulses on it.
        """
        if self.shaft is None:
            raise ValueError(f"{self.name} has no phase reference of the shaft; name its channel in [shaft]")
        return self.shaft

    def perturbator_angle(self) -> AngleTrack | None:
        """Angle of the perturbator from its mark, growing whichever way it turns; None without a mark.

        Of one that the setup says is ``steady`` and has no mark, frequency from the motion and angle zero at the start.

        Raises:
            ValueError: no pulses on its channel, or no steady line in the motion.
        """
        return self.marks.perturbator

    @cached_property
    def run_out(self) -> RunOut | None:
        """Run-out that ``[slow_roll]`` of the setup says to take out of the signals; None where it says nothing.

        Raises:
            ValueError: the shaft hardly turns so slowly.
            FileNotFoundError: no such recording of slow turning.
        """
        how = self.rig.slow_roll
        if how is None or self.setup is None:
            return None
        slow = self
        if how.file is not None:
            slow = read_recording(joined(self.path.parent, how.file), replace(self.setup, slow_roll=None))
        return find_run_out(slow, slow.shaft_angle(), how)

    def without_run_out(self, probe: Probe, start: int = 0, stop: int | None = None) -> Float:
        """Voltage of a probe without its run-out; before the first mark and after the last the angle is continued.

        Args:
            probe: one of :attr:`probes`.
            start, stop: samples from and to.
        """
        volts = self.channel(probe.channel, start, stop)
        if self.run_out is None:
            return volts
        first, last, _ = slice(start, stop).indices(self.size)
        t = np.arange(first, last) / self.sample_rate
        return np.asarray(volts - self.run_out.volts(probe.channel, self.shaft_angle().angle(t)))

    @cached_property
    def shaft(self) -> AngleTrack | None:
        """Angle of the shaft; None where it has no mark."""
        return None if self.rig.shaft is None else track(self, self.rig.shaft)

    @cached_property
    def twist(self) -> Float:
        """Twist at every sample, its mean taken out, rad, from a torsion channel or two tooth wheels.

        Raises:
            ValueError: no twist was measured, or a wheel without pulses.
        """
        return views.twist_of(self)

    @cached_property
    def findings(self) -> tuple[Finding, ...]:
        """Faults that were found or corrected: setup against file, pulses, channels."""
        found = [*(Finding("note", "file", text) for text in self.raw.remarks), *self.rig.findings]
        found += [] if self.setup is None else [*_absent_runs(self.path, self.setup)]
        shaft, perturbator = self.marks.shaft, self.marks.perturbator
        found += [finding for angle in (shaft, perturbator) if angle is not None for finding in angle.findings]
        found += [*quality.setting_findings(self)]
        found += [] if shaft is None else [*quality.speed_findings(self, shaft), *quality.folding_findings(self, shaft)]
        found += [] if shaft is None or perturbator is None else quality.mark_findings(self, shaft, perturbator)
        found += quality.probe_findings(self, self.statistics)
        found += quality.direction_findings(self, shaft, perturbator)
        found += quality.hum_findings(self, shaft)
        found += [] if self.run_out is None else [Finding("note", "slow-roll", in_words(self, self.run_out))]
        return tuple(found)

    @cached_property
    def statistics(self) -> Mapping[str, ChannelStatistics]:
        """Mean, range and scatter of the voltage of each probe, from one pass over its channel."""
        return {probe.channel: statistics(self, probe.channel) for probe in self.probes}

    @cached_property
    def marks(self) -> Marks:
        """Angles of shaft and perturbator, either may be missing."""
        reference, whirl = self.rig.perturbator, 1 if self.force is None else self.force.whirl
        perturbator = None
        if reference is not None:
            steady = reference.channel is None
            perturbator = steady_track(self, self.shaft, whirl) if steady else track(self, reference)
        return Marks(shaft=self.shaft, perturbator=perturbator, whirl=whirl)


def _absent_runs(path: Path, setup: RigSetup) -> Iterator[Finding]:
    """A ``[[run]]`` of a file that is not there, where the one that is read has none: misspelt, it says nothing."""
    if setup.of_file(path.name) is not setup:
        return
    files = [file.name for file in path.parent.iterdir()]
    stems = {name.rpartition(".")[0] for name in files}
    absent = [name for name in setup.runs if name not in files and name not in stems]
    if absent:
        words = (
            f"{path.name} has no [[run]] in {setup.source or 'the setup'}, which has one of {listed(absent)}; there is "
            f"no such file beside it, and what that says is not used. Is {path.name} meant?"
        )
        yield Finding("warning", "run-absent", words)


def read_recording(path: str | Path, setup: str | Path | RigSetup | None = None) -> Recording:
    """Open a recording of raw signals: probes and Keyphasors in volts. Samples are read when they are asked for.

    Args:
        path: the file.
        setup: of the rig: path of ``rig.toml``, a setup, or None where the file's own attributes suffice.

    Raises:
        ValueError: what in file or setup is wrong or not said, and what to do.
        FileNotFoundError: no such file.

    Example:
        >>> record = rf.read_recording(rf.datasets.path("volts_journal-fwd.h5"))
        >>> record.planes, record.sample_rate
        (('disk', 'journal'), 4096.0)
        >>> record.findings
        ()
    """
    raw = open_raw(path)
    given = setup if isinstance(setup, RigSetup) or setup is None else read_setup(setup)
    return Recording(raw=raw, rig=complete(raw, given), path=Path(path), setup=given)


def named_apart(records: Recording | Sequence[Recording]) -> list[Recording]:
    """The recordings of a test; those whose files have one name are named by as many folders as tell them apart."""
    listed = list(records) if isinstance(records, Sequence) and not isinstance(records, str) else [records]
    if not listed:
        raise ValueError("no recordings given")
    for record in listed:
        if not isinstance(record, Recording):
            raise TypeError(f"{str(record)!r:.80} is no recording; rf.read_recording reads one from its file")
    count = Counter(record.name for record in listed)
    return [
        record if count[record.name] == 1 else replace(record, label=_distinct_name(record.path, listed))
        for record in listed
    ]


def _distinct_name(path: Path, records: Sequence[Recording]) -> str:
    """The shortest end of a path that no other recording's path has: with its suffix, with one folder, with two, ..."""
    others = {record.path.resolve() for record in records} - {path.resolve()}
    parts = path.resolve().parts
    for length in range(1, len(parts)):
        end = parts[-length:]
        if not any(other.parts[-length:] == end for other in others):
            same_folder = any(other.parent == path.resolve().parent and other.stem == path.stem for other in others)
            return "/".join((*end[:-1], path.name if same_folder else path.stem))
    return path.stem
