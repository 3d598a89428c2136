"""The posterior of a problem beside causes that are integrated out: no more dimensions, sizes drawn afterwards."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from rotorfit.base.array_types import Float, Index
from rotorfit.estimators.inference.covariance import prior_curvature, prior_slope
from rotorfit.estimators.inference.joint_errors import joint_step
from rotorfit.estimators.inference.linear_causes import CausesGiven, LinearCauses
from rotorfit.estimators.inference.log_posterior import PRIOR_FREEDOM, LogPosterior, Noise
from rotorfit.estimators.misfit.kernels import Batch
from rotorfit.estimators.misfit.problem import Problem, linear_response, robust_weights

_TOGETHER = 65_536
"""Readings of all vectors that are evaluated together: more leave the cache."""


class CausedPosterior(LogPosterior):
    """Log posterior density of a problem with causes of sizes ``c`` that change its residuals to first order.

    With residuals ``r`` and columns ``B``, each by a standard uncertainty, sizes are normal given the fitted values.
    Integrated out whatever their sign they leave ``min |r + B c|^2 + |c|^2``, which is ``|W r|^2`` with
    ``W = I - U (1 - 1 / sqrt(1 + d^2)) U'`` and ``B = U d V'``; the density is that times the probability that no cause
    of one sign is negative. Unknown noise is taken at the joint optimum in the weights by which sizes follow residuals.

    Vectors are less what the fitted values take up of causes, ``x - T c``, and ``B`` is what is left of the columns
    beside that (:class:`~rotorfit.estimators.inference.caused_problem.CausedProblem`): the density is as narrow as
    without causes, and what rests on their sizes is added with the sizes that are drawn.
    """

    def __init__(
        self,
        problem: Problem,
        noise: Noise,
        causes: LinearCauses,
        x: Float,
        *,
        taken: Float,
        inflation: float = 1.0,
        effects: Sequence[tuple[Index, float]] = (),
        accelerate: bool | None = None,
        work: float = np.inf,
    ) -> None:
        super().__init__(problem, noise, inflation=inflation, effects=effects, accelerate=accelerate, work=work)
        self.causes, self.taken = causes, taken
        whole = all(linear_response(block) is not None for block in problem.blocks)
        self._seen = self.batch if whole else Batch(problem, accelerate=False)
        size2, slope = robust_weights(problem.loss, np.abs(problem.residuals(x)) ** 2)
        sums = self._by_channel(size2) / inflation
        self._levels = np.zeros(sums.size) if noise == "fixed" else 0.5 * np.log((sums + PRIOR_FREEDOM) / self.counts)
        weight = slope * self._precision(self._levels)
        self._given = CausesGiven(causes=causes, weight=weight)
        # What the data tell of causes: columns are sums of few ways in which readings can go.
        left, told, right = np.linalg.svd(self._seen.in_channels(causes.columns.T).T, full_matrices=False)
        some = told > 1e-4  # of a standard uncertainty; the square by which the prior alone errs is a hundred millionth
        self._ways, self._of_ways = left[:, some] * told[some], right[some]
        parts = self._seen.parts
        self._grams = np.array([self._ways[part].T @ self._ways[part] for part in parts])
        self._weights = np.empty(2 * weight.size)
        for place in self._seen.places:
            self._weights[place] = weight
        self._weighed = self._ways * self._weights[:, None]
        self._onto = self._of_ways @ self._given.covar
        self._middle = causes.at - self._given.covar @ causes.at

    def _by_channel(self, size2: Float) -> Float:
        found = np.bincount(self.problem.channel, weights=size2, minlength=len(self.problem.channel_names))
        return np.asarray(found, dtype=float)

    def _precision(self, levels: Float) -> Float:
        """Weight of each reading's square by the level of its noise."""
        return np.exp(-2 * levels)[self.problem.channel] / self.inflation

    def sums_and_beside(self, x: Float) -> tuple[Float, Float | float]:
        """See :class:`LogPosterior`; sums at the most probable sizes."""
        sums, sizes = self._at_their_best(x)
        beside = -0.5 * np.einsum("wk,wk->w", sizes, sizes) + self._given.log_one_sign(sizes)
        return sums, beside

    def height(self, vectors: Float) -> Float:
        """See :class:`LogPosterior`: with the sizes at their most probable, not integrated out, as in the fit."""
        sizes = self._at_their_best(vectors[:, : self.problem.space.size])[1]
        return self(vectors) - self._given.log_one_sign(sizes) - self._given.fall(sizes)

    def drawn(self, vectors: Float, rng: np.random.Generator) -> tuple[Float, Float]:
        """Vectors ``(W, size)`` with what they take up of sizes of causes drawn at random, and these in their units."""
        # Walkers stay where they are for some steps: what is most probable there is worked out once.
        distinct, place = np.unique(vectors[:, : self.problem.space.size], axis=0, return_inverse=True)
        middle, sizes = np.empty((len(distinct), self.causes.at.size)), np.empty((len(vectors), self.causes.at.size))
        for some, r in self._misses(distinct):
            middle[some] = self._sizes(r @ self._weighed)
        for first in range(0, len(vectors), 4096):
            some = slice(first, first + 4096)
            sizes[some] = self._given.drawn(middle[place[some]], rng)
        return self._moved(vectors, sizes, 1), sizes

    def alone(self, vectors: Float, sizes: Float) -> Float:
        """Vectors less what they take up of causes of given sizes, of which this is the density."""
        return self._moved(vectors, sizes, -1)

    def _moved(self, vectors: Float, sizes: Float, way: int) -> Float:
        found = vectors.copy()
        found[:, : len(self.taken)] += way * (sizes / self.causes.size - self.causes.at) @ self.taken.T
        return found

    def _at_their_best(self, x: Float) -> tuple[Float, Float]:
        """Sums of squares of each channel and most probable sizes whatever their sign."""
        sums, sizes = np.empty((len(x), len(self._grams))), np.empty((len(x), self.causes.at.size))
        parts, loss = self._seen.parts, self.problem.loss
        for some, r in self._misses(x):
            if loss == "linear":  # readings of a channel weigh alike: all follows from what is along the ways
                along = np.array([r[:, part] @ self._ways[part] for part in parts])
                sizes[some] = self._sizes(np.tensordot(self._weights[[part.start for part in parts]], along, 1))
                moved = (sizes[some] - self.causes.at) @ self._of_ways.T
                square = np.array([np.einsum("wr,wr->w", r[:, part], r[:, part]) for part in parts])
                sums[some] = (square + np.einsum("cwq,wq->cw", 2 * along + moved @ self._grams, moved)).T
            else:
                sizes[some] = self._sizes(r @ self._weighed)
                size2 = (r + (sizes[some] - self.causes.at) @ self._of_ways.T @ self._ways.T) ** 2
                real, imaginary = (size2[:, place] for place in self._seen.places)
                rho = robust_weights(loss, real + imaginary)[0]
                sums[some] = [self._by_channel(own) for own in rho]
        return sums / self.inflation, sizes

    def _misses(self, x: Float) -> Iterator[tuple[slice, Float]]:
        step = max(1, 2 * _TOGETHER // self.problem.n_data)
        for first in range(0, len(x), step):
            some = slice(first, first + step)
            yield some, self._seen.misses(x[some])

    def _sizes(self, along: Float) -> Float:
        """Most probable sizes whatever their sign by weighed residuals along the ways."""
        return np.asarray(self._middle - along @ self._onto)

    def laplace(self, start: Float) -> tuple[Float, Float]:
        """See :class:`LogPosterior`: the optimum beside causes that are not below zero, and the covariance there
        whatever their sign."""
        x, levels, causes = start, self._levels, self.causes
        for _ in range(1 if self.noise == "fixed" else 30):
            r, J = self.problem.jacobian(x)
            root = np.sqrt(self._precision(levels) * robust_weights(self.problem.loss, np.abs(r) ** 2)[1])[:, None]
            step, sizes, _ = joint_step(
                (r - causes.columns @ causes.at) * root[:, 0],
                J * root,
                causes.columns * root,
                size=np.ones(causes.at.size),
                one_sided=causes.one_sided,
                prior=prior_curvature(self.problem, x),
                prior_slope=prior_slope(self.problem, x),
            )
            ahead = np.clip(x + step, self.lower, self.upper)
            if not np.isfinite(self.problem.cost(ahead)):
                break
            x = ahead
            if self.noise == "fixed":
                break
            left = self.problem.residuals(x) + causes.columns @ (sizes - causes.at)
            sums = self._by_channel(np.abs(left) ** 2) / self.inflation
            new = 0.5 * np.log((sums + PRIOR_FREEDOM) / self.counts)
            moved, levels = np.abs(new - levels).max(), new
            if moved < 1e-3:
                break
        return self._normal(x, levels, self._information(x, levels))

    def _information(self, x: Float, levels: Float) -> Float:
        """Of the vector, the causes taken out."""
        information = self._weighted(levels).gauss_newton(x)[2]
        r, J = self.problem.jacobian(x)
        weight = self._precision(levels) * robust_weights(self.problem.loss, np.abs(r) ** 2)[1]
        given, weighed = CausesGiven(causes=self.causes, weight=weight), self.causes.columns * weight[:, None]
        across = (J.conj().T @ weighed).real
        return information - across @ given.covar @ across.T
