"""Coordinates of a search along a valley: the logarithm of one parameter, and others over it.

Where data determine little more of some parameters than their ratios to another one, as lines of the twist do of
eccentricity and side load to inertia, what fits lies along a bent valley thousands of times as long as wide. In these
coordinates the valley is straight, one of them leads along it, and curvature along it stands apart from that across.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rotorfit.base.array_types import Float, Index
from rotorfit.estimators.misfit.parameter_space import ParameterSpace
from rotorfit.estimators.misfit.problem import Problem


@dataclass(frozen=True, eq=False, kw_only=True)
class Ratios:
    """Which entries of the fitted vector are replaced."""

    entry: int  # what the others are divided by; of the sign of ``size``
    numerators: Index  # the others
    size: float  # typical value of the entry, the unit of the logarithm

    def of(self, x: Float) -> Float:
        """Coordinates of fitted vectors, of the same shape."""
        y = x.copy()
        share = x[..., self.entry] / self.size
        y[..., self.numerators] /= share[..., None]
        y[..., self.entry] = np.log(share)
        return y

    def vectors(self, y: Float) -> Float:
        """Fitted vectors of coordinates, of the same shape."""
        x = y.copy()
        share = np.exp(y[..., self.entry])
        x[..., self.numerators] *= share[..., None]
        x[..., self.entry] = self.size * share
        return x

    def slope(self, y: Float) -> Float:
        """Derivatives of the fitted vector by its coordinates, shape ``(p, p)``."""
        x, by = self.vectors(y), np.eye(y.size)
        by[self.numerators, self.numerators] = np.exp(y[self.entry])
        by[self.numerators, self.entry] = x[self.numerators]
        by[self.entry, self.entry] = x[self.entry]
        return by

    def bounds(self, space: ParameterSpace) -> tuple[Float, Float]:
        """Bounds of the coordinates, shapes ``(p,)``."""
        lower, upper = space.lower.copy(), space.upper.copy()
        ends = sorted(bound[self.entry] / self.size for bound in (lower, upper))
        with np.errstate(divide="ignore"):  # a bound at zero is none of the logarithm
            lower[self.entry], upper[self.entry] = np.log(np.maximum(ends, 0.0))
        return lower, upper

    def led_by(self, entry: int, x: Float) -> Ratios:
        """The same with another of the parameters that go together in front; its sign is kept."""
        others = [self.entry, *self.numerators[self.numerators != entry].tolist()]
        return Ratios(entry=entry, numerators=np.array(others), size=float(x[entry]))


def ratios_of(problem: Problem) -> Ratios | None:
    """The coordinates that suit a problem, None where the entries of its fitted vector do."""
    space = problem.space
    if not any(block.reads_twist for block in problem.blocks):
        return None
    names = space.model.parameter_names
    for denominator, numerators in space.model.ratios.items():
        entries = [i for i, base in enumerate(space.base) if base == denominator]
        over = [i for i, base in enumerate(space.base) if base in numerators]
        places = [names.index(name) for name in numerators]
        given = space.template[:, places][space.index[:, places] < 0]
        bounds = np.concatenate([space.lower[over], space.upper[over]])
        if len(entries) != 1 or not over or space.lower[entries[0]] < 0:
            continue
        # A numerator that is known tells the other from its ratio; bounds but zero would be none of a ratio.
        if not given.any() and (np.isinf(bounds) | (bounds == 0)).all():
            size = space.model.parameter(denominator).scale
            return Ratios(entry=entries[0], numerators=np.array(over), size=size)
    return None


@dataclass(frozen=True, eq=False)
class LogRatioProblem:
    """A problem in such coordinates, an objective as the problem itself is."""

    problem: Problem  # the problem
    ratios: Ratios  # the coordinates

    def cost(self, y: Float) -> float:
        """See :meth:`Problem.cost`."""
        return self.problem.cost(self.ratios.vectors(y))

    def gauss_newton(self, y: Float) -> tuple[float, Float, Float]:
        """See :meth:`Problem.gauss_newton`."""
        cost, gradient, matrix = self.evaluate(y[None])
        return float(cost[0]), gradient[0], matrix[0]

    def evaluate(self, y: Float) -> tuple[Float, Float, Float]:
        """See :meth:`Problem.evaluate`."""
        cost, gradient, matrix = self.problem.evaluate(self.ratios.vectors(y))
        by = np.array([self.ratios.slope(row) for row in y])
        return cost, (gradient[:, None] @ by)[:, 0], by.swapaxes(1, 2) @ matrix @ by

    def hessian(self, y: Float) -> Float:
        """Second derivatives of the cost, by central differences of the exact gradient."""
        space = self.problem.space
        size = np.concatenate([space.typical, np.full(len(space.nuisance), 0.1)])
        size[self.ratios.entry] = 1.0
        largest = 0.1  # how many of them such a step is long at most
        with np.errstate(divide="ignore"):
            wide = largest / np.sqrt(np.diag(self.gauss_newton(y)[2]))
        relative_step = 1e-3  # of a coordinate, by which second derivatives are found from slopes to a millionth
        steps = np.diag(np.minimum(relative_step * np.maximum(np.abs(y), size), wide))
        slopes = self.evaluate(np.concatenate([y + steps, y - steps]))[1]
        matrix = (slopes[: y.size] - slopes[y.size :]) / (2 * np.diag(steps)[:, None])
        return np.asarray((matrix + matrix.T) / 2)
