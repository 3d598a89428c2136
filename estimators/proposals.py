"""Proposals for emcee: independent draws from a heavy-tailed picture of the posterior, mixed with emcee's own moves."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import emcee
import numpy as np
from scipy.stats import multivariate_t

from rotorfit.models.array_types import Float

DEGREES_OF_FREEDOM = 5.0
"""Tails of the independence proposal, heavy enough to reach the arms of a curved posterior."""
CLOSE = 12.0
"""The same where the proposal resembles the posterior: still heavier than that of more than a dozen readings."""

ALIKE = 0.6
"""Efficiency of importance sampling beyond which the proposal is taken to resemble the posterior."""
_LOOKS = 512  # draws that the efficiency is estimated from


class IndependenceMove(emcee.moves.MHMove):  # type: ignore[misc]
    """Metropolis-Hastings step with proposals that do not depend on where the walker stands.

    Walkers move freely wherever the proposal resembles the posterior; where it does not, they stay, and the other
    moves of a mixture have to carry them. The factor is ``q(x) / q(x')`` (Tierney 1994, independence chains).

    Args:
        centre: location, shape ``(p,)``.
        covariance: covariance of the posterior as the optimum sees it, shape ``(p, p)``.
        df: degrees of freedom of the multivariate t distribution.
    """

    def __init__(self, centre: Float, covariance: Float, df: float = DEGREES_OF_FREEDOM) -> None:
        # Drawn in units of the standard deviations, where the matrix is well scaled.
        self.centre, self.size = centre, np.sqrt(np.diag(covariance))
        shape = covariance / np.outer(self.size, self.size)
        self.proposal: Any = multivariate_t(np.zeros(centre.size), shape, df=df, allow_singular=True)
        super().__init__(self.draw, centre.size)

    def draw(self, coords: Float, random: np.random.RandomState) -> tuple[Float, Float]:
        """Proposed positions and log Hastings factors."""
        whitened = np.reshape(self.proposal.rvs(coords.shape[0], random_state=random), coords.shape)
        density = self.proposal.logpdf(np.concatenate([(coords - self.centre) / self.size, whitened]))
        return self.centre + whitened * self.size, density[: coords.shape[0]] - density[coords.shape[0] :]

    def efficiency(self, log_density: Callable[[Float], Float]) -> float:
        """Effective share of draws from the proposal as importance samples, one where it is the posterior itself."""
        random = np.random.RandomState(0)  # the same answer when a run is resumed
        drawn, factor = self.draw(np.broadcast_to(self.centre, (_LOOKS, self.centre.size)), random)
        log_weight = log_density(drawn) + factor
        best = log_weight.max()
        if not np.isfinite(best):
            return 0.0
        weight = np.exp(log_weight - best)
        return float(weight.sum() ** 2 / (weight @ weight) / _LOOKS)


def mixture(log_density: Callable[[Float], Float], centre: Float, covariance: Float) -> list[tuple[Any, float]]:
    """Independence proposals mixed with moves that need no picture: differential evolution and stretch.

    Independence proposals get 80 % where they resemble the posterior, and half where they do not and walkers have to
    be carried.

    Args:
        log_density: of vectors of shape ``(W, p)``.
        centre, covariance: picture of the posterior.
    """
    independence, share = IndependenceMove(centre, covariance, CLOSE), 0.8
    if independence.efficiency(log_density) < ALIKE:
        independence, share = IndependenceMove(centre, covariance), 0.5
    return [
        (independence, share),
        (emcee.moves.DEMove(), 0.8 * (1 - share)),
        (emcee.moves.StretchMove(), 0.2 * (1 - share)),
    ]
