"""Uncertainty of a calibration: sizes of the causes that every reading of a probe, or of a test, has in common.

A probe that reads 1 % high, a trial weight that is 0.5 % heavier than its label, or a Keyphasor notch 1 deg off its
mark spoils all readings alike: more readings do not help, and the residuals hardly show it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from rotorfit.base.names import unknown_name

Uncertainty = float | Mapping[str, float]

_USELESS = {"probe_gain": 0.5, "probe_phase_deg": 90.0, "mr": 0.5, "keyphasor_deg": 90.0}
"""Uncertainties from which on nothing is calibrated: rather per cent where a fraction is wanted."""


@dataclass(frozen=True)
class Calibration:
    """Standard uncertainties of a calibration (GUM type B); zero where nothing is said.

    Attributes:
        probe_gain: relative uncertainty of each probe's gain, probes being independent; a number for all of them or a
            mapping by plane (``{"disk": 0.01}``) or by plane and direction (``{"disk.x": 0.01}``).
        probe_phase_deg: uncertainty of each probe's phase, degrees, likewise.
        mr: relative uncertainty of the force's amplitude (mass-radius product), the same error in all runs.
        keyphasor_deg: uncertainty of the angle between phase reference and force, degrees, the same error in all runs.

    Example:
        >>> calibrated = rf.Calibration(probe_gain=0.01, mr=0.005)
        >>> surer = rf.fit(rf.models.WhirlWhip(), rig, known={"K3": 6000.0}, calibration=calibrated)
        >>> surer.params["D"].stderr < fit.params["D"].stderr
        True
    """

    probe_gain: Uncertainty = 0.0
    probe_phase_deg: Uncertainty = 0.0
    mr: float = 0.0
    keyphasor_deg: float = 0.0

    def __post_init__(self) -> None:
        for name, most in _USELESS.items():
            given = getattr(self, name)
            for where, value in given.items() if isinstance(given, Mapping) else [("", given)]:
                said = f"{name} of {where} is {value!r}" if where else f"{name} is {value!r}"
                if not (isinstance(value, (int, float)) and math.isfinite(value) and value >= 0):
                    raise ValueError(f"{said}; a standard uncertainty is zero or a positive number")
                if value >= most:
                    unit = "degrees" if name.endswith("_deg") else "as a fraction, 0.02 for 2 %"
                    raise ValueError(f"{said}; it is below {most:g} ({unit})")
        if not any(np.any(list(v.values()) if isinstance(v, Mapping) else v) for v in vars(self).values()):
            raise ValueError("every uncertainty of the calibration is zero: give at least one")


def calibration_of(values: Mapping[str, Any]) -> Calibration | None:
    """A calibration from names and values, none from none."""
    if not values:
        return None
    names = [f.name for f in fields(Calibration)]
    for name in values:
        if name not in names:
            raise ValueError(unknown_name("uncertainty of calibration", name, names))
    return Calibration(**values)


def sizes_of(calibration: Calibration, planes: Mapping[str, tuple[str, ...]]) -> dict[str, float]:
    """Sizes of the causes that a calibration tells, by name.

    Args:
        calibration: its uncertainties.
        planes: planes that are read, each with the directions of its probes: the mean of an x and a y probe is off by
            the root of both squares over two.

    Raises:
        ValueError: planes or probes that are not there.
    """
    found = {}
    for option, given, cause, unit in (
        ("probe_gain", calibration.probe_gain, "gain", 1.0),
        ("probe_phase_deg", calibration.probe_phase_deg, "lead", math.pi / 180),
    ):
        if not given:
            continue
        by_place = given if isinstance(given, Mapping) else dict.fromkeys(planes, float(given))
        probes = [f"{plane}.{way}" for plane, ways in planes.items() for way in ways]
        for name in by_place:
            if name not in (*planes, *probes):
                raise ValueError(f"{option} names {name}; the data have {', '.join((*planes, *probes))}")
        for plane, ways in planes.items():
            each = [unit * by_place.get(f"{plane}.{way}", by_place.get(plane, 0.0)) for way in ways]
            found[f"{cause}[{plane}]"] = math.hypot(*each) / len(each)
    if calibration.probe_gain or calibration.mr:
        found["gain"] = calibration.mr or _FORCE
    if calibration.keyphasor_deg:
        found["phase"] = math.radians(calibration.keyphasor_deg)
    return found


_FORCE = 0.01
"""Size of the common gain by trial weight and radius alone, where the probes were calibrated on the shaft."""
