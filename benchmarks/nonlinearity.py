"""Least-squares estimates to second order in the noise: where the Cramer-Rao bound stops applying."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rotorfit.base.array_types import Float
from rotorfit.estimators.misfit.problem import Problem


@dataclass(frozen=True, eq=False)
class SecondOrder:
    """What the noise does to least-squares estimates, to second order in the noise.

    Attributes:
        stderr: Cramer-Rao bound, the first order, shape ``(p,)``.
        bias: expected error (Box 1971) over ``stderr``, shape ``(p,)``.
        nonlinearity: standard deviation of the second-order term over ``stderr``, shape ``(p,)``.
    """

    stderr: Float
    bias: Float
    nonlinearity: Float


def second_order(problem: Problem, x: Float) -> SecondOrder:
    """Expand the least-squares estimate in powers of the noise about the truth.

    Be f the whitened predictions, J their Jacobian, ``C = inv(J^T J)`` and e the whitened noise. The error
    is d1 + d2 + ... with ``d1 = C J^T e`` and ``d2 = C (-J^T f''[d1, d1] / 2 + f''[d1]^T e_perp)``,
    where ``e_perp``, the noise that no parameter explains, is independent of d1. The first part of d2 is a
    quadratic form in the Gaussian d1, with mean ``tr(A C)`` and variance ``2 tr(A C A C)``; the second has
    mean zero.

    Args:
        problem: the fit; only its predictions and noise are used.
        x: true parameters, shape ``(p,)``.
    """
    size = np.abs(x)
    J = _real(problem.jacobian(x)[1]) * size  # by relative changes, so that one step suits all parameters
    curvature = np.empty((*J.shape, x.size))
    step = np.cbrt(np.finfo(float).eps)
    for k in range(x.size):
        change = np.zeros_like(x)
        change[k] = step * size[k]
        ahead, behind = (_real(problem.jacobian(x + sign * change)[1]) * size for sign in (1, -1))
        curvature[:, :, k] = (ahead - behind) / (2 * step)
    Q, R = np.linalg.qr(J)
    inverse = np.linalg.inv(R)
    C = inverse @ inverse.T
    A = -0.5 * np.einsum("im,mjk->ijk", inverse @ Q.T, curvature)
    AC = A @ C
    bias = np.trace(AC, axis1=1, axis2=2)
    along = 2 * np.einsum("ijk,ikj->i", AC, AC)
    # f'' without its part in the column space of J: E[v v^T] of v = f''[d1]^T e_perp, then C E[v v^T] C.
    flat = curvature.reshape(J.shape[0], -1)
    across = (flat - Q @ (Q.T @ flat)).reshape(curvature.shape)
    weighted = np.einsum("mjk,jl->mlk", across, np.linalg.cholesky(C), optimize=True).reshape(-1, x.size)
    scatter = C @ (weighted.T @ weighted) @ C
    stderr = np.sqrt(np.diag(C))
    return SecondOrder(stderr * size, bias / stderr, np.sqrt(along + np.diag(scatter)) / stderr)


def _real(values: NDArray[np.complex128]) -> Float:
    return np.concatenate([values.real, values.imag])
