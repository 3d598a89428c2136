"""Whether, when and by how much the level of dated values changed, against their own scatter.

Values of one date form a vector (K, M and D of one test, say). What a date has of its own, a weight mounted anew, is
correlated between them: a force that is 2 % off moves K and M alike, a support that loosens moves K alone. The scatter
is therefore taken as a full covariance, from the dates themselves, and the statistic is the largest squared distance
of the means before and after,

    T(k) = k (N - k) / N * d_k^T C^-1 d_k,   d_k = mean after - mean before,

with C the scatter of all dates about their common mean. How large it gets by chance is counted over orders of the same
dates: without a change every order is as likely, whatever their distribution (a permutation test, exact for dates of
equal accuracy).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rotorfit.models.array_types import Float

FEWEST_DATES = 2
"""Dates on either side of a change: one date alone may be a slip."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Change:
    """The most likely change of level in N dates of P values."""

    index: int  # first date after the change
    before: Float  # mean levels before the change, shape ``(P,)``
    after: Float  # mean levels after it, shape ``(P,)``
    scatter: Float  # covariance of one date about its level, shape ``(P, P)``
    covariance: Float  # of the difference ``after - before``, shape ``(P, P)``
    freedom: int  # degrees of freedom of the scatter
    p_value: float  # share of orders of the dates that show as large a change by chance

    @property
    def shift(self) -> Float:
        """Difference of the levels, shape ``(P,)``."""
        return self.after - self.before


def fewest_dates(count: int) -> int:
    """Dates that a full covariance needs before a change can be distinguished from it."""
    return max(2 * FEWEST_DATES + 2, count + 4)


def find_change(values: Float, *, orders: int = 1999, seed: int = 0) -> Change:
    """The most likely change of level."""
    n, p = values.shape
    if n < fewest_dates(p):
        raise ValueError(f"a change in {p} values needs at least {fewest_dates(p)} dates, there are {n}")
    centred = values - values.mean(axis=0)
    unit = centred.std(axis=0)
    if not (unit > 0).all():
        raise ValueError("values that never change have no scatter to hold a change against")
    # Whitened by the scatter of all dates, which no order changes; a common level can then be left out of the sums.
    left, size, _ = np.linalg.svd(centred / unit, full_matrices=False)
    white = left[:, size > 1e-9 * size[0]]
    statistic = _distances(white)
    split = int(np.argmax(statistic))
    random = np.random.default_rng(seed)
    chance = _distances(white[random.permuted(np.tile(np.arange(n), (orders, 1)), axis=1)]).max(axis=-1)
    index = split + FEWEST_DATES
    before, after = values[:index], values[index:]
    residual = np.vstack([before - before.mean(axis=0), after - after.mean(axis=0)])
    scatter = residual.T @ residual / (n - 2)
    return Change(
        index=index,
        before=before.mean(axis=0),
        after=after.mean(axis=0),
        scatter=scatter,
        covariance=scatter * (1 / index + 1 / (n - index)),
        freedom=n - 2,
        p_value=float((1 + np.sum(chance >= statistic[split] * (1 - 1e-12))) / (1 + orders)),
    )


def _distances(white: Float) -> Float:
    """Squared distance of the means before and after each admissible split, shape ``(..., N - 2 FEWEST_DATES + 1)``."""
    n = white.shape[-2]
    k = np.arange(FEWEST_DATES, n - FEWEST_DATES + 1)
    sums = np.cumsum(white, axis=-2)[..., k - 1, :]
    return np.asarray(np.sum(sums**2, axis=-1) * n / (k * (n - k)))


def along(change: Change, direction: Float) -> tuple[float, float, float]:
    """The multiple of one direction that the change is, its standard error, and the chance of what is left (F test)."""
    from scipy.stats import f

    whiten = np.linalg.inv(np.linalg.cholesky(change.covariance))
    y, x = whiten @ change.shift, whiten @ direction
    size = float(x @ y / (x @ x))
    error = float(1 / np.sqrt(x @ x))
    more = y.size - 1
    if not more:
        return size, error, 1.0
    # Hotelling's T squared of the remainder in P - 1 dimensions.
    rest = float(np.sum((y - x * size) ** 2))
    freedom = change.freedom - more + 1
    return size, error, float(f.sf(rest * freedom / (more * change.freedom), more, freedom))
