"""Many vectors at once against one at a time."""

from __future__ import annotations

import numpy as np
import pytest

from rotorfit.estimators.misfit.kernels import Batch
from rotorfit.estimators.misfit.problem import robust_weights


def check(problem, x, accelerate):
    """Against residuals and their derivatives, reading by reading; gradients to the round-off of their terms."""
    batch = Batch(problem, accelerate=accelerate)
    assert batch.compiled == bool(accelerate and len(problem.space.model.coordinates) <= 2)
    costs, gradients = batch.cost_and_gradient(x)
    np.testing.assert_allclose(batch.channel_sums(x).sum(axis=1), 2 * costs, rtol=1e-12)
    sums = problem.evaluate(x)
    for i, row in enumerate(x):
        residuals, jacobian = problem.jacobian(row)
        rho, weight = robust_weights(problem.loss, np.abs(residuals) ** 2)
        expected, slope = rho.sum() / 2, ((weight * residuals).conj() @ jacobian).real
        matrix = ((weight[:, None] * jacobian).conj().T @ jacobian).real
        size = np.sqrt(np.diag(matrix))
        for cost, gradient in ((costs[i], gradients[i]), (sums[0][i], sums[1][i])):
            assert cost == pytest.approx(expected, rel=1e-10)
            assert (np.abs(gradient - slope) < 1e-9 * np.sqrt(2 * expected) * size + 1e-300).all()
        assert (np.abs(sums[2][i] - matrix) < 1e-10 * np.outer(size, size) + 1e-300).all()
