"""Columns that act on the readings of one channel alone, taken out of a linearised fit channel by channel.

What a probe's own numbers follow is a subspace of its own readings. Least squares with these columns are least squares
of what is left of all others without them (Frisch and Waugh's theorem), at any weights.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rotorfit.base.array_types import ComplexArray, Float, Index


@dataclass(frozen=True, eq=False, kw_only=True)
class OwnColumns:
    """Derivatives of the readings of a channel by numbers that act on no others."""

    readings: Index  # shape ``(m,)``
    rows: ComplexArray  # shape ``(k, m)``


def own_basis(own: Sequence[OwnColumns], scale: Float) -> ComplexArray:
    """Orthonormal columns that span those of each channel over a scale, shape ``(R, most k)``; the columns of several
    channels share a place, as no reading has more than its own."""
    found = np.zeros((scale.size, max((len(one.rows) for one in own), default=0)), dtype=complex)
    for one in own:
        rows = np.ascontiguousarray(one.rows / scale[one.readings]).view(float)
        size = np.linalg.norm(rows, axis=1)
        rows = rows / np.where(size > 0, size, 1.0)[:, None]
        power, vectors = np.linalg.eigh(rows @ rows.T)
        kept = power > 1e-12 * power[-1]  # squares of singular values: others are combinations of these
        basis = (vectors[:, kept] / np.sqrt(power[kept])).T @ rows
        found[one.readings[:, None], np.arange(len(basis))] = basis.view(complex).T
    return found


def without(own: Sequence[OwnColumns], basis: ComplexArray, columns: ComplexArray) -> ComplexArray:
    """What is left of columns, shape ``(R, k)``."""
    left = columns.copy()
    for one in own:
        taken = np.ascontiguousarray(basis[one.readings].T).view(float)
        mine = np.ascontiguousarray(columns[one.readings].T).view(float)
        left[one.readings] = (mine - (mine @ taken.T) @ taken).view(complex).T
    return left
