"""Noise of the readings of sweeps: from repeats, from the direction against the force, or from smoothness.

It is estimated from the data and from nothing else. The fit's own residuals are never used: they would hide a model
that does not fit, and redchi would mean nothing.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from rotorfit.base.array_types import ROUND_OFF, ComplexArray, Float, Index
from rotorfit.base.significance import P_UNLIKELY
from rotorfit.estimators.blocks.observations import Responses, force_plane, sweeps_of
from rotorfit.estimators.blocks.row_keys import distinguished

NOISE_FLOOR = 1e-9
"""Smallest noise, as a fraction of a channel's rms amplitude: exact data would otherwise weigh infinitely."""

FEWEST_LINES = 6
"""Lines from which a sweep shows its curve and what leaves it, jumps or noise: a parabola takes up three. Chosen."""

LINES_OF_A_LEVEL = 8
"""Lines from which a sweep can have a noise of its own: 16 squares give its variance within a third."""

SMOOTH_CORRELATION = 0.5
"""Lag-one correlation above which samples follow a curve and are no noise: of noise, sixteen samples exceed it once in
a hundred, eight once in fifteen."""

READINGS_OF_NOISE = 0.39
"""Readings behind an estimate of their noise, a share of them: windows of 13 lines leave 8 to it, and the median of
windows has 2/pi of the efficiency of their mean."""


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
    both: dict[tuple[Any, ...], list[Index]] = {}  # sweeps that differ in the sense of whirl only
    for rows in sweeps_of(block, synchronous=synchronous):
        if np.isnan(sigma[rows]).any():
            drive = np.abs(block.force[block.line[rows], plane[rows]]).sum()
            extent = (f"{v:.6g}" for v in (np.abs(w[rows]).min(), np.abs(w[rows]).max(), drive))
            first = rows[0]
            test = (block.coordinate[first], plane[first], speed[first], rows.size, *extent)
            both.setdefault(test, []).append(rows)
    for parts in both.values():
        try:
            for rows, level in _level_of_senses(block, w, wrong, parts):
                sigma[rows] = level
        except ValueError as reason:
            raise ValueError(f"{block.labels[block.label[parts[0][0]]]}: {reason}") from reason
    return sigma


def _level_of_senses(
    block: Responses, w: Float, against: ComplexArray, sweeps: Sequence[Index]
) -> Iterator[tuple[Index, Float | float]]:
    """Readings and their noise, of sweeps that differ in the sense of whirl alone: by motion against the force where it
    is noise, else by their smoothness."""
    together = np.concatenate(sweeps)
    if np.isfinite(against[together]).all() and not any(_is_smooth(against[sweep]) for sweep in sweeps):
        return _level_against_force(against, block.measured, sweeps)
    return _level_of_smoothness(w, block.measured, sweeps)


def _level_against_force(
    against: ComplexArray, measured: ComplexArray, sweeps: Sequence[Index]
) -> Iterator[tuple[Index, Float | float]]:
    """Noise by motion against the force, one for all sweeps where they agree."""
    together, sizes = np.concatenate(sweeps), [sweep.size for sweep in sweeps]
    pooled = noise_from_samples(against[together], measured[together], sizes)
    power = np.split(np.abs(against[together] / pooled) ** 2, np.cumsum(sizes)[:-1])
    if _agree([float(np.mean(own)) for own in power], [2 * size for size in sizes]):
        yield together, pooled
    else:
        yield from ((sweep, noise_from_samples(against[sweep], measured[sweep])) for sweep in sweeps)


def _level_of_smoothness(
    w: Float, measured: ComplexArray, sweeps: Sequence[Index]
) -> Iterator[tuple[Index, Float | float]]:
    """Noise by the smoothness of responses over frequency, one for all sweeps where they agree."""
    levels = [noise_from_smoothness(w[sweep], measured[sweep]) for sweep in sweeps]
    # Windows overlap, and a median is less sure than a mean: about half as many degrees of freedom as readings.
    if _agree([level**2 for level in levels], [sweep.size // 2 for sweep in sweeps]):
        yield np.concatenate(sweeps), float(np.sqrt(np.mean(np.square(levels))))
    else:
        yield from zip(sweeps, levels, strict=True)


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
    # Chi-squared with one degree of freedom is a squared normal.
    return math.erfc(math.sqrt(statistic / 2)) > P_UNLIKELY


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
    # Times the noise of each sweep by itself up to which the differences of repeats are noise
    repeats_over_smoothness = 2.5
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
        alone = [noise_from_smoothness(w[rows], block.measured[rows]) for rows in ordered]
        pairs = zip(deviations, ordered, strict=True)
        levels = np.array([noise_from_samples(deviation, block.measured[rows]) for deviation, rows in pairs])
        own = np.sqrt(np.mean(levels**2, axis=0))
        if float(np.median(own)) <= repeats_over_smoothness * max(alone) and not any(map(_is_smooth, deviations)):
            yield from ((rows, own) for rows in ordered)


def _repeats(block: Responses, w: Float, condition: Sequence[Float | Index]) -> Index | None:
    """Number of each reading among those that differ in what was done; None where none is repeated, and no sweep."""
    plane = force_plane(block)
    forces = block.force[block.line].T
    drive = [plane, *[np.round(part, 12) for force in forces if force.any() for part in (force.real, force.imag)]]
    columns = [block.coordinate, block.reading_group, *condition, np.round(w, 9), *drive]
    _, number = distinguished(*columns)
    return None if int(number.max(initial=-1)) + 1 == number.size else number


def noise_from_samples(noise: ComplexArray, amplitude: ComplexArray, sizes: Sequence[int] | None = None) -> Float:
    """Standard deviation of real and of imaginary part, shape ``(L,)``, from samples of a channel's noise alone: of
    constant noise (probe and cable) and of noise proportional to the amplitude (gain flutter), the likelier. Samples of
    several sweeps follow one another, ``sizes`` counts those of each."""
    size = np.abs(amplitude)
    floor = NOISE_FLOOR * float(np.sqrt(np.mean(size * size)))
    constant = _level(noise)
    found = np.full(size.size, max(constant, floor))
    if size.size < LINES_OF_A_LEVEL or constant <= floor or not size.all():
        return found
    # The right shape makes |noise| / shape identically distributed, the wrong one spreads its logarithm; few outliers
    # weigh the same in both.
    safe = np.maximum(np.abs(noise), floor)
    ends = np.cumsum(sizes or [size.size])
    # Spread of the logarithm of proportional noise over that of constant noise below which it is preferred; else the
    # amplitude hardly varies
    spread_of_proportional = 0.8
    if _spread_within(np.log(safe / size), ends) < spread_of_proportional * _spread_within(np.log(safe), ends):
        return np.asarray(np.maximum(_level(noise / size) * size, floor))
    return found


def _spread_within(values: Float, ends: Index) -> float:
    """Sum of squared deviations from the means of the sweeps."""
    return sum(float(np.sum((own - own.mean()) ** 2)) for own in np.split(values, ends[:-1]))


def _level(noise: ComplexArray) -> float:
    """Standard deviation of real and imaginary part; the median's where gross outliers inflate the mean square."""
    power = np.abs(noise) ** 2
    # |noise|^2 of a complex Gaussian is exponential: mean 2 sigma^2, median 2 sigma^2 ln 2.
    mean = float(np.mean(power)) / 2
    fewest = 30
    if power.size < fewest:
        return float(np.sqrt(mean))
    median = float(np.median(power)) / (2 * np.log(2))
    # Mean over median-based power from which there are outliers: noise alone exceeds it in 30 samples once in 1000
    mean_over_median = 2.0
    return float(np.sqrt(median if mean > mean_over_median * median else mean))


def noise_from_smoothness(frequency: Float, response: ComplexArray) -> float:
    """Noise level of a channel from its departure from local rational functions of frequency. In a window that slides
    along the sweep, ``y (1 + a1 d + a2 d^2) = b0 + b1 d + b2 d^2`` is fitted by linear least squares, d the distance
    from the middle: a rational function follows a resonance that a polynomial of the same width cannot. The median over
    the windows of the residual variance is the estimate. Short sweeps drop a2, then a1."""
    count = frequency.size
    if count < FEWEST_LINES:
        raise ValueError(
            f"a sweep with {count} of the {FEWEST_LINES} points needed has too few to estimate its noise: "
            "give a sigma_um column"
        )
    width, poles = (13, 2) if count >= 13 else (count, min(2, max(0, count - 7)))
    rank = np.argsort(frequency)
    windows = np.lib.stride_tricks.sliding_window_view
    some = slice(None, None, -(-count // 5000))  # the median of so many variances is right to a per cent
    variances = _local_variances(windows(frequency[rank], width)[some], windows(response[rank], width)[some], poles)
    freedom = 2 * (width - 3 - poles)
    # Median of chi-squared over its mean (Wilson and Hilferty).
    median = (1 - 2 / (9 * freedom)) ** 3
    sigma = float(np.sqrt(np.median(variances) / median))
    floor = NOISE_FLOOR * float(np.sqrt(np.mean(np.abs(response) ** 2)))
    return max(sigma, floor)


def _local_variances(w: Float, y: ComplexArray, poles: int) -> Float:
    """Residual variance of real and imaginary part about a local rational function in each window, ``(N, m)``."""
    d = w - w.mean(axis=1, keepdims=True)
    d = d / np.maximum(np.abs(d).max(axis=1, keepdims=True), np.finfo(float).tiny)
    basis = np.stack([d**k for k in range(3)] + [-y * d**k for k in range(1, poles + 1)], axis=-1)
    denominator = np.ones_like(y)
    for _ in range(3):  # the equation error is the response error times the denominator: divide by the last one
        scaled, target = basis / denominator[..., None], y / denominator
        coefficients = _solved(scaled, target)
        miss = target - np.einsum("nmp,np->nm", scaled, coefficients)
        powers = np.stack([d**k for k in range(poles + 1)], axis=-1)
        leading = np.concatenate([np.ones((len(y), 1)), coefficients[:, 3:]], axis=1)
        denominator = np.einsum("nmp,np->nm", powers, leading)
        denominator = np.where(denominator == 0, 1.0, denominator)
    return np.asarray(np.sum(np.abs(miss) ** 2, axis=1) / (2 * (w.shape[1] - basis.shape[2])))


def _solved(design: ComplexArray, target: ComplexArray) -> ComplexArray:
    """Least squares in each window, ``(N, m, p)`` and ``(N, m)``. Triangles take a part of the time of singular values,
    which are left to windows whose columns depend on each other, as those of exact data may."""
    q, r = np.linalg.qr(design)
    size = np.abs(np.diagonal(r, axis1=1, axis2=2))
    sound = size.min(axis=1) > ROUND_OFF * size.max(axis=1)
    found = np.empty((len(design), design.shape[2]), dtype=complex)
    along = np.matmul(q[sound].conj().swapaxes(1, 2), target[sound, :, None])
    found[sound] = np.linalg.solve(r[sound], along)[..., 0]
    if not sound.all():
        found[~sound] = np.einsum("npm,nm->np", np.linalg.pinv(design[~sound], rcond=ROUND_OFF), target[~sound])
    return found


def deviations_of_repeats(sweeps: ComplexArray) -> ComplexArray:
    """Noise of repeated sweeps, ``(n_repeats, L)``, without each one's gain and phase, which are no noise."""
    mean = sweeps.mean(axis=0)
    count, lines = sweeps.shape
    if lines < 3:  # nothing would be left
        return np.asarray((sweeps - mean) * np.sqrt(count / (count - 1)))
    power = float(np.sum(np.abs(mean) ** 2))
    factor = sweeps @ mean.conj() / power if power > 0 else np.ones(len(sweeps))
    left = sweeps - factor[:, None] * mean
    return np.asarray(left * np.sqrt(count * lines / ((count - 1) * (lines - 1))))
