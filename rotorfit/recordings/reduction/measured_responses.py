"""Responses to forces that were measured: magnetic bearing, load cells, shaker, hammer; one axis or both at once.

A rig that is shaken along x, then along y, feels the other shaker too. Where both forces were measured, the two
recordings are reduced together: with A the motion and F the forces of both, ``H = A F^-1`` at lines that they share.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from rotorfit.data.experiments import FORCE_SIGMA, PerturbationTest, records
from rotorfit.data.findings import Finding
from rotorfit.data.synchronous import join
from rotorfit.estimators.blocks.set_speeds import SPEED_TOLERANCE
from rotorfit.estimators.signals.local_response import SMOOTH_DEGREE, LocalResponse, RecordSpectra
from rotorfit.models.array_types import Bool, ComplexArray, Float
from rotorfit.models.digits import significant
from rotorfit.recordings.recording import Recording
from rotorfit.recordings.reduction.measured_force import (
    ReducedForce,
    clear_of_noise,
    coherence,
    coherence_note,
    force_across,
    reduce_measured,
)
from rotorfit.recordings.reduction.response_lines import Report, clear_lines, estimated, readings, rows, shaft_speed_at
from rotorfit.recordings.reduction.ring_downs import QUIET_SHARE, Blow, blow_findings, blows, rest_of


@dataclass(frozen=True, kw_only=True, eq=False)
class _Driven:
    """One recording under a measured force, with the responses that it shows by itself."""

    force: ReducedForce
    found: LocalResponse  # what acts along the other axis is the last output
    cut_off: float  # share of the motion that the recording cuts off
    across: tuple[ComplexArray, Float] | None  # what acts along the other axis over the force, and its sigma
    struck: bool

    @property
    def line_noise(self) -> float:
        """Power of the noise of the force in a line of the spectrum."""
        return self.force.noise * self.force.record.time.size / self.force.record.rate

    @property
    def size(self) -> float:
        """Size that represents the force at all lines, N."""
        return float(np.sqrt(np.mean(np.abs(self.force.record.unit_force) ** 2)))


def measured_responses(recordings: Sequence[Recording], report: Report) -> PerturbationTest:
    """Responses to measured forces. What the noise of their channels does to the motion that they predict is left over
    by the local fits, and so in sigma."""
    driven = []
    for record in recordings:
        struck = blows(record)
        force = reduce_measured(record, struck=bool(struck))
        for finding in blow_findings(record, struck):
            report(finding)
        found, cut_off = _forced(force, struck, report)
        across = force_across(force, found)
        driven.append(_Driven(force=force, found=found, cut_off=cut_off, across=across, struck=bool(struck)))
    tests = []
    while driven:
        first = driven.pop(0)
        partner = next((other for other in driven if _belong_together(first, other)), None)
        if partner is None:
            tests.append(_alone(first, report))
        else:
            driven.remove(partner)
            tests += _of_both(first, partner, report)
    return join(tests)


def _belong_together(one: _Driven, other: _Driven) -> bool:
    """True if one recording is shaken along x and one along y, at one speed, and either along both."""
    speeds = [each.force.record.shaft_speed or each.force.record.record.speed or 0.0 for each in (one, other)]
    planes = [each.force.record.record.planes for each in (one, other)]
    return (
        {one.force.direction, other.force.direction} == {"x", "y"}
        and not (one.across is None and other.across is None)
        and not (one.struck or other.struck)
        and one.force.across is not None
        and other.force.across is not None
        and planes[0] == planes[1]
        and bool(np.ptp(speeds) <= SPEED_TOLERANCE * max(speeds))
    )


def _alone(driven: _Driven, report: Report) -> PerturbationTest:
    """The test that one recording makes."""
    clear = _clear(driven, driven.found, driven.line_noise, report)
    test = _rows(driven, driven.found, clear, report)
    sigma = np.hypot(test.sigma, driven.cut_off * np.abs(test.response) / np.sqrt(2))
    test = replace(test, sigma=sigma)
    if driven.across is None:
        return test
    ratio, error = driven.across[0][clear], driven.across[1][clear]
    noise = np.tile(driven.size * error, len(test) // ratio.size)
    return replace(_with_across(test, driven, ratio), attributes={**test.attributes, FORCE_SIGMA: noise})


def _rows(driven: _Driven, found: LocalResponse, clear: Bool, report: Report) -> PerturbationTest:
    """Readings at clear lines, with their coherence."""
    record, reduced = driven.force.record.record, driven.force.record
    speed: Float | float = record.speed or 0.0
    if reduced.shaft_speed:
        speed = shaft_speed_at(reduced.without_orders(), found.frequency, found.width / (SMOOTH_DEGREE + 1))
    test = rows(
        record,
        readings(record, reduced.whirl, found, np.zeros(found.noise.shape)),
        clear,
        frequency=reduced.whirl * found.frequency,
        speed=speed,
        force_plane=record.force.plane if record.force else "",
        force=np.full(found.frequency.size, driven.size, dtype=complex),
        force_direction=driven.force.direction,
    )
    coherent = coherence(test, found, reduced, clear)
    report(coherence_note(test, coherent))
    return replace(test, attributes={**test.attributes, "coherence": coherent})


def _with_across(test: PerturbationTest, driven: _Driven, ratio: ComplexArray) -> PerturbationTest:
    """The test with what acts along the other axis at once, over the force, shape ``(L,)``."""
    newton = np.tile(driven.size * ratio, len(test) // ratio.size)
    acting = zip(test.force_plane.tolist(), newton.tolist(), strict=True)
    return replace(test, further_forces=records(((plane, force, driven.force.axis_across),) for plane, force in acting))


def _clear(driven: _Driven, found: LocalResponse, noise: float, report: Report) -> Bool:
    reduced = driven.force.record
    clear = clear_lines(reduced, found, 0, report) & clear_of_noise(found, reduced, noise)
    if not clear.any():
        raise ValueError(f"{reduced.record.name}: the measured force does not stand out of the noise of its channels")
    return clear


def _of_both(one: _Driven, other: _Driven, report: Report) -> list[PerturbationTest]:
    """The tests that two recordings make together, one of each, at lines that they share.

    Forces (columns of the inverse root of the covariance of both responses) are chosen so that the two tests err
    independently. They are nearly those that acted, and taken to be along the axes where they nearly are.
    """
    pair = sorted((one, other), key=lambda driven: driven.force.direction)
    spectra = []
    for driven in pair:
        reduced = driven.force.record.without_orders()
        own = reduced.spectra(np.ones(1, dtype=complex), reduced.orders())
        across = [reduced.spectrum(driven.force.across)] if driven.force.across is not None else []
        forces = [own.forces[0], *across] if driven.force.direction == "x" else [*across, own.forces[0]]
        spectra.append(replace(own, forces=np.array(forces), force_noise=driven.line_noise))
    bands = [driven.force.record.band for driven in pair]
    names = [driven.force.record.record for driven in pair]
    found = estimated(names, spectra, max(low for low, _ in bands), min(high for _, high in bands))
    acting = _independent_forces(found.covariance)
    tests = []
    each = [
        replace(
            found,
            response=np.einsum("jl,jpl->pl", acting[:, k], found.response)[None],
            sigma=found.noise[None]
            * np.sqrt(np.einsum("jl,jml,ml->l", acting[:, k], found.covariance, acting[:, k].conj()).real / 2),
        )
        for k in (0, 1)
    ]
    clear = np.logical_and(
        *[_clear(driven, part, driven.line_noise, report) for driven, part in zip(pair, each, strict=True)]
    )
    for k, (driven, part) in enumerate(zip(pair, each, strict=True)):
        test = _rows(driven, part, clear, report)
        tests.append(_with_across(test, driven, acting[1 - k, k, clear]) if acting[1 - k, k].any() else test)
    return tests


def _independent_forces(covariance: ComplexArray) -> ComplexArray:
    """Forces along x and y of two tests, over that along the test's own axis, shape ``(2, 2, L)``: columns are tests.

    With C the covariance of the responses, tests of forces ``conj(C^-1/2)`` err independently.
    """
    values, vectors = np.linalg.eigh(covariance.transpose(2, 0, 1).conj())
    root = (vectors / np.sqrt(values)[:, None, :]) @ vectors.conj().swapaxes(1, 2)
    forces = np.asarray((root / np.einsum("ljj->lj", root)[:, None, :]).transpose(1, 2, 0))
    nearly = 0.05  # of a force: tests along the axes then err independently to a tenth
    small = np.median(np.abs(forces[[1, 0], [0, 1]])) < nearly
    return np.repeat(np.eye(2, dtype=complex)[:, :, None], forces.shape[2], axis=2) if small else forces


def _forced(driven: ReducedForce, struck: Sequence[Blow], report: Report) -> tuple[LocalResponse, float]:
    """Responses to a force that was measured, that of the other axis the last, and the share of the motion that the
    recording cuts off.

    To one blow a smooth response and a smooth transient look alike. Where the rotor rests before the blows and after
    them there is no transient, and the shaft's orders are those of the time when it is quiet.
    """
    reduced, unit = driven.record, np.ones(1, dtype=complex)
    record = reduced.record
    noise = driven.noise * reduced.time.size / reduced.rate  # of a line of the spectrum

    def noisy(spectra: RecordSpectra) -> RecordSpectra:
        more = [] if driven.across is None else [reduced.spectrum(driven.across)]
        return replace(spectra, force_noise=noise, outputs=np.array([*spectra.outputs, *more]))

    quiet, left_out = rest_of(reduced, struck) if struck else (np.zeros(1, dtype=bool), 0.0)
    many_blows = 3  # blows whose spectrum is not smooth, so that it is distinguished from a transient
    if not struck or (quiet.mean() < QUIET_SHARE and len(struck) >= many_blows):
        spectra = reduced.without_orders().spectra(unit, reduced.orders())
        return estimated([record], [noisy(spectra)], *reduced.band), 0.0
    if quiet.mean() < QUIET_SHARE and reduced.shaft_angle is not None:
        raise ValueError(
            f"{record.name}: the rotor is quiet in {quiet.mean():.0%} of the {significant(np.ptp(reduced.time), 3)} s "
            "between the first mark of the shaft and the last, too little to tell the shaft's own orders from the "
            "blow: record some turns before it, and until the rotor rests"
        )
    calm = reduced.without_orders(quiet).spectra(unit, [])
    found = estimated([record], [noisy(calm)], *reduced.band, transient=False)
    if left_out:
        words = (
            f"{record.name}: the rotor moves when the recording begins or ends, by {significant(left_out, 2)} of "
            "its motion after the blow; errors are wider by that share of each response. Record some turns before "
            "the blow, and until the rotor rests."
        )
        report(Finding("warning", "moving-at-ends", words))
    return found, left_out
