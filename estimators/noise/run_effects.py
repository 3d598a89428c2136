"""What differs from run to run and is the same within one: a mixed linear model about a fit.

``residual = -J dx - Z b + noise``: J the sensitivity to the fitted values, Z that of each run to errors of its own
(force, phase reference, speed label, fluid), b normal with one variance for each kind. The variances are found by
restricted likelihood (Patterson and Thompson 1971). All of it is done with one small matrix a run.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from rotorfit.models.array_types import ComplexArray, Float, Index

_NULL = 1e-9
"""Share of a run's sensitivity below which one kind is a combination of the others."""

_ALIKE = 1.5
"""Log likelihood below that of the best kind within which another may be the one as well: weights from a fifth up."""

_LARGEST = 0.3
"""Largest standard deviation of an effect that is looked for, relative: beyond it linearisation means nothing."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Common:
    """Sums over all readings: what the fit is without any effects of runs."""

    information: Float  # ``J^T J`` and the curvature of the priors, shape ``(p, p)``
    gradient: Float  # ``J^T r``, shape ``(p,)``
    square: float  # ``r^T r``

    @cached_property
    def outer(self) -> Float:
        """Covariance of the fitted values, shape ``(p, p)``."""
        return inverse_of_determined(self.information)

    @cached_property
    def step(self) -> Float:
        """Step to the optimum, shape ``(p,)``."""
        return -self.outer @ self.gradient

    @property
    def left(self) -> float:
        """What remains of the square there."""
        return self.square + float(self.gradient @ self.step)


@dataclass(frozen=True, eq=False, kw_only=True)
class MixedModel:
    """Sums over runs from which likelihoods and estimates follow."""

    gram: Float  # ``Z^T Z`` of each run, shape ``(n_runs, k, k)``
    cross: Float  # ``Z^T J`` of each run, shape ``(n_runs, k, p)``
    moment: Float  # ``Z^T r`` of each run, shape ``(n_runs, k)``
    common: Common  # sums over all of them

    @classmethod
    def of(cls, r: ComplexArray, J: ComplexArray, Z: ComplexArray, runs: Sequence[Index], prior: Float) -> MixedModel:
        """Sums of whitened residuals and sensitivities."""
        k, p = Z.shape[1], J.shape[1]
        stacked = np.concatenate([real_rows(Z), real_rows(J), r.view(float)[None]])
        whole = stacked[k:-1] @ stacked[k:].T
        parts = np.array([part[:k] @ part.T for part in (_of_run(stacked, rows) for rows in runs)])
        parts = parts.reshape(len(runs), k, k + p + 1)
        information, square = whole[:, :-1] + np.diag(prior), float(np.vdot(r, r).real)
        common = Common(information=information, gradient=whole[:, -1], square=square)
        return cls(gram=parts[:, :, :k], cross=parts[:, :, k:-1], moment=parts[:, :, -1], common=common)

    def louder(self, factor: float, prior: Float) -> MixedModel:
        """The model under noise that is larger by a factor; the curvature of the priors stays."""
        if factor == 1:
            return self
        less, common = factor**-2, self.common
        common = Common(
            information=common.information * less + np.diag(prior) * (1 - less),
            gradient=common.gradient * less,
            square=common.square * less,
        )
        return MixedModel(gram=self.gram * less, cross=self.cross * less, moment=self.moment * less, common=common)

    def part(self, kinds: Sequence[int]) -> MixedModel:
        """The model with some of the kinds only."""
        k = list(kinds)
        return replace(self, gram=self.gram[:, k][:, :, k], cross=self.cross[:, k], moment=self.moment[:, k])

    @property
    def rows(self) -> int:
        """Number of fitted values."""
        return self.common.gradient.size

    def _inner(self, variance: Float) -> Float:
        """``(Z^T Z + 1/variance)^-1`` of each run, infinite variances for effects that are free."""
        free = np.isinf(variance)
        curvature = np.diag(np.where(free, 0.0, 1 / np.where(free, 1.0, variance)))
        matrix = self.gram + curvature
        if not free.any():
            return np.asarray(np.linalg.inv(matrix))
        return inverse_of_determined(matrix, _NULL)

    def solve(self, variance: Float) -> Solved:
        """Step to the optimum with effects of given variances, and what remains of the square."""
        if not variance.size:
            return self._alone()
        inner, common = self._inner(variance), self.common
        onto = inner @ self.cross
        matrix = common.information - np.einsum("ikp,ikq->pq", self.cross, onto)
        slope = common.gradient - np.einsum("ikp,ik->p", onto, self.moment)
        outer = inverse_of_determined(matrix)
        step = -outer @ slope
        own = -np.einsum("ikl,il->ik", inner, self.moment + self.cross @ step)
        quadratic = (
            common.square - float(np.einsum("ik,ikl,il->", self.moment, inner, self.moment)) - slope @ outer @ slope
        )
        return Solved(inner=inner, onto=onto, outer=outer, matrix=matrix, step=step, own=own, square=float(quadratic))

    def _alone(self) -> Solved:
        """The step where no effects are looked for."""
        count, common = len(self.gram), self.common
        return Solved(
            inner=np.zeros((count, 0, 0)),
            onto=np.zeros((count, 0, self.rows)),
            outer=common.outer,
            matrix=common.information,
            step=common.step,
            own=np.zeros((count, 0)),
            square=common.left,
        )

    def log_likelihood(self, variance: Float) -> float:
        """Restricted log likelihood, up to a constant."""
        solved = self.solve(variance)
        root = np.sqrt(variance)
        spread = np.eye(root.size) + root[:, None] * self.gram * root
        return -0.5 * float(np.linalg.slogdet(spread)[1].sum() + _log_det(solved.matrix) + solved.square)

    def score_p_values(self) -> Float:
        """Probability, kind by kind, of scores at least as large where runs do not differ, shape ``(k,)``.

        The sum of squared scores is a mixture of chi-squared, matched in mean and variance.
        """
        from scipy.special import gammaincc  # late: loading it takes longer than a fit

        outer = self.common.outer
        C, own = np.swapaxes(self.cross, 0, 1), np.einsum("ikk->ki", self.gram)
        size = np.sqrt(np.where(own > 0, own, 1.0))  # runs count alike
        S = -(C @ outer @ np.swapaxes(C, 1, 2))
        np.einsum("kii->ki", S)[:] += own
        S /= size[:, :, None] * size[:, None, :]
        score = (self.moment.T + C @ self.common.step) / size
        mean, variance = np.einsum("kii->k", S), np.sum(S**2, axis=(1, 2))
        blind = mean <= _NULL * own.shape[1]
        over = np.where(blind, 0.0, mean) / np.where(blind, 1.0, variance)
        told = gammaincc(np.where(blind, 1.0, mean * over / 2), np.sum(score**2, axis=1) * over / 2)
        return np.where(blind, 1.0, told)

    def freedom(self, variance: Float) -> Float:
        """Degrees of freedom that each estimated variance has, at least two (one for two runs), shape ``(k,)``.

        A variance that was chosen because it is large errs to the safe side, and fewer would widen without end.
        """
        solved = self.solve(variance)
        found = []
        for kind, own in enumerate(variance):
            # What is left of b by its estimate: own - var(b | data) is the share that the data tell.
            C = solved.onto[:, kind]
            left = np.diag(solved.inner[:, kind, kind]) + C @ solved.outer @ C.T
            told = np.eye(len(left)) - left / own
            found.append(max(float(np.sum(told**2)), min(2.0, len(left) - 1.0)))
        return np.array(found)


@dataclass(frozen=True, eq=False, kw_only=True)
class Solved:
    """Estimates with effects of given variances."""

    inner: Float  # ``(Z^T Z + 1/variance)^-1`` of each run, and that times ``Z^T J``
    onto: Float  # ``(Z^T Z + 1/variance)^-1`` of each run, and that times ``Z^T J``
    outer: Float  # covariance of the fitted values, effects included, and its inverse
    matrix: Float  # covariance of the fitted values, effects included, and its inverse
    step: Float  # change of the fitted values
    own: Float  # effects of each run, shape ``(n_runs, k)``
    square: float  # what remains of ``r^T r``, the effects' own squares included

    def rest(self, r: ComplexArray, J: ComplexArray, Z: ComplexArray, runs: Sequence[Index]) -> Rest:
        """What the step and the effects leave."""
        count = r.size
        left = r.view(float) + self.step @ real_rows(J)
        own, leverage = real_rows(J), np.zeros(count)
        if Z.shape[1]:
            own, effects = own.copy(), real_rows(Z)
            for rows, value, onto, inner in zip(runs, self.own, self.onto, self.inner, strict=True):
                mine = _of_run(effects, rows)
                columns = _columns(rows)
                left[columns] += value @ mine
                own[:, columns] -= onto.T @ mine
                leverage[_span(rows)] = powers(inner @ mine, mine)
        leverage += powers(self.outer @ own, own)
        return Rest(residuals=left.view(complex), own=own.view(complex).T, leverage=leverage / 2)


@dataclass(frozen=True, eq=False, kw_only=True)
class Rest:
    """What a mixed model leaves of residuals and sensitivities."""

    residuals: ComplexArray  # after the step, effects taken out, shape ``(R,)``
    own: ComplexArray  # sensitivities to the fitted values less what the effects of each run follow, shape ``(R, p)``
    leverage: Float  # share of each reading that its own fit follows, mean of real and imaginary part, shape ``(R,)``


def real_rows(columns: ComplexArray) -> Float:
    """Columns of complex numbers as rows of their parts, shape ``(k, 2 R)``: products of real numbers are enough."""
    return np.ascontiguousarray(columns.T).view(float)


def powers(left: Float, right: Float) -> Float:
    """Sum over rows, and over both parts of each reading, of products, shape ``(..., R)``."""
    found = np.einsum("...kr,...kr->...r", left, right)
    return np.asarray(found[..., ::2] + found[..., 1::2])


def _span(rows: Index) -> slice | Index:
    """Readings that follow one another as a slice, which copies nothing."""
    together = rows.size > 0 and int(rows[-1]) - int(rows[0]) + 1 == rows.size
    return slice(int(rows[0]), int(rows[-1]) + 1) if together else rows


def _columns(rows: Index) -> slice | Index:
    """Places of both parts of some readings, in ascending order, among those of all."""
    span = _span(rows)
    if isinstance(span, slice):
        return slice(2 * span.start, 2 * span.stop)
    return np.asarray((2 * rows[:, None] + np.arange(2)).reshape(-1))


def _of_run(stacked: Float, rows: Index) -> Float:
    return stacked[:, _columns(rows)]


def runs_agree(model: MixedModel, *, level: float) -> bool:
    """Whether a score test, the kinds tried together, lets all runs agree."""
    return bool(model.score_p_values().min() * model.gram.shape[1] > level)


def select_effects(model: MixedModel, *, level: float, forced: Sequence[int] = ()) -> Float:
    """Variances of the kinds of effects that the data ask for, zero for the others, shape ``(k,)``.

    Kinds join one by one, that which raises the restricted likelihood most first, while a score test refuses that runs
    agree and the likelihood gains accordingly.
    """
    count = model.gram.shape[1]
    variance = np.zeros(count)
    if not count:
        return variance
    chosen = list(forced)
    if chosen:
        variance[chosen] = _best(model.part(chosen), np.zeros(len(chosen)))
    if not chosen and runs_agree(model, level=level):
        return variance
    from scipy.special import gammainccinv  # late: loading it takes longer than a fit

    least = 2 * float(gammainccinv(0.5, min(2 * level / count, 1.0)))  # a variance on its bound: half the chance
    base = _restricted(model, variance)
    while len(chosen) < count:
        trials = {}
        for kind in set(range(count)) - set(chosen):
            kinds = [*chosen, kind]
            found = _one(model.part(kinds), variance[kinds], len(chosen))
            trials[kind] = (model.part(kinds).log_likelihood(found), found) if found[-1] > 0 else (-np.inf, found)
        kind = max(trials, key=lambda k: trials[k][0])
        if 2 * (trials[kind][0] - base) < least:
            break
        chosen.append(kind)
        variance[chosen] = _best(model.part(chosen), trials[kind][1])
        base = _restricted(model, variance)
    return variance


def share_alike(model: MixedModel) -> Float:
    """Variances of all kinds that may be the one by which runs differ, each by how likely it is, shape ``(k,)``.

    Few runs do not tell, say, a force that differs from a damping. Each kind gets the variance that it has alone, times
    its weight: the mean of the covariances that one kind each would give.
    """
    alone = [_one(model.part([kind]), np.zeros(1), 0) for kind in range(model.gram.shape[1])]
    found = {kind: float(variance[0]) for kind, variance in enumerate(alone) if variance[0] > 0}
    gain = {kind: model.part([kind]).log_likelihood(alone[kind]) for kind in found}
    best = max(gain.values())
    weight = {kind: float(np.exp(gain[kind] - best)) for kind in found if best - gain[kind] < _ALIKE}
    shared = np.zeros(len(alone))
    for kind, share in weight.items():
        shared[kind] = found[kind] * share / sum(weight.values())
    return shared


def _restricted(model: MixedModel, variance: Float) -> float:
    kinds = np.flatnonzero(variance > 0)
    if kinds.size:
        return model.part(kinds.tolist()).log_likelihood(variance[kinds])
    return -0.5 * (_log_det(model.common.information) + model.common.left)


def _one(model: MixedModel, variance: Float, kind: int) -> Float:
    """Variances with one of them where the likelihood is largest; zero where it falls from the start."""

    from scipy.optimize import minimize_scalar  # with all it imports, too heavy for `import rotorfit`

    def at(log_sd: float) -> Float:
        found = np.maximum(variance, 1e-16)
        found[kind] = np.exp(2 * log_sd)
        return found

    # Below a tenth of what one run tells of its own effect, a variance is zero to any purpose.
    sizes = model.gram[:, kind, kind]
    least = np.log(0.03 / np.sqrt(max(float(sizes.max(initial=0.0)), 1e-300)))
    most = np.log(_LARGEST)
    if least >= most:
        return variance
    grid = np.linspace(least, most, 7)
    values = [model.log_likelihood(at(v)) for v in grid]
    best = int(np.argmax(values))
    if best == 0:
        return variance
    found = minimize_scalar(
        lambda v: -model.log_likelihood(at(v)),
        bounds=(grid[best - 1], grid[min(best + 1, 6)]),
        method="bounded",
        options={"xatol": 0.02},
    )
    return at(float(found.x))


def _best(model: MixedModel, variance: Float) -> Float:
    """Variances of several kinds by turns."""
    for _ in range(3 if variance.size > 1 else 1):
        for kind in range(variance.size):
            variance = _one(model, variance, kind)
    return variance


def _scale(matrix: Float) -> Float:
    """Root of the diagonal, one where that is zero."""
    diagonal = np.einsum("...kk->...k", matrix)
    return np.sqrt(np.where(diagonal > 0, diagonal, 1.0))


def inverse_of_determined(matrix: Float, null: float = 1e-12) -> Float:
    """Inverse of symmetric matrices; directions without information are left out."""
    scale = _scale(matrix)
    over = 1 / (scale[..., :, None] * scale[..., None, :])
    power, basis = np.linalg.eigh(matrix * over)
    kept = power > null * power[..., -1:]
    weight = np.divide(1.0, power, out=np.zeros_like(power), where=kept)
    return np.asarray(((basis * weight[..., None, :]) @ np.swapaxes(basis, -1, -2)) * over)


def _log_det(matrix: Float) -> float:
    """Logarithm of the determinant, directions without information as good as empty."""
    scale = _scale(matrix)
    power = np.linalg.eigvalsh(matrix / scale[:, None] / scale)
    return float(np.log(np.maximum(power, 1e-12)).sum() + 2 * np.log(scale).sum())
