"""Causes to first order about the point where they were solved with the fitted values, and what is left of them there.

Sizes are in standard uncertainties, so that each has the prior N(0, 1), cut at zero where it is never negative.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from rotorfit.base.array_types import Bool, ComplexArray, Float
from rotorfit.estimators.inference.joint_errors import nearest_of_one_sign

_CANDIDATES = 8
"""Sizes of one sign from which one is drawn by their weights."""


@dataclass(frozen=True, eq=False, kw_only=True)
class LinearCauses:
    """Columns of causes at the joint optimum of a problem with their effect taken out of its readings."""

    columns: ComplexArray  # change of the whitened residuals by a standard uncertainty of each, shape ``(R, k)``
    at: Float  # where they were solved, shape ``(k,)``
    size: Float  # standard uncertainty of each, shape ``(k,)``
    one_sided: Bool  # causes that are never negative

    def wider(self, factor: float) -> LinearCauses:
        """The same with all standard uncertainties times a factor."""
        return replace(self, columns=self.columns * factor, at=self.at / factor, size=self.size * factor)

    def with_noise(self, factor: Float | float) -> LinearCauses:
        """The same beside noise times a factor, or that of each reading times its own, shape ``(R,)``."""
        return replace(self, columns=self.columns / np.broadcast_to(factor, len(self.columns))[:, None])

    def before(self, count: int, rng: np.random.Generator) -> Float:
        """Sizes at random by what is known of them before the data, shape ``(count, k)``."""
        sizes = rng.normal(size=(count, self.at.size))
        return np.where(self.one_sided, np.abs(sizes), sizes)

    @cached_property
    def rows(self) -> Float:
        """The columns with real and imaginary parts of each reading in turn, shape ``(2 R, k)``."""
        return np.stack([self.columns.real, self.columns.imag], axis=1).reshape(-1, self.at.size)


@dataclass(frozen=True, eq=False, kw_only=True)
class CausesGiven:
    """Sizes of causes given the fitted values, the noise known: normal, and cut at zero where of one sign."""

    causes: LinearCauses
    weight: Float  # of the square of each reading's whitened residual, shape ``(R,)``

    @cached_property
    def covar(self) -> Float:
        """Covariance of the sizes whatever their sign, shape ``(k, k)``."""
        rows = self.causes.rows
        gram = rows.T @ (rows * np.repeat(self.weight, 2)[:, None])
        return np.asarray(np.linalg.inv(np.eye(self.causes.at.size) + gram))

    def log_one_sign(self, sizes: Float) -> Float:
        """Logarithm of the probability that none of one sign is negative, by most probable sizes ``(W, k)``: sign by
        sign, what is left of the others taken as normal (Mendell and Elston 1974), which errs by some per cent."""
        from scipy.special import log_ndtr  # late: loading it takes longer than a fit

        bound, found = np.flatnonzero(self.causes.one_sided), np.zeros(len(sizes))
        middle, covar = (
            sizes[:, bound],
            np.broadcast_to(self.covar[np.ix_(bound, bound)], (len(sizes),) + 2 * bound.shape),
        )
        for _ in bound:
            deviation = np.sqrt(covar[:, 0, 0])
            room = middle[:, 0] / deviation
            share = log_ndtr(room)
            found += share
            ahead = np.exp(-0.5 * room**2 - share) / math.sqrt(2 * math.pi)
            along = covar[:, 1:, 0] / deviation[:, None]
            middle = middle[:, 1:] + along * ahead[:, None]
            less = (ahead * (ahead + room))[:, None, None]
            covar = covar[:, 1:, 1:] - along[:, :, None] * along[:, None, :] * less
        return found

    def fall(self, sizes: Float) -> Float:
        """By how much the log density falls from most probable sizes ``(W, k)`` to those of no wrong sign."""
        if not self.causes.one_sided.any():
            return np.zeros(len(sizes))
        held = np.array([nearest_of_one_sign(own, self.covar, self.causes.one_sided) for own in sizes]) - sizes
        return np.asarray(0.5 * np.einsum("wk,wk->w", held, np.linalg.solve(self.covar, held.T).T))

    def drawn(self, sizes: Float, rng: np.random.Generator) -> Float:
        """Sizes at random, none of one sign below zero, about most probable ones ``(W, k)``; in units of each."""
        bound, free = np.flatnonzero(self.causes.one_sided), np.flatnonzero(~self.causes.one_sided)
        found = sizes.copy()
        onto = np.zeros((free.size, bound.size))
        if bound.size:
            weights, trials = self._along(sizes[:, bound], rng.random((len(sizes), _CANDIDATES, bound.size)))
            # The largest of the weights with Gumbel's noise is each with its probability.
            chosen = np.argmax(weights + rng.gumbel(size=weights.shape), axis=1)
            found[:, bound] = np.maximum(trials[np.arange(len(sizes)), chosen], 0.0)
            onto = np.asarray(np.linalg.solve(self.covar[np.ix_(bound, bound)], self.covar[np.ix_(bound, free)])).T
        rest = self.covar[np.ix_(free, free)] - onto @ self.covar[np.ix_(bound, free)]
        noise = rng.normal(size=(len(sizes), free.size)) @ np.linalg.cholesky(rest).T
        found[:, free] += (found[:, bound] - sizes[:, bound]) @ onto.T + noise
        return np.asarray(found * self.causes.size)

    @cached_property
    def _root(self) -> Float:
        bound = self.causes.one_sided
        return np.asarray(np.linalg.cholesky(self.covar[np.ix_(bound, bound)]))

    def _along(self, middle: Float, uniform: Float) -> tuple[Float, Float]:
        """Normal vectors cut at zero, drawn entry by entry from uniform numbers ``(W, N, k)``, and the logarithms of
        their weights (Geweke, Hajivassiliou and Keane); shapes ``(W, N, k)`` and ``(W, N)``."""
        from scipy.special import ndtr, ndtri  # late: loading it takes longer than a fit

        root = self._root
        weights = np.zeros(uniform.shape[:2])
        white = np.zeros((*weights.shape, len(root)))
        for j, row in enumerate(root):
            room = (middle[:, None, j] + white[..., :j] @ row[:j]) / row[j]
            share = np.maximum(ndtr(room), 1e-300)
            weights += np.log(share)
            white[..., j] = -ndtri(np.maximum(uniform[..., j] * share, 1e-300))
        return weights, middle[:, None, :] + white @ root.T
