"""The chain of masses and springs whose deflection lines come closest to given mode shapes (eqs 24 to 26).

Mode v of a chain in mass-scaled coordinates ``y_i = sqrt(M_i) z_i`` is row v of psi, and ``T = psi^T diag(w^2) psi`` is
tridiagonal: the Lanczos relation, so psi follows from its first column, a direction on the unit sphere. T fixes the
chain up to two numbers. Springs to ground at the ends alone mean that ``T d``, ``d_i = sqrt(M_i)``, vanishes at all
inner masses, so ``d = inv(T) (a, 0, ..., 0, b)``; a : b shares the ground stiffness between the ends, and their size
sets the total mass. T is an M-matrix: every a, b >= 0 gives positive masses and springs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from rotorfit.base.array_types import Float
from rotorfit.base.digits import significant
from rotorfit.base.equality import ByValue
from rotorfit.base.text_table import text_table
from rotorfit.models.lumped import MOST_MASSES, Chain

_Masses: TypeAlias = tuple[Float, Float, Float]  # masses, springs, psi

# Exact shapes are to give back their chain to round-off.
_EXACT: dict[str, Any] = {"xtol": 1e-15, "ftol": 1e-15, "gtol": 1e-15, "x_scale": "jac", "max_nfev": 60}


@dataclass(frozen=True, eq=False, kw_only=True)
class ChainFromModes(ByValue):
    """A chain that has given natural frequencies, and how well its deflection lines match the given ones.

    Attributes:
        M: masses, kg, shape ``(n,)``.
        K: springs, N/m, shape ``(n + 1,)``.
        psi: orthogonal matrix of eq. (25), row v the mode v in mass-scaled coordinates, shape ``(n, n)``.
        frequencies: natural frequencies of the chain, rad/s, shape ``(n,)``.
        shapes: deflection lines of the chain, columns scaled to the given ones, shape ``(n, n)``.
        match: modal assurance criterion of each deflection line with the given one, 1 for equal shapes, shape ``(n,)``.
        deviation: length of the difference of the two lines over that of the given one, shape ``(n,)``.
        modal_mass: modal mass of each mode in the scaling of the given shapes, kg, shape ``(n,)``.
    """

    M: Float
    K: Float
    psi: Float
    frequencies: Float
    shapes: Float
    match: Float
    deviation: Float
    modal_mass: Float

    def values(self) -> dict[str, float]:
        """Masses and springs by the parameter names of :class:`Chain`."""
        masses = {f"M{i + 1}": float(m) for i, m in enumerate(self.M)}
        return masses | {f"K{i + 1}": float(k) for i, k in enumerate(self.K)}

    def model(self, planes: Sequence[str] | None = None, *, fluid: str | None = None) -> Chain:
        """The chain as a model, for instance to be fitted with ``known=chain.values()``.

        Args:
            planes: names of the masses, by default mass-1, mass-2, ...
            fluid: plane with a fluid bearing.
        """
        return Chain(self.M.size, planes, fluid=fluid)

    def __str__(self) -> str:
        modes = zip(self.frequencies, self.modal_mass, self.match, self.deviation, strict=True)
        rows = [
            [f"{v}", f"{w:.6g}", significant(m, 5), f"{c:.6f}", significant(e, 2)]
            for v, (w, m, c, e) in enumerate(modes, 1)
        ]
        return "\n".join(
            [
                "M " + ", ".join(f"{m:.6g}" for m in self.M) + " kg",
                "K " + ", ".join(f"{k:.6g}" for k in self.K) + " N/m",
                *text_table([["mode", "w rad/s", "modal kg", "match", "deviation"], *rows], ">5 >12 >12 >11 >11"),
            ]
        )


def chain_from_modes(
    frequencies: ArrayLike, shapes: ArrayLike, *, modal_masses: ArrayLike | None = None, total_mass: float | None = None
) -> ChainFromModes:
    """Chain of n masses and n + 1 springs with n given natural frequencies (eqs 24 to 26).

    The frequencies are met exactly. What is free, the direction of psi's first column and the share of the two end
    springs, is chosen so that the deflection lines match the given shapes in the least-squares sense, whatever their
    scaling. How well they do is in ``match``: a few lumps follow the low modes of a shaft with disks, not those of a
    bare beam, whose frequencies grow faster than any chain's.

    Args:
        frequencies: natural frequencies, rad/s, positive and distinct, shape ``(n,)``, n up to 20.
        shapes: deflection at n stations (rows, in their order along the shaft) in each mode (columns), from finite
            elements or measured, any scale and sign, shape ``(n, n)``.
        modal_masses: modal mass of each mode in the scaling of ``shapes``, kg, shape ``(n,)`` or one for all (1 for
            mass-normalised shapes). They set the size of the masses only.
        total_mass: sum of the masses, kg, where the modal masses are not known.

    Raises:
        ValueError: wrong shapes, frequencies that are not positive and distinct, neither or both of ``modal_masses``
            and ``total_mass``.
    """
    w, lines = np.asarray(frequencies, dtype=float), np.asarray(shapes, dtype=float)
    _check(w, lines, modal_masses, total_mass)
    order = np.argsort(w)
    w, lines = w[order], lines[:, order]
    given = None if modal_masses is None else np.broadcast_to(np.asarray(modal_masses, dtype=float), w.shape)[order]
    unit = lines / np.linalg.norm(lines, axis=0)
    inverse_mass = None if given is None else np.sum(lines**2, axis=0) / given
    M, K, psi = _Search(w, unit).best(inverse_mass)
    own = psi.T / np.sqrt(M)[:, None]
    size = np.sum(own * lines, axis=0) / np.sum(own**2, axis=0)
    # own has unit modal mass; scaled to the given shapes, and by the factor on M, it has size^2 * factor.
    factor = float(np.exp(np.mean(np.log(given / size**2)))) if given is not None else float(total_mass or 1) / M.sum()
    scaled = own * size
    deviation = np.linalg.norm(scaled - lines, axis=0) / np.linalg.norm(lines, axis=0)
    return ChainFromModes(
        M=M * factor,
        K=K * factor,
        psi=psi * np.where(size < 0, -1.0, 1.0)[:, None],
        frequencies=chain_modes(M, K)[0],
        shapes=scaled,
        match=np.sum(scaled**2, axis=0) / np.sum(lines**2, axis=0),
        deviation=deviation,
        modal_mass=size**2 * factor,
    )


def _check(w: Float, shapes: Float, modal_masses: ArrayLike | None, total_mass: float | None) -> None:
    n = w.size
    if w.ndim != 1 or not 1 <= n <= MOST_MASSES or shapes.shape != (n, n):
        raise ValueError(
            f"n frequencies (1 to {MOST_MASSES}) need shapes at n stations, rows, in n modes, columns; got frequencies "
            f"of shape {w.shape} and shapes of shape {shapes.shape}. Choose as many stations as modes"
        )
    ordered = np.sort(w)
    if not (np.isfinite(w).all() and ordered[0] > 0 and (np.diff(ordered) > 1e-9 * ordered[-1]).all()):
        raise ValueError(f"frequencies of a supported chain are positive and distinct; got {w}")
    if not np.isfinite(shapes).all() or not np.linalg.norm(shapes, axis=0).all():
        raise ValueError("shapes must be finite and no mode may be zero at every station")
    if (modal_masses is None) == (total_mass is None):
        raise ValueError("shapes leave the size of the masses open: give either modal_masses or total_mass")
    if modal_masses is not None and not (np.asarray(modal_masses, dtype=float) > 0).all():
        raise ValueError(f"modal masses must be positive, got {modal_masses}")
    if total_mass is not None and not total_mass > 0:
        raise ValueError(f"total_mass must be positive, got {total_mass}")


def _near_chain(w: Float, d: Float, modes: Float) -> tuple[Float, Float] | None:
    """Masses and springs read off the shapes, then moved by Newton on logarithms as little as gives the frequencies:
    these grow with a spring's share of potential energy and fall with a mass's of kinetic. None without settling."""
    T = (modes * w**2) @ modes.T
    ground = np.maximum((T @ d)[[0, -1]] * d[[0, -1]], 0.0)
    M, K = d**2, np.concatenate([ground[:1], np.abs(np.diag(T, 1)) * d[:-1] * d[1:], ground[1:]])
    round_off = max(1e-13, 1e-15 * float(w[-1] / w[0]))
    for _ in range(50):  # steps allowed towards the frequencies
        own, shapes = chain_modes(M, K)
        if not own.all():
            return None
        miss = 2 * np.log(w / own)
        if np.abs(miss).max() < round_off:
            return M, K
        potential = K[:, None] * np.diff(shapes, axis=0, prepend=0.0, append=0.0) ** 2 / own**2
        kinetic = M[:, None] * shapes**2
        step = np.linalg.pinv(np.concatenate([-kinetic, potential]).T) @ miss
        step *= min(1.0, 1.0 / np.abs(step).max())
        M, K = M * np.exp(step[: w.size]), K * np.exp(step[w.size :])
    return None


@dataclass(frozen=True, eq=False)
class _Search:
    """Search over the logarithms of psi's squared first column and the share ``end`` of the last spring."""

    w: Float  # frequencies, ascending, shape ``(n,)``
    lines: Float  # deflection lines of unit length, stations by modes, shape ``(n, n)``

    def miss(self, M: Float, psi: Float) -> Float:
        """Residuals of the given lines, those of the chain being scaled to match."""
        if not M.all():  # beyond what numbers hold: as bad as a line at right angles
            return self.lines.ravel()
        own = psi.T / np.sqrt(M)[:, None]
        own /= np.linalg.norm(own, axis=0)
        return np.asarray((self.lines - own * np.sum(own * self.lines, axis=0)).ravel())

    def chain(self, logs: Float, end: float) -> _Masses:
        return chain_of(bidiagonal(self.w, np.exp(logs - logs.max())), end)

    def residual(self, u: Float, end: float | None = None) -> Float:
        M, _, psi = self.chain(u[: self.w.size], float(u[-1]) if end is None else end)
        return self.miss(M, psi)

    def improve(self, logs: Float, end: float, free: bool) -> _Found:
        """Least squares from a start, ``end`` free or held."""
        from scipy.optimize import least_squares

        largest = 300.0  # largest ratio of squared deflections at the first mass, as a logarithm
        box = np.full((2, self.w.size + free), [[-largest], [largest]])
        if free:
            box[:, -1] = 0.0, 1.0
        start = np.append(np.clip(logs, -0.9 * largest, 0.0), [end] * free)
        found = least_squares(self.residual, start, bounds=tuple(box), args=() if free else (end,), **_EXACT)
        return _Found(float(found.cost), found.x[: self.w.size], float(found.x[-1]) if free else end)

    def descend(self, logs: Float, ends: Sequence[float]) -> _Found:
        """Least squares from the best of several shares of the last spring."""
        costs = [float(np.sum(self.residual(logs, share) ** 2)) for share in ends]
        found = self.improve(logs, ends[int(np.argmin(costs))], True)
        missing_spring = 1e-2  # share of the ground stiffness below which an end is tried without a spring
        for bound in (0.0, 1.0):
            if abs(found.end - bound) < missing_spring:  # an interior method never quite reaches a missing spring
                found = min(found, self.improve(found.logs, bound, False), key=lambda one: one.cost)
        return found

    def best(self, inverse_mass: Float | None) -> _Masses:
        """Masses (up to a factor), springs and psi of the best match from three starts: a chain read off the shapes,
        their first row, and the chain that is its own mirror image, in closed form."""
        # Square roots of masses and given shapes in mass-scaled coordinates, made orthogonal: sum_v g_v phi_iv phi_jv,
        # g the inverse modal masses, vanishes off the diagonal and is 1/M_i on it.
        if inverse_mass is None:
            rows, others = np.triu_indices(self.w.size, 1)
            products = np.vstack([self.lines[rows] * self.lines[others], np.zeros(self.w.size)])
            inverse_mass = np.abs(np.linalg.svd(products)[2][-1])
        scaled = self.lines * np.sqrt(inverse_mass)
        inverse_root = np.linalg.norm(scaled, axis=1)
        left, _, right = np.linalg.svd(scaled / inverse_root[:, None])
        d, modes = 1 / inverse_root, left @ right
        gaps = np.abs(self.w[:, None] - self.w) * (self.w[:, None] + self.w) + np.eye(self.w.size)
        smallest = 1e-30  # deflection taken in place of zero at the first mass, where no mode of a chain vanishes
        columns = [2 * np.log(np.maximum(np.abs(modes[0]), smallest)), -np.log(gaps).sum(axis=0)]
        # Shares of the ground stiffness at the last mass to start from.
        end_shares: tuple[float, ...] = (0.02, 0.1, 0.3, 0.5, 0.7, 0.9, 0.98)
        best, chosen, ends = np.inf, (d, d, modes), end_shares
        near = _near_chain(self.w, d, modes)
        if near is not None:
            M, K = near
            psi = (chain_modes(M, K)[1] * np.sqrt(M)[:, None]).T
            best, chosen = float(np.sum(self.miss(M, psi) ** 2)) / 2, (M, K, psi)
            columns.insert(0, 2 * np.log(np.maximum(psi[:, 0], smallest)))
            force = K[[0, -1]] / np.sqrt(M[[0, -1]])
            ends = (*end_shares, float(np.clip(force[1] / force.sum(), 1e-6, 1 - 1e-6)))
        matched = 1e-20  # half the sum of squared misses of lines of unit length that leaves nothing to search for
        for column in columns:
            if best <= matched:
                break
            found = self.descend(column - column.max(), ends)
            if found.cost < best:
                best, chosen = found.cost, self.chain(found.logs, found.end)
        return chosen


class _Found(NamedTuple):
    cost: float
    logs: Float
    end: float


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
    """Upper bidiagonal B with ``psi^T diag(w^2) psi = B^T B`` for a given first column of psi. Lanczos' recursion, even
    with full reorthogonalisation, loses what a mode has at the start below round-off, and modes of long chains are
    often confined far from it. Here the qd algorithm adds one mode after the other without any subtraction (after D. P.
    Laurie, J. Comput. Appl. Math. 112 (1999) 165), and the frequencies carry the round-off of w, not that of w^2. The
    modes are added in descending order of frequency. Between two, the matrix ``L L^T``, ``L = B^T``, of those there,
    with w^2 counted from the last one, is shifted by the positive gap to the next (stationary qd). The new mode then
    has w^2 = 0 and leaves ``L^T L`` unchanged but for a row."""
    w, mass = frequencies.tolist(), weights.tolist()
    q, e = [0.0], [0.0]
    total = mass[-1]
    for v in range(len(w) - 2, -1, -1):
        q, e = _shifted(q, e, (w[v + 1] - w[v]) * (w[v + 1] + w[v]))
        # An eigenvalue zero is added, which has its share of the weight.
        total += mass[v]
        share = mass[v] / total
        rest, new_q, new_e = q[0] * share, [q[0] * (1.0 - share)], []
        for below, square in zip(e, [*q[1:], 0.0], strict=True):
            new_e.append(below + rest)
            new_q.append(square * (below / new_e[-1]))
            rest = square * (rest / new_e[-1])
        q, e = new_q, [*new_e, 0.0]
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
