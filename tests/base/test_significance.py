"""Probabilities beside SciPy's."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from rotorfit.base.significance import chance_of_square


@pytest.mark.parametrize("freedom", [0.3, 1, 2, 3, 5.5, 23, 100, 1e3, 1e5])
def test_chance_of_a_sum_of_squares(freedom: float) -> None:
    squares = np.r_[-1.0, 0.0, np.geomspace(1e-3, 20, 40) * freedom]
    found = [chance_of_square(float(square), freedom) for square in squares]
    assert found == pytest.approx(chi2.sf(squares, freedom), rel=1e-9, abs=1e-300)  # of exp(1e4) in 1e5 degrees
