"""Section of the report on the recordings that the data were made from: what was recorded, and what was done to it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from rotorfit.base.digits import significant
from rotorfit.base.units import RPM_PER_RAD_S
from rotorfit.show.report.figures import embedded
from rotorfit.show.report.html import Html, bullets, element, paragraph, table
from rotorfit.show.report.material import ReportInput
from rotorfit.show.report.numbers import plain
from rotorfit.show.report.parts import note, section, sentence

if TYPE_CHECKING:
    from rotorfit.lab.recordings.angle_track import AngleTrack
    from rotorfit.lab.recordings.recording import Recording

_BY_BLOWS = (
    "Each free vibration after a blow or a release became a ring-down, with the shaft's own 1x and 2x beside its modes."
)
_BY_TURBULENCE = (
    "Orders of the shaft were taken out by its angle, and spectra of what turbulence left averaged over cells of "
    "frequencies."
)
_BY_LOADS = "Mean gap voltages became positions of the shaft under constant loads."
_BY_LINES = (
    "The spectra became amplitudes of the shaft's combination lines, each relative to a drive made of the force and "
    "the shaft's own angle."
)
_BY_WINDOWS = "Vectors were tracked by windows of {turns} whole turns, as tracking filters do; a sweep makes them lag."
_BY_SPECTRA = (
    "The spectra of z = x + j y became responses at lines chosen for the fit, by local models in the signed frequency. "
    "The models include transients, so the rate of a sweep does not bias them. Motion that turns with the shaft "
    "(run-out, residual unbalance and their orders) was subtracted with the shaft's own angle. Lines too close to an "
    "order to be separated from it were left out. The noise of each reading is that of the local residuals."
)


def recordings_section(material: ReportInput) -> Iterator[Html]:
    """Files, marks, probes, forces and cascades of the recordings; nothing where the data were not recorded."""
    records = material.recordings
    if not records:
        return
    done = dict.fromkeys(_done(record, material) for record in records)
    found = [f"{record.name}: {finding.message}" for record in records for finding in record.findings]
    yield section(
        "Recordings",
        table(
            ["recording", "length, s", "rate, Hz", "speed, rpm", "perturbation, rpm", "driven by"],
            [_row(record) for record in records],
            numeric=(1, 2),
        ),
        table(["probe", "plane", "angle, deg", "sensitivity, V/mm", "signals"], _probe_rows(records), (2, 3)),
        *(paragraph(words) for words in done),
        bullets(sentence(words) for words in found) if found else note("Nothing odd was found in the signals."),
    )
    if material.figure_format != "none":
        drawn = 4  # recordings whose cascade is shown; a page of more says nothing new
        cascades = [
            embedded(material, f"cascade_{i + 1}", record.plot.cascade, f"Full spectra of {record.name}.")
            for i, record in enumerate(records[:drawn])
        ]
        yield section("Cascades of the recordings", element("div", *cascades, class_="side"))


def _done(record: Recording, material: ReportInput) -> str:
    """The function that made experiments of a recording."""
    if any(test.reducer == "shaft_lines" for test in material.fit.experiments):
        return _BY_LINES  # the weight of the shaft and its own unbalance may be all that drives it
    if any(test.reducer == "operating_spectra" for test in material.fit.experiments):
        return _BY_TURBULENCE
    from rotorfit.lab.recordings.reduction.responses import BLOWS, LOADS, kind_of  # loads half of SciPy

    kind = kind_of(record)
    if kind in (BLOWS, LOADS):
        return _BY_BLOWS if kind == BLOWS else _BY_LOADS
    return _BY_WINDOWS.format(turns=material.turns) if material.turns else _BY_SPECTRA


def _row(record: Recording) -> list[str]:
    perturbator = record.perturbator_angle()
    return [
        record.name,
        significant(record.duration, 4),
        f"{record.sample_rate:g}",
        _speeds(record.shaft_angle()) if record.rig.shaft is not None else "",
        _speeds(perturbator) if perturbator is not None else "",
        _driven_by(record),
    ]


def _speeds(angle: AngleTrack) -> str:
    """Speeds of a mark, and the number of its pulses."""
    rpm = np.abs(angle.speed(np.linspace(angle.begin, angle.end, 200))) * RPM_PER_RAD_S
    span = f"{rpm.min():.1f}" if np.ptp(rpm) < 0.002 * rpm.max() else f"{rpm.min():.0f} to {rpm.max():.0f}"
    return f"{span} ({angle.pulses.size} pulses)"


def _driven_by(record: Recording) -> str:
    """Force of a recording in words."""
    force, load = record.force, record.rig.load
    if force is None and load is not None:
        return f"load of {plain(abs(load.newton), 4)} N at {load.plane}"
    if force is None:
        return "blows" if record.rig.impulse is not None else "what the shaft itself brings"
    if force.measured:
        return f"measured force at {force.plane}, {', '.join(name for name in force.channels if name)}"
    ahead = f"{np.degrees(force.angle):.1f}° ahead of the mark".replace("-", "−")
    angle = ahead if force.datum_known else "at an angle not known"
    whirl = "" if force.reference == "shaft" else " forward" if force.whirl > 0 else " backward"
    return f"m r = {plain(1e6 * force.mr, 4)} g mm{whirl} at {force.plane}, {angle}"


def _probe_rows(records: Sequence[Recording]) -> list[list[str]]:
    """A row a channel, with the range of its voltage in all recordings."""
    rows: dict[tuple[str, str], list[Recording]] = {}
    for record in records:
        for probe in record.probes:
            rows.setdefault((probe.channel, str(probe.plane)), []).append(record)
    found = []
    for (channel, plane), holding in rows.items():
        probe = next(p for p in holding[0].probes if p.channel == channel)
        each = [record.statistics[channel] for record in holding]
        low, high = min(s.low for s in each), max(s.high for s in each)
        found.append(
            [
                channel,
                plane,
                significant(np.degrees(probe.angle or 0.0), 4),
                f"in {probe.unit}" if probe.unit else significant(1e-3 * abs(float(probe.sensitivity or np.nan)), 4),
                f"{low:.3f} to {high:.3f} {each[0].unit}".replace("-", "−"),
            ]
        )
    return found
