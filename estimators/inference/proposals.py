"""Proposals for emcee: independent draws from a heavy-tailed approximation of the posterior, and its own moves."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import emcee
import numpy as np
from scipy.stats import multivariate_t

from rotorfit.models.array_types import RANK_TOLERANCE, Float

DEGREES_OF_FREEDOM = 5.0
"""Tails of the independence proposal, heavy enough to reach the arms of a curved posterior."""

GOOD_EFFICIENCY = 0.6
"""Efficiency of importance sampling beyond which the proposal is taken to resemble the posterior."""


class IndependenceMove(emcee.moves.MHMove):  # type: ignore[misc]
    """Metropolis-Hastings step with proposals that do not depend on where the walker stands. Walkers move freely
    wherever the proposal resembles the posterior; where it does not, they stay, and the other moves of a mixture have
    to carry them. The factor is ``q(x) / q(x')`` (Tierney 1994, independence chains)."""

    def __init__(self, centre: Float, covariance: Float, df: float = DEGREES_OF_FREEDOM) -> None:
        # In units of the standard deviations, where the matrix is well scaled, and along directions that have a spread:
        # SciPy's density of a singular t distribution counts the others too.
        size = np.sqrt(np.diag(covariance))
        power, basis = np.linalg.eigh(covariance / np.outer(size, size))
        spread = power > RANK_TOLERANCE * power[-1]
        root = np.sqrt(power[spread])
        self.centre, self.df = centre, df
        self._colour = (size[:, None] * basis[:, spread] * root).T
        self._whiten = basis[:, spread] / root / size[:, None]
        self.proposal: Any = multivariate_t(np.zeros(root.size), np.eye(root.size), df=df)
        super().__init__(self.draw, centre.size)

    def draw(self, coords: Float, random: np.random.RandomState) -> tuple[Float, Float]:
        """Proposed positions and log Hastings factors."""
        white = self.white(len(coords), random)
        here = (coords - self.centre) @ self._whiten
        density = self.proposal.logpdf(np.concatenate([here, white]))
        return self.place(white), density[: len(coords)] - density[len(coords) :]

    def white(self, count: int, random: np.random.RandomState) -> Float:
        """Draws in units of the spread along each direction that has one, shape ``(count, rank)``."""
        return np.reshape(self.proposal.rvs(count, random_state=random), (count, -1))

    def place(self, white: Float) -> Float:
        """Positions of such draws, shape ``(count, p)``."""
        return np.asarray(self.centre + white @ self._colour)


def best_proposal(
    log_density: Callable[[Float], Float], centre: Float, covariance: Float
) -> tuple[IndependenceMove, float]:
    """The proposal whose tails suit the posterior best, and how much it resembles it. The measure is the efficiency of
    importance sampling, ``E(w)^2 / E(w^2)`` with weights ``w = p / q``: one where the proposal is the posterior itself.
    The same draws, from the heaviest tails, judge all."""
    heavy = IndependenceMove(centre, covariance)
    # The same where the proposal resembles the posterior: that of few readings with noise of unknown level is Student's
    # t itself, that of hundreds is normal. Tails stay heavier than the posterior's, so that walkers leave every place.
    lighter = (12.0, 50.0)
    moves = [heavy, *(IndependenceMove(centre, covariance, df) for df in lighter)]
    random = np.random.RandomState(0)  # the same answer when a run is resumed
    count = 512  # draws that the efficiency is estimated from
    drawn = heavy.white(count, random)
    value = log_density(heavy.place(drawn))
    if not np.isfinite(value.max()):
        return heavy, 0.0
    posterior = np.exp(value - value.max())
    proposed = [np.exp(move.proposal.logpdf(drawn)) for move in moves]
    mean = (posterior / proposed[0]).mean()
    efficiency = [float(mean**2 / (posterior**2 / (proposed[0] * one)).mean()) for one in proposed]
    first = int(np.argmax(efficiency))
    return moves[first], efficiency[first]


def mixture(log_density: Callable[[Float], Float], centre: Float, covariance: Float) -> list[tuple[Any, float]]:
    """Independence proposals mixed with moves that need no approximation: differential evolution and stretch."""
    independence, efficiency = best_proposal(log_density, centre, covariance)
    # Share of independence proposals at most: the rest keeps a chain moving where 512 draws have seen nothing.
    largest_share = 0.9
    share = min(efficiency, largest_share)
    if efficiency < GOOD_EFFICIENCY:
        independence, share = IndependenceMove(centre, covariance), 0.5
    return [
        (independence, share),
        (emcee.moves.DEMove(), 0.8 * (1 - share)),
        (emcee.moves.StretchMove(), 0.2 * (1 - share)),
    ]
