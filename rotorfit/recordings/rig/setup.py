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
    """A displacement probe."""

    plane: str  # where it looks at the shaft
    channel: str  # of the recording
    angle: float | None = None  # where it sits, rad, counter-clockwise from x
    sensitivity: float | None = None  # V/m; positive: the signal rises as the target approaches
    linear_range: tuple[float, float] | None = None  # voltages between which it is linear, V, the lower first
    centre: float | None = None  # voltage while the shaft is in the centre of its bearing, V; None: not known
    unit: str | None = None  # in which its channel is scaled already; None: volts, or as the file says
    delay: float | None = None  # time by which its channel is late against the marks, s; None: on time


@dataclass(frozen=True, kw_only=True)
class Reference:
    """A phase reference: Keyphasor or tooth wheel."""

    channel: str | None = None  # of the recording
    edge: str | None = None  # ``"falling"`` or ``"rising"``, the edge that is angle zero; None: found from the signal
    level: float | None = None  # voltage at which the edge is timed; None: half way
    pulses_per_turn: int | None = None  # 1 unless given
    clock: float | None = None  # share by which its channel's clock is fast against that of the probes; None: the same
    steady: bool | None = None


@dataclass(frozen=True, kw_only=True)
class ForceSetup:
    """Force that drives the rotor: a rotating mass at a known angle, or a force that was measured."""

    plane: str | None = None  # where the force acts
    mr: float | None = None  # unbalance, kg m
    angle: float | None = None  # heavy spot ahead of the mark in the direction it turns, rad; None: not known
    hole_angle: float | None = None
    whirl: int | None = None  # +1 turns with the shaft, -1 against it
    channel_x: str | None = None  # channel of a measured force along x
    channel_y: str | None = None  # channel of a measured force along y
    sensitivity: float | None = None  # of these channels, V/N
    unit: str | None = None  # in which these channels are scaled already; None: volts, or as the file says


@dataclass(frozen=True, kw_only=True)
class LoadSetup:
    """A constant load on the turning shaft."""

    plane: str | None = None  # where it acts
    size: float | None = None  # N; zero: a recording without load, that positions may count from
    angle: float | None = None  # its direction, rad, from x counter-clockwise


@dataclass(frozen=True, kw_only=True)
class ImpulseSetup:
    """Blows or releases, after which the shaft vibrates freely."""

    plane: str | None = None  # of the probes to look at
    highest: float | None = None  # frequency above which nothing is of interest, rad/s


@dataclass(frozen=True, kw_only=True)
class Twist:
    """The disk's twist against the evenly turning end: a channel of torsion, or tooth wheels at two planes."""

    channel: str | None = None  # of the recording
    sensitivity: float | None = None  # V/rad
    # even_wheel, wheel: channels of the tooth wheels at the evenly turning end and at the disk
    even_wheel: str | None = None
    wheel: str | None = None
    teeth: int | None = None  # of each wheel


VECTOR_ORDERS, WAVEFORM_ORDERS = 2, 24
"""Orders of the shaft that run-out is made of: as vectors, and as a waveform over the angle."""


@dataclass(frozen=True, kw_only=True)
class SlowRollSetup:
    """Run-out to be taken out of the signals, as slow turning shows it."""

    below: float | None = None  # speed below which motion that turns with the shaft is run-out, rad/s
    file: str | None = None  # recording of slow turning in the folder of the recording; None: the recording itself
    orders: int | None = None  # of the shaft; None: vectors


@dataclass(frozen=True, kw_only=True)
class Scale:
    """Quantity and unit of a channel's numbers."""

    volts_per_count: float | None = None  # factor; None where the full scale is given
    full_scale: float | None = None  # volts at the largest count that the file can hold
    offset: float = 0.0  # volts at count zero
    unit: str | None = None  # in which the channel is scaled already; None: volts, or as the file says


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
        clearance: radial, m, by plane.
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
    clearance: Mapping[str, float] = field(default_factory=dict)
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
    """The values of ``first``, and where it has none, those of ``second``; records within records likewise."""
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
    """Force that drives the rotor in one recording, complete."""

    plane: str  # where the force acts
    mr: float  # unbalance, kg m; NaN for a measured force
    angle: float  # heavy spot ahead of the mark in the direction it turns, rad
    datum_known: bool  # whether ``angle`` counts from the mark; otherwise the fit needs ``phase_offsets="common"``
    whirl: int  # +1 turns with the shaft, -1 against it
    reference: str  # ``"perturbator"`` or ``"shaft"``, the mark that the force is locked to
    channels: tuple[str, str] = ("", "")  # channels of the force along x and y where it was measured
    sensitivity: float = float("nan")  # of these channels, V/N; NaN without

    @property
    def measured(self) -> bool:
        """True if the force was measured rather than computed from a turning mass."""
        return any(self.channels)


@dataclass(frozen=True, kw_only=True)
class Load:
    """Constant load of one recording."""

    plane: str  # where it acts
    newton: complex  # ``Px + j Py``, y 90 degrees ahead of x as the shaft turns; zero: none
