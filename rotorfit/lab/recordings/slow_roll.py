"""Run-out of the surfaces that probes look at: what turns with a slow shaft, taken out of the signals at every speed.

Bow, scratches and magnetism turn with the shaft as vibration does, and a probe cannot tell them apart; but they do not
change with speed, and a shaft that turns slowly does not vibrate. Of vectors (orders 1 and 2) or as a waveform over the
angle (many orders), they are amplitudes of harmonics of the shaft's angle, found by least squares.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from rotorfit.base.array_types import ComplexArray, Float
from rotorfit.base.digits import significant
from rotorfit.base.units import RPM_PER_RAD_S
from rotorfit.lab.recordings.angle_track import AngleTrack
from rotorfit.lab.recordings.rig.setup import VECTOR_ORDERS, SlowRollSetup
from rotorfit.lab.recordings.signals import SAMPLES_OF_A_PIECE, Signals


@dataclass(frozen=True, kw_only=True, eq=False)
class RunOut:
    """Run-out as each probe sees it."""

    # by channel, V, of the harmonics ``exp(j n theta)``, n = 1, 2, ..., of the shaft's angle theta, shape ``(N,)``
    amplitudes: Mapping[str, ComplexArray]
    turns: float  # how many turns tell it
    highest: float  # speed of the fastest of these, rad/s

    def volts(self, channel: str, angle: Float) -> Float:
        """Run-out in the signal of a channel."""
        turn = np.exp(1j * angle)
        found = np.zeros(turn.shape, dtype=complex)
        for amplitude in self.amplitudes[channel][::-1]:
            found = (found + amplitude) * turn
        return np.asarray(found.real)


def find_run_out(record: Signals, shaft: AngleTrack, how: SlowRollSetup) -> RunOut:
    """Run-out of a recording's probes where its shaft turns slowly."""
    orders = np.arange(1, (how.orders or VECTOR_ORDERS) + 1)
    limit = np.inf if how.below is None else how.below
    columns = 2 * orders.size + 2
    normal, moment = np.zeros((columns, columns)), np.zeros((len(record.probes), columns))
    turns, highest = 0.0, 0.0
    for start in range(0, record.size, SAMPLES_OF_A_PIECE):
        stop = min(start + SAMPLES_OF_A_PIECE, record.size)
        t = np.arange(start, stop) / record.sample_rate
        speed = np.abs(shaft.speed(t))
        slow = (t >= shaft.begin) & (t <= shaft.end) & (speed < limit)
        if not slow.any():
            continue
        t, speed = t[slow], speed[slow]
        turns += float(speed.sum()) / record.sample_rate / (2 * np.pi)
        highest = max(highest, float(speed.max()))
        phase = orders[:, None] * shaft.angle(t)
        basis = np.vstack([np.ones_like(t), t / record.duration, np.cos(phase), np.sin(phase)])
        normal += basis @ basis.T
        for i, probe in enumerate(record.probes):
            moment[i] += basis @ record.channel(probe.channel, start, stop)[slow]
    fewest_turns = 4  # turns from which run-out is distinguished from noise and from a drift
    if turns < fewest_turns:
        below = "" if how.below is None else f" below {how.below * RPM_PER_RAD_S:.0f} rpm"
        raise ValueError(
            f"{record.name}: the shaft turns {turns:.1f} times{below}, slow roll takes at least {fewest_turns} turns: "
            "give a higher below_rpm in [slow_roll], or file, a recording of slow turning"
        )
    if orders[-1] * highest > np.pi * record.sample_rate / 2:
        raise ValueError(
            f"{record.name}: order {orders[-1]} of {highest * RPM_PER_RAD_S:.0f} rpm is beyond a quarter of the "
            'sampling rate: give a lower below_rpm in [slow_roll], or as = "vector"'
        )
    parts = np.linalg.solve(normal, moment.T)[2:].reshape(2, orders.size, -1)
    amplitudes = {probe.channel: parts[0, :, i] - 1j * parts[1, :, i] for i, probe in enumerate(record.probes)}
    return RunOut(amplitudes=amplitudes, turns=turns, highest=highest)


def in_words(record: Signals, found: RunOut) -> str:
    """Run-out that was subtracted from the signals of a recording."""
    sizes = ", ".join(
        f"{probe.channel} "
        f"{significant(abs(found.amplitudes[probe.channel][0] / float(probe.sensitivity or 1.0)) * 1e6, 3)} µm"
        for probe in record.probes
    )
    orders = len(next(iter(found.amplitudes.values())))
    return (
        f"{record.name}: run-out of orders 1 to {orders} of the shaft is taken out of the signals, read from "
        f"{found.turns:.0f} turns up to {found.highest * RPM_PER_RAD_S:.0f} rpm; at 1x: {sizes}"
    )
