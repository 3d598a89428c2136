"""How many modes influences at a few dwell speeds show: shapes by singular values against noise, poles by a pencil.

A mode contributes ``g phi^T w^2 / (wn^2 - w^2 + 2 j zeta wn w)`` to the matrix of influences (probes by force planes).
Between two speeds each mode grows by a factor of its own, an eigenvalue of the pencil of the two matrices, and the
factor tells its natural frequency; a mode far above the speeds grows as w^2 and leaves its frequency open.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rotorfit.estimators.significance import P_CHANCE
from rotorfit.estimators.starting.influence import Influence
from rotorfit.models.array_types import ComplexArray, Float

_LARGEST_ERROR = 0.2  # relative standard error of a natural frequency beyond which it is not determined


@dataclass(frozen=True, kw_only=True)
class ModesSeen:
    """Modes that influences show."""

    singular: tuple[float, ...]  # singular values of all influences, the largest that noise alone makes being one
    # natural frequencies that are determined, rad/s, ascending, with standard errors
    frequencies: tuple[tuple[float, float], ...]
    shapes: int  # number of singular values above the noise

    @property
    def count(self) -> int:
        """Modes with a shape above the noise and a natural frequency."""
        return len(self.frequencies)


def modes_seen(influence: Influence) -> ModesSeen | None:
    """Shapes and poles in influences; None where one speed only, or gaps, leave nothing to compare."""
    dwells = np.unique(influence.dwell).tolist()
    channels = sorted(set.intersection(*[set(influence.channel[influence.dwell == d].tolist()) for d in dwells]))
    size = influence.influence.shape[1]
    if len(dwells) < 2 or not channels or not np.isfinite(influence.covariance).all():
        return None
    place = {(int(c), int(d)): i for i, (c, d) in enumerate(zip(influence.channel, influence.dwell, strict=True))}
    cells = np.array([[place[c, d] for c in channels] for d in dwells])
    rows = (cells[:, :, None] * size + np.arange(size)).reshape(-1)
    values = influence.influence[cells]  # dwells, channels, planes
    covariance = influence.covariance[np.ix_(rows, rows)]
    sd = np.sqrt(np.real(np.diag(covariance))).reshape(values.shape)
    scale = np.maximum(sd.mean(axis=(0, 2)), 1e-30)[:, None]
    noise = _draws(covariance, values.shape) / scale
    values = values / scale
    reach = np.quantile([np.linalg.svd(np.hstack(list(draw)), compute_uv=False)[0] for draw in noise], 1 - P_CHANCE)
    singular = np.linalg.svd(np.hstack(list(values)), compute_uv=False) / max(float(reach), 1e-30)
    shapes = int(np.sum(singular > 1))
    speed = influence.speed[dwells]
    order = np.argsort(speed)
    low, high = int(order[0]), int(order[-1])
    found: list[tuple[float, float]] = []
    for rank in range(min(shapes, size), 0, -1):
        between = float(speed[low]), float(speed[high]), rank
        squares = np.array([_poles(v[low], v[high], *between) for v in values + noise])
        at = _poles(values[low], values[high], *between)
        found = [pole for k in range(rank) if (pole := _determined(float(at[k]), squares[:, k])) is not None]
        if found:
            break
    return ModesSeen(singular=tuple(float(v) for v in singular), frequencies=tuple(sorted(found)), shapes=shapes)


def _draws(covariance: ComplexArray, shape: tuple[int, ...]) -> ComplexArray:
    rng = np.random.default_rng(0)
    values, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    draws = 400
    raw = rng.standard_normal((draws, values.size)) + 1j * rng.standard_normal((draws, values.size))
    return np.asarray((raw @ root.T).reshape(draws, *shape))


def _poles(low: ComplexArray, high: ComplexArray, w1: float, w2: float, rank: int) -> Float:
    """Squares of the natural frequencies from influences at two speeds, largest growth first, NaN where none fits."""
    left = np.linalg.svd(np.hstack([low, high]))[0][:, :rank].conj().T
    right = np.linalg.svd(np.vstack([low, high]))[2][:rank].conj().T
    growth = np.linalg.eigvals(np.linalg.solve(left @ low @ right, left @ high @ right))
    q = np.sort(growth.real)[::-1] * (w1 / w2) ** 2  # (wn^2 - w1^2)/(wn^2 - w2^2) without damping
    with np.errstate(all="ignore"):
        square = (q * w2**2 - w1**2) / (q - 1)
    return np.where(np.isfinite(square) & (square > 0), square, np.nan)


def _determined(square: float, draws: Float) -> tuple[float, float] | None:
    """Natural frequency and standard error, None where the draws leave it open."""
    if not np.isfinite(square) or np.mean(np.isfinite(draws)) < 1 - P_CHANCE:
        return None
    low, high = np.nanquantile(np.sqrt(draws), [0.16, 0.84])
    error, wn = float(high - low) / 2, float(np.sqrt(square))
    return (wn, error) if error < _LARGEST_ERROR * wn else None
