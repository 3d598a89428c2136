"""Residuals of a fit: their level by restricted likelihood, correlation along each sweep, scatter from line to line.

Noise found in the data alone (:mod:`rotorfit.estimators.noise.sweep_noise`) does not see what both probes share, such
as a force that jitters. Residuals see it, and where they do not follow one another along the sweep it is noise and no
misfit.

Noise of any shape has no memory from line to line; filters that overlap have a short one; a model that does not fit has
a long one. Noise that lies in one direction of the complex plane, as that of a speed that jitters, or that two probes
share at a line, one variance a reading does not see: the scatter of the gradient, summed line by line, does (HC3).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from rotorfit.base.array_types import ComplexArray, Float, Index
from rotorfit.base.significance import CHANCE_ERRORS, P_UNLIKELY
from rotorfit.estimators.noise.run_effects import LEAST_RESIDUAL_SHARE, in_a_row, parts, powers, real_rows
from rotorfit.estimators.noise.sweep_noise import LINES_OF_A_LEVEL, NOISE_FLOOR

_RATIOS = np.concatenate([[0.0], np.logspace(-2.5, 4.5, 22), [np.inf]])
"""Tried ratios of the proportional to the constant share of the variance, at the mean square amplitude."""

_BETWEEN = np.linspace(0.0, 1.0, 9)
"""Ratios between the neighbours of the best of them, as shares of the way on a logarithmic scale."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Shape:
    """Noise of one group of readings, ``sigma^2 = a^2 + b^2 |prediction|^2``."""

    rows: Index  # the readings
    a: float  # constant part, in units of the readings
    b: float  # part that is proportional to the prediction
    log_likelihood: float  # restricted, up to a constant of the readings
    along: str  # what ``size2`` is of, in words

    def variance(self, size2: Float) -> Float:
        """Variance of the real and of the imaginary part of each reading of the group."""
        return self.a**2 + self.b**2 * np.asarray(size2)[self.rows]


def likelihood(power: Float, weight: Float, variance: Float) -> float:
    """Restricted log likelihood of squared residuals, up to a constant."""
    return -float(np.sum(weight * (np.log(variance) + power / variance)))


def fit_probes(
    probes: Sequence[Sequence[Index]], power: Float, weight: Float, size2: Float, *, along: str = ""
) -> list[list[Shape]]:
    """Noise of several probes by restricted likelihood; sweeps share both parts, unless the data refuse it."""
    from scipy.special import gammaincc  # late: loading it takes longer than a fit

    found = [[shape] for shape in _fit_groups([np.concatenate(s) for s in probes], power, weight, size2, along)]
    several = [i for i, s in enumerate(probes) if len(s) > 1 and min(rows.size for rows in s) >= LINES_OF_A_LEVEL]
    singly = iter(_fit_groups([rows for i in several for rows in probes[i]], power, weight, size2, along))
    for i in several:
        own = [next(singly) for _ in probes[i]]
        gain = sum(shape.log_likelihood for shape in own) - found[i][0].log_likelihood  # half of a chi-squared
        if gammaincc(len(own) - 1, max(gain, 0.0)) < P_UNLIKELY:
            found[i] = own
    return found


def _fit_groups(groups: Sequence[Index], power: Float, weight: Float, size2: Float, along: str) -> list[Shape]:
    """The shape of each of several groups of readings. For a given ratio of the two parts, the level has a closed form;
    the ratio is looked for on a grid, which no start can lead astray. Shorter groups are filled up with readings of no
    weight."""
    longest, number = max((rows.size for rows in groups), default=0), np.arange(len(groups))
    if not longest:
        return []
    rows = np.array([np.concatenate([own, np.repeat(own[:1], longest - own.size)]) for own in groups])
    there = np.arange(longest) < np.array([own.size for own in groups])[:, None]
    w, q = np.where(there, weight[rows], 0.0), size2[rows]
    mean = np.sum(q * there, axis=1, keepdims=True) / there.sum(axis=1, keepdims=True)
    some = mean > 0
    relative = np.where(some, q / np.where(some, mean, 1.0), 1.0)
    p, total = w * power[rows], w.sum(axis=1, keepdims=True)
    least = np.where(some, NOISE_FLOOR**2 * mean, np.finfo(float).tiny)

    def best_of(ratio: Float) -> tuple[Index, Float, Float]:
        """The best of tried ratios, shape ``(G, m)``, with its level and log likelihood."""
        whole = np.isinf(ratio)
        finite = np.where(whole, 0.0, ratio)
        shape = (1 + finite[:, :, None] * relative[:, None]) / (1 + finite)[:, :, None]
        shape[whole] = np.maximum(relative, 1e-12)[np.nonzero(whole)[0]]
        misfit = np.matmul(1 / shape, p[:, :, None])[:, :, 0]
        level = np.maximum(misfit / total, least)
        found = -np.matmul(np.log(shape), w[:, :, None])[:, :, 0] - total * np.log(level) - misfit / level
        best = np.argmax(found, axis=1)
        return best, level[number, best], found[number, best]

    best = best_of(np.broadcast_to(_RATIOS, (len(groups), _RATIOS.size)))[0]
    inner = (best > 0) & (best < _RATIOS.size - 1)
    low, high = _RATIOS[np.clip(best - 1, 1, None)], _RATIOS[np.clip(best + 1, None, _RATIOS.size - 2)]
    low, high = np.where(inner, low, 1.0)[:, None], np.where(inner, high, 1.0)[:, None]
    last = np.where(inner[:, None], low * (high / low) ** _BETWEEN, _RATIOS[best][:, None])
    chosen, level, found = best_of(last)
    ratio = last[number, chosen]
    with np.errstate(invalid="ignore"):
        share = np.where(np.isinf(ratio), 1.0, ratio / (1 + ratio))
    a = np.sqrt((1 - share) * level)
    b = np.sqrt(np.where(some, share[:, None] * level[:, None] / np.where(some, mean, 1.0), 0.0))[:, 0]
    return [
        Shape(rows=own, a=values[0], b=values[1], log_likelihood=values[2], along=along)
        for own, *values in zip(groups, a.tolist(), b.tolist(), found.tolist(), strict=True)
    ]


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
    along, level = r[order], float(np.mean(np.abs(r) ** 2)) / 2
    # Distance, in lines, up to which neighbours are looked at, and never more than a third of a sweep: filters of an
    # analyser overlap over two or three lines.
    longest = max(1, min(12, min(rows.size for rows in sweeps) // 3))
    # A fit takes its share of every reading, and makes neighbours oppose one another a little.
    shared = _lagged_products(sensitivities, outer, order, number, longest)
    total = float(np.sum(np.abs(along) ** 2)) + level * next(shared)
    found: list[float] = []
    z, fades = 0.0, False
    for lag in range(1, longest + 1):
        same = number[lag:] == number[:-lag]
        product = (along[lag:] * along[:-lag].conj()).real * same
        amount = float(product.sum()) + level * next(shared)
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


def _lagged_products(
    sensitivities: ComplexArray, outer: Float, order: Index, number: Index, longest: int
) -> Iterator[float]:
    """Products of sensitivities with those 0, 1, 2, ... readings further along the same sweep by a covariance, summed;
    of those beyond the neighbours, which are seldom asked for, together."""
    for lags in (range(2), range(2, longest + 1)):
        total = np.zeros(len(lags))
        for part in parts(order.size):
            own = real_rows(sensitivities[in_a_row(order[part.start : part.stop + lags.stop - 1])])
            moved = outer @ own[:, : 2 * (part.stop - part.start)]
            for place, lag in enumerate(lags):
                ahead = number[part.start + lag : part.stop + lag]
                same, count = ahead == number[part.start :][: ahead.size], 2 * ahead.size
                total[place] += powers(moved[:, :count], own[:, 2 * lag : 2 * lag + count]) @ same
        yield from total.tolist()


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


Piece: TypeAlias = tuple[Index, Index, ComplexArray]
"""Some readings, the entries that act on them, and the derivatives by these, shape ``(k, m)``."""


def scatter_in_pieces(pieces: Iterable[Piece], size: int, sweeps: Sequence[Index], lags: Sequence[float]) -> Float:
    """The same as :func:`scatter`, of derivatives in pieces that hold whole sweeps, by ``size`` entries."""
    added = np.zeros((size, size))
    place = np.full(max((int(sweep.max()) for sweep in sweeps), default=0) + 1, -1)
    for readings, entries, rows in pieces:
        place[:] = -1
        known = readings < place.size
        place[readings[known]] = np.flatnonzero(known)
        own = [place[sweep] for sweep in sweeps]
        added[np.ix_(entries, entries)] += scatter(rows.T, [sweep for sweep in own if (sweep >= 0).all()], lags)
    return added


def line_scatter(
    r: ComplexArray,
    pieces: Iterable[Piece],
    covar: Float,
    line: Index,
    power: float = 1.0,
    entries: Index | None = None,
) -> LineScatter:
    """Compare the scatter of the gradient with what noise of a given power explains, for all entries or some."""
    wanted = np.arange(len(covar)) if entries is None else entries
    number = np.unique(line, return_inverse=True)[1].reshape(-1)
    expected, evened, scatter = np.zeros((3, wanted.size, int(number.max(initial=-1)) + 1))
    for readings, acting, rows in pieces:
        order = np.argsort(number[readings], kind="stable")
        own = np.ascontiguousarray(rows[:, order]).view(float)  # both parts of each reading one after the other
        moved = covar[np.ix_(wanted, acting)] @ own
        share = powers(covar[np.ix_(acting, acting)] @ own if entries is not None else moved[acting], own) / 2
        left = np.maximum(1 - share, LEAST_RESIDUAL_SHARE)
        along, misses = number[readings[order]], r[readings[order]]
        starts = np.flatnonzero(np.diff(along, prepend=-1))
        lines = along[starts]
        for total, factor in ((evened, misses / np.sqrt(left)), (scatter, misses / left)):
            total[:, lines] += np.add.reduceat(moved * factor.view(float), 2 * starts, axis=1)
        expected[:, lines] += np.add.reduceat(moved**2, 2 * starts, axis=1)
    total = np.maximum(expected.sum(axis=1), np.finfo(float).tiny)
    chance = np.maximum(np.sqrt(2 * np.sum(expected**2, axis=1)) / total, np.finfo(float).eps)
    ratio = np.sum(evened**2, axis=1) / total / power
    return LineScatter(covar=scatter @ scatter.T, excess=(ratio - 1) / chance, freedom=2 / chance**2)
