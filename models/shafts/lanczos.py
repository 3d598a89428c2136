"""Chains of masses and springs as Jacobi matrices, and back (eqs 24 to 26).

Mode v of a chain in mass-scaled coordinates ``y_i = sqrt(M_i) z_i`` is row v of psi, and ``T = psi^T diag(w^2) psi`` is
tridiagonal: the Lanczos relation, so psi follows from its first column, a direction on the unit sphere. T fixes the
chain up to two numbers. Springs to ground at the ends alone mean that ``T d``, ``d_i = sqrt(M_i)``, vanishes at all
inner masses, so ``d = inv(T) (a, 0, ..., 0, b)``; a : b shares the ground stiffness between the ends, and their size
sets the total mass. T is an M-matrix: every a, b >= 0 gives positive masses and springs.

Lanczos' recursion itself, even with full reorthogonalisation, loses what a mode has at the start below round-off, and
modes of long chains are often confined far from it. Here the recursion's coefficients come from the qd algorithm, which
adds one mode after the other without any subtraction (after D. P. Laurie, J. Comput. Appl. Math. 112 (1999) 165), as
squares of the bidiagonal B in ``T = B^T B``; the frequencies then carry the round-off of w, not that of w^2.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from rotorfit.models.array_types import Float


def chain_modes(M: ArrayLike, K: ArrayLike) -> tuple[Float, Float]:
    """Natural frequencies and mass-normalised mode shapes of a chain.

    Args:
        M: masses, kg, shape ``(n,)``, positive.
        K: springs, N/m, shape ``(n + 1,)``, not negative; the first and the last lead to ground.

    Returns:
        frequencies, rad/s, ascending, shape ``(n,)``; shapes, 1/sqrt(kg), a column a mode, positive at the first mass,
        shape ``(n, n)``.

    Raises:
        ValueError: masses or springs of the wrong number or sign.
    """
    m, k = np.asarray(M, dtype=float), np.asarray(K, dtype=float)
    if m.ndim != 1 or k.shape != (m.size + 1,):
        raise ValueError(f"n masses sit between n + 1 springs; got {m.shape} masses and {k.shape} springs")
    if not ((m > 0).all() and (k >= 0).all()):
        raise ValueError(f"masses must be positive and springs not negative; got M = {m}, K = {k}")
    stretch = np.eye(m.size + 1, m.size) - np.eye(m.size + 1, m.size, -1)
    _, w, rows = np.linalg.svd(np.sqrt(k)[:, None] * stretch / np.sqrt(m))
    shapes = rows[::-1].T / np.sqrt(m)[:, None]
    return w[::-1].copy(), shapes * np.where(shapes[0] < 0, -1.0, 1.0)


def bidiagonal(frequencies: Float, weights: Float) -> Float:
    """Upper bidiagonal B with ``psi^T diag(w^2) psi = B^T B`` for a given first column of psi. The modes are added in
    descending order of frequency. Between two, the matrix ``L L^T``, ``L = B^T``, of those there, with w^2 counted from
    the last one, is shifted by the positive gap to the next (stationary qd). The new mode then has w^2 = 0 and leaves
    ``L^T L`` unchanged but for a row."""
    w, mass = frequencies.tolist(), weights.tolist()
    q, e = [0.0], [0.0]
    total = mass[-1]
    for v in range(len(w) - 2, -1, -1):
        q, e = _shifted(q, e, (w[v + 1] - w[v]) * (w[v + 1] + w[v]))
        q, e = _with_zero(q, e, mass[v] / (total + mass[v]))
        total += mass[v]
    q, e = _shifted(q, e, w[0] ** 2)
    return np.asarray(np.diag(np.sqrt(q)) - np.diag(np.sqrt(e[:-1]), 1))


def _shifted(q: list[float], e: list[float], shift: float) -> tuple[list[float], list[float]]:
    """Squares of the factor's diagonal q and subdiagonal e after ``L L^T + shift``."""
    above, new_q, new_e = shift, [], []
    for square, below in zip(q, e, strict=True):
        pivot = square + above
        new_q.append(pivot)
        new_e.append(below * (square / pivot))
        above = shift + above * (below / pivot)
    return new_q, new_e


def _with_zero(q: list[float], e: list[float], share: float) -> tuple[list[float], list[float]]:
    """Squares of the factor with an eigenvalue zero added, which has ``share`` of the weight."""
    new_q, new_e = [q[0] * (1.0 - share)], []
    rest = q[0] * share
    for below, square in zip(e, [*q[1:], 0.0], strict=True):
        total = below + rest
        new_e.append(total)
        new_q.append(square * (below / total))
        rest = square * (rest / total)
    return new_q, [*new_e, 0.0]


def chain_of(B: Float, end: float) -> tuple[Float, Float, Float]:
    """Masses, springs ``(n + 1,)`` and psi of a bidiagonal matrix; ``end``: share of the last mass in ``T d``."""
    from scipy.linalg import solve_triangular

    load = np.zeros(B.shape[0])
    load[0] += 1.0 - end
    load[-1] += end
    d = solve_triangular(B, solve_triangular(B, load, trans="T"))
    off = -np.diag(B)[:-1] * np.diag(B, 1)
    psi = np.linalg.svd(B)[2][::-1]
    return d**2, np.concatenate([[d[0] * (1.0 - end)], off * d[:-1] * d[1:], [d[-1] * end]]), psi
