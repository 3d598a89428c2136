"""Blows: where a motion is quiet between them, and what the measured force of a hammer shows of each."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from rotorfit.data.findings import Finding, listed
from rotorfit.models.array_types import Bool, ComplexArray, Float
from rotorfit.models.digits import significant
from rotorfit.recordings.reduction.reduced_record import HIGHEST_ORDER, ReducedRecord
from rotorfit.recordings.signals import SAMPLES_OF_A_PIECE

if TYPE_CHECKING:
    from rotorfit.recordings.recording import Recording

AVERAGING_TIME = 0.02
"""Time over which the motion is averaged to see a blow, s."""
QUIET_TURNS = 2.0
"""Turns of quiet motion before the first blow that tell the shaft's orders."""
QUIET_SHARE = 0.1
"""Share of a recording of blows that tells them: their error two lines beside then is as large as the noise."""

_TOP_SHARE, _LARGEST_TOP_SHARE = 5e-3, 0.2
"""Share of its peak within which a blow is at its top, and the share of its length at half the peak that the top of no
blow lasts: half sines and their squares have 0.1."""


def quiet_part(
    z: ComplexArray, angle: Float | None, rate: float, before: Bool | None = None
) -> tuple[ComplexArray, ComplexArray, Float, float, Bool]:
    """A motion between blows, arrays of shape ``(N,)``: less the orders that the shaft has where it is quiet, m; where
    it settles, m; the size of what is left, averaged over some hundredths of a second, and that where it is quiet, m;
    and when nothing is left of a blow, first guess ``before``."""
    turning = [n for n in range(-HIGHEST_ORDER, HIGHEST_ORDER + 1) if n] if angle is not None else []
    orders = np.exp(1j * np.array(turning)[:, None] * (0.0 if angle is None else angle)).T
    width = max(int(AVERAGING_TIME * rate), 1)
    quiet = np.ones(z.size, dtype=bool) if before is None else before
    level = np.zeros(z.size, dtype=complex)
    median_time = 0.5  # time about each instant whose median position is where the shaft rests, s
    for _ in range(3):  # blows disturb the orders, and orders hide blows
        left = z - orders @ np.linalg.lstsq(orders[quiet], (z - level)[quiet], rcond=None)[0] if turning else z
        level = _level(left, int(median_time * rate))
        size = np.sqrt(np.convolve(np.abs(left - level) ** 2, np.ones(width) / width, mode="same"))
        noise = float(np.median(size[quiet]))
        quiet = size < 3 * noise
    return left, level, size, noise, quiet


def _level(values: ComplexArray, width: int) -> ComplexArray:
    """Running median: it follows where the shaft rests, jumps with a release and does not see vibration."""
    from scipy.ndimage import median_filter

    parts = (median_filter(part, max(width, 1), mode="nearest") for part in (values.real, values.imag))
    return np.asarray(sum(factor * part for factor, part in zip((1, 1j), parts, strict=True)))


def rest_of(reduced: ReducedRecord, struck: Sequence[Blow]) -> tuple[Bool, float]:
    """When all planes of a rotor under blows are quiet, and the share of a blow's motion that the recording cuts off.

    Of a mode that decays, what is cut off of its spectrum has the size over the whole that the motion at the end has
    over that at the beginning.
    """
    angle, time = reduced.shaft_angle, reduced.time
    if struck[-1].end < time[0] or struck[0].begin > time[-1] or (len(struck) == 1 and struck[0].begin < time[0]):
        raise ValueError(
            f"{reduced.record.name}: the blow at {struck[0].begin:.3f} s is not between the first mark of the shaft "
            f"and the last, {time[0]:.3f} to {time[-1]:.3f} s, where its angle is known: record some turns before it"
        )
    before = time < struck[0].begin - AVERAGING_TIME
    turns = float(np.sum(before)) / reduced.rate * reduced.shaft_speed / (2 * np.pi)
    begins_quiet = bool(np.sum(before) > 2 * AVERAGING_TIME * reduced.rate) and (angle is None or turns >= QUIET_TURNS)
    parts = [quiet_part(z, angle, reduced.rate, before if begins_quiet else None) for z in reduced.motion.values()]
    quiet = np.asarray(np.all([calm for *_, calm in parts], axis=0))
    at_ends = [max(size[0], size[-1]) * np.sqrt(2) / size.max() for _, _, size, _, _ in parts]  # half a window
    rests = begins_quiet and bool(quiet[0] and quiet[-1])
    return quiet, 0.0 if rests else float(max(at_ends)) / len(struck)


@dataclass(frozen=True, kw_only=True)
class Blow:
    """One blow of a hammer whose force was measured."""

    begin: float  # when the force rises, s
    end: float  # when the force is gone, s
    peak: float  # N
    cut: bool  # whether its top is flat


def blows(record: Recording) -> list[Blow]:
    """The blows that a measured force consists of; none where it is no force of blows."""
    first = record.force_signal(0, SAMPLES_OF_A_PIECE)
    level = complex(np.median(first.real), np.median(first.imag))
    pieces = [(start, start + SAMPLES_OF_A_PIECE) for start in range(0, record.size, SAMPLES_OF_A_PIECE)]
    greatest = max(float(np.abs(record.force_signal(*piece) - level).max()) for piece in pieces)
    acting_force_share = 0.1  # share of the greatest force of a recording from which it acts
    acts = np.concatenate(
        [np.abs(record.force_signal(*piece) - level) > acting_force_share * greatest for piece in pieces]
    )
    largest_struck_share = 0.1  # share of a recording in which the force acts, below which it is one of blows
    if not acts.any() or acts.mean() > largest_struck_share:
        return []
    at = np.flatnonzero(acts)
    longest_break = 1e-3  # time for which noise may interrupt a blow, s: none bounces so soon
    apart = np.flatnonzero(np.diff(at) > max(longest_break * record.sample_rate, 1.0))
    found = []
    for low, high in zip(at[np.append(0, apart + 1)].tolist(), (at[np.append(apart, -1)] + 1).tolist(), strict=True):
        size = np.abs(record.force_signal(low, high) - level)
        top, half = int(np.sum(size > (1 - _TOP_SHARE) * size.max())), int(np.sum(size > size.max() / 2))
        found.append(
            Blow(
                begin=low / record.sample_rate,
                end=high / record.sample_rate,
                peak=float(size.max()),
                cut=top >= 3 and top > _LARGEST_TOP_SHARE * half,
            )
        )
    return found


def blow_findings(record: Recording, found: list[Blow]) -> Iterator[Finding]:
    """Blows that bounced, and those that went beyond the range of the force's channel or of a probe's."""
    cut = [blow for blow in found if blow.cut]
    if cut:
        yield Finding(
            "error",
            "force-clipped",
            f"{record.name}: the force of the blow at {listed([f'{b.begin:.3f} s' for b in cut])} is cut off at "
            f"{listed([f'{significant(b.peak, 4)} N' for b in cut])}: its channel was overloaded, and responses come "
            "out too large. Leave the blow out, or strike again with a wider input range.",
        )
    bounce_time = 0.1  # time after a blow within which no one strikes on purpose, s: the hammer bounced
    again = [(first, second) for first, second in pairwise(found) if second.begin - first.end < bounce_time]
    if again:
        when = listed(
            [f"{a.begin:.3f} s and again {significant((b.begin - a.begin) * 1e3, 3)} ms later" for a, b in again]
        )
        yield Finding(
            "warning",
            "double-hit",
            f"{record.name}: the hammer struck at {when}. The responses hold, for all of the force was measured, but "
            "where both blows cancel they are worse by what the errors say. Strike again if these lines matter.",
        )
    for channel, each in record.statistics.items():
        if not each.clipped and each.flat_low + each.flat_high > 0:  # it stays at an extreme even once
            yield Finding(
                "error",
                "channel-clipped",
                f"{record.name}, channel {channel} is clipped after a blow, at {significant(each.low, 4)} or "
                f"{significant(each.high, 4)} "
                f"{each.unit}: amplitudes there are too small. Set the input range wider, or leave the probe out.",
            )
