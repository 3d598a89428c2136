"""Contents of a recording, in words."""

from __future__ import annotations

import numpy as np

from rotorfit.base.digits import significant
from rotorfit.base.units import RAD_S_PER_RPM
from rotorfit.lab.recordings.angle_track import AngleTrack
from rotorfit.lab.recordings.recording import Recording

_UNITS = (("µm", 1e6), ("mm/s", 1e3), ("m/s²", 1.0))
"""Unit of what a sensor reads, and its share of SI, by how often it differentiates."""


def summary(record: Recording) -> str:
    """Length, speeds, force, a line a probe, and what was found."""
    lines = [f"{record.name}: {record.duration:.3f} s at {record.sample_rate:g} Hz, {len(record.channels)} channels"]
    if record.rig.shaft is not None:
        lines.append(_mark(record, "shaft", record.shaft_angle()))
    perturbator = record.perturbator_angle()
    if perturbator is not None:
        lines.append(_mark(record, "perturbator", perturbator))
    lines += _force(record)
    width = max((len(probe.channel) for probe in record.probes), default=0)
    for probe in record.probes:
        each = record.statistics[probe.channel]
        unit, factor = _UNITS[probe.derivative]
        scale = factor / abs(float(probe.sensitivity or 1.0))
        lines.append(
            f"  {probe.channel:<{width}}  {probe.plane} at {np.degrees(float(probe.angle or 0.0)):g} deg: mean "
            f"{each.mean:.3f} {each.unit}, {each.low:.3f} to {each.high:.3f} {each.unit} "
            f"({(each.high - each.low) * scale:.1f} {unit} pk-pk, {each.deviation * scale:.2f} {unit} rms)"
        )
    lines += [f"  {finding}" for finding in record.findings] or ["  nothing odd was found"]
    return "\n".join(lines)


def _mark(record: Recording, name: str, angle: AngleTrack) -> str:
    speeds = np.abs(angle.speeds()) / RAD_S_PER_RPM
    jitter = f"{angle.jitter * record.sample_rate:.2f} samples"
    return f"  {name:<12} {speeds.min():.1f} to {speeds.max():.1f} rpm, {angle.pulses.size} pulses, scatter {jitter}"


def _force(record: Recording) -> list[str]:
    force = record.force
    if force is None:
        return ["  no force is described"]
    if force.measured:
        return [f"  force        measured at {force.plane}, {', '.join(name for name in force.channels if name)}"]
    angle = (
        f"{np.degrees(force.angle - force.mark):.1f} deg ahead of the mark"
        if force.datum_known
        else "at an angle not known"
    )
    turns = "forward" if force.whirl > 0 else "backward"
    return [
        f"  force        m r = {significant(1e6 * force.mr, 3)} g mm at {force.plane}, {turns} with the "
        f"{force.reference}, {angle}"
    ]
