"""A setup to fill in, made from a recording's own channels: ``rotorfit template a.h5 > rig.toml``."""

from __future__ import annotations

import json
import math
from pathlib import Path

from rotorfit.base.units import RAD_S_PER_RPM
from rotorfit.lab.recordings.formats.files import open_raw
from rotorfit.lab.recordings.formats.raw_file import RawFile
from rotorfit.lab.recordings.rig.resolve import file_setup
from rotorfit.lab.recordings.rig.setup import ForceSetup, Probe, Reference, RigSetup, channel_unit, name_and_unit

_CLEARANCE = (
    "",
    "# [clearance_um]                 # leave out, or: radial clearance, drawn in orbits and centrelines",
    "# journal = 150.0                # of a plane, about the place that its probes' centre_V says",
)
_SLOW_ROLL = (
    "",
    "# [slow_roll]                    # leave out, or: run-out to take out of the signals",
    '# below_rpm = 300.0              # from the slow part of the recording; or file = "slow.h5", one beside it',
    '# as = "vector"                  # 1x and 2x; "waveform": scratches too',
)


def template(path: str | Path) -> str:
    """Text of a ``rig.toml`` for a recording: what the file says is a comment, what is missing is to be filled in."""
    raw = open_raw(path)
    own = file_setup(raw)
    rate = raw.sample_rate or next((c.sample_rate for c in raw.channels.values() if c.sample_rate), None)
    parts = [
        f"# Setup of the rig for {raw.name}. Lines marked FILL IN wait for a value: take the '#' away and write it.",
        "# What the recording says itself need not be written; a value here goes before it.",
        "",
        'rotation = "ccw"                 # "ccw": the shaft turns from x towards y; "cw": the other way',
        _line("sample_rate_hz", rate, 6400.0, "samples a second"),
        _line("speed_rpm", own.speed and own.speed / RAD_S_PER_RPM, 1500.0, "nominal speed", must=False),
        *_reference("shaft", own.shaft, raw, "the shaft's Keyphasor"),
        *_reference("perturbator", own.perturbator, raw, "the perturbator's mark; leave out for a start-up"),
        *(line for probe in own.probes or () for line in _probe(probe, own, raw)),
        *([] if own.probes else _unknown_probes(raw)),
        *_force(own.force),
        *_SLOW_ROLL,
        *_CLEARANCE,
    ]
    for channel in raw.channels.values():
        if channel.full_count is not None and channel.volts_per_count is None:
            scale = "# full_scale_V = 10.0            # FILL IN: volts of the largest count, or volts_per_count"
            parts += [
                "",
                "[[channel]]                      # it holds counts",
                f"name = {_quoted(channel.name)}",
                scale,
            ]
    return "\n".join(parts) + "\n"


def _line(key: str, known: float | str | None, example: float | str, words: str, *, must: bool = True) -> str:
    value = example if known is None else known
    shown = _quoted(value) if isinstance(value, str) else f"{value:.10g}" if value % 1 else f"{value:.1f}"
    said = "the recording says so" if known is not None else f"FILL IN: {words}" if must else words
    return f"{f'# {key} = {shown}':<32} # {said}"


def _quoted(name: str) -> str:
    """A text as TOML has it, which escapes as JSON does."""
    return json.dumps(name, ensure_ascii=False)


def _reference(table: str, known: Reference | None, raw: RawFile, words: str) -> list[str]:
    if known is None or known.channel is None:
        return [
            "",
            f"{f'# [{table}]':<32} # {words}",
            f"{'# channel = ...':<32} # one of: {', '.join(raw.channels)}",
            f"{'# angle_deg = 0.0':<32} # where this Keyphasor probe sits, from x counter-clockwise",
        ]
    edge = f'edge = "{known.edge}" by the recording' if known.edge else 'edge = "falling" or "rising", else found'
    return [
        "",
        f"{f'[{table}]':<32} # {words}",
        f"channel = {_quoted(known.channel)}",
        f"{'# pulses_per_turn = 1':<32} # {edge}; level_V is found",
        _line("angle_deg", known.angle, 0.0, "where this Keyphasor probe sits, from x counter-clockwise"),
    ]


def _probe(probe: Probe, own: RigSetup, raw: RawFile) -> list[str]:
    said = (channel_unit(text) for text in (raw.channels[probe.channel].unit, name_and_unit(probe.channel)[1]))
    unit = next((each.name for each in said if each is not None and each.quantity == "length"), "")
    angle = None if probe.angle is None else math.degrees(probe.angle)
    sensitivity = None if own.sensitivity is None else own.sensitivity / 1e3
    others = 'or _mV_per_mil, ..., _mV_per_g or _mV_per_mm_s of other sensors; or unit = "um" if it is scaled'
    scale = _line("sensitivity_V_per_mm", sensitivity, 7.87, others)
    return [
        "",
        "[[probe]]",
        f"plane = {_quoted(probe.plane)}",
        f"channel = {_quoted(probe.channel)}",
        _line("angle_deg", angle, 0.0, "where the probe sits, from x counter-clockwise"),
        _line("unit", unit, "um", "") if unit else scale,
        _line("delay_us", None, 0.0, "by which the channel is late, as on a card of its own", must=False),
    ]


def _unknown_probes(raw: RawFile) -> list[str]:
    lines = ["", f"# FILL IN one table a displacement probe; the channels are: {', '.join(raw.channels)}"]
    for name in raw.channels:
        lines += [
            "# [[probe]]",
            '# plane = "disk"',
            f"# channel = {_quoted(name)}",
            "# angle_deg = 0.0",
            "# sensitivity_V_per_mm = 7.87   # of an accelerometer sensitivity_mV_per_g = 100.0,",
            "#                               # of a sensor of velocity sensitivity_mV_per_mm_s = 4.0;",
            '#                               # or unit = "um" for a channel that is scaled already',
        ]
    return lines


def _force(known: ForceSetup | None) -> list[str]:
    force = known or ForceSetup()
    angle = force.angle if force.angle is not None else force.hole_angle
    key = "hole_angle_deg" if force.angle is None and force.hole_angle is not None else "angle_deg"
    whirl = None if force.whirl is None else ("forward" if force.whirl > 0 else "backward")
    lines = [
        _line("plane", force.plane, "disk", "where the force acts"),
        _line("mr_kg_m", force.mr, 2e-5, "unbalance of the perturbator or trial weight"),
        _line(key, None if angle is None else math.degrees(angle), 33.0, "heavy spot ahead of the mark", must=False),
        _line("whirl", whirl, "forward", "or backward: which way the perturbator turns", must=False),
    ]
    lines += [
        "#                                # instead of mr_kg_m a measured force, of a hammer, a shaker or a load cell:",
        '#   channel_x = "hammer"         # or channel_y, along y',
        '#   sensitivity_mV_per_N = 2.25  # or _V_per_N, _mV_per_lbf, ...; or unit = "N"',
    ]
    words = "FILL IN if the rotor is driven, else leave out" if known is None else "said by the recording:"
    return ["", f"{'# [force]':<32} # {words}", *lines]
