"""Noise of the readings, estimated from the data and from nothing else.

The fit's own residuals are never used: they would hide a model that does not fit, and redchi would mean nothing.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rotorfit.models.array_types import ROUND_OFF, ComplexArray, Float, Index

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

_SPREAD_OF_PROPORTIONAL = 0.8
"""Spread of the logarithm of proportional noise over that of constant noise below which it is preferred; else the
amplitude hardly varies."""
_MEAN_OVER_MEDIAN = 2.0
"""Mean over median-based power from which there are outliers: noise alone exceeds it in 30 samples once in 1000."""


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
    if _spread_within(np.log(safe / size), ends) < _SPREAD_OF_PROPORTIONAL * _spread_within(np.log(safe), ends):
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
    return float(np.sqrt(median if mean > _MEAN_OVER_MEDIAN * median else mean))


def noise_from_smoothness(frequency: Float, response: ComplexArray) -> Float:
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
    return np.full(count, max(sigma, floor))


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
