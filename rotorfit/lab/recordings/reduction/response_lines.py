"""Lines at which a recording gives responses: driven enough, apart from orders of the shaft; a row a probe for each."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from rotorfit.base.array_types import Bool, ComplexArray, Float
from rotorfit.base.digits import significant
from rotorfit.estimators.signals.local_response import LocalResponse, RecordSpectra, local_response
from rotorfit.lab.data.experiments import DERIVATIVES, MEASURED, PerturbationTest
from rotorfit.lab.data.findings import Finding
from rotorfit.lab.data.from_arrays import perturbation_test
from rotorfit.lab.recordings.recording import Recording
from rotorfit.lab.recordings.reduction.reduced_record import ReducedRecord
from rotorfit.lab.recordings.signals import said_of

Report = Callable[[Finding], None]

DRIVEN_INFORMATION_SHARE = 3e-3
"""Information of a line over that of the median line below which it is left out: 18 times the median error."""


def estimated(
    records: Sequence[Recording], spectra: Sequence[RecordSpectra], low: float, high: float, *, transient: bool = True
) -> LocalResponse:
    """Local responses; what is wrong is said with the names of the recordings."""
    with said_of(", ".join(record.name for record in records)):
        return local_response(spectra, low, high, transient=transient)


def clear_lines(reduced: ReducedRecord, found: LocalResponse, power: int, report: Report) -> Bool:
    """Lines where the force says enough and that no order of the shaft is too near to."""
    enough = driven(found, power)
    apart, seconds = apart_from_orders(reduced, found.frequency), float(np.ptp(reduced.time))
    say_lost(reduced.record, int(np.sum(enough & ~apart)), int(enough.sum()), seconds, report)
    return enough & apart


def say_lost(record: Recording, lost: int, count: int, seconds: float, report: Report) -> None:
    """Say how many lines an order of the shaft takes."""
    if lost:
        words = (
            f"{record.name}: {lost} of {count} lines left out: closer to "
            f"an order of the shaft than {significant(seconds, 3)} s can separate."
        )
        report(Finding("note", "lines-at-orders", words))


def driven(found: LocalResponse, power: int) -> Bool:
    """True if the force says enough at each node, its growth with a power of the frequency aside.

    Where a sweep begins and ends its spectrum falls off and cannot be distinguished from the transient. Chosen by the
    force, not by what was measured, so that nothing is selected.
    """
    information = (found.noise[0] / found.sigma[0, 0]) ** 2 / found.width / found.frequency**power
    return np.asarray(information > DRIVEN_INFORMATION_SHARE * np.median(information))


def time_at(reduced: ReducedRecord, frequency: Float) -> Float:
    """When the drive last passed each frequency, s; of the nearest one where it never did."""
    speed = reduced.drive_speed
    ascending = np.maximum.accumulate(speed) if speed[-1] >= speed[0] else np.minimum.accumulate(speed)[::-1]
    time = reduced.time if speed[-1] >= speed[0] else reduced.time[::-1]
    return time[np.clip(np.searchsorted(ascending, frequency), 0, time.size - 1)]


def shaft_speed_at(reduced: ReducedRecord, frequency: Float, width: Float) -> Float:
    """Rotative speed that the responses at some frequencies have, from a band of a width about each, rad/s; the record
    is one without the shaft's orders.

    A speed that is off its mean by v(t) presses on the motion z by what the fluid does to ``v(t) z(t)``: to first order
    the response is that at the mean speed and V/Z, the ratio of the spectra. Of a sweep that is the speed when it
    passed, a little later as the motion lags.
    """
    if reduced.shaft_angle is None:
        return np.full(frequency.size, reduced.shaft_speed)
    away = np.gradient(reduced.shaft_angle) * reduced.rate - reduced.shaft_speed
    cross, power = np.zeros((2, reduced.lines.size))
    for z in reduced.motion.values():
        for signal in (z, z.conj()):
            spectrum = reduced.spectrum(signal)
            cross += (reduced.spectrum(away * signal) * spectrum.conj()).real
            power += np.abs(spectrum) ** 2
    low, high = (np.searchsorted(reduced.lines, frequency + side * width / 2) for side in (-1, 1))
    shift, size = (
        total[np.minimum(high, power.size - 1)] - total[np.maximum(low - 1, 0)]
        for total in map(np.cumsum, (cross, power))
    )
    return np.asarray(reduced.shaft_speed + np.divide(shift, size, out=np.zeros_like(shift), where=size > 0))


def apart_from_orders(reduced: ReducedRecord, w: Float) -> Bool:
    """True if lines are further from every order than the record can separate, its own wander of speed added; of a
    shaft without a mark, whose speed is only said, than that speed may be off."""
    if not reduced.shaft_speed:
        return np.ones(w.size, dtype=bool)
    said_within = 0.01  # of a speed that is said, as of a motor that slips
    wander = said_within * reduced.shaft_speed
    if reduced.shaft_angle is not None:
        wander = float(np.std(np.diff(reduced.shaft_angle)) * reduced.rate)
    order = np.maximum(np.rint(w / reduced.shaft_speed), 1)
    resolution = 2 * np.pi / (reduced.time[-1] - reduced.time[0])
    return np.asarray(np.abs(w - order * reduced.shaft_speed) > resolution + order * wander)


ProbeResponses = tuple[str, str, ComplexArray, Float]
"""Plane and direction of a probe, its responses, output over force, shape ``(L,)``, and the standard deviation of their
real part and of their imaginary part."""


def readings(record: Recording, whirl: int, found: LocalResponse, disturbance: Float) -> list[ProbeResponses]:
    """Responses to the first force, probe by probe.

    The noise of x and of y is each one's own, widened together where the orbit's component in the direction of the
    force is noisier than independent probes would make it: what disturbs the force or the phase reference moves both.
    """
    response, variance = found.response[0], found.sigma[0] ** 2
    listed: list[ProbeResponses] = []
    row = 0
    for plane in record.planes:
        if plane not in record.pairs:
            sigma = np.sqrt(variance[row] + disturbance[row] ** 2 / 2)
            axis, factor = single_direction(record, plane, whirl)
            listed.append((plane, axis, factor * response[row], sigma))
            row += 1
            continue
        right = variance[row] + disturbance[row] ** 2 / 2
        widening = np.sqrt(np.maximum(1.0, right / ((variance[row + 2] + variance[row + 3]) / 4)))
        for at, axis in ((row + 2, "x"), (row + 3, "y")):
            listed.append((plane, axis, response[at], np.sqrt(variance[at]) * widening))
        row += 4
    return listed


def single_direction(record: Recording, plane: str, whirl: int) -> tuple[str, complex]:
    """Direction of a plane's only probe, and the factor that makes a phasor there of what it reads.

    A probe that sits neither along x nor along y gives the x of a circular orbit in the direction of the force; a fit
    takes any single probe so.
    """
    angle = record.rig.rotation * float(next(probe.angle or 0.0 for probe in record.probes if probe.plane == plane))
    for axis, place in (("x", 0.0), ("y", np.pi / 2)):
        if abs(np.sin(angle - place)) < 1e-3:
            return axis, complex(np.sign(np.cos(angle - place)))
    return "x", complex(np.exp(1j * whirl * angle))


def rows(
    record: Recording,
    probes: Sequence[ProbeResponses],
    kept: Bool,
    *,
    frequency: Float,
    speed: Float | float,
    force_plane: str,
    force: ComplexArray,
    force_direction: str = "circular",
    unit: Float | None = None,
) -> PerturbationTest:
    """A test of one run, with the name and the attributes of its recording."""
    reference = force if unit is None else unit.astype(complex)
    planes, directions, responses, sigmas = zip(*probes, strict=True)
    count = int(kept.sum())
    orders = [record.derivative(plane) for plane in planes]
    gains = [(1j * np.abs(frequency)) ** order for order in orders]  # of what a sensor reads of a motion of a metre
    said = {MEASURED: np.repeat([DERIVATIVES[order] for order in orders], count)} if any(orders) else {}

    def each(values: NDArray[np.generic]) -> NDArray[np.generic]:
        return np.tile(values[kept], len(probes))

    return perturbation_test(
        run=record.name,
        speed=each(np.broadcast_to(speed, frequency.shape)),
        frequency=each(frequency),
        force_plane=force_plane,
        force=each(force),
        plane=np.repeat(planes, count),
        direction=np.repeat(directions, count),
        response=np.concatenate([(each * reference / gain)[kept] for each, gain in zip(responses, gains, strict=True)]),
        sigma=np.concatenate(
            [(each * np.abs(reference / gain))[kept] for each, gain in zip(sigmas, gains, strict=True)]
        ),
        attributes={**{name: np.full(len(probes) * count, value) for name, value in record.attributes.items()}, **said},
        force_direction=force_direction,
        source=record.name,
    )
