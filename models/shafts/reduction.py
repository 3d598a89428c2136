"""A known structure with fitted scale factors, reduced to few coordinates with an error that is known.

The inner coordinates follow those at the planes by ``X = -inv(kappa_ii) kappa_ip``. Solutions at a few lines and
factors span the coordinates kept (a rational Krylov basis); the matrices are projected on them, so that frequency,
speed and factors enter as before. What a projected solution leaves of the equations, R on the right and L on the left,
makes an error of ``L inv(kappa_ii) R`` in the stiffness at the planes: the square of how well the basis does. Solutions
are added where that is largest until it is negligible everywhere (a greedy reduced basis, Benner et al. 2015).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from rotorfit.base.array_types import ComplexArray, Float, Index

if TYPE_CHECKING:
    from rotorfit.models.shafts.shaft import StructureMatrices

BASIS_TOLERANCE = 1e-7
"""Error of the stiffness at the planes, relative to its largest entry at the line, at which the basis is complete."""
REDUCTION_TOLERANCE = 1e-6
"""The same, up to which a reduction is used at all: round-off of large structures may be above the former."""

_SMALLEST_DIRECTION = 1e-6  # share of a new direction that earlier ones leave, below which it is not new


@dataclass(frozen=True, eq=False, kw_only=True)
class Terms:
    """A structure as a sum of matrices, each times a number that depends on frequency, speed and factors."""

    matrices: ComplexArray  # K, C, G, M, then those of each part in this order, shape ``(4 + 4 S, N, N)``
    n: int  # coordinates seen, which come first

    @staticmethod
    def of(whole: StructureMatrices, parts: Sequence[StructureMatrices], seen: Index) -> Terms:
        """The terms of a structure and its parts, of which some coordinates are seen."""
        order = np.concatenate([seen, np.setdiff1d(np.arange(len(whole.K)), seen)])
        terms = np.stack([matrix for each in (whole, *parts) for matrix in (each.K, each.C, each.G, each.M)])
        return Terms(matrices=terms[:, order[:, None], order], n=seen.size)

    @property
    def size(self) -> int:
        """Coordinates in all."""
        return len(self.matrices[0])

    def weights(self, s: ComplexArray, speed: Float, scales: Float) -> ComplexArray:
        """The numbers of each line, shape ``(L, 4 + 4 S)``."""
        powers = np.stack([np.ones_like(s), s, s * speed, s**2], axis=1)
        factors = np.concatenate([np.ones((s.size, 1)), scales - 1.0], axis=1)
        return np.asarray((factors[:, :, None] * powers[:, None, :]).reshape(s.size, -1))

    def condense(self, s: ComplexArray, speed: Float, scales: Float) -> tuple[ComplexArray, ComplexArray]:
        """Dynamic stiffness between the coordinates seen, the others being free of force. ``kappa_pp - kappa_pi
        inv(kappa_ii) kappa_ip``, p the coordinates seen, i the others."""
        entries = 4_000_000  # of matrices worked on at once
        step = max(1, entries // self.size**2)
        pieces = [slice(i, i + step) for i in range(0, max(s.size, 1), step)]
        found = [self._condense(s[piece], speed[piece], scales[piece]) for piece in pieces]
        return np.concatenate([f[0] for f in found]), np.concatenate([f[1] for f in found], axis=1)

    def kappa(self, weights: ComplexArray) -> ComplexArray:
        """Dynamic stiffness of all coordinates by the numbers of each line, shape ``(L, N, N)``."""
        return np.asarray((weights @ self.matrices.reshape(len(self.matrices), -1)).reshape(-1, self.size, self.size))

    def following(self, kappa: ComplexArray) -> ComplexArray:
        """Motion of all coordinates by that of the coordinates seen, the others free of force, shape ``(L, N, n)``."""
        n = self.n
        moved = np.zeros((len(kappa), self.size, n), dtype=complex)
        moved[:, :n] = np.eye(n)
        moved[:, n:] = -np.linalg.solve(kappa[:, n:, n:], kappa[:, n:, :n])
        return moved

    def _condense(self, s: ComplexArray, speed: Float, scales: Float) -> tuple[ComplexArray, ComplexArray]:
        weights = self.weights(s, speed, scales)
        kappa = self.kappa(weights)
        right = self.following(kappa)
        slopes = np.empty((scales.shape[1], s.size, self.n, self.n), dtype=complex)
        if len(slopes):
            left = np.swapaxes(self.following(np.swapaxes(kappa, 1, 2)), 1, 2)
            flat = self.matrices.reshape(len(self.matrices), -1)
            for number in range(len(slopes)):
                change = weights[:, :4] @ flat[4 + 4 * number : 8 + 4 * number]
                slopes[number] = left @ change.reshape(kappa.shape) @ right
        return kappa[:, : self.n] @ right, slopes


class Reduction:
    """A structure reduced for lines, and factors within ``limits``, ``(2, S)``; its error is over the largest entry."""

    def __init__(self, full: Terms, s: ComplexArray, speed: Float, limits: Float) -> None:
        self._full = full
        n = full.n
        # Inner coordinates in which the energy at the highest frequency is the unit matrix: forces and moments compare.
        K, M = (full.matrices[k, n:, n:] for k in (0, 3))
        self._unit = np.linalg.cholesky(K + np.abs(s).max() ** 2 * M)
        self._basis = np.zeros((len(K), 0), dtype=complex)
        points = _corners(s, speed, limits)
        order = np.lexsort((speed, s.imag))
        most = 48  # lines among which the worst is looked for, over the whole range of frequencies
        some = np.unique(order[np.linspace(0, order.size - 1, min(most, order.size)).astype(int)])
        training = _corners(s[some], speed[some], limits)
        self._add(training, np.array([0, some.size // 2]))
        last = np.inf
        for _ in range(40):
            error = self._errors(*training)
            worst = float(error.max())
            if worst <= BASIS_TOLERANCE / 10:
                error = self._errors(*points)  # every line
                if float(error.max()) <= BASIS_TOLERANCE:
                    break
                training = points
            elif worst > 0.5 * last and worst < 10 * BASIS_TOLERANCE:
                break  # round-off: nothing more to be had
            last = worst
            self._add(training, _peaks(error))
        self.error = float(self._errors(*points).max())

    @property
    def size(self) -> int:
        """Coordinates kept."""
        return self.small.size

    def _add(self, points: tuple[ComplexArray, Float, Float], where: Index) -> None:
        """Add exact solutions, right and left, at some points to the basis."""
        s, speed, scales = points[0][where], points[1][where], points[2][where]
        n = self._full.n
        for kappa in self._full.kappa(self._full.weights(s, speed, scales)):
            right = np.linalg.solve(kappa[n:, n:], kappa[n:, :n])
            left = np.linalg.solve(kappa[n:, n:].conj().T, kappa[:n, n:].conj().T)
            directions = self._unit.conj().T @ np.concatenate([right, left], axis=1)
            directions = directions / np.linalg.norm(directions, axis=0)
            for _ in range(2):  # the second time against round-off
                directions = directions - self._basis @ (self._basis.conj().T @ directions)
            vectors, sizes, _ = np.linalg.svd(directions, full_matrices=False)
            self._basis = np.concatenate([self._basis, vectors[:, sizes > _SMALLEST_DIRECTION]], axis=1)
        self._project()

    def _project(self) -> None:
        """Matrices in the coordinates seen and those of the basis, and what measures the residuals."""
        n, back = self._full.n, np.linalg.solve(self._unit.conj().T, self._basis)
        size = n + back.shape[1]
        small = np.zeros((len(self._full.matrices), size, size), dtype=complex)
        columns, rows = [], []
        for matrix, into in zip(self._full.matrices, small, strict=True):
            right = np.concatenate([matrix[n:, :n], matrix[n:, n:] @ back], axis=1)
            left = np.concatenate([matrix[:n, n:], back.conj().T @ matrix[n:, n:]]).conj().T
            into[:n, :n], into[:n, n:], into[n:] = matrix[:n, :n], matrix[:n, n:] @ back, back.conj().T @ right
            columns.append(right)
            rows.append(left)
        self.small = Terms(matrices=small, n=n)
        self._right, self._left = self._measure(columns), self._measure(rows)

    def _measure(self, parts: list[ComplexArray]) -> ComplexArray:
        """Triangular factor of all terms side by side, so that sizes of residuals take no vectors of full length."""
        used = np.concatenate(parts, axis=1)
        scaled = np.linalg.solve(self._unit, used)
        triangle: ComplexArray = np.linalg.qr(scaled)[1]
        return triangle.reshape(-1, len(parts), parts[0].shape[1])

    def _errors(self, s: ComplexArray, speed: Float, scales: Float) -> Float:
        """Estimated error of the stiffness over its largest entry, shape of ``s``."""
        weights = self._full.weights(s, speed, scales)
        n, kappa = self.small.n, self.small.kappa(weights)
        right = self.small.following(kappa)
        left = self.small.following(np.swapaxes(kappa, 1, 2).conj())
        stiffness = np.abs(kappa[:, :n] @ right).max(axis=(1, 2))
        smallest = np.linalg.svd(kappa[:, n:, n:], compute_uv=False)[:, -1]
        misses = _sizes(self._right, weights, right) * _sizes(self._left, weights.conj(), left)
        return np.asarray(misses / smallest / stiffness)


def _sizes(factor: ComplexArray, weights: ComplexArray, solution: ComplexArray) -> Float:
    """Size of what solutions leave of the equations, shape ``(L,)``: terms times weights, all lines in one product."""
    weighted = (weights.T[:, None, :, None] * np.moveaxis(solution, 1, 0)).reshape(factor[0].size, -1)
    left = (factor.reshape(len(factor), -1) @ weighted).reshape(len(factor), *solution.shape[::2])
    return np.asarray(np.linalg.norm(left, axis=(0, 2)))


def _corners(s: ComplexArray, speed: Float, limits: Float) -> tuple[ComplexArray, Float, Float]:
    """Lines at the corners and in the middle of the limits of the factors."""
    low, high = limits
    corners = np.stack(np.meshgrid(*zip(low, high, strict=True), indexing="ij"), axis=-1).reshape(-1, low.size)
    factors = np.concatenate([corners, np.sqrt(low * high)[None]])
    return np.tile(s, len(factors)), np.tile(speed, len(factors)), np.repeat(factors, s.size, axis=0)


def _peaks(error: Float) -> Index:
    """The worst point of each of some stretches of the points."""
    at_once = 2  # solutions added before looking again
    stretches = np.array_split(np.arange(error.size), min(at_once, error.size))
    worst = np.array([part[int(np.argmax(error[part]))] for part in stretches], dtype=np.intp)
    return worst[error[worst] > BASIS_TOLERANCE / 10]
