"""The posterior of a problem: its density at many vectors at once, and its normal approximation at the optimum."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from rotorfit.base.array_types import ROUND_OFF, Float, Index
from rotorfit.estimators.minimisation.least_squares import minimise
from rotorfit.estimators.misfit.kernels import Batch
from rotorfit.estimators.misfit.priors import log_priors, within_support
from rotorfit.estimators.misfit.problem import Problem

Noise = Literal["marginal", "fixed", "sampled"]

NOISES: tuple[Noise, ...] = ("marginal", "fixed", "sampled")
PRIOR_FREEDOM = 1.0
"""Weight of the noise level given with the data, in real data, where the level is inferred; and of the estimated
variance of effects of runs, in runs."""


class LogPosterior:
    """Log posterior density of a problem.

    The noise given with the data sets the shape of each channel's noise; its level is what ``noise`` says:

    * "fixed": as given;
    * "marginal": unknown in each channel and integrated out in closed form. The prior of the scale is Jeffreys' 1/s
      together with one datum's worth of belief in the noise given, without which a channel of few readings could be
      met exactly and pull the density to infinity. With n real data of whitened sum of squares S the channel
      contributes ``(S + 1)^(-(n + 1)/2)``: one that the model misses widens by itself;
    * "sampled": the same, with log s of each channel as further entries of the vector.

    The likelihood is taken to the power of one over ``inflation``: of noise as given that multiplies its variance, of
    unknown noise so many readings count as one.

    Effects of runs, given by their entries and estimated standard deviation, are normal with a variance that is unknown
    too and integrated out the same way, in place of their priors: n of them with a sum of squares b contribute
    ``(sd^2 + b)^(-(n + 1)/2)``.
    """

    def __init__(
        self,
        problem: Problem,
        noise: Noise = "marginal",
        *,
        inflation: float = 1.0,
        effects: Sequence[tuple[Index, float]] = (),
        accelerate: bool | None = None,
        work: float = np.inf,
    ) -> None:
        if noise not in NOISES:
            raise ValueError(f"noise is {noise!r}; allowed: {', '.join(NOISES)}")
        if problem.loss != "linear" and noise != "fixed":
            raise ValueError(f"the {problem.loss} loss has a fixed scale: noise must be 'fixed', not {noise!r}")
        self.problem, self.noise, self.inflation = problem, noise, inflation
        self.batch = Batch(problem, accelerate=accelerate, work=work)
        belief = 0.0 if noise == "fixed" else PRIOR_FREEDOM
        self.counts = problem.channel_counts / inflation + belief
        self.size = problem.space.size + (self.counts.size if noise == "sampled" else 0)
        self.lower, self.upper = box(problem)
        self._effects = tuple(effects)
        shared = {int(entry) for entries, _ in effects for entry in entries}
        self._log_priors = log_priors([prior for prior in problem.priors if prior.entry not in shared])

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the entries of the sampled vector."""
        space = self.problem.space
        levels: list[str] = []
        for name in self.problem.channel_names if self.noise == "sampled" else ():
            # Files may name their runs alike: the second such channel is named by its number.
            count = sum(level.startswith((f"log_s[{name}]", f"log_s[{name} #")) for level in levels)
            levels.append(f"log_s[{name} #{count + 1}]" if count else f"log_s[{name}]")
        return (*space.names, *space.nuisance, *levels)

    def __call__(self, vectors: Float) -> Float:
        """Log density, up to a constant, of vectors of shape ``(W, size)``; minus infinity outside the bounds."""
        p = self.problem.space.size
        result = np.full(vectors.shape[0], -np.inf)
        inside = np.flatnonzero(((vectors[:, :p] >= self.lower) & (vectors[:, :p] <= self.upper)).all(axis=1))
        if not inside.size:
            return result
        x = vectors[inside, :p]
        with np.errstate(all="ignore"):  # a proposal may well be absurd; what is not finite is refused below
            (sums, beside), levels = self.sums_and_beside(x), vectors[inside, p:]
            if self.noise == "fixed":
                value = -0.5 * sums.sum(axis=1)
            elif self.noise == "marginal":
                value = -0.5 * np.log(sums + PRIOR_FREEDOM) @ self.counts
            else:
                value = -levels @ self.counts - 0.5 * ((sums + PRIOR_FREEDOM) * np.exp(-2 * levels)).sum(axis=1)
            value += self._log_priors(x) + beside
            for entries, sd in self._effects:
                size = np.sum((x[:, entries] / sd) ** 2, axis=1)
                value -= 0.5 * (PRIOR_FREEDOM + entries.size) * np.log(PRIOR_FREEDOM + size)
        result[inside] = np.where(np.isfinite(value), value, -np.inf)
        return result

    def height(self, vectors: Float) -> Float:
        """Log density by which optima are compared."""
        return self(vectors)

    def channel_sums(self, x: Float) -> Float:
        """Whitened sum of squares of each channel over ``inflation``, shape ``(W, channels)``."""
        return self.sums_and_beside(x)[0]

    def sums_and_beside(self, x: Float) -> tuple[Float, Float | float]:
        """:meth:`channel_sums`, and what is beside them in the log density."""
        return self.batch.channel_sums(x) / self.inflation, 0.0

    # ---- normal approximation ----------------------------------------------------------------------------------------

    def laplace(self, start: Float) -> tuple[Float, Float]:
        """Mode and covariance of the density's normal approximation."""
        x, levels = start, np.zeros(self.counts.size)
        # Alternate between the noise levels and the fit they weigh, which climbs the density at every turn.
        for _ in range(0 if self.noise == "fixed" else 30):
            new = 0.5 * np.log((self.channel_sums(x[None, :])[0] + PRIOR_FREEDOM) / self.counts)
            moved, levels = np.abs(new - levels).max(), new
            if moved < 1e-3:
                break
            x = self._fit(levels, x)
        if self.inflation != 1 and self.problem.priors and self.noise == "fixed":
            x = self._fit(levels, x)  # priors weigh more against wider noise
        information = self._weighted(levels).gauss_newton(x)[2]
        return self._normal(x, levels, information)

    def _normal(self, x: Float, levels: Float, information: Float) -> tuple[Float, Float]:
        """Centre and covariance by the information of the vector."""
        for prior in self.problem.priors:
            # A prior without curvature here still limits the width.
            has = prior.terms(float(x[prior.entry]))[2]
            floor = 1.0 / float(prior.distribution.var())
            information[prior.entry, prior.entry] += max(floor - has, 0.0) if np.isfinite(floor) else 0.0
        covariance = self._invert(information, x)
        if self.noise != "sampled":
            return x, covariance
        full = np.zeros((self.size, self.size))
        full[: x.size, : x.size] = covariance
        full[x.size :, x.size :] = np.diag(0.5 / self.counts)
        return np.concatenate([x, levels]), full

    def _weighted(self, levels: Float) -> Problem:
        """The problem with the noise of each channel multiplied by exp(level), and by ``inflation``."""
        factors = self.problem.by_block(np.sqrt(self.inflation) * np.exp(levels[self.problem.channel]))
        pairs = zip(self.problem.blocks, factors, strict=True)
        return replace(self.problem, blocks=tuple(block.with_noise(factor) for block, factor in pairs))

    def _fit(self, levels: Float, start: Float) -> Float:
        """Optimum with the noise of each channel multiplied by exp(level)."""
        inside = np.clip(start, self.lower, self.upper)
        return minimise(self._weighted(levels), inside, lower=self.lower, upper=self.upper).x

    def _invert(self, information: Float, x: Float) -> Float:
        size = np.sqrt(np.maximum(np.diag(information), 0.0))
        silent = size == 0
        size = np.where(silent, 1.0 / np.maximum(np.abs(x), 1.0), size)
        power, basis = np.linalg.eigh(information / np.outer(size, size))
        open_ = power <= ROUND_OFF * power[-1]
        self._refuse_runaway(basis[:, open_])
        closed = basis[:, ~open_] / size[:, None]
        covariance = closed / power[~open_] @ closed.T
        for direction in (basis[:, open_] / size[:, None]).T:
            # As wide as the line through x that the bounds leave, in multiples of the direction.
            moving = np.abs(direction) > 1e-9 * np.abs(direction).max()
            with np.errstate(divide="ignore", invalid="ignore"):
                ends = np.array([(self.lower - x) / direction, (self.upper - x) / direction])[:, moving]
            width = ends.max(axis=0).min() - ends.min(axis=0).max()
            covariance += np.outer(direction, direction) * width**2 / 12
        return np.asarray(covariance)

    def _refuse_runaway(self, flat: Float) -> None:
        """Refuse directions in the span of flat ones, shape ``(p, k)``, that leave the bounds nowhere."""
        from scipy.optimize import linprog

        flat = np.where(np.abs(flat) > 1e-9, flat, 0.0)
        at = np.concatenate([-flat[np.isfinite(self.lower)], flat[np.isfinite(self.upper)]])
        # A bound on one side stops motion to that side; what still moves without limit is found entry by entry.
        for way in (*flat, *-flat):
            if not way.any():
                continue
            found = linprog(-way, A_ub=at, b_ub=np.zeros(len(at)), bounds=(-1.0, 1.0))
            if found.success and -found.fun > 1e-4:
                names = (*self.problem.space.names, *self.problem.space.nuisance)
                moved = [name for name, part in zip(names, np.abs(flat @ found.x), strict=True) if part > 1e-4]
                raise ValueError(
                    f"the posterior is flat along {', '.join(moved)}, without bounds: fix one, bound it or give a prior"
                )


def box(problem: Problem) -> tuple[Float, Float]:
    """Bounds narrowed to where the priors are not zero, shapes ``(p,)``."""
    space = within_support(problem.space, problem.priors)
    return space.lower, space.upper
