"""Shares of measuring time that make errors smallest, with the certificate of the equivalence theorem.

Lines k of a test give the information ``F = F_0 + sum_k w_k F_k`` for shares w_k of the time. The mean over draws of
the parameters, and over quantities with gradient g, of ``log(g^T F^-1 g)`` is convex in w, and so is that of
``-log det F / p``. Its slope is minus the mean of ``phi_k = g^T F^-1 F_k F^-1 g / (g^T F^-1 g)``, and shares are
optimal where no line has a larger phi than those that are measured have on average (Kiefer and Wolfowitz 1960;
Pukelsheim 2006). Shares are found by the multiplicative steps ``w_k <- w_k phi_k^(1/2)`` (Silvey, Titterington and
Torsney 1978). The largest phi bounds what any other shares could reach: no information on the quantities is more than
that many times as large.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from rotorfit.base.array_types import RANK_TOLERANCE, Bool, Float, Index
from rotorfit.base.digits import significant
from rotorfit.estimators.noise.run_effects import inverse_of_determined

GAP = 0.01
"""Excess of the largest phi over the mean of measured lines at which a search ends: variances are the least to 1 %."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Lines:
    """Candidate lines of a test, at some draws of the parameters."""

    rows: Float  # derivatives of whitened readings, real and imaginary parts apart, shape ``(D, M, p)``
    line: Index  # line of each row, shape ``(M,)``
    fixed: Float  # information that is there whatever is measured, shape ``(D, p, p)``
    gradients: Float  # of the quantities that are wanted, shape ``(D, q, p)``; none for all parameters together

    @property
    def count(self) -> int:
        """Number of lines."""
        return int(self.line.max()) + 1

    def information(self, weight: Float) -> Float:
        """Information of lines with weights, one for the time that the rows are whitened by, shape ``(D, p, p)``."""
        weighed = self.rows * weight[self.line][:, None]
        return np.asarray(self.fixed + np.swapaxes(weighed, 1, 2) @ self.rows)

    def covariance(self, weight: Float) -> Float:
        """Covariance of what is determined, shape ``(D, p, p)``."""
        return inverse_of_determined(self.information(weight))[0]

    def variances(self, weight: Float) -> Float:
        """Variances of the quantities, shape ``(D, q)``."""
        return np.asarray(np.einsum("dqi,dij,dqj->dq", self.gradients, self.covariance(weight), self.gradients))

    def rank(self) -> Index:
        """Number of combinations of parameters that all lines together determine at each draw, shape ``(D,)``."""
        return np.asarray(np.sum(self._spread(np.ones(self.count)) > RANK_TOLERANCE, axis=1), dtype=np.intp)

    def of_draws(self, kept: Bool) -> Lines:
        """The lines at some of the draws."""
        return replace(self, rows=self.rows[kept], fixed=self.fixed[kept], gradients=self.gradients[kept])

    def _spread(self, weight: Float) -> Float:
        """Eigenvalues of the information, parameters scaled by that of all lines alike, shape ``(D, p)``."""
        size = np.sqrt(np.einsum("dpp->dp", self.information(np.ones(self.count))))
        size = np.where(size > 0, size, 1.0)
        return np.asarray(np.linalg.eigvalsh(self.information(weight) / (size[:, :, None] * size[:, None, :])))

    def criterion(self, weight: Float) -> float:
        """Mean logarithm of the variances, or of the volume of all errors a parameter."""
        if self.gradients.shape[1]:
            return float(np.mean(np.log(self.variances(weight))))
        return float(-np.mean(np.log(np.maximum(self._spread(weight), RANK_TOLERANCE))))

    def phi(self, weight: Float) -> Float:
        """Gain of the criterion by a unit of weight of each line, shape ``(K,)``."""
        covar = self.covariance(weight)
        if self.gradients.shape[1]:
            moves = covar @ np.swapaxes(self.gradients, 1, 2)  # (D, p, q)
            size = np.einsum("dqp,dpq->dq", self.gradients, moves)
            moves /= np.sqrt(size * self.gradients.shape[1])[:, None, :]
        else:
            power, basis = np.linalg.eigh(covar)
            moves = basis * np.sqrt(np.maximum(power, 0.0) / covar.shape[1])[:, None, :]
        gain = np.square(self.rows @ moves).sum(axis=2).mean(axis=0)
        return np.asarray(np.bincount(self.line, weights=gain, minlength=self.count), dtype=float)


@dataclass(frozen=True, eq=False, kw_only=True)
class Shares:
    """Shares of measuring time."""

    share: Float  # of each line, shape ``(K,)``, sum one, the even part included
    even: float  # part of the time that is spread over all lines alike
    phi: Float  # gain of each line, shape ``(K,)``
    gap: float  # excess of the largest phi over the mean of what the free part measures; zero at the optimum
    efficiency: float  # least information on the quantities over that of the best shares without an even part
    steps: int  # of the search

    @property
    def optimal(self) -> bool:
        """True if the equivalence theorem certifies the shares, to :data:`GAP`."""
        return self.gap <= GAP

    def __str__(self) -> str:
        if self.even == 1:
            return "the time is spread evenly over all lines"
        verdict = "optimal" if self.optimal else "not optimal"
        return (
            f"shares {verdict} by the equivalence theorem (gap {significant(self.gap, 2)} after {self.steps} steps); "
            f"with {self.even:.0%} of the time spread evenly they have at least {self.efficiency:.0%} of the "
            "information of the best shares"
        )


def optimal_shares(lines: Lines, even: float) -> Shares:
    """Shares that make the criterion smallest while a part of the time is spread over all lines alike."""
    count = lines.count
    free = np.full(count, 1.0 / count)
    step = 0
    most_steps = 2000  # the gap falls with the number of steps; a rig takes some tens to hundreds
    while True:
        share = even / count + (1 - even) * free
        phi = lines.phi(count * share) * count
        inside = float(free @ phi)
        gap = float(phi.max()) - inside
        if gap <= GAP or even == 1 or step == most_steps:
            break
        free = free * np.sqrt(phi / inside)
        free /= free.sum()
        step += 1
    # An information that is concave rises by no more than its slope says.
    bound = 1 + float(phi.max()) - float(share @ phi)
    return Shares(share=share, even=even, phi=phi, gap=gap, efficiency=1 / bound, steps=step)
