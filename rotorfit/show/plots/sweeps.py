"""Sweeps of a fit by what moves the curve: parameter group, rotative speed and, of nonlinear fluids, the force."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rotorfit.base.array_types import ComplexArray, Float, Index
from rotorfit.base.digits import significant
from rotorfit.estimators.blocks.nonlinear import OrbitResponses
from rotorfit.estimators.blocks.observations import Responses
from rotorfit.estimators.blocks.set_speeds import once_per_turn
from rotorfit.identify.fitting.result import FitResult
from rotorfit.identify.fitting.summary import natural
from rotorfit.identify.uncertainty.predict import rotor_changes
from rotorfit.lab.data.experiments import PerturbationTest
from rotorfit.lab.observing.circular import observe
from rotorfit.lab.observing.measured_stiffness import IsotropicPlanes
from rotorfit.models import RotorModel
from rotorfit.show.plots.journal import group_label, half_width
from rotorfit.show.plots.style import MARKERS, PLAIN, Sheet, colour_of, literal

_SWEPT_SPEED = -1.0  # speed of a key whose speed is swept


@dataclass(frozen=True, kw_only=True)
class SweepCondition:
    """One curve of every panel and one entry of the legend; lists of them are sorted by number."""

    group: int  # parameter group
    speed: float  # rad/s, NaN where it is swept
    name: str  # words for the legend
    colour: str  # of its points and lines
    marker: str  # of its points


@dataclass(frozen=True, eq=False, kw_only=True)
class Sweeps:
    """The lines of one block."""

    number: int  # of the block in the fit's problem
    responses: Responses  # observations, with the fit's errors of phase and calibration taken out
    block: Responses | OrbitResponses  # the block that predicts them
    condition: Index  # place of each line's condition in the list of all, shape ``(L,)``


@dataclass(frozen=True, kw_only=True)
class _Key:
    group: int
    speed: float
    level: str


def sweeps(fit: FitResult, sheet: Sheet) -> tuple[list[SweepCondition], list[Sweeps]]:
    """Conditions, and the blocks with responses to circular forces or imposed orbits."""
    found: list[tuple[int, Responses, Responses | OrbitResponses]] = []
    theta = fit.thetas
    for number, (given, predicted) in enumerate(zip(fit.problem.blocks, fit.problem.predict(fit.x), strict=True)):
        block = given.uncorrelated
        base = block.responses
        if base is None or not isinstance(block, Responses | OrbitResponses) or not base.frequency.any():
            continue
        plain = block.predict(theta)
        off = np.divide(predicted, plain, out=np.ones_like(predicted), where=plain != 0)
        clean = replace(base, measured=base.measured / off, sigma=base.sigma / np.abs(off))
        found.append((number, clean, block))
    if not found:
        raise ValueError("this fit has no responses to a circular force to plot")
    keyed = _keys([clean for _, clean, _ in found], nonlinear=fit.model.eccentricity_dependent)
    distinct = sorted(
        {key for keys in keyed for key in keys},
        key=lambda k: (natural(group_label(fit, k.group)), k.speed, natural(k.level)),
    )
    conditions = _conditions(sheet, distinct, lambda group: group_label(fit, group))
    parts = []
    for (number, clean, block), keys in zip(found, keyed, strict=True):
        places = np.array([distinct.index(key) for key in keys], dtype=np.intp)
        parts.append(Sweeps(number=number, responses=clean, block=block, condition=places))
    return conditions, parts


def _conditions(sheet: Sheet, keys: Sequence[_Key], label: Callable[[int], str]) -> list[SweepCondition]:
    """Conditions in the order of their keys; ``label`` has words for a parameter group."""
    conditions = []
    for i, (key, name) in enumerate(zip(keys, _names(sheet, keys, label), strict=True)):
        speed, colour = math.nan if key.speed == _SWEPT_SPEED else key.speed, colour_of(i, len(keys))
        marker = MARKERS[i % len(MARKERS)]
        conditions.append(SweepCondition(group=key.group, speed=speed, name=name, colour=colour, marker=marker))
    return conditions


def _keys(blocks: Sequence[Responses], *, nonlinear: bool) -> list[list[_Key]]:
    """Keys that distinguish the lines of each block; equal speeds of several blocks have equal keys."""
    most_steady = 12  # distinct speeds of a block beyond which the speed is swept, as in a start-up
    # Few dwell speeds are one curve as a start-up is, if all lines are at once-per-turn frequency.
    at_1x = [bool(once_per_turn(base.frequency, base.speed).all()) for base in blocks]
    swept = [np.unique(base.set_speed).size > most_steady or one for base, one in zip(blocks, at_1x, strict=True)]
    same_speed = 2e-3  # relative difference of speeds that were meant to be the same
    steady = _rounded(
        np.concatenate([np.zeros(0) if s else b.set_speed for s, b in zip(swept, blocks, strict=True)]), same_speed
    )
    found, begin = [], 0
    for base, is_swept in zip(blocks, swept, strict=True):
        count = base.speed.size
        speeds = np.full(count, _SWEPT_SPEED) if is_swept else steady[begin : begin + count]
        begin += 0 if is_swept else count
        by_force = nonlinear and not base.imposed
        names = levels(np.abs(base.force).max(axis=1), base.frequency) if by_force else [""] * count
        keys = zip(base.group.tolist(), speeds.tolist(), names, strict=True)
        found.append([_Key(group=group, speed=speed, level=level) for group, speed, level in keys])
    return found


def levels(force: Float, frequency: Float) -> list[str]:
    """Size of each line's force in words: of an unbalance m r where that takes fewer values than the force itself."""
    same_level = 0.03  # relative difference of forces that were meant to be the same
    by_force = _rounded(force, same_level)
    by_unbalance = _rounded(force / np.maximum(frequency**2, 1e-12), same_level)
    if np.unique(by_unbalance).size < np.unique(by_force).size:
        return [f"{significant(value * 1e6, 3)} g mm" for value in by_unbalance]
    return [f"{significant(value, 3)} N" for value in by_force]


def _rounded(values: Float, tolerance: float) -> Float:
    """Values with those that differ by little replaced by their mean."""
    if not values.size:
        return values
    order = np.argsort(values)
    ordered = values[order]
    new = np.diff(ordered, prepend=ordered[:1]) > tolerance * np.abs(ordered)
    cluster = np.cumsum(new)
    means = np.bincount(cluster, weights=ordered) / np.bincount(cluster)
    out = np.empty_like(values)
    out[order] = means[cluster]
    return out


def _names(sheet: Sheet, keys: Sequence[_Key], label: Callable[[int], str]) -> list[str]:
    """Words for the legend: speed, force, and the group where these do not tell it."""
    several = len({(k.speed, k.level) for k in keys}) < len(keys)
    found = []
    for k in keys:
        speed = "synchronous" if k.speed == _SWEPT_SPEED else sheet.rate_words(k.speed)
        parts = (speed, k.level, label(k.group) if several else "")
        found.append(literal(", ".join(filter(None, parts))))
    return found


@dataclass(frozen=True, eq=False, kw_only=True)
class SweepCurve:
    """One probe's response to one force in one condition and one direction of whirl, frequencies ascending."""

    coordinate: int  # places in the model's coordinates
    force_plane: int  # places in the model's coordinates; of forces at several planes see `forced_planes`
    condition: SweepCondition  # what it was measured in
    block: Index  # block of the fit's problem that each reading is in
    reading: Index  # place of each reading in its block
    frequency: Float  # of the readings, rad/s
    measured: ComplexArray  # response over force (or force over imposed displacement)
    uncertainty: Float  # sigma of the readings over their size by the fit
    whitened: ComplexArray  # residual over noise
    signed: bool  # values are of x + jy at the signed frequency, not of a probe
    imposed: bool  # values are forces over an imposed displacement
    fine: Float  # frequencies of the fitted line; before a fit of the readings
    fitted: ComplexArray  # values of the fitted line; before a fit the readings
    band: tuple[Float, Float]  # half-width of the fitted line's 95 % band

    @property
    def seen(self) -> ComplexArray:
        """Readings over force as a probe shows them."""
        return as_probe(self.measured, self.frequency, self.signed)

    @property
    def line_seen(self) -> ComplexArray:
        """The fitted line as a probe shows it."""
        return as_probe(self.fitted, self.fine, self.signed)


def as_probe(values: ComplexArray, frequency: Float, signed: bool) -> ComplexArray:
    """Responses over force as the phasors of a probe and a force along it, whose phase is the lead in time.

    Of a motion in x + jy that turns backward, with the signed frequency, they are the conjugates.
    """
    return np.where(signed & (frequency < 0), values.conj(), values)


def curves(fit: FitResult, sheet: Sheet = PLAIN) -> tuple[Sequence[SweepCondition], Sequence[SweepCurve]]:
    """Conditions, and every measured and fitted response."""
    return _curves_of(fit, replace(sheet, ax=None))


@lru_cache(maxsize=1)  # three figures of a report show them
def _curves_of(fit: FitResult, sheet: Sheet) -> tuple[Sequence[SweepCondition], Sequence[SweepCurve]]:
    """Conditions named in the units of a sheet, and the responses."""
    conditions, parts = sweeps(fit, sheet)
    return tuple(conditions), tuple(curve for part in parts for curve in _curves(fit, conditions, part))


def joined(found: Sequence[SweepCurve]) -> list[SweepCurve]:
    """One curve for each probe, force and condition; its lines break between the sweeps that it is made of."""
    parts: dict[tuple[int, int, SweepCondition], list[SweepCurve]] = {}
    for curve in found:
        parts.setdefault((curve.coordinate, curve.force_plane, curve.condition), []).append(curve)

    def broken(lines: Sequence[NDArray[Any]]) -> NDArray[Any]:
        return np.concatenate([np.append(line, np.nan) for line in lines])[:-1]

    whole = []
    for same in parts.values():
        names = ("block", "reading", "frequency", "measured", "uncertainty", "whitened")
        joint: dict[str, Any] = {name: np.concatenate([getattr(c, name) for c in same]) for name in names}
        joint |= {name: broken([getattr(c, name) for c in same]) for name in ("fine", "fitted")}
        band = (broken([c.band[0] for c in same]), broken([c.band[1] for c in same]))
        whole.append(replace(same[0], band=band, **joint))
    return whole


MOST_PANELS = 9
"""Responses of which each has a panel on a page."""


def leading(
    model: RotorModel, found: Sequence[SweepCurve], *, every: bool
) -> tuple[Sequence[SweepCurve], tuple[str, ...]]:
    """Of more responses than a page shows those of planes to forces at themselves, and of planes in the fluid to all;
    and words on what is left out."""
    count = len({(c.coordinate, c.force_plane) for c in found})
    wet = {fluid.plane for fluid in getattr(model, "fluids", ())}
    first = [c for c in found if c.coordinate == c.force_plane or model.coordinates[c.coordinate].plane in wet]
    if every or count <= MOST_PANELS or not first:
        return found, ()
    drawn = len({(c.coordinate, c.force_plane) for c in first})
    return first, (f"{drawn} of {count} responses, those at forces and in the fluid; every=True draws all.",)


def measured_curves(test: PerturbationTest, sheet: Sheet) -> tuple[RotorModel, list[SweepCondition], list[SweepCurve]]:
    """Coordinates of a test, its conditions, and every measured response as a curve through the readings."""
    planes = tuple(dict.fromkeys((*test.planes, *test.force_planes)))
    tilts = sorted({p for p, d in zip(test.plane.tolist(), test.direction.tolist(), strict=True) if d.startswith("r")})
    model = IsotropicPlanes(planes, tilts)
    base = observe(model, test, np.zeros(len(test), dtype=np.intp))
    (keys,) = _keys([base], nonlinear=False)
    distinct = sorted(set(keys), key=lambda k: k.speed)
    conditions = _conditions(sheet, distinct, str)
    places = np.array([distinct.index(key) for key in keys], dtype=np.intp)
    return model, conditions, list(_measured(base, conditions, places))


def _curves(fit: FitResult, conditions: Sequence[SweepCondition], part: Sweeps) -> Iterator[SweepCurve]:
    base = part.responses
    predicted, by_theta = part.block.predict_jacobian(fit.thetas)
    by_causes = rotor_changes(fit, part.block)
    drive, share = _drive(base)
    for curve in _measured(base, conditions, part.condition):
        rows = curve.reading
        alike = base.beside is None and bool((share[rows] == share[rows[0]]).all())
        if isinstance(part.block, Responses) and not base.imposed and alike:
            fine, fitted, slope, moved = _fine(fit, part.block, rows)
        else:
            fine, fitted = curve.frequency, predicted[rows] / drive[rows]
            slope, moved = by_theta[rows] / drive[rows, None], by_causes[rows] / drive[rows, None]
        yield replace(
            curve,
            block=np.full(rows.size, part.number),
            uncertainty=base.sigma[rows] / np.abs(predicted[rows]),
            whitened=(predicted[rows] - base.measured[rows]) / base.sigma[rows],
            fine=fine,
            fitted=fitted,
            band=_band(fit, curve.condition.group, fitted, slope, moved),
        )


def _measured(base: Responses, conditions: Sequence[SweepCondition], condition: Index) -> Iterator[SweepCurve]:
    """Curves through the readings of a block, whose lines are in the conditions of those numbers."""
    w = base.frequency[base.line]
    drive, share = _drive(base)
    load = np.array([_load(base, row) for row in base.force])[base.line]
    at_several = load >= len(base.model.coordinates)
    _, direction = np.unique(np.where(at_several[:, None], share, 0), axis=0, return_inverse=True)
    keys = np.column_stack([base.coordinate, load, condition[base.line], w < 0, direction.reshape(-1)])
    for key in np.unique(keys[w != 0], axis=0):
        rows = np.flatnonzero((keys == key).all(axis=1))
        rows = rows[np.argsort(w[rows], kind="stable")]
        measured, none = base.measured[rows] / drive[rows], np.zeros(rows.size)
        yield SweepCurve(
            coordinate=int(key[0]),
            force_plane=int(key[1]),
            condition=conditions[int(key[2])],
            block=np.zeros(rows.size, dtype=np.intp),
            reading=rows,
            frequency=w[rows],
            measured=measured,
            uncertainty=base.sigma[rows] / np.abs(base.measured[rows]),
            whitened=none.astype(complex),
            signed=base.model.frame == "z",
            imposed=base.imposed,
            fine=w[rows],
            fitted=measured,
            band=(none, none),
        )


def _drive(base: Responses) -> tuple[ComplexArray, ComplexArray]:
    """The largest force of each reading, and all forces over it, which act at once."""
    plane = np.argmax(np.abs(base.force), axis=1)[base.line]
    drive = base.force[base.line, plane]
    return drive, np.round(base.force[base.line] / drive[:, None], 9)


def _load(base: Responses, force: ComplexArray) -> int:
    """Place of a line's force, or a number beyond the places for forces at several planes."""
    coordinates, largest = base.model.coordinates, int(np.argmax(np.abs(force)))
    places = np.flatnonzero(force).tolist()
    if len({coordinates[place].plane for place in places}) <= 1:
        return largest
    return len(coordinates) + sum(1 << place for place in places)


def forced_planes(model: RotorModel, force_plane: int) -> str:
    """Planes of the force of a curve, in words."""
    coordinates, beyond = model.coordinates, force_plane - len(model.coordinates)
    if beyond < 0:
        pressed = coordinates[force_plane]
        along = f" along {pressed.axis}" if pressed.axis in ("x", "y") else ""
        return f"force{along} at {pressed.plane}"
    planes = dict.fromkeys(c.plane for place, c in enumerate(coordinates) if beyond >> place & 1)
    return f"forces at {' and '.join(planes)}"


def _fine(fit: FitResult, block: Responses, rows: Index) -> tuple[Float, ComplexArray, ComplexArray, ComplexArray]:
    """Fitted response along a sweep and its derivatives by parameters and by causes of the rotor, on a grid fine enough
    for sharp resonances."""
    line = block.line[rows]
    w = block.frequency[line]
    points = 1200  # points of a fitted line
    fine = np.linspace(w[0], w[-1], points)
    force = block.force[line[0]]
    count = np.arange(points)
    grid = replace(
        block,
        speed=np.interp(fine, w, block.speed[line]),
        frequency=fine,
        force=np.tile(force, (points, 1)),
        group=np.full(points, block.group[line[0]]),
        line=count,
        coordinate=np.full(points, block.coordinate[rows[0]]),
        measured=np.zeros(points, dtype=complex),
        sigma=np.ones(points),
        label=np.zeros(points, dtype=np.intp),
        run=np.full(points, ""),
        derivative=None,
    )
    value, slope = grid.predict_jacobian(fit.thetas)
    drive = force[np.argmax(np.abs(force))]
    return fine, value / drive, slope / drive, rotor_changes(fit, grid) / drive


def _band(
    fit: FitResult, group: int, value: ComplexArray, slope: ComplexArray, by_causes: ComplexArray
) -> tuple[Float, Float]:
    """Half-widths for the logarithm of the amplitude and for the phase, by the delta method."""
    size = np.where(value != 0, value, np.inf)[:, None]
    by, moved = slope / size, by_causes / size
    return half_width(fit, group, by.real, moved.real), half_width(fit, group, by.imag, moved.imag)
