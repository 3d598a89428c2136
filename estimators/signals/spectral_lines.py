"""Lines in the spectrum of a signal: how much goes round with an angle, and hum of the mains."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rotorfit.models.array_types import ComplexArray, Float

_LINE_POWER_OVER_MEDIAN = 25.0
"""Power of a line over the median around it; chi-squared noise with two degrees reaches it once in 3e7 bins."""


def turning_power(z: ComplexArray, angle: Float) -> tuple[float, float]:
    """Square of what turns with an angle, and against it, the median over blocks of six turns: responses of a sweep do
    not cancel themselves, and a passing sweep is large for a while only."""
    block = np.floor((angle - angle[0]) / (2 * np.pi * 6)).astype(np.intp)
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


def mains_hum(signal: Float, rate: float) -> list[tuple[float, float]]:
    """Lines at 50 or 60 Hz and odd harmonics that stand out: frequencies (Hz) and amplitudes (0-peak)."""
    places = [(order * mains, order * 0.05) for mains in (50.0, 60.0) for order in (1, 3, 5)]
    # the mains' frequency wanders by some hundredths of a hertz
    return [line for line in _standing_out(signal, rate, places) if line is not None]


def folded_orders(signal: Float, rate: float, turning: float, spread: float) -> list[tuple[int, float, float]]:
    """Orders of a shaft above half the sampling rate that stand where sampling folds them to. Only up to the sixtieth
    order and once folded, and not where the place is that of another order. Returns the order, the frequency of the
    line (Hz) and amplitude of each found."""
    orders = [n for n in range(int(rate / 2 / turning) + 1, 61) if n * turning < 0.98 * rate]
    margin = 8 * rate / signal.size
    orders = [n for n in orders if _off_orders(rate - n * turning, turning) > margin + 2 * n * spread]
    found = _standing_out(signal, rate, [(rate - n * turning, n * spread) for n in orders])
    return [(n, *line) for n, line in zip(orders, found, strict=True) if line is not None]


def _off_orders(frequency: float, turning: float) -> float:
    """Distance of a frequency from the nearest multiple of another, in its unit."""
    return abs(frequency - turning * round(frequency / turning))


def _standing_out(
    signal: Float, rate: float, places: Sequence[tuple[float, float]]
) -> list[tuple[float, float] | None]:
    """Frequency and amplitude of the line at each place, a frequency and how far the line may be off (Hz); or None."""
    window = np.hanning(signal.size)
    spectrum = np.abs(np.fft.rfft((signal - signal.mean()) * window)) / (window.sum() / 2)
    step = rate / signal.size
    found: list[tuple[float, float] | None] = []
    beside = 40  # bins on each side of a line from which the level around it is taken
    for frequency, off in places:
        at, wide = round(frequency / step), max(3, round(off / step))
        if at - wide - beside < 1 or at + wide + beside >= spectrum.size:
            found.append(None)
            continue
        peak = at - wide + int(np.argmax(spectrum[at - wide : at + wide + 1]))
        sides = spectrum[at - wide - beside : at - wide], spectrum[at + wide + 1 :][:beside]
        out = spectrum[peak] ** 2 > _LINE_POWER_OVER_MEDIAN * np.median(np.concatenate(sides) ** 2)
        out = out and not all(side.max() > spectrum[peak] / 2 for side in sides)  # blows at equal times make a comb
        found.append((peak * step, float(spectrum[peak])) if out else None)
    return found


def full_spectrum(z: ComplexArray, rate: float, points: int = 1) -> tuple[Float, Float]:
    """Amplitudes of a complex motion over signed frequency (Hz, ascending, negative backward), a circle of radius A
    having A, by a Hann window, mean out; a line between two bins reads up to 15 % low."""
    window = np.hanning(z.size + 1)[:-1]
    spectrum = np.fft.fft((z - z.mean()) * window, points * z.size) / window.sum()
    return np.fft.fftshift(np.fft.fftfreq(points * z.size, 1 / rate)), np.fft.fftshift(np.abs(spectrum))
