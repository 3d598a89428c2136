"""Angle, speed and acceleration of a shaft from its pulses, smoothed as much as the pulses jitter and no more.

The angle is a quintic spline whose third derivative is penalised, so that a steadily accelerating shaft costs nothing:
`sum_k (theta_k - theta(t_k))^2/sigma_k^2 + penalty int theta'''^2 dt` (P-splines; Eilers and Marx 1996). Seen as a
model, the jerk is white noise and the pulses scatter by ``sigma_k``; the ratio of the two is what restricted maximum
likelihood says (Wahba 1985), from the pulses alone. Knots are added until the penalty, not they, smooths.

Pulses scatter in time where the sampling rounds a sharp edge, in angle where noise meets an edge that extends over some
angle, and from one to the other as the speed changes: ``sigma_k`` is pooled over neighbours and the fit repeated.

Several pulses a turn carry the same errors of spacing every turn: a pattern with zero mean, estimated with the spline.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.interpolate import BSpline
from scipy.linalg import cho_solve_banded, cholesky_banded
from scipy.linalg.blas import dsbmv
from scipy.ndimage import median_filter
from scipy.optimize import minimize_scalar

from rotorfit.base.array_types import Bool, Float, Index
from rotorfit.estimators.signals.local_response import POOLED_FREEDOM
from rotorfit.estimators.signals.pulse_numbers import NumberedPulses

SPLINE_DEGREE = 5
_OUTLYING_DEVIATIONS = 7.0
"""Robust standard deviations beyond which a pulse is taken for noise: never once in a million Gaussian ones."""
_ROUND_OFF = 1e-9
"""Share of the record's length below which a pulse is never late: what is left of pulses without any jitter."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SmoothAngle:
    """A shaft's angle as a function of time."""

    spline: BSpline  # the angle, rad, over time, s
    begin: float  # time of the first pulse used, s
    end: float  # time of the last pulse used, s
    jitter: float  # typical standard deviation of a pulse's time about the smooth angle, s
    groups: Float
    shares: Float  # variance of the smooth angle over that of one pulse, shape ``(S,)``
    share_t: Float  # times of these, s, shape ``(S,)``
    pattern: Float  # how far each pulse of a turn is ahead of even spacing, rad, shape ``(P,)``
    outlying: Float  # times of pulses left out because they are far from the smooth angle, s
    count: int  # pulses used

    @property
    def share(self) -> float:
        """Mean of the shares over the pulses: what the spline takes of their number is this times :attr:`count`."""
        angle = self.angle(self.share_t)
        return float(np.trapezoid(np.minimum(self.shares, 1.0), angle) / (angle[-1] - angle[0]))

    def angle(self, t: Float) -> Float:
        """Angle, rad, at times, s; zero at the first pulse's nominal position."""
        return np.asarray(self.spline(t))

    def speed(self, t: Float) -> Float:
        """First derivative of the angle, rad/s."""
        return np.asarray(self.spline(t, nu=1))

    def acceleration(self, t: Float) -> Float:
        """Second derivative of the angle, rad/s^2."""
        return np.asarray(self.spline(t, nu=2))

    def stderr(self, t: Float) -> Float:
        """Standard error of the angle, rad, between the first and the last pulse."""
        return np.asarray(self.scatter(t) * np.sqrt(np.interp(t, self.share_t, self.shares)))

    def scatter(self, t: Float) -> Float:
        """Standard deviation of a single pulse's angle, rad, at times, s."""
        return np.asarray(np.exp(np.interp(t, self.groups[0], np.log(self.groups[1]))))


def smooth_angle(
    pulses: NumberedPulses, *, duration: float, pulses_per_turn: int = 1, resolution: float = 0.0
) -> SmoothAngle:
    """Fit the smooth angle to counted pulses."""
    step = 2 * np.pi / pulses_per_turn
    if pulses.times.size < 4 * pulses_per_turn and pulses_per_turn > 1:
        raise ValueError(
            f"{pulses.times.size} pulses of a wheel with {pulses_per_turn}; at least four turns are needed"
        )
    keep = np.ones(pulses.times.size, dtype=bool)
    if pulses_per_turn == 1:
        keep = ~_displaced(pulses, max(resolution, _ROUND_OFF * duration))
    for _ in range(4):
        fit = _fit(pulses.times[keep], pulses.numbers[keep], step, duration, pulses_per_turn)
        tooth = fit.pattern[pulses.numbers % pulses_per_turn]
        off = step * pulses.numbers + tooth - fit.angle(pulses.times)
        scatter = fit.scatter(pulses.times)
        scale = 1.4826 * float(np.median(np.abs(off[keep] / scatter[keep])))  # outliers have widened the scatter
        allowed = max(resolution, _ROUND_OFF * duration) * np.abs(fit.speed(pulses.times))
        near = np.abs(off) <= np.maximum(_OUTLYING_DEVIATIONS * scale * scatter, allowed)
        if np.array_equal(near, keep) or near.sum() < max(4, pulses.times.size // 2):
            break
        keep = near
    return replace(fit, outlying=pulses.times[~keep])


def _displaced(pulses: NumberedPulses, allowed: float) -> Bool:
    """Single pulses far from where the two before and the two after say they are: one of them bends the smooth angle
    towards itself. That is fitted without them first, and says then which stay left out. Not where the count is wrong,
    which leaves others displaced too."""
    odd = _off_place(pulses.times, pulses.numbers, allowed)
    if odd.any():
        left = np.flatnonzero(~odd)
        more = left[_off_place(pulses.times[left], pulses.numbers[left], allowed)]
        beside = 8  # pulses among which one displaced is no single one
        odd[[i for i in np.flatnonzero(odd) if np.abs(more - i).min(initial=beside) < beside]] = False
    return odd


def _off_place(t: Float, numbers: Index, allowed: float) -> Bool:
    """Pulses that are off the cubic through their four neighbours, more than these and by far more than usual, s."""
    if t.size < 5:
        return np.zeros(t.size, dtype=bool)
    n, inner = numbers.astype(float), slice(2, -2)
    near = [slice(0, -4), slice(1, -3), slice(3, -1), slice(4, None)]
    cubic = sum(
        t[one] * np.prod([(n[inner] - n[other]) / (n[one] - n[other]) for other in near if other is not one], axis=0)
        for one in near
    )
    off = np.pad(np.abs(t[inner] - cubic), 2)
    usual = median_filter(off, 31, mode="nearest")
    largest = np.lib.stride_tricks.sliding_window_view(np.pad(off, 2), 5).max(axis=1)
    least = 0.02 * np.gradient(t, n)  # of a turn: less does no harm
    limit = np.maximum(1.5 * _OUTLYING_DEVIATIONS * usual, np.maximum(least, allowed))
    return np.asarray((off == largest) & (off > limit))


def _fit(times: Float, numbers: Index, step: float, duration: float, per_turn: int) -> SmoothAngle:
    slope: Float = np.interp(times, (times[1:] + times[:-1]) / 2, step * np.diff(numbers) / np.diff(times))
    angle = np.asarray(step * numbers, dtype=float)
    present, tooth = np.unique(numbers % per_turn, return_inverse=True)  # a wheel with an index gap has not all teeth
    speed = slope / float(np.median(slope))
    relative = speed  # a first guess: all pulses scatter alike in time
    rows = _looked_at(times.size)
    most_knots = 200_000
    # Log10 of the penalty beyond which the spline is smoother than its knots would force it to be.
    largest_penalty = 3.0
    for _ in range(2):
        size = 128  # pieces of the spline to begin with
        posed, log_penalty = _posed(times, angle, relative**-2, duration, size, tooth)
        while log_penalty <= largest_penalty and size < min(times.size, most_knots):
            size = min(4 * size, most_knots)
            posed, log_penalty = _posed(times, angle, relative**-2, duration, size, tooth)
        best = posed.solve(log_penalty)
        spline = BSpline(posed.knots, best.coefficients + posed.trend, SPLINE_DEGREE, extrapolate=True)
        shares = np.minimum(posed.leverages(log_penalty, times[rows]) / relative[rows] ** 2, 0.95)
        if best.sigma < _ROUND_OFF * duration * float(slope.max()):
            break  # pulses without any jitter: what is left is rounding
        off = (angle + best.pattern[tooth] - spline(times)) / best.sigma
        relative = _scatter(times, speed, off**2, 1 - np.interp(times, times[rows], shares))
    scatter = np.maximum(best.sigma, 1e-300) * relative
    pattern = np.zeros(per_turn)
    pattern[present] = best.pattern
    shown = np.union1d(rows, np.linspace(0, times.size - 1, max(2 * times.size // POOLED_FREEDOM, 2)).astype(int))
    # between pulses that are far apart the angle is less well known than at them
    at = np.union1d(times[rows], (times[rows[:-1]] + times[rows[:-1] + 1]) / 2)
    return SmoothAngle(
        spline=spline,
        begin=float(times[0]),
        end=float(times[-1]),
        jitter=float(np.median(scatter / slope)),
        groups=np.stack([times[shown], scatter[shown]]),
        shares=posed.leverages(log_penalty, at) / np.interp(at, times, relative) ** 2,
        share_t=at,
        pattern=pattern,
        outlying=np.zeros(0),
        count=times.size,
    )


def _looked_at(count: int) -> Index:
    """Pulses at which it is computed how well the smooth angle is known: spread over all, every one near the ends."""
    sampled = 64  # pulses at least at which it is computed how far the smooth angle is better known than they are
    spread = np.linspace(0, count - 1, sampled).astype(int)
    at_either_end = 16  # pulses at either end at each of which it is: where a sweep begins they are far apart
    ends = np.arange(min(at_either_end, count))
    return np.unique(np.concatenate([ends, spread, count - 1 - ends]))


def _scatter(times: Float, speed: Float, squares: Float, left: Float) -> Float:
    """Standard deviation of each pulse's angle, from the squares that the spline has left a share of. The likeliest
    mixture of scatter in angle and scatter in time, pooled over neighbours for what is neither."""
    shares = np.array([0.0, 0.01, 0.03, 0.1, 0.3, 0.6, 0.85, 0.95, 0.99, 1.0])
    best, least = speed**2, np.inf
    for share in shares.tolist():
        variance = (1 - share) + share * speed**2
        variance = variance * float(np.sum(squares / variance) / np.sum(left))
        cost = float(np.sum(left * np.log(variance)))
        if cost < least:
            best, least = variance, cost
    groups = np.array_split(np.arange(times.size), max(times.size // POOLED_FREEDOM, 1))
    means = np.array([(squares / best)[group].sum() / left[group].sum() for group in groups])
    means = np.maximum(means, max(1e-4 * float(means.max()), 1e-30))
    return np.asarray(np.sqrt(best * np.interp(times, [times[group].mean() for group in groups], means)))


def _posed(
    times: Float, angle: Float, weight: Float, duration: float, size: int, tooth: Index
) -> tuple[_Problem, float]:
    """The problem on some knots and the log10 of its best penalty."""
    posed = _Problem(times, angle, weight, duration, size, tooth)

    def criterion(log_penalty: float) -> float:
        return posed.solve(log_penalty).criterion

    grid = np.linspace(-4.0, 12.0, 17)  # the criterion has a second minimum where an uneven sweep passes for jitter
    best = int(np.argmin([criterion(log_penalty) for log_penalty in grid]))
    bounds = (grid[max(best - 1, 0)], grid[min(best + 1, grid.size - 1)])
    near = float(minimize_scalar(criterion, bounds=bounds, method="bounded").x)
    # Round-off decides where in a flat minimum a search ends; it moves the parabola through points well apart far less.
    apart = 0.1
    below, here, above = (criterion(near + step) for step in (-apart, 0.0, apart))
    if below - 2 * here + above > 0:
        near += apart / 2 * (below - above) / (below - 2 * here + above)
    return posed, float(np.clip(near, *bounds))


class _Solution(NamedTuple):
    coefficients: Float
    pattern: Float
    sigma: float  # of one pulse's angle at the median speed, rad
    criterion: float  # minus twice the restricted log-likelihood, constants left out


class _Problem:
    """Normal equations of the penalised spline in banded storage (upper form), pattern columns beside them."""

    def __init__(self, times: Float, angle: Float, weight: Float, duration: float, pieces: int, tooth: Index) -> None:
        m = pieces + SPLINE_DEGREE
        self.knots: Float = duration / pieces * np.arange(-SPLINE_DEGREE, m + 1, dtype=float)
        # A quadratic is taken out first: what is left is small, which keeps its digits.
        quadratic = np.polynomial.Polynomial.fit(times, angle, 2, w=np.sqrt(weight))
        self.trend = _blossom(quadratic, np.lib.stride_tricks.sliding_window_view(self.knots[1:-1], SPLINE_DEGREE))
        y = angle - quadratic(times)
        count = int(tooth.max())  # teeth of a turn less one: the pattern sums to zero; angle = spline - pattern
        contrast = np.vstack([-np.eye(count), np.ones((1, count))])
        self.normal, self.right = np.zeros((SPLINE_DEGREE + 1, m)), np.zeros(m)
        self.cross, self.teeth, self.teeth_right = np.zeros((m, count)), np.zeros((count, count)), np.zeros(count)
        at_once = 100_000  # pulses turned into equations at once
        for begin in range(0, times.size, at_once):
            part = slice(begin, begin + at_once)
            design = BSpline.design_matrix(times[part], self.knots, SPLINE_DEGREE, extrapolate=True).tocsr()
            gram = design.T @ design.multiply(weight[part, None]).tocsr()
            for k in range(SPLINE_DEGREE + 1):
                self.normal[SPLINE_DEGREE - k, k:] += gram.diagonal(k)
            indicator = contrast[tooth[part]]
            weighted = weight[part, None] * indicator
            self.right += design.T @ (weight[part] * y[part])
            self.cross += design.T @ weighted
            self.teeth += indicator.T @ weighted
            self.teeth_right += weighted.T @ y[part]
        # D^T D of third differences, in the last four rows of the same storage.
        self.penalty, row = np.zeros((4, m)), np.array([-1.0, 3.0, -3.0, 1.0])
        for i in range(4):
            for k in range(i, 4):
                self.penalty[3 - (k - i), k : m - 3 + k] += row[i] * row[k]
        self.squares, self.size = float(weight @ y**2), times.size

    def solve(self, log_penalty: float) -> _Solution:
        penalty = 10.0**log_penalty
        factor = self._factor(log_penalty)
        m, teeth = self.right.size, self.teeth_right.size
        spline_part = cho_solve_banded((factor, False), self.right)
        determinant = 2 * float(np.log(factor[-1]).sum())
        pattern = np.zeros(0)
        if teeth:
            reduced = cho_solve_banded((factor, False), self.cross)
            schur = self.teeth - self.cross.T @ reduced
            pattern = np.linalg.solve(schur, self.teeth_right - self.cross.T @ spline_part)
            spline_part = spline_part - reduced @ pattern
            determinant += float(np.linalg.slogdet(schur)[1])
        free = max(self.size - 3 - teeth, 1)
        variance = max(self._left(penalty, spline_part, pattern), 1e-30) / free
        return _Solution(
            coefficients=spline_part,
            pattern=np.concatenate([pattern, [-pattern.sum()]]),
            sigma=float(np.sqrt(variance)),
            criterion=free * np.log(variance) + determinant - (m - 3) * np.log(penalty),
        )

    def _left(self, penalty: float, coefficients: Float, pattern: Float) -> float:
        """Weighted squares that are left, and the penalty. Round-off of the coefficients enters by its square; what the
        normal equations say is fitted has it by itself, by units of the criterion where the knots are many."""
        moved = dsbmv(SPLINE_DEGREE, 1.0, self.normal, coefficients) - 2 * self.right + 2 * self.cross @ pattern
        turned = self.teeth @ pattern - 2 * self.teeth_right
        jerk = np.diff(coefficients, 3)
        return float(self.squares + coefficients @ moved + pattern @ turned + penalty * (jerk @ jerk))

    def leverages(self, log_penalty: float, times: Float) -> Float:
        """Variance of the spline at some times over that of a pulse of weight one; the pattern's share left out."""
        factor, found = self._factor(log_penalty), []
        at_once = 32  # times at which it is computed at once
        for part in np.array_split(times, -(-times.size // at_once)):  # rows as long as the knots are many
            rows = BSpline.design_matrix(part, self.knots, SPLINE_DEGREE, extrapolate=True).toarray().T
            found.append(np.sum(rows * cho_solve_banded((factor, False), rows), axis=0))
        return np.concatenate(found)

    def _factor(self, log_penalty: float) -> Float:
        whole = self.normal.copy()
        whole[-4:] += 10.0**log_penalty * self.penalty
        whole[-1] += 1e-13 * whole[-1].max()  # columns without a pulse and hardly a penalty
        return np.asarray(cholesky_banded(whole))


def _blossom(quadratic: np.polynomial.Polynomial, knots: Float) -> Float:
    """B-spline coefficients of a quadratic: its polar form at each function's inner knots ``(m, SPLINE_DEGREE)``."""
    a, b, c = (np.concatenate([quadratic.convert().coef, np.zeros(3)]))[:3]
    total = knots.sum(axis=1)
    pairs = (total**2 - (knots**2).sum(axis=1)) / (SPLINE_DEGREE * (SPLINE_DEGREE - 1))
    return np.asarray(a + b * total / SPLINE_DEGREE + c * pairs)
