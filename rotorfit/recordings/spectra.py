"""Full spectra of a recording: one of a stretch, and cascades of them over time or speed; and the twist of the shaft.

The twist is read from a torsion channel in volts, or from tooth wheels at two planes. A tooth wheel gives an angle at
every tooth. The wheel at the evenly turning end is smoothed as any mark is; the other wheel's teeth, against that
angle, are samples of the twist. Errors of the spacing of teeth repeat every turn and are taken out as a pattern, and
with them what of the twist is locked to the shaft.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from rotorfit.estimators.signals.pulse_numbers import number_pulses
from rotorfit.estimators.signals.pulses import find_edges, find_levels
from rotorfit.estimators.signals.spectral_lines import full_spectrum
from rotorfit.models.array_types import Float
from rotorfit.models.parameters import unknown_name
from rotorfit.recordings.angle_track import Marks, track
from rotorfit.recordings.rig.setup import Reference
from rotorfit.recordings.signals import Signals, said_of


@dataclass(frozen=True, kw_only=True, eq=False)
class Cascade:
    """Spectra of one plane, or of the twist, one after the other."""

    over: str  # what tells them apart: ``time``, ``speed`` or ``perturbation``
    position: Float  # s or rad/s, shape ``(W,)``
    shaft: Float  # shaft speed at each spectrum, rad/s; NaN without a mark
    perturbation: Float  # speed of the perturbation at each spectrum, rad/s, signed by its whirl; NaN without a mark
    frequency: Float  # Hz, negative is backward, shape ``(F,)``; of one direction and of the twist not negative
    amplitude: Float  # m or rad, shape ``(W, F)``; a circle of radius A has A
    plane: str = ""  # its name; none of the twist
    direction: str | None = None  # x or y where the spectra are of the motion along it alone
    overall: Float | None = None  # of the twist: amplitude that a sine of the same mean square has, rad, shape ``(W,)``


def spectrum(record: Signals, plane: str, start: float, stop: float | None) -> tuple[Float, Float]:
    """Full spectrum of a plane over a stretch of time: frequencies (Hz) and amplitudes (m)."""
    first = round(max(start, 0.0) * record.sample_rate)
    last = record.size if stop is None else min(round(stop * record.sample_rate), record.size)
    last = min(last, first + (1 << 20))
    if last - first < 16:
        end = "the end" if stop is None else f"{stop:g} s"
        raise ValueError(f"{record.name}: no samples from {start:g} s to {end}")
    z = record.motion(plane, first, last)
    frequency, amplitude = full_spectrum(z.astype(complex), record.sample_rate)
    return frequency, amplitude if np.iscomplexobj(z) else 2 * amplitude


def cascade(
    record: Signals,
    marks: Marks,
    plane: str,
    *,
    over: str | None = None,
    spectra: int = 60,
    direction: str | None = None,
) -> Cascade:
    """Full spectra at even steps of time, speed or perturbation frequency, or those along x or y."""
    if direction not in (None, "x", "y"):
        raise ValueError(unknown_name("direction", str(direction), ("x", "y")))
    size, starts, places = _even_steps(record, marks, over, spectra)
    rows = []
    for start in starts:
        z = record.motion(plane, start, start + size)
        if direction is not None and not np.iscomplexobj(z):
            raise ValueError(f"{record.name}, {plane}: one probe reads this plane; leave direction out for its spectra")
        z = {"x": z.real, "y": z.imag}.get(direction or "", z)
        frequency, amplitude = full_spectrum(z.astype(complex), record.sample_rate, points=4)  # round lines
        rows.append(amplitude if np.iscomplexobj(z) else 2 * amplitude)
    shown = frequency >= (-np.inf if direction is None else 0)
    amplitude = np.array(rows)[:, shown]
    return Cascade(**places, plane=plane, direction=direction, frequency=frequency[shown], amplitude=amplitude)


def _even_steps(record: Signals, marks: Marks, over: str | None, spectra: int) -> tuple[int, list[int], dict[str, Any]]:
    """Even steps of time, speed or perturbation: samples of a spectrum, the first of each, and where these are."""
    if over is None:  # what changes
        over = "time"
        for name, angle in (("speed", marks.shaft), ("perturbation", marks.perturbator)):
            if angle is not None:
                speed = angle.speeds(50)
                over = name if np.ptp(speed) > 0.1 * np.abs(speed).max() else over
    if over not in ("time", "speed", "perturbation"):
        raise ValueError(unknown_name("axis of a cascade", over, ("time", "speed", "perturbation")))
    most_samples = 1 << 15  # most samples of a spectrum of a cascade
    size = min(int(np.clip(record.size // spectra * 2, 256, most_samples)), record.size)
    t = np.linspace(size / 2, record.size - size / 2, spectra) / record.sample_rate
    if over != "time":
        mark = marks.named("shaft" if over == "speed" else "perturbator", record)
        fine = np.linspace(t[0], t[-1], 20 * spectra)
        speed = mark.speed(fine)
        if not np.any(np.diff(speed) * (speed[-1] - speed[0]) <= 0):  # one way up or down; else in the order of time
            order = np.argsort(speed)
            t = np.interp(np.linspace(speed.min(), speed.max(), spectra), speed[order], fine[order])
    starts = np.clip(np.round(t * record.sample_rate) - size // 2, 0, record.size - size).astype(np.intp)
    nan = np.full(t.size, np.nan)
    shaft = nan if marks.shaft is None else marks.shaft.speed(t)
    perturbation = nan if marks.perturbator is None else marks.whirl * marks.perturbator.speed(t)
    position = {"time": t, "speed": shaft, "perturbation": np.abs(perturbation)}[over]
    return size, starts.tolist(), {"over": over, "position": position, "shaft": shaft, "perturbation": perturbation}


def steady_lines(marks: Marks, start: float, stop: float) -> dict[str, float]:
    """Frequencies of orders, Hz, by label, of the marks whose speed hardly changes meanwhile."""
    lines: dict[str, float] = {}
    t = np.linspace(start, stop, 50)
    for name, angle in marks.present.items():
        speed = angle.speed(t) / (2 * np.pi)
        if np.ptp(speed) < 0.02 * np.abs(speed).max():
            mean = float(speed.mean())
            lines |= {f"{k}x": k * mean for k in (-2, -1, 1, 2)} if name == "shaft" else {"w": marks.whirl * mean}
    return lines


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
    with said_of(f"{record.name}, channel {name}"):
        levels = find_levels(record.channel(name))
        pulses = number_pulses(find_edges(record.pieces(name), levels) / record.sample_rate)
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


def twist_cascade(record: Signals, marks: Marks, *, over: str | None, spectra: int) -> Cascade:
    """Overall amplitude and spectra of the twist at even steps of time, speed or perturbation frequency."""
    twist = twist_of(record)
    size, starts, places = _even_steps(record, marks, over, spectra)
    parts = [twist[start : start + size] for start in starts]
    rows = [full_spectrum(part.astype(complex), record.sample_rate) for part in parts]
    shown = rows[0][0] >= 0
    return Cascade(
        **places,
        frequency=rows[0][0][shown],
        amplitude=2 * np.array([amplitude[shown] for _, amplitude in rows]),
        overall=np.array([float(np.sqrt(2) * part.std()) for part in parts]),
    )
