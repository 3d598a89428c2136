"""Correction weights by least squares: the vibration that they leave, their limits and their errors.

With vibrations ``y`` and influences ``A`` the weights ``w`` make ``sum_c g_c |y_c + A_c w|^2`` as small as limits on
their sizes allow. The problem is convex. Errors of weights follow from those of ``y`` and ``A`` through the condition
that the gradient of the Lagrangian vanishes, along the limits where these are reached.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rotorfit.base.array_types import ROUND_OFF, Bool, ComplexArray, Float

_OWN_SHARE = 0.2
"""Share of a plane's influence that no combination of other planes reproduces, below which planes count as acting
alike: weights of such planes are large, oppose one another and follow the errors. The significance factor of Darlow,
Balancing of High-Speed Machinery, 1989, has the same size."""
_AT_LIMIT = 1e-6  # relative distance from a limit that is none


@dataclass(frozen=True, kw_only=True, eq=False)
class Correction:
    """Correction weights of P planes for C readings."""

    weight: ComplexArray  # shape ``(P,)``
    covariance: Float  # of the real parts, then the imaginary parts, NaN where no error is known, shape ``(2P, 2P)``
    left: ComplexArray  # vibration that the weights leave, shape ``(C,)``
    left_error: Float  # standard deviation of its real part and of its imaginary part, shape ``(C,)``
    at_limit: Bool  # weights as large as they may be, shape ``(P,)``


def correct(coefficients: ComplexArray, covariance: ComplexArray, importance: Float, limit: Float) -> Correction:
    """Weights within limits by vibration and influences ``(C, 1 + P)``, their covariance, and readings' importance."""
    y, A = coefficients[:, 0], coefficients[:, 1:]
    right = A.conj().T * importance
    normal, towards = right @ A, right @ y
    weight = _within(normal, towards, limit)
    at_limit = np.abs(weight) >= limit * (1 - _AT_LIMIT)
    left, left_error = remaining(coefficients, covariance, weight)
    share = np.concatenate([[1.0], weight])
    # Change of the gradient A^H g (y + A w) with the coefficients, and with their conjugates.
    direct = np.einsum("cq,c,i->qci", A.conj(), importance, share)
    folded = np.zeros_like(direct)
    for plane in range(weight.size):
        folded[plane, :, plane + 1] = importance * left
    plus, minus = ((direct + sign * folded).reshape(weight.size, -1) for sign in (1, -1))
    slope = np.block([[plus.real, -minus.imag], [plus.imag, minus.real]])
    pull = -((right @ left) * weight.conj()).real / np.maximum(np.abs(weight) ** 2, 1e-300)
    H = _real(normal + np.diag(np.where(at_limit, pull, 0.0)))
    free = _tangents(weight, at_limit)
    answer = free @ np.linalg.solve(free.T @ H @ free, free.T @ slope)
    return Correction(
        weight=weight,
        covariance=np.asarray(answer @ _real(covariance) @ answer.T),
        left=left,
        left_error=left_error,
        at_limit=at_limit,
    )


def remaining(coefficients: ComplexArray, covariance: ComplexArray, weight: ComplexArray) -> tuple[ComplexArray, Float]:
    """Vibration that weights leave, ``(C,)``, and the standard deviation of its real and of its imaginary part."""
    share = np.concatenate([[1.0], weight])
    count = len(coefficients)
    blocks = covariance.reshape(count, share.size, count, share.size)
    own = np.einsum("i,cicj,j->c", share, blocks, share.conj()).real
    return coefficients @ share, np.sqrt(np.maximum(own, 0.0))


def own_shares(influence: ComplexArray, importance: Float) -> Float:
    """Share of each plane's influence that no combination of the other planes reproduces, shape ``(P,)``."""
    columns = influence * np.sqrt(importance)[:, None]
    shares = np.ones(columns.shape[1])
    for plane in range(shares.size):
        others = np.delete(columns, plane, axis=1)
        if others.size:
            explained = others @ np.linalg.lstsq(others, columns[:, plane], rcond=None)[0]
            shares[plane] = np.linalg.norm(columns[:, plane] - explained) / np.linalg.norm(columns[:, plane])
    return shares


def confounded(influence: ComplexArray, importance: Float) -> Bool:
    """True for planes that act alike on the readings, shape ``(P,)``."""
    return own_shares(influence, importance) < _OWN_SHARE


def _within(normal: ComplexArray, towards: ComplexArray, limit: Float) -> ComplexArray:
    """Least-squares weights no larger than their limits."""
    free = -np.linalg.solve(normal, towards)
    if (np.abs(free) <= limit).all():
        return np.asarray(free)
    from scipy.optimize import minimize  # late: it loads much of SciPy

    size = np.minimum(limit, np.abs(free).max())
    H = _real(normal * np.outer(size, size))
    b = np.concatenate([(towards * size).real, (towards * size).imag])
    scale = float(np.abs(b).max())
    bounded = np.flatnonzero(np.isfinite(limit))
    parts = np.eye(limit.size)[bounded]
    parts = np.hstack([parts, parts])  # real and imaginary part of each bounded weight
    room = {
        "type": "ineq",
        "fun": lambda x: (limit / size)[bounded] ** 2 - parts @ x**2,
        "jac": lambda x: -2 * parts * x,
    }
    inside = free * np.minimum(1.0, limit / np.maximum(np.abs(free), ROUND_OFF)) / size
    found = minimize(
        lambda x: (x @ H @ x / 2 + b @ x) / scale,
        np.concatenate([inside.real, inside.imag]),
        jac=lambda x: (H @ x + b) / scale,
        constraints=room,
        method="SLSQP",
        options={"ftol": 1e-15, "maxiter": 500},
    )
    weight = (found.x[: limit.size] + 1j * found.x[limit.size :]) * size
    return np.asarray(weight * np.minimum(1.0, limit / np.maximum(np.abs(weight), ROUND_OFF * size)))


def _tangents(weight: ComplexArray, at_limit: Bool) -> Float:
    """Directions in which the weights may move, of real parts and of imaginary parts, one a column."""
    columns = []
    for plane, (value, fixed) in enumerate(zip(weight.tolist(), at_limit.tolist(), strict=True)):
        for move in [1j * value / abs(value)] if fixed else [1.0, 1j]:
            column = np.zeros(2 * weight.size)
            column[plane], column[plane + weight.size] = complex(move).real, complex(move).imag
            columns.append(column)
    return np.array(columns).T


def _real(matrix: ComplexArray) -> Float:
    """A complex matrix as the real one that acts on real parts above imaginary parts."""
    return np.block([[matrix.real, -matrix.imag], [matrix.imag, matrix.real]])
