"""Readings x and y put together as motion in the direction of the force and against it."""

from __future__ import annotations

import numpy as np

from rotorfit.models.array_types import Bool, ComplexArray, Float, Index


def directional(response: ComplexArray, rows: Index, backward: Bool) -> tuple[ComplexArray, ComplexArray]:
    """Motion in the direction of the force, relative to ``exp(jwt)``, and against it, relative to ``exp(-jwt)``.

    ``Re(X exp(j|w|t)) + j Re(Y exp(j|w|t))`` is ``(X + jY)/2`` forward and ``conj(X - jY)/2`` backward. What one probe
    reads alone is taken for that of a circular orbit, ``Y = -jX`` forward and ``Y = +jX`` backward; a reading z is
    motion in the direction of the force as it is, and counts where neither x nor y was read.

    Returns:
        both, shape ``(..., M)``; NaN in the first where nothing was read, in the second without an x/y pair.
    """
    seen, turn = rows >= 0, np.where(backward, -1j, 1j)
    right = np.where(seen[:, 2], response[..., rows[:, 2]], np.nan)
    wrong = np.full(right.shape, np.nan, dtype=complex)
    x, y, pair = (
        np.flatnonzero(some) for some in (seen[:, 0] & ~seen[:, 1], seen[:, 1] & ~seen[:, 0], seen[:, 0] & seen[:, 1])
    )
    if x.size:
        right[..., x] = _folded(response[..., rows[x, 0]], backward[x])
    if y.size:
        right[..., y] = _folded(response[..., rows[y, 1]] * turn[y], backward[y])
    if pair.size:
        along, across = response[..., rows[pair, 0]], response[..., rows[pair, 1]] * turn[pair]
        right[..., pair] = _folded((along + across) / 2, backward[pair])
        wrong[..., pair] = _folded((along - across) / 2, ~backward[pair])
    return right, wrong


def _folded(values: ComplexArray, backward: Bool) -> ComplexArray:
    """Conjugates where a phasor relative to exp(j|w|t) is that of motion backward."""
    return np.where(backward, values.conj(), values)


def directional_noise(sigma: Float, rows: Index) -> Float:
    """Standard deviation of each part of the motion in the direction of the force, shape ``(..., M)``."""
    seen = rows >= 0
    noise = np.where(seen[:, 2], sigma[..., rows[:, 2]], np.nan)
    for axis in (1, 0):
        if seen[:, axis].any():
            noise = np.where(seen[:, axis], sigma[..., rows[:, axis]], noise)
    both = np.flatnonzero(seen[:, 0] & seen[:, 1])
    if both.size:
        noise[..., both] = np.sqrt(sigma[..., rows[both, 0]] ** 2 + sigma[..., rows[both, 1]] ** 2) / 2
    return noise
