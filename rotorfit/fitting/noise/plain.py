"""Residuals of many runs of one plan: which of them are plainly the noise of the data."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rotorfit.estimators.misfit.problem import Problem
from rotorfit.estimators.misfit.run_stack import RunStack
from rotorfit.estimators.noise.correlation import neighbours
from rotorfit.estimators.noise.noise_levels import fit_probes, likelihood
from rotorfit.estimators.noise.run_effects import inverse_of_determined, powers
from rotorfit.fitting.noise.search import AGREES, GAIN, RESPONSE, channels_of, forgetful, made_good
from rotorfit.models.array_types import Float


def plain_noise(stack: RunStack, x: Float) -> tuple[NDArray[np.bool_], Float]:
    """Which runs :func:`~rotorfit.fitting.noise.search.search_noise` would find as their noise says, shape ``(W,)``.

    They are those within half of the limits from which it looks closer.

    Returns:
        which they are, and the degrees of freedom of the noise of each.
    """
    r, rows = stack.jacobian(x)
    own = rows.view(float)
    _, gradient, matrix = stack.gauss_newton(x)
    outer = inverse_of_determined(matrix)
    step = -(outer @ gradient[..., None])
    left = (r.view(float) + (np.swapaxes(step, -1, -2) @ own)[:, 0]).view(complex)
    leverage = powers(outer @ own, own) / 2
    power, weight = made_good(left, leverage, stack.sigma)
    channels = channels_of(Problem(space=stack.space, blocks=(stack.layout,)))
    sweeps = [sweep for channel in channels for sweep in channel]
    plain = forgetful(*neighbours(left, rows, outer, sweeps))
    if stack.layout.told:
        ratio = np.sum(weight * power / stack.sigma**2, axis=1) / np.sum(weight, axis=1)
        return np.asarray(plain & (ratio <= AGREES)), np.full(len(x), np.inf)
    size2 = np.abs(stack.measured + r * stack.sigma) ** 2
    first = np.arange(len(x)) * stack.measured.shape[1]
    probes = [[sweep + start for sweep in channel] for start in first.tolist() for channel in channels]
    shapes = fit_probes(probes, power.ravel(), weight.ravel(), size2.ravel(), along=RESPONSE)
    likely = np.array([sum(shape.log_likelihood for shape in found) for found in shapes])
    gain = likely.reshape(len(x), -1).sum(axis=1) - likelihood(power, weight, stack.sigma**2)
    return np.asarray(plain & (2 * gain < GAIN / 2 * len(channels))), 2 * np.sum(weight, axis=1)
