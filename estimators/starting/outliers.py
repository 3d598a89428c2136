"""Gross outliers discounted before a start is looked for: one would carry a closed form away."""

from __future__ import annotations

import numpy as np

from rotorfit.estimators.blocks.observations import Block
from rotorfit.estimators.misfit.losses import LOSS_SCALE
from rotorfit.estimators.misfit.problem import Problem
from rotorfit.estimators.starting.closed_form import closed_form
from rotorfit.estimators.starting.start_points import full_vector


def without_outliers(problem: Problem) -> tuple[Block, ...]:
    """Blocks whose gross outliers carry a larger sigma, found by closed forms that discount what the last one missed.

    The scale of the residuals is their own median, so that a start that is far off does not take all for outliers.
    """
    blocks = problem.blocks
    before = np.zeros(0)
    tolerance = 0.05  # relative change of all values between rounds from which more of them make no better start
    for number in range(8):
        values = closed_form(problem.space, blocks, passes=32).x
        if number and np.all(np.abs(values - before) <= tolerance * np.abs(values)):
            break
        before = values
        size = np.abs(problem.residuals(full_vector(problem, values)))
        # The median modulus of pure noise is sqrt(2 ln 2) sigma.
        scale = max(1.0, float(np.median(size)) / np.sqrt(2 * np.log(2)))
        widening = np.maximum(1.0, size / (LOSS_SCALE * scale)) ** 2
        parts = np.split(widening, np.cumsum([block.measured.size for block in problem.blocks])[:-1])
        blocks = tuple(block.with_noise(part) for block, part in zip(problem.blocks, parts, strict=True))
    return blocks
