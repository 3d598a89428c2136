"""Vectors by windows of whole turns, what tracking filters do, and responses where a frequency dwells.

In each window least squares finds the components that turn with the drive, against it and with the orders of the shaft,
all with constant amplitude. While the frequency is swept at the rate ``w'`` a response H lags behind: it is off by
``-(j/2) w' H''(w)`` and more. Where the frequency dwells, or for slow sweeps, and for a rotor whose response depends on
its amplitude, windows are the right thing; otherwise :mod:`rotorfit.estimators.signals.local_response`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from rotorfit.base.array_types import Bool, ComplexArray, Float, Index
from rotorfit.base.digits import significant
from rotorfit.estimators.signals.local_response import RecordSpectra, seen

LEAST_TURNS_APART = 1.0
"""Turns over the window by which an order has to differ from the drive to be distinguished from it."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Tracked:
    """Components in W windows."""

    centre: Index  # sample in the middle of each window, shape ``(W,)``
    along: ComplexArray  # amplitude of what turns with the drive, relative to ``exp(j angle)``, shape ``(P, W)``
    against: ComplexArray  # amplitude of what turns against it, relative to ``exp(-j angle)``, shape ``(P, W)``
    sigma: Float  # standard deviation of the real part and of the imaginary part of both, shape ``(P, W)``
    clear: Bool  # whether no order of the shaft was too near to the drive to be distinguished, shape ``(W,)``


def track_windows(motion: ComplexArray, angle: Float, shaft: Float | None, *, turns: int) -> Tracked:
    """Components of signals in windows of whole turns of the drive."""
    number = np.floor(np.abs(angle - angle[0]) / (2 * np.pi * turns)).astype(np.intp)
    edges = np.searchsorted(number, np.arange(number[-1] + 1))
    if edges.size < 2:
        raise ValueError(f"the record holds less than {turns} turns of the drive")
    windows = [slice(int(a), int(b)) for a, b in pairwise(edges)]
    found = [_window(motion[:, w], angle[w], None if shaft is None else shaft[w]) for w in windows]
    along, against, sigma, clear = (np.array(part) for part in zip(*found, strict=True))
    return Tracked(
        centre=np.array([(w.start + w.stop) // 2 for w in windows], dtype=np.intp),
        along=along.T,
        against=against.T,
        sigma=sigma.T,
        clear=clear,
    )


def _window(motion: ComplexArray, angle: Float, shaft: Float | None) -> tuple[ComplexArray, ComplexArray, Float, bool]:
    turn = np.exp(1j * angle)
    columns, clear = [turn, turn.conj(), np.ones(turn.size, dtype=complex)], True
    if shaft is not None:
        drive, shaft_turns = angle[-1] - angle[0], shaft[-1] - shaft[0]
        for n in [n for n in range(-5, 6) if n]:
            apart = min(abs(n * shaft_turns - drive), abs(n * shaft_turns + drive)) / (2 * np.pi)
            if apart > LEAST_TURNS_APART:
                columns.append(np.exp(1j * n * shaft))
            else:
                clear = False
    amplitude, noise, share = _fitted(np.array(columns).T, motion)
    return amplitude[0], amplitude[1], noise * share, clear


def _fitted(basis: ComplexArray, signals: ComplexArray) -> tuple[ComplexArray, Float, float]:
    """Amplitudes of columns in signals ``(P, N)``, noise ``sqrt(E |N|^2)`` of these, and over it the standard deviation
    of either part of the first amplitude."""
    scale = np.linalg.norm(basis, axis=0)
    q, r = np.linalg.qr(basis / scale)
    inverse = np.linalg.inv(r) / scale[:, None]
    amplitude = inverse @ (q.conj().T @ signals.T)
    left = signals.T - basis @ amplitude
    noise = np.sqrt(np.sum(np.abs(left) ** 2, axis=0) / max(basis.shape[0] - basis.shape[1], 1))
    return amplitude, noise, float(np.linalg.norm(inverse[0]) / np.sqrt(2))


def order_vectors(z: ComplexArray, angles: Sequence[Float], orders: int) -> ComplexArray:
    """Coefficients of ``exp(j k angle)`` of several references in one window, ``(references, 2 orders + 1)``, ``k``
    from ``-orders``, the mean with the first; NaN where angles drift apart by less than a turn, or from the mean. Meant
    for figures and nonlinear tests, as tracking filters are."""
    rows, columns = [np.ones(z.shape[-1], dtype=complex)], [(0, orders)]
    found = np.zeros((len(angles), 2 * orders + 1, *z.shape[:-1]), dtype=complex)
    turned = [abs(angle[-1] - angle[0]) for angle in angles]
    for i, angle in enumerate(angles):
        if turned[i] <= 2 * np.pi or any(abs(turned[i] - other) <= 2 * np.pi for other in turned[:i]):
            found[i] = np.nan
            continue
        for k in range(1, orders + 1):
            rows += [np.exp(1j * k * angle), np.exp(-1j * k * angle)]
            columns += [(i, orders + k), (i, orders - k)]
    basis = np.stack(rows)
    weighted = basis.conj() * np.hanning(z.shape[-1] + 2)[1:-1]
    solution = np.linalg.lstsq(weighted @ basis.T, weighted @ z.T, rcond=None)[0]
    for (i, column), value in zip(columns, solution, strict=True):
        found[i, column] = value
    return found


LINES_BESIDE = 14
"""Lines of the spectrum to each side of the force. Chosen."""
FEWEST_TURNS = 10.0
"""Turns of the force in the shortest dwell. Chosen."""
DWELL_SPEED_RANGE = 0.01
"""Largest range of the speed within a dwell over its mean. Chosen."""


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
    dwell_speed_rate = 0.1  # rate of the speed over its mean rate of a sweep below which it dwells. Chosen.
    still = (
        np.abs(np.gradient(mean, middle)) < dwell_speed_rate * spread / length if mean.size > 2 else np.zeros(0, bool)
    )
    ends = np.flatnonzero(np.diff(np.concatenate([[False], still, [False]]).astype(np.int8)))
    found = []
    for first, last in zip(ends[::2].tolist(), ends[1::2].tolist(), strict=True):
        begin, end = int(edges[first]), int(edges[last])
        inside = mean[first:last]
        turns = abs(angle[end] - angle[begin]) / (2 * np.pi)
        if turns >= FEWEST_TURNS and np.ptp(inside) <= DWELL_SPEED_RANGE * abs(float(inside.mean())):
            found.append(slice(begin, end))
    least_dwelling_share = 0.5  # share of a record that dwells in a test of dwells. Chosen.
    return found if sum(part.stop - part.start for part in found) > least_dwelling_share * time.size else []


def dwell_response(spectra: RecordSpectra, at: float) -> DwellResponse:
    """Response of each output to the first force about one frequency. There the spectrum of a dwell obeys ``Z(k) =
    H F(k) + T(k) + sum_i c_i U_i(k) + noise``: H one number, T the transient that the dwell begins with (a polynomial
    of second degree), U_i what is locked to the shaft: the method of local responses with a single band."""
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
    response, noise, share = _fitted(matrix, spectra.outputs[:, lines])
    return DwellResponse(response[0], noise * share, noise)
