"""Noise of the readings of sweeps: from repeats, from the direction against the force, or from smoothness."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from rotorfit.estimators.blocks.observations import Responses
from rotorfit.estimators.blocks.row_keys import distinguished
from rotorfit.estimators.blocks.sweeps import force_plane, sweeps_of
from rotorfit.estimators.noise.reading_noise import (
    LINES_OF_A_LEVEL,
    NOISE_FLOOR,
    SMOOTH_CORRELATION,
    deviations_of_repeats,
    noise_from_samples,
    noise_from_smoothness,
)
from rotorfit.estimators.significance import P_UNLIKELY
from rotorfit.models.array_types import ComplexArray, Float, Index

_REPEATS_OVER_SMOOTHNESS = 2.5
"""Times the noise of each sweep by itself up to which the differences of repeats are noise."""


def estimate_noise(block: Responses, wrong: ComplexArray, synchronous: bool, condition: Index | None = None) -> Float:
    """Standard deviation of either part of each reading, ``(R,)``: from repeated sweeps, else the wrong direction, else
    smoothness. Forward and backward sweeps of a test share a level unless Bartlett's test refuses: probes do not know
    which way the force turns."""
    w = block.frequency[block.line]
    speed = np.zeros_like(w) if synchronous else np.round(block.set_speed[block.line], 6)
    plane = force_plane(block)
    sigma = np.full(w.size, np.nan)
    same = np.zeros_like(w) if condition is None else condition
    for rows, level in _repeated(block, w, (speed, same)):
        sigma[rows] = level
    sweeps = [rows for rows in sweeps_of(block, synchronous=synchronous) if np.isnan(sigma[rows]).any()]
    for parts in _both_ways(block, w, speed, plane, sweeps):
        try:
            for rows, level in _noise_of(block, w, wrong, parts):
                sigma[rows] = level
        except ValueError as reason:
            raise ValueError(f"{block.labels[block.label[parts[0][0]]]}: {reason}") from reason
    return sigma


def _both_ways(block: Responses, w: Float, speed: Float, plane: Index, sweeps: Sequence[Index]) -> list[list[Index]]:
    """Sweeps put together that differ in the sense of whirl only."""
    both: dict[tuple[Any, ...], list[Index]] = {}
    for rows in sweeps:
        drive = np.abs(block.force[block.line[rows], plane[rows]])
        extent = (np.abs(w[rows]).min(), np.abs(w[rows]).max(), drive.sum())
        test = (
            block.coordinate[rows[0]],
            plane[rows[0]],
            speed[rows[0]],
            rows.size,
            *(f"{v:.6g}" for v in extent),
        )
        both.setdefault(test, []).append(rows)
    return list(both.values())


def _noise_of(
    block: Responses, w: Float, wrong: ComplexArray, parts: Sequence[Index]
) -> Iterator[tuple[Index, Float | float]]:
    """Noise of sweeps that differ in the sense of whirl: one for all where they agree."""
    rows, sizes = np.concatenate(parts), [part.size for part in parts]
    if np.isfinite(wrong[rows]).all() and not any(_is_smooth(wrong[part]) for part in parts):
        pooled = noise_from_samples(wrong[rows], block.measured[rows], sizes)
        power = np.split(np.abs(wrong[rows] / pooled) ** 2, np.cumsum(sizes)[:-1])
        if _agree([float(np.mean(own)) for own in power], [2 * size for size in sizes]):
            yield rows, pooled
        else:
            for part in parts:
                yield part, noise_from_samples(wrong[part], block.measured[part])
        return
    levels = [float(noise_from_smoothness(w[part], block.measured[part])[0]) for part in parts]
    # Windows overlap, and a median is less sure than a mean: about half as many degrees of freedom as readings.
    if _agree([level**2 for level in levels], [size // 2 for size in sizes]):
        yield rows, float(np.sqrt(np.mean(np.square(levels))))
    else:
        yield from zip(parts, levels, strict=True)


def _agree(power: Sequence[float], freedom: Sequence[int]) -> bool:
    """True if the largest and the smallest variance can be one, by Bartlett's test; short sweeps always agree."""
    high, low = int(np.argmax(power)), int(np.argmin(power))
    if high == low or min(freedom) < LINES_OF_A_LEVEL or power[low] <= 0:
        return True
    ends = ((power[high], freedom[high]), (power[low], freedom[low]))
    both = freedom[high] + freedom[low]
    pooled = sum(own * f for own, f in ends) / both
    correction = 1 + (sum(1 / f for _, f in ends) - 1 / both) / 3  # Bartlett 1937
    statistic = max(sum(f * math.log(pooled / own) for own, f in ends), 0.0) / correction  # round-off may be below zero
    return (
        math.erfc(math.sqrt(statistic / 2)) > P_UNLIKELY
    )  # chi-squared with one degree of freedom is a squared normal


def _is_smooth(samples: ComplexArray) -> bool:
    """True if samples follow one another; few never do."""
    power = float(np.sum(np.abs(samples) ** 2))
    if samples.size < LINES_OF_A_LEVEL or power == 0:
        return False
    return bool(np.abs(np.sum(samples[1:] * samples[:-1].conj())) > SMOOTH_CORRELATION * power)


def _repeated(block: Responses, w: Float, condition: Sequence[Float | Index]) -> Iterator[tuple[Index, Float | float]]:
    """Sweeps that were run again at the same force, in the same conditions and order, and their noise. Differences of
    repeats are noise only where they are no larger than what each sweep shows by itself, and do not follow a curve:
    what differs on purpose, or drifts, is none."""
    number = None if len(block.labels) < 2 else _repeats(block, w, condition)
    if number is None:
        return
    sweeps: dict[tuple[int, ...], list[Index]] = {}
    for label in np.unique(block.label):
        rows = np.flatnonzero(block.label == label)
        upward = int(np.sign(np.sum(np.sign(np.diff(np.abs(w[rows]))))))
        rows = rows[np.argsort(number[rows], kind="stable")]
        sweeps.setdefault((upward, *number[rows].tolist()), []).append(rows)
    for repeated in sweeps.values():
        if len(repeated) < 2:
            continue
        ordered = [rows[np.argsort(w[rows], kind="stable")] for rows in repeated]
        deviations = deviations_of_repeats(np.array([block.measured[rows] for rows in ordered]))
        if repeated[0].size < LINES_OF_A_LEVEL:  # too short to tell more
            floor = NOISE_FLOOR * float(np.sqrt(np.mean(np.abs(block.measured[ordered[0]]) ** 2)))
            level = max(float(np.sqrt(np.mean(np.abs(deviations) ** 2) / 2)), floor)
            yield from ((rows, level) for rows in ordered)
            continue
        alone = [float(noise_from_smoothness(w[rows], block.measured[rows])[0]) for rows in ordered]
        pairs = zip(deviations, ordered, strict=True)
        levels = np.array([noise_from_samples(deviation, block.measured[rows]) for deviation, rows in pairs])
        own = np.sqrt(np.mean(levels**2, axis=0))
        if float(np.median(own)) > _REPEATS_OVER_SMOOTHNESS * max(alone) or any(
            _is_smooth(deviation) for deviation in deviations
        ):
            continue
        yield from ((rows, own) for rows in ordered)


def _repeats(block: Responses, w: Float, condition: Sequence[Float | Index]) -> Index | None:
    """Number of each reading among those that differ in what was done; None where none is repeated, and no sweep."""
    plane = force_plane(block)
    forces = block.force[block.line].T
    drive = [plane, *[np.round(part, 12) for force in forces if force.any() for part in (force.real, force.imag)]]
    columns = [block.coordinate, block.reading_group, *condition, np.round(w, 9), *drive]
    _, number = distinguished(*columns)
    return None if int(number.max(initial=-1)) + 1 == number.size else number
