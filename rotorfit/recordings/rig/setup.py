"""Setup of a rig: which channel is which probe and reference, what turns volts into motion, and what drives the rotor.

Every field may be left unsaid (None): what a setup does not say is taken from the attributes of the recording, and what
a ``[[run]]`` says of one file goes before both. :func:`prefer` is that rule.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, is_dataclass, replace
from typing import Any, TypeVar

T = TypeVar("T")


@dataclass(frozen=True, kw_only=True)
class Probe:
    """A displacement probe.

    Attributes:
        plane: where it looks at the shaft.
        channel: of the recording.
        angle: where it sits, rad, counter-clockwise from x.
        sensitivity: V/m; positive: the signal rises as the target approaches.
        linear_range: voltages between which it is linear, V, the lower first; None: not known.
        centre: voltage while the shaft is in the centre of its bearing, V; None: not known.
        delay: time by which its channel is late against the marks, s; None: on time.
    """

    plane: str
    channel: str
    angle: float | None = None
    sensitivity: float | None = None
    linear_range: tuple[float, float] | None = None
    centre: float | None = None
    delay: float | None = None


@dataclass(frozen=True, kw_only=True)
class Reference:
    """A phase reference: Keyphasor or tooth wheel.

    Attributes:
        channel: of the recording.
        edge: ``"falling"`` or ``"rising"``, the edge that is angle zero; None: found from the signal.
        level: voltage at which the edge is timed; None: half way.
        pulses_per_turn: 1 unless given.
        steady: whether a perturbator without a mark runs at one frequency, which is then found from the motion.
    """

    channel: str | None = None
    edge: str | None = None
    level: float | None = None
    pulses_per_turn: int | None = None
    steady: bool | None = None


@dataclass(frozen=True, kw_only=True)
class ForceSetup:
    """What drives the rotor: a rotating mass at a known angle, or a force that was measured.

    Attributes:
        plane: where the force acts.
        mr: unbalance, kg m.
        angle: heavy spot ahead of the mark in the direction it turns, rad; None: not known.
        hole_angle: place of the weight in a pattern of holes, rad, whose zero is at an unknown angle from the mark.
        whirl: +1 turns with the shaft, -1 against it.
        channel_x, channel_y: channels of a measured force along x and y.
        sensitivity: of these channels, V/N.
    """

    plane: str | None = None
    mr: float | None = None
    angle: float | None = None
    hole_angle: float | None = None
    whirl: int | None = None
    channel_x: str | None = None
    channel_y: str | None = None
    sensitivity: float | None = None


@dataclass(frozen=True, kw_only=True)
class LoadSetup:
    """A constant load on the turning shaft.

    Attributes:
        plane: where it acts.
        size: N; zero: a recording without load, that positions may count from.
        angle: its direction, rad, from x counter-clockwise.
    """

    plane: str | None = None
    size: float | None = None
    angle: float | None = None


@dataclass(frozen=True, kw_only=True)
class ImpulseSetup:
    """Blows or releases, after which the shaft vibrates freely.

    Attributes:
        plane: of the probes to look at.
        highest: frequency above which nothing is of interest, rad/s.
    """

    plane: str | None = None
    highest: float | None = None


@dataclass(frozen=True, kw_only=True)
class Twist:
    """The disk's twist against the evenly turning end: a channel of torsion, or tooth wheels at two planes.

    Attributes:
        channel: of the recording.
        sensitivity: V/rad.
        even_wheel, wheel: channels of the tooth wheels at the evenly turning end and at the disk.
        teeth: of each wheel.
    """

    channel: str | None = None
    sensitivity: float | None = None
    even_wheel: str | None = None
    wheel: str | None = None
    teeth: int | None = None


VECTOR_ORDERS, WAVEFORM_ORDERS = 2, 24
"""Orders of the shaft that run-out is made of: as vectors, and as a waveform over the angle."""


@dataclass(frozen=True, kw_only=True)
class SlowRollSetup:
    """Run-out to be taken out of the signals, as slow turning shows it.

    Attributes:
        below: speed below which motion that turns with the shaft is run-out, rad/s; None: at every speed of ``file``.
        file: recording of slow turning in the folder of the recording; None: the recording itself.
        orders: of the shaft; None: vectors.
    """

    below: float | None = None
    file: str | None = None
    orders: int | None = None


@dataclass(frozen=True, kw_only=True)
class Scale:
    """What a channel of counts means in volts.

    Attributes:
        volts_per_count: factor; None where the full scale is given.
        full_scale: volts at the largest count that the file can hold.
        offset: volts at count zero.
    """

    volts_per_count: float | None = None
    full_scale: float | None = None
    offset: float = 0.0


@dataclass(frozen=True, kw_only=True)
class RigSetup:
    """Setup of a rig; see the module.

    Attributes:
        rotation: +1 counter-clockwise (x towards y) as the shaft turns, -1 clockwise.
        sample_rate: Hz, where the file does not hold it.
        speed: nominal rotative speed, rad/s.
        shaft: the shaft's phase reference.
        perturbator: that of the perturbator; not there in a start-up, where the shaft's own mark is the reference.
        probes: all displacement probes.
        force: what drives the rotor.
        load: constant load on it.
        impulse: that it is struck or released.
        twist: channel of torsion.
        slow_roll: run-out to be taken out.
        sensitivity: of probes that have none of their own, V/m.
        scales: of channels that hold counts, by channel.
        attributes: test attributes of the recording, such as the oil temperature.
        runs: what holds for one file, by the name of the file.
        source: the file this was read from, for messages.
    """

    rotation: int | None = None
    sample_rate: float | None = None
    speed: float | None = None
    shaft: Reference | None = None
    perturbator: Reference | None = None
    probes: tuple[Probe, ...] | None = None
    force: ForceSetup | None = None
    load: LoadSetup | None = None
    impulse: ImpulseSetup | None = None
    twist: Twist | None = None
    slow_roll: SlowRollSetup | None = None
    sensitivity: float | None = None
    scales: Mapping[str, Scale] = field(default_factory=dict)
    attributes: Mapping[str, float | str] = field(default_factory=dict)
    runs: Mapping[str, RigSetup] = field(default_factory=dict)
    source: str = ""

    def of_file(self, name: str) -> RigSetup:
        """The setup for one file: what its ``[[run]]`` says goes before what is said for all.

        Args:
            name: of the file, without its folder.
        """
        stem = name.rpartition(".")[0] or name
        run = next((r for key, r in self.runs.items() if key in (name, stem)), None)
        return self if run is None else prefer(run, replace(self, runs={}))


def prefer(first: T, second: T) -> T:
    """What ``first`` says, and where it says nothing, what ``second`` says; records within records likewise.

    Args:
        first: a record.
        second: one of the same class.
    """
    merged: dict[str, Any] = {}
    for each in fields(first):  # type: ignore[arg-type]
        mine, other = getattr(first, each.name), getattr(second, each.name)
        if mine is None or other is None:
            merged[each.name] = other if mine is None else mine
        elif is_dataclass(mine):
            merged[each.name] = prefer(mine, other)
        elif isinstance(mine, Mapping):
            merged[each.name] = {**other, **mine}
        elif isinstance(mine, tuple | str):
            merged[each.name] = mine or other
        else:
            merged[each.name] = mine  # zero is a word too
    return replace(first, **merged)  # type: ignore[type-var]


@dataclass(frozen=True, kw_only=True)
class Force:
    """What drives the rotor in one recording, complete.

    Attributes:
        plane: where the force acts.
        mr: unbalance, kg m; NaN for a measured force.
        angle: heavy spot ahead of the mark in the direction it turns, rad; zero where not known. For a weight in a
            pattern of holes the angle in the pattern.
        datum_known: whether ``angle`` counts from the mark; otherwise the fit needs ``phase_offsets="common"``.
        whirl: +1 turns with the shaft, -1 against it.
        reference: ``"perturbator"`` or ``"shaft"``, the mark that the force is locked to.
        channels: channels of the force along x and y where it was measured; a missing one is an empty name.
        sensitivity: of these channels, V/N; NaN without.
    """

    plane: str
    mr: float
    angle: float
    datum_known: bool
    whirl: int
    reference: str
    channels: tuple[str, str] = ("", "")
    sensitivity: float = float("nan")

    @property
    def measured(self) -> bool:
        """Whether the force was measured rather than computed from a turning mass."""
        return any(self.channels)


@dataclass(frozen=True, kw_only=True)
class Load:
    """Constant load of one recording.

    Attributes:
        plane: where it acts.
        newton: ``Px + j Py``, y 90 degrees ahead of x as the shaft turns; zero: none.
    """

    plane: str
    newton: complex
