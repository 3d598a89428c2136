"""Objective, settings and solution of the least-squares engine."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Literal, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

Vector: TypeAlias = NDArray[np.float64]
Matrix: TypeAlias = NDArray[np.float64]
HessianKind: TypeAlias = Literal["gauss-newton", "exact"]
Method: TypeAlias = Literal["auto", "gauss-newton", "ipopt"]

METHODS: tuple[Method, ...] = ("auto", "gauss-newton", "ipopt")


class Objective(Protocol):
    """A cost to minimise: half a sum of squared residuals, or a robustified one; never negative. ``x`` has shape (n,)
    in the caller's units. A point where the model is undefined is reported by a non-finite cost; the line search then
    backtracks. An exception aborts the fit and reaches the caller."""

    def cost(self, x: Vector) -> float:
        """Cost at ``x``; ``nan`` or ``inf`` where the model is undefined."""

    def gauss_newton(self, x: Vector) -> tuple[float, Vector, Matrix]:
        """Cost, gradient of shape (n,) and the Gauss-Newton matrix JᵀJ of shape (n, n)."""

    def hessian(self, x: Vector) -> Matrix:
        """Exact Hessian of the cost, shape (n, n)."""


class Status(Enum):
    """How a minimisation ended; the value is the message for the user."""

    CONVERGED = "converged"
    ITERATION_LIMIT = "stopped at the iteration limit: the estimate is the best point seen, not a minimum"
    SINGULAR = "not unique: the cost is minimal, but some change of the parameters leaves it unchanged"
    STALLED = "stalled: no further decrease was possible, yet the best point seen is not a minimum"
    INFEASIBLE_START = "not started: the cost or its derivatives are not finite at the starting point"


@dataclass(frozen=True)
class Options:
    """Settings of the solver; all tolerances are dimensionless."""

    max_iterations: int = 200  # iterations allowed in total, of all methods and Hessians together; at least 1
    method: Method = "auto"  # damped Gauss-Newton steps, Ipopt, or Ipopt where undamped Gauss-Newton steps lead nowhere
    tolerance: float = 1e-10
    acceptable: float = 1e-6  # relative offset that still counts as converged when round-off prevents ``tolerance``
    hessian: Literal["auto", "gauss-newton", "exact"] = "auto"

    def __post_init__(self) -> None:
        if self.max_iterations < 1:
            raise ValueError(f"max_iterations is {self.max_iterations}; it must be at least 1")
        if self.method not in METHODS:
            raise ValueError(f"method is {self.method!r}; allowed: {', '.join(map(repr, METHODS))}")


@dataclass(frozen=True, kw_only=True)
class Solution:
    """Outcome of :func:`~rotorfit.estimators.minimisation.least_squares.minimise`."""

    x: Vector  # best point seen, shape (n,), the caller's units; never outside the bounds
    cost: float  # cost at ``x``
    status: Status  # how the run ended
    n_iterations: int  # Ipopt iterations plus refinement steps
    n_evaluations: int  # evaluations of the objective, with or without derivatives
    hessian: HessianKind  # the Hessian Ipopt used last
    offset: float  # what the tolerances are compared with

    @property
    def success(self) -> bool:
        """True if ``x`` is a minimum within the tolerances."""
        return self.status is Status.CONVERGED

    @property
    def message(self) -> str:
        """The status in words."""
        return self.status.value
