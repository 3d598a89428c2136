"""Correlation of residuals along each sweep, and their scatter from line to line.

Noise of any shape has no memory from line to line; filters that overlap have a short one; a model that does not fit has
a long one. Noise that lies in one direction of the complex plane, as that of a speed that jitters, or that two probes
share at a line, one variance a reading does not see: the scatter of the gradient, summed line by line, does (HC3).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rotorfit.estimators.noise.run_effects import LEAST_RESIDUAL_SHARE, powers, real_rows
from rotorfit.estimators.significance import CHANCE_ERRORS
from rotorfit.models.array_types import ComplexArray, Float, Index


@dataclass(frozen=True, kw_only=True)
class Memory:
    """Correlation of whitened residuals along their sweeps."""

    first: float  # correlation of neighbouring lines, less what the fit itself brings about
    z: float  # that over its standard deviation for residuals without memory, whatever their sizes
    lags: tuple[float, ...]  # correlations at distances 1, 2, ... up to the first that chance explains
    fades: bool  # chance explains one of the distances that are looked at


def memory(r: ComplexArray, sensitivities: ComplexArray, outer: Float, sweeps: Sequence[Index]) -> Memory:
    """Correlation along sweeps of residuals of a fit with these sensitivities and covariance ``outer``."""
    order = np.concatenate(sweeps)
    number = np.repeat(np.arange(len(sweeps)), [rows.size for rows in sweeps])
    along, own = r[order], real_rows(sensitivities[order])
    # A fit takes its share of every reading and makes neighbours oppose one another a little.
    moved = np.mean(np.abs(r) ** 2) / 2 * (outer @ own)
    total = float(np.sum(np.abs(along) ** 2) + np.sum(own * moved))
    found: list[float] = []
    z, fades = 0.0, False
    # Distance, in lines, up to which neighbours are looked at, and never more than a third of a sweep: filters of an
    # analyser overlap over two or three lines.
    longest_lag = 12
    for lag in range(1, max(1, min(longest_lag, min(rows.size for rows in sweeps) // 3)) + 1):
        same = number[lag:] == number[:-lag]
        product = (along[lag:] * along[:-lag].conj()).real * same
        amount = float(product.sum() + powers(moved[:, 2 * lag :], own[:, : -2 * lag]) @ same)
        chance = float(np.sqrt(np.sum(product**2)))
        if lag == 1:
            z = amount / chance if chance > 0 else 0.0
            found.append(amount / total if total > 0 else 0.0)
        fades = amount < CHANCE_ERRORS * chance
        if fades:
            break
        if lag > 1:
            found.append(amount / total)
    return Memory(first=found[0], z=z, lags=tuple(found) if z > CHANCE_ERRORS else (), fades=fades)


def scatter(own: ComplexArray, sweeps: Sequence[Index], lags: Sequence[float]) -> Float:
    """Addition of memory along sweeps to the scatter of the gradient, ``J^T (R - 1) J``, shape ``(p, p)``."""
    added = np.zeros((own.shape[1], own.shape[1]))
    for lag, value in enumerate(lags, start=1):
        for rows in sweeps:
            if rows.size > lag:
                part = (own[rows[lag:]].conj().T @ own[rows[:-lag]]).real
                added += value * (part + part.T)
    return added


@dataclass(frozen=True, eq=False, kw_only=True)
class LineScatter:
    """Scatter of the gradient by lines, beside what equal and circular noise brings."""

    covar: Float  # covariance of the estimate by HC3, shape ``(p, p)``
    excess: Float  # standard deviations by which the variance of each entry exceeds that of such noise, shape ``(p,)``
    freedom: Float  # degrees of freedom of those variances, shape ``(p,)``


def line_scatter(r: ComplexArray, J: ComplexArray, covar: Float, line: Index, power: float = 1.0) -> LineScatter:
    """Compare the scatter of the gradient with what noise of a given power explains."""
    own = real_rows(J)
    moved = covar @ own  # both parts of each reading one after the other
    left = np.maximum(1 - powers(moved, own) / 2, LEAST_RESIDUAL_SHARE)
    order = np.argsort(line, kind="stable")
    starts = 2 * np.flatnonzero(np.diff(line[order], prepend=-1))
    parts = (2 * order[:, None] + np.arange(2)).ravel()

    def by_line(values: Float) -> Float:
        return np.asarray(np.add.reduceat(values[:, parts], starts, axis=1))

    def gathered(residuals: ComplexArray) -> Float:
        return by_line(moved * residuals.view(float))

    expected = by_line(moved**2)
    total = np.maximum(expected.sum(axis=1), np.finfo(float).tiny)
    chance = np.maximum(np.sqrt(2 * np.sum(expected**2, axis=1)) / total, np.finfo(float).eps)
    ratio = np.sum(gathered(r / np.sqrt(left)) ** 2, axis=1) / total / power
    scatter = gathered(r / left)
    return LineScatter(covar=scatter @ scatter.T, excess=(ratio - 1) / chance, freedom=2 / chance**2)
