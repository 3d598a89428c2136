"""Proposals for emcee: independent draws from a heavy-tailed picture of the posterior, mixed with emcee's own moves."""

from __future__ import annotations

from typing import Any

import emcee
import numpy as np
from numpy.typing import NDArray
from scipy.stats import multivariate_t

Float = NDArray[np.float64]

DEGREES_OF_FREEDOM = 6.0
"""Tails of the independence proposal: heavier than any posterior that comes from many readings."""


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


def mixture(centre: Float, covariance: Float) -> list[tuple[Any, float]]:
    """Half independence proposals, half moves that need no picture: differential evolution and stretch."""
    return [
        (IndependenceMove(centre, covariance), 0.5),
        (emcee.moves.DEMove(), 0.4),
        (emcee.moves.StretchMove(), 0.1),
    ]
