"""Statistics of one pass over a channel: mean, range and scatter of its voltage, how often it stays at an extreme, and
for how long it stands still."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from rotorfit.base.array_types import Bool, Float, Index
from rotorfit.lab.recordings.signals import Signals

_HELD_SAMPLES, _LARGEST_EQUAL_SHARE = 16, 0.25
"""Equal samples in a row that are held ones, and the share of equal neighbours elsewhere from which a channel is too
quiet to tell."""
_JUMP_COUNTS = 4.0
"""Counts by which a channel jumps where it was held or clipped; the crest of a quiet signal is left count by count."""

CLIPPED_STRETCHES = 3
"""Stretches at an extreme from which a channel is clipped, not interrupted there."""


@dataclass(frozen=True, kw_only=True)
class ChannelStatistics:
    """One pass over a channel."""

    mean: float  # mean, deviation, low, high: in the unit
    deviation: float
    low: float
    high: float
    # flat_low, flat_high: stretches of at least three equal samples at the lowest and at the highest voltage that the
    # signal enters with a jump
    flat_low: int
    flat_high: int
    step: float  # smallest difference between samples, V: one count
    at_low: float  # at_low, at_high: share of the samples at the extremes
    at_high: float
    # from when to when, s, the channel stays on one count though it carries noise elsewhere
    still: tuple[tuple[float, float], ...]
    noise: float  # deviation of its samples from their neighbours; that of white noise is the whole deviation
    idle: bool  # whether the probe looks across the force of a rotor at rest, which moves along the force alone
    unit: str  # of the channel: V, or that in which it is scaled already

    @property
    def clipped(self) -> bool:
        """True if the signal stays at one of its extremes again and again."""
        return max(self.flat_low, self.flat_high) >= CLIPPED_STRETCHES

    @property
    def without_gap(self) -> bool:
        """True if the mean voltage is too near to zero to be a probe's gap: AC-coupled."""
        least_gap = 0.25  # voltage below which a mean is no probe's gap
        return abs(self.mean) < max(least_gap if self.unit == "V" else 0.0, 0.05 * self.deviation)


def statistics(record: Signals, name: str) -> ChannelStatistics:
    """Go through a channel once."""
    factor, offset = record.rig.scales[name]
    integers = record.raw.channels[name].full_count is not None
    total = squares = changes = 0.0
    step = 1.0 if integers else np.inf  # in counts, or in what the file stores
    bottom, top = _Top(), _Top()
    window, fewest = 0.05, 32  # length of the windows in which a channel is looked at, s, and their samples at least
    quiet = _Quiet(length=max(fewest, round(window * record.sample_rate)))
    for piece in record.stored_pieces(name):
        values = piece.astype(float)
        differences = np.diff(values)
        total += float(values.sum())
        squares += float(values @ values)
        changes += float(differences @ differences)
        quiet.see(values, differences)
        if not np.isfinite(step):
            sizes = np.abs(differences[:4095])
            step = float(sizes[sizes > 0].min(initial=np.inf))
        bottom.see(-values, step)
        top.see(values, step)
    mean, lowest, highest = total / record.size, -bottom.value, top.value
    clipped = [v for v, end in ((lowest, bottom), (highest, top)) if end.stretches >= CLIPPED_STRETCHES]
    probe = next(probe for probe in record.probes if probe.channel == name)
    if factor < 0:
        bottom, top, lowest, highest = top, bottom, highest, lowest
    channels = record.force.channels if record.force is not None and record.speed == 0 else ("", "")
    axis = 0.0 if channels[0] else np.pi / 2  # of the force of a rotor at rest, where it has one
    return ChannelStatistics(
        mean=mean * factor + offset,
        deviation=float(np.sqrt(max(squares / record.size - mean**2, 0.0))) * abs(factor),
        low=lowest * factor + offset,
        high=highest * factor + offset,
        flat_low=bottom.stretches,
        flat_high=top.stretches,
        step=step * abs(factor) if np.isfinite(step) else 0.0,
        at_low=bottom.samples / record.size,
        at_high=top.samples / record.size,
        still=tuple((low / record.sample_rate, high / record.sample_rate) for low, high in quiet.stretches(clipped)),
        noise=float(np.sqrt(changes / (2 * record.size))) * abs(factor),
        idle=bool(channels[0]) != bool(channels[1]) and abs(np.cos((probe.angle or 0.0) - axis)) < 0.5,
        unit=probe.unit or "V",
    )


def _stretches(true: Bool) -> Index:
    """Where what is true begins, and the first place after it, shape ``(S, 2)``."""
    return np.flatnonzero(np.diff(np.concatenate([[False], true, [False]]).astype(np.int8))).reshape(-1, 2)


@dataclass(kw_only=True, eq=False)
class _Quiet:
    """Where a channel stands still: windows in which it moves by less than a count, and stretches of equal samples, as
    a card or a network leaves them that lost some and repeats the last one."""

    length: int  # samples of a window
    seen: int = 0  # samples so far
    step: float = np.inf  # smallest change between samples: a card may have fewer bits than the file
    begin: list[Index] = field(default_factory=list)  # of the windows
    moves: list[Float] = field(default_factory=list)  # deviation within each window
    equal: int = 0  # neighbours that are equal, those of long stretches left out
    held: list[tuple[int, int, float, float]] = field(default_factory=list)  # from, to, value, jump at an end

    def see(self, values: Float, differences: Float) -> None:
        windows = values[: values.size // self.length * self.length].reshape(-1, self.length)
        square = np.einsum("ij,ij->i", windows, windows) / self.length
        self.moves.append(np.sqrt(np.maximum(square - windows.mean(axis=1) ** 2, 0.0)))
        self.begin.append(self.seen + self.length * np.arange(len(windows)))
        changes = np.abs(differences)
        self.step = min(self.step, float(changes.min(where=changes > 0, initial=np.inf)))
        begin, end = _stretches(changes == 0).T  # first and last sample of each stretch
        long = end - begin + 1 >= _HELD_SAMPLES
        self.equal += int(np.sum((end - begin)[~long]))
        for low, high in zip(begin[long].tolist(), end[long].tolist(), strict=True):
            beside = values[[max(low - 1, 0), min(high + 1, values.size - 1)]]
            jump = float(np.abs(beside - values[low]).max())
            self.held.append((self.seen + low, self.seen + high + 1, float(values[low]), jump))
        self.seen += values.size

    def stretches(self, clipped: Sequence[float]) -> list[tuple[int, int]]:
        """Samples from and to, in order; where a channel is cut off at an extreme again and again it is clipped."""
        if not np.isfinite(self.step):
            return []
        still = self._windows()
        if self.equal <= _LARGEST_EQUAL_SHARE * self.seen:
            least = _JUMP_COUNTS * self.step
            still += [(low, high) for low, high, value, jump in self.held if jump > least and value not in clipped]
        found: list[tuple[int, int]] = []
        for low, high in sorted(still):
            if found and low <= found[-1][1]:  # they overlap
                found[-1] = (found[-1][0], max(found[-1][1], high))
            else:
                found.append((low, high))
        return found

    def _windows(self) -> list[tuple[int, int]]:
        """Stretches on one count, that the channel enters or leaves with all its noise."""
        begin, moves = np.concatenate(self.begin), np.concatenate(self.moves)
        found = []  # to and fro between two neighbouring counts has 0.5
        for low, high in _stretches(moves <= 0.6 * self.step).tolist():
            # The window that holds the end of the stretch is passed over.
            beside = [*moves[max(low - 2, 0) : max(low - 1, 0)].tolist(), *moves[high + 1 : high + 2].tolist()]
            still_windows = 4  # windows in a row that a channel stands still for, from which no chance is left
            noise_counts = 3.0  # deviation beside such a stretch, counts, from which no motion died down to it
            if high - low >= still_windows and beside and min(beside) >= noise_counts * self.step:
                found.append((int(begin[low]), int(begin[high - 1]) + self.length))
        return found


@dataclass(kw_only=True)
class _Top:
    """The highest value so far, how often the signal stayed there and how long."""

    value: float = -np.inf
    stretches: int = 0
    samples: int = 0

    def see(self, values: Float, step: float) -> None:
        highest = float(values.max())
        if highest > self.value:
            self.value, self.stretches, self.samples = highest, 0, 0
        if highest == self.value:
            at = values == highest
            # Stretches of three and more samples that begin or end with a jump of several counts: the crest of a slow
            # and quiet signal stays on one count too, but comes there count by count.
            begin, end = _stretches(at).T
            before, after = values[np.maximum(begin - 1, 0)], values[np.minimum(end, values.size - 1)]
            jump = highest - np.minimum(before, after)
            self.stretches += int(np.sum((end - begin >= 3) & (jump > _JUMP_COUNTS * step)))
            self.samples += int(at.sum())
