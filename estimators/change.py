"""Changes of level: evidence after every test with a bound on false alarms for ever, and when and how much it was.

Test after test the same question is asked, and a test of significance at a fixed level would raise a false alarm sooner
or later. Evidence here is a non-negative martingale M that begins at 1: as long as nothing has changed, the probability
that it ever reaches 1/a is at most a, however long one looks and whenever one stops (Ville 1939).

A change of level. Values scatter normally about a level, which may depend on conditions in a straight line; scatter and
level are not known. From test k on the level is shifted by d standard deviations of one test, d from N(0, t^2). Level
and scatter are integrated over the priors that treat all of them alike (right Haar measure), so that the ratio of the
marginal likelihoods,

    (1 + t^2 r)^(-1/2) (R / (R - t^2 c^2 / (1 + t^2 r)))^((n - p) / 2),

is one of quantities that do not depend on level and scatter, and hence a martingale, whatever both are (Lai 1976;
Perez-Ortiz, Lardy, de Heide and Grunwald 2024). R is the sum of the squared residuals y without a shift, r that of the
shift's own step u once level and conditions are taken out of it, c the product of u and y. The mean over t and k, with
weights 1/(j (j + 1)) of the j-th possible k, is a martingale too. No error bar of a test is needed, which says little
of what mounting a weight anew scatters. Scatter with tails makes single values far off: evidence that is to count has
to hold whichever single value is left out, which only makes alarms fewer.

A value below what is required. Scores that are N(0, 1) at the limit and lower above it: for a mean d > 0 from score k
on the likelihood ratio is exp(d S - m d^2/2), S the sum of the m scores since then, d averaged over half of N(0, t^2).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rotorfit.base.array_types import ROUND_OFF, Float

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
    """The most likely change of level. Values of one date form a vector (K, M and D of one test, say). What a date has
    of its own, a weight mounted anew, is correlated between them: a force that is 2 % off moves K and M alike, a
    support that loosens moves K alone. The scatter C is therefore taken as a full covariance, from all dates about
    their common mean, and the statistic is the largest ``T(k) = k (N - k) / N * d_k^T C^-1 d_k``, d_k the difference of
    the means before and after. How large it gets by chance is counted over orders of the same dates: without a change
    every order is as likely, whatever their distribution (a permutation test, exact for dates of equal accuracy)."""
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
    chance = _by_chance(white, orders, random)
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


def _by_chance(white: Float, orders: int, random: np.random.Generator) -> Float:
    """Largest squared distance in each of so many orders of the dates, a few at a time: all would take orders x N."""
    numbers = 1 << 18  # taken at a time. Chosen
    at_a_time = max(1, numbers // white.size)
    found = np.empty(orders)
    for begin in range(0, orders, at_a_time):
        part = found[begin : begin + at_a_time]
        order = random.permuted(np.tile(np.arange(len(white)), (len(part), 1)), axis=1)
        part[:] = _distances(white[order]).max(axis=-1)
    return found


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


SHIFTS = (1.0, 4.0, 16.0)
"""Standard deviations of the shifts looked for, in standard deviations of one test. Chosen."""
FEWEST_FREEDOM = 3
"""Degrees of freedom of the scatter before a change. Chosen."""


def change_evidence(values: Float, conditions: Float | None = None) -> Float:
    """Evidence that the level has changed after each value, shape ``(N,)``; ``conditions`` have shape ``(N, C)``."""
    design = np.column_stack([np.ones(len(values)), *([] if conditions is None else conditions.T)])
    return np.array([_change(values[:n], design[:n]) for n in range(1, len(values) + 1)])


def without_any(values: Float, conditions: Float | None = None) -> float:
    """Evidence after the last value, whichever single value is left out: the least."""
    design = np.column_stack([np.ones(len(values)), *([] if conditions is None else conditions.T)])
    rows = ~np.eye(len(values), dtype=bool)
    return min(_change(values[row], design[row]) for row in rows)


def _change(values: Float, design: Float) -> float:
    """Evidence after the last of these values."""
    count = len(values)
    first = design.shape[1] + FEWEST_FREEDOM  # values before the first change that is looked for
    if count <= first or np.linalg.matrix_rank(design) < design.shape[1]:
        return 1.0
    basis = np.linalg.qr(design)[0]
    residual = values - basis @ (basis.T @ values)
    rest = float(residual @ residual)
    if rest <= (ROUND_OFF * np.abs(values).max()) ** 2 * count:
        return 1.0  # values that never change
    after = slice(first, None)
    products = np.cumsum(residual[::-1])[::-1][after]
    taken_out = np.sum(np.cumsum(basis[::-1], axis=0)[::-1][after] ** 2, axis=1)
    steps = np.maximum(np.arange(count - first, 0, -1) - taken_out, 0.0)
    squares = np.square(SHIFTS)[:, None]
    share = squares * products**2 / (1 + squares * steps) / rest
    ratios = -np.log1p(squares * steps) / 2 - (count - design.shape[1]) / 2 * np.log1p(-share)
    return _mixed(ratios)


def low_evidence(scores: Float) -> Float:
    """Evidence that scores are above 0 from some time on, after each of them, shape ``(N,)``."""
    from scipy.special import log_ndtr

    found = np.ones(len(scores))
    squares = np.square(SHIFTS)[:, None]
    for n in range(1, len(scores) + 1):
        total = np.cumsum(scores[:n][::-1])[::-1]
        wide = 1 + squares * np.arange(n, 0, -1)
        ratios = -np.log(wide) / 2 + squares * total**2 / (2 * wide)
        found[n - 1] = _mixed(ratios + np.log(2) + log_ndtr(total * np.sqrt(squares / wide)))
    return found


def _mixed(ratios: Float) -> float:
    """Mean of likelihood ratios, whose logarithms have shape ``(t, k)``, over sizes and times of a change."""
    j = np.arange(1, ratios.shape[1] + 1)
    parts = np.logaddexp.reduce(ratios, axis=0) - np.log(len(ratios)) - np.log(j * (j + 1))
    yet_to_come = -np.log(len(j) + 1)
    return float(np.exp(min(float(np.logaddexp.reduce(np.append(parts, yet_to_come))), 600.0)))
