"""Causes solved together with the fitted values, and what each leaves in the error of a result.

A cause is a column ``b`` beside the Jacobian: the change of the whitened predictions by its size ``c``, of which a
standard uncertainty ``s`` is known before the data. With the residuals ``r`` at ``c = 0``

    minimise |r + J dx + B c|^2 + sum (c / s)^2 + priors of x.

With the fitted values eliminated, ``c`` has the covariance ``C_c`` and moves them by ``T c``. A result with the slopes
``g_x`` and ``g_c`` moves by ``h = T' g_x + g_c`` with the causes, and its variance is that of the noise and
``h' C_c h``: exact, additive, and the same whatever asks for it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from rotorfit.base.array_types import Bool, ComplexArray, Float, Index
from rotorfit.estimators.noise.run_effects import inverse_of_determined, parts, products, real_rows

TOLD = 0.05
"""Determined share of a cause below which a test of it would be one of round-off and curvature. Chosen."""
_ON_TRUST = 0.5
"""Determined share of a cause below which its interval has the shape of what is known before the data. Chosen."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Shares:
    """Standard error of a result by its shares, which add up as squares; ``trust`` cause by cause."""

    noise: float  # if every cause were known
    bounded: float  # by causes that had to be found from the data
    trust: Float  # by the size that each cause is given before the data, with the sign of its slope, shape ``(k,)``

    @property
    def systematic(self) -> float:
        """The share of all causes."""
        return math.hypot(self.bounded, float(np.linalg.norm(self.trust)))

    @property
    def total(self) -> float:
        """The standard error."""
        return math.hypot(self.noise, self.systematic)


@dataclass(frozen=True, eq=False, kw_only=True)
class Reach:
    """How far the interval of a result reaches below and above its value.

    What rests on a cause that is never negative lengthens the interval to one side only, and to the other as far as the
    estimate of the cause has room.
    """

    rest: float  # variance of all else
    one_sided: Float  # slope by a standard deviation of each cause that is never negative and on trust
    room: Float  # estimates of these over their standard deviations

    def ends(self, reach: float) -> tuple[float, float]:
        """Both sides; ``reach``: standard errors on either side of a normal estimate."""
        plain, room = reach**2 * self.rest, np.minimum(reach, self.room)
        ahead = np.where(self.one_sided > 0, reach, room) * self.one_sided
        behind = np.where(self.one_sided > 0, room, reach) * self.one_sided
        return math.sqrt(plain + float(behind @ behind)), math.sqrt(plain + float(ahead @ ahead))


@dataclass(frozen=True, eq=False, kw_only=True)
class JointErrors:
    """Causes as they were solved with the fitted values."""

    size: Float  # standard uncertainty of each before the data, shape ``(k,)``
    one_sided: Bool  # causes that are never negative
    free: Float  # most probable size of each whatever its sign
    covar: Float  # ``C_c``, covariance of the sizes, data and all other causes included, shape ``(k, k)``
    moves: Float  # ``T``, change of the fitted vector by a unit of each cause, shape ``(p, k)``
    widened: float = 1.0  # factor on all variances, where no listed cause explains the misfit
    z_beside_runs: Float | None = None  # scores beside what few runs may differ by, which passes for causes

    @classmethod
    def of(
        cls,
        r: ComplexArray,
        J: ComplexArray,
        B: ComplexArray,
        *,
        inverse: Float,
        size: Float,
        one_sided: Bool,
        runs: ComplexArray | None = None,
    ) -> JointErrors:
        """Solve for causes beside fitted values.

        Args:
            r: whitened residuals at no cause, shape ``(R,)``, the fitted values at their optimum beside the causes.
            J, B: derivatives by the fitted vector and by the causes, shapes ``(R, p)`` and ``(R, k)``.
            inverse: covariance of the fitted vector by the noise alone, at unit noise, priors of the vector included.
            size: standard uncertainty of each cause before the data.
            one_sided: causes that are never negative.
            runs: changes of the residuals by a standard deviation of what each run may differ by, shape ``(R, m)``.
        """
        k, beside = size.size, B if runs is None else np.hstack([B, runs])
        moves = -inverse @ np.sum([real_rows(J[some]) @ real_rows(beside[some]).T for some in parts(r.size)], axis=0)
        unit = np.append(size, np.ones(moves.shape[1] - k))[:, None]

        def left(number: int) -> Iterator[Float]:
            """What the fitted values do not take up of the causes, in units of their sizes, and of the runs, by parts
            of the readings."""
            for some in parts(r.size):
                yield ((real_rows(beside[some]) + moves.T @ real_rows(J[some])) * unit)[:number]

        gram, push = np.zeros((unit.size, unit.size)), np.zeros(unit.size)
        for some, own in zip(parts(r.size), left(unit.size), strict=True):
            gram += own @ own.T
            push += own @ real_rows(r[some, None])[0]
        covar = _inverse_beside_one(gram[:k, :k], lambda: left(k))
        free = -size * (covar @ push[:k])
        z = None
        if runs is not None:
            z = _scores(_inverse_beside_one(gram, lambda: left(unit.size)), push)[:k]
        covar = covar * np.outer(size, size)
        return cls(size=size, one_sided=one_sided, free=free, covar=covar, moves=moves[:, :k], z_beside_runs=z)

    def in_noise(self, factor: float) -> JointErrors:
        """The same where the variance of the noise is a factor larger, at the same sizes."""
        unit = np.outer(self.size, self.size)
        left, basis = np.linalg.eigh(self.covar / unit)
        left = np.clip(left, 0.0, 1.0)
        return replace(self, covar=((basis * (factor * left / (1 + (factor - 1) * left))) @ basis.T) * unit)

    @cached_property
    def value(self) -> Float:
        """Most probable size of each cause, none of one sign below zero."""
        if not (self.one_sided & (self.free < 0)).any():
            return self.free
        return nearest_of_one_sign(self.free, self.covar, self.one_sided)

    @cached_property
    def deviation(self) -> Float:
        """Standard deviation of each cause after the data."""
        return np.sqrt(np.diag(self.covar))

    @cached_property
    def determined(self) -> Float:
        """Share of what was open of each cause that the data tell: 0 on trust, 1 told by the data."""
        share = 1 - (self.deviation / self.size) ** 2
        return np.where(share > 1e-8, share, 0.0)  # below is round-off

    @cached_property
    def z(self) -> Float:
        """Score of each cause against none, beside all others and what few runs may differ by; NaN where the data do
        not tell."""
        told = self.determined > TOLD
        power = np.where(told, self.determined, 1.0)
        z = np.where(told, self.value / (self.deviation * np.sqrt(power)), np.nan)
        beside = z if self.z_beside_runs is None else self.z_beside_runs
        return np.where(np.abs(z) < np.abs(beside), z, np.sign(z) * np.abs(beside))

    @cached_property
    def pull(self) -> Float:
        """Size over what it scatters by if the size given before the data is right; NaN where the data do not tell."""
        told = self.determined > TOLD
        power = np.where(told, self.determined, 1.0)
        return np.where(told, self.value / (self.size * np.sqrt(power)), np.nan)

    def each_alone(self, group: Index) -> tuple[Float, Float, Float]:
        """Value, standard deviation and score of each cause of a group if the others of that group are none, each of
        shape ``(m,)``: what all of them share is not told, and hides which of them it is that acts."""
        scale = self.deviation
        information = np.linalg.inv(self.covar / np.outer(scale, scale))
        push = information @ (self.free / scale)
        found = []
        for one in group.tolist():
            kept = np.setdiff1d(np.arange(scale.size), np.setdiff1d(group, one))
            covar = np.linalg.inv(information[np.ix_(kept, kept)])
            at = int(np.flatnonzero(kept == one)[0])
            sd, size = float(np.sqrt(covar[at, at])) * scale[one], self.size[one]
            value = float(covar[at] @ push[kept]) * scale[one]
            share = 1 - (sd / size) ** 2
            found.append((value, sd, value / (sd * math.sqrt(share)) if share > TOLD else math.nan))
        value, sd, z = np.array(found).reshape(-1, 3).T
        return value, sd, z

    @property
    def covariance(self) -> Float:
        """What the causes add to the covariance of the fitted vector, shape ``(p, p)``."""
        return np.asarray(self.moves @ self.covar @ self.moves.T) * self.widened

    def along(self, by_values: Float, by_causes: Float) -> Float:
        """Slopes of a result by the causes, the fitted values following them, shape ``(..., k)``."""
        return np.asarray(by_values @ self.moves + by_causes)

    def shares(self, noise: float, slope: Float) -> Shares:
        """Shares of the error of a result with its error by the noise and its slopes :meth:`along` the causes."""
        root = math.sqrt(self.widened)
        moved = root * (self.covar @ slope)
        trust = moved / self.size
        rest = root * float(slope @ moved) - float(trust @ trust)
        return Shares(noise=noise, bounded=math.sqrt(max(rest, 0.0)), trust=trust)

    def drawn(self, count: int, rng: np.random.Generator) -> Float:
        """Sizes of the causes at random by what the data leave of them, none of one sign below zero, ``(count, k)``."""
        sd = self.deviation * math.sqrt(self.widened)
        root = np.linalg.cholesky(self.covar / np.outer(self.deviation, self.deviation) + 1e-12 * np.eye(sd.size))
        sizes = self.value + sd * (rng.normal(size=(count, sd.size)) @ root.T)
        return np.where(self.one_sided, np.maximum(sizes, 0.0), sizes)

    def reach(self, noise: float, slope: Float) -> Reach:
        """How far the interval of a result reaches, by its error by the noise and its slopes along the causes."""
        trusted = np.flatnonzero(self.one_sided & (self.determined < _ON_TRUST))
        covar = self.covar * self.widened
        whole = noise**2 + float(slope @ covar @ slope)
        if not trusted.size:
            return Reach(rest=whole, one_sided=np.zeros(0), room=np.zeros(0))
        sd = np.sqrt(np.diag(covar))[trusted]
        block = covar[np.ix_(trusted, trusted)] / np.outer(sd, sd)
        along = (covar @ slope)[trusted] / sd
        one = np.linalg.solve(block, along)  # by one standard deviation of each
        return Reach(
            rest=max(whole - float(along @ one), 0.0), one_sided=np.asarray(one), room=self.value[trusted] / sd
        )


def _scores(covar: Float, push: Float) -> Float:
    """Scores against none of sizes in units of what they are before the data; NaN where the data do not tell."""
    left = np.diag(covar)
    told = left < 1 - TOLD
    scatter = np.sqrt(np.where(told, left * (1 - left), 1.0))
    return np.where(told, -(covar @ push) / scatter, np.nan)


def _inverse_beside_one(gram: Float, columns: Callable[[], Iterator[Float]]) -> Float:
    """``inv(1 + B B')`` of rows B: of their products where these keep the digits, else of parts of the columns of B."""
    largest = 1e8  # of the products, which then tell sizes of one in eight digits
    if np.einsum("kk->k", gram).max(initial=0.0) < largest:
        return np.asarray(np.linalg.inv(gram + np.eye(len(gram))))
    root = np.zeros((0, len(gram)))
    for own in columns():
        root = np.asarray(np.linalg.qr(np.vstack([root, own.T]), mode="r"))
    _, size, basis = np.linalg.svd(root)
    return np.asarray((basis.T / (1 + size**2)) @ basis)


def nearest_of_one_sign(free: Float, covar: Float, one_sided: Bool) -> Float:
    """Most probable vector of a normal distribution with the entries of one sign not below zero."""
    from scipy.optimize import nnls  # late: loading it takes longer than a fit

    bound = np.flatnonzero(one_sided)
    sd = np.sqrt(np.diag(covar))
    scaled = covar / np.outer(sd, sd)
    # The others follow freely: the distribution of the bound ones alone is their block of the covariance.
    root = np.linalg.cholesky(np.linalg.inv(scaled[np.ix_(bound, bound)]))
    start = free[bound] / sd[bound]
    found, _ = nnls(root.T, root.T @ start)
    onto = scaled[:, bound] @ np.linalg.solve(scaled[np.ix_(bound, bound)], found - start)
    value = free + sd * onto
    value[bound] = sd[bound] * found
    return np.asarray(value)


def joint_step(
    r: ComplexArray,
    J: ComplexArray,
    B: ComplexArray,
    *,
    size: Float,
    one_sided: Bool,
    prior: Float,
    prior_slope: Float,
) -> tuple[Float, Float, float]:
    """Step of the fitted values, and the sizes of the causes, at the optimum of the linearised problem, and its ``Q``.

    Args:
        r: whitened residuals at no cause.
        J, B: derivatives by the fitted vector and by the causes.
        size, one_sided: as for :class:`JointErrors`.
        prior, prior_slope: curvature and slope of the priors of the fitted vector.
    """
    p, scale = J.shape[1], np.concatenate([np.ones(J.shape[1]), size, [1.0]])
    whole = products(r, B, J, np.arange(r.size)) * np.outer(scale, scale)
    gram, moment, square = whole[:-1, :-1], whole[:-1, -1], float(whole[-1, -1])
    slope = moment + np.concatenate([prior_slope, np.zeros(size.size)])
    covar, _ = inverse_of_determined(gram + np.diag(np.concatenate([prior, np.ones(size.size)])))
    step = -covar @ slope
    own = step[p:]
    if (one_sided & (own < 0)).any():
        held = nearest_of_one_sign(own, covar[p:, p:], one_sided)
        step = step + covar[:, p:] @ np.linalg.solve(covar[p:, p:], held - own)
        step[p:] = held
    left = square + float((2 * moment + gram @ step) @ step)
    return step[:p], step[p:] * size, left + float(step[p:] @ step[p:])


def error_factor(pulls: Sequence[float]) -> float:
    """Factor by which sizes are too small, by pulls that should be of unit variance; one where they are not."""
    from scipy.special import gammaincc  # late: loading it takes longer than a fit

    square, count = float(np.sum(np.square(pulls))), len(pulls)
    too_small = 0.01  # probability of pulls so large where the sizes are right. Chosen.
    if not count or gammaincc(count / 2, square / 2) >= too_small:
        return 1.0
    return math.sqrt(square / count)
