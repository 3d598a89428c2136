"""The two angles of a recording, shaft and perturbator, and their speeds over time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rotorfit.models.array_types import Float
from rotorfit.models.parameters import unknown_name
from rotorfit.recordings.angle_track import AngleTrack
from rotorfit.recordings.signals import Signals

_MARKS = ("shaft", "perturbator")


@dataclass(frozen=True, kw_only=True, eq=False)
class Marks:
    """The two angles of a recording, either may be missing."""

    shaft: AngleTrack | None  # angle of the shaft, ``None`` without its mark
    perturbator: AngleTrack | None  # angle of the perturbator, growing whichever way it turns, likewise
    whirl: int = 1  # +1 where the perturbator turns with the shaft, -1 against it

    def named(self, name: str, record: Signals) -> AngleTrack:
        """The angle of a mark."""
        if name not in _MARKS:
            raise ValueError(unknown_name("reference", name, _MARKS))
        found = self.shaft if name == "shaft" else self.perturbator
        if found is None:
            raise ValueError(f"{record.name} has no phase reference of the {name}")
        return found

    @property
    def main(self) -> str:
        """The mark that the force is locked to: the perturbator's where there is one."""
        return "shaft" if self.perturbator is None else "perturbator"

    @property
    def present(self) -> dict[str, AngleTrack]:
        """Those that there are, by name."""
        both = zip(_MARKS, (self.shaft, self.perturbator), strict=True)
        return {name: angle for name, angle in both if angle is not None}


@dataclass(frozen=True, kw_only=True, eq=False)
class SpeedTrack:
    """Speed of one mark over a recording."""

    mark: str  # ``shaft`` or ``perturbator``
    t: Float  # s, shape ``(N,)``
    speed: Float  # rad/s, smoothed
    acceleration: Float  # rad/s^2
    raw_t: Float  # middle between one pulse and the next, s
    raw_speed: Float  # speed from one pulse to the next, rad/s


def speeds(marks: Marks, points: int = 2000) -> list[SpeedTrack]:
    """Speed of each mark between its first and its last pulse, with the speed that single intervals would give."""
    found = []
    for name, angle in marks.present.items():
        t = np.linspace(angle.begin, angle.end, points)
        pulses = angle.pulses[:: max(angle.pulses.size // (5 * points), 1)]
        nominal = np.round(np.diff(angle.angle(pulses)) / (2 * np.pi) * angle.pulses_per_turn) / angle.pulses_per_turn
        found.append(
            SpeedTrack(
                mark=name,
                t=t,
                speed=angle.speed(t),
                acceleration=angle.acceleration(t),
                raw_t=(pulses[1:] + pulses[:-1]) / 2,
                raw_speed=2 * np.pi * nominal / np.diff(pulses),
            )
        )
    return found
