"""Which of one set belongs to which of another, each taken once."""

from __future__ import annotations

import numpy as np

from rotorfit.base.array_types import ComplexArray, Float, Index


def cheapest_rows(cost: Float) -> Index:
    """Row for each column, no row twice, so that the sum of their costs is least."""
    nearest: Index = cost.argmin(axis=0)
    if np.unique(nearest).size == nearest.size:  # no two want the same: nothing can be cheaper
        return nearest
    from scipy.optimize import linear_sum_assignment  # takes long to import, and modes seldom come that close

    columns: Index = linear_sum_assignment(cost.T)[1]
    return columns


def matched(values: ComplexArray, reference: ComplexArray) -> ComplexArray:
    """Values of each row ``(N, n)`` that belong to those of a reference ``(m,)``, or ``(N, m)``, each used once."""
    distance = np.abs(values[:, :, None] - reference[..., None, :])
    distance = np.where(np.isfinite(distance), distance, 1e300)
    order = distance.argmin(axis=1)
    ranked = np.sort(order, axis=1)
    for row in np.flatnonzero((ranked[:, 1:] == ranked[:, :-1]).any(axis=1)):
        order[row] = cheapest_rows(distance[row])
    return np.asarray(np.take_along_axis(values, order, axis=1))
