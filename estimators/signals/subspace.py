"""Poles of a rotor by subspace identification of its spectra: a start for fits, and a second opinion."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from rotorfit.base.array_types import ComplexArray, Float

SPAN = 0.25
"""Longest lag over one by the width of a cell: averaging over a cell takes a tenth of the covariance there."""
LEAST_SHARE = 0.03
"""Share in the variance of a record from which a pole is one of the rotor, not of what is left over."""
MOST_ROWS = 160  # signals times lags of the matrix of covariances: what its decomposition needs is a tenth of a second


class Poles(NamedTuple):
    """Poles of ``q' = A q, z = C q``, those of the largest share first."""

    s: ComplexArray  # 1/s, shape ``(m,)``
    shapes: ComplexArray  # deflection of each signal, shape ``(n, m)``
    share: Float  # of each in the variance of z, shape ``(m,)``


def spectral_poles(frequency: Float, power: ComplexArray, width: float, order: int) -> Poles:
    """Poles that spectra show, as many as states are asked for.

    Covariance-driven subspace identification (Van Overschee and De Moor 1996) of the complex signal, sampled at twice
    the highest frequency.

    Args:
        frequency: middle of the cells, Hz, positive, shape ``(K,)``.
        power: spectra of ``[z(w); conj z(-w)]`` there, shape ``(K, 2n, 2n)``.
        width: of a cell, Hz.
        order: number of states.
    """
    n = power.shape[-1] // 2
    at = np.concatenate([-frequency[::-1], frequency])
    two_sided = np.concatenate([power[::-1, n:, n:].conj(), power[:, :n, :n]])
    top = float(frequency[-1]) + width / 2
    grid = np.arange(-top + width / 2, top, width)
    flat = two_sided.reshape(at.size, -1)
    even = np.array([np.interp(grid, at, part.real) + 1j * np.interp(grid, at, part.imag) for part in flat.T]).T
    step = 1 / (2 * top)
    lags = max(int(min(SPAN / width / step, MOST_ROWS / n)), order + 1)
    turn = np.exp(2j * np.pi * np.outer(np.arange(2 * lags), grid) * step)
    covariance = (turn @ even * width).reshape(2 * lags, n, n)
    level = np.einsum("ii->i", covariance[0]).real ** 0.5  # planes count alike, whatever their motion
    covariance /= level[:, None] * level
    blocks = np.array([[covariance[i + j + 1] for j in range(lags)] for i in range(lags)])
    left, size, right = np.linalg.svd(blocks.transpose(0, 2, 1, 3).reshape(lags * n, lags * n))
    root = np.sqrt(size[:order])
    seen, reached = left[:, :order] * root, root[:, None] * right[:order]
    ahead = np.linalg.lstsq(seen[:-n], seen[n:], rcond=None)[0]
    poles, shapes = np.linalg.eig(ahead)
    # what each adds to the covariance at the first lag, on its way back to none
    own = np.abs(np.einsum("ik,ki->k", seen[:n] @ shapes, np.linalg.solve(shapes, reached[:, :n]) / poles[:, None]))
    rates = np.log(poles) / step
    order_of_size = np.argsort(-own)
    stable = -np.abs(rates.real) + 1j * rates.imag  # a stable rotor and its mirror image have one spectrum
    deflections = level[:, None] * (seen[:n] @ shapes)
    return Poles(stable[order_of_size], deflections[:, order_of_size], own[order_of_size] / own.sum())
