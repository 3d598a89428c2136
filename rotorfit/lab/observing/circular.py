"""From an experiment, as it was recorded, to observations in a model's coordinates."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rotorfit.base.array_types import COLLINEAR, RANK_TOLERANCE, Bool, ComplexArray, Float, Index
from rotorfit.base.digits import counted
from rotorfit.estimators.blocks.observations import Responses
from rotorfit.estimators.blocks.row_keys import combined, distinguished, in_order, numbers, rows_by
from rotorfit.estimators.noise.sweep_noise import estimate_noise
from rotorfit.lab.data.experiments import PerturbationTest
from rotorfit.lab.data.linear_force import directional, directional_noise, whirl_parts
from rotorfit.lab.observing.rows import check_planes
from rotorfit.models import RotorModel


def observe(model: RotorModel, experiment: PerturbationTest, group: Index) -> Responses:
    """Responses to forces in the model's coordinates, with their noise. Isotropic models see the component of
    each x/y pair in the direction of the force, and take a single probe's reading for that of a circular orbit. Under a
    force along an axis they see both components of each x/y pair, at +w and -w."""
    _check_finite(experiment)
    check_planes(model, experiment, experiment.planes, experiment.force_planes, forces="force planes")
    if model.frame != "z":
        other = sorted(set(experiment.category("direction").names) - {"x", "y"})
        if other:
            raise ValueError(
                f"{model.name} keeps x and y apart; readings in direction {', '.join(other)} do not fit it"
            )
    if model.frame != "z" or not experiment.linear.any():
        return _assembled(model, experiment, group)
    parts, origin = whirl_parts(experiment, _uncoupled(model, experiment))
    return _assembled(model, parts, group[origin[:, 0]])


def _uncoupled(model: RotorModel, test: PerturbationTest) -> Bool:
    """Rows at whose speed the model does not couple x with y: kappa at -w is the conjugate of that at w."""
    found = np.zeros(len(test), dtype=bool)
    if model.of_modes:  # a complex gain is the phase of a mode shape
        return ~found
    typical = np.array([q.scale if q.default is None else q.default for q in model.parameters])
    for speed in np.unique(test.speed[test.linear]).tolist():
        w = float(np.abs(test.frequency[test.speed == speed]).max())
        ahead, behind = model.dynamic_stiffness(typical, [w, -w], speed)
        found |= (test.speed == speed) & np.allclose(
            ahead, behind.conj(), rtol=0, atol=RANK_TOLERANCE * float(np.abs(ahead).max())
        )
    return found


def _check_finite(experiment: PerturbationTest) -> None:
    name = experiment.source or "experiment"
    columns = (experiment.response, experiment.force, experiment.frequency, experiment.speed)
    bad = ~np.logical_and.reduce([np.isfinite(column) for column in columns])
    if bad.any():
        raise ValueError(
            f"{name}: {counted(bad.sum(), 'reading')} not finite ({rows_in_words(bad)}); select others, for instance "
            "with test.select(...)"
        )
    bad = (experiment.sigma <= 0) | np.isinf(experiment.sigma)
    if bad.any():
        raise ValueError(
            f"{name}: the noise sigma must be positive and finite, or NaN if unknown ({rows_in_words(bad)})"
        )
    if not experiment.force.any():
        raise ValueError(
            f"{name}: every force is zero, so the responses say nothing of the rotor; check its column, or put "
            "a run without a weight together with those that have one (rf.join_runs, "
            "`rotorfit join REFERENCE TRIAL --out BOTH.csv`)"
        )
    still = experiment.force == 0
    if still.any():
        runs = ", ".join(dict.fromkeys(experiment.run[still].tolist()))
        raise ValueError(
            f"{name}: the force is zero in {counted(still.sum(), 'reading')} of {runs}. A reference run without a "
            "weight is subtracted where runs dwell at a few speeds, and from start-ups that are one test with it and "
            "pass the same speeds (rf.join_runs, `rotorfit join REFERENCE TRIAL --out BOTH.csv`); or repeat each "
            "weight at 180 degrees (eq. 20). Any other reading without a force is to be removed"
        )
    if experiment.response.all():
        return
    first, channel = experiment.alike("plane", "direction")
    alive = np.bincount(channel, weights=experiment.response != 0)
    for row, some in zip(first.tolist(), alive.tolist(), strict=True):
        if not some:
            raise ValueError(
                f"{name}: every reading of {experiment.plane[row]} {experiment.direction[row]} is zero: a probe that "
                "was not connected? Remove them, for instance with test.select(...)"
            )


def rows_in_words(bad: NDArray[np.bool_]) -> str:
    """The first rows concerned, counted from 1."""
    rows = ", ".join(str(row + 1) for row in np.flatnonzero(bad)[:8])
    return f"rows {rows}{', ...' if bad.sum() > 8 else ''}"


@dataclass(frozen=True, eq=False, kw_only=True)
class Places:
    """Which rows of a test make each reading in a model's coordinates, line by line."""

    first: Index  # first row of each line, shape ``(L,)``
    line: Index  # line of each reading, shape ``(R,)``
    coordinate: Index  # coordinate of each reading, shape ``(R,)``
    rows: Index  # its readings x, y and z, -1 where there is none, shape ``(R, 3)``; z is one that is taken as it is
    backward: NDArray[np.bool_]  # whether its force turns backward, shape ``(R,)``

    @classmethod
    def of(cls, model: RotorModel, test: PerturbationTest) -> Places:
        """Those of a test; models that keep x and y apart take each reading as it is."""
        size, apart = len(model.coordinates), model.frame != "z"
        first, line = test.lines_apart
        kind, number = test.alike("plane", "direction")
        names = [(str(test.plane[row]), str(test.direction[row])) for row in kind.tolist()]
        coordinates = [model.coordinate(p, d if apart else d[:-1] or "z") for p, d in names]
        probes = [2 if apart else "xyz".index(direction[-1]) for _, direction in names]
        cell = line * size + np.array(coordinates, dtype=np.intp)[number]
        rows = np.full(3 * first.size * size, -1, dtype=np.intp)
        rows[3 * cell + np.array(probes, dtype=np.intp)[number]] = np.arange(cell.size)
        read = np.zeros(first.size * size, dtype=bool)
        read[cell] = True
        line, coordinate = np.divmod(np.flatnonzero(read), size)
        backward = (test.frequency[first] < 0)[line]
        return cls(first=first, line=line, coordinate=coordinate, rows=rows.reshape(-1, 3)[read], backward=backward)


def _assembled(model: RotorModel, test: PerturbationTest, group: Index) -> Responses:
    places, (runs, run) = Places.of(model, test), test.category("run")
    first, line, coordinate = places.first, places.line, places.coordinate
    measured, wrong = directional(test.response, places.rows, places.backward)
    sigma, derivative = directional_noise(test.sigma, places.rows), test.derivative[places.rows.max(axis=1)]
    frequency, row = test.frequency[first], first[line]
    force = _forces(model, test, first)
    turn = _in_phase(force, frequency, test.set_speed[first], run[first])
    if turn is not None:
        force = force * turn[:, None]
        measured, wrong = measured * turn[line], wrong * turn[line].conj()
    channels = [c.plane if c.axis == "z" else str(c) for c in model.coordinates]
    begin, label = in_order(combined(run[row], coordinate))
    labels = tuple(f"{runs[run[row[i]]]} / {channels[coordinate[i]]}" for i in begin.tolist())
    block = Responses(
        model=model,
        speed=_speeds(test, first),
        frequency=frequency,
        force=force,
        group=group[first],
        line=line,
        coordinate=coordinate,
        measured=measured,
        sigma=sigma,
        label=label,
        labels=labels,
        run=test.run[row],
        sigma_given=not np.isnan(sigma).any(),
        force_noise=_force_noise(model, test, first) if test.force_sigma.any() else None,
        derivative=derivative if derivative.any() else None,
    )
    return block if block.sigma_given else with_noise(block, wrong, test.synchronous, _conditions(test)[row])


def with_noise(block: Responses, wrong: ComplexArray, synchronous: bool, condition: Index | None = None) -> Responses:
    """The block with its noise estimated where none was given, by each sensor's own quantity: there it is even."""
    seen = replace(block, measured=block.measured * block.rate)
    estimated = estimate_noise(seen, wrong * block.rate, synchronous, condition) / block.rate
    return replace(block, sigma=np.where(np.isnan(block.sigma), estimated, block.sigma))


def _in_phase(force: ComplexArray, frequency: Float, speed: Float, run: Index) -> ComplexArray | None:
    """Factors that give forces of a sweep the phase of its first line, ``(L,)``; None where they have it. A stepped
    sine starts anew at each line, and only readings whose forces agree in phase tell noise and misfit apart."""
    plane, size = np.argmax(np.abs(force), axis=1), np.abs(force).max(axis=1, initial=0.0)
    drive = force[np.arange(size.size), plane]
    phasor = np.divide(drive, size, out=np.ones_like(drive), where=size > 0)
    first, sweep = in_order(combined(run, numbers(speed), (frequency < 0).astype(np.intp), plane))
    turn = phasor[first][sweep] * phasor.conj()
    return turn if (np.abs(turn - 1) > COLLINEAR).any() else None


def _speeds(test: PerturbationTest, first: Index) -> Float:
    """Speed of each line: the mean of those that were logged with its readings, rad/s, shape ``(L,)``."""
    speed = test.speed[first]
    if np.array_equal(test.speed, test.set_speed):
        return speed
    _, line = test.lines_apart
    return np.asarray(speed + np.bincount(line, test.speed - speed[line]) / np.bincount(line))


def _forces(model: RotorModel, test: PerturbationTest, first: Index) -> ComplexArray:
    """Generalised force of each line, shape ``(L, n)``: the sum over the forces that act at once."""
    frequency, force = test.frequency[first], test.force[first]
    (planes, plane_number), (axes, axis_number) = test.category("force_plane"), test.category("force_direction")
    kind = plane_number[first] * len(axes) + axis_number[first]
    found = np.zeros((first.size, len(model.coordinates)), dtype=complex)
    for at in rows_by(kind):
        plane, axis = divmod(int(kind[at[0]]), len(axes))
        found[at] = model.force_vector(planes[plane], frequency[at], force[at], axes[axis])
    for line in np.flatnonzero(test.several[first]).tolist():
        w = frequency[line : line + 1]
        for plane, further, axis in test.further_forces[first[line]]:
            found[line] += model.force_vector(plane, w, np.array([further]), axis)[0]
    return found


def _force_noise(model: RotorModel, test: PerturbationTest, first: Index) -> ComplexArray:
    """Covariance of each line's measured forces, of either part, shape ``(L, n, n)``."""
    sigma = test.force_sigma[first]
    found = np.zeros((first.size, len(model.coordinates), len(model.coordinates)), dtype=complex)
    for line, row in enumerate(first.tolist()):
        for plane, _, axis in test.acting(row):
            share = model.force_vector(plane, test.frequency[row : row + 1], np.array([sigma[line]]), axis)[0]
            found[line] += np.outer(share, share.conj())
    return found


def _conditions(test: PerturbationTest) -> Index:
    """Number of the conditions of each row: attributes that one run has one value of, the number of a repeat aside."""
    run, codes = test.category("run").number, [np.zeros(len(test), dtype=np.intp)]
    for name, values in test.attributes.items():
        if name.startswith("repeat"):
            continue
        given = np.asarray(values)
        number = numbers(given if given.dtype.kind in "Ufiub" else given.astype(str))
        if distinguished(run, number)[0].size == int(run.max()) + 1:
            codes.append(number)
    return in_order(combined(*codes))[1]
