"""The measured dynamic stiffness, frequency by frequency: the inverted matrix of responses (eqs 5 and 7)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rotorfit.estimators.blocks.observations import Responses
from rotorfit.models.array_types import ComplexArray, Float, Index


@dataclass(frozen=True, eq=False, kw_only=True)
class StiffnessMatrices:
    """Measured dynamic stiffness (eq. 7)."""

    frequency: Float  # rad/s, shape ``(N,)``; signed where forward and backward are apart
    speed: Float  # rad/s, shape ``(N,)``
    kappa: ComplexArray  # shape ``(N, n, n)``, N/m
    sigma: Float  # standard deviation of real and imaginary part of each entry, from the propagated noise, same shape
    first_line: Index  # line of the block that carries each frequency, shape ``(N,)``


def complete_lines(block: Responses) -> Responses:
    """The lines of a block that have a reading at every coordinate."""
    if block.imposed and len(block.model.coordinates) > 1:
        return block.lines(np.zeros(block.speed.size, dtype=bool))
    needed = 1 if block.imposed else len(block.model.coordinates)
    whole = np.bincount(block.line, minlength=block.speed.size) == needed
    return block if whole.all() else block.lines(whole)


def stiffness_matrices(block: Responses) -> StiffnessMatrices:
    """Invert the response matrix at every frequency at which all planes were forced (eqs 5 and 7). In models with x and
    y apart the forward and the backward run at ``|w|`` make the 2n columns of eq. (5). Frequencies whose forces or
    readings are incomplete, and singular response matrices, are left out."""
    block = complete_lines(block)
    n = len(block.model.coordinates)
    amplitude, sigma = block.amplitudes()
    w = block.frequency if block.model.frame == "z" else np.abs(block.frequency)
    keys = np.column_stack([block.group, _rounded(block.speed), _rounded(w)])
    _, index = np.unique(keys, axis=0, return_inverse=True)
    order = np.argsort(index.reshape(-1), kind="stable")
    size = np.bincount(index.reshape(-1))
    begin = np.cumsum(size) - size
    parts = []
    for count in np.unique(size[size >= n]).tolist():
        lines = order[begin[size == count][:, None] + np.arange(count)]
        A, F = np.swapaxes(amplitude[lines], 1, 2), np.swapaxes(block.force[lines], 1, 2)
        good = (np.linalg.matrix_rank(F) == n) & (np.linalg.matrix_rank(A) == n)
        lines, A, F = lines[good], A[good], F[good]
        # More runs than coordinates (repeats): least squares, kappa A = F.
        back = np.linalg.pinv(A)
        k = F @ back
        # d kappa = -kappa dA A^+, readings independent.
        variance = np.abs(k) ** 2 @ np.swapaxes(sigma[lines] ** 2, 1, 2) @ np.abs(back) ** 2
        parts.append((lines[:, 0], k, np.sqrt(variance)))
    if not parts:
        kappa, error = np.empty((0, n, n), dtype=complex), np.empty((0, n, n))
        return StiffnessMatrices(
            frequency=np.empty(0), speed=np.empty(0), kappa=kappa, sigma=error, first_line=np.empty(0, dtype=np.intp)
        )
    first, kappa, error = (np.concatenate(column) for column in zip(*parts, strict=True))
    sort = np.lexsort([w[first], block.speed[first], block.group[first]])
    first = first[sort]
    return StiffnessMatrices(
        frequency=w[first], speed=block.speed[first], kappa=kappa[sort], sigma=error[sort], first_line=first
    )


def _rounded(values: Float) -> Float:
    """Values rounded to nine digits, so that equal conditions compare equal after unit conversion."""
    size = np.abs(values).max(initial=0.0)
    return np.round(values / size, 9) if size else values
