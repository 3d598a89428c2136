"""Quadratics over vectors that are not negative, beside SciPy's non-negative least squares."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import nnls

from rotorfit.estimators.minimisation.non_negative import non_negative


@pytest.mark.parametrize("seed", range(30))
def test_least_squares_by_their_products(seed: int) -> None:
    rng = np.random.default_rng(seed)
    size = int(rng.integers(1, 30))
    columns, values = rng.normal(size=(size + 3, size)), rng.normal(size=size + 3)
    if seed % 3 == 0:  # two columns that hardly differ
        columns[:, size // 2] = columns[:, 0] + 1e-3 * columns[:, size // 2]
    free = rng.random(size) < 0.5  # any begin leads there
    found = non_negative(columns.T @ columns, columns.T @ values, free)
    _, least = nnls(columns, values)
    assert (found >= 0).all()
    assert np.linalg.norm(columns @ found - values) == pytest.approx(least, rel=1e-9)
