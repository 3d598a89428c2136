"""A problem with the sizes of causes as further entries: an objective whose residuals are linear in them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from rotorfit.base.array_types import Bool, ComplexArray, Float, Index
from rotorfit.estimators.blocks.correlated import whiten
from rotorfit.estimators.inference.constrained_minima import damped_steps, kept_of_one_sign, solved
from rotorfit.estimators.inference.covariance import prior_curvature
from rotorfit.estimators.inference.linear_causes import LinearCauses
from rotorfit.estimators.inference.log_posterior import box
from rotorfit.estimators.minimisation.least_squares import Options, Status, minimise
from rotorfit.estimators.misfit.problem import Normal, Problem, robust_weights
from rotorfit.estimators.noise.run_effects import inverse_of_determined

_TOGETHER = 65_536
"""Readings of all vectors whose derivatives are evaluated together: more leave the cache."""


@dataclass(frozen=True, eq=False, kw_only=True)
class CausedProblem:
    """A problem beside causes, of vectors ``(x, c)`` with sizes in standard uncertainties, of the prior N(0, 1).

    To first order about where they were solved a cause is what some change ``T c`` of the fitted values would be, and
    what is left of its column beside that: predictions are ``f(x - T c) + (B + J T) c``. Values that a cause is taken
    for thus make room for it in full, however far both go, as a damper for the fluid's damping.
    """

    problem: Problem  # with the effect of the causes taken out of its readings
    causes: LinearCauses
    start: Float  # where the columns are, shape ``(p + k,)``
    moved: ComplexArray | float = 0.0  # whitened change of the readings, shape ``(R,)``

    @property
    def count(self) -> int:
        """Entries of the fitted vector, which come before the sizes."""
        return self.problem.space.size

    @cached_property
    def bounds(self) -> tuple[Float, Float]:
        """Of the vectors."""
        lower, upper = box(self.problem)
        open_ = np.full(self.causes.at.size, np.inf)
        return np.concatenate([lower, np.where(self.causes.one_sided, 0.0, -open_)]), np.concatenate([upper, open_])

    @cached_property
    def one_sided(self) -> Bool:
        """Entries that are sizes of causes of one sign."""
        return np.concatenate([np.zeros(self.count, dtype=bool), self.causes.one_sided])

    @cached_property
    def taken(self) -> Float:
        """Changes of the fitted values that take up causes, shape ``(p, k)``; of none that is known beforehand,
        or near a bound."""
        _, J = self.problem.jacobian(self.start[: self.count])
        rows = np.ascontiguousarray(J.T).view(float)
        known = np.diag(prior_curvature(self.problem, self.start[: self.count]))
        covar, _ = inverse_of_determined(rows @ rows.T + known)
        taken = -covar @ (rows @ self.causes.rows)
        taken[[prior.entry for prior in self.problem.priors]] = 0.0
        x, (lower, upper), far = self.start[: self.count], box(self.problem), 6 * np.linalg.norm(taken, axis=1)
        return np.where(((x - lower > far) & (upper - x > far))[:, None], taken, 0.0)

    @cached_property
    def beside(self) -> ComplexArray:
        """What is left of the columns of causes beside what the fitted values take up, shape ``(R, k)``."""
        _, J = self.problem.jacobian(self.start[: self.count])
        return np.asarray(self.causes.columns + J @ self.taken)

    @cached_property
    def _rows(self) -> Float:
        return np.ascontiguousarray(np.ascontiguousarray(self.beside.T).view(float).T)

    @cached_property
    def _gram(self) -> Float:
        return np.asarray(self._rows.T @ self._rows)

    def with_noise(self, factor: float) -> CausedProblem:
        """The same with the noise of all readings times a factor."""
        return replace(self, problem=self.problem.with_noise(factor), causes=self.causes.with_noise(factor))

    def taken_up(self, sizes: Float) -> Float:
        """What the fitted values take up of sizes, from those where they were solved, shape ``(M, p)``."""
        return np.asarray((sizes - self.causes.at) @ self.taken.T)

    def moved_by(self, measured: ComplexArray, sizes: Float) -> ComplexArray:
        """Whitened changes of the readings to ``measured``, and by what sizes of causes leave beside what the fitted
        values take up, shapes ``(M, R)``, ``(M, k)``."""
        parts = self.problem.by_block(np.arange(measured.shape[1]))
        pairs = zip(self.problem.blocks, parts, strict=True)
        away = [whiten(block, measured[:, part] - block.measured) for block, part in pairs]
        return np.concatenate(away, axis=1) + (sizes - self.causes.at) @ self.beside.T

    # ---- the objective -----------------------------------------------------------------------------------------------

    def evaluate(self, y: Float, moved: ComplexArray | None = None) -> Normal:
        """Costs, gradients and Gauss-Newton matrices of vectors ``(W, p + k)``; ``moved`` readings of each in place of
        those of the problem, shape ``(W, R)``."""
        p, cost, gradient = self.count, np.zeros(len(y)), np.zeros(y.shape)
        total, taken = np.zeros((*y.shape, y.shape[1])), self.taken
        step = max(1, 2 * _TOGETHER // self.problem.n_data)
        for first in range(0, len(y), step):
            some = slice(first, first + step)
            beyond = y[some, p:] - self.causes.at
            r, J = self.problem.jacobian(y[some, :p] - beyond @ taken.T)
            away = self.moved if moved is None else moved[some]
            left = np.ascontiguousarray(r + beyond @ self.beside.T - away)
            rho, weight = robust_weights(self.problem.loss, left.real**2 + left.imag**2)
            rows = np.ascontiguousarray(np.swapaxes(J, -1, -2)).view(float)  # (w, p, 2 R)
            twice = np.repeat(weight, 2, axis=-1)
            miss, linear = left.view(float) * twice, self.problem.loss == "linear"
            weighed = rows if linear else rows * twice[:, None, :]
            cost[some] = 0.5 * rho.sum(axis=-1)
            gradient[some, :p] = slope = (rows @ miss[..., None])[..., 0]
            gradient[some, p:] = miss @ self._rows - slope @ taken
            # The columns of the causes are those beside what the fitted values take up, less the derivatives along it.
            total[some, :p, :p] = own = weighed @ rows.swapaxes(-1, -2)
            across = weighed @ self._rows
            total[some, :p, p:] = across - own @ taken
            between = self._gram if linear else self._rows.T @ (twice[..., None] * self._rows)
            mixed = taken.T @ across
            total[some, p:, p:] = between - mixed - mixed.swapaxes(-1, -2) + taken.T @ own @ taken
        total[:, p:, :p] = total[:, :p, p:].swapaxes(-1, -2)
        for prior in self.problem.priors:
            value, slope, curvature = prior.terms(y[:, prior.entry])
            cost += value
            gradient[:, prior.entry] += slope
            total[:, prior.entry, prior.entry] += curvature
        own = y[:, p:]
        cost += 0.5 * np.einsum("wk,wk->w", own, own)
        gradient[:, p:] += own
        total[:, p:, p:] += np.eye(own.shape[1])
        return cost, gradient, total

    def cost(self, y: Float) -> float:
        """See :class:`~rotorfit.estimators.minimisation.objective.Objective`."""
        return self.gauss_newton(y)[0]

    def gauss_newton(self, y: Float) -> tuple[float, Float, Float]:
        """See :class:`~rotorfit.estimators.minimisation.objective.Objective`."""
        cost, gradient, matrix = self.evaluate(y[None])
        return float(cost[0]), gradient[0], matrix[0]

    def hessian(self, y: Float) -> Float:
        """Second derivatives of the cost by differences of the exact gradient."""
        size = np.concatenate([np.maximum(np.abs(y[: self.count]), 1e-8), np.ones(y.size - self.count)])
        beyond = y + np.diag(np.sqrt(np.finfo(float).eps) * size)
        gradient = self.evaluate(np.concatenate([y[None], beyond]))[1]
        matrix = (gradient[1:] - gradient[0]) / (np.diagonal(beyond) - y)[:, None]
        return np.asarray((matrix + matrix.T) / 2)

    # ---- optima ------------------------------------------------------------------------------------------------------

    def minimum(self, start: Float | None = None, options: Options | None = None) -> tuple[Float, bool]:
        """The optimum near a start, and whether it is one."""
        lower, upper = self.bounds
        begin = np.clip(self.start if start is None else start, lower, upper)
        scale = np.concatenate([np.maximum(np.abs(begin[: self.count]), 1e-12), np.ones(begin.size - self.count)])
        found = minimise(self, begin, lower=lower, upper=upper, scale=scale, options=options or Options())
        return found.x, found.status in (Status.CONVERGED, Status.SINGULAR)

    def minima(self, moved: ComplexArray, options: Options) -> tuple[Float, Bool]:
        """Optima for many sets of readings, shapes ``(M, p + k)`` and ``(M,)``, to a hundredth of a standard error;
        those that steps do not find, as at bounds, one by one."""
        lower, upper = (np.broadcast_to(bound, (len(moved), self.start.size)) for bound in self.bounds)

        def step(y: Float, gradient: Float, matrix: Float, members: Index) -> tuple[Float, Float]:
            (down,) = solved(matrix, -gradient)
            return kept_of_one_sign(self.one_sided, matrix, y, down, np.zeros_like(down))

        def normal(y: Float, members: Index) -> Normal:
            return self.evaluate(y, moved[members])

        enough = 1e-4  # squared step that remains, in standard errors
        found = damped_steps(normal, np.tile(self.start, (len(moved), 1)), lower, upper, step, enough)
        y, good = found.x, found.found
        for member in np.flatnonzero(~good).tolist():
            y[member], good[member] = replace(self, moved=moved[member]).minimum(y[member], options)
        return y, good
