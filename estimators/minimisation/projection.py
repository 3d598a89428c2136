"""Readings that are linear in some unknowns: a search for the others alone, the linear ones always at their best.

Variable projection (Golub and Pereyra 1973) with the Gauss-Newton matrix of Kaufman (1975): that of all unknowns with
the linear ones eliminated. They fall apart by the coordinate whose readings they act on
(:class:`~rotorfit.models.line_terms.Weights`), so that a mode seen by a hundred probes costs a hundred small systems of
equations and three unknowns of the search.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from rotorfit.base.array_types import ComplexArray, Float, Index
from rotorfit.estimators.minimisation.descent import solve_symmetric
from rotorfit.estimators.minimisation.own_columns import OwnColumns
from rotorfit.estimators.misfit.problem import LinearisedChannel, Problem


@dataclass(frozen=True, eq=False, kw_only=True)
class _Sums:
    """Sums over the readings of one coordinate."""

    gradient: Float  # of the cost by its linear entries, shape ``(k,)``
    matrix: Float  # their Gauss-Newton matrix, shape ``(k, k)``
    cross: Float  # that by the entries of the search and them, shape ``(q, k)``


@dataclass(frozen=True, eq=False, kw_only=True)
class Projection:
    """A problem as an objective of the entries that its readings are not linear in."""

    problem: Problem
    kept: Index  # entries of the search, shape ``(q,)``
    linear: dict[int, Index]  # entries that the readings of each coordinate are linear in, no two in common

    @classmethod
    def of(cls, problem: Problem) -> Projection | None:
        """The objective, None where none of the unknowns is free, without prior, and linear in all readings."""
        space, weights = problem.space, problem.space.model.weights
        if weights is None or problem.loss != "linear" or any(term.sum is None for term in problem.terms):
            return None
        free = np.isinf(space.lower) & np.isinf(space.upper)
        free[[prior.entry for prior in problem.priors]] = False
        linear = {}
        for coordinate in sorted({channel[0] for block in problem.responses for channel in block.channels}):
            places = np.concatenate([weights.real[coordinate], weights.imaginary[coordinate]])
            entries = np.unique(space.index[:, places[places >= 0]])
            linear[coordinate] = entries[(entries >= 0) & free[entries]]
        taken = [entry for entries in linear.values() for entry in entries.tolist()]
        return cls(problem=problem, kept=np.setdiff1d(np.arange(space.size), taken), linear=linear) if taken else None

    @cached_property
    def _place(self) -> Index:
        """Place of each entry of the fitted vector among those of the search, or those of its coordinate."""
        place = np.zeros(self.problem.space.size, dtype=np.intp)
        for entries in (self.kept, *self.linear.values()):
            place[entries] = np.arange(entries.size)
        return place

    @cached_property
    def _is_kept(self) -> Index:
        kept = np.zeros(self.problem.space.size, dtype=bool)
        kept[self.kept] = True
        return kept

    def _channels(self, x: Float, *, shared: bool) -> Iterator[LinearisedChannel]:
        for term in self.problem.terms:
            yield from term.channels(x, shared=shared)

    def vector(self, y: Float) -> Float:
        """The fitted vector: the linear entries are where the sum of squares is least."""
        x = np.zeros(self.problem.space.size)
        x[self.kept] = y
        found = {c: (np.zeros(own.size), np.zeros((own.size, own.size))) for c, own in self.linear.items()}
        for channel in self._channels(x, shared=False):
            gradient, matrix = found[channel.coordinate]
            slope, products = channel.products()
            mine = np.flatnonzero(~self._is_kept[channel.entries])
            place = self._place[channel.entries[mine]]
            gradient[place] += slope[mine]
            matrix[place[:, None], place] += products[np.ix_(mine, mine)]
        for coordinate, (gradient, matrix) in found.items():
            x[self.linear[coordinate]] = -solve_symmetric(matrix, gradient)
        return x

    def _sums(self, x: Float) -> tuple[float, Float, Float, dict[int, _Sums]]:
        """Cost, its slope and Gauss-Newton matrix by the entries of the search, and sums of each coordinate."""
        count, cost = self.kept.size, 0.0
        gradient, matrix = np.zeros(count), np.zeros((count, count))
        found = {
            c: _Sums(gradient=np.zeros(n), matrix=np.zeros((n, n)), cross=np.zeros((count, n)))
            for c, n in ((coordinate, own.size) for coordinate, own in self.linear.items())
        }
        for channel in self._channels(x, shared=True):
            sums, kept, place = found[channel.coordinate], self._is_kept[channel.entries], self._place[channel.entries]
            slope, products = channel.products()
            search, own = place[kept], place[~kept]
            cost += 0.5 * float(np.vdot(channel.residuals, channel.residuals).real)
            gradient[search] += slope[kept]
            matrix[search[:, None], search] += products[np.ix_(kept, kept)]
            sums.gradient[own] += slope[~kept]
            sums.matrix[own[:, None], own] += products[np.ix_(~kept, ~kept)]
            sums.cross[search[:, None], own] += products[np.ix_(kept, ~kept)]
        for prior in self.problem.priors:
            added, steeper, curvature = prior.terms(float(x[prior.entry]))
            at = self._place[prior.entry]
            cost += float(added)
            gradient[at] += steeper
            matrix[at, at] += curvature
        return cost, gradient, matrix, found

    def gauss_newton(self, y: Float) -> tuple[float, Float, Float]:
        """Cost, gradient and Gauss-Newton matrix of one vector of the search."""
        cost, gradient, matrix, channels = self._sums(self.vector(y))
        for sums in channels.values():
            onto = solve_symmetric(sums.matrix, np.column_stack([sums.cross.T, sums.gradient]))
            gradient = gradient - sums.cross @ onto[:, -1]  # what round-off left of the linear ones' slope
            matrix = matrix - sums.cross @ onto[:, :-1]
        return cost, gradient, (matrix + matrix.T) / 2

    def derivatives(self, x: Float) -> tuple[ComplexArray, ComplexArray, tuple[OwnColumns, ...]]:
        """Whitened residuals of a fitted vector, shape ``(R,)``, their derivatives by the entries of the search, shape
        ``(R, q)``, and those by the linear entries of each channel."""
        count = self.problem.n_data // 2
        residuals, rows = np.zeros(count, dtype=complex), np.zeros((count, self.kept.size), dtype=complex)
        own = []
        for term in self.problem.terms:
            for channel in term.channels(x):
                readings, kept = term.readings.start + channel.readings, self._is_kept[channel.entries]
                residuals[readings] = channel.residuals
                whole = channel.rows
                rows[readings[:, None], self._place[channel.entries[kept]]] = whole[kept].T
                if not kept.all():
                    own.append(OwnColumns(readings=readings, rows=whole[~kept]))
        return residuals, rows, tuple(own)

    def information(self, x: Float) -> tuple[Float, dict[int, tuple[Float, Float]]]:
        """Gauss-Newton matrix of the entries of the search with the linear ones eliminated, shape ``(q, q)``; for each
        coordinate that of its linear entries, shape ``(k, k)``, and how they follow the others, shape ``(k, q)``."""
        _, _, matrix, channels = self._sums(x)
        found = {}
        for coordinate, sums in channels.items():
            follow = -solve_symmetric(sums.matrix, sums.cross.T)
            matrix = matrix + sums.cross @ follow
            found[coordinate] = sums.matrix, follow
        return (matrix + matrix.T) / 2, found

    def cost(self, y: Float) -> float:
        """Cost of one vector of the search."""
        return self.problem.cost(self.vector(y))

    def hessian(self, y: Float) -> Float:
        """Second derivatives of the cost by differences of its exact gradient."""
        step = np.sqrt(np.finfo(float).eps) * np.maximum(np.abs(y), 1e-8)
        beyond = y + np.diag(step)
        first = self.gauss_newton(y)[1]
        slopes = np.array([self.gauss_newton(one)[1] - first for one in beyond])
        matrix = slopes / (np.diagonal(beyond) - y)[:, None]
        return np.asarray((matrix + matrix.T) / 2)
