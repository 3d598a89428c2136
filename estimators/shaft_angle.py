"""Angle, speed and acceleration of a shaft from its pulses, smoothed as much as the pulses jitter and no more.

The angle is a quintic spline whose third derivative is penalised, so that a steadily accelerating shaft costs nothing:
`sum_k (theta_k - theta(t_k))^2/(theta' sigma_t)^2 + penalty int theta'''^2 dt` (P-splines; Eilers and Marx 1996). Seen
as a model, the jerk is white noise and the pulse times scatter by ``sigma_t``; the ratio of the two is what restricted
maximum likelihood says (Wahba 1985), from the pulses alone. Knots are doubled until the penalty, not they, smooths.

Several pulses a turn carry the same errors of spacing every turn: a pattern with zero mean, estimated with the spline.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline
from scipy.linalg import cho_solve_banded, cholesky_banded
from scipy.optimize import minimize_scalar

from rotorfit.estimators.pulses import NumberedPulses

Float = NDArray[np.float64]
Index = NDArray[np.intp]

DEGREE = 5
MOST_KNOTS = 200_000
_GROUP = 60
"""Pulses whose scatter is pooled: known to 1/sqrt(2 * 60) = 9 %."""
_OUTLYING = 7.0
"""Robust standard deviations beyond which a pulse is taken for noise: never once in a million Gaussian ones."""
_ROUNDING = 1e-9
"""Share of the record's length below which a pulse is never late: what is left of pulses without any jitter."""
_SMOOTH_ENOUGH = 3.0
"""log10 of the penalty beyond which the spline is smoother than its knots would force it to be."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SmoothAngle:
    """A shaft's angle as a function of time.

    Attributes:
        spline: the angle, rad, over time, s.
        begin, end: times of the first and the last pulse used, s.
        jitter: standard deviation of a pulse's time about the smooth angle, s.
        share: variance of the smooth angle over that of one pulse, mean over the pulses.
        spread: mean over the pulses of the speed to the power -7/6, see :meth:`stderr`.
        scatter: standard deviation of the angle of single pulses about the smooth angle, rad, over time, s, shape
            ``(2, S)``: times and values.
        pattern: how far each pulse of a turn is ahead of even spacing, rad, shape ``(P,)``; zeros for one pulse a turn.
        outlying: times of pulses left out because they are far from the smooth angle, s.
        pulses: number of pulses used.
    """

    spline: BSpline
    begin: float
    end: float
    jitter: float
    share: float
    spread: float
    scatter: Float
    pattern: Float
    outlying: Float
    pulses: int

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
        """Standard error of the angle, rad, between the first and the last pulse.

        It is the scatter of the pulses around the time times the root of the share of it that the spline keeps. Pulses
        come at a rate that grows with the speed W and are weighted by ``1/W^2``, so that information comes at the rate
        1/W; a spline whose third derivative is penalised averages over a time that goes with the sixth root of W
        (Silverman 1984): the share goes with ``W^(-7/6)``, and its mean is that of the spline's degrees of freedom.
        """
        share = self.share / self.spread * np.abs(self.speed(t)) ** (-7 / 6)
        return np.asarray(np.interp(t, *self.scatter) * np.sqrt(np.minimum(share, 1.0)))


def smooth_angle(
    pulses: NumberedPulses, *, duration: float, pulses_per_turn: int = 1, resolution: float = 0.0
) -> SmoothAngle:
    """Fit the smooth angle to counted pulses.

    Args:
        pulses: times in s from the start of the record.
        duration: of the record, s; the spline covers all of it, beyond the pulses with the acceleration at the ends.
        pulses_per_turn: of the wheel.
        resolution: time that a good pulse may be off in any case, s: a sampling interval.

    Raises:
        ValueError: too few pulses for their pattern.
    """
    step = 2 * np.pi / pulses_per_turn
    if pulses.times.size < 4 * pulses_per_turn and pulses_per_turn > 1:
        raise ValueError(
            f"{pulses.times.size} pulses of a wheel with {pulses_per_turn}; at least four turns are needed"
        )
    keep = np.ones(pulses.times.size, dtype=bool)
    for _ in range(4):
        fit = _fit(pulses.times[keep], pulses.numbers[keep], step, duration, pulses_per_turn)
        tooth = fit.pattern[pulses.numbers % pulses_per_turn]
        late = (step * pulses.numbers + tooth - fit.angle(pulses.times)) / fit.speed(pulses.times)
        scale = 1.4826 * float(np.median(np.abs(late[keep])))
        near = np.abs(late) <= max(_OUTLYING * scale, resolution, _ROUNDING * duration)
        if np.array_equal(near, keep) or near.sum() < max(4, pulses.times.size // 2):
            break
        keep = near
    return SmoothAngle(**{**vars(fit), "outlying": pulses.times[~keep]})


def _fit(times: Float, numbers: Index, step: float, duration: float, per_turn: int) -> SmoothAngle:
    gap = np.diff(times)
    slope: Float = np.interp(times, (times[1:] + times[:-1]) / 2, step * np.diff(numbers) / gap)
    weight = np.asarray((np.median(slope) / slope) ** 2, dtype=float)
    size, best = 32, None
    while True:
        problem = _Problem.build(
            times, np.asarray(step * numbers, dtype=float), weight, duration, min(size, MOST_KNOTS), numbers % per_turn
        )
        log_penalty = float(minimize_scalar(problem.criterion, bounds=(-4.0, 12.0), method="bounded").x)
        best = problem.solve(log_penalty)
        if log_penalty > _SMOOTH_ENOUGH or size >= min(times.size, MOST_KNOTS):
            break
        size *= 2
    spline = BSpline(problem.knots, best.coefficients + problem.trend, DEGREE, extrapolate=True)
    off = step * numbers + best.pattern[numbers % per_turn] - spline(times)
    groups = np.array_split(np.arange(times.size), max(times.size // _GROUP, 1))
    left = 1 - min(best.freedom / times.size, 0.9)
    scatter = [[times[group].mean(), np.sqrt(np.mean(off[group] ** 2) / left)] for group in groups]
    return SmoothAngle(
        spline=spline, begin=float(times[0]), end=float(times[-1]), jitter=float(best.sigma / np.median(slope)),
        share=best.freedom / times.size, spread=float(np.mean(slope ** (-7 / 6))), scatter=np.array(scatter).T,
        pattern=best.pattern, outlying=np.zeros(0), pulses=times.size,
    )  # fmt: skip


@dataclass(frozen=True, kw_only=True, eq=False)
class _Solution:
    coefficients: Float
    pattern: Float
    sigma: float  # of one pulse's angle at the median speed, rad
    freedom: float  # of the spline
    criterion: float


@dataclass(frozen=True, kw_only=True, eq=False)
class _Problem:
    """Normal equations of the penalised spline in banded storage (upper form), pattern columns beside them."""

    knots: Float
    trend: Float  # coefficients of the quadratic taken out first: what is left is small, which keeps its digits
    normal: Float  # (DEGREE + 1, m)
    penalty: Float  # (4, m) in the last rows of the same storage
    right: Float  # (m,)
    squares: float
    cross: Float  # (m, P - 1): spline with pattern
    teeth: Float  # (P - 1, P - 1)
    teeth_right: Float  # (P - 1,)
    size: int  # pulses

    @classmethod
    def build(cls, times: Float, angle: Float, weight: Float, duration: float, pieces: int, tooth: Index) -> _Problem:
        h = duration / pieces
        knots = np.asarray(h * np.arange(-DEGREE, pieces + DEGREE + 1), dtype=float)
        m = pieces + DEGREE
        quadratic = np.polynomial.Polynomial.fit(times, angle, 2, w=np.sqrt(weight))
        greville = np.array([knots[1 + i : 1 + i + DEGREE] for i in range(m)])
        trend = _blossom(quadratic, greville)
        y = angle - quadratic(times)
        design = BSpline.design_matrix(times, knots, DEGREE, extrapolate=True).tocsr()
        values = design.data.reshape(-1, DEGREE + 1)
        first = design.indices.reshape(-1, DEGREE + 1)[:, 0]
        normal = np.zeros((DEGREE + 1, m))
        for i in range(DEGREE + 1):
            for k in range(i, DEGREE + 1):
                product = weight * values[:, i] * values[:, k]
                normal[DEGREE - (k - i)] += np.bincount(first + k, product, m)
        per_turn = int(tooth.max()) + 1
        contrast = np.vstack([np.eye(per_turn - 1), -np.ones((1, per_turn - 1))])  # sums to zero
        indicator = contrast[tooth] * -1.0  # angle = spline - pattern
        return cls(
            knots=knots, trend=trend, normal=normal, penalty=_third_differences(m), right=design.T @ (weight * y),
            squares=float(weight @ y**2), cross=np.asarray(design.T @ (weight[:, None] * indicator)),
            teeth=indicator.T @ (weight[:, None] * indicator), teeth_right=indicator.T @ (weight * y),
            size=times.size,
        )  # fmt: skip

    def criterion(self, log_penalty: float) -> float:
        """Minus twice the restricted log-likelihood, constants left out."""
        return self.solve(log_penalty).criterion

    def solve(self, log_penalty: float) -> _Solution:
        penalty = 10.0**log_penalty
        whole = self.normal.copy()
        whole[-4:] += penalty * self.penalty
        whole[-1] += 1e-13 * whole[-1].max()  # columns without a pulse and hardly a penalty
        factor = cholesky_banded(whole)
        m, teeth = self.right.size, self.teeth_right.size
        spline_part = cho_solve_banded((factor, False), self.right)
        determinant = 2 * float(np.log(factor[-1]).sum())
        pattern = np.zeros(0)
        fitted = float(self.right @ spline_part)
        if teeth:
            reduced = cho_solve_banded((factor, False), self.cross)
            schur = self.teeth - self.cross.T @ reduced
            rest = self.teeth_right - self.cross.T @ spline_part
            pattern = np.linalg.solve(schur, rest)
            spline_part = spline_part - reduced @ pattern
            fitted += float(rest @ pattern)
            determinant += float(np.linalg.slogdet(schur)[1])
        free = max(self.size - 3 - teeth, 1)
        variance = max(self.squares - fitted, 1e-30) / free
        freedom = self._freedom(factor, penalty)
        return _Solution(
            coefficients=spline_part, pattern=np.concatenate([pattern, [-pattern.sum()]]),
            sigma=float(np.sqrt(variance)), freedom=freedom,
            criterion=free * np.log(variance) + determinant - (m - 3) * np.log(penalty),
        )  # fmt: skip

    def _freedom(self, factor: Float, penalty: float) -> float:
        """Trace of the smoother, by the derivative of the log-determinant over the log of the penalty."""
        more = self.normal.copy()
        more[-4:] += penalty * np.exp(1e-3) * self.penalty
        more[-1] += 1e-13 * more[-1].max()
        change = 2 * float(np.log(cholesky_banded(more)[-1]).sum() - np.log(factor[-1]).sum())
        return float(np.clip(self.right.size - change / 1e-3, 3.0, self.size))


def _third_differences(m: int) -> Float:
    """``D^T D`` of third differences, upper banded storage of 4 rows."""
    band = np.zeros((4, m))
    row = np.array([-1.0, 3.0, -3.0, 1.0])
    for i in range(4):
        for k in range(i, 4):
            band[3 - (k - i), k : m - 3 + k] += row[i] * row[k]
    return band


def _blossom(quadratic: np.polynomial.Polynomial, knots: Float) -> Float:
    """B-spline coefficients of a quadratic: its polar form at the inner knots, ``(m, DEGREE)``, of each function."""
    a, b, c = (np.concatenate([quadratic.convert().coef, np.zeros(3)]))[:3]
    total = knots.sum(axis=1)
    pairs = (total**2 - (knots**2).sum(axis=1)) / (DEGREE * (DEGREE - 1))
    return np.asarray(a + b * total / DEGREE + c * pairs)
