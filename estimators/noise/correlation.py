"""How residuals follow one another along each sweep, and what that does to a covariance.

Noise of any shape has no memory from line to line; filters that overlap have a short one; a model that does not fit has
a long one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rotorfit.estimators.noise.run_effects import powers
from rotorfit.models.array_types import ComplexArray, Float, Index

_LAGS = 12
"""Longest distance, in lines, over which neighbours are looked at; and never more than a third of a sweep."""


@dataclass(frozen=True, kw_only=True)
class Memory:
    """Correlation of whitened residuals along their sweeps."""

    first: float  # correlation of neighbouring lines, less what the fit itself brings about
    z: float  # that over its standard deviation for residuals without memory, whatever their sizes
    lags: tuple[float, ...]  # correlations at distances 1, 2, ... up to the first that chance explains


def memory(r: ComplexArray, own: ComplexArray, outer: Float, sweeps: Sequence[Index]) -> Memory:
    """Correlation along sweeps."""
    shortest = min((rows.size for rows in sweeps), default=0)
    products = _Products.of(r, own.T, outer, sweeps)
    total = float(products.total)
    found: list[float] = []
    z = 0.0
    for lag in range(1, max(1, min(_LAGS, shortest // 3)) + 1):
        amount, chance = (float(value) for value in products.at(lag))
        if lag == 1:
            z = amount / chance if chance > 0 else 0.0
        if amount < 2 * chance:
            found += [amount / total] if lag == 1 and total > 0 else []
            break
        found.append(amount / total)
    return Memory(first=found[0] if found else 0.0, z=z, lags=tuple(found) if z > 2 else ())


@dataclass(frozen=True, eq=False, kw_only=True)
class _Products:
    """Readings in the order of the sweeps, along the last axis."""

    number: Index  # sweep of each
    along: ComplexArray  # residuals
    ours: Float  # sensitivities, and these times the covariance of the residuals' fit
    moved: Float  # sensitivities, and these times the covariance of the residuals' fit
    total: Float  # sum of the squares of all residuals, what the fit took of them made good

    @classmethod
    def of(cls, r: ComplexArray, rows: ComplexArray, outer: Float, sweeps: Sequence[Index]) -> _Products:
        """The readings that :func:`memory` is asked about."""
        order = np.concatenate(sweeps) if sweeps else np.zeros(0, dtype=np.intp)
        number = np.repeat(np.arange(len(sweeps)), [part.size for part in sweeps])
        along = r[..., order]
        ours = np.take(rows, order, axis=-1).view(float)
        power = np.mean(np.abs(r) ** 2, axis=-1)[..., None, None] / 2
        # A fit takes its share of every reading and makes neighbours oppose one another a little.
        moved = power * (outer @ ours)
        total = np.sum(np.abs(along) ** 2, axis=-1) + np.einsum("...pr,...pr->...", ours, moved)
        return cls(number=number, along=along, ours=ours, moved=moved, total=np.asarray(total))

    def at(self, lag: int) -> tuple[Float, Float]:
        """Sum of the products of readings a number of lines apart, and its standard deviation by chance."""
        same = self.number[lag:] == self.number[:-lag]
        product = (self.along[..., lag:] * self.along[..., :-lag].conj()).real * same
        brought = powers(self.moved[..., 2 * lag :], self.ours[..., : -2 * lag])
        amount = product.sum(axis=-1) + brought @ same
        return np.asarray(amount), np.asarray(np.sqrt(np.sum(product**2, axis=-1)))


def scatter(own: ComplexArray, sweeps: Sequence[Index], lags: Sequence[float]) -> Float:
    """What memory along sweeps adds to the scatter of the gradient, ``J^T (R - 1) J``, shape ``(p, p)``."""
    added = np.zeros((own.shape[1], own.shape[1]))
    for lag, value in enumerate(lags, start=1):
        for rows in sweeps:
            if rows.size > lag:
                part = (own[rows[lag:]].conj().T @ own[rows[:-lag]]).real
                added += value * (part + part.T)
    return added
