"""Random effects of runs, each the same within one run: a mixed linear model about a fit.

``residual = -J dx - Z b + noise``: J the sensitivity to the fitted values, Z that of each run to errors of its own
(force, phase reference, speed label, fluid), b normal with one variance for each kind. The variances are found by
restricted likelihood (Patterson and Thompson 1971). All of it is done with one small matrix a run.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from rotorfit.base.array_types import COLLINEAR, ComplexArray, Float, Index
from rotorfit.estimators.noise.sweep_noise import SMOOTH_CORRELATION

FEWEST_RUNS = 3
"""Runs among which one may be the odd one: of two runs either may."""

LEAST_RESIDUAL_SHARE = 0.02
"""Least 1 - leverage: a reading that alone determines something has no residual to judge by."""


@dataclass(frozen=True, eq=False, kw_only=True)
class MixedModel:
    """Sums over runs from which likelihoods and estimates follow."""

    gram: Float  # ``Z^T Z`` of each run, shape ``(n_runs, k, k)``
    cross: Float  # ``Z^T J`` of each run, shape ``(n_runs, k, p)``
    moment: Float  # ``Z^T r`` of each run, shape ``(n_runs, k)``
    information: Float  # ``J^T J`` of all readings and the curvature of the priors, shape ``(p, p)``
    gradient: Float  # ``J^T r`` of all readings, shape ``(p,)``
    square: float  # ``r^T r`` of all readings

    @classmethod
    def of(cls, r: ComplexArray, J: ComplexArray, Z: ComplexArray, runs: Sequence[Index], prior: Float) -> MixedModel:
        """Sums of whitened residuals and sensitivities of all readings, each in one of the runs if there are any."""
        k = Z.shape[1]
        parts = np.array([products(r, J, Z, rows) for rows in runs or [np.arange(r.size)]])
        whole, mine = parts.sum(axis=0), parts[: len(runs), :k]
        return cls(
            gram=mine[:, :, :k],
            cross=mine[:, :, k:-1],
            moment=mine[:, :, -1],
            information=whole[k:-1, k:-1] + np.diag(prior),
            gradient=whole[k:-1, -1],
            square=float(whole[-1, -1]),
        )

    def part(self, kinds: Sequence[int] | Index) -> MixedModel:
        """The model with some of the kinds only."""
        k = list(kinds)
        return replace(self, gram=self.gram[:, k][:, :, k], cross=self.cross[:, k], moment=self.moment[:, k])

    def solve(self, variance: Float) -> MixedSolution:
        """Step to the optimum with effects of given variances ``(..., k)``, infinite ones of effects that are free."""
        free = np.isinf(variance)
        precision = np.where(free, 0.0, 1 / np.where(free, 1.0, variance))
        precise = self.gram + (precision[..., None] * np.eye(variance.shape[-1]))[..., None, :, :]
        inner = inverse_of_determined(precise, COLLINEAR)[0] if free.any() else np.asarray(np.linalg.inv(precise))
        onto = inner @ self.cross
        matrix = self.information - np.einsum("ikp,...ikq->...pq", self.cross, onto)
        slope = self.gradient - np.einsum("...ikp,ik->...p", onto, self.moment)
        outer, log_determinant = inverse_of_determined(matrix)
        step = -np.einsum("...pq,...q->...p", outer, slope)
        onward = self.moment + np.einsum("ikp,...p->...ik", self.cross, step)
        explained = np.einsum("ik,...ikl,il->...", self.moment, inner, self.moment) - np.sum(slope * step, axis=-1)
        return MixedSolution(
            inner=inner,
            onto=onto,
            outer=outer,
            log_determinant=log_determinant,
            step=step,
            own=-np.einsum("...ikl,...il->...ik", inner, onward),
            square=self.square - explained,
        )

    def log_likelihood(self, variance: Float, *, restricted: bool = True) -> Float:
        """Restricted log likelihood of variances ``(..., k)``, up to a constant; else that at the best fitted values,
        which models with other fitted values are compared by."""
        solved, root = self.solve(variance), np.sqrt(variance)[..., None, :]
        spread = np.eye(variance.shape[-1]) + root[..., :, None] * self.gram * root[..., None, :]
        total = np.linalg.slogdet(spread)[1].sum(axis=-1) + solved.square
        return np.asarray(-0.5 * (total + (solved.log_determinant if restricted else 0.0)))

    def score_p_values(self) -> Float:
        """Probability of scores at least as large where runs agree, ``(k,)``: chi-squared by mean and variance."""
        from scipy.special import gammaincc  # late: loading it takes longer than a fit

        outer, _ = inverse_of_determined(self.information)
        C, own = np.swapaxes(self.cross, 0, 1), np.einsum("ikk->ki", self.gram)
        size = np.sqrt(np.where(own > 0, own, 1.0))  # every run has the same weight
        S = -(C @ outer @ np.swapaxes(C, 1, 2))
        np.einsum("kii->ki", S)[:] += own
        S /= size[:, :, None] * size[:, None, :]
        score = (self.moment.T - C @ (outer @ self.gradient)) / size
        mean, variance = np.einsum("kii->k", S), np.sum(S**2, axis=(1, 2))
        blind = mean <= COLLINEAR * own.shape[1]
        over = np.where(blind, 0.0, mean) / np.where(blind, 1.0, variance)
        p = gammaincc(np.where(blind, 1.0, mean * over / 2), np.sum(score**2, axis=1) * over / 2)
        return np.where(blind, 1.0, p)

    def freedom(self, variance: Float) -> Float:
        """Degrees of freedom that each estimated variance has, at least two (one for two runs), shape ``(k,)``. A
        variance that was chosen because it is large errs to the safe side, and fewer would widen without end."""
        solved = self.solve(variance)
        found = []
        for kind, own in enumerate(variance):
            # Of b's variance, own, the data leave var(b | data): the rest is what they determine.
            C = solved.onto[:, kind]
            left = np.diag(solved.inner[:, kind, kind]) + C @ solved.outer @ C.T
            determined = np.eye(len(left)) - left / own
            found.append(max(float(np.sum(determined**2)), min(2.0, len(left) - 1.0)))
        return np.array(found)


@dataclass(frozen=True, eq=False, kw_only=True)
class MixedSolution:
    """Estimates with effects of given variances."""

    inner: Float  # ``(Z^T Z + 1/variance)^-1`` of each run
    onto: Float  # that times ``Z^T J``
    outer: Float  # covariance of the fitted values, effects included
    log_determinant: Float  # of its inverse
    step: Float  # change of the fitted values
    own: Float  # effects of each run, shape ``(n_runs, k)``
    square: Float  # what remains of ``r^T r``, the effects' own squares included

    def residuals(self, r: ComplexArray, J: ComplexArray, Z: ComplexArray, runs: Sequence[Index]) -> Residuals:
        """Residuals after the step, effects taken out."""
        left = np.empty_like(J.T).T if Z.shape[1] else J
        found = Residuals(values=r.copy(), sensitivities=left, leverage=np.zeros(r.size))
        for number, rows in enumerate(runs or [np.arange(r.size)]):
            for part in parts(rows.size):
                some = in_a_row(rows[part])
                own, effects = real_rows(J[some]), real_rows(Z[some])
                values = found.values[some].view(float) + self.step @ own
                leverage = np.zeros(values.size // 2)
                if len(effects):
                    values += self.own[number] @ effects
                    own = own - self.onto[number].T @ effects
                    left[some] = own.view(complex).T
                    leverage += powers(self.inner[number] @ effects, effects)
                leverage += powers(self.outer @ own, own)
                found.values[some], found.leverage[some] = values.view(complex), leverage / 2
        return found


@dataclass(frozen=True, eq=False, kw_only=True)
class Residuals:
    """Residuals of a mixed model in units of its noise."""

    values: ComplexArray  # shape ``(R,)``
    sensitivities: ComplexArray  # to the fitted values, less the part that the effects of each run follow, ``(R, p)``
    leverage: Float  # share of each reading that its own fit follows, mean of real and imaginary part, shape ``(R,)``


def real_rows(columns: ComplexArray) -> Float:
    """Columns of complex numbers as rows of their parts, shape ``(k, 2 R)``."""
    return np.ascontiguousarray(columns.T).view(float)


def products(r: ComplexArray, J: ComplexArray, Z: ComplexArray, rows: Index) -> Float:
    """Products of effects, sensitivities and residuals of some readings with one another, in this order."""
    size, effects = Z.shape[1] + J.shape[1] + 1, Z.shape[1]
    total = np.zeros((size, size))
    for part in parts(rows.size):
        some = in_a_row(rows[part])
        own = np.empty((size, r[some].size), dtype=complex)
        own[:effects], own[effects:-1], own[-1] = Z[some].T, J[some].T, r[some]
        real = own.view(float)
        total += real @ real.T
    return total


def powers(left: Float, right: Float) -> Float:
    """Sum over rows, and over both parts of each reading, of products, shape ``(R,)``."""
    found = np.einsum("kr,kr->r", left, right)
    return np.asarray(found[::2] + found[1::2])


def parts(count: int) -> Iterator[slice]:
    """Readings in parts whose columns stay in the cache of the processor."""
    at_once = 4096
    return (slice(first, min(first + at_once, count)) for first in range(0, count, at_once))


def in_a_row(rows: Index) -> Index | slice:
    """Readings as a slice where each follows the one before, which takes no copy."""
    return slice(int(rows[0]), int(rows[-1]) + 1) if (np.diff(rows) == 1).all() else rows


def select_effects(model: MixedModel, *, level: float, forced: Sequence[int] = ()) -> Float:
    """Variances of the kinds of effects that the data ask for, zero for the others, shape ``(k,)``. Kinds join one by
    one, that which raises the restricted likelihood most first, while a score test refuses that runs agree and the
    likelihood gains accordingly."""
    count = model.gram.shape[1]
    variance, chosen = np.zeros(count), list(forced)
    if chosen:
        variance[chosen] = _best(model.part(chosen), np.zeros(len(chosen)))
    elif model.score_p_values().min() * count > level:  # the kinds tried together: all runs agree
        return variance
    from scipy.special import gammainccinv  # late: loading it takes longer than a fit

    least = 2 * float(gammainccinv(0.5, min(2 * level / count, 1.0)))  # a variance on its bound: half the chance
    some = np.flatnonzero(variance)
    base = model.part(some).log_likelihood(variance[some])
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
        base = model.part(chosen).log_likelihood(variance[chosen])
    return variance


def shared_variances(model: MixedModel) -> Float:
    """Variances of all kinds that may be the one by which runs differ, each by how likely it is, shape ``(k,)``. Few
    runs do not separate, say, a force that differs from a damping. Each kind gets the variance that it has alone, times
    its weight: the mean of the covariances that one kind each would give."""
    parts = [model.part([kind]) for kind in range(model.gram.shape[1])]
    alone = [_one(part, np.zeros(1), 0) for part in parts]
    gain = np.array([p.log_likelihood(v) if v[0] > 0 else -np.inf for p, v in zip(parts, alone, strict=True)])
    # Log likelihood below that of the best kind within which another is possible: its weight is a fifth, exp(-1.5)
    likelihood_of_alternatives = 1.5
    weight = np.where(gain.max() - gain < likelihood_of_alternatives, np.exp(gain - gain.max()), 0.0)
    return np.asarray(np.concatenate(alone) * weight / weight.sum())


def _one(model: MixedModel, variance: Float, kind: int) -> Float:
    """Variances with one of them where the likelihood is largest; zero where it falls from the start."""

    from scipy.optimize import minimize_scalar  # with all it imports, too heavy for `import rotorfit`

    def at(log_sd: Float | float) -> Float:
        found = np.tile(np.maximum(variance, 1e-16), (*np.shape(log_sd), 1))
        found[..., kind] = np.exp(2 * np.asarray(log_sd))
        return found

    sizes = model.gram[:, kind, kind]
    # Smallest standard deviation tried, over the error of one run's own effect: it adds a thousandth to the variance.
    smallest = 0.03
    least = np.log(smallest / np.sqrt(max(float(sizes.max(initial=0.0)), 1e-300)))
    # Largest relative standard deviation of an effect: the square that linearisation neglects is then a tenth.
    largest_sd = 0.3
    most = np.log(largest_sd)
    if least >= most:
        return variance
    grid = np.linspace(least, most, 7)
    best = int(np.argmax(model.log_likelihood(at(grid))))
    if best == 0:
        return variance
    precision = 0.02  # relative precision of a standard deviation: of ten runs it is known within a quarter
    found = minimize_scalar(
        lambda v: -float(model.log_likelihood(at(v))),
        bounds=(grid[best - 1], grid[min(best + 1, 6)]),
        method="bounded",
        options={"xatol": precision},
    )
    return at(found.x)


def _best(model: MixedModel, variance: Float) -> Float:
    """Variances of several kinds by turns."""
    for _ in range(3 if variance.size > 1 else 1):
        for kind in range(variance.size):
            variance = _one(model, variance, kind)
    return variance


def inverse_of_determined(matrix: Float, null: float = 1e-12) -> tuple[Float, Float]:
    """Inverse of symmetric matrices, directions without information left out, and the logarithm of their determinant,
    in which these are as good as empty."""
    diagonal = np.einsum("...kk->...k", matrix)
    scale = np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    over = 1 / (scale[..., :, None] * scale[..., None, :])
    power, basis = np.linalg.eigh(matrix * over)
    kept = power > null * power[..., -1:]
    weight = np.divide(1.0, power, out=np.zeros_like(power), where=kept)
    inverse = ((basis * weight[..., None, :]) @ np.swapaxes(basis, -1, -2)) * over
    return inverse, np.log(np.maximum(power, 1e-12)).sum(axis=-1) + 2 * np.log(scale).sum(axis=-1)


# ---- one run that does not go with the others ------------------------------------------------------------------------


def misfit_without(r: ComplexArray, J: ComplexArray, prior: Float, runs: Sequence[Index]) -> Float:
    """Mean squared residual, real and imaginary part, of a fit to all runs but one, run by run, by one step of Gauss
    and Newton."""
    rows = real_rows(J)
    information, gradient = rows @ rows.T + np.diag(prior), rows @ r.view(float)
    square = float(np.vdot(r, r).real)
    found = []
    for own in runs:
        mine = real_rows(J[own])
        left, slope = information - mine @ mine.T, gradient - mine @ r[own].view(float)
        size = np.sqrt(np.maximum(np.diag(left), np.finfo(float).tiny))
        step = np.linalg.lstsq(left / np.outer(size, size), slope / size, rcond=1e-10)[0] / size
        rest = square - float(np.vdot(r[own], r[own]).real) - float(slope @ step)
        found.append(max(rest, 0.0) / max(2 * (r.size - own.size) - prior.size, 1))
    return np.array(found)


def odd_run(
    r: ComplexArray, J: ComplexArray, prior: Float, runs: Sequence[Index], sweeps: Sequence[Index]
) -> tuple[int, float] | None:
    """Number of the one run without which a fit would be another, and what it would then leave; None where none is."""
    if len(runs) < FEWEST_RUNS:
        return None
    now = float(np.vdot(r, r).real) / max(2 * r.size - prior.size, 1)
    left = misfit_without(r, J, prior, runs)
    first, second = np.argsort(left)[:2].tolist()
    misfit_falls = 3.0  # times by which the misfit must fall without the odd run: far beyond the scatter of redchi
    misfit_falls_without_another = 1.5  # times by which it may fall without any other
    if left[first] * misfit_falls > now or left[second] * misfit_falls_without_another < now:
        return None
    # An error of a whole run leaves residuals that follow one another; one that jitters more than others is but noisy.
    own = [sweep for sweep in sweeps if np.isin(sweep[0], runs[first])]
    along = sum(float(np.vdot(r[sweep[:-1]], r[sweep[1:]]).real) for sweep in own)
    power = sum(float(np.vdot(r[sweep], r[sweep]).real) for sweep in own)
    return (first, float(left[first])) if along > SMOOTH_CORRELATION * power else None
