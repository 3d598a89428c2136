"""How wide the bands of a local fit may be, and the noise level of each.

A wide band needs fewer unknowns for the same lines, a narrow one follows a resonance. Neighbours are joined two by two
where Akaike's criterion prefers one fit of both, from the narrowest bands up; then every joined band is halved again,
because a bias too small to be seen in one band may yet be seen by a fit of all of them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from rotorfit.estimators.significance import SIGNIFICANT_ERRORS
from rotorfit.models.array_types import Float

if TYPE_CHECKING:
    from rotorfit.estimators.signals.local_response import LocalFit


POOLED_FREEDOM = 60
"""Complex degrees of freedom that a noise level is pooled from, so that it is known to 1/(2 sqrt(60)) = 6 %."""


def tile(count: int, solve: Callable[[int, int], LocalFit]) -> list[LocalFit]:
    """Bands that cover all lines, each fitted."""

    def fit(first: int, length: int) -> LocalFit:
        return solve(first, first + length)

    narrow = [fit(first, 1) for first in range(count)]
    noise = pooled_noise(narrow)
    chosen = {first: [(first, 1)] for first in range(count)}
    cost = {first: _criterion(narrow[first], noise[:, first]) for first in range(count)}
    doublings = 5  # times that bands may be doubled; chosen
    for length in (2**level for level in range(1, doublings + 1)):
        half = length // 2
        for first in range(0, count - 2 * half + 1, 2 * half):
            level = np.sqrt(np.mean(noise[:, first : first + 2 * half] ** 2, axis=1))
            together = _criterion(fit(first, 2 * half), level)
            apart = cost[first] + cost.pop(first + half)
            if together <= apart:
                chosen.pop(first + half)
                cost[first], chosen[first] = together, [(first, 2 * half)]
            else:
                cost[first] = apart
                chosen[first] += chosen.pop(first + half)
    bands = [band for first in sorted(chosen) for band in chosen[first]]
    halved = [part for first, length in bands for part in _halves(first, length)]
    return [narrow[first] if length == 1 else fit(first, length) for first, length in halved]


def _halves(first: int, length: int) -> list[tuple[int, int]]:
    return [(first, 1)] if length == 1 else [(first, length // 2), (first + length // 2, length // 2)]


def _criterion(fit: LocalFit, noise: Float) -> float:
    """Akaike's criterion over 2 with a known noise level, of all outputs together."""
    return float(np.sum(fit.misfit / noise**2) + 2 * fit.unknowns * noise.size)


def pooled_noise(fits: Sequence[LocalFit]) -> Float:
    """Noise ``sqrt(E |N|^2)`` of each output in each band, shape ``(P, bands)``. The nearest bands that together have
    :data:`POOLED_FREEDOM` degrees of freedom are pooled, but for those above their median (hum, an order of the shaft).
    A band that is clearly above its pool keeps its own level."""
    misfit = np.array([fit.misfit for fit in fits]).T
    dof = np.array([fit.dof for fit in fits], dtype=float)
    own = misfit / dof
    limit = 1 + SIGNIFICANT_ERRORS / np.sqrt(dof)
    total = np.concatenate([[0.0], np.cumsum(dof)])
    centre = (total[:-1] + total[1:]) / 2
    begin = np.clip(centre - POOLED_FREEDOM / 2, 0, max(total[-1] - POOLED_FREEDOM, 0))
    first = np.searchsorted(total, begin, side="right") - 1
    last = np.clip(np.searchsorted(total, begin + POOLED_FREEDOM), first + 1, dof.size)
    level = np.empty_like(own)
    for band, (start, stop) in enumerate(zip(first.tolist(), last.tolist(), strict=True)):
        near = slice(start, stop)
        kept = own[:, near] <= np.median(own[:, near], axis=1, keepdims=True) * limit[near]
        level[:, band] = np.sum(np.where(kept, misfit[:, near], 0.0), axis=1) / (kept @ dof[near])
    return np.asarray(np.sqrt(np.where(own > level * limit, own, level)))
