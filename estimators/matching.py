"""Which of one set belongs to which of another, each taken once."""

from __future__ import annotations

import numpy as np

from rotorfit.models.array_types import Float, Index


def cheapest_rows(cost: Float) -> Index:
    """Row for each column, no row twice, so that the sum of their costs is least."""
    nearest: Index = cost.argmin(axis=0)
    if np.unique(nearest).size == nearest.size:  # no two want the same: nothing can be cheaper
        return nearest
    from scipy.optimize import linear_sum_assignment  # takes long to import, and modes seldom come that close

    columns: Index = linear_sum_assignment(cost.T)[1]
    return columns
