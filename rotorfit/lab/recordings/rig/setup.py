"""Setup of a rig: which channel is which probe and reference, what turns volts into motion, and what drives the rotor.

Every field may be left unsaid (None): what a setup does not say is taken from the attributes of the recording, and what
a ``[[run]]`` says of one file goes before both. :func:`prefer` is that rule. A field names the keys of ``rig.toml``
that say it, with their readers, and those by which the top level of the file, or an attribute of a recording, says it.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import MISSING, dataclass, field, fields, is_dataclass, replace
from typing import Any, TypeVar

from rotorfit.base.units import RAD_S_PER_RPM, STANDARD_GRAVITY, UNITS, find_unit

UNITS_OF_CHANNELS = {
    "voltage": {"V": 1.0, "mV": 1e-3, "uV": 1e-6},
    "length": UNITS["length"],
    "force": UNITS["force"],
    "velocity": {"m/s": 1.0, "mm/s": 1e-3, "in/s": 0.0254, "ips": 0.0254},
    "acceleration": {"g": 9.80665, "m/s2": 1.0, "mm/s2": 1e-3},
}
"""Factor to SI by unit that a channel may have, by quantity."""
_LONG = {
    "volt": "V", "volts": "V", "micron": "um", "microns": "um", "micrometer": "um", "micrometre": "um", "mils": "mil",
    "inch": "in", "newton": "N", "newtons": "N", "lb": "lbf", "gn": "g", "g's": "g",
}  # fmt: skip
_IN_NAME = re.compile(r"^(.*?)(?:[ _]*[\[(]([^\])]+)[\])]|_(um|µm|mm|mil|mV|V|N|g))$")
ALLOWED = ", ".join(unit for units in UNITS_OF_CHANNELS.values() for unit in units)


@dataclass(frozen=True, kw_only=True)
class ChannelUnit:
    """A unit of a channel."""

    name: str  # as it was written
    quantity: str  # ``voltage``, ``length``, ``force``, ``velocity`` or ``acceleration``
    factor: float  # to SI


def channel_unit(text: str) -> ChannelUnit | None:
    """The unit that a text names, None where it names none of ours."""
    word = re.sub(r"[ ^*]", "", text.strip().replace("²", "2"))
    word = _LONG.get(word.lower(), word)
    for quantity, units in UNITS_OF_CHANNELS.items():
        with suppress(ValueError):
            if (factor := find_unit(word, units)) is not None:
                return ChannelUnit(name=text.strip(), quantity=quantity, factor=factor)
    return None


def name_and_unit(name: str) -> tuple[str, str]:
    """Name of a channel without the unit in it, ``disk_X [um]`` or ``disk_X_um``, and that unit or nothing."""
    match = _IN_NAME.match(name.strip())
    unit = (match[2] or match[3]) if match else ""
    return (match[1].strip(), unit) if match and channel_unit(unit) else (name, "")


T = TypeVar("T")
Reader = Callable[[str, Any], Any]
"""From what stands where (for messages) to the value of a field."""

SENSITIVITIES = {
    "V_per_m": 1.0,
    "V_per_mm": 1e3,
    "V_per_um": 1e6,
    "V_per_mil": 1 / 25.4e-6,
    "mV_per_um": 1e3,
    "mV_per_mm": 1.0,
    "mV_per_mil": 1e-3 / 25.4e-6,
}
"""Factor to V/m by unit of a probe's sensitivity."""
_IN_S = 0.0254
_VELOCITY_SENSITIVITIES = {
    "V_per_m_s": 1.0, "V_per_mm_s": 1e3, "mV_per_mm_s": 1.0, "V_per_in_s": 1 / _IN_S, "mV_per_in_s": 1e-3 / _IN_S,
    "V_per_ips": 1 / _IN_S, "mV_per_ips": 1e-3 / _IN_S,
}  # fmt: skip
_ACCELERATION_SENSITIVITIES = {
    "V_per_m_s2": 1.0, "mV_per_m_s2": 1e-3, "V_per_g": 1 / STANDARD_GRAVITY, "mV_per_g": 1e-3 / STANDARD_GRAVITY,
}  # fmt: skip
_LBF = UNITS["force"]["lbf"]
_FORCE_SENSITIVITIES = {
    "V_per_N": 1.0, "mV_per_N": 1e-3, "V_per_kN": 1e-3, "mV_per_kN": 1e-6, "V_per_lbf": 1 / _LBF,
    "mV_per_lbf": 1e-3 / _LBF,
}  # fmt: skip


def number(where: str, value: Any) -> float:
    """A finite number."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ValueError(f"{where} must be a finite number, got {value!r}")
    return float(value)


def _bounded(allowed: Callable[[float], bool], words: str) -> Reader:
    def read(where: str, value: Any) -> float:
        if not allowed(number(where, value)):
            raise ValueError(f"{where} must {words}, got {value!r}")
        return float(value)

    return read


positive = _bounded(lambda value: value > 0, "be above zero")
_nonzero = _bounded(lambda value: value != 0, "not be zero")
_ppm = _bounded(lambda value: abs(value) <= 1000, "be at most 1000 either way")  # quartz is right to a hundred
_size = _bounded(lambda value: value >= 0, "not be negative (a direction is another key)")


def _count(where: str, value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or value < 1:
        raise ValueError(f"{where} must be a whole number of at least 1, got {value!r}")
    return value


def _truth(where: str, value: Any) -> bool:
    if not isinstance(value, bool):
        raise ValueError(f"{where} must be true or false, got {value!r}")
    return value


def _range(where: str, value: Any) -> tuple[float, float]:
    if not isinstance(value, list) or len(value) != 2:
        raise ValueError(f"{where} needs two voltages, [-18.0, -2.0]; got {value!r}")
    low, high = sorted(number(where, each) for each in value)
    return low, high


def word(where: str, value: Any) -> str:
    """A name."""
    if not isinstance(value, str) or not value.strip():
        raise ValueError(f"{where} must be a name in quotation marks, got {value!r}")
    return value.strip()


def _unit_of(*quantities: str) -> Reader:
    """Reader of a unit; the sentence that refuses one lists those of the quantities that are meant."""

    def read(where: str, value: Any) -> str:
        if channel_unit(word(where, value)) is None:
            allowed = ", ".join(unit for quantity in quantities for unit in UNITS_OF_CHANNELS[quantity])
            raise ValueError(f"{where} must be one of {allowed}; got {value!r}")
        return str(value)

    return read


def _names(where: str, value: Any) -> tuple[str, ...]:
    if not isinstance(value, list):
        raise ValueError(f'{where} is a list of channels, ["channel_1", "channel_2"]; got {value!r}')
    return tuple(word(where, one) for one in value)


def _two_names(where: str, value: Any) -> tuple[str, ...]:
    names = _names(where, value)
    if len(set(names)) != 2:
        raise ValueError(f'{where} needs two channels, ["channel_1", "channel_2"]; got {value!r}')
    return names


def _choice(**allowed: Any) -> Reader:
    def read(where: str, value: Any) -> Any:
        if not isinstance(value, str) or value.lower() not in allowed:
            raise ValueError(f"{where} must be one of {', '.join(allowed)}; got {value!r}")
        return allowed[value.lower()]

    return read


def _in_units(stem: str, units: Mapping[str, float], reader: Reader = number) -> dict[str, Reader]:
    """Keys of a quantity, one a unit, read with the factor of each to SI."""

    def scaled(factor: float) -> Reader:
        return lambda where, value: reader(where, value) * factor

    return {f"{stem}_{unit}": scaled(factor) for unit, factor in units.items()}


def _said(keys: Mapping[str, Reader], flat: Mapping[str, Reader] | None = None, *, default: Any = None) -> Any:
    """A field with the keys that say it in its own table, and ``flat`` on the top level."""
    return field(default=default, metadata={"keys": keys, "flat": flat or {}})


_degrees: Reader = _in_units("angle", {"deg": math.pi / 180})["angle_deg"]
_whirl = _choice(forward=1, fwd=1, backward=-1, bwd=-1)
_plane, _channel = {"plane": word}, {"channel": word}
_unbalance = _in_units("mr", UNITS["unbalance"], _size)


@dataclass(frozen=True, kw_only=True)
class Probe:
    """A sensor of motion: a displacement probe, or a sensor of velocity or acceleration."""

    plane: str = _said(_plane, default=MISSING)  # where it looks at the shaft
    channel: str = _said(_channel, default=MISSING)  # of the recording
    angle: float | None = _said({"angle_deg": _degrees})  # where it sits, rad, counter-clockwise from x
    linear_range: tuple[float, float] | None = _said({"linear_range_V": _range})  # V, the lower first
    # voltage while the shaft is in the centre of its bearing, V; None: not known
    centre: float | None = _said({"centre_V": number})
    # in which its channel is scaled already; None: volts, or as the file says
    unit: str | None = _said({"unit": _unit_of("length", "velocity", "acceleration", "voltage")})
    # time by which its channel is late against the marks, s; None: on time
    delay: float | None = _said(_in_units("delay", {"s": 1.0, "ms": 1e-3, "us": 1e-6}))
    # V/m; positive: the signal rises as the target approaches
    sensitivity: float | None = _said(_in_units("sensitivity", SENSITIVITIES, _nonzero))
    # of a sensor of velocity, V s/m, and of an accelerometer, V s^2/m; positive along its angle
    per_velocity: float | None = _said(_in_units("sensitivity", _VELOCITY_SENSITIVITIES, _nonzero))
    per_acceleration: float | None = _said(_in_units("sensitivity", _ACCELERATION_SENSITIVITIES, _nonzero))
    # how often it differentiates the motion, once it is complete: its sensitivity is per m/s^derivative
    derivative: int = 0


@dataclass(frozen=True, kw_only=True)
class Reference:
    """A phase reference: Keyphasor or tooth wheel."""

    channel: str | None = _said(_channel)  # of the recording
    # where its probe sits, rad, counter-clockwise from x; None: at x, from which angles of forces then count
    angle: float | None = _said({"angle_deg": _degrees})
    # the edge that is angle zero; None: found from the signal
    edge: str | None = _said({"edge": _choice(falling="falling", rising="rising")})
    level: float | None = _said({"level_V": number})  # voltage at which the edge is timed; None: half way
    pulses_per_turn: int | None = _said({"pulses_per_turn": _count})  # 1 unless given
    # share by which its channel's clock is fast against that of the probes; None: the same
    clock: float | None = _said(_in_units("clock", {"ppm": 1e-6}, _ppm))
    steady: bool | None = _said({"steady": _truth})  # of a perturbator without a mark: it turns at one speed


@dataclass(frozen=True, kw_only=True)
class ForceSetup:
    """Force that drives the rotor: a rotating mass at a known angle, or a force that was measured."""

    plane: str | None = _said(_plane, {"force_plane": word, "weight_plane": word})  # where the force acts
    mr: float | None = _said(_unbalance, _unbalance)  # unbalance, kg m
    # heavy spot ahead of the mark in the direction it turns, rad; None: not known
    angle: float | None = _said({"angle_deg": _degrees}, {"heavy_spot_deg_ahead_of_mark": _degrees})
    # the same from a hole whose own angle is not known
    hole_angle: float | None = _said({"hole_angle_deg": _degrees}, {"weight_angle_deg": _degrees})
    whirl: int | None = _said({"whirl": _whirl}, {"whirl": _whirl})  # +1 turns with the shaft, -1 against it
    channel_x: str | None = _said({"channel_x": word})  # channel of a measured force along x
    channel_y: str | None = _said({"channel_y": word})  # channel of a measured force along y
    sensitivity: float | None = _said(_in_units("sensitivity", _FORCE_SENSITIVITIES, _nonzero))  # of these, V/N
    # in which these are scaled already; None: volts, or as the file says
    unit: str | None = _said({"unit": _unit_of("force", "voltage")})


@dataclass(frozen=True, kw_only=True)
class LoadSetup:
    """A constant load on the turning shaft."""

    plane: str | None = _said(_plane, {"load_plane": word})  # where it acts
    # N; zero: a recording without load, that positions may count from
    size: float | None = _said({"N": _size, "lbf": _in_units("", UNITS["force"], _size)["_lbf"]}, {"load_N": _size})
    angle: float | None = _said({"angle_deg": _degrees}, {"load_deg": _degrees})  # its direction, rad, from x


@dataclass(frozen=True, kw_only=True)
class ImpulseSetup:
    """Blows or releases, after which the shaft vibrates freely."""

    plane: str | None = _said(_plane, {"impulse_plane": word})  # of the probes to look at
    # frequency above which nothing is of interest, rad/s
    highest: float | None = _said(_in_units("highest", {"hz": 2 * math.pi}, positive))


@dataclass(frozen=True, kw_only=True)
class Twist:
    """The disk's twist against the evenly turning end: a channel of torsion, or tooth wheels at two planes."""

    channel: str | None = _said(_channel)  # of the recording
    sensitivity: float | None = _said({"sensitivity_V_per_rad": _nonzero})  # V/rad
    even_wheel: str | None = _said({"even_wheel": word})  # channel of the tooth wheel at the evenly turning end
    wheel: str | None = _said({"wheel": word})  # channel of that at the disk
    teeth: int | None = _said({"teeth": _count})  # of each wheel


VECTOR_ORDERS, WAVEFORM_ORDERS = 2, 24
"""Orders of the shaft that run-out is made of: as vectors, and as a waveform over the angle."""


@dataclass(frozen=True, kw_only=True)
class SlowRollSetup:
    """Run-out to be taken out of the signals, as slow turning shows it."""

    # speed below which motion that turns with the shaft is run-out, rad/s
    below: float | None = _said(_in_units("below", {"rpm": RAD_S_PER_RPM}, positive))
    # recording of slow turning in the folder of the recording; None: the recording itself
    file: str | None = _said({"file": word})
    # of the shaft; None: vectors
    orders: int | None = _said({"as": _choice(vector=VECTOR_ORDERS, waveform=WAVEFORM_ORDERS)})


@dataclass(frozen=True, kw_only=True)
class Scale:
    """Quantity and unit of a channel's numbers."""

    volts_per_count: float | None = _said({"volts_per_count": _nonzero})  # None where the full scale is given
    full_scale: float | None = _said({"full_scale_V": positive})  # volts at the largest count that the file can hold
    offset: float = _said({"offset_V": number}, default=0.0)  # volts at count zero
    unit: str | None = _said(
        {"unit": _unit_of(*UNITS_OF_CHANNELS)}
    )  # in which it is scaled already; None: volts, or as the file says


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
        exchanged: two channels whose cables were exchanged: each holds what the other one should.
        leave_out: channels of probes that are not to be read.
        scales: of channels that hold counts, by channel.
        attributes: test attributes of the recording, such as the oil temperature.
        runs: what holds for one file, by the name of the file.
        source: the file this was read from, for messages.
    """

    rotation: int | None = _said({}, {"rotation": _choice(ccw=1, cw=-1)})
    sample_rate: float | None = _said({}, {"sample_rate_hz": positive})
    speed: float | None = _said({}, _in_units("speed", {"rpm": RAD_S_PER_RPM, "hz": 2 * math.pi, "rad_s": 1.0}))
    shaft: Reference | None = None
    perturbator: Reference | None = None
    probes: tuple[Probe, ...] | None = None
    force: ForceSetup | None = None
    load: LoadSetup | None = None
    impulse: ImpulseSetup | None = None
    twist: Twist | None = None
    slow_roll: SlowRollSetup | None = None
    clearance: Mapping[str, float] = field(default_factory=dict)
    sensitivity: float | None = _said({}, _in_units("sensitivity", SENSITIVITIES, _nonzero))
    exchanged: tuple[str, ...] | None = _said({}, {"exchanged": _two_names})
    leave_out: tuple[str, ...] | None = _said({}, {"leave_out": _names})
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
    mr: float = math.nan  # unbalance, kg m; NaN for a measured force
    angle: float = 0.0  # heavy spot ahead of x in the direction it turns, as the mark gives its pulse, rad
    mark: float = 0.0  # of that the angle of the mark itself, rad
    datum_known: bool = True  # whether ``angle`` is known; else a fit needs ``phase_offsets="common"``
    whirl: int  # +1 turns with the shaft, -1 against it
    reference: str = ""  # ``"perturbator"`` or ``"shaft"``, the mark that it is locked to; none of a measured force
    channels: tuple[str, str] = ("", "")  # channels of the force along x and y where it was measured
    sensitivity: float = math.nan  # of these channels, V/N; NaN without

    @property
    def measured(self) -> bool:
        """True if the force was measured rather than computed from a turning mass."""
        return any(self.channels)


@dataclass(frozen=True, kw_only=True)
class Load:
    """Constant load of one recording."""

    plane: str  # where it acts
    newton: complex  # ``Px + j Py``, y 90 degrees ahead of x as the shaft turns; zero: none
