"""Speeds of a test: constant ones that jitter, and synchronous start-ups whose runs are differenced (eq. 20)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from rotorfit.base.array_types import Bool, ComplexArray, Float, Text
from rotorfit.base.digits import significant
from rotorfit.base.units import RPM_PER_RAD_S
from rotorfit.estimators.blocks.row_keys import numbers
from rotorfit.estimators.blocks.set_speeds import SPEED_TOLERANCE, set_speeds
from rotorfit.estimators.noise.sweep_noise import noise_from_smoothness
from rotorfit.estimators.signals.ratios import ratio_through
from rotorfit.lab.data.experiments import PerturbationTest
from rotorfit.lab.data.rows import Experiment

Test = TypeVar("Test", bound=Experiment)

OPPOSITE_TOLERANCE = np.radians(5.0)
"""Forces are opposite when their phases differ by 180 degrees to this angle. The difference of the two force vectors is
exact for any angle; the tolerance only says which runs were meant as a pair."""

SAME_RATE = 1e-6
"""Speeds of two runs that agree to this fraction need no interpolation."""

LARGEST_GAP = 5.0
"""Readings are not interpolated across gaps longer than this many median steps."""


RUN_OUT_SHARE = "run_out_share"
"""Attribute of start-ups whose run-out was measured: its error, common to all readings of a run, over their noise."""
DIFFERENCED = "differenced"
"""Attribute that marks rows made by :func:`difference_synchronous` with 1, rows left as they were with 0."""


def group_speeds(speed: Float, run: Text, tolerance: float = SPEED_TOLERANCE) -> Float:
    """Set speeds that jitter about a constant to their mean, where nothing is measured line by line."""
    return set_speeds(speed, np.zeros(speed.size), numbers(run), tolerance)


def difference_synchronous(test: PerturbationTest) -> PerturbationTest:
    """Difference start-ups with the weight at opposite angles (eq. 20).

    Two runs with the force at the same plane and at opposite phase are subtracted reading by reading, responses and
    forces alike: ``r1 - r2 = H (F1 - F2)``, with ``F1 - F2 = 2 F1`` for equal weights. Whatever does not change between
    the runs drops out: residual unbalance, bow, run-out. Where the second run was not sampled at the speeds of the
    first one its response is interpolated there, by a ratio of polynomials and a cubic spline of what that leaves,
    never beyond its range and not across gaps. The noise of the difference is ``sqrt(sigma1^2 + sigma2^2)``. Numeric
    attributes are averaged over the pair.

    A start-up without an opposite one is compared with a reference run, one without a weight (force zero), if there is
    one, and of several with that of its own plane; several start-ups may be compared with the same, whose noise they
    then share. Start-ups under several weights at once are compared with a reference run only.

    Runs without a partner, and readings that only one run of a pair has, stay as they are; the attribute
    :data:`DIFFERENCED` tells them apart. Rows differenced before are left alone, so doing it twice changes nothing.

    Args:
        test: a synchronous test.

    Returns:
        the test with each pair ``a``, ``b`` of runs replaced by one run named ``a minus b``.

    Raises:
        ValueError: the test is not synchronous.

    Example:
        >>> twice = rf.read(rf.datasets.path("rk4_sync.csv"))
        >>> changed = rf.difference_synchronous(twice)
        >>> len(twice.runs), len(changed.runs)
        (21, 17)
    """
    if not test.synchronous:
        raise ValueError(
            f"{test.source or 'the test'} is not synchronous: runs are differenced where frequency = speed on all rows"
        )
    done = np.asarray(test.attributes.get(DIFFERENCED, np.zeros(len(test))) == 1)
    used = np.zeros(len(test), dtype=bool)
    parts: list[PerturbationTest] = []
    for partners in (_pairs, _with_reference):
        for first, second in partners(test, ~(used | done)):
            for a, b in _channels(test, first, second):
                part = _difference(test.select(a), test.select(b))
                if len(part):
                    parts.append(part)
                    used[a] = used[b] = True
    if not parts:
        return test
    marked = dict(test.attributes) | {DIFFERENCED: done.astype(float)}
    rest = replace(test, attributes=marked).select(~used)
    return join([*parts, rest] if len(rest) else parts)


def at_speeds(test: PerturbationTest, speeds: Float) -> PerturbationTest:
    """Start-ups at chosen speeds, rad/s, interpolated as for differences; unknown noise follows from what is around."""
    around = 25  # readings, of which windows of thirteen tell the noise
    parts = []
    for run in test.runs:
        rows = np.flatnonzero(test.run == run)
        for own, _ in _channels(test, rows, rows):
            whole = test.select(own)
            missing = speeds[~_covered(speeds, whole.speed)]
            if missing.size:
                listed = ", ".join(f"{speed * RPM_PER_RAD_S:.0f}" for speed in missing)
                raise ValueError(f"{test.source or 'the test'}: run {run} was not sampled about {listed} rpm")
            force = _at(speeds, whole.speed, whole.force / whole.speed**2) * speeds**2
            sigma = _at(speeds, whole.speed, whole.sigma).real
            share = _at(speeds, whole.speed, whole.attributes.get(RUN_OUT_SHARE, np.zeros(len(whole)))).real
            for k in np.flatnonzero(np.isnan(sigma)).tolist() if len(whole) >= around else ():
                near = np.argsort(np.abs(whole.speed - speeds[k]), kind="stable")[:around]
                sigma[k] = noise_from_smoothness(whole.speed[near], whole.response[near])
            parts.append(
                replace(
                    whole.select(np.zeros(speeds.size, dtype=int)),
                    speed=speeds,
                    frequency=speeds,
                    force=force,
                    sigma=sigma * np.hypot(1.0, np.nan_to_num(share)),
                    response=_response_at(speeds, whole, force),
                )
            )
    return join(parts)


def covered_speeds(test: PerturbationTest, speeds: Float) -> Float:
    """Those of some speeds, rad/s, that every channel of every run was sampled about."""
    for run in test.runs:
        rows = np.flatnonzero(test.run == run)
        for own, _ in _channels(test, rows, rows):
            speeds = speeds[_covered(speeds, test.speed[own])]
    return speeds


def uneven_weights(test: PerturbationTest) -> list[str]:
    """Pairs of start-ups with the weight at opposite angles whose weights differ, in words. The difference of their
    responses is divided by the sum of their weights: where one weight was turned, and is given twice the size in one of
    the runs, everything comes out too stiff, and no fit notices."""
    sentences: list[str] = []
    # difference of two weights, over the larger, from which they are hardly one that was turned
    largest_unevenness = 0.05
    for pair in _pairs(test, np.asarray(test.attributes.get(DIFFERENCED, np.zeros(len(test))) != 1)):
        sizes = [float(np.median(np.abs(test.force[rows]) / test.speed[rows] ** 2)) * 1e6 for rows in pair]
        if abs(sizes[0] - sizes[1]) > largest_unevenness * max(sizes):
            runs = [
                f"{test.run[rows[0]]} ({significant(size, 4)} g mm)" for rows, size in zip(pair, sizes, strict=True)
            ]
            sentences.append(" and ".join(runs))
    return sentences


def _pairs(test: PerturbationTest, rows: Bool) -> Iterator[tuple[NDArray[Any], NDArray[Any]]]:
    """Rows of each two runs with the force at one plane in opposite directions, in order of appearance."""
    degrees = np.round(np.degrees(np.angle(test.force)), 1).tolist()  # a run whose weight was moved is two runs
    sector: dict[float, float] = {}  # each angle is the first one within the tolerance: a phase that jitters is one
    for angle in dict.fromkeys(degrees):
        near = [s for s in sector.values() if abs((angle - s + 180) % 360 - 180) <= np.degrees(OPPOSITE_TOLERANCE)]
        sector[angle] = near[0] if near else angle
    runs: dict[Any, list[int]] = {}
    usable = rows & (test.force != 0) & (test.speed != 0) & ~test.linear & ~test.several
    for row in np.flatnonzero(usable).tolist():
        runs.setdefault((test.run[row], test.force_plane[row], sector[degrees[row]]), []).append(row)
    free = list(runs)
    while free:
        key = free.pop(0)
        force = test.force[runs[key][0]]
        for other in free:
            angle = np.angle(-test.force[runs[other][0]] / force)
            if other[1] == key[1] and abs(angle) <= OPPOSITE_TOLERANCE:
                free.remove(other)
                yield np.array(runs[key]), np.array(runs[other])
                break


def _with_reference(test: PerturbationTest, rows: Bool) -> Iterator[tuple[NDArray[Any], NDArray[Any]]]:
    """Rows of each run with a weight beside those of the first run without one, of its own plane if there is one."""
    bare = rows & (test.force == 0) & (test.speed != 0) & ~test.linear
    if not bare.any():
        return
    for run in test.runs:
        loaded = np.flatnonzero(rows & (test.run == run) & (test.force != 0) & (test.speed != 0) & ~test.linear)
        if loaded.size:
            own = bare & np.isin(test.force_plane, test.force_plane[loaded])
            among = own if own.any() else bare
            yield loaded, np.flatnonzero(bare & (test.run == test.run[np.argmax(among)]))


def _channels(
    test: PerturbationTest, first: NDArray[Any], second: NDArray[Any]
) -> Iterator[tuple[NDArray[Any], NDArray[Any]]]:
    for plane, direction in dict.fromkeys(zip(test.plane[first].tolist(), test.direction[first].tolist(), strict=True)):
        of_channel = (test.plane == plane) & (test.direction == direction)
        a, b = first[of_channel[first]], second[of_channel[second]]
        if b.size:
            yield a, b


def _difference(a: PerturbationTest, b: PerturbationTest) -> PerturbationTest:
    """One channel of run a minus the same channel of run b, at the speeds of a that b covers."""
    if len(a) == len(b) and np.allclose(a.speed, b.speed, rtol=SAME_RATE, atol=0):
        response, force, sigma, position = b.response, b.force, b.sigma, None
    else:
        inside = _covered(a.speed, b.speed)
        a = a.select(inside)
        position = a.speed
        force = _at(position, b.speed, b.force / b.speed**2) * position**2  # m r exp(j delta) hardly varies
        response = _response_at(position, b, force)
        sigma = _at(position, b.speed, b.sigma).real
    attributes = {name: _shared(values, b, name, position) for name, values in a.attributes.items()}
    return replace(
        a,
        run=np.array([f"{run} minus {b.run[0]}" for run in a.run], dtype=str),
        force=a.force - force,
        response=a.response - response,
        sigma=np.hypot(a.sigma, sigma),
        attributes=dict(attributes) | {DIFFERENCED: np.ones(len(a))},
    )


def _response_at(position: Float, run: PerturbationTest, force: ComplexArray) -> ComplexArray:
    """Response of one channel of a run at other speeds. Between coarse lines a spline cuts a resonance's corners. A
    rotor's response to unbalance, run-out included, is a ratio of polynomials in speed: that carries the resonances,
    and the spline what is left, which is little but noise."""
    ratio = ratio_through(run.speed, run.response)
    if ratio is None:
        # What hardly varies is interpolated: response over force, and of a run without a weight over speed squared.
        weights = bool(run.force.all())
        law, here = (run.force, force) if weights else (run.speed**2, position**2)
        return _at(position, run.speed, run.response / law, smooth=True) * here
    return ratio(position) + _at(position, run.speed, run.response - ratio(run.speed), smooth=True)


def _covered(speed: Float, sampled: Float) -> Bool:
    """True if each speed lies between two samples that are not too far apart, or on one."""
    samples = np.unique(sampled)
    on_sample = np.abs(speed - samples[np.abs(speed[:, None] - samples).argmin(axis=1)]) <= SAME_RATE * np.abs(speed)
    if samples.size < 2:
        return np.asarray(on_sample)
    steps = np.diff(samples)
    right = np.clip(np.searchsorted(samples, speed), 1, samples.size - 1)
    inside = (speed >= samples[0]) & (speed <= samples[-1])
    return np.asarray(on_sample | (inside & (steps[right - 1] <= LARGEST_GAP * np.median(steps))))


def _at(position: Float, x: Float, y: NDArray[Any], *, smooth: bool = False) -> ComplexArray:
    """Values at other positions; samples much closer than the usual step are averaged, or splines amplify noise."""
    from scipy.interpolate import CubicSpline

    order = np.argsort(x, kind="stable")
    x, y = x[order], y[order]
    steps = np.diff(x)
    typical = np.median(steps[steps > 0]) if (steps > 0).any() else 0.0
    number = np.concatenate([[0], np.cumsum(steps > 0.1 * typical)])
    count = np.bincount(number)
    knots = np.bincount(number, x) / count
    values = (np.bincount(number, y.real) + 1j * np.bincount(number, y.imag)) / count
    if knots.size < 2:
        return np.full(position.shape, values[0])
    if smooth and knots.size >= 4:
        return np.asarray(CubicSpline(knots, values)(position))
    return np.interp(position, knots, values.real) + 1j * np.interp(position, knots, values.imag)


def _shared(values: NDArray[Any], b: PerturbationTest, name: str, position: Float | None) -> NDArray[Any]:
    """Attribute of a pair: the mean of numbers, the common text, or both texts."""
    other = b.attributes[name]
    if values.dtype.kind in "fiu":
        numbers = other.astype(float)
        return np.asarray((values + (numbers if position is None else _at(position, b.speed, numbers).real)) / 2)
    if position is not None:
        other = np.full(values.shape, other[0])
    return np.array([x if x == y else f"{x} | {y}" for x, y in zip(values.tolist(), other.tolist(), strict=True)])


def join(parts: Sequence[Test]) -> Test:
    """One test of the rows of several of a kind, whose attributes are the same."""
    first = parts[0]
    names = first._columns()
    columns: dict[str, Any] = {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
    attributes = {name: np.concatenate([part.attributes[name] for part in parts]) for name in first.attributes}
    findings = tuple(dict.fromkeys(found for part in parts for found in part.findings))
    return replace(first, attributes=attributes, findings=findings, **columns)
