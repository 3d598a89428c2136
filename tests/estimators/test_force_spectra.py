"""Spectra of forces that nobody measured: their derivatives."""

from __future__ import annotations

import numpy as np
import pytest

from rotorfit.base.array_types import ComplexArray, Float
from rotorfit.estimators.blocks.force_spectra import ForceShape, adjoint, spectra_of


@pytest.mark.parametrize("shape", [ForceShape(), ForceShape("knots", True, True)], ids=str)
def test_slopes_are_those_of_differences(shape: ForceShape) -> None:
    rng = np.random.default_rng(1)
    force, _ = spectra_of(shape, np.linspace(3, 200, 7), 3, 3)
    numbers = rng.normal(size=force.size)
    seen = rng.normal(size=(14, 2, 3)) + 1j * rng.normal(size=(14, 2, 3))

    def values(numbers: Float) -> ComplexArray:
        root = seen @ force.root(numbers)
        return np.asarray(root @ adjoint(root))

    steps = 1e-5 * np.eye(numbers.size)
    differences = [(values(numbers + step) - values(numbers - step)) / 2e-5 for step in steps]
    slopes = np.swapaxes(force.slopes(numbers, seen), 0, 1)
    np.testing.assert_allclose(slopes, differences, atol=1e-8 * np.abs(slopes).max())
