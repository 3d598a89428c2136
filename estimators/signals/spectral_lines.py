"""Lines in the spectrum of a signal: what goes round with an angle, hum of the mains, a perturbation without a mark."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy.interpolate import BSpline

from rotorfit.base.array_types import Bool, ComplexArray, Float, Index
from rotorfit.estimators.signals.shaft_angle import SPLINE_DEGREE, SmoothAngle


@dataclass(frozen=True, eq=False, kw_only=True)
class Turning:
    """An angle at some samples in blocks of six turns, in which responses of a sweep do not cancel themselves. Blocks
    have Hann's window, which what turns a third slower or faster does not pass."""

    RESOLVED: ClassVar[float] = 1 / 3  # relative difference of speeds from which motion is told apart

    back: ComplexArray  # what turns with the angle times this stands still, of each sample in a block, windowed
    samples: Bool  # those in whole blocks
    block: Index  # of each of these
    size: Float  # sum of the window in each block

    @classmethod
    def of(cls, angle: Float, apart: Bool) -> Turning:
        """By the angle of each sample, rad, in blocks all of whose samples are ``apart`` from other motion."""
        turns = (angle - angle[0]) / (2 * np.pi * 6)
        block = np.floor(turns).astype(np.intp)
        samples = (np.bincount(block, ~apart)[block] == 0) & (block < block[-1])
        block, window = block[samples], 1 - np.cos(2 * np.pi * turns[samples])
        block = np.unique(block, return_inverse=True)[1].reshape(-1)
        back = window * np.exp(-1j * angle[samples])
        return cls(back=back, samples=samples, block=block, size=np.bincount(block, window).astype(float))

    def power(self, z: ComplexArray) -> tuple[float, float]:
        """Square of what turns with the angle, and against it, the median over blocks: a passing sweep is large for a
        while only; NaN where there is no block."""
        if not self.size.size:
            return float("nan"), float("nan")
        inside = z[self.samples]
        found = []
        for turned in (inside * self.back, inside.conj() * self.back):
            mean = np.bincount(self.block, turned.real) + 1j * np.bincount(self.block, turned.imag)
            found.append(float(np.median(np.abs(mean / self.size) ** 2)))
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
    places = []
    for n in orders:
        folded = rate - n * turning
        if abs(folded - turning * round(folded / turning)) > margin + 2 * n * spread:  # from the nearest other order
            places.append((n, folded, n * spread))
    found = _standing_out(signal, rate, [place[1:] for place in places])
    return [(n, *line) for (n, *_), line in zip(places, found, strict=True) if line is not None]


def _standing_out(
    signal: Float, rate: float, places: Sequence[tuple[float, float]]
) -> list[tuple[float, float] | None]:
    """Frequency and amplitude of the line at each place, a frequency and how far the line may be off (Hz); or None."""
    window = np.hanning(signal.size)
    spectrum = np.abs(np.fft.rfft((signal - signal.mean()) * window)) / (window.sum() / 2)
    step = rate / signal.size
    found: list[tuple[float, float] | None] = []
    beside = 40  # bins on each side of a line from which the level around it is taken
    # Power of a line over the median around it; chi-squared noise with two degrees reaches it once in 3e7 bins
    line_power_over_median = 25.0
    for frequency, off in places:
        at, wide = round(frequency / step), max(3, round(off / step))
        if at - wide - beside < 1 or at + wide + beside >= spectrum.size:
            found.append(None)
            continue
        peak = at - wide + int(np.argmax(spectrum[at - wide : at + wide + 1]))
        sides = spectrum[at - wide - beside : at - wide], spectrum[at + wide + 1 :][:beside]
        out = spectrum[peak] ** 2 > line_power_over_median * np.median(np.concatenate(sides) ** 2)
        out = out and not all(side.max() > spectrum[peak] / 2 for side in sides)  # blows at equal times make a comb
        found.append((peak * step, float(spectrum[peak])) if out else None)
    return found


def full_spectrum(z: ComplexArray, rate: float, points: int = 1) -> tuple[Float, Float]:
    """Amplitudes of a complex motion over signed frequency (Hz, ascending, negative backward), a circle of radius A
    having A, by a Hann window, mean out; a line between two bins reads up to 15 % low."""
    window = np.hanning(z.size + 1)[:-1]
    spectrum = np.fft.fft((z - z.mean()) * window, points * z.size) / window.sum()
    return np.fft.fftshift(np.fft.fftfreq(points * z.size, 1 / rate)), np.fft.fftshift(np.abs(spectrum))


def steady_angle(z: ComplexArray, rate: float, direction: int, avoid: Sequence[float]) -> SmoothAngle:
    """Angle of a perturbation at a steady frequency, from the motion it causes; zero at time zero, since nothing says
    where its mark would be."""
    near = _outstanding_line(z, rate, direction, avoid)
    t = np.arange(z.size) / rate
    beyond, error = _rate_of_phase(z * np.exp(-2j * np.pi * near * t), t, near)
    speed = direction * (2 * np.pi * near + beyond)
    end = z.size / rate
    knots = np.concatenate([np.zeros(SPLINE_DEGREE + 1), np.full(SPLINE_DEGREE + 1, end)])
    coefficients = speed * np.linspace(0.0, end, SPLINE_DEGREE + 1)
    return SmoothAngle(
        spline=BSpline(knots, coefficients, SPLINE_DEGREE, extrapolate=True),
        begin=0.0,
        end=end,
        jitter=error / abs(speed),
        groups=np.array([[0.0, end], [error, error]]),
        shares=np.ones(2),
        share_t=np.array([0.0, end]),
        pattern=np.zeros(1),
        outlying=np.zeros(0),
        count=0,
    )


def _outstanding_line(z: ComplexArray, rate: float, direction: int, avoid: Sequence[float]) -> float:
    """Signed frequency of the spectrum's largest line on a side, Hz, other than those to avoid."""
    frequency, amplitude = full_spectrum(z, rate)
    step = rate / z.size
    mine = (direction * frequency > 3 * step) & (amplitude > 0)
    for line in avoid:
        mine &= np.abs(frequency - line) > 4 * step
    if not mine.any():
        raise ValueError("the recording is too short to tell the perturbation from the orders of the shaft")
    peak = int(np.argmax(np.where(mine, amplitude, 0.0)))
    line_amplitude_over_median = 8.0  # amplitude of the line over the median of the spectrum on its side
    if amplitude[peak] < line_amplitude_over_median * float(np.median(amplitude[mine])):
        raise ValueError(
            "no line stands out of the spectrum beside the orders of the shaft: is the perturbator running?"
        )
    return float(frequency[peak])


def _rate_of_phase(turned: ComplexArray, t: Float, near: float) -> tuple[float, float]:
    """Rate at which a slow vector turns, rad/s, and its standard error, by the phases of its means over blocks."""
    pieces = 24
    size = turned.size // pieces
    weight = np.hanning(size + 2)[1:-1]
    vectors = (turned[: size * pieces].reshape(pieces, size) * weight).sum(axis=1)
    middle = t[: size * pieces].reshape(pieces, size).mean(axis=1)
    phase = np.unwrap(np.angle(vectors))
    line, covariance = np.polyfit(middle, phase, 1, cov=True)
    scatter = float(np.std(phase - np.polyval(line, middle)))
    # Scatter of the phase about a straight line, rad, beyond which a frequency is not steady: 6 % of a vector is lost
    largest_phase_scatter = 0.35
    if scatter > largest_phase_scatter:
        raise ValueError(
            f"the line at {abs(near):.3f} Hz is not steady, its phase wanders by {scatter:.2f} rad; "
            "a swept perturbation needs a mark"
        )
    return float(line[0]), max(float(np.sqrt(covariance[1, 1])), 1e-12)
