"""Averaged cross-periodograms of a long record: cells of neighbouring lines of one transform of the whole of it.

No overlapping segments: these smear peaks, and the degrees of freedom of their averages are not known.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rotorfit.base.array_types import Bool, ComplexArray, Float
from rotorfit.estimators.signals.subspace import LEAST_SHARE, spectral_poles

TAPERED_SHARE = 0.1
"""Share of a record over which a split cosine fades it in and out, half at either end."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Cells:
    """Averages of ``u u^*``, ``u = [z(w); conj z(-w)]``, over cells of lines, two-sided densities in m^2/Hz."""

    frequency: Float  # middle of each cell, Hz, positive, shape ``(C,)``
    power: ComplexArray  # shape ``(C, 2n, 2n)``
    freedom: Float  # complex degrees of freedom of each, shape ``(C,)``


def averaged(
    z: ComplexArray, rate: float, *, band: tuple[float, float], width: float, masked: Sequence[tuple[float, float]] = ()
) -> Cells:
    """Cells of a record, shape ``(n, N)``, m, at so many samples a second, over a band (Hz), so many Hz wide.

    ``masked``: frequencies from and to that are left out, of motion forward and backward alike.
    """
    from scipy.fft import fft
    from scipy.signal.windows import tukey

    count = z.shape[1]
    window = tukey(count, TAPERED_SHARE)
    squares = window**2
    spread = float(np.sum(squares**2) / np.sum(squares) ** 2)  # one over the independent samples of the window
    spectrum = fft(z * window, axis=1) / np.sqrt(rate * np.sum(squares))
    step = rate / count
    lines = np.arange(1, count // 2)
    lines = lines[(lines * step >= band[0]) & (lines * step < band[1])]
    kept = np.ones(lines.size, dtype=bool)
    for low, high in masked:
        kept &= (lines * step < low) | (lines * step > high)
    cell = ((lines * step - band[0]) / width).astype(np.intp)
    lines, cell = lines[kept], cell[kept]
    u = np.concatenate([spectrum[:, lines], spectrum[:, -lines].conj()])
    sizes = np.bincount(cell)
    usual = np.flatnonzero(sizes >= sizes.max() / 2)  # what a mask leaves of a cell tells too little
    lines, u = lines[np.isin(cell, usual)], u[:, np.isin(cell, usual)]
    cell = np.searchsorted(usual, cell[np.isin(cell, usual)])
    first = np.searchsorted(cell, np.arange(usual.size))
    size = np.bincount(cell)
    outer = np.add.reduceat(u[:, None] * u[None].conj(), first, axis=2) / size
    return Cells(
        frequency=np.add.reduceat(lines * step, first) / size,
        power=np.asarray(np.transpose(outer, (2, 0, 1)), dtype=complex),
        freedom=size / (count * spread),
    )


def periodogram(z: ComplexArray, rate: float) -> tuple[Float, Float]:
    """Frequencies (Hz, positive) and periodograms of motion forward, then backward, shape ``(2n, K)``, m^2/Hz."""
    from scipy.fft import fft
    from scipy.signal.windows import tukey

    window = tukey(z.shape[1], TAPERED_SHARE)
    power = np.abs(fft(z * window, axis=1)) ** 2 / (rate * np.sum(window**2))
    lines = np.arange(1, z.shape[1] // 2)
    return lines * rate / z.shape[1], np.concatenate([power[:, lines], power[:, -lines]])


def envelope(z: ComplexArray, rate: float, centre: float, reach: float) -> tuple[float, float]:
    """Variance over squared mean of the squared envelope of whirl, shape ``(N,)``, within ``reach`` of a frequency, Hz,
    and its standard deviation by chance: 1 of motion that noise drives, 0 of a steady orbit."""
    from scipy.fft import fft, fftfreq, ifft
    from scipy.signal.windows import tukey

    frequency = fftfreq(z.size, 1 / rate)
    motion = ifft(np.where(np.abs(frequency - centre) < reach, fft(z * tukey(z.size, TAPERED_SHARE)), 0.0))
    ends = int(TAPERED_SHARE / 2 * z.size)
    square = np.abs(motion[ends : z.size - ends]) ** 2
    independent = 2 * reach * square.size / rate
    return float(square.var() / square.mean() ** 2), 2 / np.sqrt(independent)


def outstanding(frequency: Float, power: Float, clear: Bool, apart: float) -> list[float]:
    """Frequencies of lines that stand out of what is beside them, at least ``apart``, Hz, from one another; ``clear``:
    where they are looked for, shape ``(K,)``."""
    from scipy.ndimage import median_filter

    beside = 81  # lines whose median is the level about each
    line_over_median = 40.0  # of exponential noise no line in 1e12 reaches it
    ratio = np.max(power / median_filter(power, (1, beside), mode="nearest"), axis=0)
    found: list[float] = []
    for k in np.argsort(-np.where(clear, ratio, 0.0)).tolist():
        if not clear[k] or ratio[k] < line_over_median:
            break
        if all(abs(frequency[k] - other) > apart for other in found):
            found.append(float(frequency[k]))
    return sorted(found)


def smoothed(
    frequency: Float, power: Float, masked: Sequence[tuple[float, float]], width: float
) -> tuple[Float, Float]:
    """Periodograms averaged over stretches so many Hz wide, without what is masked: their middles and means."""
    kept = np.all([(frequency < low) | (frequency > high) for low, high in masked], axis=0)
    stretch = (frequency[kept] / width).astype(np.intp)
    used, first = np.unique(stretch, return_index=True)
    size = np.diff(np.append(first, stretch.size))
    return np.asarray((used + 0.5) * width, dtype=float), np.add.reduceat(power[:, kept], first, axis=1) / size


def half_width(cells: Cells, planes: int) -> float:
    """Half width at half power of the sharpest pole that the spectra show, Hz."""
    width = float(np.median(np.diff(cells.frequency)))
    poles = spectral_poles(cells.frequency, cells.power, width, 2 * planes + 2)
    return float(np.min(-poles.s[poles.share > LEAST_SHARE].real) / (2 * np.pi))
