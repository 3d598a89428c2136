"""Lines in the spectrum of a signal: how much goes round with an angle, and hum of the mains."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rotorfit.models.array_types import Float

_AROUND = 40
"""Bins on each side of a line from which the level around it is taken."""
_STANDS_OUT = 25.0
"""Power of a line over the median around it; chi-squared noise with two degrees reaches it once in 3e7 bins."""


def turning_power(z: NDArray[np.complex128], angle: Float, turns: float = 6.0) -> tuple[float, float]:
    """Square of what turns with an angle, and of what turns against it, in half of the record at least.

    The signal is taken in blocks of some turns each, so that a response whose amplitude and phase change over the
    record, as in a sweep, does not cancel itself. The median over the blocks counts: a sweep that passes the frequency
    of the angle the other way is large there for a while.

    Args:
        z: motion, shape ``(N,)``.
        angle: rad, shape ``(N,)``, growing.
        turns: of one block.

    Returns:
        forward and backward squares, in the unit of z squared; NaN for less than one block.
    """
    block = np.floor((angle - angle[0]) / (2 * np.pi * turns)).astype(np.intp)
    count = int(block[-1])
    if count < 1:
        return float("nan"), float("nan")
    inside = block < count
    size = np.bincount(block[inside], minlength=count)
    found = []
    for sign in (-1.0, 1.0):
        turned = z[inside] * np.exp(sign * 1j * angle[inside])
        mean = np.bincount(block[inside], turned.real) + 1j * np.bincount(block[inside], turned.imag)
        found.append(float(np.median(np.abs(mean / size) ** 2)))
    return found[0], found[1]


def mains_hum(signal: Float, rate: float, harmonics: int = 5) -> list[tuple[float, float]]:
    """Lines at 50 or 60 Hz and their odd harmonics that stand out of what is around them.

    Args:
        signal: shape ``(N,)``.
        rate: samples a second, Hz.
        harmonics: highest harmonic looked for.

    Returns:
        frequency (Hz) and amplitude (0-peak, in the unit of the signal) of each line found.
    """
    window = np.hanning(signal.size)
    spectrum = np.abs(np.fft.rfft((signal - signal.mean()) * window)) / (window.sum() / 2)
    step = rate / signal.size
    found = []
    for mains in (50.0, 60.0):
        for order in range(1, harmonics + 1, 2):
            at = round(order * mains / step)
            wide = max(3, round(order * 0.05 / step))  # the mains' frequency wanders by some hundredths of a hertz
            if at - wide - _AROUND < 1 or at + wide + _AROUND >= spectrum.size:
                continue
            peak = at - wide + int(np.argmax(spectrum[at - wide : at + wide + 1]))
            around = np.concatenate([spectrum[at - wide - _AROUND : at - wide], spectrum[at + wide + 1 :][:_AROUND]])
            if spectrum[peak] ** 2 > _STANDS_OUT * np.median(around**2):
                found.append((peak * step, float(spectrum[peak])))
    return found


def full_spectrum(z: NDArray[np.complex128], rate: float) -> tuple[Float, Float]:
    """Amplitudes of a complex motion over signed frequency: a circle of radius A has A at its frequency, not 2 A.

    A Hann window is laid over the motion, its mean taken out first; a line between two bins reads up to 15 % low.

    Args:
        z: ``x + jy``, shape ``(N,)``.
        rate: samples a second, Hz.

    Returns:
        frequencies (Hz, ascending, negative is backward) and amplitudes in the unit of z.
    """
    window = np.hanning(z.size + 1)[:-1]
    spectrum = np.fft.fft((z - z.mean()) * window) / window.sum()
    return np.fft.fftshift(np.fft.fftfreq(z.size, 1 / rate)), np.fft.fftshift(np.abs(spectrum))
