"""Usual sizes of causes, each with its reason, its source, and what would tell it or take it out."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Size:
    """Usual size of a cause in its own measure."""

    size: float
    reason: str
    source: str  # "c" for arithmetic or a convention that can be checked, "m" measured, "j" judgement
    remedy: str


_CALIBRATE = "measure the sensitivity of the probes on the shaft (probe_gain=)"
_SPEEDS = "test at a second speed, or fit a law of speed (law=rf.models.LinearInSpeed)"
_RING_DOWN = "measure a ring-down without fluid"
_ERROR = "give its own error (known={NAME: (value, error)}), or fit it"
_BLOCKS = "let rf.refine fit it, or bring the shaft's matrices (KnownStructure)"
_SHAFT = "bring the shaft's matrices (KnownStructure), or test further up"

NOUNS = {
    "gain": "overall gain",
    "gain[]": "probe gain",
    "turned": "angle of the probes",
    "phase": "phase reference",
    "delay": "delay of the readings",
    "high-pass": "AC coupling",
    "clock": "clock of the sweep",
    "curve[]": "curved probe",
    "lead[]": "probe phase",
    "damper[]": "damper",
    "loss": "damping in the shaft",
    "hysteresis[]": "hysteresis",
    "gyro[]": "gyroscopic effect",
    "mass[]": "mass between",
    "q[]": "modes above the band",
    "speed label": "tachometer",
    "speed[]": "change with speed of",
    "drift": "drift of D in a sweep",
    "drift[]": "drift of D in a sweep",
    "film": "growth with the orbit",
    "film[]": "growth with the orbit",
    "rest[]": "rest off the centre",
    "lag": "lag of the fluid",
    "lag[]": "lag of the fluid",
    "probe[]": "probe off its plane",
    "force[]": "force off its plane",
    "flex[]": "modes above the band",
    "clearance": "clearance",
}
"""Causes as a reader knows them, by their names, brackets for those of a place."""

SIZES = {
    "gain": Size(
        size=0.03, reason="steel of the shaft 2.9 %, trial weight and radius 1 %", source="c", remedy=_CALIBRATE
    ),
    "gain[plane]": Size(
        size=0.02, reason="two chains of probe, cable and driver that hold 5 %", source="c", remedy=_CALIBRATE
    ),
    "phase": Size(
        size=math.radians(2.0),
        reason="width of the mark, edge off the middle of its swing",
        source="c",
        remedy='check the zero by turning the shaft by hand, or fit it (phase_offsets="common")',
    ),
    "turned": Size(
        size=math.radians(1.0),
        reason="probe bracket against the zero of the force",
        source="j",
        remedy="measure the angles of the probes from the zero of the force",
    ),
    "lead": Size(
        size=0.0,
        reason="listed by a calibration",
        source="j",
        remedy="compare the phases of two probes at one plane",
    ),
    "delay": Size(
        size=math.radians(0.5) / (2 * math.pi * 100),
        reason="unequal filters, 0.5 deg at 100 Hz",
        source="c",
        remedy="undo the filters of the channels at reading",
    ),
    "high-pass": Size(
        size=2 * math.pi * 0.5,
        reason="channels that may be AC-coupled, with a corner of 0.5 Hz",
        source="c",
        remedy="record with DC coupling (then causes={'high-pass': 0})",
    ),
    "clock": Size(
        size=math.radians(0.5) / (2 * math.pi * 100),
        reason="marks sampled by a clock of their own",
        source="j",
        remedy="sample marks and probes by one clock (clock_ppm in rig.toml)",
    ),
    "curve": Size(
        size=0.01,
        reason="linearity of a probe, and of the film under its amplitude",
        source="j",
        remedy="check the probe's characteristic, or test with less motion",
    ),
    "curve[probe]": Size(
        size=0.003,
        reason="linearity of a probe alone",
        source="c",
        remedy="check the probe's characteristic, or test with less motion",
    ),
    "film": Size(
        size=1.5,
        reason="a full film of a short bearing, (1 - (a/c)^2)^-1.5",
        source="c",
        remedy="test with less motion, or fit a law of eccentricity (law=, --law)",
    ),
    "rest": Size(
        size=0.0,
        reason="listed where it is given, for a centred journal",
        source="j",
        remedy="test with the journal centred",
    ),
    "damper": Size(
        size=0.05, reason="damping ratio of rotors without fluid 2.5 %", source="m", remedy=f"{_RING_DOWN} (known=)"
    ),
    "neglected": Size(
        size=0.02,
        reason="a damper that was told as none beside the fluid's damping",
        source="j",
        remedy=f"{_RING_DOWN} (known=)",
    ),
    "damping": Size(size=0.20, reason="a damping that was measured by a ring-down", source="j", remedy=_ERROR),
    "loss": Size(size=0.005, reason="loss factor of built-up rotors", source="m", remedy=_RING_DOWN),
    "gyro": Size(
        size=0.02,
        reason="a disk of a seventh of the span at a third of it",
        source="c",
        remedy="fit a model with tilt, or the known shaft",
    ),
    "known": Size(size=0.01, reason="a value that was measured", source="j", remedy=_ERROR),
    "lag": Size(
        size=math.radians(2.0),
        reason="compliance in series, 30 times the fluid's at the top",
        source="j",
        remedy="take Mf for an effective one, or measure the stiffness of what holds the fluid",
    ),
    "speed[lam]": Size(size=0.05, reason="swirl, when the speed doubles", source="c", remedy=_SPEEDS),
    "speed[K0]": Size(size=0.30, reason="pressure is constant, the speed doubles", source="c", remedy=_SPEEDS),
    "speed[D]": Size(size=0.10, reason="oil that warms when the speed doubles", source="c", remedy=_SPEEDS),
    "drift": Size(
        size=0.04,
        reason="oil that warms by 1 K from the middle of a sweep to its end",
        source="c",
        remedy="let temperatures settle, and repeat the sweep the other way",
    ),
    "speed label": Size(
        size=0.002, reason="a speed of unknown origin", source="j", remedy="check the counter against a reference"
    ),
    "speed label[counted]": Size(
        size=0.0005,
        reason="speeds of single readings, as pulses are counted",
        source="c",
        remedy="check the counter against a reference",
    ),
    "mass": Size(size=0.005, reason="a mass that was weighed", source="j", remedy=_ERROR),
    "mass between": Size(
        size=0.05, reason="the shaft's own mass between planes, of the mean of theirs", source="c", remedy=_BLOCKS
    ),
    "between": Size(
        size=0.01, reason="coupling that a lumped chain leaves out, of the stiffness", source="j", remedy=_BLOCKS
    ),
    "offset": Size(
        size=0.02,
        reason="2 mm of 100 mm on the way to the next plane",
        source="c",
        remedy="measure how far probes and weights are off the planes",
    ),
    "q": Size(size=0.003, reason="modes above the band, of the stiffness at its top", source="c", remedy=_SHAFT),
    "flex": Size(size=0.01, reason="modes above the band, of the static compliance", source="c", remedy=_SHAFT),
    "flex[journal]": Size(
        size=0.03, reason="the same where a journal or a bare shaft is forced", source="c", remedy=_SHAFT
    ),
    "clearance": Size(size=0.02, reason="heat and measurement", source="c", remedy="measure the clearance warm"),
}
"""Usual sizes, which the user may replace; docs/uncertainty.md says where they come from."""
