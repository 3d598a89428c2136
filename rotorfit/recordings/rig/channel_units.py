"""Units in which a file holds its channels: volts of a probe, or motions and forces that are scaled already."""

from __future__ import annotations

import re
from dataclasses import dataclass

from rotorfit.units import UNITS, find_unit

_UNITS = {
    "voltage": {"V": 1.0, "mV": 1e-3, "uV": 1e-6},
    "length": UNITS["length"],
    "force": UNITS["force"],
    "velocity": {"m/s": 1.0, "mm/s": 1e-3, "in/s": 0.0254, "ips": 0.0254},
    "acceleration": {"g": 9.80665, "m/s2": 1.0, "mm/s2": 1e-3},
}
_LONG = {
    "volt": "V", "volts": "V", "micron": "um", "microns": "um", "micrometer": "um", "micrometre": "um", "mils": "mil",
    "inch": "in", "newton": "N", "newtons": "N", "lb": "lbf", "gn": "g", "g's": "g",
}  # fmt: skip
_IN_NAME = re.compile(r"^(.*?)(?:[ _]*[\[(]([^\])]+)[\])]|_(um|µm|mm|mil|mV|V|N|g))$")
ALLOWED = ", ".join(unit for units in _UNITS.values() for unit in units)


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
    for quantity, units in _UNITS.items():
        try:
            factor = find_unit(word, units)
        except ValueError:
            factor = None
        if factor is not None:
            return ChannelUnit(name=text.strip(), quantity=quantity, factor=factor)
    return None


def name_and_unit(name: str) -> tuple[str, str]:
    """Name of a channel without the unit in it, ``disk_X [um]`` or ``disk_X_um``, and that unit or nothing."""
    match = _IN_NAME.match(name.strip())
    unit = (match[2] or match[3]) if match else ""
    return (match[1].strip(), unit) if match and channel_unit(unit) else (name, "")
