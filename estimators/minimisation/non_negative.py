"""The minimum of a quadratic over vectors that are nowhere negative, without loading SciPy's optimisation."""

from __future__ import annotations

import numpy as np

from rotorfit.base.array_types import ROUND_OFF, Bool, Float


def non_negative(matrix: Float, vector: Float, free: Bool) -> Float:
    """The ``x >= 0`` with the least ``x' A x / 2 - b' x``, by block principal pivoting (Kim and Park, SIAM J. Sci.
    Comput. 33 (2011) 3261, algorithm 1).

    Args:
        matrix: A, symmetric and positive definite, shape ``(k, k)``.
        vector: b, shape ``(k,)``.
        free: entries that are probably not at zero, at which the search begins.
    """
    fewest, chances = vector.size + 1, 3
    free = free.copy()
    while True:
        x = np.zeros(vector.size)
        x[free] = np.linalg.solve(matrix[np.ix_(free, free)], vector[free])
        slope = matrix @ x - vector
        least = -ROUND_OFF * np.where(free, np.abs(x).max(), np.abs(vector).max())
        wrong = np.flatnonzero(np.where(free, x, slope) < least)
        if not wrong.size:
            return np.maximum(x, 0.0)
        if wrong.size < fewest:
            fewest, chances = wrong.size, 3
        elif chances > 0:
            chances -= 1
        else:  # one at a time, the last one first, comes to an end always
            wrong = wrong[-1:]
        free[wrong] = ~free[wrong]
