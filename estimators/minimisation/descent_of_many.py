"""Gauss-Newton steps for many runs of one plan at once, as far as each search goes as smoothly as it should."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rotorfit.estimators.minimisation.descent import (
    APPROACHES,
    CHANGE_WEIGHT,
    COST_NOISE,
    HANDOVER,
    LEAST_SIZE,
    NEAR,
    REFINEMENTS,
    SINGULAR,
    SLOW,
    SLOW_REFINEMENT,
    exact_scale,
)
from rotorfit.estimators.minimisation.objective import Options, Solution, Status
from rotorfit.models.array_types import Float, Index

Normal = tuple[Float, Float, Float]


@dataclass(frozen=True, eq=False, kw_only=True)
class SmoothEnds:
    """Where the searches ended."""

    x: Float  # best points, shape ``(W, p)``
    normal: Normal  # cost, gradient and Gauss-Newton matrix there
    n_evaluations: Index  # evaluations with derivatives of each, shape ``(W,)``
    offset: Float  # what the tolerances are compared with, see :class:`Solution`, shape ``(W,)``
    smooth: NDArray[np.bool_]

    def solution(self, run: int) -> Solution:
        """How a smooth search ended, as if it had been done by itself."""
        return Solution(
            x=self.x[run].copy(),
            cost=float(self.normal[0][run]),
            status=Status.CONVERGED,
            n_iterations=int(self.n_evaluations[run]) - 1,
            n_evaluations=int(self.n_evaluations[run]),
            hessian="gauss-newton",
            offset=float(self.offset[run]),
        )


def smooth_descents(
    evaluate: Callable[[Float], Normal], start: Float, scale: Float, lower: Float, upper: Float, options: Options
) -> SmoothEnds:
    """Undamped Gauss-Newton steps of many searches."""
    x, normal, scale = start, evaluate(start), exact_scale(scale)
    count = np.ones(len(x), dtype=np.intp)
    step, offset = _remaining(normal, x, scale)
    smooth = np.isfinite(offset) & (offset <= NEAR)
    for number in range(APPROACHES + REFINEMENTS):
        smooth &= (number < APPROACHES) | (offset <= HANDOVER)
        active = smooth & (offset > options.tolerance)
        if not active.any():
            break
        trial = np.where(active[:, None], x + step, x)
        smooth &= ((trial > lower) & (trial < upper)).all(axis=1)
        there = evaluate(trial)
        next_step, next_offset = _remaining(there, trial, scale)
        count[active] += 1
        near = offset <= HANDOVER
        allowed = normal[0] * np.where(near, 1 + COST_NOISE, 1.0)
        shrunk = next_offset <= np.where(near, SLOW_REFINEMENT, SLOW) * offset
        # The last digits may come from a step that round-off keeps from shrinking so much.
        shrunk |= near & (next_offset < offset) & (next_offset <= options.tolerance)
        smooth &= ~active | ((there[0] <= allowed) & shrunk)
        x, normal, step, offset = trial, there, next_step, np.where(active, next_offset, offset)
    size = np.sqrt(np.diagonal(normal[2], axis1=-2, axis2=-1))
    smooth &= (offset <= options.tolerance) & (size > 0).all(axis=1)
    size = np.where(size > 0, size, 1.0)
    unit = np.where(smooth[:, None, None], normal[2] / (size[:, :, None] * size[:, None, :]), np.eye(x.shape[1]))
    smooth &= np.linalg.eigvalsh(unit)[:, 0] >= SINGULAR
    return SmoothEnds(x=x, normal=normal, n_evaluations=count, offset=offset, smooth=smooth)


def _remaining(normal: Normal, x: Float, scale: Float) -> tuple[Float, Float]:
    """Step that remains, and its size relative to the misfit or to the variables, whichever is smaller."""
    cost, gradient, matrix = normal
    usable = np.isfinite(cost) & (cost > 0) & np.isfinite(gradient).all(axis=1) & np.isfinite(matrix).all(axis=(1, 2))
    unit = np.where(usable, cost, 1.0)[:, None]
    own = gradient * scale / unit
    curvature = matrix * (scale[:, :, None] * (scale / unit)[:, None, :])
    safe = np.where(usable[:, None, None], curvature, np.eye(x.shape[1]))
    try:
        np.linalg.cholesky(safe)
    except np.linalg.LinAlgError:  # of one run at least
        usable = usable & (np.linalg.eigvalsh(safe)[:, 0] > 0)
        safe = np.where(usable[:, None, None], curvature, np.eye(x.shape[1]))
    step = np.linalg.solve(safe, -np.where(usable[:, None], own, 0.0)[..., None])[..., 0]
    offset = np.sqrt(np.maximum(np.einsum("wi,wij,wj->w", step, safe, step), 0.0) / 2)
    change = (np.abs(step) / np.maximum(np.abs(x / scale), LEAST_SIZE)).max(axis=1)
    return step * scale, np.where(usable, np.minimum(offset, CHANGE_WEIGHT * change), np.inf)
