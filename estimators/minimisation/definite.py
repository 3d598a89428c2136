"""Whether matrices are surely far enough from singular: a determinant asks less than eigenvalues."""

from __future__ import annotations

import math

import numpy as np

from rotorfit.models.array_types import Float


def surely_above(unit: Float, least: float) -> bool:
    """Whether all eigenvalues of symmetric matrices of unit diagonal are surely above a limit.

    Eigenvalues but the smallest sum up to the size of the matrix at most, so that their product is below e: the
    determinant over e bounds the smallest.
    """
    try:
        pivots = np.diagonal(np.linalg.cholesky(unit), axis1=-2, axis2=-1)
    except np.linalg.LinAlgError:
        return False
    return bool((pivots.prod(axis=-1) ** 2 > math.e * least).all())
