"""From an experiment, as it was recorded, to observations in a model's coordinates."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rotorfit.data.experiments import DisplacementTest, Experiment, PerturbationTest
from rotorfit.data.kept import kept
from rotorfit.data.linear_force import whirl_parts
from rotorfit.estimators.blocks.observations import Responses
from rotorfit.estimators.blocks.row_keys import combined, in_order, numbers
from rotorfit.estimators.noise.sweep_noise import estimate_noise
from rotorfit.models import RotorModel
from rotorfit.models.array_types import ComplexArray, Float, Index
from rotorfit.observing.refusals import check_planes

_MOST_KEPT = 100_000
"""Rows up to which the observations of an experiment are kept for the next fit."""


def observe(model: RotorModel, experiment: Experiment, group: Index) -> Responses:
    """Observations of an experiment in the model's coordinates, with their noise.

    Isotropic models see the component of each x/y pair in the direction of the force, and take a single probe's reading
    for that of a circular orbit. Under a force along an axis they see both components of each x/y pair, at +w and -w.

    Args:
        model: the rotor.
        experiment: what was measured.
        group: parameter group of each row.

    Raises:
        ValueError: planes or directions that the model does not have, or readings that are not finite.
    """
    if not isinstance(experiment, DisplacementTest | PerturbationTest):
        raise TypeError(f"{type(experiment).__name__} has no responses")
    if len(experiment) > _MOST_KEPT:
        return _observe(model, experiment, group)
    notes, key = kept(experiment), _key(model, group)
    if key not in notes:
        keep_observed(experiment, _observe(model, experiment, group), group)
    found: Responses = notes[key]
    if found.model is not model:
        found = notes[key] = replace(found, model=model)
    return found


def keep_observed(experiment: Experiment, block: Responses, group: Index) -> None:
    """Keep the observations of an experiment for whoever observes it next; arguments as for :func:`observe`."""
    for values in (block.measured, block.sigma, block.force):
        values.flags.writeable = False
    kept(experiment)[_key(block.model, group)] = block


def _key(model: RotorModel, group: Index) -> tuple[Any, ...]:
    return "responses", model.frame, model.coordinates, model.planes, group.tobytes()


def _observe(model: RotorModel, experiment: DisplacementTest | PerturbationTest, group: Index) -> Responses:
    if isinstance(experiment, DisplacementTest):
        return _observe_displacement(model, experiment, group)
    _check_finite(experiment)
    check_planes(model, experiment, forces="force planes")
    if model.frame != "z":
        return _observe_xy(model, experiment, group)
    parts, origin = whirl_parts(experiment)
    return _observe_isotropic(model, parts, group[origin[:, 0]])


def _check_finite(experiment: PerturbationTest) -> None:
    name = experiment.source or "experiment"
    columns = (experiment.response, experiment.force, experiment.frequency, experiment.speed)
    bad = ~np.logical_and.reduce([np.isfinite(column) for column in columns])
    if bad.any():
        raise ValueError(
            f"{name}: {bad.sum()} readings are not finite ({_places(bad)}); remove them, for instance with "
            "test.select(...)"
        )
    bad = (experiment.sigma <= 0) | np.isinf(experiment.sigma)
    if bad.any():
        raise ValueError(f"{name}: the noise sigma must be positive and finite, or NaN if unknown ({_places(bad)})")
    if not experiment.force.any():
        raise ValueError(f"{name}: every force is zero, so the responses say nothing of the rotor; check its column")
    still = experiment.force == 0
    if still.any():
        runs = ", ".join(dict.fromkeys(experiment.run[still].tolist()))
        raise ValueError(
            f"{name}: the force is zero in {still.sum()} readings of {runs}. A reference run without a weight is "
            "subtracted where runs dwell at a few speeds; from start-ups subtract it first and give the differences, "
            "or repeat each weight at 180 degrees (eq. 20). Any other reading without a force is to be removed"
        )
    if experiment.response.all():
        return
    first, channel = in_order(combined(numbers(experiment.plane), numbers(experiment.direction)))
    alive = np.bincount(channel, weights=experiment.response != 0)
    for row, some in zip(first.tolist(), alive.tolist(), strict=True):
        if not some:
            raise ValueError(
                f"{name}: every reading of {experiment.plane[row]} {experiment.direction[row]} is zero: a probe that "
                "was not connected? Remove them, for instance with test.select(...)"
            )


def _places(bad: NDArray[np.bool_]) -> str:
    """The first rows concerned, counted from 1."""
    rows = ", ".join(str(row + 1) for row in np.flatnonzero(bad)[:8])
    return f"rows {rows}{', ...' if bad.sum() > 8 else ''}"


def _lines(experiment: PerturbationTest, coordinate: Index, slot: Index) -> tuple[Index, Index]:
    """Line of each row, and first row of each line; repeats of a reading within a run go to lines of their own."""
    columns = (
        experiment.run,
        experiment.speed,
        experiment.frequency,
        experiment.force_plane,
        experiment.force.real,
        experiment.force.imag,
        experiment.force_direction,
    )
    first, line = in_order(combined(*[numbers(column) for column in columns]))
    reading = combined(line, coordinate, slot)
    if not reading.size or np.bincount(reading).max() == 1:
        return line, first
    _, same = in_order(reading)
    order = np.argsort(same, kind="stable")
    starts = np.r_[0, np.flatnonzero(np.diff(same[order])) + 1]
    occurrence = np.empty(same.size, dtype=np.intp)
    occurrence[order] = np.arange(same.size) - np.repeat(starts, np.diff(np.r_[starts, same.size]))
    first, line = in_order(combined(occurrence, line))
    return line, first


def lines_of(model: RotorModel, test: PerturbationTest) -> Index:
    """First row of each line of a test that holds readings of one direction only, in the order of its lines."""
    coordinate = _by_kind(test, lambda plane, direction: model.coordinate(plane, direction[:-1] or "z"))
    return _lines(test, coordinate, np.zeros(len(test), dtype=np.intp))[1]


@dataclass(frozen=True, eq=False, kw_only=True)
class Places:
    """Where the rows of a test stand in an isotropic model's coordinates.

    Attributes:
        size: number of coordinates.
        line, coordinate, slot: line, coordinate and probe (x, y or z) of each row, shape ``(N,)``.
        first: first row of each line, shape ``(L,)``.
        frequency: rad/s of each line, shape ``(L,)``.
    """

    size: int
    line: Index
    coordinate: Index
    slot: Index
    first: Index
    frequency: Float

    @classmethod
    def of(cls, model: RotorModel, test: PerturbationTest) -> Places:
        """Those of a test."""
        places = _by_kind(
            test, lambda plane, direction: (model.coordinate(plane, direction[:-1] or "z"), "xyz".index(direction[-1]))
        )
        coordinate, slot = places.T
        line, first = _lines(test, coordinate, slot)
        return cls(
            size=len(model.coordinates), line=line, coordinate=coordinate, slot=slot, first=first,
            frequency=test.frequency[first],
        )  # fmt: skip

    def directional(self, response: ComplexArray, sigma: Float) -> tuple[ComplexArray, ComplexArray, Float]:
        """What :func:`directional` answers for each line and coordinate, shape ``(..., L, n)``.

        Args:
            response, sigma: readings and their noise in the order of the rows, shape ``(..., N)``.
        """
        shape = (*response.shape[:-1], self.first.size, self.size, 3)
        values, sigmas = np.full(shape, np.nan, dtype=complex), np.full(shape, np.nan)
        values[..., self.line, self.coordinate, self.slot] = response
        sigmas[..., self.line, self.coordinate, self.slot] = sigma
        return directional(values, sigmas, self.frequency[:, None])


def _observe_isotropic(model: RotorModel, test: PerturbationTest, group: Index) -> Responses:
    places = Places.of(model, test)
    right, wrong, sigma = places.directional(test.response, test.sigma)
    readings = np.argwhere(np.isfinite(right))
    return _assemble(
        model,
        test,
        group[places.first],
        places.first,
        test.speed[places.first],
        places.frequency,
        readings,
        right[tuple(readings.T)],
        sigma[tuple(readings.T)],
        wrong[tuple(readings.T)],
        [str(c) if c.axis != "z" else c.plane for c in model.coordinates],
    )


def directional(values: ComplexArray, sigmas: Float, frequency: Float) -> tuple[ComplexArray, ComplexArray, Float]:
    """Complex amplitude in the direction of the force, and in the other one, from x, y and z readings.

    Args:
        values, sigmas: readings and noise in x, y, z, shape ``(..., 3)``, NaN where not measured.
        frequency: signed frequency, rad/s, broadcasting with ``values[..., 0]``.

    Returns:
        amplitude relative to ``exp(j w t)``, the wrong-direction amplitude (NaN without an x/y pair) and sigma.
    """
    forward = np.broadcast_to(frequency >= 0, values.shape[:-1])
    x, y, z = np.moveaxis(values, -1, 0)
    sx, sy, sz = np.moveaxis(sigmas, -1, 0)
    plus, minus = (x + 1j * y) / 2, np.conj(x - 1j * y) / 2
    right, wrong = np.where(forward, plus, minus), np.where(forward, np.conj(minus), np.conj(plus))
    sigma = np.sqrt(sx**2 + sy**2) / 2
    alone_x, alone_y = np.where(forward, x, x.conj()), np.where(forward, 1j * y, 1j * y.conj())
    for value, error in ((alone_x, sx), (alone_y, sy), (z, sz)):
        gap = np.isnan(right)
        right, sigma = np.where(gap, value, right), np.where(gap, error, sigma)
    return right, wrong, sigma


def _by_kind(test: PerturbationTest | DisplacementTest, number: Callable[[str, str], int | tuple[int, int]]) -> Index:
    """A number, or two, for each row that its plane and its direction tell."""
    direction = test.direction if isinstance(test, PerturbationTest) else np.full(len(test), "z")
    first, kind = in_order(combined(numbers(test.plane), numbers(direction)))
    pairs = zip(test.plane[first].tolist(), direction[first].tolist(), strict=True)
    return np.array([number(*pair) for pair in pairs], dtype=np.intp)[kind]


def _observe_xy(model: RotorModel, test: PerturbationTest, group: Index) -> Responses:
    other = sorted(set(test.direction.tolist()) - {"x", "y"})
    if other:
        raise ValueError(f"{model.name} keeps x and y apart; readings in direction {', '.join(other)} do not fit it")
    coordinate = _by_kind(test, model.coordinate)
    line, first = _lines(test, coordinate, np.zeros(len(test), dtype=np.intp))
    order = np.lexsort([coordinate, line])
    readings = np.column_stack([line, coordinate])[order]
    nothing = np.full(order.size, np.nan, dtype=complex)
    return _assemble(
        model,
        test,
        group[first],
        first,
        test.speed[first],
        test.frequency[first],
        readings,
        test.response[order],
        test.sigma[order],
        nothing,
        [str(c) for c in model.coordinates],
    )


def _assemble(
    model: RotorModel,
    test: PerturbationTest,
    group: Index,
    first: Index,
    speed: Float,
    frequency: Float,
    readings: Index,
    measured: ComplexArray,
    sigma: Float,
    wrong: ComplexArray,
    channel_names: Sequence[str],
) -> Responses:
    force = np.zeros((first.size, len(model.coordinates)), dtype=complex)
    planes = test.force_plane[first]
    along = test.force_direction[first]
    begin, kind = in_order(combined(numbers(planes), numbers(along)))
    for number, start in enumerate(begin.tolist()):
        at, plane, axis = kind == number, str(planes[start]), str(along[start])
        force[at] = model.force_vector(plane, frequency[at], test.force[first][at], axis)
    line, coordinate = readings[:, 0], readings[:, 1]
    run = test.run[first][line]
    begin, label = in_order(combined(numbers(run), coordinate))
    labels = tuple(f"{run[i]} / {channel_names[coordinate[i]]}" for i in begin.tolist())
    gaps = np.isnan(sigma)
    block = Responses(
        model=model,
        speed=speed,
        frequency=frequency,
        force=force,
        group=group,
        line=line,
        coordinate=coordinate,
        measured=measured,
        sigma=sigma,
        label=label,
        labels=labels,
        run=run,
        told=not gaps.any(),
    )
    if gaps.any():
        sigma[gaps] = estimate_noise(block, wrong, test.synchronous, _conditions(test)[first][line])[gaps]
    return block


def _conditions(test: PerturbationTest) -> Index:
    """Number of the conditions of each row: attributes that one run has one value of, the number of a repeat aside."""
    run, codes = numbers(test.run), [np.zeros(len(test), dtype=np.intp)]
    for name, values in test.attributes.items():
        if name.startswith("repeat"):
            continue
        told = np.asarray(values)
        number = numbers(told if told.dtype.kind in "Ufiub" else told.astype(str))
        if in_order(combined(run, number))[0].size == int(run.max()) + 1:
            codes.append(number)
    return in_order(combined(*codes))[1]


def _observe_displacement(model: RotorModel, test: DisplacementTest, group: Index) -> Responses:
    if model.frame != "z":
        raise ValueError(f"{model.name} keeps x and y apart; an imposed circular orbit needs an isotropic model")
    unknown = set(test.planes) - set(model.planes)
    if unknown:
        raise ValueError(
            f"{test.source or 'experiment'} has planes {', '.join(test.planes)}, the model {model.name} has "
            f"{', '.join(model.planes)}. Map names with {type(model).__name__}(planes=(...)) or --planes"
        )
    count = len(test)
    coordinate = _by_kind(test, model.coordinate)
    values = np.stack([test.force_x, test.force_y, np.full(count, np.nan, dtype=complex)], axis=-1)
    sigmas = np.stack([test.sigma, test.sigma, np.full(count, np.nan)], axis=-1)
    right, wrong, sigma = directional(values, sigmas, test.frequency)
    if not np.isfinite(right).all():
        raise ValueError(f"{test.source or 'experiment'}: forces are not all finite")
    imposed = np.zeros((count, len(model.coordinates)), dtype=complex)
    imposed[np.arange(count), coordinate] = np.where(test.frequency < 0, test.displacement.conj(), test.displacement)
    names = [f"{r} / force at {p}" for r, p in zip(test.run.tolist(), test.plane.tolist(), strict=True)]
    labels = tuple(dict.fromkeys(names))
    label = np.array([labels.index(name) for name in names], dtype=np.intp)
    block = Responses(
        model=model,
        speed=test.speed,
        frequency=test.frequency,
        force=imposed,
        group=group,
        line=np.arange(count),
        coordinate=coordinate,
        measured=right,
        sigma=sigma,
        label=label,
        labels=labels,
        run=test.run,
        imposed=True,
        told=not np.isnan(sigma).any(),
    )
    gaps = np.isnan(sigma)
    if gaps.any():
        sigma[gaps] = estimate_noise(block, wrong, False)[gaps]
    return block
