"""From what a file says of itself and what a setup says to a rig with nothing left open."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any, TypeVar

import numpy as np

from rotorfit.base.digits import significant
from rotorfit.base.names import unknown_name
from rotorfit.base.units import RPM_PER_RAD_S
from rotorfit.lab.data.findings import Finding
from rotorfit.lab.recordings.formats.raw_file import RawChannel, RawFile
from rotorfit.lab.recordings.rig.rig_toml import flat_setup
from rotorfit.lab.recordings.rig.setup import (
    ALLOWED,
    UNITS_OF_CHANNELS,
    ChannelUnit,
    Force,
    ForceSetup,
    ImpulseSetup,
    Load,
    LoadSetup,
    Probe,
    Reference,
    RigSetup,
    Scale,
    SlowRollSetup,
    Twist,
    channel_unit,
    name_and_unit,
    prefer,
)

_PROBE_NAME = re.compile(r"(?i)^(.+?)[ _.\-]?([xy])$")
_REFERENCE_NAME = re.compile(r"(?i)keyph|tacho|kph|trigger")
_PERTURBATOR_NAME = re.compile(r"(?i)pert|exc")

Plugged = TypeVar("Plugged", Probe, Reference)


@dataclass(frozen=True, kw_only=True)
class Rig:
    """The rig of one recording, complete: every probe has its angle and sensitivity, every channel exists."""

    sample_rate: float  # Hz
    size: int  # samples
    rotation: int  # +1 counter-clockwise, -1 clockwise
    probes: tuple[Probe, ...]  # with angle (rad) and sensitivity (V/m)
    shaft: Reference | None  # phase reference of the shaft, None without one
    perturbator: Reference | None  # phase reference of the perturbator, None without one
    force: Force | None  # what drives the rotor; None where neither file nor setup says
    load: Load | None  # constant load; None where neither file nor setup says
    impulse: ImpulseSetup | None  # that the rotor is struck or released
    twist: Twist | None  # channel of torsion
    slow_roll: SlowRollSetup | None  # run-out to be taken out of the signals
    clearance: Mapping[str, float]  # radial, m, by plane
    scales: dict[str, tuple[float, float]]  # factor to volts and offset by channel
    speed: float | None  # nominal rotative speed, rad/s
    attributes: dict[str, float | str]  # test attributes
    findings: tuple[Finding, ...] = ()  # contradictions between file and setup

    def late(self, channel: str) -> float:
        """Time by which the channel of a probe is late, s; zero for all others."""
        return next((probe.delay or 0.0 for probe in self.probes if probe.channel == channel), 0.0)


def file_setup(raw: RawFile) -> RigSetup:
    """The rig as a file describes it: attributes, and channels named ``PLANE_X``, ``PLANE_Y`` and ``keyphasor_...``."""
    known = dict(raw.attributes)
    edges = re.findall(r"(?i)\b(falling|rising)\b", str(known.pop("keyphasor", "")))
    edge = edges[0].lower() if edges else None
    angles = {axis: known.pop(f"probe_angle_deg_{axis.upper()}", None) for axis in "xy"}
    twist_sensitivity = known.pop("twist_V_per_rad", None)
    setup = flat_setup(known, raw.name)
    references = [name for name in raw.channels if _REFERENCE_NAME.search(name)]
    perturbators = [name for name in references if _PERTURBATOR_NAME.search(name)]
    shafts = [name for name in references if name not in perturbators]
    probes = []
    for name in raw.channels:
        match = None if name in references else _PROBE_NAME.match(name_and_unit(name)[0])
        if match:
            angle = angles[match[2].lower()]
            rad = math.radians(angle) if isinstance(angle, int | float) else None
            probes.append(Probe(plane=match[1], channel=name, angle=rad))
    has_twist = "twist" in raw.channels and isinstance(twist_sensitivity, int | float)
    return replace(
        setup,
        probes=tuple(probes) or None,
        shaft=Reference(channel=shafts[0], edge=edge) if len(shafts) == 1 else None,
        perturbator=Reference(channel=perturbators[0], edge=edge) if len(perturbators) == 1 else None,
        twist=Twist(channel="twist", sensitivity=float(twist_sensitivity or 1.0)) if has_twist else None,
    )


def complete(raw: RawFile, setup: RigSetup | None) -> Rig:
    """The rig of a recording."""
    own = file_setup(raw)
    given = None if setup is None else setup.of_file(raw.name)
    source = setup.source if setup is not None and setup.source else "the setup"
    whole = _merged(given, own)
    how = f"say it in {source}"
    if setup is None:
        how = (
            f"write a setup: `rotorfit template {raw.name} > rig.toml` makes one of the file's own channels to fill "
            "in; then give it (setup=, --setup)"
        )
    marks = (whole.shaft if whole.speed != 0 else None, whole.perturbator)  # a shaft that stands still passes none
    shaft, perturbator = (mark if mark is not None and (mark.channel or mark.steady) else None for mark in marks)
    marked = [probe.channel for probe in whole.probes or ()]
    marked += [mark.channel for mark in (shaft, perturbator) if mark is not None and mark.channel]
    used = _used(raw, whole, source, marked, how)
    probes = tuple(_complete_probe(raw, probe, whole, how) for probe in whole.probes or ())
    planes = tuple(dict.fromkeys(probe.plane for probe in probes))
    force = _force(raw, whole, perturbator, planes)
    _check_tables(whole, shaft, planes, raw.name, source)
    sample_rate, size = _sampling(raw, used, whole)
    length_over_delay = 100  # A recording is so many times as long as a probe is late, at least
    longest = size / sample_rate / length_over_delay
    for probe in probes:
        if abs(probe.delay or 0.0) > longest:
            raise ValueError(
                f"{raw.name}, as {source} describes it: the probe {probe.channel} would be {probe.delay:g} s late; "
                f"at most {significant(longest, 3)} s are allowed, a hundredth of the recording"
            )
    return Rig(
        sample_rate=sample_rate,
        size=size,
        rotation=whole.rotation or 1,
        probes=probes,
        shaft=shaft,
        perturbator=perturbator,
        force=force,
        load=_load(raw, whole.load, planes, whole.rotation or 1),
        impulse=whole.impulse,
        twist=whole.twist,
        slow_roll=whole.slow_roll,
        clearance=whole.clearance,
        scales={channel.name: _scale(raw, channel, whole) for channel in used},
        speed=whole.speed,
        attributes=dict(whole.attributes),
        findings=()
        if given is None
        else (*_contradictions(given, own, raw, source), *_unused(given, raw, used, source)),
    )


def _check_tables(whole: RigSetup, shaft: Reference | None, planes: Sequence[str], where: str, source: str) -> None:
    """Refuse tables of a setup that say too little, or what does not go together."""
    twist, slow_roll = whole.twist, whole.slow_roll
    fewest_teeth = 8  # fewest teeth a turn that show a twist at several times the speed
    if twist is not None:
        wheels = (twist.even_wheel, twist.wheel, twist.teeth)
        if twist.channel and any(part is not None for part in wheels):
            raise ValueError(f"{where}: [twist] is a channel or two tooth wheels, not both")
        if twist.channel and twist.sensitivity is None:
            raise ValueError(f"{where}: the twist channel {twist.channel} needs its sensitivity_V_per_rad in [twist]")
        if not twist.channel and any(part is None for part in wheels):
            raise ValueError(
                f"{where}: [twist] needs channel and sensitivity_V_per_rad, or even_wheel (the evenly turning end), "
                "wheel (the other) and teeth"
            )
        if twist.teeth is not None and twist.teeth < fewest_teeth:
            few = f"{twist.teeth} teeth a turn are too few for a twist"
            raise ValueError(f"{where}: {few}; at least {fewest_teeth} are needed")
    if slow_roll is not None and slow_roll.below is None and slow_roll.file is None:
        raise ValueError(
            f"{source}, [slow_roll]: give below_rpm, the speed below which the shaft does not vibrate, or file, a "
            "recording of slow turning"
        )
    if slow_roll is not None and shaft is None:
        raise ValueError(f"{source}, [slow_roll] needs the shaft's own mark; name its channel in [shaft]")
    for plane in whole.clearance:
        if plane not in planes:
            raise ValueError(f"{source}, [clearance_um]: {unknown_name('plane', plane, planes)}")


def _merged(given: RigSetup | None, own: RigSetup) -> RigSetup:
    """The rig by the setup, and where it is silent by the file; channels that measure a force are no probes."""
    whole = own if given is None else prefer(given, own)
    if given is not None and given.probes:
        known = {probe.channel: probe for probe in own.probes or ()}
        probes = [prefer(probe, known.get(probe.channel, probe)) for probe in given.probes]
        whole = replace(whole, probes=tuple(probes))
    if given is not None and given.twist is not None and given.twist.wheel:
        whole = replace(whole, twist=given.twist)
    forces = {whole.force.channel_x, whole.force.channel_y} if whole.force is not None else set()
    out = {*forces, *(whole.leave_out or ())}
    return _as_wired(replace(whole, probes=tuple(p for p in whole.probes or () if p.channel not in out)))


def _as_wired(setup: RigSetup) -> RigSetup:
    """The setup with every probe and mark on the channel that its cable was on."""
    if setup.exchanged is None:
        return setup
    one, other = setup.exchanged
    on = {one: other, other: one}

    def wired(part: Plugged) -> Plugged:
        return part if part.channel is None else replace(part, channel=on.get(part.channel, part.channel))

    probes = tuple(wired(probe) for probe in setup.probes or ())
    shaft, perturbator = (None if mark is None else wired(mark) for mark in (setup.shaft, setup.perturbator))
    return replace(setup, probes=probes, shaft=shaft, perturbator=perturbator)


def _used(raw: RawFile, whole: RigSetup, source: str, marked: Sequence[str], how: str) -> list[RawChannel]:
    """Channels of the file that the rig is read from: those of probes and marks, which are ``marked``, and others."""
    twist, force = whole.twist or Twist(), whole.force or ForceSetup()
    others = (twist.channel, twist.even_wheel, twist.wheel, force.channel_x, force.channel_y)
    named = [*marked, *filter(None, others)]
    said = (*named, *whole.scales, *(whole.exchanged or ()), *(whole.leave_out or ()))
    for name in said:
        if name not in raw.channels:
            raise ValueError(f"{raw.name}, as {source} describes it: {unknown_name('channel', name, raw.channels)}")
    if not named:
        raise ValueError(f"{raw.name} does not say which channel is which probe; {how}")
    twice = [name for name in marked if marked.count(name) > 1]
    if twice:
        raise ValueError(
            f"{raw.name}, as {source} describes it: the channel {twice[0]} is used twice; every probe and every mark "
            "has a channel of its own"
        )
    return [raw.channels[name] for name in dict.fromkeys(named)]


def _complete_probe(raw: RawFile, probe: Probe, setup: RigSetup, how: str) -> Probe:
    unit = _unit_of(raw, probe.channel, probe.unit, setup)
    said = (probe.sensitivity, probe.per_velocity, probe.per_acceleration)
    orders = [order for order, value in enumerate(said) if value is not None]
    if len(orders) > 1:
        raise ValueError(
            f"{raw.name}: the probe {probe.channel} has sensitivities to {len(orders)} quantities; keep one"
        )
    order = orders[0] if orders else 0
    scaled = unit is not None and unit.quantity in _MOTIONS
    if unit is not None and scaled and not orders:
        order = _MOTIONS.index(unit.quantity)
    default = setup.sensitivity if not orders and (order == 0 or not scaled) else None
    sensitivity = _scaled(raw, probe.channel, unit, _MOTIONS[order], said[order] if orders else default)
    if probe.angle is None or sensitivity is None:
        lacking = (
            "sensitivity_V_per_mm (of an accelerometer _mV_per_g, of a sensor of velocity _mV_per_mm_s; or unit, of a "
            "channel that is scaled)"
        )
        lacking = "angle_deg" if probe.angle is None else lacking
        own = raw.channels[probe.channel].unit
        unknown = f" (its unit in the file, {own!r}, is none of {ALLOWED})" if own and channel_unit(own) is None else ""
        raise ValueError(f"{raw.name}: the probe {probe.channel} has no {lacking}{unknown}; {how}")
    name = unit.name if unit is not None and unit.quantity != "voltage" else None
    return replace(probe, sensitivity=sensitivity, unit=name, derivative=order)


def _unit_of(raw: RawFile, channel: str, said: str | None, setup: RigSetup) -> ChannelUnit | None:
    """Unit of a channel: by the setup, else by the file or the channel's name; None where nothing says one of ours."""
    scale = setup.scales.get(channel)
    given = said or (scale.unit if scale is not None else None)
    if given is None and scale is not None:
        return None  # volts of a count
    return channel_unit(given or "") or _unit_in_file(raw, channel)


def _unit_in_file(raw: RawFile, channel: str) -> ChannelUnit | None:
    """Unit of a channel by the file or the channel's name; None where neither says one of ours."""
    found = (channel_unit(text) for text in (raw.channels[channel].unit, name_and_unit(channel)[1]) if text)
    return next((unit for unit in found if unit is not None), None)


_MOTIONS = ("length", "velocity", "acceleration")
"""Quantities of a sensor of motion, by how often it differentiates."""
_MEANT = dict.fromkeys(_MOTIONS, "a probe reads motion") | {"force": "[force] takes forces"}


def _scaled(
    raw: RawFile, channel: str, unit: ChannelUnit | None, quantity: str, sensitivity: float | None
) -> float | None:
    """Sensitivity of a channel: that of volts as it is given, else of unit for a metre or a newton."""
    if unit is None or unit.quantity == "voltage":
        return sensitivity
    if unit.quantity != quantity:
        wanted = _MOTIONS if quantity in _MOTIONS else (quantity,)
        units = ", ".join(each for one in wanted for each in UNITS_OF_CHANNELS[one])
        raise ValueError(
            f"{raw.name}: the channel {channel} is in {unit.name}, {unit.quantity}; {_MEANT[quantity]}, in {units}, or "
            "in V or mV with a sensitivity to it. If the file is wrong, say unit = "
            f'"..." of [[channel]] name = "{channel}"'
        )
    if sensitivity is not None and np.isclose(abs(sensitivity) * unit.factor, 1):
        return sensitivity  # one of the unit for one of the unit, and perhaps falling on approach
    if sensitivity is not None:
        raise ValueError(
            f"{raw.name}: the channel {channel} is in {unit.name}, so it has no sensitivity in volts; take the "
            f'sensitivity away, or say unit = "V" of the channel if it holds volts'
        )
    return 1 / unit.factor


def _force(raw: RawFile, setup: RigSetup, perturbator: Reference | None, planes: tuple[str, ...]) -> Force | None:
    force = setup.force
    if force is None:
        return None
    channels = (force.channel_x or "", force.channel_y or "")
    if named := [channel for channel in channels if channel]:
        units = {channel: _unit_of(raw, channel, force.unit, setup) for channel in named}
        scaled = {_scaled(raw, channel, unit, "force", force.sensitivity) for channel, unit in units.items()}
        if len(scaled) > 1:
            raise ValueError(f"{raw.name}: the channels of the force, {' and '.join(named)}, are in different units")
        sensitivity = scaled.pop()
        if force.plane is None or sensitivity is None:
            lacking = "plane" if force.plane is None else "sensitivity_V_per_N, or unit"
            raise ValueError(f"{raw.name}: the measured force needs its {lacking} in [force]")
        return Force(plane=force.plane, whirl=force.whirl or 1, channels=channels, sensitivity=sensitivity)
    if force.mr is None:
        return None
    if perturbator is not None and force.whirl is None:
        raise ValueError(f'{raw.name}: nothing says which way the perturbator turns; give whirl = "forward" in [force]')
    only = len(planes) == 1 or (force.mr == 0 and planes)  # where no weight is does not matter
    plane = force.plane if force.plane is not None or not only else planes[0]
    if plane is None:
        raise ValueError(f"{raw.name}: nothing says in which plane the force acts; give plane in [force]")
    reference = setup.shaft if perturbator is None else perturbator
    whirl = force.whirl or 1
    mark = whirl * (setup.rotation or 1) * ((reference.angle if reference is not None else None) or 0.0)
    angle = force.angle if force.angle is not None else force.hole_angle
    marked = perturbator is None or perturbator.channel is not None
    return Force(
        plane=plane,
        mr=force.mr,
        angle=(angle or 0.0) + mark,
        mark=mark,
        datum_known=(force.angle is not None or force.mr == 0) and marked,
        whirl=whirl,
        reference="shaft" if perturbator is None else "perturbator",
    )


def _load(raw: RawFile, load: LoadSetup | None, planes: tuple[str, ...], rotation: int) -> Load | None:
    if load is None:
        return None
    plane = load.plane if load.plane is not None or len(planes) != 1 else planes[0]
    said = {"plane": plane, "N": load.size, "angle_deg": 0.0 if load.size == 0 else load.angle}
    lacking = [name for name, value in said.items() if value is None]
    if lacking or plane is None:
        raise ValueError(f"{raw.name}: the constant load needs its {', '.join(lacking)} in [load]")
    newton = float(load.size or 0.0) * complex(np.exp(1j * rotation * float(load.angle or 0.0)))
    return Load(plane=plane, newton=newton)


def _sampling(raw: RawFile, used: list[RawChannel], setup: RigSetup) -> tuple[float, int]:
    """Sampling rate, Hz, and number of samples of all channels."""
    own = {channel.sample_rate for channel in used if channel.sample_rate is not None}
    if len({round(rate, 6) for rate in own}) > 1:
        listed = ", ".join(f"{channel.name} {channel.sample_rate:g} Hz" for channel in used if channel.sample_rate)
        raise ValueError(f"{raw.name}: the channels have different sampling rates: {listed}; export them at one rate")
    rate = setup.sample_rate or (own.pop() if own else raw.sample_rate)
    if rate is None:
        raise ValueError(
            f"{raw.name} does not say its sampling rate; write sample_rate_hz = ... at the top of rig.toml and give "
            "that (setup=, --setup)"
        )
    longest = max(channel.size for channel in used)
    if odd := next((channel for channel in used if channel.size != longest), None):
        raise ValueError(
            f"{raw.name}: channels of unequal length: {odd.name} has {odd.size} samples, others {longest}; the "
            "recording is not whole, export it again"
        )
    return float(rate), longest


def _scale(raw: RawFile, channel: RawChannel, setup: RigSetup) -> tuple[float, float]:
    """Volts per count and volts at count zero."""
    scale = setup.scales.get(channel.name)
    if scale is None or scale.unit is not None:
        scale = Scale(volts_per_count=channel.volts_per_count, offset=channel.offset)
        if scale.volts_per_count is None and channel.full_count is None:
            unit = _unit_of(raw, channel.name, None, setup)
            return (unit.factor if unit is not None and unit.quantity == "voltage" else 1.0), scale.offset
    if scale.full_scale is not None:
        return scale.full_scale / (channel.full_count or 1.0), scale.offset
    if scale.volts_per_count is None and channel.full_count is not None:
        raise ValueError(
            f"{raw.name}: the channel {channel.name} holds counts and nothing says how many volts one is; add "
            f'[[channel]] name = "{channel.name}", volts_per_count = ... (or full_scale_V = ...) to rig.toml'
        )
    return (1.0 if scale.volts_per_count is None else scale.volts_per_count), scale.offset


def _contradictions(given: RigSetup, own: RigSetup, raw: RawFile, source: str) -> list[Finding]:
    """Values that setup and file give differently; those of the setup were taken."""
    found: list[str] = []

    def compare(what: str, mine: Any, other: Any, factor: float = 1.0, *, angle: bool = False) -> None:
        if mine is None or other is None:
            return
        if angle:  # within half a turn of each other
            mine, factor = other + (mine - other + np.pi) % (2 * np.pi) - np.pi, 180 / np.pi
        words = isinstance(mine, str)
        if mine != other if words else not np.isclose(mine * factor, other * factor, rtol=1e-4, atol=1e-9):
            shown = [each if words else f"{each * factor:.6g}" for each in (mine, other)]
            found.append(f"{what}: {source} says {shown[0]}, the file {shown[1]}")

    rates = (own.sample_rate, raw.sample_rate, *(channel.sample_rate for channel in raw.channels.values()))
    compare("sample rate (Hz)", given.sample_rate, next((rate for rate in rates if rate is not None), None))
    compare("speed (rpm)", given.speed, own.speed, RPM_PER_RAD_S)
    compare("sensitivity (V/mm)", given.sensitivity, own.sensitivity, 1e-3)
    said, in_file = given.force or ForceSetup(), own.force or ForceSetup()
    compare("plane of the force", said.plane, in_file.plane)
    compare("unbalance (g mm)", said.mr, in_file.mr, 1e6)
    compare("angle of the heavy spot (deg)", said.angle, in_file.angle, angle=True)
    mine, other = ({1: "forward", -1: "backward"}.get(force.whirl or 0) for force in (said, in_file))
    compare("direction of whirl", mine, other)
    by_setup = {probe.channel: probe for probe in own.probes or ()}
    for probe in given.probes or ():
        angle = by_setup[probe.channel].angle if probe.channel in by_setup else None
        compare(f"angle of {probe.channel} (deg)", probe.angle, angle, angle=True)
        compare(f"sensitivity of {probe.channel} (V/mm)", probe.sensitivity, own.sensitivity, 1e-3)
    for what, mine, other in _units(given, raw):
        compare(what, mine, other)
    found += [f"planes of the probes: {words}" for words in _parted(given.probes or (), by_setup, source)]
    told = (f"{raw.name}: {words}; the setup is followed." for words in found)
    return [Finding("warning", "setup-contradicts-file", words) for words in told]


def _unused(given: RigSetup, raw: RawFile, used: Sequence[RawChannel], source: str) -> Iterator[Finding]:
    """What a setup says and nothing is made of, each with why."""
    said: list[tuple[str, str]] = []
    for name, mark in (("shaft", given.shaft), ("perturbator", given.perturbator)):
        if mark is not None and given.speed == 0 and name == "shaft":
            said.append(("[shaft]", "a rotor at rest (speed_rpm = 0) passes no marks"))
        elif mark is not None and mark.channel is not None and mark.steady:
            said.append((f"steady of [{name}]", "its mark says the speed"))
    said += _unused_of_force(given)
    names = {*(channel.name for channel in used), *(given.leave_out or ())}
    for name, scale in given.scales.items():
        if name not in names:
            said.append((f'[[channel]] name = "{name}"', "no probe, mark or force is on it"))
        elif scale.unit is not None and scale.offset:
            said.append((f'offset_V of [[channel]] name = "{name}"', "a channel that is scaled has no offset in volts"))
    if given.sensitivity is not None and given.probes and all(_has_own(probe) for probe in given.probes):
        said.append(("the sensitivity at the top", "every probe has its own"))
    for what, why in said:
        words = f"{raw.name}: {what} in {source} is not used: {why}."
        yield Finding("note", "setup-unused", words)


def _unused_of_force(given: RigSetup) -> Iterator[tuple[str, str]]:
    """What of the force, or of what else drives the rotor, is not used, and why."""
    said: list[tuple[str, str]] = []
    force = given.force
    keys: dict[str, object]
    if force is not None and (force.channel_x or force.channel_y):
        keys = {"mr_...": force.mr, "angle_deg": force.angle, "hole_angle_deg": force.hole_angle, "whirl": force.whirl}
        said += [(f"{key} of [force]", "the force was measured") for key, value in keys.items() if value is not None]
    elif force is not None:
        keys = {"sensitivity_...": force.sensitivity, "unit": force.unit}
        why = "no channel_x or channel_y measures the force"
        said += [(f"{key} of [force]", why) for key, value in keys.items() if value is not None]
        if force.angle is not None and force.hole_angle is not None:
            said.append(("hole_angle_deg of [force]", "angle_deg says where the heavy spot is"))
    if force is not None:
        others = (("[load]", given.load), ("[impulse]", given.impulse))
        said += [(name, "[force] says what drives the rotor") for name, value in others if value is not None]
    elif given.load is not None and given.impulse is not None:
        said.append(("[load]", "[impulse] says what drives the rotor"))
    yield from said


def _has_own(probe: Probe) -> bool:
    return any(
        value is not None for value in (probe.sensitivity, probe.per_velocity, probe.per_acceleration, probe.unit)
    )


def _units(given: RigSetup, raw: RawFile) -> Iterator[tuple[str, str, str]]:
    """Units of channels that the setup gives otherwise than the file."""
    said = {name: scale.unit for name, scale in given.scales.items()}
    said |= {probe.channel: probe.unit for probe in given.probes or () if probe.unit}
    if given.force is not None and given.force.unit:
        said |= dict.fromkeys(filter(None, (given.force.channel_x, given.force.channel_y)), given.force.unit)
    for channel, text in said.items():
        mine, other = channel_unit(text or ""), _unit_in_file(raw, channel)
        if mine and other and (mine.quantity, mine.factor) != (other.quantity, other.factor):
            yield f"unit of {channel}", mine.name, other.name


def _parted(given: Sequence[Probe], by_setup: Mapping[str, Probe], source: str) -> Iterator[str]:
    """Pairs of probes that setup and file do not agree about: of one plane by the one, of two by the other."""
    both = [(probe, by_setup[probe.channel].plane) for probe in given if probe.channel in by_setup]
    for (one, of_one), (other, of_other) in combinations(both, 2):
        if (one.plane == other.plane) != (of_one == of_other):
            yield (
                f"{source} has {one.channel} at {one.plane} and {other.channel} at {other.plane}, by their names "
                f"they are at {of_one} and {of_other}"
            )
            return
