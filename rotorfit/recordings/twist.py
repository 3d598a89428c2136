"""Twist of the shaft from a recording: a torsion channel in volts, or tooth wheels at two planes.

A tooth wheel gives an angle at every tooth. The wheel at the evenly turning end is smoothed as any mark is; the other
wheel's teeth, against that angle, are samples of the twist. Errors of the spacing of teeth repeat every turn and are
taken out as a pattern, and with them what of the twist is locked to the shaft.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rotorfit.estimators.signals.pulses import find_edges, find_levels, number_pulses
from rotorfit.estimators.signals.spectral_lines import full_spectrum
from rotorfit.models.array_types import Float
from rotorfit.recordings.angle_track import track
from rotorfit.recordings.marks import Marks
from rotorfit.recordings.rig.setup import Reference
from rotorfit.recordings.signals import Signals
from rotorfit.recordings.spectra import CascadeTimes, cascade_times


def twist_of(record: Signals) -> Float:
    """Twist at every sample of a recording, its mean taken out, rad."""
    how = record.rig.twist
    if how is None:
        raise ValueError(f"{record.name} has no twist: name its channel, or two tooth wheels, in [twist]")
    if how.channel:
        volts = record.channel(how.channel)
        return np.asarray((volts - volts.mean()) / float(how.sensitivity or 1.0))
    from scipy.interpolate import CubicSpline

    teeth = int(how.teeth or 1)
    motor = track(record, Reference(channel=how.even_wheel, pulses_per_turn=teeth))
    name = str(how.wheel)
    try:
        levels = find_levels(record.channel(name))
        pulses = number_pulses(find_edges(record.pieces(name), levels) / record.sample_rate)
    except ValueError as problem:
        raise ValueError(f"{record.name}, channel {name}: {problem}") from problem
    step = 2 * np.pi / teeth
    twist = step * pulses.numbers - motor.angle(pulses.times)
    place = pulses.numbers % teeth
    count = np.maximum(np.bincount(place, minlength=teeth), 1)
    slope = np.polynomial.Polynomial.fit(pulses.times, twist, 1)  # an offset, and a drift that the pattern must not see
    twist = twist - slope(pulses.times)
    twist = twist - (np.bincount(place, twist, minlength=teeth) / count)[place]
    time = np.arange(record.size) / record.sample_rate
    inside = (time >= pulses.times[0]) & (time <= pulses.times[-1])
    return np.where(inside, CubicSpline(pulses.times, twist)(np.clip(time, *pulses.times[[0, -1]])), 0.0)


@dataclass(frozen=True, kw_only=True, eq=False)
class TwistView(CascadeTimes):
    """Data of the figure of the twist."""

    overall: Float  # amplitude that a sine of the same mean square has, rad 0-pk, shape ``(W,)``
    frequency: Float  # Hz, from zero, shape ``(F,)``
    amplitude: Float  # of the lines, rad 0-pk, shape ``(W, F)``


def twist_view(record: Signals, marks: Marks, *, over: str | None, spectra: int) -> TwistView:
    """Overall amplitude and spectra of the twist at even steps of time, speed or perturbation frequency."""
    twist = twist_of(record)
    places = cascade_times(record, marks, over, spectra)
    rows, overall = [], []
    for start in places.starts.tolist():
        part = twist[start : start + places.size]
        frequency, amplitude = full_spectrum(part.astype(complex), record.sample_rate)
        rows.append(2 * amplitude[frequency >= 0])
        overall.append(float(np.sqrt(2) * part.std()))
    positive = frequency[frequency >= 0]
    return TwistView(**vars(places), frequency=positive, amplitude=np.array(rows), overall=np.array(overall))
