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
    """Correlation of whitened residuals along their sweeps.

    Attributes:
        first: correlation of neighbouring lines, less what the fit itself brings about.
        z: that over its standard deviation for residuals without memory, whatever their sizes.
        lags: correlations at distances 1, 2, ... up to the first that chance explains.
    """

    first: float
    z: float
    lags: tuple[float, ...]


def memory(r: ComplexArray, own: ComplexArray, outer: Float, sweeps: Sequence[Index]) -> Memory:
    """Correlation along sweeps.

    Args:
        r: whitened residuals, shape ``(R,)``.
        own: whitened sensitivities of the fit that left them, shape ``(R, p)``.
        outer: covariance of its fitted values, shape ``(p, p)``.
        sweeps: readings of each sweep in the order of frequency.
    """
    shortest = min((rows.size for rows in sweeps), default=0)
    order = np.concatenate(sweeps) if sweeps else np.zeros(0, dtype=np.intp)
    number = np.repeat(np.arange(len(sweeps)), [rows.size for rows in sweeps])
    along = r[order]
    ours = np.ascontiguousarray(own.T[:, order]).view(float)
    power = float(np.mean(np.abs(r) ** 2)) / 2
    # A fit takes its share of every reading and makes neighbours oppose one another a little.
    moved = power * (outer @ ours)
    total = float(np.vdot(along, along).real) + float(np.vdot(ours, moved))
    found: list[float] = []
    z = 0.0
    for lag in range(1, max(1, min(_LAGS, shortest // 3)) + 1):
        same = number[lag:] == number[:-lag]
        product = (along[lag:] * along[:-lag].conj()).real[same]
        brought = powers(moved[:, 2 * lag :], ours[:, : -2 * lag])
        amount = float(product.sum()) + float(brought[same].sum())
        chance = float(np.sqrt(np.sum(product**2)))
        if lag == 1:
            z = amount / chance if chance > 0 else 0.0
        if amount < 2 * chance:
            found += [amount / total] if lag == 1 and total > 0 else []
            break
        found.append(amount / total)
    return Memory(first=found[0] if found else 0.0, z=z, lags=tuple(found) if z > 2 else ())


def scatter(own: ComplexArray, sweeps: Sequence[Index], lags: Sequence[float]) -> Float:
    """What memory along sweeps adds to the scatter of the gradient, ``J^T (R - 1) J``, shape ``(p, p)``.

    Args:
        own: whitened sensitivities, shape ``(R, p)``.
        sweeps: readings of each sweep in the order of frequency.
        lags: correlations at distances 1, 2, ...
    """
    added = np.zeros((own.shape[1], own.shape[1]))
    for lag, value in enumerate(lags, start=1):
        for rows in sweeps:
            if rows.size > lag:
                part = (own[rows[lag:]].conj().T @ own[rows[:-lag]]).real
                added += value * (part + part.T)
    return added
