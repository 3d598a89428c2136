"""Common poles of many responses by relaxed vector fitting (Gustavsen and Semlyen 1999, Gustavsen 2006).

Each response times a scalar function sigma(s) is a sum over trial poles, and so is sigma, whose zeros are the next
trial poles. What belongs to one response alone is eliminated by a QR factorisation of its own equations (Deschrijver et
al. 2008), so that the work grows with the responses and not with their square. Partial fractions stay well conditioned
where polynomials in s do not. (SciPy's AAA takes one response without noise.)
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from rotorfit.models.array_types import ComplexArray, Float


class Response(NamedTuple):
    """Readings of one response."""

    frequency: Float  # signed, rad/s, shape ``(L,)``
    value: ComplexArray  # shape ``(L,)``
    weight: Float  # one over the standard deviation of each, shape ``(L,)``


def common_poles(responses: Sequence[Response], pairs: int) -> ComplexArray:
    """Stable poles with positive imaginary part common to all responses, rad/s, ascending; none that become real."""
    top = max(float(np.abs(one.frequency).max()) for one in responses)
    low = min(float(np.abs(one.frequency).min()) for one in responses) / top
    damping = 0.01  # of the trial poles at the beginning: between lightly and well damped
    at = np.linspace(max(low, 0.5 / pairs), 1.0, pairs + 2)[1:-1] if pairs > 1 else np.array([np.sqrt(max(low, 0.1))])
    poles = np.asarray(at * (1j - damping), dtype=complex)
    real: Float = np.zeros(0)
    for _ in range(12):
        before = poles
        poles, real = _relocated(responses, top, poles, real)
        if poles.size == before.size and np.abs(poles - before).max(initial=0.0) < 1e-6:
            break
    return np.asarray(poles * top, dtype=complex)


def _relocated(
    responses: Sequence[Response], top: float, poles: ComplexArray, real: Float
) -> tuple[ComplexArray, Float]:
    """Zeros of sigma, turned to the stable side: those with positive imaginary part, and real ones."""
    rows: list[Float] = []
    total: ComplexArray = np.zeros(2 * poles.size + real.size + 1, dtype=complex)
    for one in responses:
        s = np.asarray(1j * one.frequency / top)
        sigma = _basis(s, poles, real)
        own = np.hstack([_partial_fractions(s, poles, real), np.ones((s.size, 1))])
        size = np.sqrt(np.mean(np.abs(one.value * one.weight) ** 2)) or 1.0
        A = np.hstack([own, 1j * own, -one.value[:, None] * sigma]) * (one.weight / size)[:, None]
        factor = np.asarray(np.linalg.qr(np.concatenate([A.real, A.imag]), mode="r"))
        rows.append(factor[2 * own.shape[1] :, 2 * own.shape[1] :])
        total = total + sigma.sum(axis=0)
    strength = float(np.sqrt(sum(np.sum(row**2) for row in rows)))
    mean = total.real / sum(one.frequency.size for one in responses)
    relaxed = mean[None, :] * strength  # sigma is one on average, which keeps noise from pulling it to zero
    A, b = np.concatenate([*rows, relaxed]), np.zeros(sum(map(len, rows)) + 1)
    b[-1] = strength
    columns = np.linalg.norm(A, axis=0)
    columns = np.where(columns > 0, columns, 1.0)
    c = np.linalg.lstsq(A / columns, b, rcond=1e-12)[0] / columns
    least = 1e-8  # constant of sigma below which dividing by it says nothing
    zeros = np.linalg.eigvals(_state_matrix(poles, real, c[:-1] / (c[-1] if abs(c[-1]) > least else least)))
    zeros = np.where(zeros.real > 0, -zeros.conj(), zeros)
    straight = np.abs(zeros.imag) <= 1e-9 * np.abs(zeros)
    found = zeros[(zeros.imag > 0) & ~straight]
    return found[np.argsort(np.abs(found))], zeros[straight].real


def _partial_fractions(s: ComplexArray, poles: ComplexArray, real: Float) -> ComplexArray:
    """One over the distance to every pole, conjugates included, shape ``(L, 2 n + r)``."""
    every = np.concatenate([poles, poles.conj(), real])
    return np.asarray(1 / (s[:, None] - every))


def _basis(s: ComplexArray, poles: ComplexArray, real: Float) -> ComplexArray:
    """Terms of sigma with real coefficients: two for a pair of poles, one for a real pole, and a constant."""
    ahead, behind = 1 / (s[:, None] - poles), 1 / (s[:, None] - poles.conj())
    single = 1 / (s[:, None] - real)
    return np.hstack([ahead + behind, 1j * (ahead - behind), single, np.ones((s.size, 1))])


def _state_matrix(poles: ComplexArray, real: Float, c: Float) -> Float:
    """Matrix whose eigenvalues are the zeros of ``1 + sum c_i basis_i``."""
    n, size = poles.size, 2 * poles.size + real.size
    A, b = np.zeros((size, size)), np.zeros(size)
    first, second = np.arange(n), np.arange(n, 2 * n)
    A[first, first] = A[second, second] = poles.real
    A[first, second], A[second, first] = poles.imag, -poles.imag
    b[first] = 2.0
    A[np.arange(2 * n, size), np.arange(2 * n, size)], b[2 * n :] = real, 1.0
    return A - np.outer(b, c)
