"""Noise of the readings, estimated from the data and from nothing else.

The fit's own residuals are never used: they would hide a model that does not fit, and redchi would mean nothing.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

FLOOR = 1e-9
"""Smallest noise, as a fraction of a channel's rms amplitude: exact data would otherwise weigh infinitely."""


_OUTLIERS = 2.0  # mean over median-based power; noise alone exceeds this in 30 samples about once in 10^3


def noise_from_samples(noise: ComplexArray, amplitude: ComplexArray) -> Float:
    """Noise level of a channel from pure-noise samples that have the same distribution as its noise.

    Two shapes of noise compete: constant over the sweep (probe and cable), and proportional to the
    amplitude (gain flutter).

    Args:
        noise: complex samples, shape ``(L,)``, for instance the component opposite to the force.
        amplitude: the channel's readings, shape ``(L,)``.

    Returns:
        standard deviation of the real part and of the imaginary part, shape ``(L,)``.
    """
    size = np.abs(amplitude)
    floor = FLOOR * float(np.sqrt(np.mean(size**2)))
    constant = _level(noise)
    if constant <= floor or noise.size < 8 or not size.all():
        return np.full(size.shape, max(constant, floor))
    # The right shape makes |noise| / shape identically distributed, the wrong one spreads its logarithm; few outliers
    # weigh the same in both.
    safe = np.maximum(np.abs(noise), floor)
    if np.var(np.log(safe / size)) < np.var(np.log(safe)):
        return np.maximum(_level(noise / size) * size, floor)
    return np.full(size.shape, constant)


def _level(noise: ComplexArray) -> float:
    """Standard deviation of real and imaginary part; the median's where gross outliers inflate the mean square."""
    power = np.abs(noise) ** 2
    # |noise|^2 of a complex Gaussian is exponential: mean 2 sigma^2, median 2 sigma^2 ln 2.
    mean, median = float(np.mean(power)) / 2, float(np.median(power)) / (2 * np.log(2))
    return float(np.sqrt(median if mean > _OUTLIERS * median and power.size >= 30 else mean))


def noise_from_smoothness(frequency: Float, response: ComplexArray, half_width: int = 4, order: int = 3) -> Float:
    """Noise level of a channel from its departure from local polynomials in frequency.

    A polynomial is fitted through the neighbours of each point, the point itself left out; the prediction error is
    divided by its own leverage. The median over the sweep resists resonances, where a polynomial falls short.

    Args:
        frequency: rad/s, shape ``(L,)``.
        response: readings, shape ``(L,)``.
        half_width: neighbours on either side.
        order: order of the polynomial.

    Returns:
        standard deviation of the real part and of the imaginary part, shape ``(L,)``.

    Raises:
        ValueError: fewer points than the polynomial needs.
    """
    count = frequency.size
    need = order + 3
    if count < need:
        raise ValueError(
            f"{count} points on a sweep are too few to estimate its noise (at least {need}): give a sigma_um column"
        )
    rank = np.argsort(frequency)
    w, values = frequency[rank], response[rank]
    errors = np.empty(count)
    for i in range(count):
        low = min(max(0, i - half_width), max(0, count - 2 * half_width - 1))
        window = np.arange(low, min(count, low + 2 * half_width + 1))
        window = window[window != i]
        span = max(abs(w[window] - w[i]).max(), np.finfo(float).tiny)
        basis = np.vander((w[window] - w[i]) / span, order + 1, increasing=True)
        weights = np.linalg.pinv(basis)[0]
        errors[i] = abs(values[i] - weights @ values[window]) ** 2 / (1 + weights @ weights)
    # |error|^2 of a complex Gaussian is exponential with mean 2 sigma^2 and median 2 sigma^2 ln 2.
    sigma = float(np.sqrt(np.median(errors) / (2 * np.log(2))))
    floor = FLOOR * float(np.sqrt(np.mean(np.abs(response) ** 2)))
    return np.full(count, max(sigma, floor))


def noise_from_repeats(sweeps: ComplexArray) -> float:
    """Standard deviation of real and imaginary part from repeated sweeps, shape ``(n_repeats, L)``, pooled."""
    deviation = sweeps - sweeps.mean(axis=0)
    freedom = 2 * (sweeps.shape[0] - 1) * sweeps.shape[1]
    return float(np.sqrt(np.sum(np.abs(deviation) ** 2) / freedom))
