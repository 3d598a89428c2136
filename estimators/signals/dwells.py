"""Frequency responses where a frequency dwells: local models of the spectrum about it, and stretches that count.

About the frequency of the force the spectrum of a dwell obeys ``Z(k) = H F(k) + T(k) + sum_i c_i U_i(k) + noise``: H
one number, T the transient that the dwell begins with (a polynomial of second degree), U_i what is locked to the shaft.
It is the method of :mod:`rotorfit.estimators.signals.local_response` with a single band.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from rotorfit.estimators.signals.local_response import RecordSpectra, seen
from rotorfit.models.array_types import ComplexArray, Float
from rotorfit.models.digits import significant

LINES_BESIDE = 14
"""Lines of the spectrum to each side of the force. Chosen."""
FEWEST_TURNS = 10.0
"""Turns of the force in the shortest dwell. Chosen."""
DWELL_SPEED_RANGE = 0.01
"""Largest range of the speed within a dwell over its mean. Chosen."""
_DWELL_SPEED_RATE = 0.1
"""Rate of the speed over its mean rate of a sweep below which it dwells. Chosen."""
_LEAST_DWELLING_SHARE = 0.5
"""Share of a record that dwells in a test of dwells. Chosen."""


class DwellResponse(NamedTuple):
    """Responses of P outputs at one frequency."""

    response: ComplexArray  # output over force, shape ``(P,)``
    sigma: Float  # standard deviation of its real part and of its imaginary part, shape ``(P,)``
    noise: Float  # of the spectrum, ``sqrt(E |N|^2)``, shape ``(P,)``


def dwells(time: Float, angle: Float, speed: Float) -> list[slice]:
    """Stretches in which a frequency dwells; none where it sweeps for most of the record."""
    spread, length = float(np.ptp(speed)), float(time[-1] - time[0])
    if spread <= DWELL_SPEED_RANGE * float(np.abs(speed).mean()):
        return [slice(0, time.size)]
    # mean speeds of blocks of turns, in which what is left of the jitter of marks averages out
    block_turns = 2.0  # turns over which speeds are averaged to see whether they change
    number = np.floor(np.abs(angle - angle[0]) / (2 * np.pi * block_turns)).astype(np.intp)
    edges = np.searchsorted(number, np.arange(number[-1] + 1))
    middle, mean = (time[edges[1:]] + time[edges[:-1]]) / 2, np.diff(angle[edges]) / np.diff(time[edges])
    still = (
        np.abs(np.gradient(mean, middle)) < _DWELL_SPEED_RATE * spread / length if mean.size > 2 else np.zeros(0, bool)
    )
    ends = np.flatnonzero(np.diff(np.concatenate([[False], still, [False]]).astype(np.int8)))
    found = []
    for first, last in zip(ends[::2].tolist(), ends[1::2].tolist(), strict=True):
        begin, end = int(edges[first]), int(edges[last])
        inside = mean[first:last]
        turns = abs(angle[end] - angle[begin]) / (2 * np.pi)
        if turns >= FEWEST_TURNS and np.ptp(inside) <= DWELL_SPEED_RANGE * abs(float(inside.mean())):
            found.append(slice(begin, end))
    return found if sum(part.stop - part.start for part in found) > _LEAST_DWELLING_SHARE * time.size else []


def dwell_response(spectra: RecordSpectra, at: float) -> DwellResponse:
    """Response of each output to the first force about one frequency."""
    step = float(spectra.frequency[1] - spectra.frequency[0])
    middle = round(at / step)
    half = min(LINES_BESIDE, middle - 1, spectra.frequency.size - 1 - middle)
    lines = slice(middle - half, middle + half + 1)
    degree = 2  # degree of the polynomial for the transient
    unknowns = degree + 2
    if 2 * half + 1 < 2 * unknowns:
        raise ValueError(f"{significant(at * 2 * np.pi / step, 3)} turns are too few for a dwell")
    smooth = np.polynomial.legendre.legvander(np.linspace(-1, 1, 2 * half + 1), degree).astype(complex)
    # The shaft's orders beside it; half the lines stay free.
    greatest, most = np.abs(spectra.others).max(axis=1, initial=0.0), (2 * half + 1) // 2 - unknowns
    orders = seen(spectra.others[:, lines].T, smooth, greatest, most)
    matrix = np.column_stack([spectra.forces[0, lines], smooth, orders])
    scale = np.linalg.norm(matrix, axis=0)
    q, r = np.linalg.qr(matrix / scale)
    inverse = np.linalg.inv(r)[0] / scale[0]
    measured = spectra.outputs[:, lines].T
    projected = q.conj().T @ measured
    left = measured - q @ projected
    noise = np.sqrt(np.sum(np.abs(left) ** 2, axis=0) / (matrix.shape[0] - matrix.shape[1]))
    return DwellResponse(inverse @ projected, noise * float(np.sqrt(np.sum(np.abs(inverse) ** 2) / 2)), noise)
